"""The full-profile mapper: every bin speaks, echoes look for the one cell that made them, silence frees."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, generate_binary_structure, label

from ullage.data import Recording
from ullage.grids import AMBIGUOUS, UNKNOWN, Changes, Grid, OccupancyMap, Tiles
from ullage.kernels.occupancy_cone import Beam
from ullage.kernels.occupancy_show import in_view, render_cells
from ullage.processing.blocks import FREE_NATS, PRIOR, Blocks
from ullage.processing.coherent import EchoJudge
from ullage.processing.inverse_sensor import heard_deg
from ullage.processing.mapper_door import in_order, plane_of
from ullage.processing.mapper_levels import LevelFinder
from ullage.processing.mapper_lobes import LobeComparison
from ullage.processing.mapper_looks import Listener, Look

Floats = NDArray[np.float64]

DETECTION = 0.9
ENOUGH_SIDES = 4
VAGUE_TENTHS = 10
HEARD_ODDS, SIDE_NATS = -0.7, 0.8
SOLID_ODDS = float(np.log(0.65 / 0.35))
SECTORS = {2: (1, 96), 3: (28, 28)}
FLOWN_M = 0.25
LEAST_TRUST, LEAST_TURN = 0.15, 0.01
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
        self._lobe: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {}
        self._published: OccupancyMap | None = None
        self._reach = np.zeros(SECTORS[grid.dims])
        self._levels = LevelFinder()
        self._lobes = LobeComparison()
        self._judge = EchoJudge(phase=phase)
        self._waiting: list[tuple[int, str, Look]] = []
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
            hit_deg, free_deg = heard_deg(part.spec.antenna)
            self._lobe[name] = cos_sin(hit_deg), cos_sin(free_deg)
            listener = self._listeners.setdefault(name, Listener(*self._axis[name][:2], part.spec.wavelength_m))
            looks += [(look.heard.t_ns, name, look) for look in listener.hear(part)]
        self._insert_all(looks)

    def finish(self) -> None:
        """Use the looks that waited for frames to come."""
        self._insert_all(
            [(look.heard.t_ns, name, look) for name, one in self._listeners.items() for look in one.flush()], last=True
        )
        self.blocks.collapse()

    def _insert_all(self, looks: list[tuple[int, str, Look]], *, last: bool = False) -> None:
        looks = sorted(looks, key=lambda item: item[:2])
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
        hit, free = self._lobe[name]
        heard, arcs = look.heard, self._arcs(look)
        self.blocks.clear(heard.position, max(FLOWN_M, self.grid.step_m))
        self._flown[tuple(np.rint(heard.position / self.grid.step_m).astype(int).tolist())] = None
        quiet = np.concatenate([[0], np.cumsum(heard.quiet)])
        beam = Beam(
            heard.position,
            heard.axes,
            self._reach,
            1.09 * hit[1] / hit[0],
            hit,
            free,
            FLOWN_M,
            far,
            start,
            bin_m,
            quiet,
            arcs,
        )
        ways = [(*way, arc[0]) for arc in arcs[arcs[:, 8] > 0] for way in self._ways(heard.axes, arc, hit[0])]
        self.blocks.insert(beam, np.array(ways).reshape(-1, 4))

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

    def _ways(self, axes: Floats, arc: Floats, least: float) -> list[Floats]:
        """The direction on the plane that an arc's bearing leaves open, where only one is in the beam.

        An echo comes off a surface that lies square to the way there, which then hides what lies behind it.
        """
        if self.grid.dims == 3:
            return []
        track = np.array([arc[2], arc[3], 0.0])
        track /= max(float(np.linalg.norm(track)), 1e-9)
        across = np.array([-track[1], track[0], 0.0])
        off = np.sqrt(max(1 - arc[5] ** 2, 0.0))
        both = [arc[5] * track + sign * off * across for sign in (-1, 1)]
        lit = [way for way in both if way @ axes[:, 0] > least]
        return lit if len(lit) == 1 else []

    def map(self) -> OccupancyMap:
        """The map so far; free cells that no free way joins to the flight are unknown."""
        known = self.blocks.known()
        if known is None:
            return OccupancyMap(self.grid, Tiles.unknown(self.grid.shape), "ullage")
        box = np.array([(axis.start, axis.stop) for axis in known], np.int64)
        percent = np.empty(box[:, 1] - box[:, 0], np.int8)
        render_cells(
            self.blocks.pools, self.blocks.edge, box, FREE_NATS, PRIOR, ENOUGH_SIDES, VAGUE_TENTHS, HEARD_ODDS,
            SIDE_NATS, SOLID_ODDS, percent,
        )  # fmt: skip
        percent = percent.reshape(percent.shape[3 - self.grid.dims :])
        corner = tuple(int(k) for k in box[3 - self.grid.dims :, 0])
        self._forget_cut_off(percent, corner)
        return OccupancyMap(self.grid, Tiles.of(percent, shape=self.grid.shape, corner=corner), "ullage")

    def _forget_cut_off(self, percent: NDArray[np.int8], corner: tuple[int, ...]) -> None:
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
        cells = cells[inside] - corner
        names = np.unique(open_[tuple(cells.T)])
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


def cos_sin(angle_deg: float) -> tuple[float, float]:
    """Cosine and sine."""
    angle = math.radians(angle_deg)
    return math.cos(angle), math.sin(angle)
