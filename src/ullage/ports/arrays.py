"""Recordings of any radar as plain arrays: `.npz` files as `numpy.savez` writes them, MATLAB's `.mat`, HDF5's `.h5`.

- `samples` (n, b): complex baseband, or real RF samples.
- `times_s` or `times_ns` (n): time of each frame [s] or [ns].
- `ranges_m` (b): range of each bin, evenly spaced [m].
- `center_hz`, `bandwidth_hz`, optional: carrier and -10 dB bandwidth [Hz].
- `positions_m` (n, 3), `quaternions_xyzw` (n, 4), optional: world_from_body of each frame, on the same clock.
- `track_times_s` or `track_times_ns` (m), `track_positions_m` (m, 3), `track_quaternions_xyzw` (m, 4), optional:
  world_from_body on a clock of its own. `ul.calibrate` finds the offset.

Positions are z up. Without quaternions the attitude is that of the world. Baseband phase is -4 pi range / wavelength.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs
from ullage.checks import is_in_nanoseconds
from ullage.data import UNEVEN, Trajectory
from ullage.errors import InputError
from ullage.ports import containers
from ullage.ports.intake import warn
from ullage.ports.protocol import mend_clock, warn_of_saturation
from ullage.ports.tracks import good_poses
from ullage.specs import RadarSpec
from ullage.untrusted import check_unpacked

KEYS = ("samples", "times_s", "times_ns", "ranges_m", "center_hz", "bandwidth_hz", "positions_m", "quaternions_xyzw",
        "track_times_s", "track_times_ns", "track_positions_m", "track_quaternions_xyzw")  # fmt: skip
WANTED = "samples (n, b), times_s or times_ns (n), ranges_m (b)"
PICKLE = "a Python pickle: not opened, because it can run code"
CONVERT = "plain arrays: convert it with numpy.savez in a program that trusts the file; docs/recordings.md"
PICKLES = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
LIKE = "x4m05"
"""Preset whose carrier and bandwidth are assumed for complex samples."""
OTHERS = (*containers.MATLAB, *containers.HDF5)
BAND = ("center_hz", "bandwidth_hz")
MOST_S, MOST_M, MOST_BYTES = 9e9, 1e6, 4_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Arrays:
    """A recording read from plain arrays."""

    samples: NDArray[Any]  # (n, b) complex64 or float32
    range_m: Floats  # (b) [m]
    t_ns: Longs  # (n)
    spec: RadarSpec
    poses: Trajectory | None  # world_from_body at t_ns
    track: Trajectory | None  # world_from_body on its own clock


def refuse_pickle(path: Path) -> None:
    """Refuse a file that starts as a Python pickle does.

    Raises:
        InputError: it is one.
    """
    with path.open("rb") as file:
        start = file.read(2)
    if start in PICKLES:
        raise InputError(PICKLE, where=path, allowed=CONVERT)


def load(path: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Read those of the named arrays that the file holds; no pickled object is opened.

    Raises:
        InputError: it is no `.npz` file, is damaged, holds a pickle, or unpacks to more than 4 GB or 200 times itself.
    """
    if path.suffix.lower() in OTHERS:
        return containers.load(path, names, most_bytes=MOST_BYTES)
    try:
        refuse_pickle(path)
        with zipfile.ZipFile(path) as packed:
            members = packed.infolist()
        for one in members:
            check_unpacked(one.file_size, one.compress_size, what=one.filename, where=path)
        if (size := sum(one.file_size for one in members)) > MOST_BYTES:
            raise InputError(f"unpacks to {size} bytes", where=path, allowed=f"at most {MOST_BYTES}")
        with np.load(path, allow_pickle=False) as stored:
            return {name: np.asarray(stored[name]) for name in names if name in stored}
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=path, allowed="an .npz file") from None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        if "allow_pickle" in str(error):
            raise InputError(f"an array in it is {PICKLE}", where=path, allowed=CONVERT) from None
        raise InputError(f"cannot be read: {error}", where=path, allowed="plain arrays in an .npz file") from None


