"""CRC-16/ARC, and the search for packets between garbage. Plain arrays only."""

from __future__ import annotations

import numpy as np

from ullage.kernels.loops import loop


def _table() -> np.ndarray:
    out = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        out = np.where(out & 1, (out >> 1) ^ 0xA001, out >> 1).astype(np.uint16)
    return out


TABLE = _table()
WHOLE, SHORT, NONE, OTHER = range(4)
HEAD, TAIL = 20, 2


@loop()
def crc16(data: np.ndarray, start: int) -> np.int64:
    """Compute the CRC-16/ARC of bytes (polynomial 0x8005, reflected) that go on from `start`."""
    crc = np.int64(start)
    for byte in data:
        crc = np.int64(TABLE[(crc ^ np.int64(byte)) & 0xFF]) ^ (crc >> 8)
    return crc


@loop()
def running(data: np.ndarray, out: np.ndarray) -> None:
    """Write the CRC of the first k bytes, for each k, to `out` (n + 1)."""
    crc = np.int64(0)
    out[0] = crc
    for k in range(len(data)):
        crc = np.int64(TABLE[(crc ^ np.int64(data[k])) & 0xFF]) ^ (crc >> 8)
        out[k + 1] = crc


@loop()
def powers(out: np.ndarray) -> None:
    """Write to `out` the CRC that k zero bytes make of 0x8000 (the polynomial 1), for each k."""
    crc = np.int64(0x8000)
    for k in range(len(out)):
        out[k] = crc
        crc = np.int64(TABLE[crc & 0xFF]) ^ (crc >> 8)


@loop()
def stretch(crcs: np.ndarray, power: np.ndarray, start: int, end: int) -> np.int64:
    """Compute the CRC of bytes start..end from the running ones: a CRC is linear, so the part before is taken off."""
    left, factor, shifted = np.int64(crcs[start]), np.int64(power[end - start]), np.int64(0)
    for bit in range(15, -1, -1):
        if (left >> bit) & 1:
            shifted ^= factor
        factor = (factor >> 1) ^ (0xA001 if factor & 1 else 0)
    return np.int64(crcs[end]) ^ shifted


@loop()
def find(
    data: np.ndarray, crcs: np.ndarray, power: np.ndarray, start: int, minor: int, lost: bool
) -> tuple[int, int, np.int64]:
    """Find the next packet from `start` on.

    Returns:
        What it is, where it begins and how long it is. WHOLE: a packet of this version. OTHER: one of another version.
        SHORT: what may be a packet lacks its end. NONE: nothing from there on can be one.
    """
    waits, first = False, 0
    n = len(data)
    for at in range(start, n - 1):
        if data[at] == 0xFE:
            version = data[at + 1]
        elif data[at + 1] == 0xFE:
            version = data[at]
        else:
            continue
        if version != minor and (version < 0x30 or version > 0x7F):
            continue
        size = np.int64(HEAD + TAIL)
        if at + 6 <= n:
            # sync written FE xx is big endian: its size has the high byte first
            big = data[at] == 0xFE
            size += (
                (np.int64(data[at + 4]) << 8 | np.int64(data[at + 5]))
                if big
                else (np.int64(data[at + 5]) << 8 | np.int64(data[at + 4]))
            )
        if at + 6 > n or at + size > n:
            if version == minor and not waits:
                waits, first = True, at
                if not lost:
                    return SHORT, at, size
            continue
        big = data[at] == 0xFE
        a, b = np.int64(data[at + size - 2]), np.int64(data[at + size - 1])
        given = a << 8 | b if big else b << 8 | a
        if stretch(crcs, power, at, at + size - TAIL) == given:
            return (WHOLE if version == minor else OTHER), at, size
        lost = True
    if waits:
        return SHORT, first, np.int64(0)
    return NONE, max(n - 1, start), np.int64(0)
