"""Scatterers that were drawn at a wrong clock favour it: they are drawn at several."""

from __future__ import annotations

from dataclasses import replace

import pytest

from studies.tables.calibrate_offsets import recording
from ullage.processing.calibrate import _focus, _Prior


@pytest.mark.slow
def test_a_clock_that_motion_misleads_by_60_ms_is_found_by_focus() -> None:
    frames, clock_s, _ = recording(9, "wander", "one")
    assert frames.track is not None
    prior = replace(_Prior.of(None, frames, 1.0), lever_sigma_m=0.05)
    found = _focus(frames, frames.track, clock_s - 0.06, prior, None)
    assert abs(found.mean[0] - clock_s) < 3 * found.sigma[0] < 0.003
