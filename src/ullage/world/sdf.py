"""A world or model of SDF, URDF or xacro as a Scene.

One object stands for the shapes of one link that share a material: it is called `model`, or `model::link` where a model
has several links (`outer::inner` for nested models), and `model::link::shape` where a link is of several materials.
Materials: see sdf_material. Poses are those of the file: joints stand as they were written, actors move as scripted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.world.materials import Material
from ullage.world.meshes import Mesh
from ullage.world.notices import one_notice_per_kind
from ullage.world.scene import Scene, SceneObject
from ullage.world.sdf_actor import read_motion
from ullage.world.sdf_build import SceneBuilder
from ullage.world.sdf_frames import ScopeFrames
from ullage.world.sdf_geometry import GeometryReader, Rod
from ullage.world.sdf_material import nearest_tag, read_material, read_smooth
from ullage.world.sdf_parse import Node, read_pose
from ullage.world.sdf_resolve import Missing, Resolver
from ullage.world.sdf_sensors import ray_rigs_of, rigs_of
from ullage.world.sdf_tree import Link, Scope, TreeReader
from ullage.world.smoothing import Smooth

Geometry = Literal["collision", "visual"]


def load_sdf(
    path: Path,
    *,
    geometry: Geometry = "collision",
    search_path: Sequence[str | Path] = (),
    missing: Missing = "refuse",
    joints: Mapping[str, float] | None = None,
    xacro: Mapping[str, str] | None = None,
) -> Scene:
    """Read the scene of an SDF, URDF or xacro file.

    Args:
        path: the file.
        geometry: which shapes to take.
        search_path: folders for model://, package:// and relative names, and for xacro's $(find).
        missing: refuse the file if one that it names is missing, or skip the model or shape with a warning.
        joints: values of a URDF's joints [rad or m]; those not named are at zero.
        xacro: arguments of a xacro file, which may evaluate Python code; None: such files are refused.

    Raises:
        InputError: an element of it, or of an included file, is not valid; or it is xacro and not trusted.
    """
    resolver = Resolver(path, search_path, missing=missing)
    with one_notice_per_kind():
        return scene_of(TreeReader(resolver, joints=joints, xacro=xacro).read(path), resolver, geometry=geometry)


def scene_of(world: Scope, resolver: Resolver, *, geometry: Geometry) -> Scene:
    """Return the scene of a parsed world."""
    walk = SceneWalk(GeometryReader(resolver), geometry)
    frames = ScopeFrames(world)
    walk.add_scope(frames, "", nearest_tag(world.node))
    if walk.unseen and geometry == "collision":
        names = ", ".join(walk.unseen[:5]) + ", ..." * (len(walk.unseen) > 5)
        world.node.place.warn(f"only visuals, so not seen: {names} (geometry='visual' reads them)")
    inner = {name: one for part in frames.parts() for name, one in part.inner.items() if not one.scope.merged}
    models = {name: one.world_from_scope() for name, one in inner.items()}
    rigs = rigs_of(frames)
    rays = {} if rigs else ray_rigs_of(frames)
    return replace(walk.builder.scene(world.name), rigs=rigs, ray_rigs=rays, models=models)


@dataclass(slots=True)
class SceneWalk:
    """Visit scopes and add their shapes to a scene."""

    reader: GeometryReader
    geometry: Geometry
    builder: SceneBuilder = field(default_factory=SceneBuilder)
    unseen: list[str] = field(default_factory=list)

    def add_scope(self, frames: ScopeFrames, outer: str, tag: Node | None) -> None:
        """Add the shapes of a scope and of the models in it; names begin with `outer`, `tag` is the material around."""
        scope = frames.scope
        here = frames.world_from_scope()
        several = scope.merged or sum(len(part.scope.links) for part in frames.parts()) > 1
        for link in scope.links:
            name = f"{outer}::{link.name}".removeprefix("::") if several else outer
            self._add_link(frames, here, link, name, tag)
        for inner in frames.inner.values():
            model = inner.scope
            name = outer if model.merged else f"{outer}::{model.name}" if outer else model.name
            self.add_scope(inner, name, nearest_tag(model.node, model.included_by) or tag)
        for actor in scope.actors:
            self._add_actor(frames, actor, tag)

    def _add_link(
        self, frames: ScopeFrames, here: Floats, link: Link, name: str, tag: Node | None,
        *, motion: Trajectory | None = None,
    ) -> None:  # fmt: skip
        tag = nearest_tag(link.node) or tag
        groups: dict[tuple[Material, Smooth], list[tuple[Node, Mesh | Rod, Floats]]] = {}
        for node in link.node.children(self.geometry):
            shape = self.reader.read(node)
            if shape is not None:
                pose = here @ frames.scope_from_pose(read_pose(node), link.name, at=node.place)
                groups.setdefault((read_material(node, tag), read_smooth(node)), []).append((node, shape, pose))
        if not groups and link.node.child("visual") is not None and link.node.child("collision") is None:
            self.unseen.append(name)
        for (object_material, smooth), parts in groups.items():
            called = name if len(groups) == 1 else f"{name}::{parts[0][0].attribute('name')}"
            owner = self.builder.add_object(SceneObject(called, object_material, motion, smooth))
            for node, shape, pose in parts:
                try:
                    self.builder.add_shape(owner, shape, pose)
                except InputError as error:
                    node.place.refuse(error.what, allowed=error.allowed)

    def _add_actor(self, around_frames: ScopeFrames, actor: Scope, tag: Node | None) -> None:
        if actor.node.child("skin") is not None:
            what = f"the skin of actor {actor.name!r} is passed by; only shapes in its links are read"
            actor.node.place.warn(what, kind="skin")
        motion = read_motion(actor.node)
        frames = ScopeFrames(actor)
        here = np.eye(4)
        if motion is None:
            place = actor.pose.place or actor.node.place
            here = around_frames.world_from_scope() @ around_frames.scope_from_pose(actor.pose, "", at=place)
        for link in actor.links:
            name = actor.name if len(actor.links) == 1 else f"{actor.name}::{link.name}"
            self._add_link(frames, here, link, name, nearest_tag(actor.node) or tag, motion=motion)
