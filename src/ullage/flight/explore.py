"""Choose the next view on the map of a plane: the one that could teach most for its time.

Frontiers of free space draw the vehicle [Yamauchi1997]. A view is worth the unknown and ambiguous cells that its rays
would enter, and a path what its views teach, discounted by when they do, as in next-best-view planners
[BircherEtAl2016] [DangEtAl2020]. Radars see a smooth surface only along its normal, so a cell that a view did not teach
may need another direction. Each view therefore counts in its direction alone, and what n of them left unknown is
learned by the next one with a chance of 1 / (1 + n), by the rule of succession.

Beams free little space between walls. Paths may therefore cross unknown cells, as if they were free, until the map or
the guard shows otherwise [KoenigEtAl2003]. Unknown space costs more time than space known to be free. With a least
probability that space is free, every other cell counts as a surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt, uniform_filter
from scipy.sparse.csgraph import dijkstra

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.errors import InputError
from ullage.flight.live import LAG_S
from ullage.flight.random_flights import lattice_graph
from ullage.flight.tour import between, straightened
from ullage.grids import Grid, OccupancyMap

RAYS, SECTORS = 72, 12
"""Directions of the rays of a view, and of those in which views are counted."""
COMPASS = ("east", "northeast", "north", "northwest", "west", "southwest", "south", "southeast")
REACH_M = 6.0  # a view teaches nothing farther away, and cells on the way in proportion less
DEPTH_M = 0.7  # mean depth that is learned of unknown space
AT_ONCE = 256  # views that are compared at once
SHORTLIST, VIEWS_M = 24, 1.0  # the best single views, whose paths are compared by views in such steps
STRIDE_M = 0.4  # between places that are compared
LEAST_GAIN_M2 = 0.25  # a view that teaches less is not worth a flight
APERTURE_M = 0.5  # of track that a view needs at least
RESERVE_S = 4.0  # left at home, as the guard may slow the way there
SURELY_FREE = 0.95  # chance that a cell is free, from which a flight there takes no longer than its path
SLOW_COST = 1.0  # more time that a path through unknown space takes, as it may lead nowhere, or along a wall
SLOW_M = 0.3  # beyond the clearance, where the guard limits a flight towards a wall
STOPPED_COST = 3.0  # more time that a path takes for each stop by the guard there
HORIZON_S = 10.0  # what is learned so much later counts 1 / e
KEEP = 1.5  # a goal is kept until another one is better by as much

Kind = Literal["view", "home"]


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """Where to fly now, and why."""

    kind: Kind
    path: Floats  # (n, 2) from here on [m]
    words: str
    gain_m2: float = 0.0  # expected area that the view at its end teaches
    travel_s: float = 0.0
    home_s: float = 0.0  # from its end

    @property
    def goal(self) -> Floats:
        """Its end (2) [m]."""
        return np.asarray(self.path[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What a vehicle can reach."""

    omap: OccupancyMap
    place: Floats  # (2) of the vehicle [m]
    open: Bools  # (ny, nx) cells that a path may cross
    cost: Floats  # (ny, nx) expected time of a flight through each cell, over that through free space
    cells: Longs  # (n, 2) the open cells
    away_m: Floats  # (2, n) shortest way to each from the vehicle and from home, times its cost, inf: there is none [m]
    before: Ints  # (2, n) cell before each on those ways, below zero where there is none
    here: int  # cell of the vehicle

    @property
    def narrow(self) -> bool:
        """Whether the vehicle can go nowhere."""
        return not bool((np.isfinite(self.away_m[0]) & (self.away_m[0] >= APERTURE_M)).any())


