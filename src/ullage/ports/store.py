"""Recordings at rest in zarr: whole arrays, quick to slice, read by xarray and friends; the extra `ullage[zarr]`."""

from __future__ import annotations

import itertools
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ullage.data import Calibration, Frames, sensors_of
from ullage.errors import InputError, need
from ullage.files import writing
from ullage.flow import Sink
from ullage.grids import Grid, OccupancyMap
from ullage.ports import conversions
from ullage.ports.protocol import Item, Recording, of_one_kind
from ullage.untrusted import FREE_BYTES, check_unpacked

ROWS = 256  # frames in a chunk
PATHS = ("poses", "truth")
"""Columns with NaN where a frame has none."""


class ZarrSink(Sink):
    """Writes a store under a temporary name; `close` puts it in place.

    Args:
        path: the `.zarr` folder.
        overwrite: replace a store that is there already.

    Raises:
        InputError: it exists already, or cannot be written.
    """

    gathers = True

    def __init__(self, path: str | Path, *, overwrite: bool = False) -> None:
        zarr: Any = need("zarr", extra="zarr")
        self.path = Path(path)
        if self.path.exists() and not overwrite:
            raise InputError("exists already", where=self.path, allowed="a new name, or overwrite=True")
        self._folder = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        with writing(self.path):
            shutil.rmtree(self._folder, ignore_errors=True)
            self._root: Any = zarr.create_group(str(self._folder), attributes={"format": "ullage frames 1"})
        self._waiting: dict[str, list[Frames]] = {}
        self._open = True

    def write(self, item: Item) -> None:
        """Take frames, or a map (the last one stays); everything else passes by.

        Raises:
            InputError: the store is closed, or the disk is full.
        """
        if not self._open:
            raise InputError("the store is closed", where=self.path)
        if isinstance(item, OccupancyMap):
            self._write_map(item)
        elif isinstance(item, Frames | Mapping):
            for frames in sensors_of(item):
                parts = self._waiting.setdefault(frames.sensor, [])
                parts.append(frames)
                if sum(map(len, parts)) >= ROWS:
                    self._store(frames.sensor)

    def _store(self, sensor: str) -> None:
        for piece in of_one_kind({sensor: self._waiting.pop(sensor)}):
            frames = piece[sensor]
            columns: dict[str, Any] = {"samples": frames.samples, "t_ns": frames.t_ns}
            for name, path in (("poses", frames.poses), ("truth", frames.truth)):
                if path is not None:
                    columns[name] = conversions.state_columns(path)
            with writing(self.path):
                if sensor not in self._root:
                    self._begin(frames)
                self._append(self._root[sensor], columns)

    def _append(self, group: Any, columns: dict[str, Any]) -> None:
        """Append rows; frames without a pose have NaN there once another one has some."""
        before, count = group["t_ns"].shape[0] if "t_ns" in group else 0, len(columns["t_ns"])
        for name, values in columns.items():
            if name not in group:
                self._column(group, name, values)
                if before:
                    group[name].append(np.full((before, *values.shape[1:]), np.nan))
            group[name].append(values)
        for name in PATHS:
            if name in group and name not in columns:
                group[name].append(np.full((count, *group[name].shape[1:]), np.nan))

    def _column(self, group: Any, name: str, values: Any) -> None:
        """Begin a column with rows like these."""
        shape, rows = (0, *values.shape[1:]), (ROWS, *values.shape[1:])
        dims = ("t_ns", {"samples": "range_m"}.get(name, "state"))[: values.ndim]
        group.create_array(name, shape=shape, chunks=rows, dtype=values.dtype, dimension_names=dims)

    def _begin(self, frames: Frames) -> None:
        about = {
            "unit": frames.unit, "spec": frames.spec.model_dump_json(),
            "calibration": None if frames.calibration is None else asdict(frames.calibration),
        }  # fmt: skip
        group = self._root.create_group(frames.sensor, attributes=about)
        group.create_array("range_m", data=frames.range_m, dimension_names=("range_m",))
        if frames.track is not None:
            group.create_array("track_t_ns", data=frames.track.t_ns)
            group.create_array("track", data=conversions.state_columns(frames.track))

    def _write_map(self, omap: OccupancyMap) -> None:
        origin = [None if np.isnan(v) else v for v in omap.grid.origin_m]
        about = {"origin_m": origin, "step_m": omap.grid.step_m, "method": omap.method,
                 "occupied_from": omap.occupied_from, "free_to": omap.free_to}  # fmt: skip
        self._root.create_group("map", attributes=about, overwrite=True).create_array("percent", data=omap.percent)

    def close(self) -> None:
        """Write what waits and put the store in place."""
        if not self._open:
            return
        for sensor in list(self._waiting):
            self._store(sensor)
        self._open = False
        with writing(self.path):
            if self.path.exists():
                shutil.rmtree(self.path)
            self._folder.rename(self.path)


