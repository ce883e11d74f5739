"""Grids in the world and what is laid out on them: images and occupancy maps.

Arrays on a grid are indexed [y, x] for a plane and [z, y, x] for a volume, rows from low y to high y.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage import checks
from ullage.arrays import Bools, Floats, Ints, Longs, Singles
from ullage.display import Displayed, plots
from ullage.errors import InputError, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ullage.data import Trajectory


MOST_CELLS = 2**31 - 1
"""Cells along an axis: kernels count them in 32 bits."""
MOST_BYTES = 4_000_000_000
"""Memory of arrays with a value in every cell."""
LEAVES = "a finite number that leaves some of the box"


@dataclass(frozen=True, slots=True)
class Grid:
    """Square cells on a horizontal plane, or cubes in a volume."""

    origin_m: tuple[
        float, float, float
    ]  # lower corner of the first cell [m]; z is the plane's height, NaN: the sensors' mean
    step_m: float  # edge of a cell [m]
    shape: tuple[int, ...]  # (ny, nx) or (nz, ny, nx)

    def __post_init__(self) -> None:
        step = checks.number("step_m", self.step_m, "Grid", above=0.0, allowed="> 0")
        each = f"(ny, nx) or (nz, ny, nx), each >= 1 and at most {MOST_CELLS}"
        counts = checks.as_given("shape", self.shape)
        if counts.shape not in ((2,), (3,)):
            raise InputError(f"shape is {shown(self.shape)}", where="Grid", allowed=each)
        shape = tuple(checks.whole("shape", n, "Grid", low=1, high=MOST_CELLS, allowed=each) for n in self.shape)
        origin = checks.array("origin_m", self.origin_m)
        if origin.shape != (3,) or not np.isfinite(origin[: len(shape)]).all():
            raise InputError(f"origin_m is {shown(self.origin_m)}", where="Grid", allowed="x, y, z, finite numbers")
        for name, value in (("origin_m", tuple(origin.tolist())), ("step_m", step), ("shape", shape)):
            object.__setattr__(self, name, value)

    @classmethod
    def covering(
        cls, bounds: ArrayLike, step_m: float, *, z_m: float | None = None, dims: int = 2, margin_m: float = 0.0
    ) -> Grid:
        """The smallest grid over a box, cell edges on multiples of the step.

        Args:
            bounds: (2, 3) lower and upper corner [m], as `Scene.bounds`.
            step_m: edge of a cell [m].
            z_m: height of the plane [m] (dims=2); None takes the sensors' mean height when the grid is used.
            dims: 2 for a plane, 3 for a volume.
            margin_m: room added on every side [m].

        Raises:
            InputError: the box is not finite, the step not above zero, or another number out of bounds.
        """
        box = checks.array("bounds", bounds)
        if box.shape != (2, 3) or not np.isfinite(box).all() or np.any(box[1] < box[0]):
            raise InputError(
                f"bounds are {box.tolist()}", where="Grid", allowed="(2, 3) finite, lower then upper corner"
            )
        step_m = checks.number("step_m", step_m, "Grid", above=0.0, allowed="> 0")
        checks.whole("dims", dims, "Grid", low=2, high=3, allowed="2 or 3")
        margin_m = checks.number("margin_m", margin_m, "Grid", allowed=LEAVES)
        if np.any(box[0] - margin_m > box[1] + margin_m):
            raise InputError(f"margin_m is {margin_m}", where="Grid", allowed=LEAVES)
        low = np.floor((box[0] - margin_m) / step_m + 1e-9)
        high = np.maximum(np.ceil((box[1] + margin_m) / step_m - 1e-9), low + 1)
        nx, ny, nz = (int(k) for k in high - low)
        x, y, z = (float(k) for k in low * step_m)
        if dims == 3:
            return cls((x, y, z), step_m, (nz, ny, nx))
        height = math.nan if z_m is None else checks.number("z_m", z_m, "Grid")
        return cls((x, y, height), step_m, (ny, nx))

    def check_memory(self, bytes_per_cell: float, what: str) -> None:
        """Refuse a grid of so many cells that arrays over all of them would not fit into memory.

        Raises:
            InputError: they take more than 4 GB.
        """
        size = bytes_per_cell * self.size
        if size > MOST_BYTES:
            cells = " x ".join(map(str, self.shape))
            raise InputError(f"{what} of {cells} cells takes {size / 1e9:.1f} GB", where="grid",
                             allowed=f"up to {MOST_BYTES / 1e9:.0f} GB; a larger step or a smaller box")  # fmt: skip

    @property
    def dims(self) -> int:
        """2 for a plane, 3 for a volume."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def x_m(self) -> Floats:
        """Cell centres along x (nx) [m]."""
        return self._axis(0)

    @property
    def y_m(self) -> Floats:
        """Cell centres along y (ny) [m]."""
        return self._axis(1)

    @property
    def z_m(self) -> Floats:
        """Cell centres along z (nz) [m]; the plane's own height for a plane."""
        return self._axis(2) if self.dims == 3 else np.array([self.origin_m[2]])

    def _axis(self, k: int) -> Floats:
        return np.asarray(self.origin_m[k] + self.step_m * (np.arange(self.shape[-1 - k]) + 0.5), np.float64)

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(left, right, bottom, top) of the x-y plane [m], as matplotlib's imshow wants it with origin="lower"."""
        ny, nx = self.shape[-2:]
        x, y = self.origin_m[:2]
        return x, x + nx * self.step_m, y, y + ny * self.step_m

    def at_height(self, z_m: float) -> Grid:
        """The same plane at a height [m], where none was set; a grid with a height stays as it is."""
        if self.dims == 3 or math.isfinite(self.origin_m[2]):
            return self
        return Grid((*self.origin_m[:2], z_m), self.step_m, self.shape)

    def index(self, points_m: ArrayLike) -> tuple[Longs, Bools]:
        """Cell of each point (n, 3): indices (n, dims) in array order, and whether the point lies on the grid (n)."""
        points = np.atleast_2d(np.asarray(points_m, float))[:, : self.dims]
        cell = np.floor((points - np.asarray(self.origin_m)[: self.dims]) / self.step_m).astype(np.int64)[:, ::-1]
        return cell, np.all((cell >= 0) & (cell < np.asarray(self.shape)), axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Image(Displayed):
    """A SAR image: one value per cell of a grid."""

    grid: Grid
    values: NDArray[Any]  # grid.shape, complex64 (coherent) or float32 (summed amplitudes)
    coherence: Singles | None = None  # grid.shape, 0..1
    method: str = ""

    def __post_init__(self) -> None:
        if self.values.shape != self.grid.shape:
            raise InputError(f"values have shape {self.values.shape}", where="Image", allowed=f"{self.grid.shape}")

    def __repr__(self) -> str:
        x, y, z = self.peak_m
        return f"Image({self.method or 'no method'}, {_cells(self.grid)}, peak at ({x:.2f}, {y:.2f}, {z:.2f}) m)"

    def plot(
        self, ax: Axes | None = None, *, scene: Any = None, path: Trajectory | None = None, span_db: float = 40.0
    ) -> Axes:
        """Draw the image with matplotlib, in dB below its brightest cell; of a volume, the highest over z.

        Args:
            ax: where to draw; None: a new figure.
            scene: the true world, a `Scene`, whose outline is drawn in red.
            path: where the radar went.
            span_db: range of the colours [dB].

        Returns:
            The axes.

        Raises:
            InputError: the span is not above zero.
        """
        return plots().plot_image(self, ax, scene=scene, path=path, span_db=span_db)  # type: ignore[no-any-return]

    @property
    def amplitude(self) -> Singles:
        """Magnitude of each cell."""
        return np.asarray(np.abs(self.values), np.float32)

    @property
    def peak_m(self) -> Floats:
        """Centre of the brightest cell (3) [m]."""
        cell = np.unravel_index(int(np.argmax(self.amplitude)), self.grid.shape)
        z = self.grid.z_m[cell[0] if self.grid.dims == 3 else 0]
        return np.array([self.grid.x_m[cell[-1]], self.grid.y_m[cell[-2]], z])


def _cells(grid: Grid) -> str:
    """A grid in a few words, x first."""
    return f"{' x '.join(str(n) for n in reversed(grid.shape))} cells of {grid.step_m:g} m"


UNKNOWN, AMBIGUOUS = -1, -2
EDGE = {2: 16, 3: 8}
"""Cells along a block's edge, of a plane and of a volume."""


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """Int8 cells in sparse blocks: one number for a block that is the same throughout, cells only for the others."""

    shape: tuple[int, ...]  # of the whole, in cells
    place: Ints  # (blocks along each axis) row of `cells`, or -1 for a block that is one number
    value: NDArray[np.int8]  # (blocks along each axis) that number
    cells: NDArray[np.int8]  # (k, edge, edge[, edge])

    @classmethod
    def of(cls, values: NDArray[np.int8], *, shape: tuple[int, ...] | None = None, corner: Sequence[int] = ()) -> Tiles:
        """Blocks of an array, or of one that lies inside a larger, otherwise unknown whole.

        Args:
            values: (ny, nx) or (nz, ny, nx).
            shape: of the whole; None: that of the values.
            corner: of the values in the whole, multiples of the block's edge.
        """
        edge = EDGE[values.ndim]
        whole = values.shape if shape is None else shape
        table = tuple(-(-n // edge) for n in whole)
        corner = tuple(corner) or (0,) * values.ndim
        part = tuple(slice(c // edge, c // edge - (-n // edge)) for c, n in zip(corner, values.shape, strict=True))
        blocks = _cut(values, edge)
        flat = blocks.reshape(*blocks.shape[: values.ndim], edge**values.ndim)
        mixed = flat.min(axis=-1) != flat.max(axis=-1)
        place, value = np.full(table, -1, np.int32), np.full(table, UNKNOWN, np.int8)
        value[part] = flat[..., 0]
        place[part][mixed] = np.arange(int(mixed.sum()))
        return cls(whole, place, value, np.ascontiguousarray(blocks[mixed]))

    @classmethod
    def unknown(cls, shape: tuple[int, ...]) -> Tiles:
        """Blocks of which nothing is known."""
        edge, dims = EDGE[len(shape)], len(shape)
        table = tuple(-(-n // edge) for n in shape)
        return cls(
            shape,
            np.full(table, -1, np.int32),
            np.full(table, UNKNOWN, np.int8),
            np.zeros((0, *(edge,) * dims), np.int8),
        )

    def dense(self) -> NDArray[np.int8]:
        """Every cell."""
        edge, dims = EDGE[len(self.shape)], len(self.shape)
        out = np.repeat(self.value[..., None], edge**dims, axis=-1).reshape(*self.place.shape, *(edge,) * dims)
        out[self.place >= 0] = self.cells[self.place[self.place >= 0]]
        order = [k for axis in range(dims) for k in (axis, dims + axis)]
        whole = out.transpose(order).reshape([n * edge for n in self.place.shape])
        return np.ascontiguousarray(whole[tuple(slice(n) for n in self.shape)])

    def block(self, index: tuple[int, ...]) -> tuple[tuple[int, ...], NDArray[np.int8]]:
        """One block's corner in cells and its cells, cut at the border of the whole."""
        edge = EDGE[len(self.shape)]
        corner = tuple(k * edge for k in index)
        size = tuple(min(edge, n - c) for n, c in zip(self.shape, corner, strict=True))
        row = int(self.place[index])
        if row < 0:
            return corner, np.full(size, self.value[index], np.int8)
        return corner, self.cells[row][tuple(slice(n) for n in size)].copy()

    def differing(self, other: Tiles) -> Longs:
        """Indices (k, dims) of the blocks in which the two differ, in order."""
        plain = (self.place < 0) & (other.place < 0)
        differ = np.where(plain, self.value != other.value, True)
        rest = np.argwhere(~plain)
        where = tuple(rest.T)
        mine, theirs = self._filled(where), other._filled(where)
        differ[where] = (mine != theirs).any(axis=1)
        return np.argwhere(differ)

    def _filled(self, where: tuple[Longs, ...]) -> NDArray[np.int8]:
        dims, row = len(self.shape), self.place[where]
        out = np.empty((len(row), EDGE[dims] ** dims), np.int8)
        out[:] = self.value[where][:, None]
        out[row >= 0] = self.cells[row[row >= 0]].reshape(-1, out.shape[1])
        return out

    @property
    def nbytes(self) -> int:
        """Memory held [byte]."""
        return self.place.nbytes + self.value.nbytes + self.cells.nbytes


def _cut(values: NDArray[np.int8], edge: int) -> NDArray[np.int8]:
    """The array as blocks (blocks along each axis, edge along each axis); the last of each axis repeats its border."""
    over = [(0, -n % edge) for n in values.shape]
    padded = np.pad(values, over, mode="edge") if any(b for _, b in over) else values
    parts = [k for n in padded.shape for k in (n // edge, edge)]
    return padded.reshape(parts).transpose([*range(0, len(parts), 2), *range(1, len(parts), 2)])


@dataclass(frozen=True, slots=True, eq=False)
class MappedSurface:
    """A surface as a mapper estimates it."""

    kind: str  # "plane", "cylinder", "edge"; in a plane map "lying" (its axis is level) or "slope" (its normal rises)
    position: Floats  # (d) that the state refers to [m]; d is 2 in a plane map and 3 in a volume
    state: Floats  # from there; plane: range [m], bearing [rad], curvature of the range [1/m] and cosine of the
    # elevation (4); volume: range [m], unit vector (3) and curvature (5)
    covariance: Floats  # (4, 4) or (5, 5)
    log_odds: float  # of its existence
    seen: int  # keyframes that saw it
    on_map: bool  # False: a slope, of open direction, hidden behind other surfaces, or flown through
    points: Floats  # (seen, d) specular points, which show its extent; of "lying" where the plane cuts it [m]
    normals: Floats  # (seen, d) unit vectors from there towards the sensor

    def lines(self, length_m: float, height_m: float) -> Floats:
        """Return short lines (k, 2, 3) along the surface through each specular point, for pictures [m].

        A point has one line in a plane map. In a volume it has two, across each other.

        Args:
            length_m: of each line [m].
            height_m: of the plane [m].
        """
        normals = np.zeros((len(self.normals), 3))
        normals[:, : self.normals.shape[1]] = self.normals
        points = np.full((len(self.points), 3), height_m)
        points[:, : self.points.shape[1]] = self.points
        steep = np.abs(normals[:, 2:]) > 0.99
        level = np.cross(np.where(steep, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]), normals)
        level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-12)
        along = [level] if self.points.shape[1] == 2 else [level, np.cross(normals, level)]
        half = 0.5 * length_m * np.concatenate(along)
        middle = np.tile(points, (len(along), 1))
        return np.stack([middle - half, middle + half], axis=1)


class OccupancyMap(Displayed):
    """What is known of each cell: 0..100 percent chance of being occupied, -1 unknown, -2 ambiguous.

    Ambiguous means: an echo came from an arc that holds this cell, and nothing yet says from which cell of it. Cells
    are kept in blocks; `percent` lays them out, for as long as somebody holds what it gave. It does not change.

    Args:
        grid: where the cells are.
        percent: int8 of the grid's shape, or the same in blocks.
        method: what made it.
        occupied_from: percent at and above which a cell counts as occupied.
        free_to: percent at and below which it counts as free.
        surfaces: that the cells were drawn from; none where the method estimates none, or a file held the map.

    Raises:
        InputError: the cells are not int8, not of the grid's shape, or out of range; or the levels are.
    """

    __slots__ = ("_view", "free_to", "grid", "method", "occupied_from", "surfaces", "tiles")
    grid: Grid
    tiles: Tiles
    method: str
    occupied_from: int
    free_to: int
    surfaces: tuple[MappedSurface, ...]
    _view: weakref.ref[NDArray[np.int8]] | None

    def __init__(
        self,
        grid: Grid,
        percent: NDArray[np.int8] | Tiles,
        method: str = "",
        occupied_from: int = 65,
        free_to: int = 35,
        surfaces: tuple[MappedSurface, ...] = (),
    ) -> None:
        if percent.shape != grid.shape or (isinstance(percent, np.ndarray) and percent.dtype != np.int8):
            kind = "blocks" if isinstance(percent, Tiles) else percent.dtype
            raise InputError(f"percent is {kind} {percent.shape}", where="OccupancyMap", allowed=f"int8 {grid.shape}")
        if isinstance(percent, np.ndarray) and (percent.min() < AMBIGUOUS or percent.max() > 100):
            low, high = int(percent.min()), int(percent.max())
            raise InputError(f"cells from {low} to {high}", where="OccupancyMap", allowed=f"{AMBIGUOUS} to 100 percent")
        if not 0 <= free_to <= occupied_from <= 100:
            levels = f"free_to {free_to}, occupied_from {occupied_from}"
            raise InputError(levels, where="OccupancyMap", allowed="0 <= free_to <= occupied_from <= 100")
        tiles = percent if isinstance(percent, Tiles) else Tiles.of(percent)
        self.__setstate__((grid, tiles, method, occupied_from, free_to, surfaces))

    def __repr__(self) -> str:
        counts = (("occupied", self.occupied), ("free", self.free), ("ambiguous", self.ambiguous))
        known = ", ".join(f"{int(flags.sum())} {name}" for name, flags in counts)
        return f"OccupancyMap({self.method or 'no method'}, {_cells(self.grid)}: {known})"

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"an OccupancyMap does not change: {name}")

    def __getstate__(self) -> tuple[Any, ...]:
        return self.grid, self.tiles, self.method, self.occupied_from, self.free_to, self.surfaces

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        names = ("grid", "tiles", "method", "occupied_from", "free_to", "surfaces", "_view")
        for name, value in zip(names, (*state, None), strict=True):
            object.__setattr__(self, name, value)

    @property
    def percent(self) -> NDArray[np.int8]:
        """Every cell, grid.shape; not to be written to."""
        held = None if self._view is None else self._view()
        if held is None:
            held = self.tiles.dense()
            held.flags.writeable = False
            object.__setattr__(self, "_view", weakref.ref(held))
        return held

    @property
    def occupied(self) -> Bools:
        """Cells held to be occupied."""
        return np.asarray(self.percent >= self.occupied_from)

    @property
    def free(self) -> Bools:
        """Cells held to be free."""
        return np.asarray((self.percent >= 0) & (self.percent <= self.free_to))

    @property
    def unknown(self) -> Bools:
        """Cells of which nothing is known."""
        return np.asarray(self.percent == UNKNOWN)

    @property
    def ambiguous(self) -> Bools:
        """Cells on an arc that one look alone left open."""
        return np.asarray(self.percent == AMBIGUOUS)

    @property
    def nbytes(self) -> int:
        """Memory its cells take [byte]."""
        return self.tiles.nbytes

    def clearance(self, *, chance: float | None = None) -> Clearance:
        """Measure the distance from each cell to the nearest surface that may be there, for planners.

        A surface may be in every cell that is not free, and off the grid.

        Args:
            chance: that a cell is free, from which it counts as free, 0.5 to 1; None: every cell held free.

        Raises:
            InputError: the chance is out of bounds.
        """
        from scipy.ndimage import distance_transform_edt

        free = self.free
        if chance is not None:
            if not 0.5 <= checks.number("chance", chance, "clearance") <= 1:
                raise InputError(f"chance is {shown(chance)}", where="clearance", allowed="0.5 to 1")
            free = (self.percent >= 0) & (self.percent <= 100 * (1 - chance) + 1e-9)
        cells, near = distance_transform_edt(np.pad(free, 1), return_indices=True)
        inner = (slice(1, -1),) * self.grid.dims
        distance = np.maximum(cells[inner] - 0.5, 0.0) * self.grid.step_m
        sigma = np.pad(self._sigmas(), 1)[tuple(near[(slice(None), *inner)])]
        return Clearance(self.grid, distance.astype(np.float32), sigma.astype(np.float32))

    def _sigmas(self) -> Floats:
        """Standard deviation of the place of the surface in each occupied cell, 0 in all others (grid.shape) [m]."""
        out = np.where(self.occupied, self.grid.step_m / math.sqrt(12), 0.0)
        shown = [one for one in self.surfaces if one.on_map]
        cells = np.argwhere(self.occupied)
        if shown and len(cells):
            from scipy.spatial import cKDTree

            points = np.concatenate([one.points for one in shown])
            variance = np.repeat([one.covariance[0, 0] for one in shown], [len(one.points) for one in shown])
            centres = np.asarray(self.grid.origin_m)[: self.grid.dims] + self.grid.step_m * (cells[:, ::-1] + 0.5)
            near = np.asarray(cKDTree(points).query(centres)[1])
            out[tuple(cells.T)] = np.sqrt(out[tuple(cells.T)] ** 2 + variance[near])
        return out

    def plot(
        self, ax: Axes | None = None, *, scene: Any = None, path: Trajectory | None = None, level: int | None = None
    ) -> Axes:
        """Draw the map with matplotlib: white free, black occupied, grey unknown, amber ambiguous.

        Args:
            ax: where to draw; None: a new figure.
            scene: the true world, a `Scene`, whose outline is drawn in red.
            path: where the drone flew.
            level: index along z of a volume's only level to draw; None: the highest probability over z.

        Returns:
            The axes.

        Raises:
            InputError: there is no such level.
        """
        return plots().plot_map(self, ax, scene=scene, path=path, level=level)  # type: ignore[no-any-return]

    def changes(self, before: OccupancyMap | None) -> Changes:
        """The blocks in which it differs from an earlier map of the same grid, or from nothing known.

        Raises:
            InputError: the two lie on different grids.
        """
        if before is None:
            old = Tiles.unknown(self.grid.shape)
        elif (before.grid.shape, before.grid.step_m) != (self.grid.shape, self.grid.step_m):
            raise InputError(
                f"the earlier map has cells {before.grid.shape}", where="changes", allowed=f"{self.grid.shape}"
            )
        else:
            old = before.tiles
        return Changes(self, self.tiles.differing(old))


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """Distance from the centre of each cell to the nearest surface that may be there.

    Its standard deviation is that of the nearest surface as the mapper states it, and of its place in a cell. It is 0
    where the nearest cell is not occupied but unknown or ambiguous. Errors that all poses share are not in it.
    """

    grid: Grid
    distance_m: Singles  # grid.shape; 0 in cells that are not free
    sigma_m: Singles  # grid.shape


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Blocks of a map that differ from an earlier one: iterate over it for (corner in cells, int8 values) of each.

    Corners and values are in array order, [y, x] or [z, y, x]. It is false when nothing changed.
    """

    after: OccupancyMap
    index: Longs  # (k, dims) of the blocks

    def __len__(self) -> int:
        return len(self.index)

    def __iter__(self) -> Iterator[tuple[tuple[int, ...], NDArray[np.int8]]]:
        for row in self.index.tolist():
            yield self.after.tiles.block(tuple(row))

    @property
    def box(self) -> tuple[slice, ...] | None:
        """Index of the smallest box of the map's array that holds them; None: nothing changed."""
        if not len(self.index):
            return None
        edge = EDGE[self.after.grid.dims]
        low, high = self.index.min(axis=0) * edge, (self.index.max(axis=0) + 1) * edge
        return tuple(slice(int(a), min(int(b), n)) for a, b, n in zip(low, high, self.after.grid.shape, strict=True))

    def rectangle(self) -> tuple[tuple[int, ...], NDArray[np.int8]] | None:
        """Corner and cells of that box, as `map_msgs/OccupancyGridUpdate` wants them; None: nothing changed."""
        box = self.box
        return None if box is None else (tuple(s.start for s in box), self.after.percent[box])
