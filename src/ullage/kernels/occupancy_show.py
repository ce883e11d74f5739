"""From the mapper's blocks to percent, and what the flight could see of it."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import loop
from ullage.kernels.occupancy import EMPTY, SCALE, Pools, bit_count, cell_index


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
