"""How the surface of an echo is bent, from the bow of its ranges, and where a bent surface stands.

Off a surface that is bent one way, as a tank's wall, ranges are distances to the line on which its normals meet, the
caustic that waves off it would focus to [BornWolf1999]: less a constant behind that line, more past it. Along a track
t they bow by (t . e)^2 / f, where e is the way across that line and f how far ahead the line is: less than nothing
for a wall nearer than its focus, the range itself for an edge, which has the line in it. Where the track itself bends
by c, that adds n . c. One track tells the bow, not which way the line runs; all its slopes are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.processing.mapper_echoes import Echo

STRAIGHT = float(np.cos(np.radians(35.0)))
LEAST_ECHOES, LEAST_LONG_M, LEAST_SCATTER_M, OFF_M, MOST_MORE = 8, 0.45, 0.003, 0.01, 0.3
FEWEST = 6  # however far apart: a cubic takes four
OWN_SHARE = 0.4  # looks of one window share their frames
SLOPES, LEAST_ACROSS = 8, 0.15  # of the line; share of the track's way beside the echo that runs across it
HOLLOW, FOCUSED = -0.3, 1.7  # bows as shares of that of an edge or pole
LEAST_FOCAL_M = 0.8  # nearer lines are no farther than the stretch is long, and a fourth order tells nothing of them
HEARD = 5.0  # [sigma], since many ways are asked
TANGENTS = np.radians([-60.0, -40.0, -20.0, 20.0, 40.0, 60.0])


@dataclass(frozen=True, slots=True, eq=False)
class Bow:
    """Ranges of one reflector along a straight stretch of track.

    Attributes:
        place: middle of the stretch (3) [m].
        track: unit vector along it (3).
        range_m: there.
        cosine: fall of range for each metre flown there.
        rise: by how much that falls for each metre flown [1/m].
        doubt: of `rise` [1/m].
        curl: by how much the track bends (3) [1/m].
    """

    place: Floats
    track: Floats
    range_m: float
    cosine: float
    rise: float
    doubt: float
    curl: Floats

    def bend(self, ways: Floats) -> Floats:
        """The bow (w) that surfaces in these ways (w, 3) make [1/m]: nothing for flat ones."""
        return np.asarray(self.rise + ways @ self.curl)

    def bent(self, ways: Floats) -> Bools:
        """Whether ranges surely bow (w) as off hollow walls in these ways (w, 3), not flat ones, edges or poles."""
        bend = self.bend(ways)
        share = bend * self.range_m / max(1 - self.cosine**2, 1e-3)
        return np.asarray((abs(bend) > HEARD * self.doubt) & ((share < HOLLOW) | (share > FOCUSED)))


@dataclass(frozen=True, slots=True, eq=False)
class Hollow:
    """A surface that is bent one way.

    Attributes:
        centre: a place on the line on which its normals meet (3) [m].
        axis: unit vector along it (3).
        radius_m: of the surface about that line; less than nothing for one that bulges towards who hears it.
        pieces: how many flat ones told it, where no bow did.
        post: whether it is a thin thing or an edge, told whole.
    """

    centre: Floats
    axis: Floats
    radius_m: float
    pieces: int = 0
    post: bool = False

    def ways(self, places: Floats, toward: Floats) -> Floats:
        """Unit vectors (n, 3) from places (n, 3) to the surface, on the side of a way (3)."""
        gap = self.centre - places
        gap = gap - (gap @ self.axis)[:, None] * self.axis
        gap /= np.maximum(np.linalg.norm(gap, axis=1), 1e-9)[:, None]
        return np.asarray(np.where(gap @ toward < 0, -1.0, 1.0)[:, None] * gap)

    def ranges(self, places: Floats, ways: Floats) -> Floats:
        """Ranges (n) at which places (n, 3) hear it in these ways (n, 3) [m]."""
        return np.asarray(self.radius_m + np.sum((self.centre - places) * ways, axis=1))

    def tangents(self, way: Floats, along: Floats) -> Floats:
        """Planes that touch a hollow surface beside where a way (3) meets it: normals, distances and feet (6, 7) [m].

        Seen from within, such a wall is nowhere farther than any of them.
        """
        across = np.cross(self.axis, way)
        normal = np.cos(TANGENTS)[:, None] * way + np.sin(TANGENTS)[:, None] * across
        foot = self.centre + ((along - self.centre) @ self.axis) * self.axis + self.radius_m * normal
        return np.column_stack([normal, np.sum(normal * foot, axis=1), foot])


def own_share(share: float, echoes: list[Echo]) -> float:
    """Share of what echoes say that is each one's own, from that of a dense flight: looks far apart share no frames."""
    return min(share * sum(e.looks for e in echoes) / len(echoes), 1.0)


