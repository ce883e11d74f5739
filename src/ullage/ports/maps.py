"""Read and write maps of `map_server`, and occupied cells as a PLY point cloud.

`map_server` has an image and a `.yaml` with its place [MapServer]; every mesh viewer opens a PLY [Turk1994].

trinary: black is occupied, white free, grey (205) unknown. scale: grey levels between the thresholds, unknown is
transparent, so the image is a PNG. raw: the pixel is the percent, 255 unknown; nothing is lost but the mark ambiguous.

Maps that are read come from many programs: a cell is free or occupied only where every way to read its pixel agrees.
"""

from __future__ import annotations

import io
import json
import math
import os
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ullage.arrays import Floats
from ullage.errors import InputError, shown
from ullage.files import write_whole
from ullage.grids import UNKNOWN, Grid, OccupancyMap
from ullage.ports.intake import warn
from ullage.specs import Spec
from ullage.untrusted import MOST_CELLS, read_yaml, reading, reason, regular_size
from ullage.world.meshes import check_ply

Mode = Literal["trinary", "scale", "raw"]
MODES = ("trinary", "scale", "raw")
FREE_PIXEL, UNKNOWN_PIXEL = 254, 205
FREE_THRESHOLD, OCCUPIED_THRESHOLD = 0.196, 0.65  # map_server's own, between which 205 is unknown
MOST_PIXELS = 100_000_000
STRIP = 256  # rows of the image worked on at a time, so that their colours take little memory
FORMATS = ("PPM", "PNG", "BMP", "TIFF", "GIF", "JPEG")  # none that needs another program, as PostScript does
LARGEST = 1e9  # metres and metres a pixel
SCREEN_GAMMA = 0.45455  # of a PNG that screens show as it stands
JPEG_ERROR, ROUNDED = 12 / 255, 0.5 / 255  # of brightness, as JPEG or 8 bits change it
TRUE = ("1", "1.0", "true", "yes", "on")  # of YAML 1.1, as others write it


def write_map_server(omap: OccupancyMap, path: str | Path, *, mode: Mode = "trinary") -> Path:
    """Write a plane as `<name>.yaml` and its image beside it, `.pgm` or (scale) `.png`.

    Args:
        omap: a plane; what is ambiguous becomes unknown.
        path: of the `.yaml` or of the image.
        mode: how percent become pixels.

    Returns:
        The path of the `.yaml`.

    Raises:
        InputError: the map is a volume, the mode is unknown, or the folder cannot be written.
    """
    import yaml
    from PIL import Image

    path = Path(path)
    if omap.grid.dims != 2:
        raise InputError("map_server knows planes only", where=path, allowed="a 2D map; .bt, .ot or .ply for a volume")
    if mode not in MODES:
        raise InputError(f"no mode {mode!r}", where="mode", allowed=", ".join(MODES))
    image = path.with_suffix(".png" if mode == "scale" else ".pgm")
    picture = Image.fromarray(np.ascontiguousarray(_pixels(omap, mode)[::-1]))
    write_whole(image, lambda out: picture.save(out, "PNG" if mode == "scale" else "PPM"))
    x, y, z = omap.grid.origin_m
    low, high = (
        (omap.free_to / 100, omap.occupied_from / 100) if mode != "trinary" else (FREE_THRESHOLD, OCCUPIED_THRESHOLD)
    )
    about: dict[str, Any] = {
        "image": image.name, "mode": mode, "resolution": omap.grid.step_m, "origin": [x, y, 0.0], "negate": 0,
        "occupied_thresh": high, "free_thresh": low,
        "ullage": {"height_m": z if math.isfinite(z) else None, "method": omap.method},
    }  # fmt: skip
    text = yaml.safe_dump(about, sort_keys=False, default_flow_style=None)
    write_whole(path.with_suffix(".yaml"), lambda out: out.write(text.encode()))
    return path.with_suffix(".yaml")


def _pixels(omap: OccupancyMap, mode: Mode) -> NDArray[np.uint8]:
    """Rows from low y to high y; (ny, nx), or (ny, nx, 2) with opacity."""
    known = omap.percent >= 0
    if mode == "trinary":
        return np.where(omap.occupied, 0, np.where(omap.free, FREE_PIXEL, UNKNOWN_PIXEL)).astype(np.uint8)
    if mode == "raw":
        return np.where(known, omap.percent, 255).astype(np.uint8)
    grey = np.where(known, np.rint(255 - 2.55 * omap.percent), UNKNOWN_PIXEL)
    return np.stack([grey, np.where(known, 255, 0)], axis=-1).astype(np.uint8)


