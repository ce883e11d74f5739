"""What the frames of one radar in one scene share: pulse, tables, gates, the pair of antennas, and how pieces are cut.

Antennas whose fields are known are sums of patterns of one polarisation each; each pair of these has its own context,
and frames are their sums.

Every mechanism of `radar.physical` takes this context and knows none of the other mechanisms' callers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from ullage.antenna import PatternPair, pattern_pairs
from ullage.arrays import Bools, Complexes, Floats, Ints
from ullage.data import Trajectory
from ullage.geometry import C0
from ullage.kernels import beams, pulse
from ullage.kernels import facets as kernel
from ullage.kernels.bounces import Mirrors
from ullage.kernels.facets import (
    Antennas,
    EchoSums,
    LitFaces,
    PieceLimits,
    PulseGrid,
    Reflection,
    Transmission,
    TriangleClusters,
    TrianglePieces,
)
from ullage.kernels.near import LEAST_M
from ullage.radar.diffraction import OutlineSet, nowhere, outlines_of
from ullage.radar.echo_set import EchoSet, centroids, echo_set
from ullage.radar.facets import PlanarPatches, Surfaces, joined
from ullage.radar.own_body import carried
from ullage.radar.penetration import Transmissive, reflection_tables, transmissive_of
from ullage.radar.prepared import Prepared, prepare
from ullage.radar.pulse import Pulse, tabulate
from ullage.radar.quadrics import Quadric
from ullage.radar.visibility import seen
from ullage.radar.wires import Lines, strung
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

KAPPA = 1 / 8
"""Largest squared transverse edge of a piece over wavelength times range."""

REACH = 0.3
"""Longest edge of a piece over its range."""

_ASIDE_M = np.array([3.1e-7, -4.3e-7, 2.7e-7])  # along none of the axes that things are built along


@dataclass(frozen=True, slots=True, eq=False)
class AntennaPair:
    """A radar at one place: where it sends and receives from, and how it is turned."""

    origins: Floats  # (2, 3) transmitter and receiver [m]
    frames: Floats  # (2, 3, 3) sensor_from_world
    fields: Floats  # (2, 3) unit electric fields in the world
    factor: complex = 1.0 + 0j  # of every echo
    patterns: tuple[int, int] = (0, 0)  # which of the context's patterns each has

    @property
    def monostatic(self) -> bool:
        """Whether transmitter and receiver stand at one place."""
        return bool(self.origins[0].tolist() == self.origins[1].tolist())

    @property
    def alike(self) -> bool:
        """Whether transmitter and receiver have one polarisation."""
        return bool(self.fields[0].tolist() == self.fields[1].tolist())

    @property
    def reversible(self) -> bool:
        """Whether a path and its reverse carry the same wave."""
        return self.monostatic and self.alike and self.patterns[0] == self.patterns[1]

    def swapped(self) -> AntennaPair:
        """Return the radar that sends from this one's receiver."""
        origins, frames, fields = (np.ascontiguousarray(row[::-1]) for row in (self.origins, self.frames, self.fields))
        return AntennaPair(origins, frames, fields, self.factor, self.patterns[::-1])

    @property
    def aside(self) -> Floats:
        """A hair (3) to the radar's side, as `edges.cut` wants it; it turns with the radar, as all else does [m]."""
        return np.asarray(_ASIDE_M @ self.frames[0])


