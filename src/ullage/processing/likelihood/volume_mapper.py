"""The likelihood mapper of volumes: as that of planes, with directions in space and rivals for each surface."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ullage import checks
from ullage.antenna import cube
from ullage.arrays import Bools, Floats
from ullage.data import Recording
from ullage.grids import UNKNOWN, Grid, MappedSurface, OccupancyMap
from ullage.processing.baseband import as_baseband
from ullage.processing.intake import in_order
from ullage.processing.inverse_sensor import mirror_m
from ullage.processing.likelihood.directions import DirectionFinder
from ullage.processing.likelihood.keyframes import Keyframe
from ullage.processing.likelihood.mapper import CELL_M, LikelihoodMapper
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.volume_map import render, smoothed
from ullage.processing.likelihood.volume_silence import Radar, VolumeSilence
from ullage.processing.likelihood.volume_surfaces import SpatialSurface, SpatialTracker


class VolumeMapper(LikelihoodMapper):
    """Streaming mapper of a volume by one likelihood.

    Args:
        grid: a volume that holds the flight.
        spec: parameters; None: the defaults.
        floor_z_m: height of a level floor [m], a known surface that takes its echoes; None: none is known.
        vehicle_radius_m: radius of the ball about the antenna that the vehicle fills, and so shows free [m]; None: that
            of `spec`.

    Raises:
        InputError: the grid is too large, the radius is not a positive number, or the floor's height not a finite one.
    """

    def __init__(
        self,
        grid: Grid,
        *,
        spec: LikelihoodSpec | None = None,
        floor_z_m: float | None = None,
        vehicle_radius_m: float | None = None,
    ) -> None:
        grid.check_memory(60, "the map")
        self._finder = DirectionFinder(spec := self._set_up(grid, spec, vehicle_radius_m))
        self._pose_errors, self._mount_errors = self._finder.pose_errors, self._finder.mount_errors
        floor = None if floor_z_m is None else checks.number("floor_z_m", floor_z_m, "mapper")
        self._space = SpatialTracker(spec, floor)
        self._cubes: dict[str, Floats] = {}
        self._mirror_m = np.inf
        self._places: dict[tuple[int, ...], None] = {}
        self._quiet = VolumeSilence(grid, spec)

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, phase of some sensors only, another carrier, a sample that is not finite, or a flight
                that leaves the grid.
        """
        parts = [as_baseband(part) for part in in_order(frames, self.grid)]
        for part in parts:
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
        known = self._space.known(key.position)
        cubes = np.stack([self._cubes[name] for name in key.names])
        echoes = yield from self._finder.steps(key, cubes, known)
        yield
        number = self._space.update(echoes, self._mirror_m)
        if key.aperture.phase:
            self._quiet.add(echoes, number)

    def _rendered(self) -> tuple[OccupancyMap, tuple[MappedSurface, ...]]:
        self._work.finish()
        surfaces = self._space.confirmed()
        flown = (np.array(list(self._places), float).reshape(-1, 3) + 0.5) * CELL_M
        if not len(flown):
            unknown = np.full(self.grid.shape, UNKNOWN, np.int8)
            return OccupancyMap(self.grid, unknown, "likelihood"), ()
        radar = Radar(self._wavelength_m, self._fold_m, self._mirror_m)
        omap, kept = render(self.grid, surfaces, self._quiet, flown, radar, self.spec)
        return omap, _mapped(surfaces, kept)


def _mapped(surfaces: list[SpatialSurface], kept: Bools) -> tuple[MappedSurface, ...]:
    out = []
    for one, on_map in zip(surfaces, kept, strict=True):
        place = np.array([seen.position for seen in one.sightings.values()])
        state, _ = smoothed(one)
        spread = np.zeros((5, 4))
        spread[0, 0] = spread[4, 3] = 1.0
        spread[1:4, 1:3] = one.frames[one.leader].T
        covariance = spread @ one.covariances[one.leader] @ spread.T
        given = one.position, one.states[one.leader], covariance, one.log_odds, len(place), bool(on_map)
        unit = state[:, 1:4]
        out.append(MappedSurface(one.kind, *given, place + state[:, :1] * unit, -unit))
    return tuple(out)