def read_map_server(path: str | Path) -> OccupancyMap:
    """Read a `map_server` map of any program.

    Args:
        path: of the `.yaml`.

    Raises:
        InputError: the file or its image cannot be read or make no map.
    """
    path = Path(path)
    about, _ = read_yaml(path)
    if not isinstance(about, dict) or "image" not in about:
        raise InputError("no map", where=path, allowed="a map_server .yaml with image, resolution, origin, ...")
    step = _number(about, "resolution", path)
    low, high = _number(about, "free_thresh", path), _number(about, "occupied_thresh", path)
    mode = str(about.get("mode", "trinary"))
    if mode not in MODES:
        raise InputError(f"no mode {mode!r}", where=path, allowed=", ".join(MODES))
    if not 0 <= low < high <= 1:
        raise InputError(f"free_thresh {low:g} is not below occupied_thresh {high:g}", where=path, allowed="0 to 1")
    x, y, yaw = _origin(about, path)
    image, negate = _beside(path, str(about["image"])), str(about.get("negate", 0)).lower() in TRUE
    percent = _read_image(image, lambda grey: _percent(grey, mode, negate, low, high))[::-1]
    entry = about.get("ullage")
    own: dict[str, Any] = entry if isinstance(entry, dict) else {}
    z = own.get("height_m")
    height = float(z) if isinstance(z, int | float) and abs(z) <= LARGEST else math.nan
    levels = (round(100 * high), round(100 * low)) if mode == "raw" else (65, 35)
    grid, cells = along_axes(np.ascontiguousarray(percent), (x, y, height), step, yaw=yaw, occupied_from=levels[0])
    return OccupancyMap(grid, cells, str(own.get("method") or "map_server"), *levels)


def _number(about: dict[str, Any], name: str, path: Path) -> float:
    value = about.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise InputError(f"{name} is {shown(value)}", where=path, allowed="a number")
    return float(value)


def _origin(about: dict[str, Any], path: Path) -> tuple[float, float, float]:
    origin: Any = about.get("origin")
    known = isinstance(origin, list) and len(origin) == 3 and all(isinstance(v, int | float) for v in origin)
    if not (known and all(abs(v) <= LARGEST for v in origin)):
        raise InputError(f"origin is {shown(origin)}", where=path, allowed="[x, y, yaw]")
    return float(origin[0]), float(origin[1]), float(origin[2])


def _beside(path: Path, name: str) -> Path:
    """The image that a map names: a file in the map's folder, or below it."""
    image = path.parent / name
    try:
        inside = image.resolve().is_relative_to(path.parent.resolve())
    except (OSError, ValueError):  # too long, or a zero byte in it
        raise InputError(f"image is {shown(name)}", where=path, allowed="the name of a file") from None
    if not inside:
        raise InputError(f"image {shown(name)} reaches out of the map's folder", where=path, allowed="a file beside it")
    if not os.path.exists(image):
        raise InputError("no image: no such file", where=image, allowed="PGM, PNG, BMP")
    regular_size(image, allowed="PGM, PNG, BMP")
    return image


def _read_image(path: Path, percent_of: Callable[[Floats], NDArray[np.int8]]) -> NDArray[np.int8]:
    """The percent of each pixel, from its brightness 0..255, the mean of colours; unknown where readings differ."""
    from PIL import Image

    try:
        with warnings.catch_warnings(), Image.open(path, formats=FORMATS) as image:
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our own limit is lower
            if image.width * image.height > MOST_PIXELS:
                size = f"{image.width} x {image.height} pixels"
                raise InputError(f"{size} are too many", where=path, allowed=f"{MOST_PIXELS:.0e}")
            readings = _readings(image)
            out = np.empty((image.height, image.width), np.int8)
            for top in range(0, image.height, STRIP):
                over_black, over_white = _brightness(image.crop((0, top, image.width, min(top + STRIP, image.height))))
                found = [percent_of(255 * read(grey)) for read in readings for grey in (over_black, over_white)]
                same = np.ptp(found, axis=0) == 0
                out[top : top + STRIP] = np.where(same, found[0], UNKNOWN)
            return out
    except InputError:
        raise
    except Image.DecompressionBombError:
        raise InputError("its pixels are too many", where=path, allowed=f"{MOST_PIXELS:.0e}") from None
    except Exception as error:  # the image library raises a dozen kinds of exception
        raise InputError(f"no image: {reason(error)}", where=path, allowed="PGM, PNG, BMP") from None


def _readings(image: Any) -> list[Callable[[Floats], Floats]]:
    """Ways to read a brightness 0..1: as it stands, by a PNG's gamma that few programs heed, or off by JPEG's error."""
    gamma = float(image.info.get("gamma") or SCREEN_GAMMA)
    power = 1.0 if abs(gamma / SCREEN_GAMMA - 1) < 0.02 else SCREEN_GAMMA / gamma
    error = JPEG_ERROR if image.format == "JPEG" else ROUNDED if power != 1 else 0.0

    def bent(grey: Floats, off: float) -> Floats:
        return np.asarray(np.clip(grey + off, 0, 1) ** power)

    return [lambda grey: grey, *(partial(bent, off=off) for off in (-error, error) if error)]


