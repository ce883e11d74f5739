"""Which echoes may have come from a flat wall one unambiguous range farther off.

Such a wall fits every range and bearing of the track alike, so only what else is known can tell: the room there is for
it, how loud its echo could be, and what stands before it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ullage.antenna import BoresightPattern
from ullage.arrays import Bools, Floats
from ullage.processing.blocks import Blocks
from ullage.processing.mapper_looks import Look, lit_ways

TOO_LOUD = 2.0  # times the usual: no wall mirrors so well, unless those heard lately were all heard faintly
BESIDE_M = 1.0  # what stands so near before a wall belongs to it
OWN_CELLS = 3.0  # beyond its own range that an echo's own cells may lie
DOUBT_RAD = 0.12  # of a way in a volume: no vaguer one is told
TRACK_COSINE = 0.97  # a fall of ranges in doubt by 0.01 to 0.03 tells no way that is nearer to the track
ACROSS = (0.0, -0.5, 0.5, -1.0, 1.0)  # rays to parts of the first Fresnel zone, in its half widths


class Fold(NamedTuple):
    """What of a sensor says whether its echoes may be folded."""

    least: float  # cosine to boresight in which echoes are looked for
    pattern: BoresightPattern  # of its antenna
    wave_m: float  # wavelength of the carrier [m]
    fold_m: float  # range at which echoes fold [m]
    loudest_m: float  # amplitude times range that no flat wall's echo exceeds, infinite where it is not known [m]

    def among(self, look: Look, cosine: Floats, blocks: Blocks, *, usual: float) -> Bools:
        """Which echoes (k) of a look on a plane may as well be those of a wall farther off by `fold_m`.

        Args:
            look: with k echoes.
            cosine: of each to the track (k).
            blocks: what the map holds.
            usual: strength, range times height, of the strongest echoes lately heard.
        """
        eye, ahead = look.heard.position, look.heard.axes[:, 0]
        out = np.zeros(len(look.echoes), bool)
        for k, (reach, height) in enumerate(look.echoes[:, [0, 5]].tolist()):
            for way in lit_ways(look.heard.axes, look.track, float(np.clip(cosine[k], -1, 1)), self.least):
                out[k] |= self.may_be(eye, ahead, way, (reach, height), blocks, usual=usual)
        return out

    def may_be(
        self, eye: Floats, ahead: Floats, way: Floats, echo: tuple[float, float], blocks: Blocks, *, usual: float
    ) -> bool:
        """Whether one echo, of a range and height in some way (3), may as well be that of a wall farther off.

        It is not where that would lie off the grid, the doubt of the way allowed for, nor where its echo, which falls
        as one over its range, is too loud for it. Nor where the map holds something before it, but that must cover its
        first Fresnel zone: a mirror echo passes beside what is thinner. What the map holds at the echo's own range is
        no witness: it may be there by such echoes. Past something nearer than both, an echo tells neither from the
        other in a volume.
        """
        reach, height = echo
        far = reach + self.fold_m
        _, inside = blocks.grid.index(eye + far * _about(way, blocks.grid.dims))
        facing = height * float(self.pattern.two_way_loss(float(way @ ahead)))
        if not inside.any() or facing * far >= self._loudest(usual, blocks.grid.dims):
            return False
        step, slope = blocks.grid.step_m, math.sqrt(self.wave_m / (2 * far))  # half the zone's width over its range
        beyond, hidden = reach + OWN_CELLS * step, blocks.grid.dims == 3
        for ray in _zone(way, slope, blocks.grid.dims):
            if blocks.clear_to(eye, ray, reach - step):
                hidden = False
                if blocks.clear_to(eye + beyond * ray, ray, far - BESIDE_M - beyond):
                    return True
        return hidden

    def _loudest(self, usual: float, dims: int) -> float:
        """Strength, range times height, that a wall's echo may have.

        In a volume as much as any flat wall's: where those around are heard at the beam's rim alone, as on a line over
        a tank's axis, the one ahead is much louder than the usual.
        """
        known = dims == 3 and math.isfinite(self.loudest_m)
        return max(TOO_LOUD * usual, self.loudest_m) if known else TOO_LOUD * usual


def alike(way: Floats, track: Floats) -> Iterator[Floats]:
    """A way (3) and, where the fall of ranges cannot tell it from one along the track (3), that one as well."""
    yield way
    along = float(way @ track)
    if abs(along) > TRACK_COSINE:
        yield math.copysign(1.0, along) * track


def is_hidden(blocks: Blocks, eye: Floats, way: Floats, range_m: float, wave_m: float) -> bool:
    """Whether what the map holds hides a place in a way (3): it covers the first Fresnel zone, or is of the same wall.

    An echo passes beside what is narrower. What stands close before the place belongs to its wall, of which not all is
    told: waves go on inside it, and from it round corners.
    """
    if blocks.clear_to(eye, way, range_m):
        return False
    near = max(range_m - BESIDE_M, 0.0)
    if not blocks.clear_to(eye + near * way, way, range_m - near):
        return True
    rays = _zone(way, math.sqrt(wave_m / (2 * range_m)), blocks.grid.dims)
    return not any(blocks.clear_to(eye, ray, range_m / float(ray @ way)) for ray in rays)


def _zone(way: Floats, slope: float, dims: int) -> Iterator[Floats]:
    """Unit vectors (3) through parts of a first Fresnel zone about a way (3), of half width `slope` for each metre."""
    for side in _across(way, dims):
        for part in ACROSS:
            yield (way + part * slope * side) / math.hypot(1.0, part * slope)


def _about(way: Floats, dims: int) -> Floats:
    """Unit vectors (n, 3) in which a wall may stand that was told to be in a way (3): in a volume, that is in doubt."""
    aside = [sign * DOUBT_RAD * side for side in _across(way, dims) for sign in (-1, 1)] if dims == 3 else []
    return np.array([way, *(way + off for off in aside)])


def _across(way: Floats, dims: int) -> list[Floats]:
    """Directions (3) square to a way, across which a Fresnel zone is looked through: level, and in a volume upright."""
    level = np.array([-way[1], way[0], 0.0])
    if dims == 2:
        return [level]
    if np.linalg.norm(level) < 0.1:
        level = np.array([1.0, 0.0, 0.0])
    level = level - (level @ way) * way
    level /= np.linalg.norm(level)
    return [level, np.cross(way, level)]
