"""Every kind of recording comes in as the same type."""

from pathlib import Path

import numpy as np
import pytest

import ullage as ul

DATA = Path(__file__).parents[3] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the real recordings are not here")


@needs_data
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_rail_decodes_to_the_last_sample() -> None:
    source = ul.open(DATA / "pulson440/rail_a")
    frames = source.frames()
    known = np.load(DATA / "pulson440/rail_a/decoded.npz")
    np.testing.assert_array_equal(frames.samples, known["scans"].astype(np.float32))
    np.testing.assert_allclose(frames.range_m, known["range_m"], atol=1e-12)
    np.testing.assert_allclose(frames.t_ns * 1e-9, known["t_radar_s"], atol=1e-9)