def names_in(path: Path) -> frozenset[str]:
    """Names of the arrays in a file; none where it is no such file."""
    if path.suffix.lower() in OTHERS:
        return containers.names_in(path)
    try:
        with zipfile.ZipFile(path) as packed:
            return frozenset(name.removesuffix(".npy") for name in packed.namelist())
    except (OSError, ValueError, zipfile.BadZipFile):
        return frozenset()


def read_npz(path: str | Path, *, preset: str | None = None) -> Arrays:
    """Read a recording with the keys that this module documents.

    Args:
        path: the `.npz` file.
        preset: name of the radar's preset, or its YAML file. None: the file says carrier and bandwidth. Otherwise
            those of the X4M05 are assumed for complex samples, with a warning.

    Raises:
        InputError: a key is missing, shapes and values do not fit together, or samples are real and of no known radar.
    """
    path = Path(path)
    entries = load(path, KEYS)
    if missing := [name for name in ("samples", "ranges_m") if name not in entries]:
        raise InputError(f"no {', '.join(missing)}", where=path, allowed=WANTED)
    t_ns = _times(entries, "", path)
    samples, range_m = _profiles(entries, len(t_ns), path)
    spec = _spec(samples, range_m, t_ns, *_band(entries, preset, path), path)
    t_ns = mend_clock(t_ns, where=path)
    warn_of_saturation(samples, path)
    poses = _poses(entries, "", t_ns, path)
    track = None
    if "track_positions_m" in entries:
        track = _poses(entries, "track_", mend_clock(_times(entries, "track_", path), where=path), path)
    if poses is not None and track is not None:
        raise InputError("both positions_m and track_positions_m", where=path, allowed="one of them")
    return Arrays(samples, range_m, t_ns, spec, poses, track)


def _times(entries: dict[str, NDArray[Any]], prefix: str, path: Path) -> Longs:
    """Longs under `times_s` or `times_ns`, as they stand in the file."""
    either = [f"{prefix}times_s", f"{prefix}times_ns"]
    names = [name for name in either if name in entries]
    if len(names) != 1:
        what = f"both {' and '.join(either)}" if names else f"no {' or '.join(either)}"
        raise InputError(what, where=path, allowed=f"one of {', '.join(either)}" if prefix else WANTED)
    value, nanoseconds = entries[names[0]], names[0].endswith("_ns")
    if value.ndim != 1 or not value.size or value.dtype.kind not in "iuf" or not np.isfinite(value).all():
        raise InputError(f"{names[0]} is {_kind(value)}", where=path, allowed="a row of finite numbers")
    nanoseconds = nanoseconds or is_in_nanoseconds(value.astype(float), path)
    if float(np.abs(value.astype(float)).max()) > MOST_S * (1e9 if nanoseconds else 1):
        raise InputError(f"{names[0]} is absurd", where=path, allowed=f"within {MOST_S:g} s of zero")
    if nanoseconds and value.dtype.kind in "iu":
        return value.astype(np.int64)
    return np.rint(value.astype(float) * (1 if nanoseconds else 1e9)).astype(np.int64)


def _profiles(entries: dict[str, NDArray[Any]], rows: int, path: Path) -> tuple[NDArray[Any], Floats]:
    """Samples and the range axis, checked against each other and the number of times."""
    samples, range_m = entries["samples"], entries["ranges_m"]
    if samples.ndim != 2 or samples.dtype.kind not in "iufc" or samples.shape != (rows, range_m.size):
        shapes = f"samples is {_kind(samples)}, with {rows} times and {range_m.size} ranges"
        raise InputError(shapes, where=path, allowed=WANTED)
    range_m = np.asarray(range_m.ravel(), float) if range_m.dtype.kind in "iuf" else np.full(range_m.size, np.nan)
    if range_m.size < 8 or not np.isfinite(range_m).all() or np.any(np.diff(range_m) <= 0):
        raise InputError("ranges_m does not rise", where=path, allowed="at least 8 rising, finite ranges [m]")
    step = np.diff(range_m)
    if abs(step / np.median(step) - 1).max() > UNEVEN:
        raise InputError("ranges_m is not evenly spaced", where=path, allowed="bins of one width")
    finite = np.isfinite(samples).all(axis=1)
    if not finite.all():
        raise InputError(f"samples of frame {int(np.argmin(finite))} are not finite", where=path, allowed="numbers")
    return samples.astype(np.complex64 if samples.dtype.kind == "c" else np.float32), range_m


