"""The full-profile mapper: every bin speaks, echoes look for the one cell that made them, silence frees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, generate_binary_structure, label

from ullage.data import Recording
from ullage.grids import AMBIGUOUS, UNKNOWN, Changes, Grid, OccupancyMap
from ullage.kernels.occupancy import cast_reach, mark_flown, update_cells
from ullage.kernels.occupancy_show import in_view, render_cells
from ullage.processing.blocks import Blocks
from ullage.processing.coherent import EchoJudge
from ullage.processing.mapper_door import in_order, plane_of
from ullage.processing.mapper_levels import LevelFinder
from ullage.processing.mapper_lobes import LobeComparison
from ullage.processing.mapper_looks import Listener, Look

Floats = NDArray[np.float64]

PRIOR = -3.5
DETECTION = 0.9
FREE_NATS = np.array([0, 0.3, 0.7, 1.2, 2.0, 2.7] + [3.5] * 11)
ENOUGH_SIDES = 4
VAGUE_TENTHS = 10
HEARD_ODDS, SIDE_NATS = -0.7, 0.8
SOLID_ODDS = float(np.log(0.65 / 0.35))
WALL_TENTHS = 20
HAZE_PER_M = 0.12
HIT_BEAM, FREE_BEAM = np.cos(np.radians(50.0)), np.cos(np.radians(40.0))
TANGENT = 1.3
SECTORS = {2: (1, 96), 3: (28, 28)}
FLOWN_M = 0.25
LEAST_TRUST, LEAST_TURN = 0.15, 0.01
SHADE_DEG = 25.0
EYES, HIDE_M, GAP_M = 64, 0.25, 0.4


class UllageMapper:
    """Streaming full-profile mapper on a plane or a volume.

    Args:
        grid: holds the flight; a plane without a height takes that of the first frames.
        phase: whether phase may be used; it is left aside anyway while echoes do not keep it along the track.
    """

    def __init__(self, grid: Grid, *, phase: bool = True) -> None:
        self.grid = grid
        self.blocks = Blocks(grid)
        self._listeners: dict[str, Listener] = {}
        self._axis: dict[str, tuple[float, float, float]] = {}
        self._published: OccupancyMap | None = None
        self._found = np.zeros((60_000, 4), np.int32)
        self._chance = np.zeros(60_000)
        self._reach = np.zeros(SECTORS[grid.dims])
        self._levels = LevelFinder() if grid.dims == 2 else None
        self._lobes = LobeComparison()
        self._judge = EchoJudge(phase=phase)
        self._waiting: list[tuple[int, str, Look]] = []
        self._looks = 0
        self._flown: dict[tuple[int, ...], None] = {}

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, a sample that is not finite, or a flight that leaves the grid.
        """
        parts = in_order(frames, self.grid)
        self.grid = self.blocks.grid = plane_of(self.grid, parts)
        looks: list[tuple[int, str, Look]] = []
        for part in parts:
            name = part.sensor
            step = float(part.range_m[-1] - part.range_m[0]) / (len(part.range_m) - 1)
            self._axis[name] = float(part.range_m[0]), step, float(part.range_m[-1])
            listener = self._listeners.setdefault(name, Listener(*self._axis[name][:2], part.spec.wavelength_m))
            looks += [(look.heard.t_ns, name, look) for look in listener.hear(part)]
        self._insert_all(looks)

    def finish(self) -> None:
        """Use the looks that waited for frames to come."""
        self._insert_all(
            [(look.heard.t_ns, name, look) for name, one in self._listeners.items() for look in one.flush()], last=True
        )
        self.blocks.collapse(ENOUGH_SIDES + 2)

    def _insert_all(self, looks: list[tuple[int, str, Look]], *, last: bool = False) -> None:
        looks = sorted(looks, key=lambda item: item[:2])
        if self._levels is None:
            for _, name, look in looks:
                self._insert(name, self._lobes.without_sidelobes(name, look))
            return
        for item in looks:
            self._levels.hear(item[2])
            self._waiting.append(item)
            if self._levels.ready:
                self._insert_waiting(self._levels)
        if last:
            self._insert_waiting(self._levels)

    def _insert_waiting(self, levels: LevelFinder) -> None:
        for _, name, look in self._waiting:
            self._insert(name, self._lobes.without_sidelobes(name, levels.without_levels(look)))
        self._waiting.clear()

    def _insert(self, name: str, look: Look) -> None:
        start, bin_m, far = self._axis[name]
        blocks, heard, step = self.blocks, look.heard, self.grid.step_m
        arcs = self._arcs(look)
        n = far / (blocks.edge * step)  # most blocks a cone of 100 deg can meet, its rim counted twice over
        blocks.reserve(int(1.2 * n**2 + 8 * n + 40 if self.grid.dims == 2 else 1.2 * n**3 + 10 * n**2 + 8 * n + 60))
        pools = (blocks.slots, blocks.free_slots, blocks.free_count, blocks.hits, blocks.silent, blocks.facing)
        mark_flown(*pools, blocks.origin, step, blocks.edge, blocks.size, heard.position, max(FLOWN_M, step))
        self._flown[tuple(np.rint(heard.position / step).astype(int).tolist())] = None
        cast_reach(
            blocks.slots, blocks.hits, blocks.silent, blocks.origin, step, blocks.edge, blocks.size, heard.position,
            heard.axes, TANGENT, far, WALL_TENTHS, HAZE_PER_M * step, self._reach,
        )  # fmt: skip
        self._shade(heard.axes, arcs)
        box = np.zeros((3, 2), np.int64)
        update_cells(
            *pools, blocks.origin, step, blocks.edge, blocks.size, heard.position, heard.axes, HIT_BEAM, FREE_BEAM,
            TANGENT, self._reach, heard.quiet, start, bin_m, FLOWN_M, far, arcs, FREE_NATS, PRIOR,
            self._found, self._chance, box,
        )  # fmt: skip
        self._looks += 1
        if self._looks % 64 == 0:
            blocks.collapse(ENOUGH_SIDES + 2)

    def _arcs(self, look: Look) -> Floats:
        """Rows for the kernel: range, sigma, track (3), cosine, its sigma, chance of detection, located, false."""
        step, echoes = self.grid.step_m, look.echoes
        arcs = np.zeros((len(echoes), 10))
        arcs[:, 0] = echoes[:, 0]
        arcs[:, 1] = np.maximum(echoes[:, 1], 0.35 * step)
        arcs[:, 2:5] = look.track
        if not look.track.any():
            arcs[:, 6], arcs[:, 7], arcs[:, 9] = 1e3, 0.5, 0.5
            return arcs
        cosine, sigma, trust = self._judge.weigh(look)
        blur = 0.35 * step / np.maximum(echoes[:, 0], 0.1)
        arcs[:, 5] = np.clip(cosine, -1, 1)
        arcs[:, 6] = np.sqrt(sigma**2 + blur**2 + LEAST_TURN**2)
        arcs[:, 7], arcs[:, 8], arcs[:, 9] = DETECTION, 1, np.clip(1 - trust, 0.03, 0.95)
        return arcs[trust >= LEAST_TRUST]

    def _shade(self, axes: Floats, arcs: Floats) -> None:
        """Nothing is learned behind an echo whose bearing is known, even before the map holds it.

        An echo comes off a surface that lies square to the way there, so on a plane the shade follows that line to
        25 deg on both sides.
        """
        rays = self._rays(axes)
        slack = 2 * self.grid.step_m
        for arc in arcs[arcs[:, 8] > 0]:
            behind = abs(rays @ arc[2:5] - arc[5]) < 2.5 * arc[6] + 0.05
            self._reach[behind] = np.minimum(self._reach[behind], arc[0] + slack)
            for way in self._ways(axes, arc):
                turn = rays @ way
                square = turn > np.cos(np.radians(SHADE_DEG))
                self._reach[square] = np.minimum(self._reach[square], arc[0] / turn[square] + slack)

    def _rays(self, axes: Floats) -> Floats:
        up, left = self._reach.shape
        y = (2 * (np.arange(left) + 0.5) / left - 1) * TANGENT
        z = (2 * (np.arange(up) + 0.5) / up - 1) * TANGENT if up > 1 else np.zeros(1)
        ray = np.stack(np.broadcast_arrays(1.0, y[None, :], z[:, None]), axis=-1) @ axes.T
        if up == 1:
            ray[..., 2] = 0
        return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))

    def _ways(self, axes: Floats, arc: Floats) -> list[Floats]:
        """The directions on the plane that an arc's bearing leaves open, when only one of them is in the beam."""
        if self.grid.dims == 3:
            return []
        track = np.array([arc[2], arc[3], 0.0])
        track /= max(float(np.linalg.norm(track)), 1e-9)
        across = np.array([-track[1], track[0], 0.0])
        off = np.sqrt(max(1 - arc[5] ** 2, 0.0))
        both = [arc[5] * track + sign * off * across for sign in (-1, 1)]
        lit = [way for way in both if way @ axes[:, 0] > HIT_BEAM]
        return lit if len(lit) == 1 else []

    def map(self) -> OccupancyMap:
        """The map so far; free cells that no free way joins to the flight are unknown."""
        shape = self.grid.shape if self.grid.dims == 3 else (1, *self.grid.shape)
        percent = np.empty(shape, np.int8)
        box = np.array([[0, n] for n in shape[::-1]], np.int64)
        blocks = self.blocks
        render_cells(
            blocks.slots, blocks.hits, blocks.silent, blocks.edge, blocks.size, box, FREE_NATS, PRIOR, ENOUGH_SIDES,
            VAGUE_TENTHS, HEARD_ODDS, SIDE_NATS, SOLID_ODDS, percent,
        )  # fmt: skip
        percent = percent.reshape(self.grid.shape)
        self._forget_cut_off(percent)
        return OccupancyMap(self.grid, percent, "ullage")

    def _forget_cut_off(self, percent: NDArray[np.int8]) -> None:
        """Free cells that only a narrow gap joins to the flight become unknown; walls hidden by walls, ambiguous."""
        free = (percent >= 0) & (percent < 50)
        solid = percent >= 50
        ball = generate_binary_structure(free.ndim, free.ndim)
        wide = max(1, round(GAP_M / 2 / self.grid.step_m))
        open_, count = label(free & ~binary_dilation(solid | (percent == AMBIGUOUS), ball, iterations=wide))
        if not count or not self._flown:
            return
        flown = np.array(list(self._flown), float) * self.grid.step_m
        cells, inside = self.grid.index(flown)
        names = np.unique(open_[tuple(cells[inside].T)])
        joined = binary_dilation(np.isin(open_, names[names > 0]), ball, iterations=wide + 1)
        percent[free & ~joined] = UNKNOWN
        suspects = np.argwhere(solid & ~binary_dilation(joined, ball, iterations=2))
        if len(suspects):
            eyes = cells[np.linspace(0, len(cells) - 1, min(EYES, len(cells))).astype(int)]
            seen = np.zeros(len(suspects), bool)
            deep = [np.pad(v.astype(float), ((0, 0), (3 - free.ndim, 0))) for v in (suspects, eyes)]
            in_view(solid.reshape((-1, *solid.shape[-2:])), *deep, HIDE_M / self.grid.step_m, seen)
            percent[tuple(suspects[~seen].T)] = AMBIGUOUS

    def changed(self) -> Changes:
        """The blocks in which the map differs from that of the last call."""
        now = self.map()
        out = now.changes(self._published)
        self._published = now
        return out
