"""What `ros2:NAMESPACE?key=value` can be told."""

from __future__ import annotations

from typing import Any, Literal, TypeVar

from pydantic import Field

from ullage.errors import InputError
from ullage.specs import Spec


class NodeOptions(Spec):
    """What every node of ullage is told."""

    domain: int | None = Field(None, ge=0, le=232, description="ROS domain; none: ROS_DOMAIN_ID")
    node: str = Field("ullage", pattern=r"^[A-Za-z_]\w*$", description="name of the node")


class SinkOptions(NodeOptions):
    """What `--to ros2:` is told."""

    pace: float = Field(1.0, ge=0, le=1000, description="times real time; 0: as fast as it comes")
    clock: Literal["auto", "on", "off"] = Field("auto", description="publish /clock; auto: when the stamps are not now")
    clock_hz: float = Field(100.0, gt=0, le=1000, description="rate of /clock while time passes evenly")
    map_full_s: float = Field(10.0, gt=0, description="seconds between whole maps; in between come updates")
    linger_s: float = Field(0.0, ge=0, le=86400, description="stay after the end, for those who come late")
    reliable: bool = Field(False, description="frames and profiles reliable instead of best effort")


Options = TypeVar("Options", bound=NodeOptions)


def read_options(kind: type[Options], options: dict[str, Any]) -> Options:
    """Checked options.

    Raises:
        InputError: one is unknown, or of no use.
    """
    if unknown := sorted(options.keys() - kind.model_fields.keys()):
        raise InputError(f"no option {unknown[0]!r}", where="ros2:", allowed=", ".join(kind.model_fields))
    try:
        return kind(**options)
    except InputError as error:
        raise InputError(error.what, where="ros2:") from None