@dataclass(frozen=True, slots=True, eq=False)
class RadarContext:
    """All that the frames of one radar in one scene share."""

    world: Prepared
    spec: RadarSpec
    pulse: Pulse
    patterns: PatternPair
    magnitudes: Floats  # of its table
    gamma: Complexes  # echoes of each material; the last row reflects 1
    lag: Floats  # their delays [s]
    bounce: Complexes  # what goes on to other surfaces
    lines: Lines
    outlines: OutlineSet
    transmissive: Transmissive
    first_m: float  # range of the first grid place [m]
    places: int
    shift: int  # grid place of bin 0
    gate: tuple[float, float]  # ranges whose echoes can reach the frame [m]
    seed: int = 0  # of the fine structure of rough surfaces
    plain: bool = False  # physical optics alone, without edges and creeping waves
    whole_outlines: bool = (
        False  # rims of faces are cut all along, not done by their ends where those are all that counts
    )

    @property
    def fold_s(self) -> float:
        """Time between pulses: echoes later than this land in the next frame's start [s]."""
        return 1 / self.spec.prf_hz

    def poses(self, path: Trajectory) -> Floats | list[None]:
        """Return the poses of all objects (n, o, 4, 4) along a sensor's path (n); None for each where nothing moves."""
        poses = self.world.poses(path.t_ns)
        return poses if isinstance(poses, list) else carried(poses, self.world.own, path, self.spec)

    @property
    def carrier(self) -> complex:
        """Transfer of both antennas at the carrier."""
        return self.patterns.carrier(self.spec.center_hz)

    @property
    def widest_m(self) -> float:
        """Facets of curved surfaces wider than this are mirrors of their own [m]: a Fresnel zone at the gate."""
        return float(np.sqrt(self.spec.wavelength_m * self.gate[1] / 2))

    @property
    def loudest(self) -> float:
        """Largest two-way amplitude gain."""
        return float(self.magnitudes[0].max() * self.magnitudes[-1].max())

    @property
    def reflection(self) -> Reflection:
        """Reflection tables of the materials, as kernels take them."""
        return _reflection(self)

    @property
    def pulse_grid(self) -> PulseGrid:
        """Carrier and delay grid, as kernels take them."""
        return _pulse_grid(self)

    def antennas(self, pair: AntennaPair) -> Antennas:
        """One radar at one place, as kernels take it."""
        return _antennas(self, pair)

    def mirrors(self, planar: PlanarPatches) -> Mirrors:
        """Flat faces as mirrors for the carrier, as kernels take them."""
        return Mirrors(planar.normals, planar.offsets, planar.object_ids, planar.widths, self.bounce,
                       self.spec.wavelength_m)  # fmt: skip

    @property
    def piece_limits(self) -> PieceLimits:
        """How small the pieces of triangles must be, and where they are wanted."""
        return PieceLimits(np.array(self.gate), KAPPA * self.spec.wavelength_m, REACH)


# all mechanisms of a frame ask for the same: it is made once
@lru_cache(maxsize=8)
def _reflection(context: RadarContext) -> Reflection:
    return Reflection(context.gamma, context.lag)


@lru_cache(maxsize=32)
def _pulse_grid(context: RadarContext) -> PulseGrid:
    return PulseGrid(context.pulse.omega, context.first_m * 2 / C0, context.pulse.step_s, context.fold_s)


@lru_cache(maxsize=32)
def _antennas(context: RadarContext, pair: AntennaPair) -> Antennas:
    table = context.patterns.swapped() if pair.patterns[0] > pair.patterns[1] else context.patterns.table
    return Antennas(pair.origins[None], pair.frames[None], pair.fields[None], table,
                    context.spec.antenna.kind == "isotropic", np.array([pair.factor], complex))  # fmt: skip


def radar_contexts(scene: Scene, spec: RadarSpec, *, seed: int = 0, edges: bool = True) -> tuple[RadarContext, ...]:
    """Pulse, tables and gates of each pair of patterns of a radar in one scene; without `edges` plain physical optics.

    Raises:
        InputError: the pulse is wider than the frame, a material has no data at the carrier, or a table of an antenna
            cannot be read.
    """
    return _bench(prepare(scene), spec, seed, edges)


def radar_context(scene: Scene, spec: RadarSpec, *, seed: int = 0, edges: bool = True) -> RadarContext:
    """Return the first of `radar_contexts`, which is the only one of antennas without a far field."""
    return radar_contexts(scene, spec, seed=seed, edges=edges)[0]


