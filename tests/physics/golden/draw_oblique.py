"""Draws docs/pictures/oblique.png: `python tests/physics/golden/draw_oblique.py` (ten seconds)."""

# ruff: noqa: E402 - the comparison lies one folder up

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
import moments
import oblique
from full_wave import db
from fullwave_figure import draw_fullwave


def panel(azimuth_deg):
    """Both fields of a plate of two wavelengths against the angle off its normal."""
    size = 2 * oblique.WAVE_M
    theta, _, places, axes = oblique.views(np.arange(0, 81, 2.5), (azimuth_deg,))
    own = db(oblique.ours(moments.plate(size, 1.0), places, axes, 1))
    truth = db(oblique.truth(moments.plate(size, oblique.WAVE_M / 8), places, axes))
    curves = {f"{name} field": (theta, truth[i], own[i]) for i, name in enumerate(oblique.FIELDS)}
    return "angle off the normal [deg]", "path gain at 7.29 GHz, 1 m [dB]", curves


if __name__ == "__main__":
    draw_fullwave(HERE.parents[2] / "docs/pictures/oblique.png", {
        "principal plane": panel(0), "azimuth 22.5 deg": panel(22.5), "azimuth 45 deg, over the corner": panel(45),
    }, "moments")  # fmt: skip
