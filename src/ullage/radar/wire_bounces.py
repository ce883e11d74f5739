"""Echoes of wires over large flat faces: over faces before the wire, after it, or both.

The mirror image of the radar in a face sees the wire as the radar itself does, at another angle. So the line integral
along the wire is that of a direct echo from the place of the image, with the cylinder's series for the angle between
the two directions. Polarisation, reflection and that angle are those at the specular point of the wire. A piece of wire
counts where its path meets the faces inside their outlines and is free on all legs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Complexes, Floats, Longs
from ullage.kernels import paths as kernel
from ullage.kernels import wires as string
from ullage.kernels.facets import EchoSums, Transmission
from ullage.radar.context import KAPPA, REACH, RadarContext, RadarFrame, grown
from ullage.radar.echo_set import EchoSet, echo_set
from ullage.radar.paths import PathSet, flat_faces, reached


@dataclass(frozen=True, slots=True, eq=False)
class MetWires:
    """Pairs of a path and a wire that it meets."""

    of: Longs  # (m) path
    on: Longs  # (m) wire
    waves: Complexes  # (m, 2) factors of the cylinder's series by the fields, TM and TE
    turns: Floats  # (m) angle around the wire between the outgoing and the reversed incoming direction [rad]


def accumulate_wire_bounces(frame: RadarFrame, paths: PathSet) -> list[EchoSet]:
    """Add the echoes of wires over flat faces to the delay grids."""
    context, lines = frame.context, frame.context.lines
    at = lines.placed(frame.poses)
    met = _met(frame, paths, at.starts, at.ends)
    if not len(met.on):
        return []
    starts, ends, radars = at.starts[met.on], at.ends[met.on], paths.ends[met.of]
    gate, fresnel = np.array(context.gate), KAPPA * context.spec.wavelength_m
    pieces, owner = grown(512, (2, 3), lambda out, of: string.cut_wires(
        starts, ends, radars, gate, fresnel, REACH, out, of))  # fmt: skip
    middle = pieces.mean(1)
    free = reached(frame, paths, met.of[owner], middle).free
    if not free.any():
        return []
    wires = string.WirePieces(pieces, owner, lines.radii[met.on], _series(context, met))
    images = paths.antennas(frame.radar, met.of)

    def put(between: Transmission, sums: EchoSums) -> None:
        string.accumulate_wires(wires, between, images, context.pulse_grid, sums)

    between = Transmission(free.astype(complex), np.zeros(len(pieces)))
    echoes = echo_set(put, between, frame.grids, lines.object_ids[met.on[owner]], middle)
    return [paths.with_paths(echoes, met.of[owner])]


def _met(frame: RadarFrame, paths: PathSet, starts: Floats, ends: Floats) -> MetWires:
    """Find the wires that paths meet within the gate at their specular points."""
    size = len(paths) * len(starts)
    met = kernel.WireMeetings(np.empty(size, np.int64), np.empty(size, np.int64), np.empty((size, 2), complex),
                              np.empty(size))  # fmt: skip
    scratch = kernel.FieldScratch(np.empty((5, 4, 3)), np.empty((2, 3), complex))
    mirrors, flat, gate_m = frame.context.mirrors(frame.planar), flat_faces(frame.planar), frame.context.gate[1]
    count = kernel.meet_wires(np.stack([starts, ends]), paths.over_mirrors, gate_m, frame.antennas.fields, mirrors,
                              flat, met, scratch)  # fmt: skip
    return MetWires(met.of[:count], met.on[:count], met.waves[:count], met.turns[:count])


def _series(context: RadarContext, met: MetWires) -> Complexes:
    """Compute the series (m, 2, sines) of wires for the receiver's polarisation: both rows are equal."""
    modes, kinds = context.lines.modes, context.lines.kinds[met.on]
    orders = np.cos(met.turns[:, None] * np.arange(modes.shape[2]))
    share = (met.waves[:, :, None] * orders[:, None]).reshape(len(kinds), -1)
    out = np.empty((len(kinds), 2, modes.shape[3]), complex)
    for kind in np.unique(kinds):
        mine = kinds == kind
        # no matrix product: for small arrays its threads cost more than they save
        out[mine] = np.einsum("kn,ns->ks", share[mine], modes[kind].reshape(-1, modes.shape[3]))[:, None]
    return out
