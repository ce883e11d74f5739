"""Occupied cells as a PLY point cloud, which every mesh viewer opens [Turk1994]."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.grids import UNKNOWN, Grid, OccupancyMap
from ullage.ports.intake import warn
from ullage.specs import Spec
from ullage.untrusted import MOST_CELLS, reading, reason
from ullage.world.meshes import check_ply

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
