"""Coherent echoes by physical optics on surfaces fixed to the world.

Each lit triangle adds (j / 4 pi) times the integral of g^2 Gamma cos / r^2 q(t - 2 r / c), in closed form where delay
and weight are linear across it [Balanis2012, ch. 7]; triangles are cut until that holds within the Fresnel zone.
Signals are analytic with e^{+jwt}: an echo at delay tau has the phase -2 pi f_c tau in the baseband, and a conductor
turns it by pi.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats, Singles
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import C0, quat_matrix
from ullage.kernels import pulse as pulses
from ullage.kernels import wires as string
from ullage.kernels.near import LEAST_M
from ullage.radar.arcs import lay_arcs
from ullage.radar.ball_bounces import lay_inside
from ullage.radar.context import (
    KAPPA,
    REACH,
    Bench,
    View,
    bench,
    common,
    grown,
    lay_triangles,
    shading,
    triangles,
    view_of,
)
from ullage.radar.curves import lay_curves
from ullage.radar.facets import Flats, Surfaces, joined
from ullage.radar.flat_pairs import lay_flat_pairs
from ullage.radar.flats import lay_flats
from ullage.radar.fringes import lay_edges
from ullage.radar.laid import Laid, centroids, laid_by
from ullage.radar.multipath import lay_bounces, looks
from ullage.radar.patch_echoes import lay_curved
from ullage.radar.roughness import lay_grit
from ullage.radar.round_pairs import lay_pairs
from ullage.radar.rounds import Round
from ullage.radar.wall_bodies import lay_wall_bodies
from ullage.radar.wall_bounces import lay_walls
from ullage.radar.ways import ways_of
from ullage.radar.wire_bounces import lay_wire_bounces
from ullage.radar.wires import placed
from ullage.specs import RadarSpec
from ullage.world.scene import Scene


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


def radio(baseband: Complexes, spec: RadarSpec) -> Singles:
    """The real signal at the antenna (n, b) from its complex envelope."""
    phase = 2 * np.pi * spec.center_hz * 2 * spec.range_m / C0
    return np.asarray((baseband * np.exp(1j * phase)).real, np.float32)


def lay(ready: Bench, view: View, poses: Floats | None, max_bounces: int, grids: Complexes) -> list[Laid]:
    """Adds every echo at one pose to the delay grids; `poses` (o, 4, 4) of the objects where any moves."""
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
        arcs = lay_arcs(ready, parts, rounds, view, grids)
        out += arcs
    if len(ready.lines):
        out += _lay_wires(ready, parts, view, poses, grids)
    if len(ready.rims.edges):
        out += lay_edges(ready, parts, view, poses, grids)
    if ready.world.rough:
        out.append(lay_grit(ready, parts, view, poses, grids))
    if max_bounces > 1:
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
    ways = ways_of(ready, flats, view, most, look)
    out = lay_curves(ready, parts, flats, view, ways, peak, grids) if curved else []
    return out + (lay_wire_bounces(ready, parts, flats, view, poses, ways, grids) if len(ready.lines) else [])


def _lay_round(
    ready: Bench, parts: list[Surfaces], rounds: tuple[Round, ...], flats: Flats, view: View, most: int, look: Floats,
    grids: Complexes,
) -> list[Laid]:  # fmt: skip
    """Adds what goes from wall to wall of a round tank or a ball, to bodies in it, between these, over flats too."""
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
