"""Tracks and inertial units in vehicles' own logs: PX4's `.ulg`, ArduPilot's `.bin`, fixes of satellite receivers.

Autopilots write north-east-down and forward-right-down; here tracks are ENU and FLU. Fixes become east, north and up of
a datum; where a log has no attitude, it is that of the world [ULog] [NMEA0183] [UBXF9].
"""

from __future__ import annotations

import operator
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.data import Imu, Trajectory
from ullage.errors import InputError, NotRecorded, need
from ullage.geometry import GRAVITY_M_S2, rpy_quat
from ullage.ports.intake import warn
from ullage.ports.ned import FLIP, SWAP, Geodetic, datum_of, enu_quat
from ullage.untrusted import reading

Pose = tuple[int, ArrayLike, ArrayLike]
"""Time [ns], position (3) [m], quaternion xyzw (4)."""

Fix = tuple[int, float, float, float]
"""Time [ns], latitude and longitude [deg], height over the ellipsoid [m]."""

MOST_M, MOST_NS = 1e6, 9_000_000_000_000_000_000
ESTIMATES = ("XKF1", "NKF1")
"""Messages of ArduPilot's filters that hold place and attitude: those of EKF3, then EKF2."""
LAYOUT = re.compile(rb"\xa3\x95\x80(.)(.)", re.DOTALL)
"""The start of a record of ArduPilot that says how long a kind of record is: that kind, its bytes with their header."""
DAY_NS = 86_400_000_000_000
_PLACE: Any = [("place", "<i4", 3), ("sea", "<i4")]
UBX = {
    b"\xb5\x62\x01\x14\x24\x00": np.dtype([  # NAV-HPPOSLLH
        ("head", "V6"), ("version", "V3"), ("invalid", "u1"), ("tow", "<u4"), *_PLACE, ("fine", "i1", 4),
        ("accuracy", "<u4"), ("vertical", "<u4"), ("sums", "u1", 2),
    ]),
    b"\xb5\x62\x01\x07\x5c\x00": np.dtype([  # NAV-PVT
        ("head", "V6"), ("tow", "<u4"), ("utc", "V17"), ("fixed", "u1"), ("more", "V2"), *_PLACE,
        ("accuracy", "<u4"), ("rest", "V48"), ("sums", "u1", 2),
    ]),
    b"\xb5\x62\x01\x02\x1c\x00": np.dtype([  # NAV-POSLLH
        ("head", "V6"), ("tow", "<u4"), *_PLACE, ("accuracy", "<u4"), ("vertical", "<u4"), ("sums", "u1", 2),
    ]),
}  # fmt: skip
"""Messages with fixes, the finest first: GPS time of week [ms]; longitude, latitude [1e-7 deg] and height [mm]; what
these lack [1e-9 deg, 0.1 mm]. Without a fix, bit 0 of `invalid` is set or that of `fixed` is not [UBXF9, UBX-NAV]."""


def track_of_poses(rows: Iterable[Pose], path: Path) -> Trajectory:
    """Return the track of poses in order of time; those that cannot be used are left out, with a warning.

    Raises:
        InputError: none can be used.
    """
    listed = list(rows)
    times = np.array([row[0] for row in listed], np.int64)
    table = np.array([np.concatenate([row[1], row[2]]) for row in listed], float).reshape(-1, 7)
    norm = np.linalg.norm(table[:, 3:], axis=1)
    good = np.isfinite(table).all(1) & (abs(norm - 1) < 0.01) & (abs(table[:, :3]) < MOST_M).all(1)
    if not good.any():
        allowed = "places within 1000 km of the origin, unit quaternions"
        raise InputError(f"none of {len(listed)} poses can be used", where=path, allowed=allowed)
    if not good.all():
        text = f"{path}: {int((~good).sum())} of {len(listed)} poses are no poses, first pose {int(np.argmin(good))}"
        warn(f"{text}; left out")
    t_ns, first = np.unique(times[good], return_index=True)
    kept = table[good][first]
    return Trajectory(t_ns, kept[:, :3], kept[:, 3:] / norm[good][first][:, None])


