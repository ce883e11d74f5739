"""Echoes of wires by way of large flat faces: over faces before the wire, after it, or both.

The mirror image of the radar in a face sees the wire as the radar itself does, at another angle: the line integral
along the wire is that of a direct echo from the image's place, with the cylinder's series for the angle between the two
directions. Polarisation, reflection and that angle are those at the wire's point of shortest path. A piece of
wire counts where its path meets the faces within their rims and is free on all legs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Complexes, Floats, Longs
from ullage.kernels import paths as kernel
from ullage.kernels import wires as string
from ullage.kernels.facets import EchoSums, Transmission
from ullage.radar.context import KAPPA, REACH, AntennaPair, RadarContext, grown
from ullage.radar.echo_set import EchoSet, echo_set
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.paths import PathSet, flat_faces, reached
from ullage.radar.wires import placed


@dataclass(frozen=True, slots=True, eq=False)
class Strung:
    """Wires as ways meet them, one for each way and wire."""

    of: Longs  # (m) way
    on: Longs  # (m) wire
    waves: Complexes  # (m, 2) what the fields make of the cylinder's series, TM and TE
    turns: Floats  # (m) angle about the wire between the way on and the way it came [rad]


def accumulate_wire_bounces(
    context: RadarContext,
    parts: list[Surfaces],
    planar: PlanarPatches,
    antennas: AntennaPair,
    poses: Floats | None,
    paths: PathSet,
    grids: Complexes,
) -> list[EchoSet]:
    """Adds the echoes of wires over flat faces to the delay grids."""
    lines = context.lines
    starts, ends = placed(lines, poses)
    met = _met(context, planar, antennas, paths, starts, ends)
    if not len(met.on):
        return []
    starts, ends, radars = starts[met.on], ends[met.on], paths.ends[met.of]
    gate, fresnel = np.array(context.gate), KAPPA * context.spec.wavelength_m
    pieces, owner = grown(512, (2, 3), lambda out, of: string.cut_wires(
        starts, ends, radars, gate, fresnel, REACH, out, of))  # fmt: skip
    middle = pieces.mean(1)
    free = reached(parts, planar, paths, met.of[owner], middle).free
    if not free.any():
        return []
    wires = string.WirePieces(pieces, owner, lines.radii[met.on], _series(context, met))
    images = paths.antennas(context.antennas(antennas), met.of)

    def put(between: Transmission, sums: EchoSums) -> None:
        string.accumulate_wires(wires, between, images, context.pulse_grid, sums)

    between = Transmission(free.astype(complex), np.zeros(len(pieces)))
    echoes = echo_set(put, between, grids, lines.object_ids[met.on[owner]], middle)
    return [paths.with_paths(echoes, met.of[owner])]


def _met(
    context: RadarContext, planar: PlanarPatches, antennas: AntennaPair, paths: PathSet, starts: Floats, ends: Floats
) -> Strung:
    """Wires that ways meet within the gate where their paths are shortest."""
    size = len(paths) * len(starts)
    met = kernel.WireMeetings(np.empty(size, np.int64), np.empty(size, np.int64), np.empty((size, 2), complex),
                              np.empty(size))  # fmt: skip
    scratch = kernel.FieldScratch(np.empty((5, 4, 3)), np.empty((2, 3), complex))
    count = kernel.meet_wires(np.stack([starts, ends]), paths.over_mirrors, context.gate[1], antennas.fields,
                              context.mirrors(planar), flat_faces(planar), met, scratch)  # fmt: skip
    return Strung(met.of[:count], met.on[:count], met.waves[:count], met.turns[:count])


def _series(context: RadarContext, met: Strung) -> Complexes:
    """Series (m, 2, sines) of wires as the receiver's polarisation takes them: both rows alike."""
    modes, kinds = context.lines.modes, context.lines.kinds[met.on]
    orders = np.cos(met.turns[:, None] * np.arange(modes.shape[2]))
    share = (met.waves[:, :, None] * orders[:, None]).reshape(len(kinds), -1)
    out = np.empty((len(kinds), 2, modes.shape[3]), complex)
    for kind in np.unique(kinds):
        mine = kinds == kind
        # no product of matrices: for so little its library wakes threads that take longer
        out[mine] = np.einsum("kn,ns->ks", share[mine], modes[kind].reshape(-1, modes.shape[3]))[:, None]
    return out
