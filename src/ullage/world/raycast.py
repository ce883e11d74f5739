"""First hits of rays on a scene: triangle ids from Embree (float32), distances recomputed in float64 [Embree]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.world.scene import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class Raycaster:
    """Casts rays into a scene as it stands at one time.

    Args:
        scene: what can be hit; wires are not.
        t_ns: where moving objects are; None: their start.
    """

    def __init__(self, scene: Scene, *, t_ns: int | None = None) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self.corners = scene.corners(t_ns)
        edge1, edge2 = self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        cross = np.cross(edge1, edge2)
        norm = np.linalg.norm(cross, axis=1, keepdims=True)
        self.normals: Floats = cross / np.where(norm > 0, norm, 1.0)
        self._scene = EmbreeScene()
        if len(self.corners):
            TriangleMesh(self._scene, np.ascontiguousarray(self.corners, np.float32))

    def hits(self, origins: Floats, directions: Floats) -> tuple[Ints, Floats]:
        """First face each ray meets.

        Args:
            origins: (n, 3) or (3) [m].
            directions: (n, 3) unit vectors.

        Returns:
            Face ids (n), -1 where nothing is hit, and distances (n) [m], inf there.
        """
        rays = np.ascontiguousarray(directions, np.float64)
        start = np.broadcast_to(np.asarray(origins, np.float64), rays.shape)
        if not len(self.corners):
            return np.full(len(rays), -1, np.int32), np.full(len(rays), np.inf)
        ids = self._scene.run(np.ascontiguousarray(start, np.float32), rays.astype(np.float32), query="INTERSECT")
        face = np.asarray(ids, np.int32)
        hit = face >= 0
        normal = self.normals[face[hit]]
        along = np.einsum("ni,ni->n", normal, rays[hit])
        gap = np.einsum("ni,ni->n", normal, self.corners[face[hit], 0] - start[hit])
        distance = np.full(len(rays), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance[hit] = gap / along
        bad = hit & ~(distance >= 0)
        face[bad], distance[bad] = -1, np.inf
        return face, distance

    def visible(self, origin: Floats, targets: Floats, *, slack_m: float = 1e-3) -> NDArray[np.bool_]:
        """Whether nothing stands between the origin (3) and each target (n, 3), but for the last `slack_m`."""
        ray = np.asarray(targets, float) - origin
        length = np.linalg.norm(ray, axis=1)
        _, distance = self.hits(origin, ray / np.maximum(length, 1e-12)[:, None])
        return np.asarray(distance >= length - slack_m)
