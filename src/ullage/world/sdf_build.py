"""Gathers objects and their shapes, one after the other, into a Scene."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.geometry import apply
from ullage.world import shapes
from ullage.world.meshes import MOST_FACES, Mesh, joined
from ullage.world.scene import Scene, SceneObject, Wires
from ullage.world.sdf_geometry import SAGITTA_M, Rod

Floats = NDArray[np.float64]


@dataclass(slots=True)
class SceneBuilder:
    """What was read so far."""

    objects: list[SceneObject] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
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
        self.meshes.append((apply(frame_from_shape, shape[0]), shape[1]))
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
