"""What the radar sees: one ray to the middle of every piece of surface, through thin sheets where there are any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels import rays as kernel
from ullage.kernels import shadow_borders
from ullage.kernels.rays import MetSheets
from ullage.kernels.shadow_borders import FollowedMesh, ShadowEnds, ShadowLines
from ullage.radar.facets import Surfaces, TransmissiveFaces
from ullage.radar.penetration import Transmissive
from ullage.world.raycast import Raycaster

SLACK_M = 2e-3
"""Two surfaces nearer than this along a ray count as one [m]; Embree's float32 and shared edges need it."""
LEAVE_M = 1e-4
"""What stands so near before the radar hides nothing [m]: in Embree's float32 a radar on a face may be behind it."""
SHEETS = 4
"""A wave is followed through at most so many sheets, one way."""


def seen(
    parts: Sequence[Surfaces], origin: Floats, points: Floats, transmissive: Transmissive
) -> tuple[Complexes, Floats]:
    """Two-way factor (n) and delay [s] (n) of what stands between the origin (3) and points (n, 3) on surfaces.

    1 in the open, 0 behind anything opaque; behind thin sheets what they let through, at most `SHEETS` of them.
    """
    casters = [part.casters(transmissive.thin) for part in parts]
    veils = [veil for _, veil in casters if veil is not None]
    clear = _clear([opaque for opaque, _ in casters], origin, points, LEAVE_M)
    factor, late = clear.astype(complex), np.zeros(len(points))
    if veils:
        _through(veils, origin, points, np.flatnonzero(clear), transmissive, factor, late)
    return factor, late


def _through(
    veils: Sequence[TransmissiveFaces],
    origin: Floats,
    points: Floats,
    todo: Longs,
    transmissive: Transmissive,
    factor: Complexes,
    late: Floats,
) -> None:
    """Follows the rays to some of the points through sheet after sheet, where there is any."""
    bare = np.ones(len(todo), bool)
    for veil in veils:
        bare &= veil.rays.visible(origin, points[todo], slack_m=SLACK_M)
    todo = todo[~bare]
    if not len(todo):
        return
    ray = points[todo] - origin
    length = np.sqrt(np.einsum("ni,ni->n", ray, ray))
    ray /= np.maximum(length, 1e-9)[:, None]
    passed = np.zeros(len(todo))
    table = kernel.SheetTable(transmissive.factor, transmissive.delay_s)
    for step in range(SHEETS + 1):
        met = _first(veils, origin + ray * passed[:, None], ray)
        walk = kernel.SheetWalk(todo, length, passed, ray)
        count = kernel.pass_transmissive(walk, met, table, SLACK_M, step == SHEETS, factor, late)
        if not count:
            return
        todo, length, passed, ray = todo[:count], length[:count], passed[:count], ray[:count]


def _first(veils: Sequence[TransmissiveFaces], origins: Floats, rays: Floats) -> MetSheets:
    """Find the first sheet that each ray (n) meets; its distance is inf where there is none."""
    if len(veils) == 1:
        face, distance, slope = veils[0].rays.trace(origins, rays)
        return MetSheets(distance, veils[0].object_ids[face], slope)
    least = np.full(len(rays), np.inf)
    object_id, cosine = np.zeros(len(rays), np.int32), np.ones(len(rays))
    for veil in veils:
        face, distance, slope = veil.rays.trace(origins, rays)
        near = np.flatnonzero((face >= 0) & (distance < least))
        least[near], object_id[near], cosine[near] = distance[near], veil.object_ids[face[near]], slope[near]
    return MetSheets(least, object_id, cosine)


def between(parts: Sequence[Surfaces], a: Floats, b: Floats) -> Bools:
    """Whether nothing stands between the points a (n, 3) and b (n, 3), which may lie on surfaces."""
    return _clear([part.rays for part in parts], a, b, SLACK_M)


def _clear(opaque: Sequence[Raycaster], a: Floats, b: Floats, leave_m: float) -> Bools:
    """Whether nothing opaque stands between places a (3) or (n, 3), from so far off them on, and b (n, 3)."""
    out = None
    for rays in opaque:
        open_ = rays.visible(a, b, slack_m=SLACK_M, leave_m=leave_m)
        out = open_ if out is None else out & open_
    return np.ones(len(b), np.bool_) if out is None else out


@dataclass(frozen=True, slots=True, eq=False)
class OpaqueView:
    """Opaque surfaces as seen from one place."""

    opaque: Sequence[Raycaster]
    origin: Floats  # (3) [m]

    def clear(self, points: Floats) -> Bools:
        """Whether nothing stands before points (n, 3) on surfaces."""
        return _clear(self.opaque, self.origin, points, LEAVE_M)

    def shadow_ends(self, dark: Floats, lines: ShadowLines) -> ShadowEnds:
        """Find where the shadows that hide dark places (b, 3) on lines (b) stop."""
        many = len(dark)
        ends = ShadowEnds(np.ones(many), np.full(many, -np.inf), np.ones(many), np.zeros((many, 2, 3)))
        for rays in self.opaque if many else ():
            for met in rays.first_faces(self.origin, dark, leave_m=LEAVE_M, slack_m=SLACK_M):
                eye, turn = self.origin, np.eye(3)
                to_dark, seen = dark - eye, lines
                if met.pose is not None:
                    turn = met.pose[:3, :3].copy()
                    eye, to_dark = (eye - met.pose[:3, 3]) @ turn, to_dark @ turn
                    seen = lines._replace(middles=lines.middles @ turn, along=lines.along @ turn)
                mesh = FollowedMesh(met.corners, met.neighbours, turn)
                shadow_borders.follow(mesh, met.faces, eye, to_dark, seen, ends, np.empty((2, 3)))
        return ends