class ZarrSource(Recording):
    """Reads a store; streaming reads only the rows it hands out.

    Args:
        path: the `.zarr` folder.

    Raises:
        InputError: it is no store of ullage's.
    """

    def __init__(self, path: str | Path) -> None:
        zarr: Any = need("zarr", extra="zarr")
        super().__init__(path)
        try:
            self._root: Any = zarr.open_group(str(self.path), mode="r", zarr_format=3)
            known = str(self._root.attrs.get("format", "")).startswith("ullage frames")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"no zarr store: {error}", where=self.path) from None
        if not known:
            raise InputError("not a store of ullage's", where=self.path, allowed="what ul.sink('name.zarr') wrote")

    def _names(self) -> Iterator[str]:
        return (name for name in sorted(self._root.group_keys()) if name != "map")

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """The same in pieces of at most `chunk` frames of each sensor, in order of time."""
        sizes = {name: self._root[name]["t_ns"].shape[0] for name in self.sensors}
        for start in range(0, max(sizes.values(), default=0), chunk):
            yield from of_one_kind(
                {name: self._cut(name, start, start + chunk) for name, size in sizes.items() if start < size}
            )

    def _array(self, group: Any, name: str) -> Any:
        """An array, refused where its description promises far more than the files hold."""
        array = group[name]
        if array.nbytes > FREE_BYTES:
            stored = sum(path.stat().st_size for path in (self.path / array.path).rglob("*") if path.is_file())
            check_unpacked(array.nbytes, stored, what=name, where=self.path)
        return array

    def _cut(self, name: str, start: int, stop: int) -> Iterator[Frames]:
        """Give the frames of some rows, those with poses and those without apart."""
        try:
            group, rows = self._root[name], slice(start, stop)
            t_ns, samples = self._array(group, "t_ns")[rows], self._array(group, "samples")[rows]
            states = {key: self._array(group, key)[rows] for key in PATHS if key in group}
            track, about = None, group.attrs["calibration"]
            if "track" in group:
                track = conversions.path_of(self._array(group, "track_t_ns")[:], self._array(group, "track")[:])
            range_m, spec = self._array(group, "range_m")[:], conversions.spec_of(json.loads(group.attrs["spec"]), name)
            known = [np.isfinite(one).all(1) for one in states.values()]
            changes = np.flatnonzero(np.diff(known, axis=1).any(0)) + 1 if known else np.zeros(0, int)
            for some in itertools.starmap(slice, itertools.pairwise([0, *changes.tolist(), len(t_ns)])):
                paths = {
                    key: conversions.path_of(t_ns[some], one[some])
                    for (key, one), finite in zip(states.items(), known, strict=True) if finite[some].all()
                }  # fmt: skip
                yield Frames(
                    samples[some], range_m, t_ns[some], spec, paths.get("poses"), paths.get("truth"), name,
                    group.attrs["unit"], track, None if about is None else Calibration(**about),
                )  # fmt: skip
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            raise InputError(f"damaged: {error}", where=self.path) from None

    def map(self) -> OccupancyMap | None:
        """The map, where there is one."""
        if "map" not in self._root:
            return None
        group = self._root["map"]
        about, percent = group.attrs, self._array(group, "percent")[...]
        x, y, z = (np.nan if v is None else v for v in about["origin_m"])
        grid = Grid((x, y, z), about["step_m"], percent.shape)
        return OccupancyMap(grid, percent, about["method"], about["occupied_from"], about["free_to"])
