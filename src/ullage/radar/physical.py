"""Coherent echoes by physical optics on surfaces fixed to the world.

Each lit triangle adds (j / 4 pi) times the integral of g^2 Gamma cos / r^2 q(t - 2 r / c), in closed form where delay
and weight are linear across it [Balanis2012, ch. 7]; triangles are cut until that holds within the Fresnel zone.
Signals are analytic with e^{+jwt}: an echo at delay tau has the phase -2 pi f_c tau in the baseband, and a conductor
turns it by pi.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.antenna import cube
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import C0, quat_matrix
from ullage.kernels import facets as kernel
from ullage.kernels import pulse as pulses
from ullage.kernels import wires as string
from ullage.kernels.near import LEAST_M
from ullage.radar.diffraction import Rims, nowhere, rims_of
from ullage.radar.facets import Flats, Surfaces, joined
from ullage.radar.laid import Laid, centroids, laid_by
from ullage.radar.penetration import Curtains, curtains, reflection_tables
from ullage.radar.prepared import Prepared, prepare
from ullage.radar.pulse import Pulse, tabulate
from ullage.radar.rounds import Round
from ullage.radar.visibility import seen
from ullage.radar.wires import Lines, placed, strung
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]

KAPPA = 1 / 8
"""Largest squared transverse edge of a piece over wavelength times range."""
REACH = 0.3
"""Longest edge of a piece over its range."""
_ASIDE_M = np.array([3.1e-7, -4.3e-7, 2.7e-7])  # along none of the axes that things are built along


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A radar at one place: where it sends and receives from, and how it is turned."""

    origins: Floats  # (2, 3) transmitter and receiver [m]
    frames: Floats  # (2, 3, 3) sensor_from_world
    fields: Floats  # (2, 3) unit electric fields in the world
    factor: complex = 1.0 + 0j  # of every echo

    @property
    def aside(self) -> Floats:
        """A hair (3) to the radar's side, as `edges.cut` wants it; it turns with the radar, as all else does [m]."""
        return np.asarray(_ASIDE_M @ self.frames[0])


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """All that the frames of one radar in one scene share."""

    world: Prepared
    spec: RadarSpec
    pulse: Pulse
    table: Floats
    gamma: Complexes
    lag: Floats
    lines: Lines
    rims: Rims
    sheets: Curtains
    first_m: float  # range of the first grid place [m]
    places: int
    shift: int  # grid place of bin 0
    gate: tuple[float, float]  # ranges whose echoes can reach the frame [m]
    seed: int = 0  # of the fine structure of rough surfaces
    whole_rims: bool = False  # rims of faces are cut all along, not done by their ends where those are all that counts

    @property
    def fold_s(self) -> float:
        """Time between pulses: echoes later than this land in the next frame's start [s]."""
        return 1 / self.spec.prf_hz


def bench(scene: Scene, spec: RadarSpec, *, seed: int = 0, edges: bool = True) -> Bench:
    """Pulse, tables and gates of one radar in one scene; without `edges` plain physical optics.

    Raises:
        InputError: the pulse is wider than the frame, or a material has no data at the carrier.
    """
    return _bench(prepare(scene), spec, seed, edges)


@lru_cache(maxsize=8)  # tracks come in pieces
def _bench(world: Prepared, spec: RadarSpec, seed: int, edges: bool) -> Bench:
    pulse = tabulate(spec)
    pad = pulse.half + 4
    places = 2 * pad + (spec.bins - 1) * pulse.every + 1
    first = spec.range_start_m - pad * pulse.step_s * C0 / 2
    gamma, lag = reflection_tables(world.materials, spec)
    gamma = np.concatenate([gamma, _plain(gamma)])
    lag = np.concatenate([lag, np.where(np.arange(lag.shape[1])[None, :, None] == 0, 0.0, -np.ones_like(lag[:1]))])
    last = spec.range_start_m + (spec.bins - 1) * spec.bin_m + pulse.half_m
    rims = rims_of(world.edges if edges else nowhere(), spec.wavelength_m)
    return Bench(world, spec, pulse, cube(spec.antenna), gamma, lag, strung(world.scene, spec.center_hz), rims,
                 curtains(world.materials, spec), first, places, pad, (0.0, last), seed)  # fmt: skip


def _plain(gamma: Complexes) -> Complexes:
    """A last row of the tables: what reflects 1, for paths whose coefficients are known otherwise."""
    out = np.zeros_like(gamma[:1])
    out[0, 0] = 1
    return out