@lru_cache(maxsize=32)  # tracks come in pieces; several radars, each of one or two pulse intervals
def _bench(world: Prepared, spec: RadarSpec, seed: int, edges: bool) -> tuple[RadarContext, ...]:
    gamma, lag, bounce = reflection_tables(world.materials, spec)
    gamma, bounce = np.concatenate([gamma, _plain(gamma)]), np.concatenate([bounce, _plain(bounce)])
    lag = np.concatenate([lag, np.where(np.arange(lag.shape[1])[None, :, None] == 0, 0.0, -np.ones_like(lag[:1]))])
    lines = strung(world.scene, spec.center_hz)
    outlines = outlines_of(world.edges if edges else nowhere(), spec.wavelength_m)
    transmissive = transmissive_of(world.materials, spec)
    out, last = [], spec.range_start_m + (spec.bins - 1) * spec.bin_m
    for patterns in pattern_pairs(spec):
        taps = tabulate(spec, patterns)
        pad = taps.half + 4
        places = 2 * pad + (spec.bins - 1) * taps.every + 1
        first = spec.range_start_m - pad * taps.step_s * C0 / 2
        out.append(RadarContext(world, spec, taps, patterns, np.abs(patterns.table), gamma, lag, bounce, lines,
                                outlines, transmissive, first, places, pad, (0.0, last + taps.half_m), seed,
                                not edges))  # fmt: skip
    return tuple(out)


def _plain(gamma: Complexes) -> Complexes:
    """A last row of the tables: what reflects 1, for paths whose coefficients are known otherwise."""
    out = np.zeros_like(gamma[:1])
    out[0, 0] = 1
    return out


def antenna_pair(spec: RadarSpec, position: Floats, turn: Floats, patterns: PatternPair | None = None) -> AntennaPair:
    """The radar at a position (3) [m], world_from_sensor rotation (3, 3), with a pair of patterns (None: the first)."""
    arm = turn[:, 1] * (spec.antenna_offset_m / 2)
    pair = patterns or pattern_pairs(spec)[0]
    return AntennaPair(np.array([position + arm, position - arm]), np.array([turn.T, turn.T], order="C"),
                       pair.axes @ turn.T, patterns=(0, len(pair.table) - 1))  # fmt: skip


@dataclass(frozen=True, eq=False)
class RadarFrame:
    """One frame of one radar: what all of its mechanisms take, and the delay grids that they add to."""

    context: RadarContext
    antennas: AntennaPair
    parts: list[Surfaces]  # what stands still and what moves
    poses: Floats | None  # (o, 4, 4) of the objects where any moves
    max_bounces: int
    grids: Complexes  # (3, g)

    @cached_property
    def radar(self) -> Antennas:
        """The radar, as kernels take it."""
        return self.context.antennas(self.antennas)

    @cached_property
    def planar(self) -> PlanarPatches:
        """All flat faces (p)."""
        return joined([part.planar for part in self.parts])

    @cached_property
    def quadrics(self) -> tuple[Quadric, ...]:
        """All fitted cylinders and spheres."""
        return self.context.world.quadrics_at(self.poses)

    @cached_property
    def sizes(self) -> Floats:
        """Apparent size of each flat face (p) from the nearest antenna; 0 beyond the gate.

        It is reduced for faces smaller than a Fresnel zone.
        """
        origins = self.antennas.origins[:1] if self.antennas.monostatic else self.antennas.origins
        spheres, widths, out = self.planar.spheres, self.planar.widths, np.empty(len(self.planar))
        beams.apparent_sizes(spheres, widths, origins, self.context.gate[1], self.context.spec.wavelength_m, out)
        return out

    def lit(self, surfaces: Surfaces | PlanarPatches) -> LitFaces:
        """Triangles or flat faces as the radar sees them, as kernels take them."""
        return LitFaces(surfaces.normals, surfaces.object_ids, self.radar, self.context.reflection)

    def transmission_to(self, points: Floats) -> Transmission:
        """Find the two-way factor (m) of what stands before each point, 1 in the open, and the delay it adds [s]."""
        (one, other), transmissive = self.antennas.origins, self.context.transmissive
        if near(one, other):
            return Transmission(*seen(self.parts, (one + other) / 2, points, transmissive))
        (factor, late), (back, later) = (seen(self.parts, eye, points, transmissive) for eye in (one, other))
        return Transmission(np.sqrt(factor) * np.sqrt(back), (late + later) / 2)

    def accumulate_triangles(self, pieces: TrianglePieces, lit: LitFaces, between: Transmission) -> EchoSet:
        """Add the echoes of pieces (m) of triangles, as `triangles` gives them."""
        (phase, place, cosine, path), (base, weight) = np.empty((4, 3)), np.empty((2, 3), complex)
        scratch = kernel.CornerScratch(phase, place, base, cosine, path, weight)

        def put(between: Transmission, sums: EchoSums) -> None:
            kernel.accumulate(pieces, lit, between, self.context.pulse_grid, sums, scratch)

        return echo_set(put, between, self.grids, lit.materials[pieces.triangle], lambda: centroids(pieces.corners))

    def add_range_bins(self, out: Complexes) -> None:
        """Convolve the delay grids with the pulse, and add them to range bins (b)."""
        context = self.context
        pulse.convolve(self.grids, context.pulse.taps, context.pulse.every, context.shift, out)


