"""Radars on a model of a running gzserver (Gazebo Classic 11)."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterable
from typing import Any

from pydantic import Field

from ullage.data import Frames
from ullage.ports.cosimulation import CosimulationOptions, CosimulationSource, matching, options_of, resolved
from ullage.ports.gazebo_classic.peer import (
    ClassicPeer,
    Connected,
    Disconnected,
    Event,
    Received,
    Unresponsive,
    type_of,
)
from ullage.ports.gazebo_classic.topics import RadarTopics
from ullage.ports.gazebo_classic.wire import gz, master_of
from ullage.ports.intake import PATIENCE_S, Log
from ullage.ports.pose_events import EventFeed, ModelPose, Notice, OtherModels, pose_of, stamp_ns
from ullage.ports.scanning import Scan, ScanSource, scan_of

ASK_S = 0.5
"""How often the server is asked for the model while no pose of it comes: it tells of what moves only."""
STILL_NS = 200_000_000
"""An answer holds for the time this long before the request: later motion came before the answer [ns]."""


RAY_TYPES = {"ray", "gpu_ray"}
"""Types of sensors that publish scans."""


class ClassicOptions(CosimulationOptions):
    """Options of `gazebo-classic:`."""

    gazebo_world: str = Field("", description="the server's name of its world; none: the first that it tells")


class ClassicFeed(EventFeed[Event]):
    """Poses of one model and of other models from a gzserver, or scans of its rays, and notices about the server.

    Args:
        peer: the connection to the server.
        options: name the model and its topics.
        others: names of the world's other models.
        ask_every_s: how often the server is asked for the model while no pose of it comes [s].
        patience_s: after how long a silence that is reported [s].
    """

    def __init__(
        self, peer: ClassicPeer, options: ClassicOptions, others: frozenset[str] = frozenset(), *,
        ask_every_s: float = ASK_S, patience_s: float = PATIENCE_S,
    ) -> None:  # fmt: skip
        super().__init__(peer)
        self._peer, self._options, self.world = peer, options, options.gazebo_world
        self._ask_every_s, self._patience_s = ask_every_s, patience_s
        self._others = frozenset() if options.rays else others - {options.model}  # rays see them by themselves
        self._refresh_due = False  # before anything moves, the server is asked where everything is
        self._refresh_ns: int | None = None
        self._refresh_s = 0.0
        self.newest_ns = 0
        self._known = False  # the model was there
        self._number = int.from_bytes(os.urandom(4), "big") >> 1  # of our requests
        self._paused = self._there = False
        self._asked_ns: int | None = None  # the server's clock at the question, until it is answered or a pose comes
        self._last_s = self._ask_s = time.monotonic()
        self._logged_s = 0.0
        self._topics: RadarTopics | None = None
        self._scans: dict[str, str] = {}  # name of the ray sensor by its topic

    def _take(self, event: Event) -> ModelPose | OtherModels | Scan | Notice | None:
        if not isinstance(event, Received):
            return self._master(event)
        self._last_s = time.monotonic()
        reads = {
            "/scan": self._scan, "/pose/info": self._poses, "/world_stats": self._status, "/response": self._response,
            "/model/info": self._came, "/request": self._asked,
        }  # fmt: skip
        return next((read(event) for end, read in reads.items() if event.topic.endswith(end)), None)

    def _scan(self, event: Received) -> Scan:
        message = gz().LaserScanStamped.FromString(event.data)
        sensor = self._scans.get(event.topic, event.topic.split("/")[-2])
        return scan_of(message.scan, message.time, pose_of(message.scan.world_pose), sensor=sensor)

    def _response(self, event: Received) -> ModelPose | OtherModels | Notice | None:
        message = gz().Response.FromString(event.data)
        if message.id == self._number + 1:
            return self._everything(message)
        return self._answer(message) if message.id == self._number else None

    def _master(self, event: Connected | Disconnected | Unresponsive) -> Notice | None:
        if isinstance(event, Connected):
            return self._met(event)
        if isinstance(event, Unresponsive):
            return Notice("gzserver does not answer: joining it anew")
        self._there = False
        return Notice("gzserver has gone; waiting for it to come back (Ctrl-C ends)")

    def _met(self, event: Connected) -> Notice | None:
        worlds = [name for name in event.worlds if name and not name.startswith("/")]
        if self._there or not worlds or (self.world and self.world not in worlds):
            return None
        self._there, self.world, self._refresh_due = True, self.world or worlds[0], bool(self._others)
        root = f"/gazebo/{self.world}"
        kinds = {"world_stats": "WorldStatistics", "response": "Response"}
        if not self._options.rays:
            kinds["pose/info"] = "PosesStamped"
        if self._others:
            kinds |= {"model/info": "Model", "request": "Request"}
        for name, kind in kinds.items():
            self._peer.subscribe(f"{root}/{name}", type_of(kind))
        self._peer.advertise(f"{root}/request", type_of("Request"))
        return Notice(f"gzserver runs the world {self.world!r}")

    def _poses(self, event: Received) -> ModelPose | None:
        message = gz().PosesStamped.FromString(event.data)
        t_ns, own = stamp_ns(message.time), None
        theirs = {}
        for pose in message.pose:
            if pose.name == self._options.model:
                own = pose
            elif pose.name in self._others:
                theirs[pose.name] = pose
        moved = self._valid_poses(event.topic, theirs)
        if moved:
            self._ready.append(OtherModels(t_ns, moved))
        if own is None:
            return None
        self._ask_s, self._asked_ns, self._known = time.monotonic(), None, True
        return self._seen(t_ns, own)

    def _seen(self, t_ns: int, pose: Any) -> ModelPose:
        self.newest_ns = t_ns
        return ModelPose(t_ns, *pose_of(pose))

    def _came(self, event: Received) -> OtherModels | None:
        """Note a new or changed model, and request all poses."""
        name, self._refresh_due = gz().Model.FromString(event.data).name, True
        return OtherModels(self.newest_ns, new=frozenset({name})) if self._strange(name) else None

    def _asked(self, event: Received) -> OtherModels | None:
        """Note a request to delete a model."""
        message = gz().Request.FromString(event.data)
        deleted = message.request == "entity_delete" and message.data in self._others
        return OtherModels(self.newest_ns, gone=frozenset({message.data})) if deleted else None

    def _strange(self, name: str) -> bool:
        return name != self._options.model and name not in self._others

    def _everything(self, message: Any) -> OtherModels | None:
        """Return all poses from the server's scene."""
        asked_ns, self._refresh_ns, self._refresh_due = self._refresh_ns, None, False
        if asked_ns is None:
            return None
        there = {model.name: model.pose for model in gz().Scene.FromString(message.serialized_data).model}
        new = frozenset(name for name in there if self._strange(name))
        ours = self._valid_poses("response", {name: pose for name, pose in there.items() if name in self._others})
        return OtherModels(asked_ns, ours, self._others - there.keys(), new)

    def _status(self, event: Received) -> Notice | None:
        stats = gz().WorldStatistics.FromString(event.data)
        if time.monotonic() - self._ask_s > self._ask_every_s:
            self._ask_s = time.monotonic()
            self._asked_ns = stamp_ns(stats.sim_time)
            self._ask("entity_info", self._options.model)
        if (
            self._refresh_due and time.monotonic() - self._refresh_s > self._ask_every_s
        ):  # until it answers: the first may be lost
            self._refresh_s, self._refresh_ns = time.monotonic(), stamp_ns(stats.sim_time)
            self._ask("scene_info", "", number=self._number + 1)
        if stats.paused == self._paused:
            return None
        self._paused = stats.paused
        return Notice("gzserver is paused" if self._paused else "gzserver goes on")

    def _ask(self, what: str, data: str, *, number: int | None = None) -> None:
        ask = gz().Request(id=self._number if number is None else number, request=what, data=data)
        self._peer.publish(f"/gazebo/{self.world}/request", ask)

    def _answer(self, message: Any) -> ModelPose | Notice | None:
        if message.request == "scene_info":
            names = [model.name for model in gz().Scene.FromString(message.serialized_data).model]
            return Notice(f"no model {self._options.model!r} in gzserver (there are {', '.join(names[:12])})")
        if message.type != type_of("Model"):
            return self._absent()
        if self._options.rays:
            return self._sensor(message)
        asked_ns, self._asked_ns, self._known = self._asked_ns, None, True
        if asked_ns is None:
            return None
        return self._seen(max(asked_ns - STILL_NS, 0), gz().Model.FromString(message.serialized_data).pose)

    def _absent(self) -> Notice | None:
        if self._known:
            self._known = False
            return Notice(f"the model {self._options.model!r} has gone from gzserver; waiting for it to come back")
        self._ask("scene_info", "")
        return None

    def _sensor(self, message: Any) -> Notice | None:
        """Subscribe to the topics of the ray sensors on any link of the model."""
        found = ray_sensors(gz().Model.FromString(message.serialized_data).link)
        wanted, missing = matching(self._options.rays, found)
        for name in wanted:
            topic = f"/gazebo/{self.world}/{found[name]}/scan"
            self._scans[topic] = name
            self._peer.subscribe(topic, type_of("LaserScanStamped"))
        if missing:
            names = ", ".join(found) or "none"
            absent = ", ".join(map(repr, missing))
            return Notice(f"no ray sensor {absent} on {self._options.model!r} (there are {names})")
        return None

    def _on_silence(self) -> Notice | None:
        now = time.monotonic()
        if now - max(self._last_s, self._logged_s) < self._patience_s:
            return None
        self._logged_s = now
        host, port = self._peer.master
        return Notice(f"no gzserver at {host}:{port}" if not self._there else f"gzserver at {host}:{port} says nothing")

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Publish frames."""
        if self._topics is None:
            self._topics = RadarTopics(self._peer, self.world, self._options.model)
        for frames in chunk.values():
            self._topics.write(frames, offset_ns)


def ray_sensors(links: Iterable[Any]) -> dict[str, str]:
    """Return the paths of a model's ray sensors by name; a name on several links gets its link as prefix (`arm/front`).

    Args:
        links: links in the message of the model.
    """
    placed = [(link.name, sensor.name) for link in links for sensor in link.sensor if sensor.type in RAY_TYPES]
    count = Counter(name for _, name in placed)
    return {
        name if count[name] == 1 else f"{link.rpartition('::')[2]}/{name}": f"{link.replace('::', '/')}/{name}"
        for link, name in placed
    }


def source_of(address: str, options: dict[str, Any], *, log: Log | None = None) -> CosimulationSource | ScanSource:
    """Open radars on a model of a running gzserver: `gazebo-classic:HOST:PORT?model=NAME`.

    Args:
        address: address of the master; empty: GAZEBO_MASTER_URI, or this machine's usual port.
        options: as `ClassicOptions` lists them.
        log: takes lines for the user; None: they become warnings.

    Raises:
        InputError: an option is not valid, or no world is known.
        MissingExtra: protobuf is not installed.
    """
    where = f"gazebo-classic:{address}"
    chosen, scene, rig = resolved(options_of(ClassicOptions, options, where), where)
    master = master_of(address)

    def join() -> ClassicFeed:
        return ClassicFeed(ClassicPeer(master, chosen.host), chosen, frozenset(scene.models))

    if chosen.rays:
        return ScanSource(join, rig, chosen, scene=scene, log=log)
    return CosimulationSource(join, scene, rig, chosen, log=log)
