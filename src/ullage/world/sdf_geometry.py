"""SDF's <geometry> as triangles, or as a wire where it is a thin round rod."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.world import shapes
from ullage.world.meshes import Mesh, load_mesh
from ullage.world.sdf_parse import Node
from ullage.world.sdf_resolve import Resolver

Floats = NDArray[np.float64]

SAGITTA_M = 2.5e-4
"""Facets of round shapes stay this close to the true surface, 1/160 of a wavelength at 7.3 GHz [m]."""

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
    """Reads geometries; each mesh file once."""

    def __init__(self, resolver: Resolver) -> None:
        self.resolver = resolver
        self._meshes: dict[tuple[Path, str, bool], Mesh] = {}
        self._kinds: dict[str, Callable[[Node], Mesh | Rod]] = {
            "box": lambda node: shapes.box(node.sizes("size", 3)),
            "cylinder": _cylinder,
            "sphere": _sphere,
            "capsule": _capsule,
            "ellipsoid": _ellipsoid,
            "cone": _cone,
            "plane": _plane,
            "mesh": self._mesh,
            "heightmap": self._heightmap,
        }

    def read(self, owner: Node) -> Mesh | Rod | None:
        """The shape of a collision or visual, in its own frame; None: it has none that can be read.

        Raises:
            InputError: a size, a file or a value cannot be used.
        """
        node = owner.need("geometry")
        try:
            lines = list(node.children("polyline"))
            if lines:
                return _polyline(lines)
            for kind, make in self._kinds.items():
                found = node.child(kind)
                if found is not None:
                    return make(found)
        except InputError as error:
            if error.line is None:  # a mesh, or a size that only the shape knows to be wrong: say who asked for it
                place = f"{error.where}: " if error.where is not None else ""
                node.place.refuse(f"{place}{error.what}", allowed=error.allowed)
            raise
        other = [child.tag for child in node.children()]
        if other != ["empty"]:
            said = ", ".join(f"<{tag}>" for tag in other) or "nothing"
            node.place.warn(f"geometry of {owner.attribute('name')!r} holds {said}; it is passed by")
        return None

    def _mesh(self, node: Node) -> Mesh:
        uri = node.need("uri")
        part = node.child("submesh")
        name, center = ("", False) if part is None else (part.said("name"), part.flag("center"))
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
        size = node.sizes("size", 3) if node.child("size") else np.ones(3)
        pos = node.child("pos")
        grey = _grey(self.resolver.find(uri.text, at=uri.place))
        heights = grey * (size[2] / max(grey.max(), 1e-12))
        vertices, faces = shapes.terrain(heights, size[:2])
        return (vertices if pos is None else vertices + pos.numbers(3)), faces


def _cylinder(node: Node) -> Mesh | Rod:
    radius, length = float(node.sizes("radius", 1)[0]), float(node.sizes("length", 1)[0])
    if radius <= WIRE_RADIUS_M and length >= WIRE_SLENDERNESS * radius:
        return Rod(radius, length)
    return shapes.cylinder(radius, length, segment_m=shapes.sagitta_segment_m(radius, SAGITTA_M))


def _sphere(node: Node) -> Mesh:
    radius = float(node.sizes("radius", 1)[0])
    return shapes.sphere(radius, edge_m=_edge_m(radius))


def _edge_m(radius_m: float) -> float:
    """A triangle's middle bows out 4/3 as far as the middle of its edges."""
    return shapes.sagitta_segment_m(radius_m, 0.75 * SAGITTA_M)


def _capsule(node: Node) -> Mesh:
    radius, length = float(node.sizes("radius", 1)[0]), float(node.sizes("length", 1)[0])
    return shapes.capsule(radius, length, segment_m=shapes.sagitta_segment_m(radius, SAGITTA_M))


def _ellipsoid(node: Node) -> Mesh:
    radii = node.sizes("radii", 3)
    return shapes.ellipsoid(radii, edge_m=_edge_m(float(radii.max())))


def _cone(node: Node) -> Mesh:
    radius, length = float(node.sizes("radius", 1)[0]), float(node.sizes("length", 1)[0])
    return shapes.cone(radius, length, segment_m=shapes.sagitta_segment_m(radius, SAGITTA_M))


def _plane(node: Node) -> Mesh:
    normal = node.child("normal")
    size = node.sizes("size", 2) if node.child("size") else np.full(2, PLANE_M)
    return shapes.plane(size, normal=(0, 0, 1) if normal is None else normal.numbers(3))


def _polyline(lines: list[Node]) -> Mesh:
    rings = [[point.numbers(2) for point in line.children("point")] for line in lines]
    return shapes.extrude(rings, float(lines[0].sizes("height", 1)[0]))


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
