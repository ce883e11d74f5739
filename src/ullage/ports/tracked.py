"""Recordings of one radar with its track: a folder, or plain arrays with both."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.data import Frames, Trajectory
from ullage.errors import InputError, UllageWarning
from ullage.ports.arrays import Arrays, names_in, read_npz, refuse_pickle
from ullage.ports.motive import read_tracks
from ullage.ports.protocol import WholeSource
from ullage.ports.pulson import read_arrays, read_log
from ullage.ports.survey import Survey, read_survey
from ullage.ports.tracks import read_bodies
from ullage.specs import MountSpec

LOGS = ("radar.out", "radar.npz")
TRACKS = ("mocap.csv", "track.csv", "track.txt", "track.tum")
"""Names of the radar's track in a folder with radar.out or radar.npz."""


class RailSource(WholeSource):
    """Radar recording with the track of the radar and surveyed reflectors, if any.

    Args:
        frames: of the radar.
        path: of the body.
        reflectors: places of reflectors (r, 3), for comparison [m].
        survey: reflectors that may settle clock and range, from `reflectors.csv`; None: there is no such file.
        floor_z_m: height of the floor, where the track's kind says it [m].
    """

    def __init__(
        self, frames: Frames, *, path: Trajectory, reflectors: Floats, survey: Survey | None = None,
        floor_z_m: float | None = None,
    ) -> None:  # fmt: skip
        super().__init__({frames.sensor: frames}, path=path)
        self._reflectors = reflectors
        self.survey, self.floor_z_m = survey, floor_z_m

    def reflectors(self) -> Floats:
        """True places of the reflectors (r, 3), world ENU [m]: those of `reflectors.csv`, else Motive's."""
        return self._reflectors if self.survey is None else self.survey.places


def open_arrays(path: Path, *, preset: str | None = None, mount: MountSpec | None = None) -> WholeSource:
    """Open an `.npz` file: a PulsON log as arrays by its keys, else the documented keys of any radar.

    Args:
        path: the file.
        preset: of the radar, where the file does not say carrier and bandwidth.
        mount: of the radar on the body whose poses the file holds.

    Raises:
        InputError: as `read_npz` and `read_arrays`.
    """
    arrays = _arrays(path, preset)
    frames = _frames(arrays, arrays.track, mount, path)
    return WholeSource({frames.sensor: frames}, path=arrays.track or arrays.poses)


def open_tracked(folder: Path, *, preset: str | None = None, mount: MountSpec | None = None) -> RailSource:
    """Open a folder with radar.out or radar.npz and a track, as if both clocks had started together.

    `calibrate` finds the offsets.

    Args:
        folder: holds one radar recording and one track.
        preset: of the radar, where radar.npz does not say carrier and bandwidth.
        mount: of the radar on the body that the track follows.

    Raises:
        InputError: a file is missing or cannot be read, or there are two recordings or two tracks.
    """
    both = [name for name in LOGS if (folder / name).exists()]
    if len(both) > 1:
        raise InputError("two radar recordings", where=folder, allowed="radar.out or radar.npz, not both")
    arrays = _log(folder / "radar.out") if both == ["radar.out"] else _arrays(folder / "radar.npz", preset)
    there = [name for name in TRACKS if (folder / name).exists()]
    inside = arrays.track or arrays.poses
    if inside is not None:
        there.append("radar.npz")
    if len(there) > 1:
        raise InputError(f"two tracks, {' and '.join(there)}", where=folder, allowed="one of " + ", ".join(TRACKS))
    survey = read_survey(folder / "reflectors.csv") if (folder / "reflectors.csv").exists() else None
    tracks = {"radar": inside} if inside is not None else read_bodies(folder / (there[0] if there else TRACKS[0]))
    name = _radar_body(tracks)
    frames = _frames(arrays, arrays.track if arrays.poses is not None else tracks[name], mount, folder)
    marks = read_tracks(folder / "reflector.csv") if (folder / "reflector.csv").exists() else {}
    points = [np.median(track.position, axis=0) for key, track in marks.items() if key != name]
    floor_z_m = 0.0 if there == ["mocap.csv"] else None  # Motive's ground plane is set on the floor
    return RailSource(
        frames, path=tracks[name], reflectors=np.array(points).reshape(-1, 3), survey=survey, floor_z_m=floor_z_m
    )


def _log(path: Path) -> Arrays:
    log = read_log(path)
    return Arrays(log.scans.astype(np.float32), log.range_m, log.t_ns, log.spec, None, None)


def _arrays(path: Path, preset: str | None) -> Arrays:
    """The arrays of a file by either set of keys."""
    refuse_pickle(path)
    if "scans" not in names_in(path):
        return read_npz(path, preset=preset)
    log = read_arrays(path)
    return Arrays(log.scans.astype(np.float32), log.range_m, log.t_ns, log.spec, None, None)


def _frames(arrays: Arrays, track: Trajectory | None, mount: MountSpec | None, where: Path) -> Frames:
    """Frames with the poses of the arrays, or with a track of another clock, as if both clocks had started together."""
    spec = arrays.spec.but(mount=mount) if mount else arrays.spec
    name, turn = "pulson" if spec.name == "pulson440" else "radar", spec.mount.body_from_sensor()
    t_ns, poses, sensor = arrays.t_ns, None, None
    if track is not None:
        t_ns, sensor = t_ns - t_ns[0] + track.t_ns[0], track.mounted(turn)
        poses = _held(sensor, t_ns, where)
    elif arrays.poses is not None:
        poses = arrays.poses.mounted(turn)
    return Frames(arrays.samples, arrays.range_m, t_ns, spec, poses, sensor=name, unit="normalised", track=sensor)


def _held(track: Trajectory, t_ns: Longs, where: Path) -> Trajectory:
    """The track at these times, standing still before its start and after its end."""
    inside, row = np.unique(np.clip(t_ns, track.t_ns[0], track.t_ns[-1]), return_inverse=True)
    if outside := int(((t_ns < track.t_ns[0]) | (t_ns > track.t_ns[-1])).sum()):
        warnings.warn(
            f"{where}: {outside} of {len(t_ns)} scans lie outside the motion capture; its ends were held",
            UllageWarning,
            stacklevel=5,
        )
    known = track.at(inside)
    velocity, spin = known.rates
    return Trajectory(t_ns, known.position[row], known.quat_xyzw[row], velocity[row], spin[row])


def _radar_body(tracks: dict[str, Trajectory]) -> str:
    """The rigid body that carries the radar: named so, or the one that moved farthest."""
    named = [name for name in tracks if "radar" in name.lower()]
    return max(named or tracks, key=lambda name: float(np.ptp(tracks[name].position, axis=0).max()))
