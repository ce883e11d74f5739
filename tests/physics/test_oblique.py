"""Small conductors at oblique aspects against the method of moments: bounds near what docs/fullwave.md states."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import oblique

# median error in and off the principal planes by band [dB]; greatest error, as part of the strongest echo [dB]
BOUNDS = {
    "plate 2": ((0.4, 0.8, 1.6, 1.2), (0.4, 2.2, 4.2, 6.2), -24),
    "plate 3": ((0.3, 0.5, 1.0, 1.5), (0.3, 1.7, 3.5, 4.5), -29),
    "rectangle": ((0.4, 0.8, 0.8, 2.0), (0.4, 2.6, 4.0, 3.6), -24),
    "box": ((0.8, 1.0, 1.0, 1.0), (0.8, 3.5, 5.6, 5.0), -16),
    "dihedral 2": ((1.6, 0.7, 7.5, 1.5), (1.9, 3.3, 3.5, 8.4), -7),
    "dihedral": ((0.9, 1.2, 2.4, 2.0), (0.8, 2.6, 2.3, 4.4), -8),
}


def assert_within_bounds(shape, per_wave):
    inside, outside, part_db = BOUNDS[shape]
    found = list(oblique.rows(shape, per_wave))
    medians = np.array([row[3] for row in found]).reshape(-1, 2)
    assert (medians[:, 0] < inside).all(), medians
    assert (medians[:, 1] < outside).all(), medians
    assert max(row[5] for row in found) < part_db


def test_small_plate():
    assert_within_bounds("plate 2", 6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "per_wave"),
    [("plate 2", 8), ("plate 3", 8), ("rectangle", 8), ("box", 8), ("dihedral 2", 6), ("dihedral", 6)],
)
def test_small_bodies(shape, per_wave):
    assert_within_bounds(shape, per_wave)


@pytest.mark.parametrize("field", [0, 1])
def test_no_jumps_off_the_principal_planes(field):
    """Neither where a wave comes to pass a corner, nor where a path over an edge between two others begins."""
    size = 2 * oblique.WAVE_M
    for theta in (40, 60):
        _, _, places, axes = oblique.views((theta,), np.arange(-2, 50, 0.25))
        echo = oblique.ours(oblique.moments.plate(size, 1.0), places, axes, 1)[field]
        assert abs(np.diff(echo, 2)).max() < 0.01 * abs(echo).max(), theta
