"""Simulate radars on an external robot: receive its poses and publish the frames of its radars."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

from ullage.data import Frames, sensors_of
from ullage.errors import InputError
from ullage.geometry import matrix_quat
from ullage.ports import schema as ros
from ullage.ports.conversions import PLACING, placements_in
from ullage.ports.cosimulation import CosimulationSource, rig_of, world_of
from ullage.ports.intake import PATIENCE_S, Counters, Inbox, Log, checked_pose, warn
from ullage.ports.pose_events import ModelPose, Notice
from ullage.ports.protocol import Passed
from ullage.ports.publisher import Publisher, shifted
from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import SimulateOptions
from ullage.ports.ros2.transforms import Transforms
from ullage.world.scene import Scene


class PoseFeed:
    """Feed of a vehicle's poses from a topic, with frames published back.

    Args:
        peer: the node.
        options: names the topic.
        scene: the world, published once for viewers.
    """

    def __init__(self, peer: Peer, options: SimulateOptions, scene: Scene) -> None:
        self._peer, self._options = peer, options
        self._topic = peer.resolved(options.pose)
        self._kind = ""
        self.counters = Counters()
        self._inbox: Inbox[bytes] = Inbox(self.counters)
        self._transforms = Transforms()
        self._waiting: list[ModelPose] = []
        self._publisher = Publisher(frame_prefix=options.frame_prefix)
        peer.claim(self._topic)
        self._scene: Scene | None = scene
        self._searched_s = 0.0
        self._last_s = self._logged_s = time.monotonic()
        self.newest_ns = 0
        self._peer.spin()

    @property
    def behind_s(self) -> float:
        """How long the oldest message waits already [s]."""
        return self._inbox.behind_s

    def next(self, timeout_s: float) -> ModelPose | Notice | None:
        """Return the next pose or notice, or None if none came within the timeout."""
        end = time.monotonic() + timeout_s
        while True:
            if not self._kind and (found := self._find_topic()):
                return found
            if self._waiting:
                return self._waiting.pop(0)
            left = end - time.monotonic()
            data = self._inbox.get(max(0.0, min(left, 0.1)))
            if data is None:
                if left <= 0:
                    return self._on_silence() if timeout_s else None
                continue
            self._last_s = time.monotonic()
            self._waiting += self._taken(data)

    def _find_topic(self) -> Notice | None:
        """Subscribe once the topic exists."""
        if time.monotonic() - self._searched_s < 0.2:
            return None
        self._searched_s = time.monotonic()
        kind = self._peer.topics().get(self._topic, "")
        if not kind:
            return None
        if kind not in PLACING:
            raise InputError(f"{self._topic} carries {kind}", where="pose", allowed=", ".join(PLACING))
        self._kind = kind
        quality: Any = "transforms" if kind == ros.TRANSFORMS else "sensor"
        self._peer.listen(self._topic, kind, quality, self._put, depth=500)
        if kind == ros.TRANSFORMS:
            self._peer.listen("/tf_static", kind, "latched", self._fixed, depth=100)
        return Notice(f"poses come on {self._topic}")

    def _put(self, data: bytes) -> None:
        self._inbox.put(data, topic=self._topic, size=len(data))

    def _taken(self, data: bytes) -> list[ModelPose]:
        """Return the poses in a message, and count a message that cannot be read."""
        try:
            return self._read(data)
        except Exception as error:  # a damaged message can raise any error in the decoder
            self.counters.drop(self._topic, "bad", f"cannot be read: {type(error).__name__}")
            return []

    def _fixed(self, data: bytes) -> None:
        with suppress(Exception):
            self._add(data, fixed=True)

    def _add(self, data: bytes, *, fixed: bool = False) -> list[int]:
        stamps = []
        for one in placements_in(ros.TRANSFORMS, data):
            pose = checked_pose(one.position, one.quat_xyzw)
            if isinstance(pose, str):
                self.counters.drop(f"pose of {one.child}", "bad", pose)
                continue
            self._transforms.add(one.parent, one.child, one.t_ns, *pose, fixed=fixed)
            stamps.append(one.t_ns)
        return stamps

    def _read(self, data: bytes) -> list[ModelPose]:
        """Return the poses of the body in a message."""
        if self._kind == ros.TRANSFORMS:
            return self._from_transforms(self._add(data))
        (found,) = placements_in(self._kind, data)
        return self._valid_pose(found.t_ns, found.position, found.quat_xyzw)

    def _from_transforms(self, stamps: list[int]) -> list[ModelPose]:
        out = []
        for t_ns in dict.fromkeys(stamps):
            answer = self._transforms.at(self._options.map, self._options.frame_prefix + self._options.body, t_ns)
            if answer.matrix is not None:
                x, y, z = answer.matrix[:3, 3].tolist()
                out += self._valid_pose(t_ns, (x, y, z), tuple(matrix_quat(answer.matrix[:3, :3]).tolist()))
        return out

    def _valid_pose(self, t_ns: int, at: tuple[float, float, float], turn: Any) -> list[ModelPose]:
        pose = checked_pose(at, turn)
        if isinstance(pose, str):
            self.counters.drop(self._topic, "bad", pose)
            return []
        self.newest_ns = t_ns
        x, y, z, w = pose[1].tolist()
        return [ModelPose(t_ns, at, (x, y, z, w))]

    def _on_silence(self) -> Notice | None:
        now = time.monotonic()
        if now - max(self._last_s, self._logged_s) < PATIENCE_S:
            return None
        self._logged_s = now
        if self._kind:
            return Notice(f"no poses on {self._topic} any more; waiting (Ctrl-C ends)")
        fitting = [name for name, kind in self._peer.topics().items() if kind in PLACING]
        names = ", ".join(fitting) or "none that is there"
        return Notice(f"nobody publishes {self._topic}; pose=TOPIC could be {names}")

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Publish frames on the clock of the poses."""
        parts = {part.sensor: shifted(part, -offset_ns) for part in sensors_of(chunk)}
        items: list[Any] = [parts] if self._scene is None else [parts, self._scene]
        self._scene = None
        for item in items:
            for message in self._publisher.messages(item):
                if message.topic in ("odom", "truth/odom", "path") or (message.topic == "/tf" and not self._moves()):
                    continue  # the robot publishes these itself
                if self._peer.send(message):
                    self._peer.claim(
                        self._peer.resolved(message.topic)
                    )  # a `--to ros2:` sink then does not publish it again

    def pass_on(self, item: Passed) -> None:
        """Publish a message as it is."""
        for message in self._publisher.messages(item):
            self._peer.send(message)

    def _moves(self) -> bool:
        """Whether to publish the transform of the body."""
        if self._options.tf == "auto":  # another node that publishes this frame keeps it in any case
            return self._kind != ros.TRANSFORMS
        return self._options.tf == "on"

    def close(self) -> None:
        """Leave the network after all reliable messages have arrived."""
        self._peer.settle(1.0)
        self._peer.close()


