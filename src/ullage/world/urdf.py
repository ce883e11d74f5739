"""URDF: the robot is rewritten as an SDF model whose links stand where yourdfpy's kinematics puts them.

So names, materials, wires and refusals are those of SDF. A `<laserRetro>` or a radar's `<sensor>` in
`<gazebo reference="LINK">`, and an `<ullage:material>` in a link, visual or collision count as in SDF.
"""

from __future__ import annotations

import copy
import io
import logging
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from lxml import etree

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import matrix_quat, transform
from ullage.world.sdf_parse import EARTH_M, Node

_NAMES = """
acceleration actuator axis box calibration capsule child collision color contact cylinder dynamics effort gazebo
geometry group_name hardwareInterface inertia inertial joint leftActuator limit link mass material
mechanicalReduction mesh mimic origin parent rightActuator robot role ros2_control safety_controller
self_collision_checking simulated_actuated_joint sphere texture transmission type verbose visual
"""
KNOWN = frozenset(_NAMES.split())
_NEEDED = {"box": ("size",), "capsule": ("radius", "length"), "cylinder": ("radius", "length"), "sphere": ("radius",)}


def sdf_of_urdf(robot: Node, joints: Mapping[str, float]) -> Node:
    """Rewrite a robot as SDF with one model.

    Args:
        robot: the `<robot>`.
        joints: joint values [rad or m]; those not named are at zero.

    Returns:
        The `<sdf>`, of the robot's name.

    Raises:
        InputError: a link or joint is not valid, or there is no such joint.
    """
    _check(robot)
    poses, retros = _link_poses(robot, joints), _retros(robot)
    name = robot.attribute("name") or robot.file.stem
    root, model = _like("sdf", robot, version="1.12", name=name), _like("model", robot, name=name)
    root.append(model)
    model.extend(copy.deepcopy(tag) for tag in robot.element if _ours(tag))
    for link in robot.children("link"):
        made = _sdf_link(link, retros)
        made.insert(0, _pose_at(poses[link.name], link))
        made.extend(copy.deepcopy(sensor) for sensor in _sensors(robot, link.name))
        model.append(made)
    return Node(root, robot.file)


def _check(root: Node) -> None:
    """Joints make one tree of the links that are there."""
    links: dict[str, Node] = {}
    for link in root.children("link"):
        if link.name in links:
            link.place.refuse(f"a second link {link.name!r}")
        links[link.name] = link
    if not links:
        root.place.refuse("the robot has no links")
    above: dict[str, str] = {}
    for joint in root.children("joint"):
        parent, child = (joint.need(tag).attribute("link") for tag in ("parent", "child"))
        for name in (parent, child):
            if name not in links:
                joint.place.refuse(f"joint {joint.name!r} names no link {name!r}", allowed=", ".join(list(links)[:12]))
        if child in above:
            joint.place.refuse(f"link {child!r} is the child of two joints")
        above[child] = parent
        ring = [child]
        while ring[-1] in above:
            ring.append(above[ring[-1]])
            if ring[-1] == child:
                joint.place.refuse("the joints go in a circle: " + " -> ".join(ring))
        _origin(joint)
    loose = sorted(set(links) - set(above))
    if len(loose) > 1:
        root.place.warn(f"no joint leads to {', '.join(loose[1:5])}; placed at the root, as {loose[0]} is")
    _warn_unknown(root)


def _warn_unknown(root: Node) -> None:
    reported: set[str] = set()
    for element in root.element.iter(etree.Element):
        name = element.tag
        inside = any(up.tag in ("gazebo", "transmission", "ros2_control") for up in element.iterancestors())
        if not (inside or name in KNOWN or name in reported or ":" in name or element.prefix):
            reported.add(name)
            Node(element, root.file).place.warn(f"<{name}> is not a URDF element; it is passed by")


