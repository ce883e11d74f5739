"""Radars simulated along the poses of a flying autopilot, real or simulated."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from ullage.data import Frames
from ullage.errors import InputError
from ullage.ports.cosimulation import CosimulationSource, options_of, rig_of, world_of
from ullage.ports.intake import Log, warn
from ullage.ports.mavlink.link import POSES, Link, PoseMessage, leave, open_link
from ullage.ports.mavlink.options import SourceOptions
from ullage.ports.mavlink.poses import PoseBuilder, origin_of
from ullage.ports.pose_events import EventFeed, ModelPose, Notice

SYNC_S = 3.0
"""How long poses wait for TIMESYNC after the first one came [s]."""
RESTART_NS = 1_000_000_000
"""A pose that lies behind the last one by more: the autopilot was started again [ns]."""


class PoseFeed(EventFeed[PoseMessage]):
    """Poses of the autopilot's vehicle, at times of this machine's clock where TIMESYNC is answered.

    Args:
        link: to the autopilot.
        options: which poses, and how.
    """

    def __init__(self, link: Link, options: SourceOptions) -> None:
        super().__init__(link)
        self._link, self._options = link, options
        self._builder = PoseBuilder(link.counters, options.poses, origin_of(options.origin))
        self._unsynced: deque[ModelPose] = deque()
        self._synchronised: bool | None = None  # None: not decided
        self._begun_s = self._last_s
        self._first_s: float | None = None
        self._boot_ns = 0
        link.request_hz = options.request_hz

    def next(self, timeout_s: float) -> Any:
        """Return the next pose or notice; poses from before the first call are not kept, for they would be late."""
        self._link.listens = True
        return super().next(timeout_s)

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Nothing: the sink sends distances."""

    def close(self) -> None:
        """Let go of the link, unless a sink still uses it."""
        self._link.listens = False
        leave(self._link, "source")

    def _take(self, event: PoseMessage) -> ModelPose | Notice | None:
        found = self._builder.take(event.message)
        if found:
            self._last_s = time.monotonic()
            self._first_s = self._first_s or self._last_s
            self._link.poses_come = True
        for pose in found:
            if pose.t_ns < self._boot_ns - RESTART_NS:
                self._unsynced.clear()
                self._link.forget_clock()
                self._ready.append(Notice("the autopilot's clock went back: it was started again"))
            self._boot_ns = pose.t_ns
            self._unsynced.append(pose)
        self._ready += self._timed()
        if self._builder.reset:
            self._builder.reset = False
            return Notice("the autopilot reset its estimate: its poses may have jumped")
        return None

    def _timed(self) -> list[ModelPose | Notice]:
        """The poses whose time is known."""
        if self._synchronised is None and self._unsynced:
            if self._link.clock.known:
                self._synchronised = True
            elif self._first_s is not None and time.monotonic() - self._first_s > SYNC_S:
                self._synchronised = False
                self._ready.append(Notice("the autopilot does not answer TIMESYNC: frames keep the time of its clock"))
        if self._synchronised is None or (self._synchronised and not self._link.clock.known):
            while len(self._unsynced) > 1:  # frames along older ones would only come late
                self._unsynced.popleft()
            return []
        poses, self._unsynced = list(self._unsynced), deque()
        return [self._local(pose) if self._synchronised else pose for pose in poses]

    def _local(self, pose: ModelPose) -> ModelPose:
        t_ns = self._link.local_ns(pose.t_ns)
        return pose if t_ns is None else ModelPose(t_ns, pose.position, pose.quat_xyzw)

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
        return f"no poses of system {there.system}: frames wait (it should send {wanted})"


def source_of(address: str, options: dict[str, Any], *, log: Log | None = None) -> CosimulationSource:
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
    link = open_link(address, chosen, role="source", log=log or warn)
    try:
        return CosimulationSource(lambda: PoseFeed(link, chosen), scene.without(chosen.model), rig, chosen, log=log)
    except BaseException:
        leave(link, "source")
        raise
