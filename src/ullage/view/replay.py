"""Data of a replay in the report and the moving picture: world, flight, profiles, maps, image, explained frames.

All of it is one JSON file, compressed, beside the run's other files: `replay.json.gz`. Arrays are little-endian numbers
in base64, `{"type": "f4", "shape": [n, 3], "data": "..."}`. Positions are in metres and in the world frame, times in
seconds from the first frame.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.flow import Sink
from ullage.grids import AMBIGUOUS, UNKNOWN, Grid, Image, OccupancyMap
from ullage.radar.explain import Contribution
from ullage.untrusted import reason
from ullage.view.viewer_scene import GREY, beam_deg, body_of, hull_objects, sensor_color, turned_inwards
from ullage.view.world_picture import CLEAR, COLORS
from ullage.world.scene import Scene

FILE = "replay.json.gz"
MOST_FACES = 300_000
"""Largest number of drawn triangles; a larger world is left out."""
MOST_POINTS = 3000
"""Largest number of points of surface that is not on the map."""
SPAN_DB = 60.0
"""Dynamic range of profiles below their highest level [dB]."""
IMAGE_DB = 30.0
"""Dynamic range of the image below its peak [dB]."""
UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL, AMBIGUOUS_CELL = range(4)


@dataclass(slots=True)
class MapHistory(Sink):
    """A sink that keeps at most `most` maps and `most_bytes` bytes of a run, evenly over time."""

    gathers: ClassVar[bool] = True
    most: int = 120
    most_bytes: int = 64_000_000
    _maps: list[tuple[float, OccupancyMap]] = field(default_factory=list)
    _stride: int = 1
    _seen: int = 0
    _now_ns: int = 0

    def write(self, item: Any) -> None:
        """Keep a map if it is due by the frames' times."""
        if isinstance(item, Mapping):
            self._now_ns = max([self._now_ns, *(int(part.t_ns[-1]) for part in item.values())])
        if not isinstance(item, OccupancyMap):
            return
        if self._seen % self._stride == 0:
            self._maps.append((self._now_ns * 1e-9, item))
        self._seen += 1
        while len(kept := self._maps) > 1 and (
            len(kept) > self.most or sum(one.nbytes for _, one in kept) > self.most_bytes
        ):
            self._maps, self._stride = kept[::2], 2 * self._stride

    def maps(self) -> list[tuple[float, OccupancyMap]]:
        """Each kept map with the time of the last frame in it [s]."""
        return list(self._maps)


@dataclass(frozen=True, slots=True)
class Explained:
    """The strongest echoes of one frame, with their causes."""

    sensor: str
    t_ns: int
    echoes: Sequence[Contribution]


@dataclass(frozen=True, slots=True)
class Parts:
    """Parts of a run to replay; all but the frames may be absent."""

    title: str
    frames: Mapping[str, Frames]
    scene: Scene | None = None
    maps: Sequence[tuple[float, OccupancyMap]] = ()  # with times [s], the last one is the final map
    image: Image | None = None
    explained: Sequence[Explained] = ()
    states: Mapping[str, str] = field(default_factory=dict)  # what the map shows of each object
    unmapped: Floats | None = None  # (k, 3) points of surface in sight that are not on the map [m]


