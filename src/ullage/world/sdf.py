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
from ullage.geometry import apply, matrix_quat
from ullage.world.materials import Material
from ullage.world.meshes import MOST_FACES, Mesh
from ullage.world.notices import one_notice_per_kind
from ullage.world.scene import Scene, SceneObject, Wires
from ullage.world.sdf_frames import ScopeFrames
from ullage.world.sdf_geometry import GeometryReader, Rod, round_bar
from ullage.world.sdf_material import nearest_tag, read_material, read_smooth
from ullage.world.sdf_parse import Node, read_pose
from ullage.world.sdf_resolve import Missing, Resolver
from ullage.world.sdf_sensors import ray_rigs_of, rigs_of
from ullage.world.sdf_tree import Frame, Scope, TreeReader
from ullage.world.smoothing import Smooth

Geometry = Literal["collision", "visual"]

LOOPED_S = 600.0
"""A looped script of an actor repeats until this time [s]."""

_RETURN_S = 1e-3  # a loop whose ends differ jumps back, as it does in Gazebo


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
    return replace(walk.scene(world.name), rigs=rigs, ray_rigs=rays, models=models)


@dataclass(slots=True)
class SceneWalk:
    """Visit scopes and add their shapes to a scene."""

    reader: GeometryReader
    geometry: Geometry
    objects: list[SceneObject] = field(default_factory=list)
    meshes: list[tuple[Mesh, Floats]] = field(default_factory=list)  # with frame_from_shape; equal ones share arrays
    owners: list[int] = field(default_factory=list)  # object of each mesh
    rods: list[tuple[Floats, Floats, float, int]] = field(default_factory=list)
    faces: int = 0
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
        self, frames: ScopeFrames, here: Floats, link: Frame, name: str, tag: Node | None,
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
            self.objects.append(SceneObject(called, object_material, motion, smooth))
            for node, shape, pose in parts:
                self._add_shape(shape, pose)
                if self.faces > MOST_FACES:
                    allowed = "simpler meshes, or fewer of them"
                    node.place.refuse(f"more than {MOST_FACES} triangles in all", allowed=allowed)

    def _add_shape(self, shape: Mesh | Rod, frame_from_shape: Floats) -> None:
        """Give the newest object one more shape, placed in the world, or in the object's own frame if it moves."""
        owner = len(self.objects) - 1
        if isinstance(shape, Rod) and self.objects[owner].motion is None:
            ends = apply(frame_from_shape, [[0, 0, -shape.length_m / 2], [0, 0, shape.length_m / 2]])
            self.rods.append((ends[0], ends[1], shape.radius_m, owner))
            return
        if isinstance(shape, Rod):  # wires stand still, so a moving rod is meshed
            shape = round_bar(shape.radius_m, shape.length_m)
        self.faces += len(shape[1])
        self.meshes.append((shape, frame_from_shape))
        self.owners.append(owner)

    def _add_actor(self, around_frames: ScopeFrames, actor: Scope, tag: Node | None) -> None:
        if actor.node.child("skin") is not None:
            what = f"the skin of actor {actor.name!r} is passed by; only shapes in its links are read"
            actor.node.place.warn(what, kind="skin")
        motion = _read_motion(actor.node)
        frames = ScopeFrames(actor)
        here = np.eye(4)
        if motion is None:
            place = actor.pose.place or actor.node.place
            here = around_frames.world_from_scope() @ around_frames.scope_from_pose(actor.pose, "", at=place)
        for link in actor.links:
            name = actor.name if len(actor.links) == 1 else f"{actor.name}::{link.name}"
            self._add_link(frames, here, link, name, nearest_tag(actor.node) or tag, motion=motion)

    def scene(self, name: str) -> Scene:
        """Return all gathered parts."""
        vertices, faces = self._placed()
        owner = np.repeat(np.array(self.owners, np.int32), [len(mesh[1]) for mesh, _ in self.meshes])
        wires = Wires()
        if self.rods:
            start, end, radius, whose = zip(*self.rods, strict=True)
            wires = Wires(np.stack(start), np.stack(end), np.array(radius), np.array(whose, np.int32))
        return Scene(vertices, faces, owner, tuple(self.objects), wires, name)

    def _placed(self) -> Mesh:
        """Join all meshes into one array without a second copy in memory."""
        vertices = np.empty((sum(len(mesh[0]) for mesh, _ in self.meshes), 3))
        faces = np.empty((self.faces, 3), np.int32)
        v = f = 0
        for (points, corners), pose in self.meshes:
            vertices[v : v + len(points)] = apply(pose, points)
            faces[f : f + len(corners)] = corners + v
            v, f = v + len(points), f + len(corners)
        return vertices, faces


def _read_motion(actor: Node) -> Trajectory | None:
    """Read the actor's motion from time zero, with delay and loop of its script; None without waypoints."""
    script = actor.child("script")
    points = [] if script is None else [p for t in script.children("trajectory") for p in t.children("waypoint")]
    if script is None or not points:
        return None
    times = np.array([point.number("time") for point in points])
    back = np.flatnonzero(np.diff(times, prepend=-1e-12) <= 0)
    if back.size:
        points[int(back[0])].place.refuse("the time of the waypoint does not rise", allowed="rising from 0")
    poses = np.stack([read_pose(point).matrix for point in points])
    delay = script.number("delay_start", 0.0)
    if delay < 0:
        script.place.refuse(f"delay_start is {delay:g}", allowed="0 s or more")
    if script.flag("loop", default=True) and len(points) > 1:
        times, poses = _looped(times, poses, delay)
    times = times + delay
    if times[0] > 0:
        times, poses = np.concatenate([[0.0], times]), np.concatenate([poses[:1], poses])
    return Trajectory(np.rint(times * 1e9).astype(np.int64), poses[:, :3, 3], matrix_quat(poses[:, :3, :3]))


def _looped(times: np.ndarray, poses: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
    period = times[-1] + _RETURN_S + delay
    rounds = min(int(np.ceil(LOOPED_S / period)), 20_000 // len(times) + 1)
    shift = np.arange(max(rounds, 1)) * period
    return (shift[:, None] + times).reshape(-1), np.tile(poses, (len(shift), 1, 1))
