"""Recordings at rest: the same bits back, whole and in pieces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import assert_same, some_frames, tumbling

import ullage as ul
from ullage.data import Calibration, joined

pytest.importorskip("zarr")


@pytest.mark.parametrize("real", [True, False])
def test_same_bits_back(tmp_path: Path, real: bool) -> None:
    track = tumbling(np.arange(0, 10**9, 10**7), np.random.default_rng(3))
    want = {name: some_frames(300, sensor=name, real=real, seed=k) for k, name in enumerate(("front", "left"))}
    want["left"] = replace(want["left"], truth=None, track=track, calibration=Calibration(1, 2, 3, 4, 5, "focus"))
    with ul.sink(tmp_path / "a.zarr") as sink:
        for at in range(0, 300, 70):
            sink.write({name: frames[at : at + 70] for name, frames in want.items()})
    source = ul.open(tmp_path / "a.zarr")
    assert source.sensors == ("front", "left")
    got = source.frames()
    parts = list(source.stream(128))
    for name, frames in want.items():
        assert_same(got[name], frames)
        assert_same(joined([part[name] for part in parts]), frames)


def test_map_comes_back(tmp_path: Path) -> None:
    omap = ul.OccupancyMap(
        ul.Grid((0, 0, float("nan")), 0.1, (3, 4)), np.arange(-2, 10, dtype=np.int8).reshape(3, 4), "m", 70, 20
    )
    with ul.sink(tmp_path / "a.zarr") as sink:
        sink.write(some_frames(3))
        sink.write(omap)
    got = ul.open(tmp_path / "a.zarr").map()
    assert got is not None
    np.testing.assert_array_equal(got.percent, omap.percent)
    assert (got.method, got.occupied_from, got.free_to, got.grid.step_m) == ("m", 70, 20, 0.1)


def test_store_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    sink = ul.sink(tmp_path / "a.zarr")
    sink.write(some_frames(300))
    assert not (tmp_path / "a.zarr").exists()
    sink.close()
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    with pytest.raises(ul.InputError, match="closed"):
        sink.write(some_frames(3))
    with pytest.raises(ul.InputError, match="exists already"):
        ul.sink(tmp_path / "a.zarr")
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