def view_of(spec: RadarSpec, position: Floats, turn: Floats) -> View:
    """The radar at a position (3) [m] with world_from_sensor rotation (3, 3)."""
    arm = turn[:, 1] * (spec.antenna_offset_m / 2)
    field = turn[:, 2] if spec.antenna.polarization == "vertical" else turn[:, 1]
    return View(
        np.stack([position + arm, position - arm]), np.array([turn.T, turn.T], order="C"), np.stack([field, field])
    )


def echoes(scene: Scene, path: Trajectory, spec: RadarSpec, *, max_bounces: int = 1, seed: int = 0) -> NDArray[Any]:
    """Echoes without noise along a sensor's track, in units of sqrt(received / transmitted power).

    Args:
        scene: what there is.
        path: the sensor's poses, one frame each (x along the boresight).
        spec: the radar.
        max_bounces: reflections between sending and receiving, 1 to 3.
        seed: of the fine structure of rough surfaces.

    Returns:
        complex64 baseband (n, b), or float32 RF when spec.output is "rf".

    Raises:
        InputError: the pulse is wider than the frame, or a material has no data at the carrier.
    """
    if max_bounces not in (1, 2, 3):
        raise InputError(f"max_bounces is {max_bounces}", where="echoes", allowed="1, 2 or 3")
    ready = bench(scene, spec, seed=seed)
    turns, poses = quat_matrix(path.quat_xyzw), ready.world.poses(path.t_ns)
    out = np.zeros((len(path), spec.bins), complex)
    for i in range(len(path)):
        grids = np.zeros((3, ready.places), complex)
        lay(ready, view_of(spec, path.position[i], turns[i]), poses[i], max_bounces, grids)
        pulses.convolve(grids, ready.pulse.taps, ready.pulse.every, ready.shift, out[i])
        out[i] *= passive(out[i])
    if spec.output == "rf":
        return radio(out, spec)
    return out.astype(np.complex64)


def passive(echo: Complexes) -> float:
    """What keeps an echo's greatest sample (b) within what was sent, as a factor, however many things stand close.

    No passive thing reflects more than all [Pozar2012, ch. 4]. Of -20 dB it takes 2e-4 dB, of less next to nothing.
    """
    square = float((echo.real**2 + echo.imag**2).max(initial=0.0))
    return float((1 + square * square) ** -0.25)


def radio(baseband: Complexes, spec: RadarSpec) -> NDArray[np.float32]:
    """The real signal at the antenna (n, b) from its complex envelope."""
    phase = 2 * np.pi * spec.center_hz * 2 * spec.range_m / C0
    return np.asarray((baseband * np.exp(1j * phase)).real, np.float32)


def lay(ready: Bench, view: View, poses: Floats | None, max_bounces: int, grids: Complexes) -> list[Laid]:
    """Adds every echo at one pose to the delay grids; `poses` (o, 4, 4) of the objects where any moves."""
    from ullage.radar.flats import lay_flats
    from ullage.radar.patch_echoes import lay_curved

    parts = ready.world.parts(poses)
    view = _off(parts, view)
    out, done = lay_curved(ready, parts, view, grids)
    for part in parts:
        small, large = done if part is parts[0] else (None, None)
        if len(part.corners):
            out.append(_lay_small(ready, parts, part, view, grids, small))
        out += lay_flats(ready, parts, part, view, grids, large)
    rounds, arcs = ready.world.rounds_at(poses), []
    if rounds:
        from ullage.radar.arcs import lay_arcs

        arcs = lay_arcs(ready, parts, rounds, view, grids)
        out += arcs
    if len(ready.lines):
        out += _lay_wires(ready, parts, view, poses, grids)
    if len(ready.rims.edges):
        from ullage.radar.fringes import lay_edges

        out += lay_edges(ready, parts, view, poses, grids)
    if ready.world.rough:
        from ullage.radar.roughness import lay_grit

        out.append(lay_grit(ready, parts, view, poses, grids))
    if max_bounces > 1:
        from ullage.radar.multipath import lay_bounces, looks

        flats = joined([part.flats for part in parts])
        look = looks(ready, flats, view)
        out += lay_bounces(ready, parts, flats, view, max_bounces, look, grids)
        loud = grids.sum(0) if arcs else grids  # what arcs add rises with f, which no kind of echo does alone
        out += _lay_over(ready, parts, flats, view, poses, max_bounces, look, float(abs(loud).max()), grids)
        if rounds:
            out += _lay_round(ready, parts, rounds, flats, view, max_bounces, look, grids)
    return out


