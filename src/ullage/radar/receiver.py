"""What the receiver makes of clean echoes."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ullage.data import Samples
from ullage.radar.rays import smoothed
from ullage.specs import RadarSpec

Floats = NDArray[np.float64]


def stream(seed: int, component: int, frame: int) -> np.random.Generator:
    """The random numbers of one component of one frame, the same however the frames are cut."""
    return np.random.Generator(np.random.Philox(key=[seed, component], counter=[0, 0, 0, frame]))


def receive(
    clean: NDArray[Any],
    spec: RadarSpec,
    *,
    seed: int,
    first_frame: int = 0,
    fidelity: Literal["physical", "thesis"] = "physical",
) -> Samples:
    """Clean echoes (n, b) as the receiver gives them."""
    if spec.noise is None:
        return clean
    if fidelity == "thesis":
        return receive_thesis(clean, spec, seed=seed, first_frame=first_frame)
    return clean


def receive_thesis(clean: NDArray[Any], spec: RadarSpec, *, seed: int, first_frame: int = 0) -> NDArray[np.float32]:
    """White noise on each bin, then the moving average that the clean profile already had."""
    noise = np.stack([stream(seed, 0, first_frame + i).standard_normal(spec.bins) for i in range(len(clean))])
    return np.asarray(clean + smoothed(spec.thesis.noise_sigma * noise, spec), np.float32)