def track_of_fixes(rows: Iterable[Fix], datum: str, path: Path) -> Trajectory:
    """Return the track of fixes: east, north, up of a datum, without attitude.

    Args:
        rows: the fixes.
        datum: `latitude,longitude[,height]`; empty: the first fix, with a warning.
        path: for messages.

    Raises:
        InputError: the datum is none, or there are no fixes.
    """
    found = [row for row in rows if np.isfinite(row[1:]).all()]
    fixes = [row for row in found if abs(row[1]) <= 90 and abs(row[2]) <= 180 and abs(row[3]) < MOST_M]
    if len(fixes) < len(found):
        warn(f"{path}: {len(found) - len(fixes)} of {len(found)} fixes are nowhere on earth; left out")
    if not fixes:
        raise InputError("no fix in it", where=path, allowed="fixes of a satellite receiver")
    times, *place = (np.array(column) for column in zip(*fixes, strict=True))
    origin = datum_of(datum) if datum else Geodetic.degrees(*(float(column[0]) for column in place))
    if not datum:
        text = f"{path}: east, north and up of its first fix, {place[0][0]:.7f},{place[1][0]:.7f},{place[2][0]:.2f}"
        warn(f"{text} (say datum=)")
    level = np.array([0.0, 0.0, 0.0, 1.0])
    return track_of_poses([(int(t), at, level) for t, at in zip(times, origin.local(*place), strict=True)], path)


def read_ulog(path: Path) -> Trajectory:
    """Read the track in a log of PX4: vehicle_local_position with the attitude of vehicle_attitude.

    Raises:
        InputError: it is no such log, or one of both is missing.
        MissingExtra: pyulog is not installed.
    """
    with reading(path):
        place, turn = _ulog(path, ["vehicle_local_position", "vehicle_attitude"])
        ned = np.stack([place["x"], place["y"], place["z"]], axis=1)
        quat = np.stack([turn[f"q[{k}]"] for k in (1, 2, 3, 0)], axis=1)
        times, turns = (np.asarray(one["timestamp"], np.int64) * 1000 for one in (place, turn))
        level = track_of_poses(zip(turns, np.zeros((len(quat), 3)), quat, strict=True), path)
        held = np.clip(times, level.t_ns[0], level.t_ns[-1])
        return _enu(times, ned, level.at(held).quat_xyzw, path)


def _ulog(path: Path, names: list[str]) -> list[dict[str, Any]]:
    """Columns of messages of a log of PX4, by name."""
    library: Any = need("pyulog", extra="logs")
    found = {one.name: one.data for one in library.ULog(str(path), names).data_list if one.multi_id == 0}
    if missing := [name for name in names if name not in found]:
        raise NotRecorded(f"no {' and no '.join(missing)}", where=path, allowed="a log of a flight by PX4")
    return [found[name] for name in names]


def read_dataflash(path: Path) -> Trajectory:
    """Read the track in a log of ArduPilot: what the filter of its first core estimated.

    Raises:
        InputError: it is no such log, or holds no estimates.
        MissingExtra: pymavlink is not installed.
    """
    rows: dict[str, list[list[float]]] = {name: [] for name in ESTIMATES}
    with reading(path):
        for message in _dataflash(path, ESTIMATES):
            if getattr(message, "C", 0) in (0, 100):
                angles = np.radians([message.Roll, message.Pitch, message.Yaw])
                rows[message.get_type()].append([message.TimeUS, message.PN, message.PE, message.PD, *angles])
        table = np.array(next((found for found in rows.values() if found), [])).reshape(-1, 7)
        if not len(table):
            raise InputError(f"no {' or '.join(ESTIMATES)}", where=path, allowed="a log of a flight by ArduPilot")
        table = table[np.isfinite(table).all(1) & (table[:, 0] < MOST_NS / 1000)]
        return _enu(np.rint(table[:, 0] * 1000).astype(np.int64), table[:, 1:4], rpy_quat(*table[:, 4:].T), path)


