"""An SDF world or model as a Scene.

One object stands for the shapes of one link that share a material: it is called `model`, or `model::link` where a model
has several links (`outer::inner` for nested models), and `model::link::shape` where a link is of several materials.

Material: the nearest `<ullage:material>` of the shape, its link, its model, the include or a model around it; without
one, steel, since the thesis gives all its objects steel-like coefficients. `<laser_retro>` sets that object's
reflection coefficient of the thesis' model and nothing else; without it, the material's own holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.geometry import apply
from ullage.world.materials import Material, material
from ullage.world.meshes import Mesh, joined
from ullage.world.scene import Scene, SceneObject, Wires
from ullage.world.sdf_frames import ScopeFrames
from ullage.world.sdf_geometry import GeometryReader, Rod
from ullage.world.sdf_parse import NAMESPACE, Node, read_pose
from ullage.world.sdf_resolve import Resolver
from ullage.world.sdf_tree import Link, Scope, TreeReader

Floats = NDArray[np.float64]
Geometry = Literal["collision", "visual"]

DEFAULT_MATERIAL = "steel"


def load_sdf(path: Path, *, geometry: Geometry = "collision", search_path: Sequence[str | Path] = ()) -> Scene:
    """The scene of an SDF file.

    Raises:
        InputError: something in it, or in what it includes, cannot be used.
    """
    resolver = Resolver(path, search_path)
    world = TreeReader(resolver).read(path)
    builder = SceneBuilder()
    reader = GeometryReader(resolver)
    _walk(ScopeFrames(world), "", [world.node], geometry, reader, builder)
    return builder.scene(world.name)


@dataclass(slots=True)
class SceneBuilder:
    """Gathers objects, one after the other."""

    objects: list[SceneObject] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    owners: list[int] = field(default_factory=list)
    rods: list[tuple[Floats, Floats, float, int]] = field(default_factory=list)
    _names: dict[str, int] = field(default_factory=dict)

    def add_object(self, thing: SceneObject) -> int:
        """Index of a new object."""
        self.objects.append(thing)
        return len(self.objects) - 1

    def add_shape(self, owner: int, shape: Mesh | Rod, world_from_shape: Floats) -> None:
        """Give an object one more shape."""
        if isinstance(shape, Rod):
            ends = apply(world_from_shape, [[0, 0, -shape.length_m / 2], [0, 0, shape.length_m / 2]])
            self.rods.append((ends[0], ends[1], shape.radius_m, owner))
            return
        self.meshes.append((apply(world_from_shape, shape[0]), shape[1]))
        self.owners.append(owner)

    def scene(self, name: str) -> Scene:
        """All that was gathered."""
        vertices, faces = joined(self.meshes)
        owner = np.repeat(np.array(self.owners, np.int32), [len(f) for _, f in self.meshes])
        wires = Wires()
        if self.rods:
            start, end, radius, whose = zip(*self.rods, strict=True)
            wires = Wires(np.stack(start), np.stack(end), np.array(radius), np.array(whose, np.int32))
        return Scene(vertices, faces, owner, tuple(self.objects), wires, name)


def _walk(
    frames: ScopeFrames,
    outer: str,
    around: list[Node],
    geometry: Geometry,
    reader: GeometryReader,
    builder: SceneBuilder,
) -> None:
    """Add the shapes of a scope and of the models in it."""
    scope = frames.scope
    here = frames.world_from_scope()
    several = len(list(_links(scope))) > 1
    for link in scope.links:
        name = f"{outer}::{link.name}" if several or scope.merged else outer
        _add_link(frames, here, link, name, around, geometry, reader, builder)
    for inner in frames.inner.values():
        model = inner.scope
        name = outer if model.merged else f"{outer}::{model.name}" if outer else model.name
        nodes = [model.node, *([model.included_by] if model.included_by else []), *around]
        _walk(inner, name, nodes, geometry, reader, builder)


def _links(scope: Scope) -> Iterator[Link]:
    yield from scope.links
    for model in scope.models:
        if model.merged:
            yield from _links(model)


def _add_link(
    frames: ScopeFrames, here: Floats, link: Link, name: str, around: list[Node],
    geometry: Geometry, reader: GeometryReader, builder: SceneBuilder,
) -> None:  # fmt: skip
    groups: dict[Material, list[tuple[str, Mesh | Rod, Floats]]] = {}
    for node in link.node.children(geometry):
        shape = reader.read(node)
        if shape is not None:
            pose = frames.scope_from_pose(read_pose(node), link.name, at=node.place)
            groups.setdefault(read_material(node, [link.node, *around]), []).append(
                (node.attribute("name"), shape, here @ pose)
            )
    for stuff, parts in groups.items():
        owner = builder.add_object(SceneObject(name if len(groups) == 1 else f"{name}::{parts[0][0]}", stuff))
        for _, shape, pose in parts:
            builder.add_shape(owner, shape, pose)


def read_material(shape: Node, around: Sequence[Node]) -> Material:
    """The material of a collision or visual, given the elements around it, nearest first.

    Raises:
        InputError: the material is unknown or a value of it is out of bounds.
    """
    tag = next((found for node in (shape, *around) if (found := _tag(node)) is not None), None)
    stuff = material(DEFAULT_MATERIAL) if tag is None else _tagged(tag)
    retro = shape.child("laser_retro")
    if retro is None:
        return stuff
    value = float(retro.numbers(1)[0])
    if value < 0:
        retro.place.refuse(f"<laser_retro> is {value:g}", allowed="0 or more")
    return stuff.but(reflection=value)


def _tag(node: Node) -> Node | None:
    for child in node.element:
        if child.tag in (f"{{{NAMESPACE}}}material", "ullage:material"):
            return Node(child, node.file)
        if child.prefix == "ullage" and child.tag.endswith("}material"):
            return Node(child, node.file)
    return None


def _tagged(tag: Node) -> Material:
    try:
        stuff = material(tag.text)
        changes = {key: tag.element.get(key) for key in ("thickness_m", "roughness_m") if key in tag.element.attrib}
        other = set(tag.element.attrib) - set(changes)
        if other:
            tag.place.refuse(f"<{tag.tag}> has {sorted(other)[0]!r}", allowed="thickness_m, roughness_m")
        return stuff.but(**{key: _number(tag, key) for key in changes}) if changes else stuff
    except InputError as error:
        if error.line is not None:
            raise
        tag.place.refuse(error.what, allowed=error.allowed)


def _number(tag: Node, key: str) -> float:
    try:
        return float(tag.attribute(key))
    except ValueError:
        tag.place.refuse(f"{key} is {tag.attribute(key)!r}", allowed="a number [m]")