class ViewPlanner:
    """What the views so far have left unknown, and the next view by it.

    Args:
        grid: a plane.
        home: x, y [m].
        clearance_m: least distance from the vehicle's centre to mapped surfaces [m].
        speed_m_s: of the flight [m/s].
        free_probability: least probability of free space on a path, 0.5 to 1; None: paths also cross unknown cells.
        free_start_m: unknown and ambiguous cells within this distance of home are free [m].

    Raises:
        InputError: home is off the grid, or a number is not above zero.
    """

    def __init__(
        self, grid: Grid, home: Floats, *, clearance_m: float, speed_m_s: float, free_probability: float | None = None,
        free_start_m: float = 0.0,
    ) -> None:  # fmt: skip
        for name, value in (("clearance_m", clearance_m), ("speed_m_s", speed_m_s)):
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} is {value}", where="ViewPlanner", allowed="> 0")
        self.grid, self.clearance_m, self.speed_m_s = grid, clearance_m, speed_m_s
        self.free_probability = free_probability
        self._flown = np.zeros(grid.shape, bool)
        self._start = self._within(home, free_start_m)
        self._stops = np.zeros(grid.shape)  # of the guard about each cell
        self._views = np.zeros((SECTORS, grid.size), np.float32)  # in each direction, weighted by what they could teach
        self._home = self._cell(home)
        self._rays = _Rays.of(grid.step_m)
        self._flown[self._home] = True

    def _cell(self, place: Floats) -> tuple[int, int]:
        cell, inside = self.grid.index(np.asarray(place, float)[None, :2])
        if not inside[0]:
            raise InputError(f"({place[0]:.2f}, {place[1]:.2f}) m is off the map", where="explore",
                             allowed="a place on the grid")  # fmt: skip
        return int(cell[0, 0]), int(cell[0, 1])

    def flew(self, place: Floats) -> None:
        """Note that the vehicle was here: this cell is free, and a way back."""
        self._flown[self._cell(place)] = True

    def stopped(self, place: Floats, radius_m: float) -> None:
        """Note that the guard stopped the vehicle before a place: paths about it cost more."""
        self._stops += self._within(place, radius_m)

    def _within(self, place: Floats, radius_m: float) -> Bools:
        """Cells (ny, nx) whose centres are at most so far from a place."""
        x, y = np.meshgrid(self.grid.x_m - place[0], self.grid.y_m - place[1])
        return np.asarray(np.hypot(x, y) <= radius_m)

    def saw(self, omap: OccupancyMap, place: Floats) -> None:
        """Count a view from here: what it leaves unknown is less likely to be learned from that direction again."""
        cells, worth = self._rays.cast(_classes(omap), np.array([self._cell(place)]))
        np.add.at(self._views, (np.broadcast_to(self._rays.sector[:, None], cells[0].shape), cells[0]), worth[0])

    def at(self, omap: OccupancyMap, place: Floats) -> Situation:
        """Return what the vehicle can reach from here by this map.

        A cell is open where no possible surface is nearer than the asked clearance, less a cell by which the map may
        err, or where the vehicle flew. Surfaces are possible in occupied cells, or with a least probability of free
        space in every cell below it. A cell costs no extra time where all within the clearance is known to be free.

        Raises:
            InputError: the place is off the grid, or the probability out of bounds.
        """
        grid = omap.grid
        free_too = self._flown | (self._start & (omap.percent < 0))
        held = OccupancyMap(grid, np.where(free_too, np.int8(0), omap.percent))
        solid = held
        if self.free_probability is None:
            solid = OccupancyMap(grid, np.where(held.occupied, np.int8(100), np.int8(0)))
        distance_m = solid.clearance(chance=self.free_probability).distance_m
        spare_m = distance_m - (self.clearance_m - grid.step_m)
        open_ = (spare_m >= 0) | self._flown
        here = self._cell(place)
        open_[here] = True
        free = (held.percent >= 0) & (held.percent <= 100 * (1 - SURELY_FREE))
        known = uniform_filter(free.astype(float), 2 * round(self.clearance_m / grid.step_m) + 1, mode="constant")
        slow = np.maximum(1.0 - known, np.clip(1.0 - spare_m / SLOW_M, 0.0, 1.0))
        cost = 1.0 + SLOW_COST * slow + STOPPED_COST * self._stops
        number = np.full(open_.shape, -1)
        number[open_] = np.arange(int(open_.sum()))
        ends = [int(number[here]), int(number[self._home])]
        graph, each = lattice_graph(open_).tocoo(), cost[open_]
        graph.data *= (each[graph.row] + each[graph.col]) / 2
        away, before = dijkstra(graph.tocsr(), directed=False, indices=ends, return_predecessors=True)
        at = np.asarray(place, float)[:2]
        return Situation(omap, at, open_, cost, np.argwhere(open_), away * grid.step_m, before, ends[0])

    def time_s(self, length_m: ArrayLike, turns: float = 0.0) -> Floats:
        """Time that flights from rest take [s].

        The vehicle reaches a new velocity with the lag of its controller. Each segment therefore takes that lag times
        the share of the speed that is new along it: all of it at the start, 1 - cos(turn) at a corner. The heading
        follows meanwhile, and costs no time.

        Args:
            length_m: of the paths, any shape [m].
            turns: 1 - cos(turn), summed over the corners.
        """
        return np.asarray(np.asarray(length_m, float) / self.speed_m_s + LAG_S * (1.0 + turns))

    def path_s(self, path: Floats, now: Situation | None = None) -> float:
        """Time that a flight from rest along a path (n, 2) takes, in free space or in a situation [s]."""
        steps = np.diff(path, axis=0)
        length_m = np.linalg.norm(steps, axis=1)
        unit = steps[length_m > 0] / length_m[length_m > 0, None]
        whole_m = length_m.sum() if now is None else self._fine(now, path)[1][-1]
        return float(self.time_s(whole_m, float((1.0 - (unit[1:] * unit[:-1]).sum(1)).sum())))

    def _fine(self, now: Situation, path: Floats) -> tuple[Floats, Floats]:
        """Places (k, 2) along a path, a cell apart, and the length to each times its cost (k) [m]."""
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        at = np.linspace(0.0, s[-1], round(s[-1] / self.grid.step_m) + 2)
        places = np.stack([np.interp(at, s, path[:, k]) for k in range(2)], 1)
        cells, _ = self.grid.index(places)
        cost = now.cost[tuple(cells.T)]
        return places, np.concatenate([[0.0], np.cumsum(np.diff(at) * (cost[1:] + cost[:-1]) / 2)])

    def is_open(self, now: Situation, path: Floats) -> bool:
        """Whether a path (n, 2) crosses open cells only [m].

        With a least probability of free space the line from the vehicle to the path counts too: the guard watches for
        surfaces there, and not for unknown space.
        """
        on = path if self.free_probability is None else np.vstack([now.place, path])
        cells, _ = self.grid.index(on)
        return all(now.open[between(a, b)].all() for a, b in pairwise(cells))

    @property
    def barrier(self) -> str:
        """What bars a path, in words."""
        least = self.free_probability
        return "surfaces" if least is None else f"surfaces and space not known to be free at {least:g}"

    def cut_off_m2(self, now: Situation) -> float:
        """Return the area held free that no path comes near, as what bars paths leaves too little room [m2]."""
        near = np.ones(self.grid.shape, bool)
        near[tuple(now.cells[np.isfinite(now.away_m[0])].T)] = False
        far = distance_transform_edt(near) * self.grid.step_m > self.clearance_m + self.grid.step_m
        return self.grid.step_m**2 * int((far & now.omap.free).sum())

    def home(self, now: Situation) -> Leg | None:
        """Return the way home, or None if it is barred."""
        if not math.isfinite(now.away_m[1, now.here]):
            return None
        path = self._path_home(now, now.here)
        return Leg("home", path, "home", travel_s=self.path_s(path, now))

    def next_view(self, now: Situation, left_s: float, *, kept: Leg | None = None) -> Leg | None:
        """Return the best view whose path there and then home fits the time left; None: none is worth it.

        Args:
            now: the map, the place of the vehicle and what it can reach.
            left_s: time left [s].
            kept: the goal at present, which is kept while it is nearly as good as the best.
        """
        stride = max(round(STRIDE_M / self.grid.step_m), 1)
        wanted = (now.cells % stride == 0).all(1)
        same = np.zeros(len(wanted), bool) if kept is None else (now.cells == self._cell(kept.goal)).all(1)
        travel_s, home_s = self.time_s(now.away_m)  # along the lattice, and so but a first estimate
        far_m = np.linalg.norm(now.cells - now.cells[now.here], axis=1) * self.grid.step_m
        new = np.isfinite(now.away_m).all(0) & ~self._flown[now.open]
        wanted &= (far_m >= APERTURE_M) & new
        if self.free_probability is not None and new.any() and not wanted.any():  # little is free yet: its far side
            wanted = new & (far_m >= min(APERTURE_M, far_m[new].max()))
        rows = np.flatnonzero((wanted | same) & (travel_s + home_s + RESERVE_S <= left_s))
        if not len(rows):
            return None
        classes = _classes(now.omap)
        first = self._single(classes, now.cells[rows]) * np.exp(-travel_s[rows] / HORIZON_S)
        rows = rows[(np.argsort(-first, kind="stable")[:SHORTLIST])]
        if same.any() and np.isfinite(travel_s[same][0]):
            rows = np.union1d(rows, np.flatnonzero(same))
        paths = [self._path(now, int(row)) for row in rows]
        there_s = np.array([self.path_s(path, now) for path in paths])
        back_s = np.array([self.path_s(self._path_home(now, int(row)), now) for row in rows])
        gain, worth = np.array([self._along(now, classes, path) for path in paths]).T
        useful = (gain >= LEAST_GAIN_M2) & (there_s + back_s + RESERVE_S <= left_s)
        worth = np.where(useful, worth, 0.0) * np.where(same[rows], KEEP, 1.0)
        best = int(np.argmax(worth))
        if worth[best] <= 0:
            return None
        words = f"to the frontier {direction(paths[best][-1] - now.place)}"
        return Leg("view", paths[best], words, float(gain[best]), float(there_s[best]), float(back_s[best]))

    def _single(self, classes: Ints, cells: Longs) -> Floats:
        """Area that single views from cells (n, 2) could teach [m2]."""
        gain = np.zeros(len(cells))
        for part in np.array_split(np.arange(len(cells)), -(-len(cells) // AT_ONCE)):
            seen, worth = self._rays.cast(classes, cells[part])
            gain[part] = (self._new(seen, worth) * self._rays.area_m2).sum((1, 2))
        return gain

    def _along(self, now: Situation, classes: Ints, path: Floats) -> tuple[float, float]:
        """Area that the views along a path could teach together, and the same discounted by when it is taught [m2]."""
        places, cost_m = self._fine(now, path)
        views = max(round(len(places) * self.grid.step_m / VIEWS_M), 1)
        rows = np.linspace(0, len(places) - 1, views + 1)[1:].astype(int)
        cells, _ = self.grid.index(places[rows])
        seen, worth = self._rays.cast(classes, cells)
        new, total = self._new(seen, worth), []
        soon = np.exp(-self.time_s(cost_m[rows]) / HORIZON_S)[:, None, None]
        for share in (new, new * soon):
            chance = np.zeros(self.grid.size)
            np.maximum.at(chance, seen.ravel(), share.ravel())
            total.append(self.grid.step_m**2 * float(chance.sum()))
        return total[0], total[1]

    def _new(self, seen: Longs, worth: Floats) -> Floats:
        """Chance that rays teach cells (n, rays, steps), with the views so far."""
        return np.asarray(worth / (1.0 + self._views[self._rays.sector[:, None], seen]))

    def _path(self, now: Situation, node: int) -> Floats:
        return self._back(now, 0, node)[::-1]

    def _path_home(self, now: Situation, node: int) -> Floats:
        return self._back(now, 1, node)

    def _back(self, now: Situation, end: int, node: int) -> Floats:
        """Straight segments (n, 2) from a cell to an end of the shortest ways, which cost no more than those [m]."""
        nodes = [node]
        while now.before[end, nodes[-1]] >= 0:
            nodes.append(int(now.before[end, nodes[-1]]))
        cells, left_m = now.cells[nodes], now.away_m[end, nodes]

        def joined(i: int, j: int) -> bool:
            on = between(cells[i], cells[j])
            straight_m = self.grid.step_m * float(np.linalg.norm(cells[j] - cells[i]))
            dear = now.cost[on].mean() * straight_m
            return bool(now.open[on].all() and dear <= left_m[i] - left_m[j] + 1e-6)

        cells = cells[straightened(len(cells), joined)]
        return np.column_stack([self.grid.x_m[cells[:, 1]], self.grid.y_m[cells[:, 0]]])


_FREE, _SOLID, _DARK = range(3)


def _classes(omap: OccupancyMap) -> Ints:
    """Class of each cell (ny, nx)."""
    out = np.full(omap.grid.shape, _FREE, np.int32)
    out[omap.unknown | omap.ambiguous] = _DARK
    out[omap.occupied] = _SOLID
    return out


class _Rays(NamedTuple):
    """The rays of a view, sampled once a cell."""

    offset: Longs  # (rays, steps, 2) cells
    sector: Longs  # (rays)
    area_m2: Floats  # (rays, steps) that a sample stands for
    near: Floats  # (rays, steps) share learned at this range
    step_m: float

    @classmethod
    def of(cls, step_m: float) -> _Rays:
        angle = (np.arange(RAYS) + 0.5) * math.tau / RAYS
        range_m = step_m * np.arange(1, max(round(REACH_M / step_m), 1) + 1)
        unit = np.stack([np.sin(angle), np.cos(angle)], 1)
        offset = np.rint(unit[:, None] * range_m[None, :, None] / step_m).astype(np.int64)
        area = np.broadcast_to(range_m * step_m * math.tau / RAYS, offset.shape[:2])
        near = np.broadcast_to(1.0 - range_m / (REACH_M + step_m), offset.shape[:2])
        return cls(offset, np.arange(RAYS) * SECTORS // RAYS, area, near, step_m)

    def cast(self, classes: Ints, cells: Longs) -> tuple[Longs, Floats]:
        """Cast the rays of views from cells (n, 2).

        Returns:
            Flat index of each sample's cell (n, rays, steps), and the chance that the view teaches it.
        """
        place = cells[:, None, None] + self.offset[None]
        inside = ((place >= 0) & (place < np.array(classes.shape))).all(-1)
        flat = np.where(inside, place[..., 0] * classes.shape[1] + place[..., 1], 0)
        kind = np.where(inside, classes.ravel()[flat], _SOLID)
        dark = kind == _DARK
        lit = np.cumsum(kind == _SOLID, axis=2) == 0
        depth_m = np.cumsum(dark, axis=2) * self.step_m
        return flat, np.where(lit & dark, np.exp(-depth_m / DEPTH_M) * self.near, 0.0)


def direction(way: Floats) -> str:
    """Return a level displacement (2 or 3) in words: 4 m north."""
    turn = round(math.atan2(float(way[1]), float(way[0])) / (math.tau / 8)) % 8
    return f"{math.hypot(float(way[0]), float(way[1])):.0f} m {COMPASS[turn]}"
