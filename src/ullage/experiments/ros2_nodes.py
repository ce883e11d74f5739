"""ullage as managed ROS 2 nodes: `radar_simulator` and `radar_mapping`.

Every option of `ros2:` is a parameter of the same name. Transitions: configure makes the source, activate lets frames
flow, deactivate stops them, cleanup lets go of everything; `autostart` goes through the first two at once.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import Field

from ullage.config import ImageMethod, MapMethod
from ullage.data import Frames
from ullage.errors import InputError, UllageError, need
from ullage.experiments.source_resolution import Begun
from ullage.flow import Stage
from ullage.grids import Grid
from ullage.pipeline import DetectStage, ImageStage, MapStage, run
from ullage.ports.live import options_of
from ullage.ports.ros2.cosimulation import Ros2Radars
from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import NodeOptions, SimulateOptions, SinkOptions, SourceOptions
from ullage.ports.ros2.sink import Ros2Sink
from ullage.ports.ros2.source import Ros2Source
from ullage.processing.own_echo import OwnEchoFilter
from ullage.specs import Spec


class MappingOptions(SourceOptions):
    """Options of `radar_mapping` beside those of every source."""

    step_m: float = Field(0.1, gt=0, description="edge of a cell")
    reach_m: float = Field(10.0, gt=0, description="how far around the first pose the map goes")
    margin_m: float = Field(0.0, ge=0, description="added to reach_m")
    method: MapMethod = Field("ullage", description="ullage, likelihood, or elfes as the thesis had it")
    threshold: float | None = Field(None, gt=0, description="lowest amplitude of an echo; none: the method's own")
    every_s: float = Field(0.2, ge=0.2, le=3600, description="time between two maps or images")
    image: bool = Field(False, description="also focus a SAR image at the height of the first pose")
    image_method: ImageMethod = Field("backprojection", description="backprojection, or summation as the thesis had it")
    image_step_m: float = Field(0.1, gt=0, le=10, description="edge of a cell of the image")
    batch_s: float = Field(0.1, ge=0, le=10, description="how long frames are gathered before they are mapped")


def simulate(source: Any, peer: Peer, options: Spec) -> None:
    """Frames go out where the poses come in; nothing is made of them here."""
    run(source)


def mapping_stages(first: dict[str, Frames], options: MappingOptions) -> list[Stage]:
    """Return the stages of `radar_mapping`: detections, a map and, if asked for, an image about the first pose.

    Args:
        first: the first piece of the stream; without poses there is no map.
        options: of the node.
    """
    own_echo = OwnEchoFilter()  # one for all: its estimate costs as much as the map
    stages: list[Stage] = [DetectStage(threshold=options.threshold, own_echo=own_echo)]
    placed = [part.poses.position[0] for part in first.values() if part.poses is not None]
    if placed:
        reach = options.reach_m + options.margin_m
        grid = Grid.covering(np.stack([placed[0] - reach, placed[0] + reach]), options.step_m)
        stages.append(
            MapStage(grid, options.method, options.threshold, every_s=options.every_s, live=True, own_echo=own_echo)
        )
        if options.image:
            box = np.stack([placed[0] - reach, placed[0] + reach])
            plane = Grid.covering(box, options.image_step_m, z_m=float(placed[0][2]))
            stages.append(ImageStage(plane, options.image_method, every_s=options.every_s, own_echo=own_echo))
    return stages


def map_frames(source: Any, peer: Peer, options: Spec) -> None:
    """Detections and a map of frames that come on topics, published."""
    if not isinstance(options, MappingOptions):
        raise InputError("not the options of radar_mapping", where="map_frames")
    begun = Begun(source, wait=True)
    if begun.first:
        how = SinkOptions(pace=0, clock="off", node=options.node, frame_prefix=options.frame_prefix)
        run(begun, stages=mapping_stages(begun.first, options), sinks=[Ros2Sink("", how, peer=peer)])


NODES: dict[str, tuple[type[NodeOptions], Callable[..., Any], Callable[..., None]]] = {
    "radar_simulator": (SimulateOptions, Ros2Radars, simulate),
    "radar_mapping": (MappingOptions, Ros2Source, map_frames),
}
"""Options, source and work of each node."""
NOT_PARAMETERS = {"domain", "node", "host", "remap"}  # ROS has its own words for these


class Work:
    """A source and the thread in which its frames flow; what a managed node does, without the node.

    Args:
        name: of `NODES`.
        node: whose parameters are the options.
    """

    def __init__(self, name: str, node: Any) -> None:
        self._name, self._node = name, node
        self._thread: threading.Thread | None = None
        self._source: Any = None

    def prepare(self) -> bool:
        """Make the source; whether the parameters allow it, else the reason is logged."""
        kind, make, _ = NODES[self._name]
        try:
            self._options = read(self._node, kind)
            self._peer = Peer("", self._options, node=self._node)
            self._source = make("", self._options, log=self._node.get_logger().info, peer=self._peer)
        except UllageError as error:
            self._node.get_logger().error(str(error))
            return False
        return True

    def begin(self) -> None:
        """Let frames flow."""
        self._thread = threading.Thread(target=self._flow, name=self._name, daemon=True)
        self._thread.start()

    def _flow(self) -> None:
        try:
            NODES[self._name][2](self._source, self._peer, self._options)
        except UllageError as error:
            self._node.get_logger().error(str(error))
        except Exception as error:
            if self._node.context.ok():
                self._node.get_logger().error(f"{type(error).__name__}: {error}")

    def halt(self) -> None:
        """Stop the stream and close the source."""
        if self._source is not None:
            self._source.stop()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
            self._thread = None
        if self._source is not None:
            self._source.close()
            self._source = None


def make_node(name: str) -> Any:
    """Return the managed node of this name.

    Raises:
        MissingExtra: there is no rclpy.
    """
    need("rclpy", extra="ros2")
    from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

    fine, refused = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE

    class Managed(LifecycleNode):  # type: ignore[misc]
        """Managed node that works while it is active; configure it again after deactivation."""

        def __init__(self) -> None:
            super().__init__(name)
            declare(self, NODES[name][0])
            self.work = Work(name, self)

        def on_configure(self, state: Any) -> Any:
            return fine if self.work.prepare() else refused

        def on_activate(self, state: Any) -> Any:
            self.work.begin()
            return super().on_activate(state)

        def on_deactivate(self, state: Any) -> Any:
            self.work.halt()
            return super().on_deactivate(state)

        def on_cleanup(self, state: Any) -> Any:
            self.work.halt()
            return fine

        on_shutdown = on_cleanup

    return Managed()


def declare(node: Any, kind: type[NodeOptions]) -> None:
    """Each option as a parameter; those without a value as an empty text."""
    from rcl_interfaces.msg import ParameterDescriptor

    for name, field in kind.model_fields.items():
        if name not in NOT_PARAMETERS:
            about = ParameterDescriptor(description=field.description or name, dynamic_typing=True)
            node.declare_parameter(name, "" if field.default is None else field.default, about)
    node.declare_parameter("autostart", True)


def read(node: Any, kind: type[NodeOptions]) -> Any:
    """Read the options from the parameters.

    Raises:
        InputError: one is of no use.
    """
    message = {name: node.get_parameter(name).value for name in kind.model_fields if name not in NOT_PARAMETERS}
    given = {name: value for name, value in message.items() if value != "" and value is not None}
    return options_of(kind, given | {"node": node.get_name()}, node.get_name())


def main(name: str, words: list[str] | None = None) -> int:
    """Run a node until it is asked to end.

    Args:
        name: of `NODES`.
        words: of the command line, with --ros-args; None: this program's.
    """
    rclpy: Any = need("rclpy", extra="ros2")
    from rclpy.executors import ExternalShutdownException

    rclpy.init(args=words)
    node = None
    try:
        node = make_node(name)
        if node.get_parameter("autostart").value:
            node.trigger_configure()
            node.trigger_activate()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        if rclpy.ok():  # otherwise a signal ended the context while the node started, and rclpy stumbled over that
            raise
    finally:
        if node is not None:
            node.work.halt()
        if rclpy.ok():
            if node is not None:
                node.destroy_node()
            rclpy.shutdown()
    return 0


def radar_simulator() -> int:
    """Entry point of the package ullage_ros."""
    return main("radar_simulator")


def radar_mapping() -> int:
    """Entry point of the package ullage_ros."""
    return main("radar_mapping")


if __name__ == "__main__":
    import sys

    raise SystemExit(main(sys.argv[1], sys.argv[1:]))
