"""Triangle meshes from files: .stl .obj .ply .dae .glb .gltf through trimesh, checked and cleaned.

Coordinates are taken as they stand, without turning any axis (as Gazebo does); a COLLADA file's unit is applied.
"""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError, UllageWarning

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Mesh = tuple[Floats, Ints]

FORMATS = (".dae", ".glb", ".gltf", ".obj", ".ply", ".stl")
MOST_BYTES = 512 * 2**20
MOST_FACES = 20_000_000


def load_mesh(path: Path, *, submesh: str = "", center: bool = False) -> Mesh:
    """Vertices (v, 3) [m] and faces (f, 3) of a mesh file.

    Args:
        path: the file; its suffix says the format.
        submesh: take only the part with this name.
        center: move the part's bounding box onto the origin.

    Raises:
        InputError: the file is missing, too large, broken, of an unknown format, or without triangles.
    """
    parts = [part for name, part in _parts(path) if not submesh or submesh in name]
    if submesh and not parts:
        known = sorted({name for names, _ in _parts(path) for name in names if name})
        raise InputError(f"no submesh {submesh!r}", where=path, allowed=", ".join(known[:20]))
    vertices, faces = joined(parts)
    if not len(faces):
        raise InputError("the mesh has no triangles", where=path)
    if not np.isfinite(vertices).all():
        raise InputError("the mesh has a vertex that is not finite", where=path)
    if center:
        vertices = vertices - (vertices.min(0) + vertices.max(0)) / 2
    return cleaned(vertices, faces, where=str(path))


def joined(parts: list[Mesh]) -> Mesh:
    """Several meshes as one."""
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    shift = np.cumsum([0, *(len(v) for v, _ in parts)])
    faces = [f + s for (_, f), s in zip(parts, shift, strict=False)]
    return np.concatenate([v for v, _ in parts]), np.concatenate(faces).astype(np.int32)


def cleaned(vertices: Floats, faces: Ints, *, where: str) -> Mesh:
    """The mesh without faces that have no area, with a warning that counts them.

    Raises:
        InputError: no face is left.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    longest = np.maximum(np.maximum(((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1)), ((a - c) ** 2).sum(1))
    flat = np.linalg.norm(np.cross(b - a, c - a), axis=1) <= 1e-9 * longest
    if flat.all():
        raise InputError("no triangle of the mesh has an area", where=where)
    if flat.any():
        some = f"{int(flat.sum())} degenerate triangle{'s' * (flat.sum() > 1)} of {len(faces)}"
        warnings.warn(f"{where}: {some} left out", UllageWarning, stacklevel=2)
        faces = faces[~flat]
    return vertices, np.ascontiguousarray(faces, np.int32)


def _parts(path: Path) -> list[tuple[set[str], Mesh]]:
    """Each part's names (of the geometry and of its node) and its triangles."""
    import trimesh

    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise InputError(f"a mesh of unknown format {path.suffix!r}", where=path, allowed=" ".join(FORMATS))
    raw = _bytes(path)
    options: dict[str, Any] = {"split_object": True, "group_material": False} if kind == ".obj" else {}
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        found = trimesh.load_scene(
            trimesh.util.wrap_as_stream(raw), file_type=kind[1:], resolver=_beside(path), process=False,
            skip_materials=True, **options,
        )  # fmt: skip
        out = []
        for node in found.graph.nodes_geometry:
            matrix, name = found.graph[node]
            geometry = found.geometry[name]
            if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
                out.append(({str(node), str(name)}, _moved(geometry, np.asarray(matrix) * 1.0)))
    except InputError:
        raise
    except Exception as error:  # whatever a broken file brings a reader to raise
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"the mesh cannot be read: {said}", where=path) from None
    return out


def _moved(geometry: Any, matrix: Floats) -> Mesh:
    vertices, faces = np.asarray(geometry.vertices, np.float64), np.asarray(geometry.faces)
    if np.allclose(matrix, np.eye(4), atol=0):
        return vertices, faces
    moved = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return moved, faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else faces


def _bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise InputError(
                f"{size / 2**20:.0f} MiB of mesh", where=path, allowed=f"at most {MOST_BYTES // 2**20} MiB"
            )
        if not size:
            raise InputError("the file is empty", where=path, allowed="a mesh")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=path) from None


def _beside(path: Path) -> Any:
    """Gives trimesh the files that a mesh names, if they lie in the mesh's folder."""
    from trimesh.resolvers import Resolver

    home = path.resolve().parent

    class Beside(Resolver):
        def __init__(self) -> None:
            pass

        def get(self, key: str) -> bytes:
            asked = (home / key).resolve()
            if not asked.is_relative_to(home):
                raise InputError(f"names {key!r}, which reaches out of its folder", where=path)
            return _bytes(asked)

        def namespaced(self, namespace: str) -> Any:
            raise ValueError(namespace)

        def keys(self) -> list[str]:
            return []

        def write(self, name: str, data: Any) -> None:
            raise ValueError(name)

    return Beside()
