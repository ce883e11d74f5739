"""Radars simulated along the poses of a flying autopilot: NED and FRD on the wire, ENU and FLU here."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import apply, matrix_quat, quat_matrix, rpy_quat, transform
from ullage.ports.cosimulation import CosimulationSource, rig_of, world_of
from ullage.ports.intake import Counters, Log, Place, PoseQueue, checked_pose, warn
from ullage.ports.live import options_of, point_of
from ullage.ports.mavlink.link import POSES, Link, PoseMessage, leave, open_link
from ullage.ports.mavlink.options import PoseOptions, SourceOptions
from ullage.ports.ned import FLIP, enu_position, enu_quat
from ullage.ports.pose_events import BodyState, EventFeed, Notice, PoseTrack

SYNC_S = 3.0
"""How long poses wait for TIMESYNC after the first one came [s]."""
RESTART_NS = 1_000_000_000
"""A pose that lies behind the last one by more: the autopilot was started again [ns]."""
LOCAL_NED = 1
"""MAV_FRAME_LOCAL_NED."""
FRAMES = {LOCAL_NED: "MAV_FRAME_LOCAL_NED", 20: "MAV_FRAME_LOCAL_FRD"}
"""Frames of ODOMETRY that are used: z points down, and the pose is that of a forward-right-down body."""
ODOMETRY_S = 1.0
"""ODOMETRY that came so lately is preferred to LOCAL_POSITION_NED [s of the autopilot's clock]."""
APART_NS = 500_000_000
"""Attitudes farther apart are not interpolated [ns]."""
MOST_WAITING = 256


class PoseBuilder:
    """Makes poses of ODOMETRY, or of LOCAL_POSITION_NED with the attitude at its time.

    An attitude between two that came is on the great arc between them.

    Args:
        counters: count what cannot be used.
        wanted: which messages; auto: ODOMETRY where it comes.
        world_from_local: (4, 4) of the autopilot's local origin, ENU.
    """

    def __init__(
        self, counters: Counters, wanted: Literal["auto", "odometry", "local"], world_from_local: Floats
    ) -> None:
        self._counters, self._wanted, self._origin = counters, wanted, world_from_local
        self._attitudes = PoseTrack(gap_ns=APART_NS)
        self._positions: PoseQueue[tuple[int, Floats, Floats]] = PoseQueue(
            counters, "LOCAL_POSITION_NED", most=MOST_WAITING
        )
        self._odometry_ns: int | None = None
        self._quaternions = False  # ATTITUDE_QUATERNION comes, so ATTITUDE is not needed
        self._resets: int | None = None
        self._spin = np.zeros(3)  # forward, right, down, of the last attitude
        self.reset = False
        """Whether the autopilot's estimator was reset since the caller cleared this."""

    def take(self, message: Any) -> list[BodyState]:
        """The poses that are known by this message, by the autopilot's clock."""
        kind = message.get_type()
        if kind == "ODOMETRY":
            return self._odometry(message)
        t_ns = message.time_boot_ms * 1_000_000
        if kind == "LOCAL_POSITION_NED":
            self._position(t_ns, message)
        elif kind == "ATTITUDE_QUATERNION":
            self._quaternions = True
            self._attitude(message, t_ns, [message.q2, message.q3, message.q4, message.q1])
        elif not self._quaternions:
            angles = [message.roll, message.pitch, message.yaw]
            turn = rpy_quat(*angles) if np.isfinite(angles).all() else np.full(4, np.nan)
            self._attitude(message, t_ns, turn)
        return self._matched()

    def _odometry(self, message: Any) -> list[BodyState]:
        if self._wanted == "local":
            return []
        w, *xyz = message.q
        ned = [message.x, message.y, message.z]
        if message.frame_id not in FRAMES:
            allowed = " or ".join(FRAMES.values())
            self._counters.drop("ODOMETRY", "bad", f"frame {message.frame_id} is not {allowed}")
            return []
        pose = checked_pose(ned, [*xyz, w])
        if isinstance(pose, str):
            self._counters.drop("ODOMETRY", "bad", pose)
            return []
        if self._resets not in (None, message.reset_counter):
            self.reset = True
        self._resets = message.reset_counter
        self._odometry_ns = message.time_usec * 1000
        velocity = np.array([message.vx, message.vy, message.vz])
        if message.child_frame_id != LOCAL_NED:
            velocity = quat_matrix(pose[1]) @ velocity
        spin = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        return [self._sighting(self._odometry_ns, *pose, velocity, spin)]

    def _position(self, t_ns: int, message: Any) -> None:
        lately = self._odometry_ns is not None and abs(t_ns - self._odometry_ns) < ODOMETRY_S * 1e9
        if self._wanted == "odometry" or (self._wanted == "auto" and lately):
            return
        ned = np.array([message.x, message.y, message.z])
        if not np.isfinite(ned).all():
            self._counters.drop("LOCAL_POSITION_NED", "bad", "position is not finite")
            return
        velocity = np.array([message.vx, message.vy, message.vz])
        self._positions.put((t_ns, ned, velocity), time.monotonic())

    def _attitude(self, message: Any, t_ns: int, quat: Any) -> None:
        pose = checked_pose(np.zeros(3), quat)
        if isinstance(pose, str):
            self._counters.drop(message.get_type(), "bad", pose)
            return
        self._spin = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        if self._attitudes.add(t_ns, *pose):
            self._positions.clear("the autopilot was started again")

    def _matched(self) -> list[BodyState]:
        """Positions whose time lies between two attitudes."""

        def attitude_at(position: tuple[int, Floats, Floats]) -> Place[tuple[Floats, Floats]]:
            return self._attitudes.at(position[0])._replace(missing="no attitude near its time")

        ready = self._positions.ready(attitude_at, time.monotonic())
        return [self._sighting(t_ns, ned, pose[1], velocity, self._spin) for (t_ns, ned, velocity), pose in ready]

    def _sighting(self, t_ns: int, ned: Floats, ned_from_frd: Floats, velocity: Floats, spin: Floats) -> BodyState:
        """Return a state of its parts north-east-down and forward-right-down; rates that are not finite count as 0."""
        at = apply(self._origin, enu_position(ned)[None])[0]
        turn = matrix_quat(self._origin[:3, :3] @ quat_matrix(enu_quat(ned_from_frd)))
        speed, spin = (np.where(np.isfinite(rate), rate, 0.0) for rate in (velocity, spin))
        return BodyState(t_ns, at, turn, self._origin[:3, :3] @ enu_position(speed), FLIP @ spin)


def origin_of(text: str) -> Floats:
    """The transform (4, 4) of `x,y,z` [m] or `x,y,z,yaw` [m, deg].

    Raises:
        InputError: it is neither.
    """
    x, y, z, *yaw = point_of(text or "0,0,0", "origin", where="mavlink", yaw=True)
    return transform((x, y, z), (0.0, 0.0, np.radians(yaw[0] if yaw else 0.0)))


class PoseFeed(EventFeed):
    """Poses of the autopilot's vehicle, at times of this machine's clock where TIMESYNC is answered.

    Args:
        link: to the autopilot.
        options: which poses, and how.
    """

    def __init__(self, link: Link, options: PoseOptions) -> None:
        super().__init__(link)
        self._link, self._options = link, options
        self.jumped = ""
        """Why poses since then may lie elsewhere than those before; empty: they do not."""
        self._builder = PoseBuilder(link.counters, options.poses, origin_of(options.origin))
        self._unsynced: deque[BodyState] = deque()
        self._synchronised: bool | None = None  # None: not decided
        self._begun_s = self._last_s
        self._first_s: float | None = None
        self._boot_ns = 0
        link.request_hz = options.request_hz

    def next(self, timeout_s: float) -> Any:
        """Return the next pose or notice; poses from before the first call are not kept, for they would be late."""
        self._link.listens = True
        return super().next(timeout_s)

    def close(self) -> None:
        """Let go of the link, unless a sink still uses it."""
        self._link.listens = False
        leave(self._link, "source")

    def _take(self, event: PoseMessage) -> BodyState | Notice | None:
        found = self._builder.take(event.message)
        if found:
            self._last_s = time.monotonic()
            self._first_s = self._first_s or self._last_s
            self._link.poses_come = True
        for pose in found:
            if pose.t_ns < self._boot_ns - RESTART_NS:
                self._unsynced.clear()
                self._link.forget_clock()
                self.jumped = "the autopilot's clock went back: it was started again"
                self._ready.append(Notice(self.jumped))
            self._boot_ns = pose.t_ns
            self._unsynced.append(pose)
        self._ready += self._timed()
        if self._builder.reset:
            self._builder.reset = False
            self.jumped = "the autopilot reset its estimate: its poses may have jumped"
            return Notice(self.jumped)
        return None

    def _timed(self) -> list[BodyState | Notice]:
        """The poses whose time is known."""
        if self._synchronised is None and self._unsynced:
            if self._link.clock.known:
                self._synchronised = True
            elif self._first_s is not None and time.monotonic() - self._first_s > SYNC_S:
                self._synchronised = False
                self._ready.append(Notice("the autopilot does not answer TIMESYNC: poses keep the time of its clock"))
        if self._synchronised is None or (self._synchronised and not self._link.clock.known):
            while len(self._unsynced) > 1:  # frames along older ones would only come late
                self._unsynced.popleft()
            return []
        poses, self._unsynced = list(self._unsynced), deque()
        return [self._local(pose) if self._synchronised else pose for pose in poses]

    def _local(self, pose: BodyState) -> BodyState:
        t_ns = self._link.local_ns(pose.t_ns)
        return pose if t_ns is None else replace(pose, t_ns=t_ns)

    def _on_silence(self) -> Notice | None:
        """Nothing came for a while.

        Raises:
            InputError: no HEARTBEAT came at all.
        """
        if self._link.autopilot is None and time.monotonic() - self._begun_s > self._options.wait_s:
            raise self._link.missing(self._options.wait_s)
        return super()._on_silence()

    def _silence(self) -> str:
        there = self._link.autopilot
        if there is None:
            return f"waiting for HEARTBEAT on {self._link.name}"
        self._link.poses_come = False
        wanted = {"odometry": POSES[0], "local": ", ".join(POSES[1:])}.get(self._options.poses, ", ".join(POSES))
        return f"no poses of system {there.system} (it should send {wanted})"


def open_poses(address: str, options: dict[str, Any]) -> PoseFeed:
    """Poses of the autopilot's vehicle: `mavlink:udp://HOST:PORT?key=value`.

    Raises:
        InputError: an option cannot be used, or the place cannot be opened.
        MissingExtra: pymavlink or pyserial is not installed.
    """
    chosen = options_of(PoseOptions, options, f"mavlink:{address}")
    origin_of(chosen.origin)
    return PoseFeed(open_link(address, chosen, role="source", log=warn), chosen)


def open_source(address: str, options: dict[str, Any], *, log: Log | None = None) -> CosimulationSource:
    """Frames of radars on the autopilot's vehicle in a world: `mavlink:udp://HOST:PORT?world=NAME`.

    Args:
        address: the place.
        options: as `SourceOptions` lists them.
        log: takes lines for the user; None: they become warnings.

    Raises:
        InputError: an option cannot be used, no world is named, or the place cannot be opened.
        MissingExtra: pymavlink or pyserial is not installed.
    """
    where = f"mavlink:{address}"
    chosen = options_of(SourceOptions, options, where)
    origin_of(chosen.origin)
    if not chosen.world:
        raise InputError("no world", where=where, allowed="world=NAME or world=FILE")
    scene = world_of(chosen.world, where=where)
    rig = rig_of(chosen.rig, scene, chosen.model, where=where)
    if chosen.stagger:
        rig = rig.but(sensors={name: spec.staggered() for name, spec in rig.sensors.items()})
    link = open_link(address, chosen, role="source", log=log or warn)
    try:
        return CosimulationSource(lambda: PoseFeed(link, chosen), scene.without(chosen.model), rig, chosen, log=log)
    except BaseException:
        leave(link, "source")
        raise
