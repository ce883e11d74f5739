"""Map files of a run: written at its end, and every minute of a long one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ullage.flow import Sink
from ullage.grids import OccupancyMap

EVERY_S = 60.0
"""Between two maps that are saved while a run goes on [s]."""
PICTURE_S = 10.0
"""A run that takes longer draws a picture of its map this long after its start [s]."""


@dataclass(slots=True)
class MapSaver(Sink):
    """A sink that saves the map so far, so that a kill leaves one that is at most a minute old.

    Attributes:
        folder: of the run.
        every_s: between two maps, by the wall clock [s].
        draw: draws the first picture of a run that takes long.
    """

    gathers: ClassVar[bool] = True
    folder: Path
    every_s: float = EVERY_S
    draw: Callable[[OccupancyMap], None] | None = None
    _saved_s: float = -float("inf")
    _started_s: float = field(init=False)

    def __post_init__(self) -> None:
        self._started_s = time.monotonic()

    def write(self, item: Any) -> None:
        """Save a map if the last one is old enough; everything else passes by.

        Raises:
            InputError: the disk is full.
        """
        if isinstance(item, OccupancyMap) and time.monotonic() - self._saved_s >= self.every_s:
            write_map_files(self.folder, item)
            self._saved_s = time.monotonic()
        if isinstance(item, OccupancyMap) and self.draw and time.monotonic() - self._started_s >= PICTURE_S:
            self.draw(item)
            self.draw = None


def write_map_files(folder: Path, omap: OccupancyMap) -> None:
    """Write a plane as map_server files, a volume as an OctoMap tree and as points, each whole or not at all.

    Raises:
        InputError: the disk is full.
    """
    from ullage.ports.maps import write_map_server
    from ullage.ports.octomap import write_octomap
    from ullage.ports.ply import write_ply

    if omap.grid.dims == 2:
        write_map_server(omap, folder / "map.yaml")
    else:
        write_octomap(omap, folder / "map.bt")
        write_ply(omap, folder / "map.ply")
