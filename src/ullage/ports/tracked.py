"""Recordings of radars with their track: a folder or two files, or plain arrays with both; logs without one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.data import Frames, Imu, Trajectory, sensors_of
from ullage.errors import InputError, NotRecorded
from ullage.ports.arrays import Arrays, names_in, read_npz, refuse_pickle
from ullage.ports.intake import warn
from ullage.ports.protocol import Source, WholeSource
from ullage.ports.radar_logs import SESSIONS, read_arrays, read_log, read_scans, read_sessions
from ullage.ports.tracks import Survey, read_bodies, read_survey, read_tracks
from ullage.ports.vehicle_logs import imu_of_dataflash, imu_of_ulog, read_dataflash, read_nmea, read_ubx, read_ulog
from ullage.specs import MountSpec
from ullage.untrusted import reading

BAGS = (".mcap", ".bag", ".db3")
TRACK_FILES = (".csv", ".txt", ".tum", ".ulg", ".bin", ".nmea", ".ubx")
TRACKS = ("mocap.csv", *(f"track{kind}" for kind in (*TRACK_FILES, *BAGS)))
"""Names of the radar's track in a folder with its recording."""
IMUS = tuple(f"imu{kind}" for kind in (".ulg", ".bin", *BAGS))
"""Names of the recorded inertial unit in that folder; else the track's file may hold it."""


class RailSource(WholeSource):
    """Radar recording with the track of the radar and surveyed reflectors, if any.

    Args:
        frames: of each radar.
        path: of the body.
        reflectors: places of reflectors (r, 3), for comparison [m].
        survey: reflectors that may settle clock and range, from `reflectors.csv`; None: there is no such file.
        floor_z_m: height of the floor, where the track's kind says it [m].
        imu_files: files that may hold an inertial unit.
    """

    def __init__(
        self, frames: list[Frames], *, path: Trajectory, reflectors: Floats, survey: Survey | None = None,
        floor_z_m: float | None = None, imu_files: tuple[Path, ...] = (),
    ) -> None:  # fmt: skip
        super().__init__({one.sensor: one for one in frames}, path=path)
        self._reflectors = reflectors
        self.survey, self.floor_z_m, self.imu_files = survey, floor_z_m, imu_files

    def reflectors(self) -> Floats:
        """True places of the reflectors (r, 3), world ENU [m]: those of `reflectors.csv`, else Motive's."""
        return self._reflectors if self.survey is None else self.survey.places


def open_arrays(path: Path, *, preset: str | None = None, mount: MountSpec | None = None) -> WholeSource:
    """Open named arrays (`.npz`, `.mat`, `.h5`): a PulsON log or an A121 session by its keys, else those of any radar.

    Args:
        path: the file.
        preset: of the radar, where the file does not say carrier and bandwidth.
        mount: of the radar on the body whose poses the file holds.

    Raises:
        InputError: as `read_npz`, `read_arrays` and `read_sessions`.
    """
    refuse_pickle(path)
    names = names_in(path)
    if names & SESSIONS:
        return WholeSource(read_sessions(path, mount=mount))
    arrays = read_arrays(path) if "scans" in names else read_npz(path, preset=preset)
    frames = _frames(arrays, arrays.track, mount, path)
    return WholeSource({frames.sensor: frames}, path=arrays.track or arrays.poses)


def open_log(path: Path) -> WholeSource:
    """Open a PulsON log alone, `.out`, or P452 scans as `.json`: frames without poses, for fits and detection.

    Raises:
        InputError: as `read_log` and `read_scans`.
    """
    log = read_scans(path) if path.suffix.lower() == ".json" else read_log(path)
    frames = _frames(log, None, None, path)
    return WholeSource({frames.sensor: frames})


def open_tracked(
    path: Path, radar: Source, *, track: str | Path = "", topic: str = "", datum: str = "",
    mount: MountSpec | None = None,
) -> WholeSource:  # fmt: skip
    """Put a radar recording on a track, as if both clocks had started together; `calibrate` finds the offsets.

    Args:
        path: file of the radar; its folder may hold the track, and surveyed reflectors.
        radar: the same, opened.
        track: file of the track; none: the one in the folder, by its name.
        topic: of the track in a bag; none: the only one there.
        datum: origin of fixes, `latitude,longitude[,height]`; none: the first fix, with a warning.
        mount: of the radar on the body that the track follows.

    Raises:
        InputError: a file cannot be read, there are two tracks, or the track is of one pose.
    """
    folder = path.parent
    found, inside = sensors_of(radar.frames()), radar.trajectory()
    there = [Path(track)] if track else [folder / name for name in TRACKS if (folder / name).exists()]
    if len(there) + (inside is not None) > 1:
        names = [one.name for one in there] + [path.name] * (inside is not None)
        raise InputError(f"two tracks, {' and '.join(names)}", where=folder, allowed="one of " + ", ".join(TRACKS))
    if not there and inside is None:
        warn(f"{folder}: no track ({', '.join(TRACKS)}), so frames have no poses")
        return WholeSource({one.sensor: one for one in found})
    tracks = {"radar": inside} if inside is not None else _read(there[0], topic=topic, datum=datum)
    name = _radar_body(tracks)
    if len(tracks[name]) < 2:
        raise InputError("a track of one pose", where=there[0] if there else folder, allowed="2 or more")
    survey = read_survey(folder / "reflectors.csv") if (folder / "reflectors.csv").exists() else None
    marks = read_tracks(folder / "reflector.csv") if (folder / "reflector.csv").exists() else {}
    points = [np.median(track.position, axis=0) for key, track in marks.items() if key != name]
    placed = found if inside is not None else [_beside(one, tracks[name], mount, folder) for one in found]
    floor_z_m = 0.0 if [one.name for one in there] == ["mocap.csv"] else None  # Motive's ground plane is on the floor
    reflectors = np.array(points).reshape(-1, 3)
    units = (*(folder / name for name in IMUS if (folder / name).exists()), *there)
    return RailSource(placed, path=tracks[name], reflectors=reflectors, survey=survey, floor_z_m=floor_z_m,
                      imu_files=units)  # fmt: skip


