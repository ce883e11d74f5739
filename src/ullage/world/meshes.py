"""Triangle meshes from files: .stl .obj .ply .dae .glb .gltf through trimesh and pycollada, checked and cleaned.

Coordinates are taken as they stand, without turning any axis (as Gazebo does); a COLLADA file's unit is applied.
"""

from __future__ import annotations

import io
import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Ints
from ullage.errors import InputError, shown
from ullage.untrusted import regular_size
from ullage.world.notices import notify
from ullage.world.polygons import plain_obj, triangle_corners
from ullage.world.repair import repaired
from ullage.world.scene import joined_normals

Mesh = tuple[Floats, Ints]


@dataclass(frozen=True, slots=True, eq=False)
class MeshFile:
    """Contents of a mesh file."""

    vertices: Floats  # (v, 3) [m]
    faces: Ints  # (f, 3)
    corner_normals: Floats | None = None  # (f, 3, 3) unit vectors, zero where the file has none; None: it has none


PLY_BYTES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2, "int": 4, "uint": 4,
    "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8, "float64": 8,
}  # fmt: skip
FORMATS = (".dae", ".glb", ".gltf", ".obj", ".ply", ".stl")
UNITLESS = (".obj", ".ply", ".stl")
LARGEST_M = 100.0
"""A longer mesh of no known unit is in millimetres [m]: the radar sees 10 m, and its halls and holds are shorter."""
MOST_BYTES = 512 * 2**20
MOST_FACES = 20_000_000
MOST_EMPTY = 1_000_000
"""Values of glTF accessors that have no data in the file."""

MOST_NODES = 100_000
"""Nodes of a COLLADA scene, those that are instanced several times counted each time."""


def load_mesh(path: Path, *, submesh: str = "", center: bool = False) -> Mesh:
    """Vertices (v, 3) [m] and faces (f, 3) of a mesh file in metres; as `read_mesh`."""
    found = read_mesh(path, submesh=submesh, center=center, scale=1.0)
    return found.vertices, found.faces


def read_mesh(path: Path, *, submesh: str = "", center: bool = False, scale: float | None = None) -> MeshFile:
    """Read a mesh file, with the normals that it gives to its corners, and repair it.

    Args:
        path: the file; its suffix gives the format.
        submesh: take only the part with this name.
        center: move the part's bounding box onto the origin.
        scale: metres in a unit of the file, which its own unit multiplies. None: 1, but 0.001 for a file without
            a unit (.obj, .ply, .stl) that is over `LARGEST_M` units long, with a warning.

    Raises:
        InputError: the file is missing, too large, broken, of an unknown format, or without triangles.
    """
    found = _parts(path)
    parts = [mesh for names, mesh in found if not submesh or submesh in names]
    if submesh and not parts:
        known = sorted({name for names, _ in found for name in names})
        raise InputError(f"no submesh {submesh!r}", where=path, allowed=", ".join(known[:20]))
    whole = joined(parts)
    vertices, faces = whole.vertices, whole.faces
    if not len(faces):
        raise InputError("the mesh has no triangles", where=path)
    if len(faces) > MOST_FACES:
        raise InputError(f"{len(faces)} triangles", where=path, allowed=f"at most {MOST_FACES}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError("a triangle of the mesh names a vertex that is not there", where=path)
    if not np.isfinite(vertices).all():
        raise InputError("the mesh has a vertex that is not finite", where=path)
    if center:
        vertices = vertices - (vertices.min(0) + vertices.max(0)) / 2
    return mended(_scaled(MeshFile(vertices, faces, whole.corner_normals), scale, path), where=str(path))


def joined(parts: list[MeshFile]) -> MeshFile:
    """Join several meshes into one."""
    if not parts:
        return MeshFile(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    shift = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + s for part, s in zip(parts, shift, strict=False)]).astype(np.int32)
    return MeshFile(np.concatenate([part.vertices for part in parts]), faces, joined_normals(parts))


def mended(mesh: MeshFile, *, where: str) -> MeshFile:
    """Repair a mesh as `repair.repaired` does, with a warning in one line if something was wrong.

    Raises:
        InputError: no triangle has an area.
    """
    found = repaired(mesh.vertices, mesh.faces, mesh.corner_normals)
    if not len(found.faces):
        raise InputError("no triangle of the mesh has an area", where=where)
    if found.report:
        notify(f"{where}: {found.report}", kind="repaired mesh")
    return MeshFile(found.vertices, found.faces, found.corner_normals)


