"""The likelihood mapper of volumes: as that of planes, with directions in space and rivals for each surface."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ullage.antenna import cube
from ullage.arrays import Bools, Floats
from ullage.data import Recording
from ullage.errors import InputError
from ullage.grids import Changes, Grid, MappedSurface, OccupancyMap
from ullage.processing.baseband import as_baseband
from ullage.processing.inverse_sensor import mirror_m
from ullage.processing.likelihood.directions import DirectionFinder
from ullage.processing.likelihood.keyframes import Keyframe, KeyframeSelector
from ullage.processing.likelihood.mapper import CELL_M, LikelihoodMapper
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.volume_map import Quiet, Radar, quiet_of, render
from ullage.processing.likelihood.volume_surfaces import SpatialSurface, SpatialTracker
from ullage.processing.likelihood.workload import Workload
from ullage.processing.mapper_door import in_order, radius_of_vehicle

QUIET_M = 0.1  # places whose silence is kept apart


class VolumeMapper(LikelihoodMapper):
    """Streaming mapper of a volume by one likelihood.

    Args:
        grid: a volume that holds the flight.
        spec: parameters; None: the defaults.
        vehicle_radius_m: radius of the ball about the antenna that the vehicle fills, and so shows free [m]; None: that
            of `spec`.

    Raises:
        InputError: the grid is too large, or the radius is not a positive number.
    """

    def __init__(
        self, grid: Grid, *, spec: LikelihoodSpec | None = None, vehicle_radius_m: float | None = None
    ) -> None:
        grid.check_memory(60, "the map")
        self.grid = grid
        self.spec = spec or LikelihoodSpec()
        if vehicle_radius_m is not None:
            self.spec = replace(self.spec, vehicle_m=radius_of_vehicle(vehicle_radius_m))
        self._keyframes = KeyframeSelector(self.spec)
        self._finder = DirectionFinder(self.spec)
        self._space = SpatialTracker(self.spec)
        self._work = Workload()
        self._cubes: dict[str, Floats] = {}
        self._mirror_m = np.inf
        self._wavelength_m = self._fold_m = 0.0
        self._places: dict[tuple[int, ...], None] = {}
        self._quiet: dict[tuple[int, ...], Quiet] = {}
        self._phase: bool | None = True
        self._published: OccupancyMap | None = None

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, no phase, another carrier, a sample that is not finite, or a flight that leaves the
                grid.
        """
        parts = [as_baseband(part) for part in in_order(frames, self.grid)]
        for part in parts:
            if not np.iscomplexobj(part.samples):
                raise InputError(
                    "the likelihood map of a volume needs samples with phase",
                    where=part.sensor,
                    allowed="complex baseband or RF; a plane; or method='ullage'",
                )
            self._check(part)
        for part in parts:
            for place in np.floor(part.believed.position / CELL_M).astype(int).tolist():
                self._places[tuple(place)] = None
            self._cubes.setdefault(part.sensor, cube(part.spec.antenna))
            self._mirror_m = mirror_m(part)
            self._keyframes.add(part)
        self._take_in(finish=False)
        self._work.spend(sum(len(part) for part in parts))

    def _explained(self, key: Keyframe) -> Iterator[None]:
        """What a keyframe adds to the surfaces and to silence, in steps of work."""
        echoes = self._finder.find(key, np.stack(list(self._cubes.values())), self._space.known(key.position))
        yield
        number = self._space.update(echoes, self._mirror_m)
        self._quiet[tuple(np.floor(key.position / QUIET_M).astype(int).tolist())] = quiet_of(echoes, number)

    def _drawn(self) -> tuple[OccupancyMap, list[SpatialSurface], Bools]:
        self._work.finish()
        surfaces = self._space.confirmed()
        flown = (np.array(list(self._places), float).reshape(-1, 3) + 0.5) * CELL_M
        if not len(flown):
            return OccupancyMap(self.grid, np.full(self.grid.shape, -1, np.int8), "likelihood"), [], np.zeros(0, bool)
        radar = Radar(np.stack(list(self._cubes.values())), self._wavelength_m, self._fold_m, self._mirror_m)
        omap, kept = render(self.grid, surfaces, list(self._quiet.values()), flown, radar, self.spec)
        return omap, surfaces, kept

    def surfaces(self) -> list[MappedSurface]:
        """None: a surface of a volume has another state than one of a plane."""
        return []

    @property
    def pose_sigma_m(self) -> float:
        """0: errors of the poses are not estimated in a volume [m]."""
        return 0.0

    def map(self) -> OccupancyMap:
        """The map so far."""
        return self._drawn()[0]

    def changed(self) -> Changes:
        """The blocks in which the map differs from that of the last call."""
        now = self.map()
        out = now.changes(self._published)
        self._published = now
        return out
