"""Every oracle of the validation page holds, and the page says when one does not."""

import numpy as np
import pytest

from studies.validation import validate as page


@pytest.mark.parametrize("oracle", page.ORACLES, ids=lambda o: o.__name__)
def test_oracle(oracle):
    rows = list(oracle())
    assert rows
    broken = [f"{r.oracle}: {r.ours:.3f} against {r.reference:.3f}" for r in rows if not r.passed]
    assert not broken


def assert_alike(ours, want):
    """Level and phase of two pulses, at the highest sample."""
    best = abs(want).argmax()
    assert page.db(ours[best] / want[best]) == pytest.approx(0, abs=0.2)
    assert abs(np.angle(ours[best] / want[best])) < 0.06


@pytest.mark.parametrize(
    ("place", "bounces"), [((0.0, 0.0, 0.8), 2), ((0.4, 0.1, 0.8), 2), ((1.1, 0.0, 1.2), 2), ((0.0, 0.0, 0.8), 3)]
)
def test_waves_from_wall_to_wall_of_a_tank_are_physical_optics_iterated_over_it(place, bounces):
    """On the axis, where all of the wall focuses; where the far wall has the image of the radar on it; at the wall."""
    assert_alike(*page.tank_wall_to_wall(1.2, 2.0, place, bounces))


@pytest.mark.parametrize(
    ("drum", "place", "reach", "twice"),
    [
        ((0.75, 0.0, 0.2), (0.1, -0.4), 1.91, False),
        ((-0.4, 0.1, 0.15), (0.5, 0.3), 1.37, False),
        ((0.75, 0.0, 0.2), (0.1, -0.4), 2.34, True),
    ],
)
def test_waves_over_a_wall_and_a_drum_are_the_drums_exact_series_and_the_walls_integral(drum, place, reach, twice):
    """As pulses, where the drum turns the wave with a cosine of 0.84 or more."""
    assert_alike(*page.tank_and_drum_pulses(drum, place, reach, twice=twice))


def test_a_broken_bound_is_told():
    row = page.Row("x", -60.0, -59.0, 0.3)
    assert not row.passed
    assert "**no**" in page.page_text([row], [])
    assert page.Row("x", -60.0, -59.8, 0.3).passed
    assert not page.Row("x", -60.0, np.nan, 0.3).passed