def _brightness(part: Any) -> tuple[Floats, Floats]:
    """Brightness of each pixel 0..1, with black behind what is clear, and with white."""
    clear = part.info.get("transparency")
    if part.mode == "I" or part.mode.startswith("I;16"):  # 16 bits, which PIL would cut off at 255
        raw = np.asarray(part, np.float64)
        if raw.max() > 65535:
            raise ValueError("pixels of 32 bits")
        grey, opacity = raw / 65535, np.where(raw == (-1 if clear is None else clear), 0.0, 1.0)
    elif part.mode == "F":
        raise ValueError("pixels of floating point")
    else:
        pixels = np.asarray(part.convert("RGBA"), np.float64) / 255
        grey, opacity = pixels[..., :3].mean(axis=-1), pixels[..., 3]
    return grey * opacity, grey * opacity + 1 - opacity


def _percent(grey: Floats, mode: str, negate: bool, low: float, high: float) -> NDArray[np.int8]:
    """The percent of pixels by their brightness 0..255."""
    if mode == "raw":
        whole = np.abs(grey - np.rint(grey)) < 1e-6  # 16 bits that hold 8 are no percent
        return np.where((grey < 100.5) & whole, np.rint(grey), UNKNOWN).astype(np.int8)
    chance = (grey if negate else 255 - grey) / 255
    between = np.full(grey.shape, float(UNKNOWN))
    if mode == "scale":
        between = np.rint(1 + 98 * (chance - low) / (high - low))
    else:
        low = min(low, FREE_THRESHOLD)  # Nav2 writes 0.25, above the unknown of the images beside it
    return np.where(chance > high, 100, np.where(chance < low, 0, between)).astype(np.int8)


SAMPLES = (-1 / 3, 0.0, 1 / 3)
"""Where a new cell looks into the old ones, from its centre along each axis [cells]."""


