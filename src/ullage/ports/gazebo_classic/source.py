"""Radars on a model of a running gzserver (Gazebo Classic 11)."""

from __future__ import annotations

import math
import os
import time
from typing import Any

import numpy as np
from pydantic import Field

from ullage.data import Frames
from ullage.ports.following import (
    PATIENCE_S,
    FollowOptions,
    FollowSource,
    Note,
    Say,
    Sighting,
    opened,
    options_of,
    radar_of,
)
from ullage.ports.gazebo_classic.peer import ClassicPeer, Deaf, Event, Heard, Lost, Met, type_of
from ullage.ports.gazebo_classic.topics import RadarTopics
from ullage.ports.gazebo_classic.wire import gz, master_of
from ullage.ports.scanning import Scan, ScanSource

ASK_S = 0.5
"""How often the server is asked for the model while no pose of it comes: it tells of what moves only."""
STILL_NS = 200_000_000
"""The answer stands for this long before the question: what had moved until then was told before the answer."""


class ClassicOptions(FollowOptions):
    """What can be set about `gazebo-classic:`."""

    gazebo_world: str = Field("", description="the server's name of its world; none: the first that it tells")


class ClassicFeed:
    """Poses of one model from a gzserver, or scans of its rays, and what becomes of the server."""

    def __init__(self, peer: ClassicPeer, options: ClassicOptions) -> None:
        self._peer, self._options, self.world = peer, options, options.gazebo_world
        self.newest_ns = 0
        self._known = False  # the model was there
        self._number = int.from_bytes(os.urandom(4), "big") >> 1  # of our questions
        self._paused = self._there = False
        self._asked_ns: int | None = None  # the server's clock at the question, until it is answered or a pose comes
        self._last_s = self._ask_s = time.monotonic()
        self._told_s = 0.0
        self._topics: RadarTopics | None = None

    def next(self, timeout_s: float) -> Any:
        """The next pose of the model or scan of its rays, or something to say."""
        end = time.monotonic() + timeout_s
        while True:
            event = self._peer.wait(max(0.0, end - time.monotonic()))
            if event is None:
                return self._silence() if timeout_s else None
            found = self._take(event)
            if found is not None:
                return found

    def _take(self, event: Event) -> Sighting | Scan | Note | None:
        if not isinstance(event, Heard):
            return self._master(event)
        self._last_s = time.monotonic()
        what = event.topic.rpartition("/")[2]
        if what == "scan":
            return scan_of(gz().LaserScanStamped.FromString(event.data))
        if what == "info":
            return self._poses(event)
        if what == "world_stats":
            return self._status(event)
        told = gz().Response.FromString(event.data)
        return self._answer(told) if told.id == self._number else None

    def _master(self, event: Met | Lost | Deaf) -> Note | None:
        if isinstance(event, Met):
            return self._met(event)
        if isinstance(event, Deaf):
            return Note("gzserver does not answer: joining it anew")
        self._there = False
        return Note("gzserver has gone; waiting for it to come back (Ctrl-C ends)")

    def _met(self, event: Met) -> Note | None:
        worlds = [name for name in event.worlds if name and not name.startswith("/")]
        if self._there or not worlds or (self.world and self.world not in worlds):
            return None
        self._there, self.world = True, self.world or worlds[0]
        root = f"/gazebo/{self.world}"
        kinds = {"world_stats": "WorldStatistics", "response": "Response"}
        if not self._options.rays:
            kinds["pose/info"] = "PosesStamped"
        for name, kind in kinds.items():
            self._peer.subscribe(f"{root}/{name}", type_of(kind))
        self._peer.advertise(f"{root}/request", type_of("Request"))
        return Note(f"gzserver runs the world {self.world!r}")

    def _poses(self, event: Heard) -> Sighting | None:
        told = gz().PosesStamped.FromString(event.data)
        own = next((pose for pose in told.pose if pose.name == self._options.model), None)
        if own is None:
            return None
        self._ask_s, self._asked_ns, self._known = time.monotonic(), None, True
        return self._seen(told.time.sec * 10**9 + told.time.nsec, own)

    def _seen(self, t_ns: int, pose: Any) -> Sighting:
        self.newest_ns = t_ns
        at, turn = pose.position, pose.orientation
        return Sighting(t_ns, (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))

    def _status(self, event: Heard) -> Note | None:
        stats = gz().WorldStatistics.FromString(event.data)
        if time.monotonic() - self._ask_s > ASK_S:
            self._ask_s = time.monotonic()
            self._asked_ns = stats.sim_time.sec * 10**9 + stats.sim_time.nsec
            self._ask("entity_info", self._options.model)
        if stats.paused == self._paused:
            return None
        self._paused = stats.paused
        return Note("gzserver is paused" if self._paused else "gzserver goes on")

    def _ask(self, what: str, data: str) -> None:
        ask = gz().Request(id=self._number, request=what, data=data)
        self._peer.publish(f"/gazebo/{self.world}/request", ask)

    def _answer(self, told: Any) -> Sighting | Note | None:
        if told.request == "scene_info":
            names = [model.name for model in gz().Scene.FromString(told.serialized_data).model]
            return Note(f"no model {self._options.model!r} in gzserver (there are {', '.join(names[:12])})")
        if told.type != type_of("Model"):
            return self._absent()
        if self._options.rays:
            return self._sensor(told)
        asked_ns, self._asked_ns, self._known = self._asked_ns, None, True
        if asked_ns is None:
            return None
        return self._seen(max(asked_ns - STILL_NS, 0), gz().Model.FromString(told.serialized_data).pose)

    def _absent(self) -> Note | None:
        if self._known:
            self._known = False
            return Note(f"the model {self._options.model!r} has gone from gzserver; waiting for it to come back")
        self._ask("scene_info", "")
        return None

    def _sensor(self, told: Any) -> Note | None:
        """Join the topic of the ray sensor, wherever on the model it is."""
        links = gz().Model.FromString(told.serialized_data).link
        found = {sensor.name: (link.name, sensor) for link in links for sensor in link.sensor}
        if self._options.rays not in found:
            names = ", ".join(found) or "none"
            return Note(f"no sensor {self._options.rays!r} on {self._options.model!r} (there are {names})")
        link, sensor = found[self._options.rays]
        path = link.replace("::", "/")
        usual = f"/gazebo/{self.world}/{path}/{sensor.name}/scan"
        self._peer.subscribe(usual, type_of("LaserScanStamped"))
        return None

    def _silence(self) -> Note | None:
        now = time.monotonic()
        if now - max(self._last_s, self._told_s) < PATIENCE_S:
            return None
        self._told_s = now
        host, port = self._peer.master
        return Note(f"no gzserver at {host}:{port}" if not self._there else f"gzserver at {host}:{port} says nothing")

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Publish frames."""
        if self._topics is None:
            self._topics = RadarTopics(self._peer, self.world, self._options.model)
        for frames in chunk.values():
            self._topics.write(frames, offset_ns)

    def close(self) -> None:
        """Let go of the sockets."""
        self._peer.close()


def scan_of(told: Any) -> Scan:
    """The scan in a message."""
    scan, at, turn = told.scan, told.scan.world_pose.position, told.scan.world_pose.orientation
    shape = (max(int(scan.vertical_count), 1), int(scan.count))
    return Scan(
        told.time.sec * 10**9 + told.time.nsec,
        np.array(scan.ranges).reshape(shape), np.array(scan.intensities).reshape(shape),
        math.degrees(scan.angle_max - scan.angle_min), scan.range_min, scan.range_max,
        (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w),
    )  # fmt: skip


def source_of(address: str, options: dict[str, Any], *, say: Say | None = None) -> FollowSource | ScanSource:
    """Frames of radars on a model of a running gzserver: `gazebo-classic:HOST:PORT?model=NAME`.

    Args:
        address: of the master; empty: GAZEBO_MASTER_URI, or this machine's usual port.
        options: as `ClassicOptions` lists them.
        say: told what a person should know; None: it becomes a warning.

    Raises:
        InputError: an option cannot be used, or no world is known.
        MissingExtra: protobuf is not installed.
    """
    where = f"gazebo-classic:{address}"
    chosen, scene, rig = opened(options_of(ClassicOptions, options, where), where)
    master = master_of(address)

    def join() -> ClassicFeed:
        return ClassicFeed(ClassicPeer(master, chosen.host), chosen)

    if chosen.rays:
        return ScanSource(join, radar_of(rig, chosen.rays), chosen, scene=scene, say=say)
    return FollowSource(join, scene, rig, chosen, say=say)