def _scaled(mesh: MeshFile, scale: float | None, path: Path) -> MeshFile:
    """Bring the mesh to metres; a file without a unit that would be larger than any place is taken in millimetres."""
    if scale is None:
        size = float(np.ptp(mesh.vertices[mesh.faces.ravel()], axis=0).max())
        if size <= LARGEST_M or path.suffix.lower() not in UNITLESS:
            return mesh
        what = f"{size:.4g} units long: taken in millimetres; give scale=1 if it is in metres"
        notify(f"{path}: {what}", kind="unit of a mesh")
        scale = 1e-3
    return replace(mesh, vertices=mesh.vertices * scale)


def _parts(path: Path) -> list[tuple[set[str], MeshFile]]:
    """Each part's names (of the geometry and of its node) and its triangles."""
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise InputError(f"a mesh of unknown format {path.suffix!r}", where=path, allowed=" ".join(FORMATS))
    raw = _bytes(path)
    try:
        return _collada(raw, path) if kind == ".dae" else _by_trimesh(raw, path, kind[1:])
    except InputError:
        raise
    except Exception as error:  # a damaged file can raise any error in a reader
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"the mesh cannot be read: {reason}", where=path) from None


def check_ply(raw: bytes, path: Path) -> None:
    """Refuse a PLY file whose header promises more than the file can hold: a reader would make room for it.

    Raises:
        InputError: the header is malformed, or promises too much.
    """
    head, found, _ = raw[: 2**20].partition(b"end_header")
    if not raw.startswith(b"ply") or not found:
        raise InputError("the mesh cannot be read: it has no PLY header", where=path)
    size = len(raw) - len(head) - len(found)
    ascii_text, promised, count = b"format ascii" in head, 0, 0
    for number, line in enumerate(head.decode("latin1").splitlines(), 1):
        words = line.split()
        if words[:1] == ["element"] and len(words) == 3:
            count = int(words[2]) if words[2].isdecimal() and len(words[2]) < 16 else -1
            if not 0 <= count <= max(size, 1):
                raise InputError(
                    f"{line[:80]!r} in {size} bytes", where=path, line=number, allowed="what the file holds"
                )
        elif words[:1] == ["property"] and len(words) >= 3:
            promised += count * (2 if ascii_text else PLY_BYTES.get(words[2 if words[1] == "list" else 1], 1))
        if promised > size + 1:
            raise InputError(
                f"promises {promised} bytes and holds {size}", where=path, line=number, allowed="whole data"
            )


def whole_stl(raw: bytes, path: Path) -> bytes:
    """The bytes of a binary STL without those after its last facet, which trimesh refuses; a text is not changed.

    The count of facets at byte 80 of a text is four of its characters, which is above what any file holds.

    Raises:
        InputError: a binary file ends before its last facet.
    """
    size = 84 + 50 * int.from_bytes(raw[80:84], "little")
    if 84 < size < len(raw):
        notify(f"{path}: {len(raw) - size} bytes after the last facet are left out", kind="bytes after the STL")
        return raw[:size]
    if len(raw) < size and not raw[:512].lstrip().lower().startswith(b"solid"):
        what = f"the mesh cannot be read: it promises {size} bytes and holds {len(raw)}"
        raise InputError(what, where=path, allowed="STL with all its facets")
    return raw


def _check_gltf(raw: bytes, path: Path) -> None:
    """Refuse a glTF file whose accessors have no data and ask for much room."""
    start = raw.find(b"{")
    text = raw[20 : 20 + int.from_bytes(raw[12:16], "little")] if raw.startswith(b"glTF") else raw[start:]
    empty = [one.get("count", 0) for one in json.loads(text).get("accessors", ()) if "bufferView" not in one]
    if any(not isinstance(count, int) or count < 0 for count in empty) or sum(empty) > MOST_EMPTY:
        raise InputError(
            f"accessors without data, of {shown(empty)} values", where=path, allowed=f"{MOST_EMPTY} in all"
        )


def _by_trimesh(raw: bytes, path: Path, kind: str) -> list[tuple[set[str], MeshFile]]:
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # the caller reports its errors
    options: dict[str, Any] = {}
    if kind == "ply":
        check_ply(raw, path)
    if kind == "stl":
        raw = whole_stl(raw, path)
    if kind in ("glb", "gltf"):
        _check_gltf(raw, path)
    if kind == "obj":
        raw = plain_obj(raw)
        objects = raw.startswith(b"o ") or b"\no " in raw
        options = {"split_objects": objects, "split_groups": not objects, "group_material": False}
    found = trimesh.load_scene(
        trimesh.util.wrap_as_stream(raw), file_type=kind, resolver=_beside(path), process=False,
        skip_materials=True, **options,
    )  # fmt: skip
    out = []
    for node in found.graph.nodes_geometry:
        matrix, name = found.graph[node]
        geometry = found.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            vertices, faces = np.asarray(geometry.vertices, np.float64), np.asarray(geometry.faces, np.int32)
            given = geometry.vertex_normals if "vertex_normals" in geometry._cache else None  # else trimesh makes some
            mesh = MeshFile(vertices, faces, _at_corners(given, faces))
            out.append(({str(node), str(name)}, _moved(mesh, np.asarray(matrix, float))))
    return out


