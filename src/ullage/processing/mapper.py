"""The full-profile mapper: every bin speaks, echoes look for the one cell that made them, silence frees."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from ullage import checks
from ullage.antenna import BoresightPattern, boresight_pattern
from ullage.arrays import Bools, Floats
from ullage.data import Recording
from ullage.grids import Changes, Grid, OccupancyMap, Tiles
from ullage.kernels.occupancy import RING, TORN
from ullage.kernels.occupancy_reach import Beam
from ullage.kernels.occupancy_show import render_cells, thin_lines
from ullage.processing.baseband import as_baseband
from ullage.processing.blocks import FREE_NATS, PRIOR, Blocks
from ullage.processing.coherent import EchoJudge
from ullage.processing.elfes import ElfesMapper
from ullage.processing.inverse_sensor import heard_deg, loudest_wall_m, mirror_m, rim_mirror_m
from ullage.processing.mapper_beyond import Zones, cell_of, without_behind, without_beyond
from ullage.processing.mapper_door import in_order, plane_of, radius_of_vehicle
from ullage.processing.mapper_echoes import Echo, SpecularPoint
from ullage.processing.mapper_ends import without_ends
from ullage.processing.mapper_folds import Fold, alike, is_hidden
from ullage.processing.mapper_levels import RETURNING, LevelFinder
from ullage.processing.mapper_lobes import LobeComparison
from ullage.processing.mapper_looks import Listener, Look, lit_ways, look_share, ways_apart
from ullage.processing.mapper_order import InOrder
from ullage.processing.mapper_posts import along_post
from ullage.processing.mapper_rims import LEAST_RIM, rim_along
from ullage.processing.mapper_runs import EchoRuns, Run, edges_among, near
from ullage.processing.mapper_show import without_cut_off
from ullage.processing.mapper_tracks import EchoTracks
from ullage.processing.mapper_turns import MOST_LOOKS, Stretch, Turns, bearings

Weighed = tuple[Floats, Floats, Floats]

DETECTION = 0.9
ENOUGH_SIDES = 4
VAGUE_TENTHS = {2: 7, 3: 10}
HEARD_ODDS, SIDE_NATS = {2: -1.2, 3: -0.7}, 0.8
SOLID = 65
SOLID_ODDS = math.log(SOLID / (100 - SOLID))
SECTORS = {2: (1, 96), 3: (28, 28)}
FLOWN_M = 0.25
LEAST_TRUST, LEAST_TURN, LEAST_FALSE = 0.15, 0.01, 0.07
FLAT_SHARE = 0.9
DISC_SHARE, DISC_SIGMA = 0.55, 0.38
SHADE = float(np.cos(np.radians(25.0)))
SEEN_TRUST, APART_M = 0.9, 0.4
AHEAD = {2: 12, 3: 24}
DISCS_A_STEP, JOINED_A_LOOK, DONE = 4, 2, object()  # discs in one go; stretches of legs judged anew
UNITS, MOST_OPEN, CATCH_UP = 9, 16, 4  # of work in a frame without a look; looks that may wait, frames for each more
HEAR, WEIGH, FOLLOW, CAST = 4, 5, 3, 2  # units of work that steps take, one about as long as silence in some blocks


class UllageMapper:
    """Streaming full-profile mapper on a plane or a volume.

    Frames of the thesis' ray model are amplitudes that sum a surface over the whole lobe: their ranges follow no one
    reflector, and no bearing can be had from them. A plane is then mapped by the inverse model made for such frames.

    Args:
        grid: holds the flight; a plane without a height takes that of the first frames.
        phase: whether phase may be used; it is left aside anyway while echoes do not keep it along the track.
        floor_z_m: height of a level floor [m]; a plane leaves its echoes out. None: only floors that show themselves.
        vehicle_radius_m: radius of the ball about the antenna that the vehicle fills, and so shows free [m].

    Raises:
        InputError: the radius is not a positive number, or the floor's height not a finite one.
    """

    def __init__(
        self, grid: Grid, *, phase: bool = True, floor_z_m: float | None = None, vehicle_radius_m: float = FLOWN_M
    ) -> None:
        if floor_z_m is not None:
            floor_z_m = checks.number("floor_z_m", floor_z_m, "mapper")
        self.grid, self._radius_m = grid, radius_of_vehicle(vehicle_radius_m)
        self.blocks = Blocks(grid)
        self._listeners: dict[str, Listener] = {}
        self._order = InOrder()
        self._axis: dict[str, tuple[float, float, float]] = {}
        self._lobe: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {}
        self._folds: dict[str, Fold] = {}
        self._patterns: dict[str, BoresightPattern] = {}
        self._wavelength_m = 0.0
        self._rays: ElfesMapper | None = None
        self._published: OccupancyMap | None = None
        self._reach, self._hush = np.zeros((2, *SECTORS[grid.dims]))
        self._levels = LevelFinder(() if floor_z_m is None else ((-1, floor_z_m),))
        self._lobes = LobeComparison()
        self._judge = EchoJudge(phase=phase)
        self._tracks = EchoTracks(self._may_be_folded)
        self._late: deque[tuple[str, Look, Floats, Floats]] = deque()
        self._runs = EchoRuns()
        self._pending: deque[tuple[str, Look, Weighed | None, list[Run], Stretch]] = deque()
        self._turns = Turns()
        self._waiting: list[tuple[str, Look]] = []
        self._open: deque[Iterator[int]] = deque()
        self._due = HEAR
        self._flown: dict[tuple[int, ...], None] = {}
        self._zones = Zones()

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, a sample that is not finite, or a flight that leaves the grid.
        """
        parts = [as_baseband(part) for part in in_order(frames, self.grid)]
        self.grid = self.blocks.grid = plane_of(self.grid, parts)
        if self._rays is not None or (self.grid.dims == 2 and all(part.ray_model for part in parts)):
            self._rays = self._rays or ElfesMapper(self.grid)
            self._rays.update(parts)
            return
        looks: list[tuple[int, str, Look]] = []
        for part in parts:
            name = part.sensor
            step = float(part.range_m[-1] - part.range_m[0]) / (len(part.range_m) - 1)
            self._wavelength_m = self._tracks.wave_m = part.spec.wavelength_m
            self._axis[name] = float(part.range_m[0]), step, float(part.range_m[-1])
            self._levels.rim_m, self._tracks.mirror_m[name] = rim_mirror_m(part), mirror_m(part)
            hit_deg, free_deg = heard_deg(part.spec.antenna)
            self._lobe[name] = cos_sin(hit_deg), cos_sin(free_deg)
            least = self._lobe[name][0][0]
            pattern = self._patterns[name] = self._tracks.patterns[name] = boresight_pattern(part.spec.antenna)
            fold_m = part.spec.unambiguous_range_m
            self._folds[name] = Fold(least, pattern, self._wavelength_m, fold_m, loudest_wall_m(part))
            listener = self._listeners.setdefault(name, Listener(*self._axis[name][:2], part.spec.wavelength_m))
            looks += [(look.heard.t_ns, name, look) for look in listener.hear(part)]
        looks = self._order.passed(looks, self._listeners)
        self._insert_all(looks, units=UNITS * (sum(len(part) for part in parts) - len(looks)))

    def finish(self) -> None:
        """Use the looks that waited for frames to come."""
        last = [(look.heard.t_ns, name, look) for name, one in self._listeners.items() for look in one.flush()]
        self._insert_all(self._order.passed(last), units=0)
        self._open.append(self._insert_last())
        self._catch_up()
        self.blocks.collapse()

    def _insert_all(self, looks: list[tuple[int, str, Look]], *, units: int) -> None:
        """Take looks in, but spread the work over the frames that follow: most of them complete no look."""
        self._open.extend(self._take_in(name, look) for _, name, look in looks)
        units = max(units, 0) + UNITS * max(len(self._open) - MOST_OPEN, 0) // CATCH_UP
        while self._open and self._due <= units:
            units -= self._due
            self._due = next(self._open[0], 0)
            if not self._due:
                self._open.popleft()
                self._due = HEAR

    def _catch_up(self) -> None:
        """Do all work that waits."""
        while self._open:
            deque(self._open[0], maxlen=0)
            self._open.popleft()
        self._due = HEAR

    def _take_in(self, name: str, look: Look) -> Iterator[int]:
        """What one look says, in steps that tell the work of the next; those of a look come before the next look's."""
        self._levels.hear(look)
        self._waiting.append((name, look))
        if self._levels.ready:
            yield from self._insert_waiting(self._levels)

    def _insert_last(self) -> Iterator[int]:
        yield from self._insert_waiting(self._levels)
        deque(map(self._lay_disc, chain(self._tracks.end(), self._tracks.join())), maxlen=0)
        while self._late:
            yield from self._insert(*self._late.popleft())
        self._turns.end()
        while self._pending:
            yield from self._insert_pending()

    def _long_enough(self) -> bool:
        """Whether the first look of a plane has waited as long as what comes after may tell of it."""
        turning = self._pending[0][4].open
        return len(self._pending) > (MOST_LOOKS if turning else AHEAD[2]) * len(self._axis)

    def _insert_waiting(self, levels: LevelFinder) -> Iterator[int]:
        for name, look in self._waiting:
            if self.grid.dims == 2:
                kept = self._lobes.without_sidelobes(name, levels.without_levels(look))
                weighed = self._weigh(kept)
                runs = [] if weighed is None else self._runs.follow(name, kept, *weighed)
                self._pending.append((name, kept, weighed, runs, self._turns.hear(name, kept)))
                while self._pending and self._long_enough():
                    yield WEIGH
                    yield from self._insert_pending()
            else:
                may_be = levels.levels(least=RETURNING)
                self._tracks.believe(levels.levels(), look.heard.position, possible=may_be)
                yield from self._follow(name, self._lobes.without_sidelobes(name, look))
        self._waiting.clear()

    def _follow(self, name: str, look: Look) -> Iterator[int]:
        """In a volume, silence waits until the walls around are known from how their echoes went on."""
        weighed = self._weigh(look)
        yield FOLLOW
        if weighed is not None:
            told = self._tracks.follow(name, look, *weighed, self._lobe[name][0][0])
            for k, foot in enumerate(chain(told, self._tracks.join(JOINED_A_LOOK))):
                self._lay_disc(foot)
                if k % DISCS_A_STEP == DISCS_A_STEP - 1:
                    yield CAST
        self._late.append((name, look, *self._arcs(look, weighed)))
        if len(self._late) > AHEAD[3] * len(self._axis):
            yield CAST
            yield from self._insert(*self._late.popleft())

    def _insert_pending(self) -> Iterator[int]:
        """On a plane, looks wait a little until it shows which of their echoes go on as those of an edge do."""
        name, look, weighed, runs, stretch = self._pending.popleft()
        if stretch.turned:
            yield from self._insert_turned(name, look, stretch)
            return
        if weighed is None:
            yield from self._insert(name, look, *self._arcs(look, weighed))
            return
        weighed, edge = edges_among(look, weighed, runs, self._lobe[name][0][0])
        look = replace(look, sharp=look.sharp.copy())
        look.sharp[edge, 3:] = 0, 1
        around = [look, *(other for one, other, *_ in self._pending if one == name)]
        weighed[2][self._levels.feet_and_heads(look, around)] = 0
        yield FOLLOW
        rims = self._rims(name, look, weighed[0], runs)
        folded = self._folds[name].among(look, weighed[0], self.blocks, usual=self._judge.usual)
        yield from self._insert(name, look, *self._arcs(look, weighed, rims, folded))

    def _insert_turned(self, name: str, look: Look, stretch: Stretch) -> Iterator[int]:
        """A look of a turn on the spot: what has no bearing by its loudness names no place."""
        seen, weighed = bearings(look, stretch, self._patterns[name])
        told = weighed[2] > 0
        arcs, rims = self._arcs(seen.only(told), (weighed[0][told], weighed[1][told], weighed[2][told]))
        vague, none = self._arcs(look.only(~told), None)
        yield from self._insert(name, look, np.concatenate([arcs, vague]), np.concatenate([rims, none]))

    def _insert(self, name: str, look: Look, arcs: Floats, rims: Floats) -> Iterator[int]:
        start, bin_m, far = self._axis[name]
        hit, free = self._lobe[name]
        heard = look.heard
        if self.grid.dims == 2:
            arcs[[ways_apart(heard.axes, arc, hit[0]) > APART_M for arc in arcs], 8] = TORN
        self.blocks.clear(heard.position, max(self._radius_m, self.grid.step_m))
        self._flown[cell_of(heard.position, self.grid)] = None
        quiet = np.concatenate([[0], np.cumsum(heard.quiet)])
        beam = Beam(
            heard.position,
            heard.axes,
            self._reach,
            self._hush,
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
        ways = [(*way, arc[0], SHADE) for arc in arcs[arcs[:, 8] > 0] for way in self._ways(heard.axes, arc, hit[0])]
        walls = self._tracks.walls
        screens = np.concatenate([walls, self._tracks.screens(walls)])
        yield from self.blocks.insert_in_steps(beam, np.array(ways).reshape(-1, 5), screens, sure=len(walls))
        if self.grid.dims == 2:
            yield CAST
            self._lay_strips(beam, arcs, rims, hit[0], look_share(heard.step_m))

    def _rims(self, name: str, look: Look, cosine: Floats, runs: list[Run]) -> Floats:
        """Fresnel parameter (k) out to which each echo's surface goes on about the foot of the perpendicular."""
        out = np.full(len(runs), LEAST_RIM)
        least, pattern = self._lobe[name][0][0], self._patterns[name]
        for k, run in enumerate(runs):
            lit = lit_ways(look.heard.axes, look.track, float(np.clip(cosine[k], -1, 1)), least)
            if len(lit) == 1:
                out[k] = rim_along(near(run, look), lit[0][:2], self._wavelength_m, pattern)
        return out

    def _may_be_folded(self, name: str, echo: Echo, way: Floats) -> bool:
        """The same in a volume, of an echo whose direction is known."""
        fold, told, usual = self._folds[name], (echo.range_m, echo.height), self._judge.usual
        ways = alike(way, echo.track)
        return any(fold.may_be(echo.position, echo.ahead, one, told, self.blocks, usual=usual) for one in ways)

    def _lay_strips(self, beam: Beam, arcs: Floats, rims: Floats, least: float, share: float) -> None:
        """Echoes of smooth surfaces stand for what is about the foot of the perpendicular, as far as their level tells.

        The looks of one window share their frames, and their errors: each adds but a share of its log-odds. A nearer
        echo shades widely, so that silence beside it frees nothing, but what is surely heard is not hidden by it: only
        what the map holds is before it.
        """
        middle = (np.arange(self._reach.shape[1]) + 0.5) / self._reach.shape[1]
        for arc, rim in zip(arcs, rims, strict=True):
            if not rim or arc[9] >= 0.5:
                continue
            for way in self._ways(beam.axes, arc, least):
                side, fore = way @ beam.axes[:, 1], max(float(way @ beam.axes[:, 0]), 1e-3)
                sector = int(np.argmin(abs((2 * middle - 1) * beam.tangent - side / fore)))
                hidden = arc[0] > self._reach[0, sector] + 1.5 * self.grid.step_m
                if hidden and (1 - arc[9] < SEEN_TRUST or not self.blocks.clear_to(beam.eye, way, float(arc[0]))):
                    continue
                half = 0.5 * rim * np.sqrt(self._wavelength_m * arc[0])
                blur = arc[0] * arc[6] / max(np.sqrt(max(1 - arc[5] ** 2, 0.0)), 0.1)
                gain = share * np.log((1 - arc[9]) / arc[9]) * half / np.hypot(half, blur)
                self.blocks.lay(beam.eye + arc[0] * way, way, (float(arc[1]), float(half), float(gain)))

    def _lay_disc(self, foot: SpecularPoint) -> None:
        """The same in a volume, for an echo whose direction its track told, out to where an edge would still show.

        A straight edge at the rim of the second Fresnel zone still changes the echo by 0.7 dB (knife edge); a wall
        of many steady echoes goes on at least so far.
        """
        echo = foot.echo
        false = float(np.clip(1 - echo.trust, LEAST_FALSE, 0.95))
        if false < 0.5 and not is_hidden(self.blocks, echo.position, foot.way, echo.range_m, self._wavelength_m):
            half = 0.5 * foot.rim * np.sqrt(self._wavelength_m * echo.range_m) if foot.flat else 0.75 * self.grid.step_m
            half = min(half, math.sqrt(foot.radius_m * self.grid.step_m))  # there a hollow wall is half a cell nearer
            gain = min(DISC_SHARE * echo.looks, 1.0) * np.log((1 - false) / false)
            zone = math.sqrt(self._wavelength_m * echo.range_m / 2)
            for at in along_post(foot, zone, self.grid.step_m):
                self.blocks.lay(at, foot.way, (DISC_SIGMA * self.grid.step_m, float(half), float(gain)))
                self._zones.add(at, foot.way, min(half, zone), self.grid)

    def _weigh(self, look: Look) -> Weighed | None:
        return self._judge.weigh(look) if look.track.any() else None

    def _arcs(
        self, look: Look, weighed: Weighed | None, rims: Floats | float = LEAST_RIM, folded: Bools | bool = False
    ) -> tuple[Floats, Floats]:
        """Rows for the kernel: range, sigma, track (3), cosine, its sigma, chance of detection, located, false.

        With them the rim of each that may be off a smooth surface, focused at least nearly as well as a wall as as a
        point, and zero for the others.
        """
        step, echoes = self.grid.step_m, look.echoes
        arcs = np.zeros((len(echoes), 10))
        arcs[:, 0] = echoes[:, 0]
        arcs[:, 1] = np.maximum(echoes[:, 1], 0.35 * step)
        arcs[:, 2:5] = look.track
        if weighed is None:
            arcs[:, 6], arcs[:, 7], arcs[:, 9] = 1e3, 0.5, 0.5
            return arcs, np.zeros(len(arcs))
        cosine, sigma, trust = weighed
        blur = 0.35 * step / np.maximum(echoes[:, 0], 0.1)
        arcs[:, 5] = np.clip(cosine, -1, 1)
        arcs[:, 6] = np.sqrt(sigma**2 + blur**2 + LEAST_TURN**2)
        arcs[:, 7], arcs[:, 8], arcs[:, 9] = DETECTION, 1, np.clip(1 - trust, LEAST_FALSE, 0.95)
        heard, flat = trust >= LEAST_TRUST, look.sharp[:, 3] >= FLAT_SHARE * look.sharp[:, 4]
        if self.grid.dims == 3:
            arcs[:, 8] = RING
        arcs[:, 8] = np.where(folded, 0.0, arcs[:, 8])  # it names no place, and hides nothing
        return arcs[heard], np.where(flat & ~np.asarray(folded), rims, 0.0)[heard]

    def _ways(self, axes: Floats, arc: Floats, least: float) -> list[Floats]:
        """The direction on the plane that an arc's bearing leaves open, where only one is in the beam.

        An echo comes off a surface that lies square to the way there, which then hides what lies behind it.
        """
        if self.grid.dims == 3:
            return []
        lit = lit_ways(axes, arc[2:5], float(arc[5]), least)
        return lit if len(lit) == 1 else []

    def map(self) -> OccupancyMap:
        """The map so far; free cells that no free way joins to the flight are unknown."""
        if self._rays is not None:
            return OccupancyMap(self.grid, self._rays.map().tiles, "rules")
        self._catch_up()
        known = self.blocks.known()
        if known is None:
            return OccupancyMap(self.grid, Tiles.unknown(self.grid.shape), "rules")
        box = np.array([(axis.start, axis.stop) for axis in known], np.int64)
        percent = np.empty(box[:, 1] - box[:, 0], np.int8)
        render_cells(
            self.blocks.pools, self.blocks.edge, box, FREE_NATS, PRIOR, ENOUGH_SIDES, VAGUE_TENTHS[self.grid.dims],
            HEARD_ODDS[self.grid.dims],
            SIDE_NATS, SOLID_ODDS, percent,
        )  # fmt: skip
        percent = percent.reshape(percent.shape[3 - self.grid.dims :])
        corner = tuple(int(k) for k in box[3 - self.grid.dims :, 0])
        if self.grid.dims == 2:
            solid = percent.copy()
            thin_lines(self.blocks.pools, self.blocks.edge, np.array(corner[::-1]), SOLID, solid, percent)
            without_ends(percent, corner, self.blocks, SOLID)
        flown = np.array(list(self._flown), float).reshape(-1, 3) * self.grid.step_m
        if self.grid.dims == 3:
            without_behind(percent, corner, self.grid, self._tracks.hollow_pieces)
            told = self._zones.rims(percent, corner, self.grid)
            without_beyond(percent, corner, self.grid, told, flown, max(FLOWN_M, self.grid.step_m))
        without_cut_off(percent, corner, self.grid, flown)
        return OccupancyMap(self.grid, Tiles.of(percent, shape=self.grid.shape, corner=corner), "rules")

    def changed(self) -> Changes:
        """The blocks in which the map differs from that of the last call."""
        before, self._published = self._published, self.map()
        return self._published.changes(before)


def cos_sin(angle_deg: float) -> tuple[float, float]:
    """Cosine and sine."""
    angle = math.radians(angle_deg)
    return math.cos(angle), math.sin(angle)
