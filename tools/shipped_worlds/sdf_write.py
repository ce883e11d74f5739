"""Worlds written as SDF 1.7 and OBJ meshes, byte for byte the same every time [SDFormat]."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from shipped_worlds import Model
from ullage.world.sdf_parse import NAMESPACE
from ullage.world.shapes import Shape
from ullage.world.solids import Part, Rod, Solid

RETRO = {
    "steel": 1.0, "pec": 1.0, "aluminium": 1.0, "concrete": 0.5, "wood": 0.3, "glass": 0.4, "plastic": 0.2,
    "rubber": 0.2, "skin": 0.6, "water": 0.8,
}  # fmt: skip
"""Reflection coefficients of the thesis' model; it has none in print but asks for steel strongest, wood weak."""

DIFFUSE = {
    "steel": "0.56 0.64 0.71 1", "concrete": "0.82 0.80 0.76 1", "wood": "0.72 0.55 0.36 1",
    "glass": "0.62 0.83 0.90 0.35", "plastic": "0.93 0.93 0.90 1", "rubber": "0.15 0.15 0.16 1",
    "skin": "0.85 0.62 0.50 1", "water": "0.35 0.50 0.60 1",
}  # fmt: skip

_HEAD = """<?xml version="1.0"?>
<!-- {title}
     Written by `python tools/write_worlds.py`; lengths in metres, x east, y north, z up.
     The radar reads the collision shapes, <ullage:material> and <laser_retro> (the thesis' reflection coefficient). -->
<sdf version="1.7" xmlns:ullage="{namespace}">
  <world name="{name}">
    <gravity>0 0 -9.80665</gravity>
    <light type="directional" name="sun">
      <pose>0 0 30 0 0 0</pose>
      <diffuse>0.9 0.9 0.9 1</diffuse>
      <specular>0.2 0.2 0.2 1</specular>
      <direction>-0.4 0.3 -0.9</direction>
      <cast_shadows>false</cast_shadows>
    </light>
"""


def world_files(name: str, title: str, models: Iterable[Model]) -> dict[str, str]:
    """The text of every file of a world, by its path under the folder of worlds."""
    files: dict[str, str] = {}
    body = [_HEAD.format(title=title, namespace=NAMESPACE, name=name)]
    body += [_model(model, name, files) for model in models]
    body.append("  </world>\n</sdf>\n")
    files[f"{name}.sdf"] = "".join(body)
    return files


def write_worlds(folder: Path, files: dict[str, str]) -> None:
    """Write files, and make the folders for them."""
    for relative, text in sorted(files.items()):
        target = folder / relative
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = target.with_name(f".{target.name}")
        draft.write_text(text, encoding="ascii", newline="\n")
        draft.replace(target)


def _model(model: Model, world: str, files: dict[str, str]) -> str:
    lines = [f"    <model name={quoteattr(model.name)}>", "      <static>true</static>"]
    if any(model.position_m) or model.yaw_deg:
        lines.append(f"      <pose>{_numbers(model.position_m)} 0 0 {_number(math.radians(model.yaw_deg))}</pose>")
    several = len(model.solids) > 1
    for solid in model.solids:
        mesh = f"meshes/{_mesh_name(world, model, solid)}.obj"
        if isinstance(solid, Part):
            files[mesh] = _obj(solid.shape)
            files[_shaded(mesh)] = _obj_with_normals(solid.shape)
        lines += _link(solid.name if several else "link", solid, mesh)
    return "\n".join([*lines, "    </model>\n"])


def _mesh_name(world: str, model: Model, solid: Solid) -> str:
    """Worlds of one family share the meshes of what they share."""
    family = "ntnu" if world.startswith("ntnu") else world.replace("-", "_")
    return f"{family}/{model.name}" if len(model.solids) == 1 else f"{family}/{model.name}_{solid.name}"


def _shaded(mesh: str) -> str:
    """The file for Gazebo's eyes: it lights an OBJ only by normals in it, and those would part shared vertices here."""
    folder, name = mesh.rsplit("/", 1)
    return f"{folder}/shaded/{name}"


def _link(name: str, solid: Solid, mesh: str) -> list[str]:
    pose, geometry = _geometry(solid, mesh)
    _, shaded = _geometry(solid, _shaded(mesh))
    thick = getattr(solid, "thickness_m", None)
    extra = "" if thick is None else f' thickness_m="{_number(thick)}"'
    color = DIFFUSE[solid.material]
    return [
        f"      <link name={quoteattr(name)}>",
        *([f"        <pose>{pose}</pose>"] if pose else []),
        '        <collision name="collision">',
        f"          {geometry}",
        f"          <laser_retro>{_number(RETRO[solid.material])}</laser_retro>",
        f"          <ullage:material{extra}>{solid.material}</ullage:material>",
        "        </collision>",
        '        <visual name="visual">',
        f"          {shaded}",
        f"          <material><ambient>{color}</ambient><diffuse>{color}</diffuse>"
        "<double_sided>true</double_sided></material>",
        "        </visual>",
        "      </link>",
    ]


def _geometry(solid: Solid, mesh: str) -> tuple[str, str]:
    """Pose of the link, empty where it is none, and the geometry element."""
    if isinstance(solid, Part):
        return "", f"<geometry><mesh><uri>{mesh}</uri></mesh></geometry>"
    if isinstance(solid, Rod):
        size = f"<radius>{_number(solid.radius_m)}</radius><length>{_number(solid.length_m)}</length>"
        pose = f"{_numbers(solid.center)} {_numbers(solid.rpy_rad)}"
        return pose, f"<geometry><cylinder>{size}</cylinder></geometry>"
    return f"{_numbers(solid.center)} 0 0 0", f"<geometry><box><size>{_numbers(solid.size)}</size></box></geometry>"


def _number(value: float) -> str:
    return f"{round(float(value), 6) + 0.0:.10g}"


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(v) for v in values)


def _obj(mesh: Shape) -> str:
    vertices, faces = mesh
    points = [f"v {_numbers(point)}" for point in vertices.tolist()]
    triangles = [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return "\n".join([*points, *triangles, ""])


def _obj_with_normals(mesh: Shape) -> str:
    vertices, faces = mesh
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.round(normal / np.linalg.norm(normal, axis=1, keepdims=True), 3) + 0.0
    kinds, which = np.unique(normal, axis=0, return_inverse=True)
    points = [f"v {_numbers(point)}" for point in vertices.tolist()]
    normals = [f"vn {_numbers(kind)}" for kind in kinds.tolist()]
    rows = zip((faces + 1).tolist(), (which.reshape(-1) + 1).tolist(), strict=True)
    triangles = [f"f {a}//{n} {b}//{n} {c}//{n}" for (a, b, c), n in rows]
    return "\n".join([*points, *normals, *triangles, ""])
