"""SDF's <geometry> as triangles, or as a wire where it is a thin round rod."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.world import shapes
from ullage.world.meshes import Mesh, load_mesh
from ullage.world.sdf_parse import Node
from ullage.world.sdf_resolve import MissingFileError, Resolver

SAGITTA_M = 2.5e-4
"""Facets of cylinders stay this close to the true surface [m]: 2.2 deg of two-way phase at 7.29 GHz."""

BALL_SAGITTA_M = 6.4e-4
"""Facets of surfaces that curve both ways do so within 1/64 of a wavelength [m].

A facet then spans a quarter of the first Fresnel zone, whatever the radius: half of it is sqrt(2 r s), and the zone's
radius is sqrt(r wavelength / 2). Cylinders are finer since their facets, as many as 1 / sqrt(s) and not 1 / s, are few.
"""

BALL_EDGE = 0.2
"""Facets of small balls are shorter than this share of the radius, so that their bends stay smooth."""

PLANE_M = 100.0
"""Side of the square that stands for a plane without a <size> [m]."""

WIRE_RADIUS_M = 0.025
WIRE_SLENDERNESS = 8
"""A cylinder up to this radius [m], and at least this many radii long, is a wire: solved as a line, not meshed."""


@dataclass(frozen=True, slots=True)
class Rod:
    """A thin round rod along z, centred on the origin."""

    radius_m: float
    length_m: float


class GeometryReader:
    """Reads geometries; each mesh file and each primitive of the same sizes once, so that equal shapes share arrays."""

    def __init__(self, resolver: Resolver) -> None:
        self.resolver = resolver
        self._meshes: dict[tuple[Path, str, bool], Mesh] = {}
        self._primitives: dict[tuple[str | float, ...], Mesh | Rod] = {}
        self._others: dict[str, Callable[[Node], Mesh | Rod]] = {
            "plane": _plane,
            "mesh": self._mesh,
            "heightmap": self._heightmap,
        }

    def read(self, owner: Node) -> Mesh | Rod | None:
        """The shape of a collision or visual, in its own frame; None: it has none that can be read.

        Raises:
            InputError: a size, a file or a value cannot be used.
        """
        node = owner.child("geometry")
        if node is None:
            owner.place.warn(f"<{owner.tag}> has no <geometry>; it is passed by", kind="no geometry")
            return None
        try:
            lines = list(node.children("polyline"))
            if lines:
                return _polyline(lines)
            for child in node.children():
                if child.tag in _PRIMITIVES:
                    return self._primitive(child)
                if child.tag in self._others:
                    return self._others[child.tag](child)
        except MissingFileError as error:
            if not self.resolver.skips(error, what="shape"):
                raise
            return None
        except InputError as error:
            if error.line is None:  # errors of a mesh or a shape have no line: add the place
                place = f"{error.where}: " if error.where is not None else ""
                node.place.refuse(f"{place}{error.what}", allowed=error.allowed)
            raise
        other = [child.tag for child in node.children()]
        if other != ["empty"]:
            tags = ", ".join(f"<{tag}>" for tag in other) or "nothing"
            what = f"geometry of {owner.attribute('name')!r} holds {tags}; it is passed by"
            node.place.warn(what, kind=f"geometry of {tags}")
        return None

    def _primitive(self, node: Node) -> Mesh | Rod:
        fields, make = _PRIMITIVES[node.tag]
        sizes = [float(size) for tag, default in fields.items() for size in node.sizes(tag, default)]
        key: tuple[str | float, ...] = (node.tag, *sizes)
        if key not in self._primitives:
            self._primitives[key] = make(*sizes)
        return self._primitives[key]

    def _mesh(self, node: Node) -> Mesh:
        uri = node.need("uri")
        part = node.child("submesh")
        name, center = ("", False) if part is None else (part.text_of("name"), part.flag("center"))
        key = (self.resolver.find(uri.text, at=uri.place), name, center)
        if key not in self._meshes:
            self._meshes[key] = load_mesh(key[0], submesh=name, center=center)
        vertices, faces = self._meshes[key]
        scale = node.child("scale")
        if scale is None:
            return vertices, faces
        factor = scale.numbers(3)
        if not factor.all():
            scale.place.refuse(f"<scale> is {scale.text!r}", allowed="three numbers other than zero")
        return vertices * factor, faces[:, ::-1] if factor.prod() < 0 else faces

    def _heightmap(self, node: Node) -> Mesh:
        uri = node.need("uri")
        size = node.sizes("size", (1.0, 1.0, 1.0))
        pos = node.child("pos")
        grey = _grey(self.resolver.find(uri.text, at=uri.place))
        heights = grey * (size[2] / max(grey.max(), 1e-12))
        vertices, faces = shapes.terrain(heights, size[:2])
        return (vertices if pos is None else vertices + pos.numbers(3)), faces


def _segment_m(radius_m: float) -> float:
    return shapes.sagitta_segment_m(radius_m, SAGITTA_M)


def round_bar(radius_m: float, length_m: float) -> Mesh:
    """A cylinder [m] as triangles, its facets within `SAGITTA_M` of the true surface."""
    return shapes.cylinder(radius_m, length_m, segment_m=_segment_m(radius_m))


def _cylinder(radius: float, length: float) -> Mesh | Rod:
    is_wire = radius <= WIRE_RADIUS_M and length >= WIRE_SLENDERNESS * radius
    return Rod(radius, length) if is_wire else round_bar(radius, length)


def _edge_m(radius_m: float) -> float:
    """A triangle's middle bows out 4/3 as far as the middle of its edges."""
    return min(shapes.sagitta_segment_m(radius_m, 0.75 * BALL_SAGITTA_M), BALL_EDGE * radius_m)