def _dataflash(path: Path, kinds: Sequence[str]) -> Iterator[Any]:
    """Messages of these kinds in a log of ArduPilot."""
    library: Any = need("pymavlink.DFReader", extra="mavlink")
    for kind, size in LAYOUT.findall(path.read_bytes()):
        if size[0] < 3:  # the library would read the same bytes for ever
            raise InputError(f"records of kind {kind[0]} of {size[0]} bytes", where=path, allowed="3 bytes or more")
    log = library.DFReader_binary(str(path))
    try:
        while (message := log.recv_match(type=list(kinds))) is not None:
            yield message
    finally:
        log.close()


def imu_of_ulog(path: Path) -> Imu:
    """Read the inertial unit in a log of PX4: sensor_combined.

    Raises:
        InputError: it is no such log, or holds no readings.
        MissingExtra: pyulog is not installed.
    """
    with reading(path):
        (found,) = _ulog(path, ["sensor_combined"])
        columns = [found[f"{name}[{k}]"] for name in ("gyro_rad", "accelerometer_m_s2") for k in range(3)]
        return imu_of_rows(np.asarray(found["timestamp"], np.int64) * 1000, _flu(np.stack(columns, axis=1)), path)


def imu_of_dataflash(path: Path) -> Imu:
    """Read the first inertial unit in a log of ArduPilot: IMU.

    Raises:
        InputError: it is no such log, or holds no readings.
        MissingExtra: pymavlink is not installed.
    """
    names = "TimeUS", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"
    with reading(path):
        rows = [[getattr(one, name) for name in names] for one in _dataflash(path, ["IMU"]) if not getattr(one, "I", 0)]
        table = np.array(rows, float).reshape(-1, 7)
        table = table[np.isfinite(table).all(1) & (table[:, 0] < MOST_NS / 1000)]
        return imu_of_rows(np.rint(table[:, 0] * 1000).astype(np.int64), _flu(table[:, 1:]), path)


def _flu(readings: Floats) -> Floats:
    """Turn rates and specific forces (n, 6) from forward-right-down."""
    return np.hstack([readings[:, :3] @ FLIP.T, readings[:, 3:] @ FLIP.T])


def imu_of_rows(t_ns: Any, readings: Floats, path: Path) -> Imu:
    """Return readings in order of time; those that are no numbers are left out, with a warning.

    Args:
        t_ns: times (n) [ns].
        readings: turn rates [rad/s] and specific forces [m/s2] of the body (n, 6), FLU.
        path: for messages.

    Raises:
        NotRecorded: fewer than two can be used.
        InputError: the specific forces are not in m/s2, or lack gravity.
    """
    good = np.asarray(np.isfinite(readings).all(1))
    times, first = np.unique(np.asarray(t_ns, np.int64)[good], return_index=True)
    if len(times) < 2:
        raise NotRecorded(f"{len(times)} readings of an inertial unit in it", where=path, allowed="two or more")
    if not good.all():
        warn(f"{path}: {int((~good).sum())} of {len(good)} readings of the inertial unit are no numbers; left out")
    kept = readings[good][first]
    usual = float(np.median(np.linalg.norm(kept[:, 3:], axis=1)))
    if not GRAVITY_M_S2 / 2 < usual < GRAVITY_M_S2 * 2:  # g, ft/s2 and forces without gravity are further away
        raise InputError(f"a specific force of {usual:.3g} m/s2 in the median", where=path,
                         allowed=f"m/s2 with gravity, within a factor of 2 of {GRAVITY_M_S2}")  # fmt: skip
    return Imu(times, kept[:, :3], kept[:, 3:])


def _enu(t_ns: Any, ned: Floats, quat: Floats, path: Path) -> Trajectory:
    """The track (n) of places north, east, down and attitudes from forward-right-down."""
    return track_of_poses(zip(t_ns, ned @ SWAP.T, enu_quat(quat), strict=True), path)


