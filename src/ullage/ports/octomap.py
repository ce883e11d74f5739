"""OctoMap trees, `.bt` (free, occupied, unknown) and `.ot` (chances), from arrays and back [Hornung2013].

Written here and not through pyoctomap, which sets one voxel at a time, does not prune and is large; it is the judge in
the tests, with octomap's own tools. Both files list a tree's nodes depth first. Nodes of one level, sorted by Morton
code, stand in that order, so each level is one array, and a node's place follows from the sizes of subtrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.grids import UNKNOWN, Grid, OccupancyMap
from ullage.ports.intake import warn
from ullage.untrusted import MOST_CELLS, reading

DEPTH = 16
CENTRE = 1 << (DEPTH - 1)
FREE, OCCUPIED, INNER = 1, 2, 3
SUREST = 0.9975
MOST_STEP_M = 1e6


@dataclass(frozen=True, slots=True)
class Level:
    """Nodes of one depth, by Morton code."""

    code: Longs  # (n)
    value: Floats  # (n) of a leaf; the highest of its children of an inner node
    inner: Bools  # (n)
    parent: Longs  # (n) row in the level above


def write_octomap(omap: OccupancyMap, path: str | Path) -> None:
    """Write a map as `.bt` or `.ot`, by the suffix.

    A plane becomes one layer of cubes. Ambiguous cells are unknown to OctoMap; `.bt` also leaves out those between free
    and occupied.

    Raises:
        InputError: the suffix is neither, the map lies outside OctoMap's world, or cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".bt", ".ot"):
        raise InputError("not an OctoMap file", where=path, allowed=".bt, .ot")
    binary = path.suffix == ".bt"
    known = omap.occupied | omap.free if binary else omap.percent >= 0
    code = _codes(omap.grid, known, path)
    percent = omap.percent[known].astype(float)
    chance = np.clip(percent / 100, 1 - SUREST, SUREST)
    value = np.where(percent >= omap.occupied_from, 1.0, 0.0) if binary else np.log(chance / (1 - chance))
    order = np.argsort(code, kind="stable")
    levels = _grow(code[order], value[order]) if len(code) else []
    nodes = sum(len(level.code) for level in levels)
    kind = "binary file" if binary else "file"
    head = f"# Octomap OcTree {kind}\n# written by ullage\nid OcTree\nsize {nodes}\nres {omap.grid.step_m!r}\ndata\n"
    body = (_bits(levels) if binary else _values(levels)) if nodes else b""
    write_whole(path, lambda out: out.write(head.encode() + body))


def _codes(grid: Grid, known: Bools, path: Path) -> Longs:
    origin = np.nan_to_num(np.array(grid.origin_m)) / grid.step_m
    first = np.rint(origin).astype(np.int64)
    if np.any(abs(origin - first) > 1e-3):
        off = float(abs(origin - first).max()) * grid.step_m
        warn(f"{path}: OctoMap's cells lie on multiples of their edge; shifted by {off:.3g} m")
    cells = np.argwhere(known if grid.dims == 3 else known[None])[:, ::-1] + first + CENTRE
    if len(cells) and (cells.min() < 0 or cells.max() >= 2 * CENTRE):
        raise InputError(
            "the map lies outside OctoMap's world", where=path, allowed=f"within {CENTRE * grid.step_m:g} m"
        )
    return _spread(cells[:, 0]) | _spread(cells[:, 1]) << 1 | _spread(cells[:, 2]) << 2


def _spread(x: Longs) -> Longs:
    """The 16 bits of each number, two zeros between them."""
    for shift, mask in ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249)):
        x = (x | x << shift) & mask
    return x


def _gather(code: Longs) -> Longs:
    """The reverse of `_spread`: every third bit."""
    x = code & 0x249249249249
    for shift, mask in ((2, 0xC30C30C30C3), (4, 0xF00F00F00F), (8, 0xFF0000FF), (16, 0xFFFF)):
        x = (x | x >> shift) & mask
    return x


def _grow(code: Longs, value: Floats) -> list[Level]:
    """Levels from the root down; eight leaves of one value become their parent."""
    levels: list[Level] = []
    inner = np.zeros(len(code), np.bool_)
    for _ in range(DEPTH):
        above, first, row = np.unique(code >> 3, return_index=True, return_inverse=True)
        high, low = np.maximum.reduceat(value, first), np.minimum.reduceat(value, first)
        same = (np.diff(np.append(first, len(code))) == 8) & (high == low) & ~np.logical_or.reduceat(inner, first)
        keep = ~same[row]
        if levels:  # the rows that nodes below point to, after those that went up are gone
            levels[-1] = replace(levels[-1], parent=(np.cumsum(keep) - 1)[levels[-1].parent])
        levels.append(Level(code[keep], value[keep], inner[keep], row[keep]))
        code, value, inner = above, high, ~same
    levels.append(Level(code, value, inner, np.zeros(len(code), np.int64)))
    return levels[::-1]


def _places(levels: list[Level], *, leaves: bool) -> list[Longs]:
    """Each node's place in the file, counted in nodes, or in inner nodes only."""
    sizes = [np.ones(0, np.int64)] * len(levels)
    for depth in range(len(levels) - 1, -1, -1):
        level = levels[depth]
        sizes[depth] = np.where(level.inner, 1, int(leaves))
        if depth + 1 < len(levels):
            np.add.at(sizes[depth], levels[depth + 1].parent, sizes[depth + 1])
    places = [np.zeros(len(levels[0].code), np.int64)]
    for above, (level, size) in zip(range(len(levels)), zip(levels[1:], sizes[1:], strict=True), strict=False):
        before = np.cumsum(size) - size
        first = np.flatnonzero(np.diff(level.parent, prepend=-1))
        start = np.zeros(len(levels[above].code), np.int64)
        start[level.parent[first]] = before[first]
        places.append(places[above][level.parent] + 1 + before - start[level.parent])
    return places