def read_radar_track(path: Path) -> Trajectory:
    """Read the track of the radar's body from a file: named so, or the body that moved farthest.

    Raises:
        InputError: the file is missing, of no known kind, or a line of it cannot be read.
    """
    tracks = _read(path, topic="", datum="")
    return tracks[_radar_body(tracks)]


def read_imu(path: str | Path, *, topic: str = "") -> Imu:
    """Read the inertial unit that a vehicle's log or a bag has recorded, for `ul.odometry`.

    Its axes count as the body's, its units as SI, and its clock as that of the track, or without one of the frames.

    Args:
        path: PX4's `.ulg`, ArduPilot's `.bin`, `.mcap`, `.bag`, `.db3`, or rosbag2's folder.
        topic: of sensor_msgs/Imu in a bag; none: the only one there.

    Raises:
        NotRecorded: the file has no readings, or is of another kind.
        InputError: it is missing or damaged, or its specific forces are not in m/s2 with gravity.
        MissingExtra: the library that reads it is not installed.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if not path.exists():
        raise InputError("no such file", where=path, allowed="a file")
    if kind == ".ulg":
        return imu_of_ulog(path)
    if kind == ".bin":
        return imu_of_dataflash(path)
    if kind in BAGS or path.is_dir():
        from ullage.ports.ros2.bags import imu_of_bag

        return imu_of_bag(path, topic=topic)
    raise NotRecorded(
        "no inertial unit is read from it", where=path, allowed=".ulg, .bin, .mcap, .bag, .db3 or a folder"
    )


def _read(path: Path, *, topic: str, datum: str) -> dict[str, Trajectory]:
    """Track of each body by name, by the suffix of the file."""
    kind = path.suffix.lower()
    if not path.exists():
        raise InputError("no such track", where=path, allowed="a file")
    with reading(path):
        if kind == ".ulg":
            return {"radar": read_ulog(path)}
        if kind == ".bin":
            return {"radar": read_dataflash(path)}
        if kind == ".nmea":
            return {"radar": read_nmea(path, datum=datum)}
        if kind == ".ubx":
            return {"radar": read_ubx(path, datum=datum)}
        if kind in BAGS:
            from ullage.ports.ros2.bags import read_track

            return {"radar": read_track(path, topic=topic, datum=datum)}
        return read_bodies(path)


def _beside(frames: Frames, track: Trajectory, mount: MountSpec | None, where: Path) -> Frames:
    """Frames of any radar with a track of another clock, as if both clocks had started together."""
    spec = frames.spec.but(mount=mount) if mount else frames.spec
    sensor, t_ns = track.mounted(spec.mount.body_from_sensor()), frames.t_ns - frames.t_ns[0] + track.t_ns[0]
    return replace(frames, spec=spec, t_ns=t_ns, poses=_held(sensor, t_ns, where), track=sensor)


def _frames(arrays: Arrays, track: Trajectory | None, mount: MountSpec | None, where: Path) -> Frames:
    """Frames with the poses of the arrays, or with their track of another clock."""
    spec = arrays.spec.but(mount=mount) if mount else arrays.spec
    name = "pulson" if spec.name == "pulson440" else "radar"
    poses = None if arrays.poses is None else arrays.poses.mounted(spec.mount.body_from_sensor())
    frames = Frames(arrays.samples, arrays.range_m, arrays.t_ns, spec, poses, sensor=name, unit="normalised")
    return frames if track is None else _beside(frames, track, None, where)


def _held(track: Trajectory, t_ns: Longs, where: Path) -> Trajectory:
    """The track at these times, standing still before its start and after its end."""
    inside, row = np.unique(np.clip(t_ns, track.t_ns[0], track.t_ns[-1]), return_inverse=True)
    if outside := int(((t_ns < track.t_ns[0]) | (t_ns > track.t_ns[-1])).sum()):
        warn(f"{where}: {outside} of {len(t_ns)} scans lie outside the motion capture; its ends were held")
    known = track.at(inside)
    velocity, spin = known.rates
    return Trajectory(t_ns, known.position[row], known.quat_xyzw[row], velocity[row], spin[row])


def _radar_body(tracks: dict[str, Trajectory]) -> str:
    """The rigid body that carries the radar: named so, or the one that moved farthest."""
    named = [name for name in tracks if "radar" in name.lower()]
    return max(named or tracks, key=lambda name: float(np.ptp(tracks[name].position, axis=0).max()))
