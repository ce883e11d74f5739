"""On a plane, which echoes may have come from a flat wall one unambiguous range farther off.

Such a wall fits every range and bearing of the track alike, so only what else is known can tell: the room there is for
it, how loud its echo could be, and what stands before it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ullage.processing.blocks import Blocks
from ullage.processing.mapper_looks import Look, lit_ways
from ullage.processing.mapper_rims import lobe_loss

Floats = NDArray[np.float64]

TOO_LOUD = 2.0  # times the usual: no wall mirrors so well
BESIDE_M = 1.0  # what stands so near before a wall belongs to it
OWN_CELLS = 3.0  # beyond its own range that an echo's own cells may lie
ACROSS = (0.0, -0.5, 0.5, -1.0, 1.0)  # rays to parts of the first Fresnel zone, in its half widths


def may_be_folded(
    look: Look, cosine: Floats, blocks: Blocks, *, least: float, half_rad: float, wave_m: float, fold_m: float,
    usual: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """Which echoes (k) may as well be those of a wall farther off by `fold_m`.

    It is none where it would lie off the grid, nor where its echo, which falls as one over its range, is too loud for
    it. Nor where the map holds something before it, but that must cover its first Fresnel zone: a mirror echo passes
    beside what is thinner. What the map holds at the echo's own range is no witness: it may be there by such echoes.

    Args:
        look: with k echoes.
        cosine: of each to the track (k).
        blocks: what the map holds.
        least: cosine to boresight in which echoes are looked for.
        half_rad: angle from boresight at which the antenna has fallen by 3 dB one way [rad].
        wave_m: wavelength of the carrier [m].
        fold_m: range at which echoes fold [m].
        usual: strength, range times height, of the strongest echoes lately heard.
    """
    eye = look.heard.position
    out = np.zeros(len(look.echoes), bool)
    for k, (reach, height) in enumerate(look.echoes[:, [0, 5]]):
        for way in lit_ways(look.heard.axes, look.track, float(np.clip(cosine[k], -1, 1)), least):
            far = reach + fold_m
            _, inside = blocks.grid.index(eye + far * way)
            lobe = float(lobe_loss(float(way @ look.heard.axes[:, 0]), half_rad))
            if inside[0] and height * lobe * far < TOO_LOUD * usual:
                out[k] |= _in_sight(blocks, eye, way, float(reach), float(far), wave_m)
    return out


def _in_sight(blocks: Blocks, eye: Floats, way: Floats, reach: float, far: float, wave_m: float) -> bool:
    """Whether the map leaves open some part of the Fresnel zone of a wall at `far`, echoes at `reach` left aside."""
    step, across = blocks.grid.step_m, np.array([-way[1], way[0], 0.0])
    slope = math.sqrt(wave_m / (2 * far))  # half the zone's width over its range
    for part in ACROSS:
        ray = (way + part * slope * across) / math.hypot(1.0, part * slope)
        beyond = reach + OWN_CELLS * step
        if blocks.clear_to(eye, ray, reach - step) and blocks.clear_to(
            eye + beyond * ray, ray, far - BESIDE_M - beyond
        ):
            return True
    return False