def _off(parts: list[Surfaces], view: View) -> View:
    """The radar `LEAST_M` off the planes of all flat faces that it is in: on a face there is no side to be on.

    What lies in a plane to 1 nm comes to stand in front of it.
    """
    origins = view.origins
    for part in parts:
        normals, offsets = part.flats.normals, part.flats.offsets
        some = origins[:1] if (origins[0] == origins[1]).all() else origins
        gaps = np.array([normals @ origin for origin in some]) - offsets
        close = np.repeat(abs(gaps) < LEAST_M, 3 - len(some), 0)
        if close.any():
            origins = origins.copy()
            for s, p in np.argwhere(close):
                gap = float(normals[p] @ origins[s] - offsets[p])
                origins[s] += ((LEAST_M if gap > -1e-9 else -LEAST_M) - gap) * normals[p]
    return view if origins is view.origins else replace(view, origins=origins)


def _lay_over(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, poses: Floats | None, most: int, look: Floats,
    peak: float, grids: Complexes,
) -> list[Laid]:  # fmt: skip
    """Adds the echoes of what is no mirror by way of the flat faces that look largest, all others being that loud."""
    curved = flats.smooth.any() or any(len(part.corners) for part in parts)
    if not (curved or len(ready.lines)) or flats.smooth.all():
        return []
    from ullage.radar.curves import lay_curves
    from ullage.radar.ways import ways_of
    from ullage.radar.wire_bounces import lay_wire_bounces

    ways = ways_of(ready, flats, view, most, look)
    out = lay_curves(ready, parts, flats, view, ways, peak, grids) if curved else []
    return out + (lay_wire_bounces(ready, parts, flats, view, poses, ways, grids) if len(ready.lines) else [])


def _lay_round(
    ready: Bench, parts: list[Surfaces], rounds: tuple[Round, ...], flats: Flats, view: View, most: int, look: Floats,
    grids: Complexes,
) -> list[Laid]:  # fmt: skip
    """Adds what goes from wall to wall of a round tank or a ball, to bodies in it, between these, over flats too."""
    from ullage.radar.ball_bounces import lay_inside
    from ullage.radar.flat_pairs import lay_flat_pairs
    from ullage.radar.round_pairs import lay_pairs
    from ullage.radar.wall_bodies import lay_wall_bodies
    from ullage.radar.wall_bounces import lay_walls

    out = lay_walls(ready, parts, rounds, flats, view, most, look, grids)
    out += lay_inside(ready, parts, view, most, grids)
    if len(rounds) > 1:
        out += lay_wall_bodies(ready, parts, rounds, flats, view, most, look, grids)
        out += lay_pairs(ready, parts, rounds, view, grids)
    return out + (lay_flat_pairs(ready, parts, rounds, flats, view, look, grids) if most > 2 else [])


def _lay_wires(ready: Bench, parts: list[Surfaces], view: View, poses: Floats | None, grids: Complexes) -> list[Laid]:
    lines = ready.lines
    starts, ends = placed(lines, poses)
    gate, fresnel = np.array(ready.gate), KAPPA * ready.spec.wavelength_m
    pieces, owner = grown(2048, (2, 3), lambda out, of: string.cut_wires(
        starts, ends, view.origins[None], gate, fresnel, REACH, out, of))  # fmt: skip
    if not len(pieces):
        return []
    middle = 0.5 * (pieces[:, 0] + pieces[:, 1])
    shade, extra = shading(ready, parts, view, middle)
    told = common(ready, view, grids)

    def put(shade: Complexes, grids: Complexes, *out: Any) -> None:
        string.lay_wires(pieces, owner, shade, extra, lines.radii, lines.series, *told[:6], *told[8:-1], grids, *out)

    return [laid_by(put, shade, grids, lines.stuffs[owner], middle)]


def _lay_small(
    ready: Bench, parts: list[Surfaces], part: Surfaces, view: View, grids: Complexes, done: Bools | None
) -> Laid:
    leaves, owner = triangles(ready, part, view, done)
    between = shading(ready, parts, view, centroids(leaves))
    pieces = leaves, owner, np.zeros(len(owner), np.int64)
    return lay_triangles(part.normals, part.stuffs, pieces, between, common(ready, view, grids))