def _link_poses(root: Node, joints: Mapping[str, float]) -> dict[str, Floats]:
    """World from each link, by yourdfpy."""
    import yourdfpy

    bare = etree.Element("robot", name=root.attribute("name") or "robot")  # shapes are read here, not by yourdfpy
    for link in root.children("link"):
        etree.SubElement(bare, "link", name=link.name)
    bare.extend(copy.deepcopy(joint.element) for joint in root.children("joint"))
    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)
    try:
        robot = yourdfpy.URDF.load(io.BytesIO(etree.tostring(bare)), load_meshes=False)
        values = dict.fromkeys(robot.actuated_joint_names, 0.0)
        if set(joints) <= set(robot.joint_map):
            robot.update_cfg(values | {name: float(value) for name, value in joints.items()})
        poses = {link.name: np.asarray(robot.get_transform(link.name), float) for link in root.children("link")}
    except Exception as error:  # a malformed joint can raise any error in the reader
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        root.place.refuse(f"the joints cannot be read: {reason}")
    if unknown := set(joints) - set(robot.joint_map):
        raise InputError(f"no joint {min(unknown)!r}", where=root.file, allowed=", ".join(robot.actuated_joint_names))
    if bad := next((name for name, pose in poses.items() if not np.isfinite(pose).all()), None):
        root.place.refuse(f"the joints put link {bad!r} at no finite place")
    return poses


def _sdf_link(link: Node, retros: Mapping[str, str]) -> Any:
    """The link as SDF writes it, on the same lines."""
    out = _like("link", link, name=link.name)
    out.extend(copy.deepcopy(tag) for tag in link.element if _ours(tag))
    for number, shape in enumerate(link.children("collision", "visual")):
        made = _like(shape.tag, shape, name=shape.attribute("name") or f"{shape.tag}{number}")
        made.append(_pose_at(_origin(shape), shape.child("origin") or shape))
        made.extend(copy.deepcopy(tag) for tag in shape.element if _ours(tag))
        if link.name in retros:
            etree.SubElement(made, "laser_retro").text = retros[link.name]
        made.append(_geometry(shape.need("geometry")))
        out.append(made)
    return out


def _ours(tag: Any) -> bool:
    return bool(tag.prefix == "ullage" or str(tag.tag).startswith("ullage:"))


def _geometry(node: Node) -> Any:
    out = _like("geometry", node)
    for shape in node.children():
        for key in _NEEDED.get(shape.tag, ()):
            if key not in shape.element.attrib:  # SDF has defaults for these, URDF has none
                shape.place.refuse(f"<{shape.tag}> has no <{key}>")
        made = _like(shape.tag, shape)
        if shape.tag == "mesh":
            made.append(_like("uri", shape, shape.attribute("filename")))
            scale = shape.attribute("scale", "1 1 1").split()
            made.append(_like("scale", shape, " ".join(scale * 3 if len(scale) == 1 else scale)))
        else:
            made.extend(_like(key, shape, value) for key, value in shape.element.attrib.items())
        out.append(made)
    return out


def _pose_at(matrix: Floats, place: Node) -> Any:
    values = [*matrix[:3, 3], *matrix_quat(matrix[:3, :3])]
    return _like("pose", place, " ".join(repr(float(value)) for value in values), rotation_format="quat_xyzw")


def _origin(node: Node) -> Floats:
    origin = node.child("origin")
    if origin is None:
        return np.eye(4)
    both = []
    for key in ("xyz", "rpy"):
        made = Node(_like(f"{key} of origin", origin, origin.attribute(key, "0 0 0")), node.file)
        both.append(made.numbers(3, most=EARTH_M))
    return transform(*both)


def _like(tag: str, node: Node, text: str | None = None, /, **attributes: str) -> Any:
    """A new element that claims the place of another."""
    out: Any = etree.Element(tag.replace(" ", "-"), attributes)
    out.sourceline, out.text = node.place.line, text
    return out


def _retros(root: Node) -> dict[str, str]:
    found = ((tag, tag.text_of("laserRetro") or tag.text_of("laser_retro")) for tag in root.children("gazebo"))
    return {tag.attribute("reference"): retro for tag, retro in found if retro}


def _sensors(root: Node, link: str) -> Iterator[Any]:
    """The sensors that `<gazebo reference="LINK">` gives a link, and radars of ours."""
    for tag in root.children("gazebo"):
        if tag.attribute("reference") == link:
            yield from (one for one in tag.element if one.tag == "sensor" or _ours(one))
