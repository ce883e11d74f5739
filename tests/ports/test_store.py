"""Stores of zarr: whole or not at all. `test_bag` has their round trips."""

from __future__ import annotations

from pathlib import Path

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
