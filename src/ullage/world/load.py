"""Worlds and models from files, by their suffix."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ullage.errors import InputError
from ullage.world.scene import Scene

SDF = (".sdf", ".world")
URDF = (".urdf", ".xacro")


def load_scene(
    path: str | Path,
    *,
    geometry: Literal["collision", "visual"] = "collision",
    search_path: Sequence[str | Path] = (),
    missing: Literal["refuse", "skip"] = "refuse",
) -> Scene:
    """Read a world: SDF 1.0 to 1.12, URDF (with xacro), or a bare mesh (.dae .glb .gltf .obj .ply .stl).

    Args:
        path: the file.
        geometry: which shapes of SDF and URDF to take.
        search_path: folders for model://, package:// and relative names, before those of the environment.
        missing: what happens when a model or mesh that an SDF file names is not there: "refuse" the file, or "skip"
            that model or shape with a warning.

    Raises:
        InputError: the file, or something that it names, is missing, malformed, too large or out of reach.
    """
    file = Path(path)
    if geometry not in ("collision", "visual"):
        raise InputError(f"geometry is {geometry!r}", where="load_scene", allowed="collision or visual")
    if missing not in ("refuse", "skip"):
        raise InputError(f"missing is {missing!r}", where="load_scene", allowed="refuse or skip")
    if not file.is_file():
        raise InputError("is a folder, not a file" if file.is_dir() else "no such file", where=file)
    kind = file.suffix.lower()
    if kind in SDF:
        from ullage.world.sdf import load_sdf

        return load_sdf(file, geometry=geometry, search_path=search_path, missing=missing)
    if kind in URDF:
        from ullage.world.urdf import load_urdf

        return load_urdf(file, geometry=geometry, search_path=search_path)
    from ullage.world.meshes import FORMATS, load_mesh

    if kind in FORMATS:
        vertices, faces = load_mesh(file)
        return Scene.of_mesh(vertices, faces, name=file.stem)
    known = " ".join((*SDF, *URDF, *FORMATS))
    raise InputError(f"a file of unknown kind {file.suffix!r}", where=file, allowed=known)