def along_axes(
    percent: NDArray[np.int8], origin_m: tuple[float, float, float], step_m: float, *, yaw: float, occupied_from: int
) -> tuple[Grid, NDArray[np.int8]]:
    """Rotate a map that is turned about its origin onto the axes of the world.

    A new cell takes what lies at its centre, or the most occupied of nine places in it, so walls stay closed.

    Args:
        percent: of each cell (ny, nx), low y first.
        origin_m: lower left corner of the first cell [m].
        step_m: edge of a cell [m].
        yaw: from the world's x axis to that of the map [rad].
        occupied_from: least percent of an occupied cell.

    Returns:
        The grid, and the percent of its cells; unknown beyond the map.

    Raises:
        InputError: the turned map has too many cells.
    """
    ny, nx = percent.shape
    yaw = math.remainder(yaw, math.tau)
    if abs(yaw) * math.hypot(nx, ny) < 0.5:  # no cell moves by half its edge
        return Grid(origin_m, step_m, percent.shape), percent
    cos, sin = math.cos(yaw), math.sin(yaw)
    corners = np.array([[0, 0], [nx, 0], [0, ny], [nx, ny]]) @ np.array([[cos, sin], [-sin, cos]])  # [cells]
    low = corners.min(axis=0)
    width, height = (int(n) for n in np.ceil(np.ptp(corners, axis=0) - 1e-6))
    if width * height > MOST_CELLS:
        raise InputError(f"{width} x {height} cells once turned", where="map", allowed=f"at most {MOST_CELLS}")
    padded = np.pad(percent, 1, constant_values=UNKNOWN)
    out = np.empty((height, width), np.int8)
    across = low[0] + np.arange(width) + 0.5
    for row in range(height):
        found = []
        for up in SAMPLES:
            for right in SAMPLES:
                x, y = across + right, low[1] + row + 0.5 + up
                column = np.clip(np.floor(cos * x + sin * y), -1, nx).astype(int) + 1
                line = np.clip(np.floor(cos * y - sin * x), -1, ny).astype(int) + 1
                found.append(padded[line, column])
        most = np.max(found, axis=0)
        out[row] = np.where(most >= occupied_from, most, found[len(found) // 2])
    x0, y0, z0 = origin_m
    return Grid((x0 + step_m * low[0], y0 + step_m * low[1], z0), step_m, out.shape), out


TAG = "comment ullage grid "
FURTHEST_M = 1e12  # points beyond cannot be numbered in cells


def write_ply(omap: OccupancyMap, path: str | Path, *, normals: Floats | None = None) -> None:
    """Write the centre of each occupied cell, with its percent.

    Args:
        omap: a plane or a volume; a plane without a height lies at z = 0.
        path: of the `.ply` file.
        normals: of the surface in each occupied cell, in array order (n, 3); None: unknown.

    Raises:
        InputError: normals of another length were given, or the folder cannot be written.
    """
    cells = np.argwhere(omap.occupied)
    centres = [omap.grid.x_m[cells[:, -1]], omap.grid.y_m[cells[:, -2]]]
    centres += [
        omap.grid.z_m[cells[:, 0]] if omap.grid.dims == 3 else np.full(len(cells), np.nan_to_num(omap.grid.z_m[0]))
    ]
    names = ["x", "y", "z"]
    if normals is not None:
        if normals.shape != (len(cells), 3):
            raise InputError(f"normals have shape {normals.shape}", where="normals", allowed=f"({len(cells)}, 3)")
        names += ["nx", "ny", "nz"]
        centres += list(normals.T)
    points = np.zeros(len(cells), [(name, "<f4") for name in names] + [("occupied", "u1")])
    for name, values in zip(names, centres, strict=True):
        points[name] = values
    points["occupied"] = omap.percent[omap.occupied]
    origin = [value if math.isfinite(value) else None for value in omap.grid.origin_m]
    about = {"origin_m": origin, "step_m": omap.grid.step_m, "shape": omap.grid.shape, "method": omap.method}
    # not by trimesh, whose export writes no comment of ours
    head = ["ply", "format binary_little_endian 1.0", TAG + json.dumps(about), f"element vertex {len(points)}"]
    head += [f"property float {name}" for name in names]
    head += ["property uchar occupied", "end_header", ""]
    write_whole(Path(path), lambda out: out.write("\n".join(head).encode() + points.tobytes()))


def read_ply(path: str | Path, *, step_m: float | None = None) -> OccupancyMap:
    """Read points as occupied cells; all others are unknown.

    Args:
        path: of the `.ply` file.
        step_m: edge of a cell [m]; None: what the file says, if ullage wrote it.

    Raises:
        InputError: it is no PLY file, holds no points, or no step is known.
    """
    import trimesh

    path = Path(path)
    with reading(path):
        raw = path.read_bytes()
    about = _grid_in(raw, path)
    try:
        check_ply(raw, path)
        cloud: Any = trimesh.load(io.BytesIO(raw), file_type="ply", process=False)
        points = np.asarray(cloud.vertices, float).reshape(-1, 3)
    except InputError:
        raise
    except Exception as error:  # trimesh says what is wrong in a dozen kinds of exception
        raise InputError(f"no PLY point cloud: {reason(error)}", where=path) from None
    points = points[np.isfinite(points).all(1)]
    if about is not None and step_m is None:
        x, y, z = (math.nan if value is None else value for value in about.origin_m)
        grid = Grid((x, y, z), about.step_m, about.shape)
    elif not len(points):
        raise InputError("no points in it", where=path)
    elif step_m is None:
        raise InputError("does not say how large its cells are", where=path, allowed="read_ply(path, step_m=...)")
    else:
        box = np.stack([points.min(0), points.max(0)])
        grid = Grid.covering(box, step_m, dims=3, margin_m=0.01 * step_m)  # so that no point lies on the last edge
    if grid.size > MOST_CELLS:
        raise InputError(f"{grid.size:.3g} cells are too many for an array", where=path, allowed=f"{MOST_CELLS:.0e}")
    percent = np.full(grid.shape, UNKNOWN, np.int8)
    cells, inside = grid.index(np.clip(points, -FURTHEST_M, FURTHEST_M))
    if not inside.all():
        warn(f"{path}: {int((~inside).sum())} points lie outside its grid; left out")
    percent[tuple(cells[inside].T)] = 100
    return OccupancyMap(grid, percent, about.method if about else "ply")


class GridComment(Spec):
    """The grid that ullage writes into a comment."""

    origin_m: tuple[float | None, float | None, float | None]
    step_m: float = Field(gt=0, le=1e6)
    shape: tuple[int, ...] = Field(min_length=2, max_length=3)
    method: str = Field("ply", max_length=100)


def _grid_in(raw: bytes, path: Path) -> GridComment | None:
    """The grid in the file's header, where ullage wrote it."""
    head = raw[:65536].split(b"end_header")[0].decode("latin1").splitlines()
    for number, line in enumerate(head, 1):
        if line.startswith(TAG):
            try:
                found = json.loads(line.removeprefix(TAG))
                return GridComment(**found if isinstance(found, dict) else {"grid": found})
            except InputError as error:
                raise InputError(f"the grid in it: {error}", where=path, line=number) from None
            except (ValueError, RecursionError) as error:
                raise InputError(f"the grid in it is no JSON: {reason(error)}", where=path, line=number) from None
    return None