def _band(entries: dict[str, NDArray[Any]], preset: str | None, path: Path) -> tuple[RadarSpec, dict[str, float]]:
    """The radar's preset, stated or assumed, and what the file says of its band."""
    stated: dict[str, float] = {key: _scalar(entries, key, path) for key in BAND if key in entries}
    if preset is not None:
        return RadarSpec.preset(preset), stated
    if len(stated) == 2:
        return RadarSpec(name="npz"), stated
    missing = " and ".join(name for name in BAND if name not in stated)
    if entries["samples"].dtype.kind != "c":
        raise InputError(f"real samples without {missing}: of which radar?", where=path,
                         allowed=f"these keys, or preset= one of {', '.join(RadarSpec.names())}")  # fmt: skip
    base = RadarSpec.preset(LIKE, range_zero_m=None)
    rest = " and ".join(f"{name} {getattr(base, name):g}" for name in BAND if name not in stated)
    warn(f"{path}: {rest} of the preset {base.name} assumed; the file does not say (give preset=)")
    return base, stated


def _scalar(entries: dict[str, NDArray[Any]], name: str, path: Path) -> float:
    value = entries[name]
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise InputError(f"{name} is {_kind(value)}", where=path, allowed="one number [Hz]")
    return float(value.ravel()[0])


def _spec(
    samples: NDArray[Any], range_m: Floats, t_ns: Longs, base: RadarSpec, stated: dict[str, float], path: Path
) -> RadarSpec:
    """The radar with the band, range axis and frame rate of the file."""
    try:
        return base.on_axis(range_m, t_ns, output="baseband" if np.iscomplexobj(samples) else "rf", **stated)
    except InputError as error:
        raise InputError(f"its values make no radar: {error}", where=path) from None


def _poses(entries: dict[str, NDArray[Any]], prefix: str, t_ns: Longs, path: Path) -> Trajectory | None:
    """Poses under `positions_m` and `quaternions_xyzw`, where there are any."""
    place, turn = f"{prefix}positions_m", f"{prefix}quaternions_xyzw"
    if place not in entries:
        if turn in entries:
            raise InputError(f"{turn} without {place}", where=path, allowed=place)
        return None
    position = entries[place]
    quat = entries.get(turn, np.tile([0.0, 0, 0, 1], (len(t_ns), 1)))
    for name, value, width in ((place, position, 3), (turn, quat, 4)):
        if value.shape != (len(t_ns), width) or value.dtype.kind not in "iuf":
            raise InputError(f"{name} is {_kind(value)}", where=path, allowed=f"({len(t_ns)}, {width}) numbers")
    if abs(position[np.isfinite(position)]).max(initial=0) > MOST_M:
        raise InputError(f"{place} is absurd", where=path, allowed=f"within {MOST_M:g} m of the origin")
    poses = good_poses(t_ns, position, quat, where=path)
    if prefix or len(poses) == len(t_ns):
        return poses
    if poses.t_ns[0] > t_ns[0] or poses.t_ns[-1] < t_ns[-1]:
        raise InputError("the first or last frame has no pose", where=path, allowed=f"finite {place}, unit {turn}")
    return poses.at(t_ns)  # a frame without a pose takes it from the poses around, as of a live port


def _kind(value: NDArray[Any]) -> str:
    finite = value.dtype.kind not in "fc" or bool(np.isfinite(value).all())
    return f"of shape {value.shape} and kind {value.dtype}" + ", not all finite" * (not finite)