def read_nmea(path: Path, *, datum: str = "") -> Trajectory:
    """Read the fixes in the GGA sentences of an NMEA log, with the height over the ellipsoid.

    Args:
        path: the log.
        datum: origin, `latitude,longitude[,height]`; none: the first fix, with a warning.

    Raises:
        InputError: no sentence holds a fix, or the datum is none.
    """
    with reading(path):
        text = path.read_text("ascii", errors="replace")
    rows: list[tuple[Any, ...]] = []
    bad, day = 0, 0
    for line in text.splitlines():
        if "GGA," not in line[:8]:
            continue
        fix = _fix(line.strip())
        bad += fix is None
        if fix is None or not fix:
            continue
        if rows and fix[0] + day < rows[-1][0] - DAY_NS // 2:
            day += DAY_NS
        rows.append((fix[0] + day, *fix[1:]))
    if bad:
        warn(f"{path}: {bad} GGA sentences cannot be read; left out")
    return track_of_fixes(rows, datum, path)


def _fix(line: str) -> Fix | tuple[()] | None:
    """The fix in one GGA sentence: empty if the receiver had none, None if the sentence is damaged."""
    body, _, checksum = line.lstrip("$").partition("*")
    cells = body.split(",")
    try:
        if checksum and reduce(operator.xor, body.encode(), 0) != int(checksum[:2], 16):
            return None
        if cells[6] in ("0", ""):
            return ()
        clock = cells[1]
        t_ns = (int(clock[:2]) * 3600 + int(clock[2:4]) * 60) * 1_000_000_000 + round(float(clock[4:]) * 1e9)
        lat, lon = (float(text[:size]) + float(text[size:]) / 60 for text, size in ((cells[2], 2), (cells[4], 3)))
        height = float(cells[9]) + float(cells[11] or 0)
    except (ValueError, IndexError, OverflowError):  # infinite seconds have no nanoseconds
        return None
    values = (lat * (-1 if cells[3] == "S" else 1), lon * (-1 if cells[5] == "W" else 1), height)
    return (t_ns, *values) if 0 <= t_ns < DAY_NS else None


def read_ubx(path: Path, *, datum: str = "") -> Trajectory:
    """Read the fixes in a binary log of a u-blox receiver, from the finest kind of message that has one.

    Messages are found by their heads, so that bytes between them do no harm. Times are those of the GPS week.

    Args:
        path: the log.
        datum: origin, `latitude,longitude[,height]`; none: the first fix, with a warning.

    Raises:
        InputError: no message holds a fix, or the datum is none.
    """
    with reading(path):
        raw = path.read_bytes()
    rows: list[Fix] = []
    damaged = 0
    for head, layout in UBX.items():
        cells = [raw[one.start() : one.start() + layout.itemsize] for one in re.finditer(re.escape(head), raw)]
        whole = [cell for cell in cells if len(cell) == layout.itemsize and _sums(cell[2:-2]) == cell[-2:]]
        damaged += len(cells) - len(whole)
        rows = rows or _ubx_fixes(np.frombuffer(b"".join(whole), layout))
    if damaged:
        warn(f"{path}: {damaged} messages are damaged; left out")
    return track_of_fixes(rows, datum, path)


def _sums(body: bytes) -> bytes:
    """Fletcher's checksum of 8 bits [UBXF9, UBX checksum]."""
    values = np.frombuffer(body, np.uint8).astype(int)
    return bytes([values.sum() % 256, values.cumsum().sum() % 256])


def _ubx_fixes(rows: Any) -> list[Fix]:
    names = rows.dtype.names
    good = rows["accuracy"] < 2**32 - 1
    for name, sign in (("invalid", 0), ("fixed", 1)):
        good &= (rows[name] & 1 == sign) if name in names else True
    rows = rows[good]
    place = rows["place"] * [1e-7, 1e-7, 1e-3]
    if "fine" in names:
        place += rows["fine"][:, :3] * [1e-9, 1e-9, 1e-4]
    t_ns = rows["tow"].astype(np.int64) * 1_000_000
    t_ns[1:] += 7 * DAY_NS * (np.diff(t_ns) < -7 * DAY_NS // 2).cumsum()
    return [(int(t), lat, lon, height) for t, (lon, lat, height) in zip(t_ns, place.tolist(), strict=True)]
