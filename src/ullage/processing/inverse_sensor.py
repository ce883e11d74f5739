"""Level of a flat wall's echo."""

from __future__ import annotations

import numpy as np

from ullage.data import Frames


def mirror_m(frames: Frames) -> float:
    """Amplitude times range of a perfect mirror before an antenna of 0 dBi [m]; infinite where the unit hides it.

    An image: lambda / (8 pi R). Only frames in units of path gain have it.
    """
    return float(frames.spec.wavelength_m / (8 * np.pi)) if frames.unit == "path_gain" else float(np.inf)