class Ros2Radars(CosimulationSource):
    """Source of simulated frames for a vehicle whose pose comes on a topic; also publishes the frames.

    Args:
        namespace: of its topics.
        options: the world, the pose, the radars.
        log: takes lines for the user; None: they become warnings.
        peer: the node to use; None: one of its own.

    Raises:
        InputError: there is no such world or rig, or an option is of no use.
        MissingExtra: there is no rclpy.
    """

    def __init__(
        self, namespace: str, options: SimulateOptions, *, log: Log | None = None, peer: Peer | None = None
    ) -> None:
        where = f"ros2:{namespace}"
        if not (options.simulate or options.world):
            raise InputError("no world", where=where, allowed="simulate=NAME or simulate=FILE.sdf")
        scene = world_of(options.simulate or options.world, where=where)
        model = options.model or next(iter(scene.rigs), "")
        rig = rig_of(options.rig, scene, model, where=where)
        scene = scene.without(model) if model in scene.rigs else scene
        made = peer or Peer(namespace, options)
        super().__init__(lambda: PoseFeed(made, options, scene), scene, rig, options, log=log or warn)
        self._stopped = False

    def stop(self) -> None:
        """End a stream that runs in another thread."""
        self._stopped = True

    def _over(self) -> bool:
        return self._stopped or super()._over()
