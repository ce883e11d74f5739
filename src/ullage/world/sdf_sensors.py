"""Radars that an SDF file declares on its models, as rigs.

In a link, `<sensor type="custom" gz:type="ullage_radar">`, as gz-sim has sensors of others' making; or any sensor that
holds an `<ullage:radar>`, as a lidar that the radar stands beside; or an `<ullage:radar>` alone, which Gazebo Classic
and URDF take too. Pose and update_rate are the sensor's; a `<ray>` or `<lidar>` block sets the fan, range and noise of
the thesis' model [Billdal2018, ch. 4]; `<ullage:radar>` holds any field of RadarSpec by name, with groups of fields
nested, and `<preset>`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.geometry import invert
from ullage.specs import MountSpec, RadarSpec, Rig
from ullage.world.sdf_frames import ScopeFrames
from ullage.world.sdf_parse import NAMESPACE, Node, read_pose
from ullage.world.sdf_tree import Link

Floats = NDArray[np.float64]
KIND = "ullage_radar"


def rigs_of(world: ScopeFrames) -> dict[str, Rig]:
    """The radars of each model by its name (`outer::inner` for nested ones), mounted in the model's frame.

    Raises:
        InputError: a radar is declared in a way that cannot be.
    """
    out = {}
    for name, frames in _models(world, ""):
        sensors: dict[str, RadarSpec] = {}
        for node, model_from_link, link in _declared(frames):
            spec = read_radar(node).but(mount=_mount(model_from_link))
            called = node.attribute("name") or "radar"
            sensors[called if called not in sensors else f"{link.name}::{called}"] = spec
        if sensors:
            out[name] = Rig(sensors=sensors)
    return out


def read_radar(node: Node) -> RadarSpec:
    """The radar that a `<sensor>` or `<ullage:radar>` describes, with its mount left out.

    Raises:
        InputError: a value of it cannot be.
    """
    values: dict[str, Any] = {}
    ours = node if _is_ours(node.element) else next(_own(node), None)
    told = {} if ours is None else _values(ours)
    told.pop("update_rate", None)
    rate = node.number("update_rate", 0.0)
    if rate > 0:
        values["fps"] = rate
    fan = _fan(node)
    preset = told.pop("preset", "x4m05")
    if fan or "thesis" in told:
        values["thesis"] = fan | (told.pop("thesis", None) or {})
    place = (ours or node).place
    try:
        return RadarSpec.preset(preset, **values | told)
    except InputError as error:
        place.refuse(f"radar {node.attribute('name')!r}: {error.what}", allowed=error.allowed)


def _models(frames: ScopeFrames, outer: str) -> Iterator[tuple[str, ScopeFrames]]:
    for inner in frames.inner.values():
        if inner.scope.merged:
            continue
        name = f"{outer}::{inner.scope.name}" if outer else inner.scope.name
        yield name, inner
        yield from _models(inner, name)


def _declared(frames: ScopeFrames) -> Iterator[tuple[Node, Floats, Link]]:
    """Each radar of a model, merged ones with it, and the transform from it to the model."""
    home = invert(frames.world_from_scope())
    yield from _in_links(frames, home)
    for inner in frames.inner.values():
        if inner.scope.merged:
            yield from _in_links(inner, home)


def _in_links(frames: ScopeFrames, model_from_world: Floats) -> Iterator[tuple[Node, Floats, Link]]:
    model_from_here = model_from_world @ frames.world_from_scope()
    for link in frames.scope.links:
        every = link.node.children("sensor")
        sensors = [s for s in every if _custom_type(s) == KIND or next(_own(s), None) is not None]
        for node in [*sensors, *_own(link.node)]:
            yield node, model_from_here @ frames.scope_from_pose(read_pose(node), link.name, at=node.place), link


def _custom_type(node: Node) -> str:
    """The type that a sensor of type custom has beyond that: gz:type, ignition:type, with or without a namespace."""
    if node.attribute("type") != "custom":
        return ""
    found = [value for key, value in node.element.attrib.items() if key.endswith(("}type", ":type"))]
    return str(found[0]).strip() if found else ""


def _is_ours(element: Any) -> bool:
    tag = str(element.tag)
    return tag in (f"{{{NAMESPACE}}}radar", "ullage:radar") or (element.prefix == "ullage" and tag.endswith("}radar"))


def _own(node: Node) -> Iterator[Node]:
    for child in node.element.iterchildren(etree.Element):
        if _is_ours(child):
            yield Node(child, node.file)


def _values(node: Node) -> dict[str, Any]:
    """Children by name: text, or what they hold where they hold elements; `none` stands for nothing."""
    out: dict[str, Any] = {}
    for child in node.element.iterchildren(etree.Element):
        name = str(child.tag).rpartition("}")[2].rpartition(":")[2]
        inner = Node(child, node.file)
        if name not in ("pose", "ray", "lidar"):
            out[name] = _values(inner) if len(child) else None if inner.text == "none" else inner.text
    return out


def _fan(node: Node) -> dict[str, Any]:
    """Settings of the thesis' model that a `<ray>` or `<lidar>` block tells; empty without one."""
    block = node.child("ray") or node.child("lidar")
    if block is None:
        return {}
    scan, reach = block.need("scan"), block.child("range")
    across = scan.need("horizontal")
    up = scan.child("vertical") or across
    fans = [(_count(axis), axis.number("max_angle", 0.0) - axis.number("min_angle", 0.0)) for axis in (across, up)]
    if fans[0][0] != fans[1][0] or abs(fans[0][1] - fans[1][1]) > 1e-3:
        sides = " and ".join(f"{n} rays over {math.degrees(opening):.4g} deg" for n, opening in fans)
        scan.place.refuse(f"a fan of {sides}", allowed="as many rays over as wide an angle across as up")
    out: dict[str, Any] = {"rays_per_side": fans[0][0], "fov_deg": math.degrees(fans[0][1])}
    if reach is not None:
        out |= {"min_range_m": reach.number("min", 0.0), "max_range_m": reach.number("max", 10.0)}
    noise = block.child("noise")
    if noise is not None:
        out["noise_sigma"] = noise.number("stddev", 0.0)
    return out


def _count(axis: Node) -> int:
    return round(axis.number("samples", 1.0) * axis.number("resolution", 1.0))


def _mount(body_from_sensor: Floats) -> MountSpec:
    turn = body_from_sensor[:3, :3]
    level = math.hypot(turn[0, 0], turn[1, 0])
    pitch = math.atan2(-turn[2, 0], level)
    roll, yaw = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    if level < 1e-9:  # straight up or down: roll and yaw are one
        roll, yaw = 0.0, math.atan2(-turn[0, 1], turn[1, 1])
    x, y, z = (float(value) for value in np.round(body_from_sensor[:3, 3], 12))
    angles = {"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
    return MountSpec(
        position_m=(x, y, z), **{name: round(math.degrees(value), 9) + 0.0 for name, value in angles.items()}
    )
