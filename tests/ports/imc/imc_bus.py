"""A peer that stands for DUNE: a TCP server that packs its own bytes, flies a line, and keeps all it is sent.

Run as a process: `python imc_bus.py PORT SECONDS FILE [ALSO]`; PORT 0 takes a free one. The port is the first line it
prints. ALSO holds packets, little endian, that are sent beside the poses, 40 a second.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import sys
import time
from contextlib import suppress
from pathlib import Path

VEHICLE, NAME = 0x0803, b"test-copter"
LAT, LON, HEIGHT = math.radians(63.4185), math.radians(10.4009), 40.0


def checksum(data: bytes) -> int:
    """CRC-16/ARC bit by bit."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


def packed(number: int, payload: bytes, *, t_s: float, src: int = VEHICLE, ent: int = 7, order: str = "<") -> bytes:
    """A packet."""
    head = struct.pack(order + "HHHdHBHB", 0xFE54, number, len(payload), t_s, src, ent, 0xFFFF, 255)
    return head + payload + struct.pack(order + "H", checksum(head + payload))


def text(data: bytes) -> bytes:
    """A string field."""
    return struct.pack("<H", len(data)) + data


def announce(t_s: float, *, src: int = VEHICLE, name: bytes = NAME, services: bytes = b"", order: str = "<") -> bytes:
    """An Announce."""
    word = lambda data: struct.pack(order + "H", len(data)) + data  # noqa: E731
    place = struct.pack(order + "BHddf", 2, 0xFFFF, LAT, LON, HEIGHT)
    return packed(151, word(name) + place + word(services), t_s=t_s, src=src, order=order)


def estimated_state(t_s: float, north: float, east: float, down: float, psi: float, **header) -> bytes:
    """An EstimatedState that moves north at half a metre a second, or as told."""
    order, (vx, vy, vz) = header.get("order", "<"), header.pop("velocity", (0.5, 0, 0))
    body = struct.pack(
        order + "ddf3f3f3f3f3fff",
        LAT,
        LON,
        HEIGHT,
        north,
        east,
        down,
        0,
        0,
        psi,
        0.5,
        0,
        0,
        vx,
        vy,
        vz,
        0,
        0,
        0,
        -1,
        -down,
    )
    return packed(350, body, t_s=t_s, **header)


def heartbeat(t_s: float) -> bytes:
    """A Heartbeat."""
    return packed(150, b"", t_s=t_s)


def split(data: bytes) -> list[bytes]:
    """Packets that lie one after the other."""
    out = []
    while data:
        size = 22 + struct.unpack_from("<H", data, 4)[0]
        out.append(data[:size])
        data = data[size:]
    return out


def serve(port: int, seconds: float, kept: Path, also: bytes = b"") -> None:
    """Fly north from the origin for so long, 20 poses a second, in the time of the packets and of the wall."""
    server = socket.create_server(("127.0.0.1", port))
    print(server.getsockname()[1], flush=True)
    client, _ = server.accept()
    began, sent, got = time.time(), 0, bytearray()
    others, gone = split(also), 0
    with suppress(OSError):  # the client may leave first
        while (now := time.time()) < began + seconds:
            due = int((now - began) * 20)
            for k in range(sent, due + 1):
                client.sendall(estimated_state(began + k / 20, 0.5 * k / 20, 0, -2, math.pi / 2))
                if k % 20 == 0:
                    client.sendall(heartbeat(now) + announce(now))
            sent = due + 1
            gone, before = int((now - began) * 40), gone
            client.sendall(b"".join(others[before:gone]))
            if select.select([client], [], [], 0.02)[0]:
                got += client.recv(1 << 16)
        client.shutdown(socket.SHUT_WR)
        client.settimeout(60)
    with suppress(OSError):
        while data := client.recv(1 << 16):
            got += data
    kept.write_bytes(got)


if __name__ == "__main__":
    serve(int(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]), b"".join(Path(p).read_bytes() for p in sys.argv[4:]))
