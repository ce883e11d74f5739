"""Coherent echoes by physical optics on surfaces fixed to the world.

Each lit triangle adds (j / 4 pi) times the integral of g^2 Gamma cos / r^2 q(t - 2 r / c), in closed form where delay
and weight are linear across it [Balanis2012, ch. 7]; triangles are cut until that holds within the Fresnel zone.
Signals are analytic with e^{+jwt}: an echo at delay tau has the phase -2 pi f_c tau in the baseband, and a conductor
turns it by pi.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage import checks
from ullage.arrays import Bools, Complexes, Singles
from ullage.data import Trajectory
from ullage.geometry import C0, quat_matrix
from ullage.kernels import wires as string
from ullage.kernels.facets import EchoSums, Transmission, TrianglePieces
from ullage.radar.context import KAPPA, REACH, RadarFrame, frames_at, grown, radar_contexts, triangles
from ullage.radar.creeping import accumulate_creeping, rods
from ullage.radar.curves import accumulate_curves
from ullage.radar.cylinder_correction import accumulate_cylinder_corrections
from ullage.radar.echo_set import EchoSet, centroids, echo_set
from ullage.radar.edge_diffraction import accumulate_edges
from ullage.radar.facets import Surfaces
from ullage.radar.fermat import accumulate_fermat
from ullage.radar.multipath import accumulate_bounces
from ullage.radar.patch_echoes import accumulate_curved
from ullage.radar.paths import paths_of
from ullage.radar.planar import accumulate_planar
from ullage.radar.reflectors import PULL_M
from ullage.radar.roughness import accumulate_diffuse_scatterers
from ullage.radar.walls import accumulate_inside, accumulate_walls
from ullage.radar.wire_bounces import accumulate_wire_bounces
from ullage.radar.wires import Lines
from ullage.specs import MOST_BOUNCES, RadarSpec
from ullage.world.scene import Scene


def echoes(scene: Scene, path: Trajectory, spec: RadarSpec, *, max_bounces: int = 1, seed: int = 0) -> NDArray[Any]:
    """Echoes without noise along a sensor's track, in units of sqrt(received / transmitted power).

    Args:
        scene: what there is.
        path: the sensor's poses, one frame each (x along the boresight).
        spec: the radar.
        max_bounces: reflections between sending and receiving, 1 to 6.
        seed: of the fine structure of rough surfaces.

    Returns:
        complex64 baseband (n, b), or float32 RF when spec.output is "rf".

    Raises:
        InputError: the pulse is wider than the frame, or a material has no data at the carrier.
    """
    checks.whole("max_bounces", max_bounces, "echoes", low=1, high=MOST_BOUNCES)
    contexts = radar_contexts(scene, spec, seed=seed)
    turns, poses = quat_matrix(path.quat_xyzw), contexts[0].poses(path)
    out = np.zeros((len(path), spec.bins), complex)
    for i in range(len(path)):
        for frame in frames_at(contexts, path.position[i], turns[i], poses[i], max_bounces):
            accumulate(frame)
            frame.add_range_bins(out[i])
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


def accumulate(frame: RadarFrame) -> list[EchoSet]:
    """Add every echo of a frame to its delay grids."""
    context, planar = frame.context, frame.planar
    out, done = accumulate_curved(frame)
    for part, (small, large) in zip(frame.parts, done, strict=True):
        if len(part.corners):
            out.append(_accumulate_small(frame, part, small))
        out += accumulate_planar(frame, part, large)
    corrections = accumulate_cylinder_corrections(frame) if frame.quadrics else []
    out += corrections
    if not context.plain:
        out += accumulate_creeping(frame)
    for lines in (context.lines,) if context.plain else (context.lines, rods(context)):
        if len(lines):
            out += _accumulate_wires(frame, lines)
    if len(context.outlines.edges):
        out += accumulate_edges(frame)
    if context.world.rough:
        out.append(accumulate_diffuse_scatterers(frame))
    if frame.max_bounces > 1:
        out += accumulate_bounces(frame)
        # corrections rise with f, and only the sum is an echo
        peak = float(abs(frame.grids.sum(0) if corrections else frame.grids).max())
        curved = bool(planar.smooth.any()) or any(len(part.corners) for part in frame.parts)
        if not planar.smooth.all() and (len(context.lines) or curved):
            paths = paths_of(frame)
            if curved:
                out += accumulate_curves(frame, paths, peak)
            if len(context.lines):
                out += accumulate_wire_bounces(frame, paths)
        if frame.quadrics:
            out += accumulate_walls(frame)
            out += accumulate_inside(frame)
            out += accumulate_fermat(frame)
    return out


def _accumulate_wires(frame: RadarFrame, lines: Lines) -> list[EchoSet]:
    context, origins, radar = frame.context, frame.antennas.origins, frame.radar
    at, gate, fresnel = lines.placed(frame.poses), np.array(context.gate), KAPPA * context.spec.wavelength_m
    pieces, owner = grown(2048, (2, 3), lambda out, of: string.cut_wires(
        at.starts, at.ends, origins[None], gate, fresnel, REACH, out, of))  # fmt: skip
    if not len(pieces):
        return []
    middle = 0.5 * (pieces[:, 0] + pieces[:, 1])
    wires = string.WirePieces(pieces, owner, lines.radii, lines.series)

    def put(between: Transmission, sums: EchoSums) -> None:
        string.accumulate_wires(wires, between, radar, context.pulse_grid, sums)

    covers, axes = lines.covers[owner], pieces[:, 1] - pieces[:, 0]
    if covers.any():  # ask before the mesh, on the radar's side; inside it there is nothing to ask
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        away = origins.mean(0) - middle
        away -= np.einsum("ni,ni->n", away, axes)[:, None] * axes
        level = np.linalg.norm(away, axis=1)
        middle = middle + ((covers + PULL_M) / np.maximum(level, 1e-9))[:, None] * away
    between = frame.transmission_to(middle)
    if covers.any():
        between = between._replace(factor=between.factor * (level > covers))
    return [echo_set(put, between, frame.grids, lines.object_ids[owner], middle)]


def _accumulate_small(frame: RadarFrame, part: Surfaces, done: Bools | None) -> EchoSet:
    leaves, owner = triangles(frame, part, done)
    pieces = TrianglePieces(leaves, owner, np.zeros(len(owner), np.int64))
    return frame.accumulate_triangles(pieces, frame.lit(part), frame.transmission_to(centroids(leaves)))


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
        max_bounces: 1 to 6.
        edges: whether edges and creeping waves are added; without, the plain integral of physical optics.
    """
    contexts = radar_contexts(scene, _carrier_only(spec, frequency_hz or spec.center_hz), edges=edges)
    turns, poses = quat_matrix(pose.quat_xyzw), contexts[0].poses(pose)
    out = np.zeros(len(pose), complex)
    for i in range(len(pose)):
        for frame in frames_at(contexts, pose.position[i], turns[i], poses[i], max_bounces):
            accumulate(frame)
            out[i] += frame.grids.sum() * frame.context.carrier
        out[i] *= passive(out[i : i + 1])
    return out
