"""Radars on a model of a running Gazebo (gz-sim), in the world that its scene service tells.

The service gives visuals only, so the radar sees these. A world file holds more (collisions, materials).
"""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.ports.cosimulation import CosimulationOptions, CosimulationSource, matching, resolved
from ullage.ports.gazebo.messages import gz
from ullage.ports.gazebo.peer import Event, ProcessLeft, Received, TopicOffered
from ullage.ports.gazebo.topics import Feed, RadarTopics
from ullage.ports.gazebo.transport import TransportPeer
from ullage.ports.intake import PATIENCE_S, Log
from ullage.ports.live import options_of
from ullage.ports.pose_events import ModelPose, Notice, OtherModels, path_through, pose_of, stamp_ns
from ullage.ports.scanning import Scan, ScanSource, scan_of
from ullage.world.load import load_scene
from ullage.world.scene import Scene

WORLD = re.compile(r"/world/([^/]+)/")
SHAPES = {
    0: ("box", ("size",)), 1: ("cylinder", ("radius", "length")), 2: ("sphere", ("radius",)),
    3: ("plane", ("normal", "size")), 10: ("cone", ("radius", "length")), 14: ("capsule", ("radius", "length")),
    15: ("ellipsoid", ("radii",)),
}  # fmt: skip
"""Types of geometry by their numbers: name and sizes, which SDF calls as the message does."""
MESH = 6


def ask_scene(peer: TransportPeer, world: str, *, where: str, patience_s: float = 10.0) -> Scene:
    """Ask a running Gazebo for its scene.

    Args:
        peer: the connection to Gazebo.
        world: Gazebo's name of the world; empty: the first that is found.
        where: for messages.
        patience_s: how long to wait for it [s].

    Raises:
        InputError: Gazebo does not answer, or its scene is not valid.
    """
    name, package = _find(peer, world, time.monotonic() + patience_s)
    allowed = "world=FILE.sdf, or a running Gazebo (GZ_IP, GZ_PARTITION as here)"
    if not name:
        raise InputError(f"no Gazebo heard in {patience_s:g} s", where=where, allowed=allowed)
    kinds = (f"{package}.Empty", f"{package}.Scene")
    raw = peer.request(f"/world/{name}/scene/info", kinds=kinds, timeout_s=patience_s)
    if raw is None:
        raise InputError(f"Gazebo does not tell the scene of {name!r}", where=where, allowed=allowed)
    return scene_of(gz().Scene.FromString(raw), where=where)


def _find(peer: TransportPeer, world: str, end_s: float) -> tuple[str, str]:
    while time.monotonic() < end_s:
        event = peer.wait(0.25)
        found = WORLD.match(event.topic) if isinstance(event, TopicOffered) else None
        if isinstance(event, TopicOffered) and found is not None and world in ("", found[1]):
            return found[1], event.kind.rpartition(".")[0]
    return "", ""


def scene_of(message: Any, *, where: str) -> Scene:
    """Return the scene in a message.

    Raises:
        InputError: a shape is not valid, for example a mesh that is not on the search path.
    """
    with tempfile.TemporaryDirectory(prefix="ullage-scene-") as folder:
        path = Path(folder) / "scene.sdf"
        path.write_text(sdf_of(message), encoding="utf-8")
        try:
            return load_scene(path, origin_m=(0.0, 0.0, 0.0))
        except InputError as error:
            raise InputError(f"Gazebo's scene: {error.what}", where=where, allowed=error.allowed) from None


def sdf_of(message: Any) -> str:
    """Return the message as SDF, with each visual that has a surface as a collision."""
    from jinja2 import Environment, StrictUndefined

    plain = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    page = plain.from_string(Path(__file__).with_name("scene.sdf.jinja").read_text(encoding="utf-8"))
    return page.render(scene=message, SHAPES=SHAPES, MESH=MESH, numbers=_numbers, pose_of=pose_of)


def _numbers(value: Any) -> str:
    """Return a length, some numbers, or the parts of a message of two or three."""
    if isinstance(value, float | tuple):
        return " ".join(map(repr, np.atleast_1d(value).tolist()))
    return " ".join(repr(getattr(value, axis)) for axis in "xyz" if hasattr(value, axis))


POSES = re.compile(r"/world/([^/]+)/(dynamic_pose|pose)/info")
STATS = re.compile(r"/world/([^/]+)/stats")
SCENE = re.compile(r"/world/([^/]+)/scene/info")
FULL_POSES_S = 0.2
"""Time between two reads of the full pose stream while the model is in the stream of moving models [s]."""


