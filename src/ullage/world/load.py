"""Worlds and models from files, by their suffix."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ullage import checks
from ullage.config import split_source
from ullage.errors import InputError, UllageWarning, shown
from ullage.untrusted import reading, regular_size
from ullage.world.lengths import LARGEST_M, length
from ullage.world.meshes import FORMATS, read_mesh
from ullage.world.scene import Scene
from ullage.world.sdf_parse import FURTHEST_M
from ullage.world.smoothing import Smooth

MODELS = (".sdf", ".world", ".urdf", ".xacro")
KINDS = (*MODELS, *FORMATS)
"""Suffixes of world files."""
TRUST_XACRO = "ULLAGE_TRUST_XACRO"
"""Environment variable that `--trust-xacro` sets to 1, for this process and its workers."""


def load_scene(
    path: str | Path, *, geometry: Literal["collision", "visual"] = "collision",
    search_path: Sequence[str | Path] = (), missing: Literal["refuse", "skip"] = "refuse", trust_xacro: bool = False,
    origin_m: ArrayLike | None = None, scale: float | None = None, smooth: Smooth | None = None,
) -> Scene:  # fmt: skip
    """Read a world: SDF 1.0 to 1.12, URDF (with xacro), or a bare mesh (.dae .glb .gltf .obj .ply .stl).

    Args:
        path: the file. Arguments of xacro follow a .xacro file: `robot.xacro?name:=value&name:=value`.
        geometry: which shapes of SDF and URDF to take.
        search_path: folders for model://, package:// and relative names, before those of the environment.
        missing: what happens when a model or mesh that the file names is not there: "refuse" the file, or "skip"
            that model or shape with a warning.
        trust_xacro: expand a .xacro file, which may evaluate Python; it runs in a process of its own, with limits.
        origin_m: point of the file (3) that becomes the scene's origin [m]. None: the file's own origin; a world that
            lies more than 100 km from it, as in UTM coordinates, gets one near its centre, with a warning.
        scale: metres in a unit of a bare mesh, which a unit in the file multiplies. None: 1, but 0.001 for an .obj,
            .ply or .stl over 100 units long, with a warning.
        smooth: whether facets stand for curved surfaces, as `Scene.smoothed`; None: what the file says of each object.

    Meshes are repaired: corners in one place become one, faces that coincide one sheet, and faces of closed bodies
    are wound alike. A warning counts what was wrong. Flat faces are cut anew, so that an echo does not depend on how
    the file cuts them.

    Raises:
        InputError: the file, or something that it names, is missing, malformed, too large or out of reach; or it is a
            .xacro file and not trusted.
    """
    name, arguments = split_source(path)
    file = Path(name)
    if geometry not in ("collision", "visual"):
        raise InputError(f"geometry is {geometry!r}", where="load_scene", allowed="collision or visual")
    if missing not in ("refuse", "skip"):
        raise InputError(f"missing is {missing!r}", where="load_scene", allowed="refuse or skip")
    if not os.path.exists(file):
        raise InputError("no such file", where=file)
    regular_size(file, allowed="a world file")
    if scale is not None:
        scale = length("scale", scale, "load_scene")
        if file.suffix.lower() not in FORMATS:
            raise InputError("scale is for a bare mesh", where=file, allowed="<scale> of <mesh> in SDF and URDF")
    with reading(file):
        if file.suffix.lower() in MODELS:
            from ullage.world.sdf import load_sdf

            trusted = trust_xacro or os.environ.get(TRUST_XACRO) == "1"
            xacro = _arguments(arguments[1:], file) if trusted else None
            scene = load_sdf(file, geometry=geometry, search_path=search_path, missing=missing, xacro=xacro)
        elif file.suffix.lower() in FORMATS:
            mesh = read_mesh(file, scale=scale)
            scene = Scene.of_mesh(mesh.vertices, mesh.faces, name=file.stem, corner_normals=mesh.corner_normals)
        else:
            raise InputError(f"a file of unknown kind {file.suffix!r}", where=file, allowed=" ".join(KINDS))
        scene = _about(scene, origin_m, file)
    return scene if smooth is None else scene.smoothed(smooth)


def _arguments(text: str, file: Path) -> dict[str, str]:
    """Read `name:=value&name:=value`."""
    out: dict[str, str] = {}
    for pair in text.split("&") if text else ():
        name, mark, value = pair.partition(":=")
        if not mark or not re.fullmatch(r"[A-Za-z_]\w*", name) or name in out:
            what = f"the argument of xacro {shown(pair)}{' comes twice' * (name in out)}"
            raise InputError(what, where=file, allowed="NAME:=VALUE&NAME:=VALUE, each name once")
        out[name] = value
    return out


def _about(scene: Scene, origin_m: ArrayLike | None, file: Path) -> Scene:
    """The scene about its origin: the given one, or one near the centre along the axes on which it lies far away."""
    clouds = (scene.vertices, scene.wires.start, scene.wires.end, scene.poses()[:, :3, 3])
    if origin_m is None and all(max(-c.min(initial=0.0), c.max(initial=0.0)) <= LARGEST_M for c in clouds):
        return scene
    low, high = scene.bounds
    if origin_m is None:
        far = np.maximum(abs(low), abs(high)) > LARGEST_M
        origin = np.where(far, np.round((low + high) / 2, -2), 0.0)
        if origin.any():
            x, y, z = origin
            what = f"the world lies far from its origin, which is moved to origin_m = [{x:.0f}, {y:.0f}, {z:.0f}]"
            warnings.warn(f"{file}: {what}; all positions are from there", UllageWarning, stacklevel=3)
    else:
        origin = checks.array("origin_m", origin_m)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise InputError(f"origin_m is {shown(origin_m)}", where="load_scene", allowed="x, y, z in metres")
    furthest = max(abs(low - origin).max(), abs(high - origin).max())
    if furthest > FURTHEST_M:
        what = f"the world reaches {furthest:.3g} m from its origin"
        raise InputError(what, where=file, allowed=f"up to {FURTHEST_M:g} m from origin_m")
    return scene.about(origin) if origin.any() else scene
