"""From the mapper's blocks to percent, and what the flight could see of it."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop
from ullage.kernels.occupancy import EMPTY, NOWHERE, SCALE, Pools, bit_count, cell_index


@loop(fastmath=True)
def render_cells(
    pools: Pools,
    edge: int,
    box: np.ndarray,
    free_nats: np.ndarray,
    prior: float,
    enough: int,
    vague: int,
    heard: float,
    many: float,
    solid: float,
    out: np.ndarray,
) -> None:
    """Percent of each cell of the box (z, y, x; first and end) into `out`: chance, UNKNOWN -1 or AMBIGUOUS -2."""
    for iz in range(box[0, 0], box[0, 1]):
        for iy in range(box[1, 0], box[1, 1]):
            for ix in range(box[2, 0], box[2, 1]):
                bz, by, bx = iz // edge if pools.size[2] > 1 else 0, iy // edge, ix // edge
                slot, silent, echoes = pools.slots[bz, by, bx], pools.common[bz, by, bx], 0
                if slot != EMPTY:
                    cell = cell_index(ix, iy, iz, edge, pools.size[2])
                    silent |= pools.silent[slot, cell]
                    echoes = pools.hits[slot, cell]
                looks = bit_count(silent)
                odds = prior + echoes / SCALE - free_nats[looks]
                if echoes >= vague:
                    odds = heard + echoes / SCALE - many * (max(looks - enough, 0) + max(looks - 8, 0))
                if odds >= solid:
                    out[iz - box[0, 0], iy - box[1, 0], ix - box[2, 0]] = min(
                        int(100.0 / (1.0 + math.exp(-odds)) + 0.5), 99
                    )
                elif looks >= enough and echoes < vague:
                    out[iz - box[0, 0], iy - box[1, 0], ix - box[2, 0]] = int(100.0 / (1.0 + math.exp(-odds)) + 0.5)
                elif echoes > 0:
                    out[iz - box[0, 0], iy - box[1, 0], ix - box[2, 0]] = -2
                else:
                    out[iz - box[0, 0], iy - box[1, 0], ix - box[2, 0]] = -1


@loop(fastmath=True)
def thin_lines(pools: Pools, edge: int, corner: np.ndarray, least: int, percent: np.ndarray, out: np.ndarray) -> None:
    """Leave of each wall on a plane the two rows of cells that its echoes say most of; the others are ambiguous (-2).

    A wall has no more rows than two, where it runs on the border between them. `corner` (x, y) in cells is that of
    `percent` and `out` (ny, nx), of which cells from `least` on are wall.
    """
    ny, nx = percent.shape
    deep = 3
    hits = np.empty(2 * deep + 1)
    for iy in range(ny):
        for ix in range(nx):
            if percent[iy, ix] < least:
                continue
            x, y = ix + corner[0], iy + corner[1]
            facing = pools.facing[pools.slots[0, y // edge, x // edge], cell_index(x, y, 0, edge, 1)]
            if facing == NOWHERE:
                continue
            sx, sy = _step_to(facing)
            hits[:] = 0.0
            for k in range(-deep, deep + 1):
                jx, jy = ix + k * sx, iy + k * sy
                if 0 <= jx < nx and 0 <= jy < ny and percent[jy, jx] >= least:
                    x, y = jx + corner[0], jy + corner[1]
                    hits[k + deep] = pools.hits[pools.slots[0, y // edge, x // edge], cell_index(x, y, 0, edge, 1)]
            first, last = deep, deep
            while first > 0 and hits[first - 1] > 0.0:
                first -= 1
            while last < 2 * deep and hits[last + 1] > 0.0:
                last += 1
            best, top = first, -1.0
            for k in range(first, last):
                if hits[k] + hits[k + 1] > top:
                    best, top = k, hits[k] + hits[k + 1]
            if last > first + 1 and deep != best and deep != best + 1:
                out[iy, ix] = -2


@inner()
def _step_to(side: int) -> tuple[int, int]:
    """The neighbour, as steps along x and y, that lies in one of the 16 directions of `side_of` on a plane."""
    turn = (side + 0.5) / 4.0
    dy = turn if turn < 1.0 else 2.0 - turn if turn < 3.0 else turn - 4.0
    dx = 1.0 - abs(dy)
    if 1.0 <= turn < 3.0:
        dx = -dx
    slope = 0.4142 * max(abs(dx), abs(dy))
    return (0 if abs(dx) < slope else 1 if dx > 0 else -1), (0 if abs(dy) < slope else 1 if dy > 0 else -1)


@loop(fastmath=True)
def in_view(solid: np.ndarray, cells: np.ndarray, eyes: np.ndarray, skip: float, out: np.ndarray) -> None:
    """Whether each cell (c, 3: z, y, x) can be seen from one of the eyes (e, 3), both in cells, past `solid` ones."""
    nz, ny, nx = solid.shape
    for c in range(len(cells)):
        for e in range(len(eyes)):
            dz, dy, dx = eyes[e, 0] - cells[c, 0], eyes[e, 1] - cells[c, 1], eyes[e, 2] - cells[c, 2]
            length = math.sqrt(dz * dz + dy * dy + dx * dx)
            clear, way = True, skip
            while way < length:
                part = way / length
                z = math.floor(cells[c, 0] + part * dz + 0.5)
                y, x = math.floor(cells[c, 1] + part * dy + 0.5), math.floor(cells[c, 2] + part * dx + 0.5)
                if 0 <= z < nz and 0 <= y < ny and 0 <= x < nx and solid[z, y, x]:
                    clear = False
                    break
                way += 0.7
            if clear:
                out[c] = True
                break
