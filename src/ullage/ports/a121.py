"""Acconeer A121 recordings, `.h5` as the exploration tool writes them [AcconeerET].

Each subsweep of each sensor is a radar of its own, since range step and pulse differ: `sensor1`, or `sensor1_2` for the
second of several. Each sweep is a frame: the first at the tick of its frame, the others at the sweep rate. The tool
takes rising phase for rising distance; here it falls (-4 pi range / wavelength), so samples are conjugated.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Longs
from ullage.data import Frames
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.ports.containers import array_in, open_hdf5
from ullage.ports.intake import warn
from ullage.ports.protocol import mend_clock
from ullage.specs import MountSpec, RadarSpec
from ullage.untrusted import reading

CENTER_HZ, DECIMATION, LEAST_BINS = 60.5e9, 8, 8
WIDTH_M = {"PROFILE_1": 0.04, "PROFILE_2": 0.07, "PROFILE_3": 0.14, "PROFILE_4": 0.19, "PROFILE_5": 0.32}
"""Full width at half maximum of the envelope over range, for each profile [m] [AcconeerET]."""
BAND = 0.569
"""-10 dB bandwidth of a Gaussian pulse, times its width over range, over the speed of light."""
MOST_BYTES = 2_000_000_000
SESSIONS = {"session", "sessions"}
"""Groups of an HDF5 file, one of which the exploration tool makes."""


def read_sessions(path: Path, *, mount: MountSpec | None = None) -> dict[str, Frames]:
    """Read the first session of a recording, by the names of its radars.

    Raises:
        InputError: it is no such recording, is damaged, or has no subsweep of 8 points or more.
        MissingExtra: h5py is not installed.
    """
    out: dict[str, Frames] = {}
    with reading(path), open_hdf5(path) as file:
        session = "sessions/session_0" if "sessions" in file else "session"
        config = _tree(file, f"{session}/session_config")
        ticks_hz = float(_tree(file, "server_info")["ticks_per_second"])
        for group, sensors in enumerate(config["groups"]):
            for entry, (number, sensor) in enumerate(sorted(sensors.items(), key=lambda item: int(item[0]))):
                name = f"sensor{int(number)}" + f"_group{group}" * (group > 0)
                place = f"{session}/group_{group}/entry_{entry}"
                out |= _Entry(file, place, sensor, ticks_hz, path).frames(name, mount)
    if not out:
        what = f"no subsweep of {LEAST_BINS} points or more"
        raise InputError(what, where=path, allowed="an A121 recording of range profiles")
    return out


def subsweep_fields(one: Mapping[str, Any], base_m: float) -> dict[str, Any]:
    """Return the fields of a RadarSpec that a subsweep settles.

    Args:
        one: start point, step length, profile and hwaas, as the exploration tool names them.
        base_m: range of one step [m].
    """
    return {
        "name": "a121", "center_hz": CENTER_HZ, "bandwidth_hz": BAND * C0 / WIDTH_M[one["profile"]],
        "decimation": DECIMATION, "sampling_hz": DECIMATION * C0 / (2 * base_m * int(one["step_length"])),
        "range_start_m": base_m * int(one["start_point"]), "iterations": 1, "pulses_per_step": int(one["hwaas"]),
    }  # fmt: skip


def _tree(file: Any, name: str) -> Any:
    """The values of a JSON text in the file."""
    return json.loads(bytes(array_in(file, name, most_bytes=1_000_000)[()]))


class _Entry:
    """One sensor of a session."""

    def __init__(self, file: Any, place: str, sensor: dict[str, Any], ticks_hz: float, path: Path) -> None:
        self._about = _tree(file, f"{place}/metadata")
        frame = array_in(file, f"{place}/result/frame", most_bytes=MOST_BYTES)
        if frame.ndim != 3 or not frame.size or not np.iscomplexobj(frame):
            raise InputError(f"frames of shape {frame.shape}", where=path, allowed="(n, sweeps, points) complex")
        tick = array_in(file, f"{place}/result/tick", most_bytes=MOST_BYTES)
        self._sensor, self._path = sensor, path
        self._samples = frame.conj().reshape(-1, frame.shape[2]).astype(np.complex64)
        self._t_ns = mend_clock(self._times(tick, frame.shape[1], ticks_hz), where=path)
        saturated = int(array_in(file, f"{place}/result/data_saturated", most_bytes=MOST_BYTES).sum())
        if saturated:
            warn(f"{path}: {saturated} of {len(frame)} frames are saturated; their strongest echoes are cut off")

    def _times(self, tick: NDArray[Any], sweeps: int, ticks_hz: float) -> Longs:
        start_s = (tick - tick[0]) / ticks_hz
        rate_hz = float(self._sensor.get("sweep_rate") or self._about["max_sweep_rate"])
        times = start_s[:, None] + np.arange(sweeps) / rate_hz
        return np.asarray(np.rint(times.ravel() * 1e9), np.int64)

    def frames(self, name: str, mount: MountSpec | None) -> dict[str, Frames]:
        """Frames of each subsweep with enough points."""
        out, short = {}, 0
        for number, (which, spec) in enumerate(self._subsweeps(mount), 1):
            if spec is None:
                short += 1
                continue
            one = name if len(self._sensor["subsweeps"]) == 1 else f"{name}_{number}"
            samples = np.ascontiguousarray(self._samples[:, which])
            out[one] = Frames(samples, spec.range_m, self._t_ns, spec, sensor=one, unit="normalised")
        if short and out:
            warn(f"{self._path}: {short} subsweeps of {name} have fewer than {LEAST_BINS} points; left out")
        return out

    def _subsweeps(self, mount: MountSpec | None) -> Iterator[tuple[slice, RadarSpec | None]]:
        base_m = float(self._about["base_step_length_m"])
        step = np.diff(self._t_ns)
        fps = 1e9 / float(np.median(step)) if len(step) else 10.0
        shapes = zip(self._about["subsweep_data_offset"], self._about["subsweep_data_length"], strict=True)
        for (start, count), one in zip(shapes, self._sensor["subsweeps"], strict=True):
            which = slice(int(start), int(start) + int(count))
            if len(self._samples[0, which]) != int(count):
                raise InputError(f"a subsweep of {count} points from {start}", where=self._path, allowed="those it has")
            if count < LEAST_BINS:
                yield which, None
                continue
            spec = RadarSpec(own_echo_m=0.0, **subsweep_fields(one, base_m), bins=int(count), fps=fps)
            yield which, spec.but(mount=mount) if mount else spec
