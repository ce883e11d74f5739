"""Worlds and models from files, by their suffix."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ullage.errors import InputError
from ullage.untrusted import reading, regular_size
from ullage.world.meshes import FORMATS, read_mesh
from ullage.world.scene import Scene

SDF = (".sdf", ".world")
URDF = (".urdf", ".xacro")
KINDS = (*SDF, *URDF, *FORMATS)
"""Suffixes of world files."""
TRUST_XACRO = "ULLAGE_TRUST_XACRO"
"""Environment variable that `--trust-xacro` sets to 1, for this process and its workers."""


def load_scene(
    path: str | Path, *, geometry: Literal["collision", "visual"] = "collision",
    search_path: Sequence[str | Path] = (), missing: Literal["refuse", "skip"] = "refuse", trust_xacro: bool = False,
) -> Scene:  # fmt: skip
    """Read a world: SDF 1.0 to 1.12, URDF (with xacro), or a bare mesh (.dae .glb .gltf .obj .ply .stl).

    Args:
        path: the file.
        geometry: which shapes of SDF and URDF to take.
        search_path: folders for model://, package:// and relative names, before those of the environment.
        missing: what happens when a model or mesh that an SDF file names is not there: "refuse" the file, or "skip"
            that model or shape with a warning.
        trust_xacro: expand a .xacro file, which may evaluate Python; it runs in a process of its own, with limits.

    Raises:
        InputError: the file, or something that it names, is missing, malformed, too large or out of reach; or it is a
            .xacro file and not trusted.
    """
    file = Path(path)
    if geometry not in ("collision", "visual"):
        raise InputError(f"geometry is {geometry!r}", where="load_scene", allowed="collision or visual")
    if missing not in ("refuse", "skip"):
        raise InputError(f"missing is {missing!r}", where="load_scene", allowed="refuse or skip")
    if not os.path.exists(file):
        raise InputError("no such file", where=file)
    regular_size(file, allowed="a world file")
    with reading(file):
        return _load(file, geometry, search_path, missing, trust_xacro or os.environ.get(TRUST_XACRO) == "1")


def _load(
    file: Path, geometry: Literal["collision", "visual"], search_path: Sequence[str | Path],
    missing: Literal["refuse", "skip"], trust_xacro: bool,
) -> Scene:  # fmt: skip
    kind = file.suffix.lower()
    if kind == ".xacro" and not trust_xacro:
        what = "xacro evaluates Python code that the file holds, so it runs only when it is trusted"
        raise InputError(what, where=file, allowed="--trust-xacro, load_scene(..., trust_xacro=True), or a .urdf file")
    if kind in SDF:
        from ullage.world.sdf import load_sdf

        return load_sdf(file, geometry=geometry, search_path=search_path, missing=missing)
    if kind in URDF:
        from ullage.world.urdf import load_urdf

        return load_urdf(file, geometry=geometry, search_path=search_path, trust_xacro=trust_xacro)
    if kind in FORMATS:
        mesh = read_mesh(file)
        return Scene.of_mesh(mesh.vertices, mesh.faces, name=file.stem, corner_normals=mesh.corner_normals)
    raise InputError(f"a file of unknown kind {file.suffix!r}", where=file, allowed=" ".join(KINDS))
