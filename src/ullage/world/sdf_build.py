"""Gathers objects and their shapes, one after the other, into a Scene."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import apply
from ullage.world import shapes
from ullage.world.meshes import MOST_FACES, Mesh
from ullage.world.scene import Scene, SceneObject, Wires
from ullage.world.sdf_geometry import SAGITTA_M, Rod


@dataclass(slots=True)
class SceneBuilder:
    """Parts read so far."""

    objects: list[SceneObject] = field(default_factory=list)
    meshes: list[tuple[Mesh, Floats]] = field(default_factory=list)  # with frame_from_shape; equal ones share arrays
    owners: list[int] = field(default_factory=list)
    rods: list[tuple[Floats, Floats, float, int]] = field(default_factory=list)
    faces: int = 0

    def add_object(self, thing: SceneObject) -> int:
        """Index of a new object."""
        self.objects.append(thing)
        return len(self.objects) - 1

    def add_shape(self, owner: int, shape: Mesh | Rod, frame_from_shape: Floats) -> None:
        """Give an object one more shape, placed in the world, or in the object's own frame if it moves.

        Raises:
            InputError: the scene grows beyond any use.
        """
        if isinstance(shape, Rod) and self.objects[owner].motion is None:
            ends = apply(frame_from_shape, [[0, 0, -shape.length_m / 2], [0, 0, shape.length_m / 2]])
            self.rods.append((ends[0], ends[1], shape.radius_m, owner))
            return
        if isinstance(shape, Rod):  # wires stand still, so a moving rod is meshed
            segment = shapes.sagitta_segment_m(shape.radius_m, SAGITTA_M)
            shape = shapes.cylinder(shape.radius_m, shape.length_m, segment_m=segment)
        self.faces += len(shape[1])
        if self.faces > MOST_FACES:
            raise InputError(f"more than {MOST_FACES} triangles in all", allowed="simpler meshes, or fewer of them")
        self.meshes.append((shape, frame_from_shape))
        self.owners.append(owner)

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