def lay_triangles(
    normals: Floats,
    stuffs: NDArray[np.int32],
    pieces: tuple[Floats, NDArray[np.int32], NDArray[np.int64]],
    between: tuple[Complexes, Floats],
    told: tuple[Any, ...],
) -> Laid:
    """Lays pieces of triangles, as `triangles` gives them, and the radar of each (m).

    With factor and delay [s] of what stands before each; what the kernel is `told` of radars (w) is as in `common`.
    """
    (leaves, owner, of), (shade, extra) = pieces, between

    def put(shade: Complexes, grids: Complexes, *out: Any) -> None:
        kernel.deposit(leaves, owner, of, shade, extra, normals, stuffs, *told[:-1], grids, *out, np.empty((5, 3)),
                       np.empty(3, complex))  # fmt: skip

    return laid_by(put, shade, told[-1], stuffs[owner], lambda: centroids(leaves))


def common(ready: Bench, view: View, grids: Complexes) -> tuple[Any, ...]:
    """What every kernel that lays echoes is told."""
    return (view.origins[None], view.frames[None], view.fields[None], ready.table,
            ready.spec.antenna.kind == "isotropic", np.array([view.factor], complex), ready.gamma, ready.lag,
            ready.pulse.omega, ready.first_m * 2 / C0, ready.pulse.step_s, ready.fold_s, grids)  # fmt: skip


def grown(
    size: int, shape: tuple[int, ...], fill: Callable[[Floats, NDArray[np.int32]], int]
) -> tuple[Floats, NDArray[np.int32]]:
    """Runs a kernel that counts what it writes, again with more room when there was too little."""
    while True:
        out, owner = np.empty((size, *shape)), np.empty(size, np.int32)
        count = fill(out, owner)
        if count <= size:
            return out[:count], owner[:count]
        size = int(1.2 * count)


def triangles(ready: Bench, part: Surfaces, view: View, done: Bools | None = None) -> tuple[Floats, NDArray[np.int32]]:
    """Triangles within the gate but those `done` (f), small enough for the closed form, and which each came from."""
    opaque = ~ready.sheets.thin[part.stuffs]
    if near(*view.origins):
        dark = part.backs.hidden(view.origins, opaque)
    else:  # a face takes from one place and gives to the other
        dark = part.backs.hidden(view.origins[:1], opaque) | part.backs.hidden(view.origins[1:], opaque)
    if done is not None:
        dark = dark | done
    return grown(8192, (3, 3), lambda out, owner: kernel.split(
        part.spheres, part.first, part.corners, dark, view.origins, np.array(ready.gate),
        KAPPA * ready.spec.wavelength_m, REACH, out, owner, np.empty((96, 3, 3))))  # fmt: skip


def shading(ready: Bench, parts: list[Surfaces], view: View, points: Floats) -> tuple[Complexes, Floats]:
    """Two-way factor (m) of what stands before each point, 1 in the open, and the delay it adds [s]."""
    one, other = view.origins
    if near(one, other):
        return seen(parts, (one + other) / 2, points, ready.sheets)
    (factor, late), (back, later) = (seen(parts, eye, points, ready.sheets) for eye in (one, other))
    return np.sqrt(factor) * np.sqrt(back), (late + later) / 2


def near(one: Floats, other: Floats) -> bool:
    """Whether two antennas (3) see the same, being as near to each other as this."""
    gap = one - other
    return float(gap @ gap) < _ONE_EYE_M**2


_ONE_EYE_M = 0.1  # antennas nearer to each other than this see the same, as seen from between them


@lru_cache(maxsize=8)
def _carrier_only(spec: RadarSpec, frequency_hz: float) -> RadarSpec:
    """The same antenna and place with a frame so long that nothing is lost."""
    return spec.but(center_hz=frequency_hz, bins=2000, range_start_m=0.0, prf_div=255)


def path_gain_cw(
    scene: Scene,
    pose: Trajectory,
    spec: RadarSpec,
    frequency_hz: float | None = None,
    *,
    max_bounces: int = 1,
    edges: bool = True,
) -> Complexes:
    """Complex path gain (n) of everything in sight at one frequency (None: the radar's centre), all delays summed.

    Args:
        scene: what there is.
        pose: the sensor's poses.
        spec: the radar.
        frequency_hz: [Hz].
        max_bounces: 1 to 3.
        edges: whether conducting edges are corrected; without, the plain integral of physical optics.
    """
    ready = bench(scene, _carrier_only(spec, frequency_hz or spec.center_hz), edges=edges)
    turns, poses = quat_matrix(pose.quat_xyzw), ready.world.poses(pose.t_ns)
    out = np.zeros(len(pose), complex)
    for i in range(len(pose)):
        grids = np.zeros((3, ready.places), complex)
        lay(ready, view_of(spec, pose.position[i], turns[i]), poses[i], max_bounces, grids)
        out[i] = grids.sum()
        out[i] *= passive(out[i : i + 1])
    return out