class TransportOptions(CosimulationOptions):
    """Options of `gazebo:`."""

    topic: str = Field("", description="topic of the poses; none: /world/WORLD/dynamic_pose/info or pose/info")
    scan_topic: str = Field("", description="topic of the rays; none: the usual one of the model's sensor")
    partition: str | None = Field(None, description="none: GZ_PARTITION, or this host and user")


class TransportFeed(Feed):
    """What gz-sim's pose streams tell.

    Args:
        peer: the connection to Gazebo.
        options: name the model and its topics.
        world: Gazebo's name of the world; empty: the first that gives poses.
        mounts: model_from_sensor (4, 4) of its ray sensors by name.
        others: names of the world's other models.
    """

    server = "Gazebo"

    def __init__(
        self, peer: TransportPeer, options: TransportOptions, world: str, mounts: Mapping[str, Floats],
        others: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        super().__init__(peer, options, world, others, patience_s=PATIENCE_S)
        self._transport, self._options, self._mounts = peer, options, mounts
        self._roaming: set[str] = set()  # models that the stream of moving models had
        self._full_poses_s = 0.0
        self._package = "gz.msgs"
        self._servers: set[str] = set()  # processes that publish poses
        self._dynamic = False  # the model is in the stream of moving models
        self._missed_s: float | None = None
        self._at: ModelPose | None = None
        if options.topic:
            peer.subscribe(options.topic)

    def _take(self, event: Event) -> ModelPose | OtherModels | Scan | Notice | None:
        if isinstance(event, TopicOffered):
            return self._met(event)
        if isinstance(event, ProcessLeft):
            return self._lost(event)
        return self._read(event) if isinstance(event, Received) else None

    def _read(self, event: Received) -> ModelPose | OtherModels | Scan | Notice | None:
        if event.topic in self._scans:
            return self._scan(event)
        if STATS.fullmatch(event.topic):
            return self._pause(gz().WorldStatistics.FromString(event.data))
        if SCENE.fullmatch(event.topic):
            names = (model.name for model in gz().Scene.FromString(event.data).model)
            return OtherModels(self.newest_ns, new=self._new_models(names))
        found = self._pose(event)
        if self._rays and isinstance(found, ModelPose):
            self._at = found
            return None
        return found

    def _scan(self, event: Received) -> Scan | None:
        """Return a scan at the last pose of the model."""
        message = gz().LaserScan.FromString(event.data)
        if self._at is None:
            self.counters.drop(event.topic, "no pose", f"nothing told where {self._model!r} is")
            return None
        sensor = self._scans[event.topic]
        model = path_through(None, [(self._at.t_ns, np.array(self._at.position), np.array(self._at.quat_xyzw))])
        mounted = model.mounted(self._mounts[sensor])
        pose = (tuple(mounted.position[0]), tuple(mounted.quat_xyzw[0]))
        return scan_of(message, message.header.stamp, pose, sensor=sensor)

    def _met(self, event: TopicOffered) -> Notice | None:
        if self._rays and (sensor := self._cast_by(event.topic)):
            self._scans[event.topic] = sensor
            self._peer.subscribe(event.topic)
        found = POSES.fullmatch(event.topic)
        ours = event.topic == self._options.topic or (
            found is not None and not self._options.topic and self.world in ("", found[1])
        )
        if not ours:
            return None
        if found is not None:
            self.world = found[1]
            self._peer.subscribe(f"/world/{found[1]}/stats")
            if self._others:
                self._peer.subscribe(f"/world/{found[1]}/scene/info")
        self._package = event.kind.rpartition(".")[0] or self._package
        fresh = not self._servers
        self._servers.add(event.process)
        self._peer.subscribe(event.topic)
        return Notice(f"Gazebo gives poses on {event.topic}") if fresh else None

    def _cast_by(self, topic: str) -> str:
        """Return the name of the ray sensor that publishes this topic; empty: none of ours."""
        if self._options.scan_topic:
            return next(iter(self._mounts)) if topic == self._options.scan_topic else ""
        ours = f"/model/{self._model}/" in topic
        return next((name for name in self._mounts if ours and topic.endswith(f"/sensor/{name}/scan")), "")

    def _lost(self, event: ProcessLeft) -> Notice | None:
        if event.process not in self._servers:
            return None
        self._servers.discard(event.process)
        return None if self._servers else self._server_gone()

    def _pose(self, event: Received) -> ModelPose | Notice | None:
        dynamic = event.topic.endswith("/dynamic_pose/info")
        if self._dynamic and not dynamic and not self._full_poses_due():
            return None
        poses = gz().Pose_V.FromString(event.data)
        self._last_s = time.monotonic()
        t_ns = stamp_ns(poses.header.stamp)
        # reversed, since models come before links and may share names with them
        by_name = {pose.name: pose for pose in reversed(poses.pose)}
        if self._others:
            self._ready.append(self._other_models(event.topic, t_ns, by_name))
        if self._dynamic and not dynamic:
            return None
        if self._model not in by_name:
            return self._missing(poses, dynamic)
        self._missed_s, self._dynamic = None, self._dynamic or dynamic
        return self._seen(t_ns, by_name[self._model])

    def _full_poses_due(self) -> bool:
        due = bool(self._others) and time.monotonic() - self._full_poses_s > FULL_POSES_S
        if due:
            self._full_poses_s = time.monotonic()
        return due

    def _other_models(self, topic: str, t_ns: int, by_name: dict[str, Any]) -> OtherModels:
        """Return the poses of other models and the names of models that left."""
        here = self._others & by_name.keys()
        poses = self._valid_poses(topic, {name: by_name[name] for name in here})
        found = POSES.fullmatch(topic)
        if found is None:  # a custom topic may hold only some models
            return OtherModels(t_ns, poses)
        if found[2] == "dynamic_pose":
            gone = frozenset(self._roaming - here)
            self._roaming |= here
            return OtherModels(t_ns, poses, gone)
        return OtherModels(t_ns, poses, self._others - here)

    def _missing(self, poses: Any, dynamic: bool) -> Notice | None:
        now = time.monotonic()
        if dynamic and not self._dynamic:
            return None  # still models are only in the other stream
        self._missed_s = self._missed_s or now
        if now - self._missed_s < 1.0:
            return None
        if self._known:
            return self._model_gone()
        names = ", ".join(dict.fromkeys(pose.name for pose in poses.pose[:12]))
        return Notice(f"no model {self._model!r} in Gazebo's poses (there are {names})")

    def _on_silence(self) -> Notice | None:
        return None if self._paused else super()._on_silence()

    def _silence(self) -> str:
        what = self._options.topic or f"/world/{self.world or 'WORLD'}/pose/info"
        host, partition = self._transport.host, self._transport.partition
        return f"no poses on {what} (listening on {host}, partition {partition}; start Gazebo with GZ_IP={host})"

    def _radar_topics(self) -> RadarTopics:
        return RadarTopics(self._peer, f"/model/{self._model}", self._package)


def open_source(address: str, options: dict[str, Any], *, log: Log | None = None) -> CosimulationSource | ScanSource:
    """Open radars on a model of a running Gazebo: `gazebo:WORLD?model=NAME`.

    Args:
        address: Gazebo's name of the world; empty: the first world that gives poses.
        options: as `TransportOptions` lists them.
        log: takes lines for the user; None: they become warnings.

    Raises:
        InputError: an option is not valid, or no world is known.
        MissingExtra: pyzmq or protobuf is not installed.
    """
    where = f"gazebo:{address}"
    chosen = options_of(TransportOptions, options, where)
    served: Scene | None = None
    if not chosen.world:
        with TransportPeer(chosen.host, chosen.partition) as peer:
            served = ask_scene(peer, address, where=where)
    chosen, scene, rig = resolved(chosen, where, served)
    named, missing = matching(chosen.rays, rig.sensors)
    if missing:
        allowed = f"a sensor of the world's file that holds <ullage:radar>: {', '.join(rig.sensors)}"
        raise InputError(f"where {missing[0]!r} sits is not known", where=where, allowed=allowed)
    if chosen.scan_topic and len(named) > 1:
        raise InputError(f"one topic for {len(named)} ray sensors", where=where, allowed="scan_topic with one of rays=")
    mounts = {name: rig.sensors[name].mount.body_from_sensor() for name in named}

    def join() -> TransportFeed:
        peer = TransportPeer(chosen.host, chosen.partition)
        return TransportFeed(peer, chosen, address, mounts, frozenset(scene.models))

    if chosen.rays:
        return ScanSource(join, rig, chosen, scene=scene, log=log)
    return CosimulationSource(join, scene, rig, chosen, log=log)
