"""Radars on a model of a running gzserver (Gazebo Classic 11)."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterable
from typing import Any

from pydantic import Field

from ullage.ports.cosimulation import CosimulationOptions, CosimulationSource, matching, resolved
from ullage.ports.gazebo.classic import ClassicPeer, master_of
from ullage.ports.gazebo.messages import classic
from ullage.ports.gazebo.peer import Connected, Disconnected, Event, Received
from ullage.ports.gazebo.topics import CLASSIC, Feed, RadarTopics
from ullage.ports.intake import PATIENCE_S, Log
from ullage.ports.live import options_of
from ullage.ports.pose_events import ModelPose, Notice, OtherModels, pose_of, stamp_ns
from ullage.ports.scanning import Scan, ScanSource, scan_of

ASK_S = 0.5
"""How often gzserver is asked for the model while no pose of it comes: it tells of what moves only."""
STILL_NS = 200_000_000
"""An answer holds for the time this long before the request: later motion came before the answer [ns]."""
RAY_TYPES = {"ray", "gpu_ray"}
"""Types of sensors that publish scans."""


class ClassicOptions(CosimulationOptions):
    """Options of `gazebo-classic:`."""

    gazebo_world: str = Field("", description="the server's name of its world; none: the first that it tells")


class ClassicFeed(Feed):
    """What gzserver tells; it gives poses of what moves only, so it is asked for the others.

    Args:
        peer: the connection to the server.
        options: name the model and its sensors.
        others: names of the world's other models.
        ask_every_s: how often the server is asked for the model while no pose of it comes [s].
        patience_s: after how long a silence that is reported [s].
    """

    server = "gzserver"

    def __init__(
        self, peer: ClassicPeer, options: ClassicOptions, others: frozenset[str] = frozenset(), *,
        ask_every_s: float = ASK_S, patience_s: float = PATIENCE_S,
    ) -> None:  # fmt: skip
        super().__init__(peer, options, options.gazebo_world, others, patience_s=patience_s)
        self._classic, self._ask_every_s = peer, ask_every_s
        self._there = False
        self._refresh_due = False  # before anything moves, the server is asked where everything is
        self._refresh_ns: int | None = None
        self._refresh_s = 0.0
        self._number = int.from_bytes(os.urandom(4), "big") >> 1  # of our requests
        self._asked_ns: int | None = None  # the server's clock at the question, until it is answered or a pose comes
        self._ask_s = time.monotonic()

    def _take(self, event: Event) -> ModelPose | OtherModels | Scan | Notice | None:
        if isinstance(event, Connected):
            return self._met(event)
        if isinstance(event, Disconnected):
            self._there = False
            return self._server_gone()
        if not isinstance(event, Received):
            return Notice("gzserver does not answer: joining it anew")
        self._last_s = time.monotonic()
        reads = {
            "/scan": self._scan, "/pose/info": self._poses, "/world_stats": self._status, "/response": self._response,
            "/model/info": self._came, "/request": self._deleted,
        }  # fmt: skip
        return next((read(event) for end, read in reads.items() if event.topic.endswith(end)), None)

    def _scan(self, event: Received) -> Scan:
        message = classic().LaserScanStamped.FromString(event.data)
        sensor = self._scans.get(event.topic, event.topic.split("/")[-2])
        return scan_of(message.scan, message.time, pose_of(message.scan.world_pose), sensor=sensor)

    def _response(self, event: Received) -> ModelPose | OtherModels | Notice | None:
        message = classic().Response.FromString(event.data)
        if message.id == self._number + 1:
            return self._everything(message)
        return self._answer(message) if message.id == self._number else None

    def _met(self, event: Connected) -> Notice | None:
        worlds = [name for name in event.worlds if name and not name.startswith("/")]
        if self._there or not worlds or (self.world and self.world not in worlds):
            return None
        self._there, self.world, self._refresh_due = True, self.world or worlds[0], bool(self._others)
        kinds = {"world_stats": "WorldStatistics", "response": "Response"}
        if not self._rays:
            kinds["pose/info"] = "PosesStamped"
        if self._others:
            kinds |= {"model/info": "Model", "request": "Request"}
        for name, kind in kinds.items():
            self._peer.subscribe(f"/gazebo/{self.world}/{name}", f"{CLASSIC}.{kind}")
        self._peer.advertise(f"/gazebo/{self.world}/request", f"{CLASSIC}.Request")
        return Notice(f"gzserver runs the world {self.world!r}")

    def _poses(self, event: Received) -> ModelPose | None:
        message = classic().PosesStamped.FromString(event.data)
        t_ns, by_name = stamp_ns(message.time), {pose.name: pose for pose in message.pose}
        theirs = {name: pose for name, pose in by_name.items() if name in self._others}
        if moved := self._valid_poses(event.topic, theirs):
            self._ready.append(OtherModels(t_ns, moved))
        if self._model not in by_name:
            return None
        self._ask_s, self._asked_ns = time.monotonic(), None
        return self._seen(t_ns, by_name[self._model])

    def _came(self, event: Received) -> OtherModels | None:
        """Note a new or changed model, and request all poses."""
        name, self._refresh_due = classic().Model.FromString(event.data).name, True
        new = self._new_models({name})
        return OtherModels(self.newest_ns, new=new) if new else None

    def _deleted(self, event: Received) -> OtherModels | None:
        message = classic().Request.FromString(event.data)
        deleted = message.request == "entity_delete" and message.data in self._others
        return OtherModels(self.newest_ns, gone=frozenset({message.data})) if deleted else None

    def _everything(self, message: Any) -> OtherModels | None:
        asked_ns, self._refresh_ns, self._refresh_due = self._refresh_ns, None, False
        if asked_ns is None:
            return None
        there = {model.name: model.pose for model in classic().Scene.FromString(message.serialized_data).model}
        theirs = self._valid_poses("response", {name: pose for name, pose in there.items() if name in self._others})
        return OtherModels(asked_ns, theirs, self._others - there.keys(), self._new_models(there))

    def _status(self, event: Received) -> Notice | None:
        stats, now = classic().WorldStatistics.FromString(event.data), time.monotonic()
        if now - self._ask_s > self._ask_every_s:
            self._ask_s, self._asked_ns = now, stamp_ns(stats.sim_time)
            self._ask("entity_info", self._model)
        if self._refresh_due and now - self._refresh_s > self._ask_every_s:  # until it answers: the first may be lost
            self._refresh_s, self._refresh_ns = now, stamp_ns(stats.sim_time)
            self._ask("scene_info", "", number=self._number + 1)
        return self._pause(stats)

    def _ask(self, what: str, data: str, *, number: int | None = None) -> None:
        ask = classic().Request(id=self._number if number is None else number, request=what, data=data)
        self._peer.publish(f"/gazebo/{self.world}/request", ask)

    def _answer(self, message: Any) -> ModelPose | Notice | None:
        if message.request == "scene_info":
            names = [model.name for model in classic().Scene.FromString(message.serialized_data).model]
            return Notice(f"no model {self._model!r} in gzserver (there are {', '.join(names[:12])})")
        if message.type != f"{CLASSIC}.Model":
            return self._absent()
        model = classic().Model.FromString(message.serialized_data)
        if self._rays:
            return self._sensors(model)
        asked_ns, self._asked_ns, self._known = self._asked_ns, None, True
        return None if asked_ns is None else self._seen(max(asked_ns - STILL_NS, 0), model.pose)

    def _absent(self) -> Notice | None:
        if self._known:
            self._known = False
            return self._model_gone()
        self._ask("scene_info", "")
        return None

    def _sensors(self, model: Any) -> Notice | None:
        """Subscribe to the topics of the ray sensors on any link of the model."""
        found = ray_sensors(model.link)
        wanted, missing = matching(self._rays, found)
        for name in wanted:
            topic = f"/gazebo/{self.world}/{found[name]}/scan"
            self._scans[topic] = name
            self._peer.subscribe(topic, f"{CLASSIC}.LaserScanStamped")
        if missing:
            names = ", ".join(found) or "none"
            absent = ", ".join(map(repr, missing))
            return Notice(f"no ray sensor {absent} on {self._model!r} (there are {names})")
        return None

    def _silence(self) -> str:
        host, port = self._classic.master
        return f"no gzserver at {host}:{port}" if not self._there else f"gzserver at {host}:{port} says nothing"

    def _radar_topics(self) -> RadarTopics:
        return RadarTopics(self._peer, f"/gazebo/{self.world}/{self._model}", CLASSIC)


def ray_sensors(links: Iterable[Any]) -> dict[str, str]:
    """Return the paths of a model's ray sensors by name; a name on several links gets its link as prefix (`arm/front`).

    Args:
        links: links in gzserver's message of the model.
    """
    placed = [(link.name, sensor.name) for link in links for sensor in link.sensor if sensor.type in RAY_TYPES]
    count = Counter(name for _, name in placed)
    return {
        name if count[name] == 1 else f"{link.rpartition('::')[2]}/{name}": f"{link.replace('::', '/')}/{name}"
        for link, name in placed
    }


def open_source(address: str, options: dict[str, Any], *, log: Log | None = None) -> CosimulationSource | ScanSource:
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
