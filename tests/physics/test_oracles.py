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


def test_a_broken_bound_is_told():
    row = page.Row("x", -60.0, -59.0, 0.3)
    assert not row.passed
    assert "**no**" in page.page_text([row], [])
    assert page.Row("x", -60.0, -59.8, 0.3).passed
    assert not page.Row("x", -60.0, np.nan, 0.3).passed