def replay(parts: Parts) -> dict[str, Any]:
    """Return the contents of a replay as plain values.

    Raises:
        InputError: no frames have poses.
    """
    placed = {name: part for name, part in parts.frames.items() if part.poses is not None}
    if not placed:
        raise InputError("no frames with poses", where="replay")
    start_ns = min(int(part.t_ns[0]) for part in placed.values())
    first = next(iter(placed.values()))
    body = body_of(first) or first.believed
    height, unmapped = float(np.median(body.position[:, 2])), parts.unmapped
    if unmapped is not None:
        unmapped = unmapped[:: max(1, -(-len(unmapped) // MOST_POINTS))]  # evenly
    return {
        "title": parts.title,
        "bounds": _bounds(parts, body).tolist(),
        "world": None if parts.scene is None else world_tree(parts.scene, parts.states),
        "flight": path_tree(body, start_ns),
        "radars": [_radar(k, part, start_ns) for k, part in enumerate(placed.values())],
        "map": map_tree(parts.maps, start_ns, height) if parts.maps else None,
        "image": None if parts.image is None else _image(parts.image, height),
        "unmapped": None if unmapped is None else packed(unmapped, "f4"),
        "explained": [_explained(one, list(placed), start_ns) for one in parts.explained if one.sensor in placed],
    }


def _bounds(parts: Parts, body: Trajectory) -> Floats:
    """Return the box (2, 3) of world, flight and known cells [m]; a plane of cells adds nothing to its height."""
    boxes = [body.position]
    if parts.scene is not None:
        boxes.append(parts.scene.bounds)
    elif parts.maps and len(known := np.argwhere(cell_states(parts.maps[-1][1]).reshape(parts.maps[-1][1].grid.shape))):
        grid = parts.maps[-1][1].grid
        box = np.tile(body.position.mean(axis=0), (2, 1))
        ends = np.stack([known.min(axis=0), known.max(axis=0) + 1])[:, ::-1] * grid.step_m
        box[:, : grid.dims] = np.asarray(grid.origin_m)[: grid.dims] + ends
        boxes.append(box)
    cloud = np.concatenate(boxes)
    return np.stack([cloud.min(axis=0), cloud.max(axis=0)])


def write_replay(folder: Path, parts: Parts) -> Path:
    """Write `replay.json.gz` into a run folder.

    Raises:
        InputError: no frames have poses, or the disk is full.
    """
    data = gzip.compress(json.dumps(replay(parts), allow_nan=False).encode(), 6, mtime=0)
    write_whole(folder / FILE, lambda out: out.write(data))
    return folder / FILE


def read_replay(folder: Path) -> dict[str, Any]:
    """Read the replay of a run.

    Raises:
        InputError: the run has none, or it cannot be read.
    """
    try:
        tree: dict[str, Any] = json.loads(gzip.decompress((folder / FILE).read_bytes()))
    except (OSError, EOFError, ValueError, RecursionError) as error:
        raise InputError(f"cannot read: {reason(error)}", where=folder / FILE, allowed="a newer run") from None
    return tree


def packed(values: ArrayLike, kind: str) -> dict[str, Any]:
    """Pack an array into JSON, as numbers of a NumPy kind such as f4."""
    array = np.ascontiguousarray(values, f"<{kind}" if kind != "u1" else kind)
    return {"type": kind, "shape": list(array.shape), "data": base64.b64encode(array.tobytes()).decode()}


def unpacked(tree: Mapping[str, Any]) -> NDArray[Any]:
    """Return the array that was packed."""
    return np.frombuffer(base64.b64decode(tree["data"]), f"<{tree['type']}").reshape(tree["shape"])


def world_tree(scene: Scene, states: Mapping[str, str]) -> dict[str, Any]:
    """Return the objects of a world with triangles and wires; hull parts are turned inwards."""
    hull, corners = hull_objects(scene), scene.corners()
    objects = []
    for index, thing in enumerate(scene.objects):
        mine = scene.face_object == index
        shape = corners[mine] if len(corners) <= MOST_FACES else corners[:0]
        if hull[index]:
            shape = turned_inwards(shape, scene.bounds.mean(axis=0))
        wire = scene.wires.object_id == index
        ends = np.stack([scene.wires.start[wire], scene.wires.end[wire]], axis=1)
        objects.append({
            "name": thing.name,
            "color": COLORS.get(thing.material.name, GREY),
            "alpha": 0.35 if thing.material.name in CLEAR else 1.0,
            "hull": bool(hull[index]),
            "state": states.get(thing.name, ""),
            "corners": packed(shape.reshape(-1, 3), "f4"),
            "wires": packed(ends.reshape(-1, 3), "f4"),
            "wire_radius": packed(scene.wires.radius_m[wire], "f4"),
        })  # fmt: skip
    return {"objects": objects}


def path_tree(path: Trajectory, start_ns: int) -> dict[str, Any]:
    """Return poses with their times."""
    return {
        "t": packed((path.t_ns - start_ns) * 1e-9, "f4"),
        "position": packed(path.position, "f4"),
        "quat": packed(path.quat_xyzw, "f4"),
    }


def _radar(number: int, part: Frames, start_ns: int) -> dict[str, Any]:
    """Return one radar: its poses, its beam, its profiles in steps of the span, and the nearest echo of each frame."""
    from ullage.processing.detect import detect
    from ullage.processing.own_echo import without_own_echo

    clean = part if part.ray_model else without_own_echo(part)[0]
    level = 20 * np.log10(np.maximum(clean.amplitude, 1e-12))
    top = 5 * float(np.ceil(level.max() / 5))
    share = np.clip((level - top + SPAN_DB) / SPAN_DB, 0, 1)
    hits = detect(clean, remove_own_echo=False)
    nearest = np.full(len(part), np.inf)
    np.minimum.at(nearest, hits.frame, hits.range_m)
    nearest[~np.isfinite(nearest)] = -1.0  # no echo
    azimuth, elevation = beam_deg(part.spec)
    return {
        "name": part.sensor,
        "color": sensor_color(number),
        "unit": part.unit,
        "azimuth_deg": azimuth,
        "elevation_deg": elevation,
        "range_m": [float(part.range_m[0]), float(part.range_m[-1])],
        "top_db": top,
        "span_db": SPAN_DB,
        "levels": packed(np.round(255 * share), "u1"),
        "nearest_m": packed(nearest, "f4"),
        **path_tree(part.believed, start_ns),
    }


def _plane(grid: Grid, height: float) -> dict[str, Any]:
    placed = grid.at_height(height)
    return {"dims": grid.dims, "origin": list(placed.origin_m), "step": grid.step_m, "shape": list(grid.shape)}


def map_tree(maps: Sequence[tuple[float, OccupancyMap]], start_ns: int, height: float) -> dict[str, Any]:
    """Return the maps of a run as changes: cells by flat index, and their states."""
    before = np.zeros(maps[-1][1].grid.size, np.uint8)
    indices, states, ends = [], [], []
    for _, omap in maps:
        now = cell_states(omap)
        changed = np.flatnonzero(now != before)
        indices.append(changed)
        states.append(now[changed])
        ends.append(len(changed))
        before = now
    return _plane(maps[-1][1].grid, height) | {
        "t": packed([max(t_s - start_ns * 1e-9, 0.0) for t_s, _ in maps], "f4"),
        "end": packed(np.cumsum(ends), "u4"),
        "cell": packed(np.concatenate(indices), "u4"),
        "state": packed(np.concatenate(states), "u1"),
    }


def maps_of(tree: Mapping[str, Any]) -> list[tuple[float, OccupancyMap]]:
    """Return the maps of a replay with times since its start [s], of free, occupied, ambiguous or unknown cells."""
    if not (plane := tree.get("map")):
        return []
    grid = _grid_of(plane)
    cells, states = unpacked(plane["cell"]), unpacked(plane["state"])
    now, out, start = np.full(grid.size, UNKNOWN, np.int8), [], 0
    percent = np.array([UNKNOWN, 0, 100, AMBIGUOUS], np.int8)  # of the four states, in their order
    for t_s, end in zip(unpacked(plane["t"]).tolist(), unpacked(plane["end"]).tolist(), strict=True):
        now[cells[start:end]] = percent[states[start:end]]
        start = end
        out.append((t_s, OccupancyMap(grid, now.reshape(grid.shape).copy())))
    return out


def images_of(tree: Mapping[str, Any]) -> list[Image]:
    """Return the image of a replay, if any, as amplitudes below its brightest cell."""
    if not (plane := tree.get("image")):
        return []
    share = unpacked(plane["level"]).astype(np.float32) / 255
    amplitude = np.where(share > 0, 10 ** ((share - 1) * plane["span_db"] / 20), 0)
    return [Image(_grid_of(plane), amplitude.astype(np.float32).reshape(plane["shape"]), None, "backprojection")]


def _grid_of(plane: Mapping[str, Any]) -> Grid:
    return Grid(tuple(plane["origin"]), plane["step"], tuple(plane["shape"]))


def cell_states(omap: OccupancyMap) -> NDArray[np.uint8]:
    """Return the state of each cell (flat): unknown, free, occupied or ambiguous; in a volume only occupied ones."""
    out = np.full(omap.grid.size, UNKNOWN_CELL, np.uint8)
    if omap.grid.dims == 2:
        out[omap.free.ravel()] = FREE_CELL
        out[omap.ambiguous.ravel()] = AMBIGUOUS_CELL
    out[omap.occupied.ravel()] = OCCUPIED_CELL
    return out


def _image(image: Image, height: float) -> dict[str, Any]:
    """Return an image in steps of its span; a volume as its brightest value over height."""
    amplitude = image.amplitude.max(axis=0) if image.grid.dims == 3 else image.amplitude
    grid = image.grid if image.grid.dims == 2 else Grid((*image.grid.origin_m[:2], height), image.grid.step_m,
                                                        image.grid.shape[-2:])  # fmt: skip
    level = 20 * np.log10(np.maximum(amplitude, 1e-30) / max(float(amplitude.max()), 1e-30))
    share = np.clip(1 + level / IMAGE_DB, 0, 1)
    return _plane(grid, height) | {"level": packed(np.round(255 * share), "u1"), "span_db": IMAGE_DB}


def _explained(one: Explained, sensors: Sequence[str], start_ns: int) -> dict[str, Any]:
    return {
        "radar": sensors.index(one.sensor),
        "t": (one.t_ns - start_ns) * 1e-9,
        "echoes": [
            {
                "path": list(echo.path),
                "object": echo.object,
                "bounces": echo.bounces,
                "range_m": round(echo.range_m, 4),
                "seen_m": round(echo.seen_m, 4),
                "db": round(echo.path_gain_db, 1),
                "point": [round(value, 4) for value in echo.point],
            }
            for echo in one.echoes
        ],
    }
