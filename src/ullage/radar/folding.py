"""Walls beyond the frame: their echoes return after the next pulse has left, and appear at its start.

A radar that repeats every T sees an echo of delay tau at tau modulo T. Everything within the frame's own ranges is
computed; of what lies beyond, over `FOLDS` more pulse intervals, only flat faces that mirror the radar to itself. Their
echoes fall as 1 / R, those of all else as 1 / R^2 or faster.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ullage.errors import UllageWarning
from ullage.geometry import C0
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.flats import lay_flats
from ullage.radar.physical import Bench, Laid, View
from ullage.specs import RadarSpec

FOLDS = 2
"""Pulse intervals beyond the frame from which walls fold back."""


def lay_folded(ready: Bench, parts: list[Surfaces], view: View, grids: NDArray[np.complex128]) -> Iterator[Laid]:
    """Adds the echoes of walls beyond the gate at one pose to the delay grids."""
    gate = (ready.gate[1], ready.gate[1] + FOLDS * ready.fold_s * C0 / 2)
    beyond = replace(ready, gate=gate)
    for part in parts:
        which = _mirrors(part.flats, view, gate)
        if len(which):
            yield from lay_flats(beyond, parts, part, view, grids, which)


def _mirrors(flats: Flats, view: View, gate: tuple[float, float]) -> NDArray[np.int64]:
    """Faces whose plane lies at these ranges, with the foot of its perpendicular near them."""
    origin = view.origins.mean(0)
    gap = flats.normals @ origin - flats.offsets
    far = np.flatnonzero((abs(gap) > gate[0] - 0.5) & (abs(gap) < gate[1]))
    foot = origin - gap[far, None] * flats.normals[far]
    beside = ((foot - flats.spheres[far, :3]) ** 2).sum(1) < (flats.spheres[far, 3] + 0.5) ** 2
    return np.asarray(far[beside], np.int64)


def warn_of_folding(spec: RadarSpec) -> None:
    """Warn where a frame is longer than the pulse interval: its far bins repeat its near ones."""
    end, fold = spec.range_start_m + spec.bins * spec.bin_m, spec.unambiguous_range_m
    if end > fold:
        warnings.warn(f"{spec.name}: the frame ends at {end:.3g} m, echoes fold at {fold:.3g} m; what lies nearer "
                      "appears again beyond (a larger prf_div puts the fold farther away)", UllageWarning,
                      stacklevel=3)  # fmt: skip