def radar_frame(
    context: RadarContext, antennas: AntennaPair, poses: Floats | None = None, max_bounces: int = 1
) -> RadarFrame:
    """Start a frame of a radar at one place, without echoes; `poses` (o, 4, 4) of the objects where any moves."""
    parts = context.world.parts(poses)
    grids = np.zeros((3, context.places), complex)
    return RadarFrame(context, off_faces(parts, antennas), parts, poses, max_bounces, grids)


def frames_at(
    contexts: tuple[RadarContext, ...], position: Floats, turn: Floats, poses: Floats | None, max_bounces: int
) -> list[RadarFrame]:
    """Start a frame of each pair of patterns at a position (3) [m] with world_from_sensor rotation (3, 3)."""
    return [radar_frame(one, antenna_pair(one.spec, position, turn, one.patterns), poses, max_bounces)
            for one in contexts]  # fmt: skip


def off_faces(parts: list[Surfaces], antennas: AntennaPair) -> AntennaPair:
    """The radar `LEAST_M` off the planes of all flat faces that it is in: on a face there is no side to be on.

    What lies in a plane to 1 nm comes to stand in front of it.
    """
    origins = antennas.origins
    for part in parts:
        normals, offsets = part.planar.normals, part.planar.offsets
        some = origins[:1] if antennas.monostatic else origins
        gaps = np.array([normals @ origin for origin in some]) - offsets
        close = np.repeat(abs(gaps) < LEAST_M, 3 - len(some), 0)
        if close.any():
            origins = origins.copy()
            for s, p in np.argwhere(close):
                gap = float(normals[p] @ origins[s] - offsets[p])
                origins[s] += ((LEAST_M if gap > -1e-9 else -LEAST_M) - gap) * normals[p]
    return antennas if origins is antennas.origins else replace(antennas, origins=origins)


def grown(size: int, shape: tuple[int, ...], fill: Callable[[Floats, Ints], int]) -> tuple[Floats, Ints]:
    """Runs a kernel that counts what it writes, again with more room when there was too little."""
    while True:
        out, owner = np.empty((size, *shape)), np.empty(size, np.int32)
        count = fill(out, owner)
        if count <= size:
            return out[:count], owner[:count]
        size = int(1.2 * count)


def triangles(frame: RadarFrame, part: Surfaces, done: Bools | None = None) -> tuple[Floats, Ints]:
    """Cut the triangles within the gate, but those `done` (f), to pieces small enough for the closed form.

    Returns:
        The pieces (m, 3, 3) [m], and the triangle that each came from (m).
    """
    opaque, origins = ~frame.context.transmissive.thin[part.object_ids], frame.antennas.origins
    if near(*origins):
        dark = part.backs.hidden(origins, opaque)
    else:  # a face takes from one place and gives to the other
        dark = part.backs.hidden(origins[:1], opaque) | part.backs.hidden(origins[1:], opaque)
    return split(frame, part, dark if done is None else dark | done, 8192)


def split(frame: RadarFrame, part: Surfaces, dark: Bools, room: int) -> tuple[Floats, Ints]:
    """Cut the triangles but the `dark` ones (f); give the pieces (m, 3, 3) [m] and the triangle of each (m).

    There is room for so many pieces at first.
    """
    clusters = TriangleClusters(part.spheres, part.first, part.corners)
    origins, limits, stack = frame.antennas.origins, frame.context.piece_limits, np.empty((96, 3, 3))
    return grown(room, (3, 3), lambda out, owner: kernel.split(clusters, dark, origins, limits, out, owner, stack))


def near(one: Floats, other: Floats) -> bool:
    """Whether two antennas (3) see the same, being as near to each other as this."""
    gap = one - other
    return float(gap @ gap) < _ONE_EYE_M**2


_ONE_EYE_M = 0.1  # antennas nearer to each other than this see the same, as seen from between them
