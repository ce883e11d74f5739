"""What spreading becomes nearer than a wave, where Friis' law would hand back more than was sent.

Over a path P a wave comes back as lambda / (4 pi P) [Friis1946]: more than 1 below P = lambda / (4 pi), where the field
is the reactive one of the antenna itself [Schantz2005]. No passive thing returns more than it takes, so 1 / P becomes
1 / (P^4 + (lambda / 4 pi)^4)^(1/4): at most 1, 5e-6 dB from the law a wave before a mirror. Delays stay what they are.
"""

from __future__ import annotations

import math

from ullage.kernels.loops import core

LEAST_M = 1e-6  # a radar nearer to a plane counts as so near: the plane's own points have no image apart from them
TOUCH_M = 1e-3  # small triangles so near are integrated as if they were so far off: in touch they fill half of space


@core(fastmath=True, error_model="numpy")
def eased(wave: float, path: float) -> float:
    """What is left of 1 / path, as a factor, for a wave number."""
    x = 2 * wave * path
    if x > 30:
        return 1.0  # to 3e-7
    x = x * x
    x = x * x
    return (x / (1 + x)) ** 0.25


@core(fastmath=True, error_model="numpy")
def spread(wave: float, path: float) -> float:
    """What stands for 1 / path, at any path, 0 among them."""
    least = 0.5 / wave
    if path > 15 / wave:
        return 1 / path
    x, y = path * path, least * least
    return (x * x + y * y) ** -0.25


@core(fastmath=True, error_model="numpy")
def lifted(r: float, cosine: float) -> tuple[float, float]:
    """Range and cosine of a point of a face at range r for a radar kept `TOUCH_M` off the face where that is near."""
    share = 1 - (0.1 * r / TOUCH_M) ** 2
    if share <= 0:
        return r, cosine
    gap, least = r * cosine, share * TOUCH_M
    if abs(gap) >= least:
        return r, cosine
    far = math.sqrt(max(r * r - gap * gap, 0.0) + least * least)
    return far, (least if gap >= 0 else -least) / far


@core(error_model="numpy")
def height(ahead: float, behind: float) -> float:
    """Compute how far (at least `LEAST_M`) and on which side of a plane an antenna is, given both antennas."""
    if abs(ahead) >= LEAST_M:
        return ahead
    if abs(behind) >= LEAST_M:
        return LEAST_M if behind > 0 else -LEAST_M
    return LEAST_M
