"""A XeThru X4 module on a serial line: `x4:/dev/ttyACM0` [NoveldaMCP].

The module is put into the mode in which the host drives the X4, gets the settings of a RadarSpec, and sends every frame
as it is measured. The driver's ranges are at 3e8 m/s [NoveldaX4Driver]; here they are at the vacuum speed of light.

Bytes are those of the XeThru Module Communication Protocol. A packet is 0x7D, its body, the exclusive or of both, and
0x7E; 0x7F escapes these three inside. A packet of data is four times 0x7C, the length of its body, a byte that is not
used, and the body without escapes. All numbers are little endian.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Iterator
from functools import reduce
from glob import glob
from operator import xor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ullage.errors import InputError, need
from ullage.geometry import C0
from ullage.ports.instruments.source import Instrument, InstrumentOptions, Scan
from ullage.ports.radar_logs import DRIVER_C
from ullage.specs import RadarSpec

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


CARRIERS = {7.29e9: 3, 8.748e9: 4}
"""Carriers [Hz] and their numbers in the module."""
ANSWER_S, SILENCE_S = 2.0, 3.0
"""How long an answer may take, and after how long without a byte the module counts as gone [s]."""
NOT_KNOWN = 0x01
ALLOWED = "x4:/dev/ttyACM0, the serial device of an X4 module"


class X4Options(InstrumentOptions):
    """Options of an X4 module; all others are fields of its RadarSpec."""

    baud: int = Field(115200, ge=1200, le=4_000_000, description="speed of a serial line; a USB port ignores it")
    power: int | None = Field(
        None, ge=0, le=3, description="transmitter: 0 off, 1 low, 2 medium, 3 high; none: as it is"
    )


def _present() -> str:
    found = sorted([*glob("/dev/ttyACM*"), *glob("/dev/ttyUSB*")])
    return f"{ALLOWED}; here: {', '.join(found) or 'none'}"


class X4Module(Instrument):
    """One module on a serial device, such as `/dev/ttyACM0`; its carrier is one of two, and its output baseband."""

    scheme, settings, preset = "x4", X4Options, "x4m05"

    def __init__(self, address: str, spec: RadarSpec, options: X4Options) -> None:
        super().__init__(address, spec, options)
        self._device = address
        if not address:
            raise InputError("no device is named", where="x4:", allowed=_present())
        if spec.center_hz not in CARRIERS or spec.output != "baseband":
            known = " or ".join(f"{hz:g}" for hz in CARRIERS)
            raise InputError(
                f"{spec.output} at {spec.center_hz:g} Hz", where=self.place, allowed=f"baseband at {known} Hz"
            )
        if spec.stagger_div is not None:
            raise InputError(f"stagger_div is {spec.stagger_div}", where=self.place, allowed="none: one pulse interval")
        self._serial: Any = need("serial", extra="instruments")
        self._line: Any = None
        self._unpacker = Unpacker()
        self._counter: int | None = None
        self._strange = 0

    def start(self) -> None:
        """Open the line, set the X4 up, and let it send frames."""
        if not os.path.exists(self._device):
            raise InputError("no such device", where=self.place, allowed=_present())
        try:
            self._line = self._serial.Serial(self._device, self._options.baud, timeout=0.2, exclusive=True)
        except (OSError, ValueError) as error:
            raise InputError(_why_not(error), where=self.place, allowed=_present()) from None
        self._unpacker, self._counter = Unpacker(), None
        self._set_up()

    def _set_up(self) -> None:
        spec = self._wanted
        for mode in (STOP, MANUAL):
            self._ask(bytes([SET_MODE, mode]), f"mode {mode:#x}", unknown=True)  # X4M03 has no modes
        self._ask(bytes([X4_DRIVER, INIT]), "a start of the X4", unknown=True)
        step_m = spec.decimation * C0 / (2 * spec.sampling_hz)
        area = np.array([spec.range_start_m, spec.range_start_m + spec.bins * step_m]) * (DRIVER_C / C0)
        whole, byte, real = (struct.Struct(kind).pack for kind in ("<I", "<B", "<f"))
        settings = [
            (FPS, real(0.0), "fps 0"),  # nothing comes while it is set up
            (BASEBAND, byte(1), "baseband"),
            (CARRIER, byte(CARRIERS[spec.center_hz]), f"center_hz {spec.center_hz:g}"),
            (ITERATIONS, whole(spec.iterations), f"iterations {spec.iterations}"),
            (PULSES, whole(spec.pulses_per_step), f"pulses_per_step {spec.pulses_per_step}"),
            (DAC_STEP, byte(spec.dac_step), f"dac_step {spec.dac_step}"),
            (DAC_MIN, whole(spec.dac_min), f"dac_min {spec.dac_min}"),
            (DAC_MAX, whole(spec.dac_max), f"dac_max {spec.dac_max}"),
            (PRF_DIV, byte(spec.prf_div), f"prf_div {spec.prf_div}"),
            (AREA_OFFSET, real(spec.frame_area_offset_m), f"frame_area_offset_m {spec.frame_area_offset_m:g}"),
            (AREA, struct.pack("<ff", *area), f"ranges of {area[0]:.3g} to {area[1]:.3g} m"),
        ]
        if self._options.power is not None:
            settings.append((POWER, byte(self._options.power), f"power {self._options.power}"))
        for name, value, text in settings:
            self._ask(setting(name, value), text)
        answer = floats_of(self._ask(struct.pack("<BBI", X4_DRIVER, GET, AREA), "its ranges"))
        start_m = (
            float(answer.values[0]) * (C0 / DRIVER_C) if answer and len(answer.values) == 2 else spec.range_start_m
        )
        self.spec = spec.but(range_start_m=start_m)
        self._ask(setting(FPS, real(spec.fps)), f"fps {spec.fps:g}")

    def _ask(self, body: bytes, what: str, *, unknown: bool = False) -> bytes:
        """Send a command and return its answer; `unknown` says that a module need not know it.

        Raises:
            InputError: no answer comes, or it is an error.
        """
        self._line.write(pack(body))
        end_s = time.monotonic() + ANSWER_S
        while time.monotonic() < end_s:
            for answer in self._unpacker.feed(self._line.read(max(self._line.in_waiting, 1))):
                if answer[0] in (ACK, REPLY):
                    return answer
                if answer[0] == ERROR:
                    code = int.from_bytes(answer[1:5], "little")
                    if unknown and code == NOT_KNOWN:
                        return answer
                    text = ERRORS.get(code, f"gives error {code:#x}")
                    raise InputError(f"the module refuses {what}: it {text}", where=self.place)
        allowed = f"an X4 module, and its speed: baud={self._options.baud}"
        raise InputError(f"no answer when asked for {what}", where=self.place, allowed=allowed)

    def scans(self) -> Iterator[Scan]:
        """Give frames until a while passes without one.

        Raises:
            OSError: the device is gone, or silent for too long.
        """
        heard_s = time.monotonic()
        while time.monotonic() - heard_s < SILENCE_S:
            came = self._line.read(max(self._line.in_waiting, 1))
            arrived_s = time.time()
            for body in self._unpacker.feed(came):
                scan = self._scan(body, arrived_s)
                if scan is not None:
                    heard_s = time.monotonic()
                    yield scan
        raise TimeoutError(0, f"silent for {SILENCE_S:g} s")

    def _scan(self, body: bytes, arrived_s: float) -> Scan | None:
        data = floats_of(body) if body[0] == DATA else None
        if data is None or len(data.values) % 2 or len(data.values) < 16 or not np.isfinite(data.values).all():
            self._strange += body[0] == DATA
            return None
        bins, before = len(data.values) // 2, self._counter
        if self._counter == data.information:  # the same frame again
            return None
        if before is None and bins != self.spec.bins:  # the module rounds the ranges that it was asked for
            self.spec = self.spec.but(bins=bins)
        if bins != self.spec.bins:
            self._strange += 1
            return None
        self._counter = data.information
        samples = np.empty(bins, np.complex64)
        samples.real, samples.imag = data.values[:bins], data.values[bins:]
        return Scan(samples, data.information / self.spec.fps, arrived_s)

    def close(self) -> None:
        """Let the X4 rest, and close the line."""
        if self._line is None:
            return
        try:
            self._line.write(pack(setting(FPS, struct.pack("<f", 0.0))))
            self._line.flush()
        except OSError:
            pass  # it is gone
        finally:
            self._line.close()
            self._line = None

    def health(self) -> list[str]:
        """Return how many packets came damaged."""
        count = self._unpacker.damaged + self._strange
        return [f"{count:,} packets came damaged"] if count else []


open_source = X4Module.open


def _why_not(error: Exception) -> str:
    text = str(error)
    if "lock" in text:
        return "in use: another program has it open"
    if "ermission" in text:
        return "no permission; its group (dialout) may open it"
    return f"cannot be opened: {text.rpartition(': ')[2] or text}"