def _bits(levels: list[Level]) -> bytes:
    """Two bits for each child of each inner node."""
    places = _places(levels, leaves=False)
    out = np.zeros(sum(int(level.inner.sum()) for level in levels), "<u2")
    for place, level in zip(places, levels[1:], strict=False):
        state = np.where(level.inner, INNER, np.where(level.value > 0, OCCUPIED, FREE))
        np.bitwise_or.at(out, place[level.parent], (state << 2 * (level.code & 7)).astype(np.uint16))
    return out.tobytes()


def _values(levels: list[Level]) -> bytes:
    """Log-odds and a bit for each child, of every node."""
    out = np.zeros(sum(len(level.code) for level in levels), [("value", "<f4"), ("children", "u1")])
    places = _places(levels, leaves=True)
    for place, level in zip(places, levels, strict=True):
        out["value"][place] = level.value
    for place, level in zip(places, levels[1:], strict=False):
        np.bitwise_or.at(out["children"], place[level.parent], (1 << (level.code & 7)).astype(np.uint8))
    return out.tobytes()


def read_octomap(path: str | Path) -> OccupancyMap:
    """Read a `.bt` or `.ot` file into the smallest volume that holds what is known.

    Raises:
        InputError: it is neither, cut, or too large to lay out as an array.
    """
    path = Path(path)
    with reading(path):
        raw = path.read_bytes()
    head, found, body = raw[:4096].partition(b"\ndata\n")
    words = dict(line.split(" ", 1) for line in head.decode("latin1").splitlines() if " " in line and line[0] != "#")
    if not (found and raw.startswith(b"# Octomap OcTree")):
        raise InputError("not an OctoMap file", where=path, allowed=".bt, .ot")
    if words.get("id") != "OcTree":
        raise InputError(f"holds a {words.get('id', '?')}", where=path, allowed="OcTree")
    binary = raw.startswith(b"# Octomap OcTree binary")
    body = raw[len(head) + len(found) :]
    try:
        step = float(words["res"])
        if not MOST_STEP_M > step > 0:
            raise InputError(f"cells of {step:g} m", where=path, allowed=f"above 0, below {MOST_STEP_M:g} m")
        leaves = (_parse_bits if binary else _parse_values)(body) if int(words["size"]) else []
    except (IndexError, KeyError, ValueError):
        raise InputError("cut or damaged", where=path) from None
    if not leaves:
        raise InputError("an empty tree", where=path)
    code, depth, value = (np.array(column) for column in zip(*leaves, strict=True))
    return _laid_out(code.astype(np.int64), depth.astype(np.int64), value.astype(float), step, path)


Leaf = tuple[int, int, float]  # Morton code at its own depth, depth, percent


def _parse_bits(body: bytes) -> list[Leaf]:
    leaves: list[Leaf] = []
    stack, at = [(0, 0)], 0
    while stack:
        code, depth = stack.pop()
        bits = body[at] | body[at + 1] << 8
        at += 2
        if depth >= DEPTH:
            raise ValueError
        inner = []
        for child in range(8):
            state = bits >> 2 * child & 3
            if state == INNER:
                inner.append((code << 3 | child, depth + 1))
            elif state:
                leaves.append((code << 3 | child, depth + 1, 100.0 if state == OCCUPIED else 0.0))
        stack.extend(reversed(inner))
    return leaves


def _parse_values(body: bytes) -> list[Leaf]:
    nodes = np.frombuffer(body[: len(body) // 5 * 5], [("value", "<f4"), ("children", "u1")])
    with np.errstate(over="ignore", invalid="ignore"):
        percents = (100 / (1 + np.exp(-nodes["value"].astype(float)))).tolist()
    children = nodes["children"].tolist()
    leaves: list[Leaf] = []
    stack, at = [(0, 0)], 0
    while stack:
        code, depth = stack.pop()
        mask = children[at]
        if not mask:
            leaves.append((code, depth, percents[at]))
        elif depth >= DEPTH:
            raise ValueError
        stack.extend((code << 3 | child, depth + 1) for child in range(7, -1, -1) if mask >> child & 1)
        at += 1
    return leaves


def _laid_out(code: Longs, depth: Longs, value: Floats, step: float, path: Path) -> OccupancyMap:
    """The leaves as cells of one volume."""
    edge = 1 << (DEPTH - depth)
    low = np.stack([_gather(code >> k) * edge for k in range(3)], axis=1)
    first, last = low.min(0), (low + edge[:, None]).max(0)
    shape = tuple(int(k) for k in (last - first)[::-1])
    cells = shape[0] * shape[1] * shape[2]
    if cells > MOST_CELLS:
        raise InputError(f"{cells:.3g} cells are too many for an array", where=path, allowed=f"{MOST_CELLS:.0e}")
    percent = np.full(shape, UNKNOWN, np.int8)
    known = np.rint(np.nan_to_num(value, nan=50)).clip(0, 100).astype(np.int8)
    single = edge == 1
    x, y, z = (low - first).T
    percent[z[single], y[single], x[single]] = known[single]
    for i in np.flatnonzero(~single):
        e = edge[i]
        percent[z[i] : z[i] + e, y[i] : y[i] + e, x[i] : x[i] + e] = known[i]
    ox, oy, oz = (float(k) for k in (first - CENTRE) * step)
    return OccupancyMap(Grid((ox, oy, oz), step, shape), percent, "octomap", 50, 49)