def _collada(raw: bytes, path: Path) -> list[tuple[set[str], MeshFile]]:
    """As Gazebo reads it: nodes' names name the parts, the unit counts, the up axis does not."""
    import collada  # type: ignore[import-untyped]

    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw:
        raise InputError("declares XML entities", where=path, allowed="plain COLLADA without entities")
    if not raw.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<"):
        raise InputError("not COLLADA", where=path, allowed="XML")
    document = collada.Collada(io.BytesIO(raw), ignore=[collada.common.DaeError])
    unit = document.assetInfo.unitmeter if document.assetInfo is not None else None
    scale = np.diag([unit or 1.0, unit or 1.0, unit or 1.0, 1.0])
    out: list[tuple[set[str], MeshFile]] = []
    left = iter(range(MOST_NODES))
    for node in document.scene.nodes if document.scene is not None else ():
        _collada_node(node, scale, set(), out, left)
    return out


def _collada_node(
    node: Any, matrix: Floats, names: set[str], out: list[tuple[set[str], MeshFile]], left: Iterator[int]
) -> None:
    if next(left, None) is None:
        raise ValueError(f"more than {MOST_NODES} nodes")
    geometry = getattr(node, "geometry", None)
    if geometry is None:
        geometry = getattr(getattr(node, "controller", None), "geometry", None)
    if geometry is not None:
        called = {name for name in (*names, geometry.id, geometry.name) if name}
        meshes = [_collada_triangles(primitive) for primitive in geometry.primitives]
        out.extend((called, _moved(mesh, matrix)) for mesh in meshes if mesh is not None)
        return
    own = {name for name in (getattr(node, "id", None), node.xmlnode.get("name")) if name}
    for child in getattr(node, "children", None) or ():
        _collada_node(child, matrix @ np.asarray(node.matrix, float), own or names, out, left)


def _collada_triangles(primitive: Any) -> MeshFile | None:
    index, normals = getattr(primitive, "vertex_index", None), getattr(primitive, "normal", None)
    where, counts = getattr(primitive, "normal_index", None), getattr(primitive, "vcounts", None)
    if index is None or not len(index):
        return None
    vertices, index = np.asarray(primitive.vertex, np.float64), np.asarray(index, np.int64)
    if counts is not None:
        corners = triangle_corners(np.asarray(counts, np.int64), vertices[index])
        index, where = index[corners], None if where is None else np.asarray(where)[corners]
    if index.ndim != 2 or index.shape[1] != 3 or not len(index):
        return None  # lines
    known = normals is not None and where is not None and np.shape(where) == np.shape(index)
    given = _at_corners(normals, np.asarray(where)) if known else None
    return MeshFile(vertices, np.asarray(index, np.int32), given)


def _at_corners(normals: Any, index: NDArray[np.integer]) -> Floats | None:
    """Unit vectors (f, 3, 3) by numbers (f, 3) of a file's normals; zero for those that are no directions."""
    if normals is None:
        return None
    rows = np.asarray(normals, np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows) or index.min() < 0 or index.max() >= len(rows):
        return None
    out = np.where(np.isfinite(rows).all(1, keepdims=True), rows, 0.0)[index]
    size = np.linalg.norm(out, axis=2, keepdims=True)
    return np.asarray(np.where(size > 1e-12, out / np.maximum(size, 1e-300), 0.0))


def _moved(mesh: MeshFile, matrix: Floats) -> MeshFile:
    """Move the mesh by an affine matrix (4, 4); normals by its inverse transpose, with faces still outward."""
    linear = matrix[:3, :3]
    vertices, faces, normals = mesh.vertices @ linear.T + matrix[:3, 3], mesh.faces, mesh.corner_normals
    side = np.linalg.det(linear)
    normals = None if normals is None or abs(side) <= 1e-300 else normals @ np.linalg.inv(linear)
    if normals is not None:
        normals = normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    if side < 0:
        faces, normals = faces[:, ::-1], None if normals is None else normals[:, ::-1]
    return MeshFile(vertices, faces, normals)


def _bytes(path: Path) -> bytes:
    try:
        size = regular_size(path, allowed="a mesh")
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
    from trimesh.resolvers import FilePathResolver

    home = path.resolve().parent

    class Beside(FilePathResolver):
        def get(self, key: str) -> bytes:
            asked = (home / key).resolve()
            if not asked.is_relative_to(home):
                raise InputError(f"names {key!r}, which reaches out of its folder", where=path)
            return _bytes(asked)

    return Beside(str(home))
