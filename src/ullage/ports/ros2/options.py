"""Options of `ros2:NAMESPACE?key=value`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ullage.ports.cosimulation import CosimulationOptions
from ullage.ports.intake import LiveOptions
from ullage.specs import Spec


class NodeOptions(Spec):
    """Options of every node of ullage."""

    domain: int | None = Field(None, ge=0, le=232, description="ROS domain; none: ROS_DOMAIN_ID")
    node: str = Field("ullage", pattern=r"^[A-Za-z_]\w*$", description="name of the node")
    remap: str = Field("", description="topics under other names: FROM:=TO, with commas between")
    frame_prefix: str = Field(
        "", pattern=r"^([A-Za-z_][\w/]*)?$", description="before every frame of reference but map, as drone1/"
    )


class SinkOptions(NodeOptions):
    """Options of `--to ros2:`."""

    pace: float = Field(1.0, ge=0, le=1000, description="times real time; 0: as fast as it comes")
    clock: Literal["auto", "on", "off"] = Field(
        "auto", description="publish /clock; auto: unless the stamps are of now"
    )
    clock_hz: float = Field(40.0, gt=0, le=1000, description="rate of /clock, beside the times of the frames")
    map_full_s: float = Field(10.0, gt=0, description="seconds between whole maps; in between come updates")
    linger_s: float = Field(0.0, ge=0, le=86400, description="stay after the end, for those who come late")
    rays: bool = Field(False, description="publish the rays of each radar's ray model as markers, for RViz")
    reliable: bool = Field(False, description="frames and profiles reliable instead of best effort")
    listeners: int = Field(0, ge=0, le=1000, description="wait for so many subscribers of /tf before the first message")


class SourceOptions(NodeOptions, LiveOptions):
    """Options of `ullage run ros2:`."""

    topics: str = Field("", description="RadarFrame, profile or Range topics, with commas; none: found by type")
    poses: Literal["auto", "tf", "message", "none"] = Field(
        "auto", description="auto: those in the frames, else from the transforms"
    )
    odom: str = Field("", description="also take the body's pose from this topic: Odometry or PoseStamped")
    map: str = Field("map", description="frame of reference that the map stands in")
    body: str = Field("base_link", description="frame of reference of the vehicle")
    radar: str = Field("x4m05", description="preset of radars whose topics do not say what they are")
    relay: bool = Field(True, description="pass on what stands under imc/, to_imc/ and desired/")
    patience_s: float = Field(1.0, ge=0, le=60, description="how long frames wait for a late transform")
    batch_s: float = Field(0.02, ge=0, le=10, description="how long frames are gathered before they are passed on")
    duration_s: float | None = Field(None, gt=0, description="ends after this much of the frames' time")
    idle_s: float | None = Field(None, gt=0, description="ends when nothing came for so long")


class PoseOptions(NodeOptions):
    """Options of the poses of a vehicle."""

    pose: str = Field("odom", description="topic of its pose: Odometry, PoseStamped, with covariance, or TFMessage")
    map: str = Field("map", description="frame of reference of the world, where the pose comes from transforms")
    body: str = Field("base_link", description="frame of reference of the vehicle")


class SimulateOptions(CosimulationOptions, PoseOptions):
    """Options of `ullage run ros2:?simulate=WORLD`, besides those of every simulator port."""

    simulate: str = Field("", description="library world or file that the vehicle moves in")
    tf: Literal["auto", "on", "off"] = Field("auto", description="publish /tf; auto: when nobody else does")
