"""The rows of `ullage validate` on meshes: curved surfaces, slivers and turned worlds keep their bounds."""

from __future__ import annotations

import pytest

from studies.validation.meshes import curved_meshes, slivers, turned_worlds
from studies.validation.validate import ORACLES


def test_the_page_has_the_rows_on_meshes():
    assert {curved_meshes, slivers, turned_worlds} <= set(ORACLES)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [curved_meshes, slivers, turned_worlds])
def test_meshes_keep_their_bounds(rows):
    found = list(rows())
    assert found
    assert not [row for row in found if not row.passed]