def _plane(node: Node) -> Mesh:
    normal = node.child("normal")
    return shapes.plane(
        node.sizes("size", (PLANE_M, PLANE_M)), normal=(0, 0, 1) if normal is None else normal.numbers(3)
    )


def _polyline(lines: list[Node]) -> Mesh:
    rings = [[point.numbers(2) for point in line.children("point")] for line in lines]
    return shapes.extrude(rings, float(lines[0].sizes("height", (1.0,))[0]))


_PRIMITIVES: dict[str, tuple[dict[str, tuple[float, ...]], Callable[..., Mesh | Rod]]] = {
    "box": ({"size": (1.0, 1.0, 1.0)}, lambda *size: shapes.box(size)),
    "cylinder": ({"radius": (1.0,), "length": (1.0,)}, _cylinder),
    "sphere": ({"radius": (1.0,)}, lambda r: shapes.sphere(r, edge_m=_edge_m(r))),
    "capsule": ({"radius": (0.5,), "length": (1.0,)}, lambda r, h: shapes.capsule(r, h, segment_m=_segment_m(r))),
    "ellipsoid": ({"radii": (1.0, 1.0, 1.0)}, lambda *radii: shapes.ellipsoid(radii, edge_m=_edge_m(max(radii)))),
    "cone": ({"radius": (1.0,), "length": (1.0,)}, lambda r, h: shapes.cone(r, h, segment_m=_segment_m(r))),
}
"""What makes each primitive: its sizes with the defaults of the specification [SDFormat], and the maker [m]."""


def _grey(path: Path) -> Floats:
    """Brightness (rows, columns) of a picture, from 0."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            if 2 * picture.width * picture.height > shapes.MOST_FACES:
                size = f"{picture.width} x {picture.height} pixels"
                raise InputError(f"a heightmap of {size}", where=path, allowed=f"up to {shapes.MOST_FACES // 2} pixels")
            plain = picture if picture.mode in ("L", "I", "F", "I;16") else picture.convert("L")
            return np.asarray(plain, np.float64)
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"the heightmap cannot be read: {' '.join(str(error).split())[:100]}", where=path) from None
