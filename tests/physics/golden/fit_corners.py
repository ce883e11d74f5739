"""How much a coefficient of each corner would help: fitted to seven squares, tried on two other plates.

What the method of moments has beyond the physical radar is fitted by one strength of each corner, per aspect and field.
`python tests/physics/golden/fit_corners.py` prints median errors without and with it (two minutes).
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import moments
import oblique
from full_wave import db

WAVE_M = oblique.WAVE_M
SQUARES = np.linspace(1.3, 2.5, 7) * WAVE_M
OTHERS = ((2.7, 2.0), (3.0, 3.0))
VIEWS = oblique.views(np.arange(10, 80, 5), (7.5, 15, 22.5, 30, 37.5, 45))
BANDS_DEG = ((10, 25), (30, 45), (50, 60), (65, 75))


def rectangle(width_m, height_m, edges_m):
    return moments.grid(edges_m, (0, -width_m / 2, -height_m / 2), (0, width_m, 0), (0, 0, height_m))


def both(width_m, height_m):
    """Path gains (2, v) of one plate: ours, and the method of moments."""
    _, _, places, axes = VIEWS
    own = oblique.ours(rectangle(width_m, height_m, 1.0), places, axes, 1)
    return own, oblique.truth(rectangle(width_m, height_m, WAVE_M / 8), places, axes)


def phases(width_m, height_m):
    """Echoes (4, v) of unit points at the corners."""
    corners = [(0, y * width_m / 2, z * height_m / 2) for y in (-1, 1) for z in (-1, 1)]
    ranges = np.linalg.norm(VIEWS[2] - np.array(corners)[:, None], axis=2)
    return np.exp(-4j * np.pi * ranges / WAVE_M)


def strengths():
    """Strength (2, 4, v) of each corner for both fields."""
    missing = np.array([np.subtract(*both(size, size)[::-1]) for size in SQUARES])
    waves = np.array([phases(size, size) for size in SQUARES])
    return np.array([np.stack([np.linalg.lstsq(waves[:, :, v], missing[:, field, v], rcond=0.05)[0]
                               for v in range(waves.shape[2])], 1) for field in range(2)])  # fmt: skip


def main():
    fitted, theta = strengths(), VIEWS[0]
    for width, height in OTHERS:
        own, truth = both(width * WAVE_M, height * WAVE_M)
        better = own + (fitted * phases(width * WAVE_M, height * WAVE_M)).sum(1)
        for field, name in enumerate(oblique.FIELDS):
            for low, high in BANDS_DEG:
                held = (theta >= low) & (theta <= high)
                without, with_ = (np.median(abs(db(x[field]) - db(truth[field]))[held]) for x in (own, better))
                print(f"| {width} x {height} | {name} | {low} to {high} | {without:.1f} | {with_:.1f} |", flush=True)


if __name__ == "__main__":
    main()
