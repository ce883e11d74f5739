"""Stores of zarr: whole or not at all. `test_bag` has their round trips."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from conftest import some_frames

pytest.importorskip("zarr")


def test_store_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    sink = ul.sink(tmp_path / "a.zarr")
    sink.write(some_frames(300))
    assert not (tmp_path / "a.zarr").exists()
    sink.close()
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    ul.sink(tmp_path / "a.zarr", overwrite=True).close()
    with pytest.raises(ul.InputError, match="no radar frames"):
        ul.open(tmp_path / "a.zarr").frames()


def test_what_is_no_store_is_refused(tmp_path: Path) -> None:
    import zarr

    (tmp_path / "a.zarr").mkdir()
    with pytest.raises(ul.InputError, match="no zarr store"):
        ul.open(tmp_path / "a.zarr")
    zarr.create_group(str(tmp_path / "b.zarr"))
    with pytest.raises(ul.InputError, match="not a store of ullage's"):
        ul.open(tmp_path / "b.zarr")
    with ul.sink(tmp_path / "c.zarr") as sink:
        sink.write(some_frames(9))
    (tmp_path / "c.zarr" / "front" / "t_ns" / "zarr.json").unlink()
    with pytest.raises(ul.InputError, match="damaged"):
        ul.open(tmp_path / "c.zarr").frames()


def test_poses_that_come_and_go_stay_with_their_frames(tmp_path: Path) -> None:
    """A live source of poses may pause: each frame keeps its own pose, or none."""
    whole = replace(some_frames(40), truth=None)
    parts = [whole[a:b] for a, b in ((0, 5), (5, 20), (20, 28), (28, 40))]
    given = [replace(part, poses=None) if number % 2 == 0 else part for number, part in enumerate(parts)]
    for name in ("all.zarr", "all.mcap"):
        with ul.sink(tmp_path / name) as sink:
            for part in given:
                sink.write({"front": part})
        found = [piece["front"] for piece in ul.open(tmp_path / name).stream(16)]
        assert sum(map(len, found)) == 40
        for part in found:
            rows = np.searchsorted(whole.t_ns, part.t_ns)
            assert np.array_equal(part.samples, whole.samples[rows])
            outside = ((rows < 5) | ((rows >= 20) & (rows < 28))).all()
            assert (part.poses is None) == outside
            if part.poses is not None:
                assert np.array_equal(part.poses.position, whole.believed.position[rows])
