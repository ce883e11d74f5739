"""Walls beyond the frame: their echoes return after the next pulse has left, and appear at its start.

A radar that repeats every T sees an echo of delay tau at tau modulo T. Everything within the frame's own ranges is
computed; of what lies beyond, over `FOLDS` more pulse intervals, only flat faces that mirror the radar to itself. Their
echoes fall as 1 / R, those of all else as 1 / R^2 or faster.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ullage.errors import UllageWarning
from ullage.geometry import C0
from ullage.kernels import outlines as kernel
from ullage.radar.facets import PlanarPatches
from ullage.specs import RadarSpec

if TYPE_CHECKING:
    from ullage.radar.context import AntennaPair

FOLDS = 2
"""Pulse intervals beyond the frame from which walls fold back."""


def limits_of(planar: PlanarPatches, antennas: AntennaPair, gate_m: float, fold_s: float) -> NDArray[np.float64]:
    """Compute how far the echoes of each face (p) are followed [m]: to the gate, or to the folds for a mirror.

    Faces that mirror have planes at the ranges of the folds, and the radar's specular point on or near them.
    """
    far_m = gate_m + FOLDS * fold_s * C0 / 2
    origin = (antennas.origins[0] + antennas.origins[1]) / 2
    limits = np.empty(len(planar))
    kernel.limits(planar.normals, planar.offsets, planar.spheres, origin, gate_m, far_m, limits)
    return limits


def warn_of_folding(spec: RadarSpec) -> None:
    """Warn where a frame is longer than the pulse interval: its far bins repeat its near ones."""
    end, fold = spec.range_start_m + spec.bins * spec.bin_m, spec.unambiguous_range_m
    if end > fold:
        warnings.warn(f"{spec.name}: the frame ends at {end:.3g} m, echoes fold at {fold:.3g} m; what lies nearer "
                      "appears again beyond (a larger prf_div puts the fold farther away)", UllageWarning,
                      stacklevel=3)  # fmt: skip
