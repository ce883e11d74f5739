"""A scene prepared for physical optics: parts at rest, moving parts, materials and edges."""

from __future__ import annotations

import threading
from collections import OrderedDict
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.geometry import invert
from ullage.radar.diffraction import sharp_edges
from ullage.radar.facets import Surfaces, gather, only
from ullage.radar.movers import Movers
from ullage.radar.own_body import of_body
from ullage.radar.patches import Curved, Patches, curved_of, patches_of
from ullage.radar.quadrics import Quadric, SmoothSurface, quadrics_of, rods_of, smooth_surfaces_of, walls_of, with_caps
from ullage.radar.spheres import Sphere, balls_of, spheres_of
from ullage.world import smoothing
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

Shape = TypeVar("Shape", Quadric, Sphere)


class Prepared:
    """The part of a scene at rest, prepared once, and the moving part at the last requested poses."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        moves = np.array([o.motion is not None for o in scene.objects], bool)
        self.own = of_body(scene)
        self.moving = moves[scene.face_object] if len(scene.faces) else np.zeros(0, bool)
        self.still = gather(scene, ~self.moving)
        self.materials = tuple(o.material for o in scene.objects)
        self.rough = any(material.roughness_m for material in self.materials)
        self._movers = Movers(scene, self.moving) if self.moving.any() else None
        self._moved: tuple[bytes, Surfaces] | None = None  # last requested poses, and the surfaces there
        self.diffuse_scatterers: dict[int, Any] = {}  # scatterers of rough surfaces, by seed
        self._patches: dict[tuple[float, float], list[Patches | None]] = {}
        self._moved_patches: tuple[tuple[tuple[float, float], bytes], Patches] | None = None
        spare = np.concatenate([part.spare for part in self._at_start()])
        if len(spare):  # two skins of a sheet have the edges of one
            kept = np.delete(np.arange(len(scene.faces)), spare)
            self.edges = sharp_edges(only(scene, kept), Raycaster(only(scene, kept[~self.moving[kept]])))
        else:
            self.edges = sharp_edges(scene, self.still.rays)

    @cached_property
    def quadrics(self) -> tuple[Quadric, ...]:
        """Cylinders and spheres fitted to the world at its initial poses."""
        return with_caps(quadrics_of(self._smooth_surfaces, self._walls), self.scene)

    @cached_property
    def spheres(self) -> tuple[Sphere, ...]:
        """Spheres and domes at rest."""
        moves = [o.motion is not None for o in self.scene.objects]
        return spheres_of([surface for surface in self._smooth_surfaces if not moves[surface.object_id]], self.still)

    @cached_property
    def rods(self) -> list[Quadric]:
        """Whole cylinders of any radius at their initial poses."""
        return rods_of(self._smooth_surfaces, self._walls)

    @cached_property
    def _walls(self) -> list[Quadric | None]:
        return walls_of(self._smooth_surfaces)

    @cached_property
    def _balls(self) -> tuple[Sphere, ...]:
        return balls_of(self._smooth_surfaces)

    def balls_at(self, poses: Floats | None) -> tuple[Sphere, ...]:
        """Return the whole balls of any size at some poses of the objects (None: the initial ones)."""
        return self._at(self._balls, poses)

    def patches(self, wavelength_m: float, widest_m: float, poses: Floats | None = None) -> list[Patches | None]:
        """Curved surfaces of other shapes in each of `parts`, cut for a wavelength [m]; None where there are none.

        Facets wider than `widest_m` [m] are left as they are.
        """
        key = wavelength_m, widest_m
        if key not in self._patches:
            self._patches[key] = [
                curved and patches_of(curved, part, wavelength_m=wavelength_m, widest_m=widest_m, world=self.scene.name)
                for part, curved in zip(self._at_start(), self._curved, strict=True)
            ]
        out = self._patches[key]
        if self._movers is None or out[1] is None:
            return out
        poses = self.scene.poses() if poses is None else poses
        where = key, poses.tobytes()
        known = self._moved_patches
        if known is None or known[0] != where:
            known = self._moved_patches = (where, self._movers.patches_at(out[1], poses))
        return [out[0], known[1]]

    @cached_property
    def _curved(self) -> list[tuple[Curved, Bools, Longs] | None]:
        """Curved surfaces of each of `parts`, where it starts."""
        bent = [part.planar.smooth.any() or len(part.corners) for part in self._at_start()]
        return [curved_of(self.scene, part, self._closed_normals()) if some else None
                for part, some in zip(self._at_start(), bent, strict=True)]  # fmt: skip

    def _at_start(self) -> list[Surfaces]:
        return [self.still] if self._movers is None else [self.still, self._movers.home]

    def _closed_normals(self) -> Floats:
        """Return normals (s, 3, 3) of closed forms at the corners of the faces that lie on them; zero at others."""
        corners = self.scene.corners()
        out = np.zeros_like(corners)
        for wall in self.quadrics:
            out[wall.faces] = wall.radial(corners[wall.faces])
        for sphere in self.spheres:
            out[sphere.faces] = corners[sphere.faces] - sphere.centre
        sides = np.einsum("fki,fi->fk", out, smoothing.face_normals(corners)[0])
        return np.asarray(out / np.copysign(np.maximum(np.linalg.norm(out, axis=2), 1e-300), sides)[..., None])

    @cached_property
    def _smooth_surfaces(self) -> list[SmoothSurface]:
        bent = self.still.planar.smooth.any() or len(self.still.corners) or self.moving.any()
        return smooth_surfaces_of(self.scene, np.ones(len(self.moving), bool)) if bent else []

    def quadrics_at(self, poses: Floats | None) -> tuple[Quadric, ...]:
        """Return the fitted cylinders and spheres at some poses of the objects (None: the initial ones)."""
        return self._at(self.quadrics, poses)

    def _at(self, rows: tuple[Shape, ...], poses: Floats | None) -> tuple[Shape, ...]:
        if poses is None or not rows:
            return rows
        start = self.scene.poses()
        moved = [o.motion is not None for o in self.scene.objects]
        return tuple(
            r.moved(poses[r.object_id] @ invert(start[r.object_id])) if moved[r.object_id] else r for r in rows
        )

    def poses(self, t_ns: Longs) -> Floats | list[None]:
        """Return the poses of all objects (n, o, 4, 4) at times (n) [ns]; None for each where nothing moves.

        Those of parts of the radars' own body are in the body's frame.
        """
        return self.scene.poses(t_ns) if any(o.motion is not None for o in self.scene.objects) else [None] * len(t_ns)

    def parts(self, poses: Floats | None = None) -> list[Surfaces]:
        """Return the surfaces at rest and the moving ones at some poses of the objects (None: the initial ones)."""
        if self._movers is None:
            return [self.still]
        poses = self.scene.poses() if poses is None else poses
        where = poses.tobytes()
        known = self._moved
        if known is None or known[0] != where:  # several radars ask for the same poses
            known = self._moved = (where, self._movers.at(poses))
        return [self.still, known[1]]


_LOCK = threading.Lock()
_KNOWN: OrderedDict[int, Prepared] = OrderedDict()
_KEPT = 4


def prepare(scene: Scene) -> Prepared:
    """Prepare a scene; the last few are cached, since tracks arrive in pieces."""
    with _LOCK:
        known = _KNOWN.get(id(scene))
        if known is None or known.scene is not scene:
            known = _KNOWN[id(scene)] = Prepared(scene)
        _KNOWN.move_to_end(id(scene))
        while len(_KNOWN) > _KEPT:
            _KNOWN.popitem(last=False)
        return known
