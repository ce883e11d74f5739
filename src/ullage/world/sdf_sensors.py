"""Radars that an SDF file declares on its models, as rigs.

In a link, `<sensor type="custom" gz:type="ullage_radar">`, as gz-sim has sensors of others' making; or any sensor that
holds an `<ullage:radar>`, as a lidar that the radar stands beside; or an `<ullage:radar>` alone, which Gazebo Classic
and URDF take too. Pose and update_rate are the sensor's; a `<ray>` or `<lidar>` block sets the fan, range and noise of
the thesis' model [Billdal2018, ch. 4]; `<ullage:radar>` holds any field of RadarSpec by name, with groups of fields
nested, and `<preset>`.

A ray sensor of 360 deg that holds several `<ullage:radar>` is the thesis' ring (fig. 4.6). Each radar has the section
of its rays about the heading of its own `<pose>`, as wide as the ring is high unless its `<fov_deg>` differs. In a file
that declares no radar at all, each ray or lidar sensor is one, with the fan of its rays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from lxml import etree

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.fan import FULL_DEG
from ullage.geometry import invert, transform
from ullage.specs import MountSpec, RadarSpec, Rig
from ullage.world.sdf_frames import ScopeFrames
from ullage.world.sdf_parse import Node, read_pose
from ullage.world.sdf_tree import Frame

KIND = "ullage_radar"
RAY_TYPES = ("ray", "gpu_ray", "lidar", "gpu_lidar")


def rigs_of(world: ScopeFrames) -> dict[str, Rig]:
    """The radars of each model by its name (`outer::inner` for nested ones), mounted in the model's frame.

    Raises:
        InputError: the declaration of a radar is not valid.
    """
    return _rigs(world, _declared)


def ray_rigs_of(world: ScopeFrames) -> dict[str, Rig]:
    """The ray and lidar sensors of each model as radars; those that cast a single row of rays are left out."""
    return _rigs(world, _ray_sensors)


def _rigs(world: ScopeFrames, found_in: Callable[[ScopeFrames, Floats], Iterator[_Found]]) -> dict[str, Rig]:
    out = {}
    for name, frames in _models(world, ""):
        sensors: dict[str, RadarSpec] = {}
        home = invert(frames.world_from_scope())
        for found in (one for part in frames.parts() for one in found_in(part, home)):
            called = found.name or "radar"
            sensors[called if called not in sensors else f"{found.link.name}::{called}"] = _radar(found)
        if sensors:
            out[name] = Rig(sensors=sensors)
    return out


class _Found(NamedTuple):
    """A radar of a link."""

    sensor: Node  # `<sensor>`, or `<ullage:radar>` alone
    settings: Node | None  # `<ullage:radar>`
    model_from_sensor: Floats
    link: Frame
    sensor_from_radar: Floats | None = None  # of one of several radars that share the rays of the sensor

    @property
    def name(self) -> str:
        """Its name as it is written."""
        own = self.sensor_from_radar is not None and self.settings is not None
        return (self.settings if own and self.settings is not None else self.sensor).attribute("name")


def _radar(found: _Found) -> RadarSpec:
    """Return the radar that a sensor declares."""
    node, values = found.sensor, dict[str, Any]()
    settings = {} if found.settings is None else _values(found.settings)
    settings.pop("update_rate", None)
    rate = node.number("update_rate", 0.0)
    if rate > 0:
        values["fps"] = rate
    fan, ahead_rad = _fan(node)
    sensor_from_radar = transform((0, 0, 0), (0, 0, ahead_rad))
    if found.sensor_from_radar is not None:
        sensor_from_radar = found.sensor_from_radar
        fan = _section(node, fan, ahead_rad, sensor_from_radar)
    values["mount"] = _mount(found.model_from_sensor @ sensor_from_radar)
    preset = settings.pop("preset", "x4m05")
    if fan or "thesis" in settings:
        values["thesis"] = fan | (settings.pop("thesis", None) or {})
    place = (found.settings or node).place
    try:
        return RadarSpec.preset(preset, **values | settings)
    except InputError as error:
        place.refuse(f"radar {found.name!r}: {error.what}", allowed=error.allowed)


def _section(node: Node, fan: dict[str, Any], middle_rad: float, sensor_from_radar: Floats) -> dict[str, Any]:
    """The fan of one of several radars that share the rays of a sensor."""
    if fan.get("fov_deg") != FULL_DEG or sensor_from_radar[2, 2] < 1 - 1e-6:
        node.place.refuse(
            f"several radars in sensor {node.attribute('name')!r}",
            allowed="one; or rays over 360 deg that they share, each turned by its yaw only",
        )
    heading_rad = math.atan2(sensor_from_radar[1, 0], sensor_from_radar[0, 0])
    start = round(math.degrees(middle_rad - heading_rad) - 180.0, 9)
    up = fan.pop("elevation_deg")
    return fan | {"ring_rays": fan["rays_per_side"], "ring_start_deg": start, "rays_per_side": fan.pop("rays_up"),
                  "fov_deg": up}  # fmt: skip


def _models(frames: ScopeFrames, outer: str) -> Iterator[tuple[str, ScopeFrames]]:
    for inner in (one for part in frames.parts() for one in part.inner.values() if not one.scope.merged):
        name = f"{outer}::{inner.scope.name}" if outer else inner.scope.name
        yield name, inner
        yield from _models(inner, name)


def _declared(frames: ScopeFrames, model_from_world: Floats) -> Iterator[_Found]:
    """Each radar that is declared in the links of a model."""
    for link in frames.scope.links:
        for sensor in link.node.children("sensor"):
            own = list(sensor.ours("radar"))
            if not own and _custom_type(sensor) != KIND:
                continue
            place = _place(frames, model_from_world, link, sensor)
            if len(own) < 2:
                yield _Found(sensor, own[0] if own else None, place, link)
            for radar in own if len(own) > 1 else ():
                yield _Found(sensor, radar, place, link, read_pose(radar).matrix)
        for alone in link.node.ours("radar"):
            yield _Found(alone, alone, _place(frames, model_from_world, link, alone), link)


def _ray_sensors(frames: ScopeFrames, model_from_world: Floats) -> Iterator[_Found]:
    """Each ray sensor in the links of a model whose fan a radar can have."""
    for link in frames.scope.links:
        for sensor in link.node.children("sensor"):
            if sensor.attribute("type") not in RAY_TYPES:
                continue
            found = _Found(sensor, None, _place(frames, model_from_world, link, sensor), link)
            with suppress(InputError):  # a scanner of one row, or of more rays than a radar has
                _radar(found)
                yield found


def _place(frames: ScopeFrames, model_from_world: Floats, link: Frame, node: Node) -> Floats:
    """The transform from a sensor to its model."""
    pose = frames.scope_from_pose(read_pose(node), link.name, at=node.place)
    return model_from_world @ frames.world_from_scope() @ pose


def _custom_type(node: Node) -> str:
    """The type that a sensor of type custom has beyond that: gz:type, ignition:type, with or without a namespace."""
    if node.attribute("type") != "custom":
        return ""
    found = [value for key, value in node.element.attrib.items() if key.endswith(("}type", ":type"))]
    return str(found[0]).strip() if found else ""


def _values(node: Node) -> dict[str, Any]:
    """Children by name: text, or what they hold where they hold elements; `none` stands for nothing."""
    out: dict[str, Any] = {}
    for child in node.element.iterchildren(etree.Element):
        name = str(child.tag).rpartition("}")[2].rpartition(":")[2]
        inner = Node(child, node.file)
        if name not in ("pose", "ray", "lidar"):
            out[name] = _values(inner) if len(child) else None if inner.text == "none" else inner.text
    return out


def _fan(node: Node) -> tuple[dict[str, Any], float]:
    """Settings of the thesis' model in a `<ray>` or `<lidar>` block, if any, and where the fan's middle is [rad]."""
    block = node.child("ray") or node.child("lidar")
    if block is None:
        return {}, 0.0
    scan, reach = block.need("scan"), block.child("range")
    across, up = _axis(scan.need("horizontal")), _axis(scan.child("vertical") or scan.need("horizontal"))
    if min(across.rays, up.rays) < 2 or min(across.opening_deg, up.opening_deg) <= 0 or abs(up.middle_rad) > 1e-3:
        sides = " and ".join(f"{one.rays} rays over {one.opening_deg:.4g} deg" for one in (across, up))
        scan.place.refuse(f"a fan of {sides}", allowed="two rays or more across and up, as far up as down")
    full = across.opening_deg > FULL_DEG - 1e-2
    out: dict[str, Any] = {
        "rays_per_side": across.rays - full,  # the last ray of a full circle is the first one again
        "fov_deg": FULL_DEG if full else across.opening_deg,
        "rays_up": up.rays, "elevation_deg": up.opening_deg,
    }  # fmt: skip
    if not full and across.rays == up.rays and abs(across.opening_deg - up.opening_deg) < 0.05:
        del out["rays_up"], out["elevation_deg"]
    if reach is not None:
        out |= {"min_range_m": reach.number("min", 0.0), "max_range_m": reach.number("max", 10.0)}
    noise = block.child("noise")
    if noise is not None:
        out["noise_sigma"] = noise.number("stddev", 0.0)
    return out, across.middle_rad


class _Axis(NamedTuple):
    """Rays across or up."""

    rays: int
    opening_deg: float
    middle_rad: float


def _axis(node: Node) -> _Axis:
    low, high = node.number("min_angle", 0.0), node.number("max_angle", 0.0)
    count = round(node.number("samples", 1.0) * node.number("resolution", 1.0))
    return _Axis(count, math.degrees(high - low), (low + high) / 2)


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
