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
from ullage.ports.cosimulation import CosimulationSource, world_and_rig
from ullage.ports.intake import Log, checked_pose
from ullage.ports.live import options_of
from ullage.ports.pose_events import EventFeed, ModelPose, Notice
from ullage.ports.protocol import Passed
from ullage.ports.publisher import Publisher, shifted
from ullage.ports.ros2.incoming import Transforms
from ullage.ports.ros2.middleware import SEARCH_S, Peer, Received
from ullage.ports.ros2.options import PoseOptions, SimulateOptions
from ullage.world.scene import Scene


class PoseFeed(EventFeed):
    """Feed of a vehicle's poses from a topic.

    Args:
        peer: the node.
        options: names the topic.
    """

    def __init__(self, peer: Peer, options: PoseOptions) -> None:
        super().__init__(peer)
        self._peer, self._options = peer, options
        self._topic, self._kind = peer.resolved(options.pose), ""
        self._transforms = Transforms()
        self.newest_ns = 0
        peer.claim(self._topic)
        peer.spin()

    def next(self, timeout_s: float) -> ModelPose | Notice | None:
        """Return the next pose or notice, or None if none came within the timeout."""
        for kind in self._peer.appeared([self._topic]).values():
            return self._begin(kind)
        found: ModelPose | Notice | None = super().next(timeout_s if self._kind else min(timeout_s, SEARCH_S))
        return found

    def _begin(self, kind: str) -> Notice:
        if kind not in PLACING:
            raise InputError(f"{self._topic} carries {kind}", where="pose", allowed=", ".join(PLACING))
        self._kind = kind
        self._peer.receive(self._topic, kind, "transforms" if kind == ros.TRANSFORMS else "sensor", depth=500)
        if kind == ros.TRANSFORMS:
            self._peer.listen("/tf_static", kind, "latched", self._fixed, depth=100)
        return Notice(f"poses come on {self._topic}")

    def _take(self, event: Received) -> ModelPose | None:
        self._last_s = time.monotonic()
        self._ready += self._read(event.data)
        return self._ready.pop() if self._ready else None

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
        if self._kind == ros.TRANSFORMS:
            return self._from_transforms(self._add(data))
        (found,) = placements_in(self._kind, data)
        return self._valid_pose(found.t_ns, found.position, found.quat_xyzw)

    def _from_transforms(self, stamps: list[int]) -> list[ModelPose]:
        out = []
        for t_ns in dict.fromkeys(stamps):
            answer = self._transforms.at(self._options.map, self._options.frame_prefix + self._options.body, t_ns)
            if answer.pose is not None:
                x, y, z = answer.pose[:3, 3].tolist()
                out += self._valid_pose(t_ns, (x, y, z), tuple(matrix_quat(answer.pose[:3, :3]).tolist()))
        return out

    def _valid_pose(self, t_ns: int, at: tuple[float, float, float], turn: Any) -> list[ModelPose]:
        pose = checked_pose(at, turn)
        if isinstance(pose, str):
            self.counters.drop(self._topic, "bad", pose)
            return []
        self.newest_ns = t_ns
        x, y, z, w = pose[1].tolist()
        return [ModelPose(t_ns, at, (x, y, z, w))]

    def _silence(self) -> str:
        if self._kind:
            return f"no poses on {self._topic} any more; waiting (Ctrl-C ends)"
        fitting = [name for name, kind in self._peer.topics().items() if kind in PLACING]
        return f"nobody publishes {self._topic}; pose=TOPIC could be {', '.join(fitting) or 'none that is there'}"

    def close(self) -> None:
        """Leave the network after all reliable messages have arrived."""
        self._peer.settle(1.0)
        super().close()


class RobotFeed(PoseFeed):
    """Feed of a vehicle's poses, with frames published back.

    Args:
        peer: the node.
        options: names the topic.
        scene: the world, published once for viewers.
    """

    _options: SimulateOptions

    def __init__(self, peer: Peer, options: SimulateOptions, scene: Scene) -> None:
        super().__init__(peer, options)
        self._publisher = Publisher(frame_prefix=options.frame_prefix)
        self._scene: Scene | None = scene

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Publish frames on the clock of the poses."""
        parts = {part.sensor: shifted(part, -offset_ns) for part in sensors_of(chunk)}
        items: list[Any] = [parts] if self._scene is None else [parts, self._scene]
        self._scene = None
        for item in items:
            for message in self._publisher.messages(item):
                if message.topic in ("odom", "truth/odom", "path") or (message.topic == "/tf" and not self._moves()):
                    continue  # the robot publishes these itself
                if self._peer.send(message):  # a `--to ros2:` sink then does not publish it again
                    self._peer.claim(self._peer.resolved(message.topic))

    def pass_on(self, item: Passed) -> None:
        """Publish a message as it is."""
        for message in self._publisher.messages(item):
            self._peer.send(message)

    def _moves(self) -> bool:
        """Whether to publish the transform of the body."""
        if self._options.tf == "auto":  # another node that publishes this frame keeps it in any case
            return self._kind != ros.TRANSFORMS
        return self._options.tf == "on"


def open_poses(namespace: str, options: dict[str, Any]) -> PoseFeed:
    """Poses of a vehicle from a topic: `ros2:NAMESPACE?pose=TOPIC`.

    Raises:
        InputError: an option is unknown or of no use.
        MissingExtra: there is no rclpy.
    """
    chosen = options_of(PoseOptions, options, f"ros2:{namespace}")
    return PoseFeed(Peer(namespace, chosen), chosen)


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
        scene, rig = world_and_rig(options.simulate or options.world, options, where=where)
        made = peer or Peer(namespace, options)
        super().__init__(lambda: RobotFeed(made, options, scene), scene, rig, options, log=log)
