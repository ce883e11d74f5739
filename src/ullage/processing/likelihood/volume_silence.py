"""What the silence of keyframes leaves free in a volume."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.grids import Grid
from ullage.kernels.directed_sums import Patterns
from ullage.kernels.volume_cells import BODY_M, Box
from ullage.kernels.volume_silence import (
    SIDE,
    Cube,
    Ends,
    Hearing,
    Silence,
    add_power,
    count_body,
    count_silence,
    exclude_surfaces,
    find_sights,
    limit,
    look,
    look_again,
)
from ullage.processing.likelihood.directions import DirectedEchoes
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.volume_surfaces import FAINTEST_DB, PROJECTORS, SpatialSurface, transported

CELL_MARGIN_M = 0.15  # more than in a plane, which asks for whole cells: pulse width and half a block
QUIET_M = 0.1  # places whose silence is kept apart
STEP_M = 0.1  # of range, in which silence is kept
LEAST_OCCLUDER_DB = (
    -22.0
)  # against a mirror: a metal pole of 5 cm at 3 m, by the root of radius over 2 (range + radius)
LATTICE_M = 0.2  # between the places at which surfaces are excluded
UPRIGHT_NORMALS, SLOPED_NORMALS, SLOPES_DEG = 24, 39, (12.0, 80.0)  # every 7.5 deg; over the sphere between two slopes
LEVEL_PRIOR, UPRIGHT_PRIOR, SLOPED_PRIOR = 0.3, 0.5, 0.2  # shares of all surfaces: assumed, not counted
MOST_LEFT = 0.06  # share of these that may be left in a free cell; chosen on the tuning kinds
SIGHT_ROUNDS = 2
BLOCKED = 10.0  # an echo of open direction ends silence unless it is as much weaker than the least occluder
LEAST_VIEWS = 5  # keyframes that would have received an occluder
MANY = 1500  # changed cells of the lattice, from which lines of sight are followed anew


@dataclass(frozen=True, slots=True, eq=False)
class Radar:
    """What the map needs to know of the sensors."""

    wavelength_m: float  # of the carrier
    fold_m: float  # unambiguous range
    mirror_m: float  # amplitude times range of a perfect mirror before an antenna of 0 dBi; infinite where not known


@dataclass(frozen=True, slots=True, eq=False)
class Quiet:
    """What one keyframe received, for the silence between."""

    position: Floats  # (3) [m]
    patterns: Patterns  # of the sensors
    rows: Floats  # (s)
    masked: Floats  # (b) energy below which an echo stays unseen, each `STEP_M`
    range_m: Floats  # (e) of its echoes
    energy: Floats  # (e)
    number: Longs  # (e) of the surface, or -1


def _quiet_of(echoes: DirectedEchoes, number: Longs) -> Quiet:
    """What a keyframe did not receive."""
    step = ((echoes.start_m + echoes.bin_m * np.arange(len(echoes.silent))) / STEP_M).astype(int)
    masked = np.zeros(step.max() + 1)
    np.maximum.at(masked, np.maximum(step, 0), echoes.silent)
    return Quiet(echoes.position, echoes.patterns, echoes.rows, masked, echoes.state[:, 0], echoes.energy, number)


class Sighted(NamedTuple):
    """A surface of one direction, which ends lines of sight."""

    surface: SpatialSurface
    fold_m: float  # by which it lies beyond its echoes' range


def box_of(grid: Grid) -> Box:
    """Cells of a grid."""
    return Box(*grid.origin_m, grid.step_m, *grid.shape)


class VolumeSilence:
    """Cells in which neither an occluder nor a surface of any normal stands: each would have been received.

    Where a surface may stand unheard, it hides what lies behind, so the cells that the first round leaves open end the
    lines of sight of the next. What keyframes see is kept from map to map, and changed where cells or surfaces changed.
    """

    def __init__(self, grid: Grid, spec: LikelihoodSpec) -> None:
        self._grid, self._spec, self._box = grid, spec, box_of(grid)
        self._coarse = max(round(LATTICE_M / grid.step_m), 1)
        self._count = tuple(-(-cells // self._coarse) for cells in grid.shape)
        self._lattice = Box(*grid.origin_m, self._coarse * grid.step_m, *self._count)
        self._rows: dict[tuple[int, ...], int] = {}  # of the keyframe kept at each place
        self._quiets: list[Quiet] = []
        self._fresh: set[int] = set()  # rows of keyframes that were not listened to
        self._levels: tuple[object, ...] = ()  # that all rows rest on
        self._heard = _Heard.of(0, 0)
        self._rounds = [_Round.of(grid.size, math.prod(self._count)) for _ in range(SIGHT_ROUNDS)]

    def add(self, echoes: DirectedEchoes, number: Longs) -> None:
        """Take what a keyframe did not receive, and forget an earlier one at its place."""
        place = tuple(np.floor(echoes.position / QUIET_M).astype(int).tolist())
        row = self._rows.setdefault(place, len(self._quiets))
        self._quiets[row : row + 1] = [_quiet_of(echoes, number)]
        self._fresh.add(row)

    def free(self, surfaces: Sequence[Sighted], occupied: Bools, radar: Radar) -> Bools:
        """Return the cells that are free.

        Args:
            surfaces: those of one direction, which end silence before their echoes.
            occupied: (cells) that end a line of sight.
            radar: the sensors.
        """
        if not self._quiets:
            return np.zeros(self._grid.size, bool)
        silence, (normals, prior) = self._listen(surfaces, radar), _normals()
        fresh, blocked = np.array(sorted(self._fresh), np.int64), occupied
        self._fresh.clear()
        free = np.ones(len(self._rounds[0].looks[0]), bool)
        along, range_m = normals @ silence.position.T, (np.arange(silence.masked.shape[1]) + 0.5) * STEP_M
        for each in self._rounds:
            each.follow(self._box, self._lattice, silence, self._coarsened(blocked != each.blocked), blocked, fresh)
            quiet, still = each.count(self._lattice, silence, self._heard.most)
            seen = range_m < (each.counted[:, _facing(), None] * STEP_M)
            walls = np.ascontiguousarray(((seen & self._heard.loud) | (range_m < BODY_M)).transpose(1, 0, 2))
            heard = Hearing(self._lattice, silence.position, along, walls, STEP_M, quiet, still)
            exclude_surfaces(heard, normals, prior, MOST_LEFT, free)
            blocked = occupied | self._fine(quiet & ~free)
        return self._fine(free)

    def _coarsened(self, cells: Bools) -> Longs:
        """Cells of the lattice that hold any of these."""
        i, j, k = np.unravel_index(np.flatnonzero(cells), self._grid.shape)
        across = self._coarse
        return np.unique(np.ravel_multi_index((i // across, j // across, k // across), self._count))

    def _fine(self, cells: Bools) -> Bools:
        """Cells within these of the lattice."""
        out = cells.reshape(self._count)
        for axis in range(3):
            out = out.repeat(self._coarse, axis)
        return out[tuple(slice(n) for n in self._grid.shape)].ravel()

    def _listen(self, surfaces: Sequence[Sighted], radar: Radar) -> Silence:
        """Bring what is kept of the keyframes up to date."""
        mirror_m = radar.mirror_m
        if not math.isfinite(mirror_m):  # uncalibrated samples: the strongest surface is the mirror
            levels_m = [np.median([seen.level for seen in one.surface.sightings.values()]) for one in surfaces]
            mirror_m = float(max(levels_m, default=0.0))
        count, steps = len(self._quiets), len(self._quiets[0].masked)
        levels = mirror_m, radar.wavelength_m
        if levels != self._levels or steps != self._heard.masked.shape[1]:
            self._levels, self._heard, self._fresh = levels, _Heard.of(0, steps), set(range(count))
            self._rounds = [_Round.of(self._grid.size, math.prod(self._count)) for _ in self._rounds]
        occluder_m, wall_m = (mirror_m * 10 ** (level_db / 20) for level_db in (LEAST_OCCLUDER_DB, FAINTEST_DB))
        edge_m = mirror_m * math.sqrt(radar.wavelength_m / 2) / math.pi  # of a half plane [Keller1962]
        before = self._heard
        old = Silence(before.position, before.power, before.masked, STEP_M, occluder_m, edge_m)
        for each in self._rounds:
            each.forget(self._lattice, old, sorted(row for row in self._fresh if row < len(before.position)), count)
        self._heard = heard = before.grown(count)
        range_m = (np.arange(steps) + 0.5) * STEP_M
        for k in sorted(self._fresh):
            quiet, wall = self._quiets[k], np.empty(2 * len(_normals()[0]))
            heard.position[k], heard.masked[k] = quiet.position, quiet.masked
            for unit, power in ((_cube().unit, heard.power[k]), (_both_ways(), wall)):
                add_power(quiet.patterns, quiet.rows, unit, power)
            heard.loud[k] = quiet.masked <= wall[:, None] * (wall_m / range_m) ** 2
        for each in self._rounds:
            for k in self._fresh:
                count_body(self._lattice, heard.position[k], 1, each.looks)
        silence = Silence(heard.position, heard.power, heard.masked, STEP_M, occluder_m, edge_m)
        self._limit(silence, surfaces)
        return silence

    def _limit(self, silence: Silence, surfaces: Sequence[Sighted]) -> None:
        """Bring up to date where surfaces and echoes of open direction end lines of sight."""
        heard, sizes = self._heard, [len(one.range_m) for one in self._quiets]
        owner, range_m = np.repeat(np.arange(len(sizes)), sizes), np.concatenate([one.range_m for one in self._quiets])
        energy, number = (np.concatenate([getattr(one, name) for one in self._quiets]) for name in ("energy", "number"))
        column = np.arange(len(owner)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        before_m = range_m - self._spec.margin_m - CELL_MARGIN_M
        plane = np.zeros((len(sizes), max(*sizes, 1, heard.plane.shape[1]), 4))
        known = {one.surface.number: k for k, one in enumerate(surfaces)}
        which = np.array([known.get(one, -1) for one in number.tolist()], np.int64)
        if (sure := np.flatnonzero(which >= 0)).size:
            every = [one.surface for one in surfaces]
            state, place = (
                np.array([one.states[one.leader] for one in every]),
                np.array([one.position for one in every]),
            )
            projector = PROJECTORS[[one.shapes[one.leader] for one in every]]
            fold_m, mine = np.array([one.fold_m for one in surfaces]), which[sure]
            seen = transported(state[mine], projector[mine], silence.position[owner[sure]] - place[mine])
            plane[owner[sure], column[sure], :3] = seen[:, 1:4]
            plane[owner[sure], column[sure], 3] = np.maximum(before_m[sure] + fold_m[mine], 1e-3)
        open_ = np.zeros_like(silence.masked)
        for q in np.flatnonzero(which < 0).tolist():
            near = slice(max(int(before_m[q] / STEP_M), 0), int(range_m[q] / STEP_M) + 2)
            open_[owner[q], near] = np.maximum(open_[owner[q], near], BLOCKED * energy[q])
        held = np.zeros_like(plane)
        held[:, : heard.plane.shape[1]] = heard.plane
        changed = (held != plane).any(axis=(1, 2)) | (heard.open != open_).any(axis=1)
        changed[sorted(self._fresh)] = True
        limit(silence, _cube(), plane, open_, np.flatnonzero(changed), heard.most)
        self._heard = heard._replace(plane=plane, open=open_)


class _Heard(NamedTuple):
    """What is kept of the keyframes; a row each."""

    position: Floats  # (k, 3) [m]
    power: Floats  # (k, d) two-way power gain along each line of sight
    masked: Floats  # (k, b) energy below which an echo stays unseen
    loud: Bools  # (k, 2 n, b) whether a wall across each normal would have been received
    plane: Floats  # (k, q, 4) unit vector and distance of the known surfaces
    open: Floats  # (k, b) energy of echoes of open direction
    most: Ends  # (k, d) ends of the lines of sight by surfaces and echoes

    @classmethod
    def of(cls, count: int, steps: int) -> _Heard:
        """Rows of nothing."""
        sights, walls = len(_cube().unit), 2 * len(_normals()[0])
        return cls(
            np.zeros((count, 3)), np.zeros((count, sights)), np.zeros((count, steps)),
            np.zeros((count, walls, steps), bool), np.zeros((count, 1, 4)), np.zeros((count, steps)),
            np.zeros((count, sights), np.int16),
        )  # fmt: skip

    def grown(self, count: int) -> _Heard:
        """The same with more rows."""
        return _Heard(*(_grown(part, count) for part in self))


def _grown(rows: Any, count: int) -> Any:
    """Rows (k, ...) with zeros up to a count."""
    return np.concatenate([rows, np.zeros((count - len(rows), *rows.shape[1:]), rows.dtype)])


@dataclass(slots=True)
class _Round:
    """What the keyframes see by the cells that end lines of sight in one round."""

    blocked: Bools  # (cells) that do
    end: Ends  # (k, d) of each line of sight by these
    counted: Ends  # (k, d) ends of those as counted
    looks: Ints  # (2, cells of the lattice) keyframes that would have received an occluder, and an edge

    @classmethod
    def of(cls, cells: int, count: int) -> _Round:
        """A round that saw nothing."""
        none = np.zeros((0, len(_cube().unit)), np.int16)
        return cls(np.zeros(cells, bool), none, none, np.zeros((2, count), np.int32))

    def forget(self, lattice: Box, silence: Silence, rows: Sequence[int], count: int) -> None:
        """Take back what these keyframes saw, and make room for more."""
        end = self.counted.copy()
        end[rows] = 0
        count_silence(lattice, silence, _cube(), self.counted, end, self.looks)
        for k in rows:
            count_body(lattice, silence.position[k], -1, self.looks)
        self.counted, self.end = _grown(end, count), _grown(self.end, count)

    def follow(self, box: Box, lattice: Box, silence: Silence, changed: Longs, blocked: Bools, fresh: Longs) -> None:
        """Follow the lines of sight of new keyframes, and of all where cells of the lattice (c) changed."""
        if len(changed) > MANY:
            fresh = np.arange(len(self.end))
        else:
            others = np.setdiff1d(np.arange(len(self.end)), fresh)
            look_again(box, lattice, silence, _cube(), blocked, changed, others, self.end)
        look(box, silence, _cube(), blocked, fresh, self.end)
        self.blocked = blocked

    def count(self, lattice: Box, silence: Silence, most: Ends) -> Bools:
        """Whether enough keyframes would have received an occluder, and an edge, in each cell (2, cells)."""
        end = np.minimum(self.end, most)
        count_silence(lattice, silence, _cube(), self.counted, end, self.looks)
        self.counted = end
        return np.asarray(self.looks >= LEAST_VIEWS)


@lru_cache(maxsize=1)
def _cube() -> Cube:
    """Lines of sight."""
    edge = 2 * np.arange(SIDE + 1) / SIDE - 1
    middle, ends = 0.5 * (edge[1:] + edge[:-1]), (edge[:-1], edge[1:])
    corners = np.stack([_directions(a, b) for a in ends for b in ends])
    return Cube(_directions(middle, middle), corners.min(axis=0), corners.max(axis=0))


def _directions(one: Floats, two: Floats) -> Floats:
    """Unit vectors (6 m m, 3) of places on the faces of a cube: +x -x +y -y +z -z."""
    a, b = (part.ravel() for part in np.meshgrid(one, two, indexing="ij"))
    side = np.ones_like(a)
    faces = [np.stack(part, axis=1) for plus in (side, -side) for part in ((plus, a, b), (a, plus, b), (a, b, plus))]
    way = np.concatenate([faces[k] for k in (0, 3, 1, 4, 2, 5)])
    return np.ascontiguousarray(way / np.linalg.norm(way, axis=1, keepdims=True))


def _both_ways() -> Floats:
    """Normals and their opposites (2 n, 3)."""
    return np.concatenate([_normals()[0], -_normals()[0]])


@lru_cache(maxsize=1)
def _facing() -> Longs:
    """Line of sight along each normal, and its opposite (2 n)."""
    number = np.empty(len(_both_ways()), np.int64)
    find_sights(_both_ways(), number)
    return number


@lru_cache(maxsize=1)
def _normals() -> tuple[Floats, Floats]:
    """Normals (n, 3) of surfaces over half the sphere, the level one first, then upright ones, and priors (n)."""
    course = (np.arange(UPRIGHT_NORMALS) + 0.5) / UPRIGHT_NORMALS * math.pi
    upright = np.column_stack([np.cos(course), np.sin(course), np.zeros(UPRIGHT_NORMALS)])
    low, high = (math.sin(math.radians(slope)) for slope in SLOPES_DEG)
    z = np.linspace(low, high, SLOPED_NORMALS)
    turn, side = math.pi * (1 + math.sqrt(5)) * np.arange(SLOPED_NORMALS), np.sqrt(1 - z**2)
    sloped = np.column_stack([side * np.cos(turn), side * np.sin(turn), z])
    prior = np.repeat([LEVEL_PRIOR, UPRIGHT_PRIOR / UPRIGHT_NORMALS, SLOPED_PRIOR / SLOPED_NORMALS],
                      [1, UPRIGHT_NORMALS, SLOPED_NORMALS])  # fmt: skip
    return np.concatenate([[[0.0, 0.0, 1.0]], upright, sloped]), prior
