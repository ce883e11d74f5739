"""Logs of vehicles as their programs write them, made of a track: PX4's ULog, ArduPilot's DataFlash, NMEA 0183, UBX."""

from __future__ import annotations

import operator
import struct
from functools import reduce

import numpy as np

import ullage as ul
from ullage.geometry import matrix_quat, quat_matrix, quat_rpy
from ullage.ports.ned import FLIP, SWAP, Geodetic

PLACE = Geodetic.degrees(-33.5, -70.25, 520.0)


def autopilot(track: ul.Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Places north, east, down (n, 3) and quaternions xyzw from forward-right-down (n, 4)."""
    return track.position @ SWAP.T, matrix_quat(SWAP @ quat_matrix(track.quat_xyzw) @ FLIP)


def ulog(track: ul.Trajectory) -> bytes:
    """A log of PX4: attitudes at the times of the track, places in between, so that attitudes are interpolated."""
    formats = (
        b"vehicle_local_position:uint64_t timestamp;float x;float y;float z;",
        b"vehicle_attitude:uint64_t timestamp;float[4] q;",
    )

    def message(kind: bytes, data: bytes) -> bytes:
        return struct.pack("<Hc", len(data), kind) + data

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    out += b"".join(message(b"F", text) for text in formats)
    for number, text in enumerate(formats):
        out += message(b"A", struct.pack("<BH", 0, number) + text.partition(b":")[0])
    t_us, (_, quat) = track.t_ns // 1000, autopilot(track)
    between = t_us[:-1] + np.diff(t_us) // 2
    ned, _ = autopilot(track.at(between * 1000))
    for t, (x, y, z, w) in zip(t_us, quat, strict=True):
        out += message(b"D", struct.pack("<HQ4f", 1, t, w, x, y, z))
    for t, place in zip(between, ned, strict=True):
        out += message(b"D", struct.pack("<HQ3f", 0, t, *place))
    return out


def dataflash(track: ul.Trajectory) -> bytes:
    """A log of ArduPilot with the estimates of two cores; those of the second are wrong."""

    def described(kind: int, size: int, name: bytes, form: bytes, columns: bytes) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, name, form, columns)

    columns = b"TimeUS,C,Roll,Pitch,Yaw,PN,PE,PD"
    out = described(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    out += described(64, 3 + 8 + 1 + 6 * 4, b"XKF1", b"QBffffff", columns)
    ned, quat = autopilot(track)
    for t, place, angles in zip(track.t_ns // 1000, ned, np.degrees(quat_rpy(quat)), strict=True):
        for core in (0, 1):
            out += b"\xa3\x95\x40" + struct.pack("<QB6f", t, core, *angles, *(place + 9 * core))
    return out


def ulog_of_imu(imu: ul.Imu) -> bytes:
    """A log of PX4 with readings of an inertial unit, in forward-right-down."""

    def message(kind: bytes, data: bytes) -> bytes:
        return struct.pack("<Hc", len(data), kind) + data

    layout = b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"F", layout)
    out += message(b"A", struct.pack("<BH", 0, 0) + b"sensor_combined")
    for t, turn, force in zip(imu.t_ns // 1000, imu.angular_velocity @ FLIP, imu.specific_force @ FLIP, strict=True):
        out += message(b"D", struct.pack("<HQ6f", 0, t, *turn, *force))
    return out


def dataflash_of_imu(imu: ul.Imu) -> bytes:
    """A log of ArduPilot with readings of two inertial units; those of the second are wrong."""

    def described(kind: int, size: int, name: bytes, form: bytes, columns: bytes) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, name, form, columns)

    out = described(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    out += described(65, 3 + 8 + 1 + 6 * 4, b"IMU", b"QBffffff", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for t, turn, force in zip(imu.t_ns // 1000, imu.angular_velocity @ FLIP, imu.specific_force @ FLIP, strict=True):
        for unit in (0, 1):
            out += b"\xa3\x95\x41" + struct.pack("<QB6f", t, unit, *(turn + unit), *force)
    return out


def nmea(track: ul.Trajectory, *, start_s: int = 86_395) -> str:
    """Fixes of a receiver without attitude, by default past midnight."""
    return "".join(sentence(start_s + t, p) for t, p in zip(track.t_ns * 1e-9, track.position, strict=True))


def sentence(t_s: float, position: np.ndarray) -> str:
    """One GGA sentence of a place east, north and up of PLACE."""
    t_s %= 86_400
    at = PLACE.moved(SWAP @ position)
    lat, lon = abs(np.degrees([at.lat_rad, at.lon_rad]))
    clock = f"{int(t_s // 3600):02d}{int(t_s % 3600 // 60):02d}{t_s % 60:05.2f}"
    degrees = f"{int(lat):02d}{lat % 1 * 60:010.7f},S,{int(lon):03d}{lon % 1 * 60:010.7f},W"
    body = f"GPGGA,{clock},{degrees},4,12,0.7,{at.height_m - 31.5:.3f},M,31.5,M,,"
    return f"${body}*{reduce(operator.xor, body.encode(), 0):02X}\r\n"


def ubx(track: ul.Trajectory, *, kinds: str = "HPPOSLLH PVT POSLLH", start_ms: int = 604_795_000) -> bytes:
    """Fixes of a u-blox receiver, by default past the end of the week; NAV-PVT is 1 m high and NAV-POSLLH 2 m."""
    out = b""
    for t_ns, position in zip(track.t_ns, track.position, strict=True):
        tow = (start_ms + int(t_ns) // 1_000_000) % 604_800_000
        for high, kind in enumerate(("HPPOSLLH", "PVT", "POSLLH")):
            at = PLACE.moved(SWAP @ (position + np.array([0, 0, high])))
            tenths = [round(value) for value in (*np.degrees([at.lon_rad, at.lat_rad]) * 1e9, at.height_m * 1e4)]
            whole = [round(value / scale) for value, scale in zip(tenths, (100, 100, 10), strict=True)]
            fine = [value - one * scale for value, one, scale in zip(tenths, whole, (100, 100, 10), strict=True)]
            if kind in kinds.split():
                out += ubx_message(kind, tow, (*whole, whole[2] - 31_500), (*fine, 0))
    return out


def ubx_message(kind: str, tow: int, place: tuple[int, ...], fine: tuple[int, ...], *, fixed: bool = True) -> bytes:
    """One message of a place: longitude, latitude, height and that over the sea, and what they lack."""
    accuracy = 14 if fixed else 2**32 - 1
    if kind == "HPPOSLLH":
        number = 0x14
        payload = struct.pack("<4BI4i4b2I", 0, 0, 0, not fixed, tow, *place, *fine, accuracy * fixed, 20)
    elif kind == "PVT":
        number, utc = 0x07, struct.pack("<H6BIi", 2026, 11, 29, 0, 0, 0, 7, 20, 0)
        payload = struct.pack("<I16sBBBB4iII", tow, utc, 3, fixed, 0, 12, *place, accuracy * fixed, 20) + bytes(44)
    else:
        number, payload = 0x02, struct.pack("<I4i2I", tow, *place, accuracy, 20)
    body, first, second = struct.pack("<BBH", 1, number, len(payload)) + payload, 0, 0
    for byte in body:
        first = (first + byte) % 256
        second = (second + first) % 256
    return b"\xb5\x62" + body + bytes([first, second])
