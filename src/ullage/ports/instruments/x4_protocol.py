"""Bytes of the XeThru Module Communication Protocol, as X4 modules speak it on a serial line [NoveldaMCP].

A packet is 0x7D, its body, the exclusive or of both, and 0x7E; 0x7F escapes these three inside. A packet of data is
four times 0x7C, the length of its body, a byte that is not used, and the body without escapes. All numbers are little
endian.
"""

from __future__ import annotations

import struct
from functools import reduce
from operator import xor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

START, END, ESCAPE = 0x7D, 0x7E, 0x7F
MARK = b"\x7c\x7c\x7c\x7c"
"""Start of a packet without escapes; as a float 5e36, which no sample is."""
SET_MODE, X4_DRIVER, SET, GET, INIT = 0x20, 0x50, 0x10, 0x11, 0x20
STOP, MANUAL = 0x13, 0x12
"""Modes of a module: at rest, and the X4 driven by the host."""
ACK, REPLY, ERROR, DATA, FLOATS = 0x10, 0x11, 0x20, 0xA0, 0x12
FPS, PULSES, ITERATIONS, BASEBAND, AREA = 0x10, 0x11, 0x12, 0x13, 0x14
DAC_STEP, DAC_MIN, DAC_MAX, AREA_OFFSET, CARRIER, POWER, PRF_DIV = 0x15, 0x16, 0x17, 0x18, 0x20, 0x21, 0x25
ERRORS = {0x01: "does not know it", 0x02: "received it damaged", 0x03: "is busy", 0x20: "has no such application",
          0x21: "cannot do it", 0x22: "is restarting"}  # fmt: skip
ARRAY = struct.Struct("<BBIII")
"""Head of a reply or of data: kind, type, content, information, count."""
MOST_BYTES = 1 << 17
"""Of a packet: 16000 bins are twice as many as an X4 has."""


def pack(body: bytes) -> bytes:
    """Return a body as a packet with escapes."""
    out = bytearray([START])
    for byte in (*body, reduce(xor, body, START)):
        if byte in (START, END, ESCAPE):
            out.append(ESCAPE)
        out.append(byte)
    out.append(END)
    return bytes(out)


def pack_data(samples: NDArray[np.float32], counter: int) -> bytes:
    """Return samples (n) as a packet of data without escapes."""
    body = ARRAY.pack(DATA, FLOATS, 0, counter, len(samples)) + samples.astype("<f4").tobytes()
    return MARK + struct.pack("<IB", len(body), 0) + body


def setting(name: int, value: bytes) -> bytes:
    """Return the body that sets a parameter of the X4."""
    return struct.pack("<BBI", X4_DRIVER, SET, name) + value


class Data(NamedTuple):
    """Numbers in a body."""

    content: int
    information: int  # of a frame: its counter
    values: NDArray[np.float32]


def floats_of(body: bytes) -> Data | None:
    """Return the floats of a body, data or a reply; None if it holds none or its length is wrong."""
    if len(body) < ARRAY.size or body[0] not in (DATA, REPLY) or body[1] != FLOATS:
        return None
    _, _, content, information, count = ARRAY.unpack_from(body)
    if len(body) - ARRAY.size - 4 * count not in (0, 1):  # some versions end a reply with the size of an item
        return None
    return Data(content, information, np.frombuffer(body, "<f4", count, ARRAY.size))


class Unpacker:
    """Finds the bodies of packets in a stream of bytes of any pieces.

    Bytes between packets are skipped. Where a packet of data starts inside another packet, that one lost its end.
    """

    def __init__(self) -> None:
        self._waiting = bytearray()
        self.damaged = 0
        """Packets that did not come whole."""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the bodies that are whole with these bytes."""
        self._waiting += data
        out: list[bytes] = []
        at = 0
        while (found := self._next(at)) is not None:
            body, at = found
            if body is not None:
                out.append(body)
        del self._waiting[: self._first(at)]
        return out

    def _first(self, at: int) -> int:
        """Return where the next packet starts, or what may become one."""
        marks = [place for place in (self._waiting.find(START, at), self._waiting.find(MARK, at)) if place >= 0]
        if marks:
            return min(marks)
        end = len(self._waiting)
        while end > at and end > len(self._waiting) - 3 and self._waiting[end - 1] == MARK[0]:
            end -= 1
        return end

    def _next(self, at: int) -> tuple[bytes | None, int] | None:
        """Return the next body and where it ends; None where more bytes are needed."""
        start = self._first(at)
        if start >= len(self._waiting) or self._waiting[start] not in (START, MARK[0]):
            return None
        return self._escaped(start) if self._waiting[start] == START else self._plain(start)

    def _plain(self, start: int) -> tuple[bytes | None, int] | None:
        head = start + 9
        if len(self._waiting) < head:
            return None
        (length,) = struct.unpack_from("<I", self._waiting, start + 4)
        if length > MOST_BYTES:
            self.damaged += 1
            return None, start + 4
        broken = self._waiting.find(MARK, head, head + length)
        if broken >= 0:
            self.damaged += 1
            return None, broken
        if len(self._waiting) < head + length:
            return None
        return bytes(self._waiting[head : head + length]), head + length

    def _escaped(self, start: int) -> tuple[bytes | None, int] | None:
        body, at, mark = bytearray(), start + 1, self._waiting.find(MARK, start)
        while at < len(self._waiting):
            if at == mark:
                self.damaged += 1
                return None, mark
            byte = self._waiting[at]
            if byte == END:
                if len(body) > 1 and reduce(xor, body, START) == 0:
                    return bytes(body[:-1]), at + 1
                self.damaged += 1
                return None, at + 1
            if byte == START or at - start > MOST_BYTES:
                self.damaged += 1
                return None, at
            if byte == ESCAPE:
                at += 1
                if at == len(self._waiting):
                    return None
            body.append(self._waiting[at])
            at += 1
        return None