def bow_of(echoes: list[Echo]) -> Bow | None:
    """The bow of the last straight stretch of one reflector's echoes; None where that is too short."""
    echoes = [e for e in echoes if abs(e.track @ echoes[-1].track) > STRAIGHT]
    if len(echoes) < FEWEST or sum(e.looks for e in echoes) < LEAST_ECHOES:
        return None
    at, reach = np.array([e.position for e in echoes]), np.array([e.range_m for e in echoes])
    track = at[-1] - at[0]
    long_ = float(np.linalg.norm(track))
    if long_ < LEAST_LONG_M:
        return None
    track /= long_
    place = at.mean(axis=0)
    gap = at - place
    along = gap @ track
    basis = np.vander(along, 4, increasing=True)
    inverse = np.linalg.pinv(basis.T @ basis, rcond=1e-12)
    heard = np.column_stack([reach, gap - along[:, None] * track])
    fit = inverse @ (basis.T @ heard)
    off = np.std(heard - basis @ fit, axis=0)
    if np.linalg.norm(off[1:]) > OFF_M:
        return None
    doubt = (
        2 * max(float(off[0]), LEAST_SCATTER_M) * float(np.sqrt(max(inverse[2, 2], 0.0) / own_share(OWN_SHARE, echoes)))
    )
    cosine = float(np.clip(-fit[1, 0], -1, 1))
    bend = 2 * float(fit[2, 0])
    # distances to a line have a fourth order too, of which a cubic takes some for bend
    more = 3 / 14 * float(along @ along) / len(along) * (bend / max(1 - cosine**2, 0.1)) ** 2 * (15 * cosine**2 - 3)
    bend /= 1 + float(np.clip(more, -MOST_MORE, MOST_MORE))
    return Bow(place + fit[0, 1:], track, float(fit[0, 0]), cosine, bend, doubt, 2 * fit[2, 1:])


def lines_of(bow: Bow, ways: Floats) -> tuple[Longs, Floats, Floats, Floats]:
    """Lines on which normals of surfaces meet that bow ranges so, of all slopes for each way (w, 3).

    Returns the way (l) and direction (l, 3) of each line, how far ahead it is (l) [m], and its doubt in bend (l) [1/m].
    """
    which = np.repeat(np.arange(len(ways)), SLOPES)
    turn = np.tile(np.arange(SLOPES) * (np.pi / SLOPES), len(ways))[:, None]
    way = ways[which]
    level = np.cross(way, np.where(abs(way[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    level /= np.linalg.norm(level, axis=1)[:, None]
    axis = np.cos(turn) * level + np.sin(turn) * np.cross(level, way)
    across = (np.cross(axis, way) @ bow.track) ** 2
    keep = (across > LEAST_ACROSS * max(1 - bow.cosine**2, 1e-3)) & bow.bent(way)
    focal = across / np.where(keep, bow.bend(way), 1.0)
    keep &= abs(focal) > LEAST_FOCAL_M
    return which[keep], axis[keep], focal[keep], bow.doubt / across[keep]


def hollow_of(bow: Bow, way: Floats, axis: Floats) -> Hollow:
    """The surface that a stretch hears in a way (3), with its line of that direction (3)."""
    axis = axis - (axis @ way) * way
    axis /= np.linalg.norm(axis)
    focal = float(np.cross(axis, way) @ bow.track) ** 2 / float(bow.bend(way))
    return Hollow(bow.place + focal * way, axis, bow.range_m - focal)
