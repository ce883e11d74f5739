"""The likelihood mapper: keyframes, their echoes, surfaces that explain these, and cells rendered from surfaces."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ullage import checks
from ullage.arrays import Bools
from ullage.data import Frames, Recording
from ullage.errors import InputError, UllageWarning
from ullage.grids import Changes, Grid, MappedSurface, OccupancyMap
from ullage.processing.baseband import as_baseband
from ullage.processing.intake import in_order, plane_of, radius_of_vehicle
from ullage.processing.likelihood.cells import render
from ullage.processing.likelihood.echoes import LEAST_ROWS, EchoFinder
from ullage.processing.likelihood.keyframes import Keyframe, KeyframeSelector
from ullage.processing.likelihood.lying import cut_or_foot
from ullage.processing.likelihood.silence import Silence
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.surfaces import Surface, SurfaceTracker, smoothed
from ullage.processing.likelihood.workload import Workload

CELL_M = 0.05  # places of the track are kept apart by as much
STRAIGHT_DOWN = -1.0, 0.0, 0.0, 0.0, 0.0  # a level floor's bearing, curvature and cosine; it has one state only


class LikelihoodMapper:
    """Streaming mapper of a plane by one likelihood.

    It predicts what each known surface would return, associates echoes with the predictions, updates the surfaces, and
    renders cells from them. All radars have one carrier, and all have phase, or none has.

    Args:
        grid: a plane that holds the flight; without a height it takes that of the first frames. Where one is given,
            the vehicle clears only what it fills at that height.
        spec: parameters; None: the defaults.
        floor_z_m: height of a level floor [m], a known surface that explains its echoes; None: none is known.
        vehicle_radius_m: radius of the ball about the antenna that the vehicle fills, and so shows free [m]; None: that
            of `spec`.

    Raises:
        InputError: the grid is a volume, the radius is not a positive number, or the floor's height not a finite one.
    """

    def __init__(
        self,
        grid: Grid,
        *,
        spec: LikelihoodSpec | None = None,
        floor_z_m: float | None = None,
        vehicle_radius_m: float | None = None,
    ) -> None:
        if grid.dims != 2:
            raise InputError("this mapper maps a plane", where="grid", allowed="a grid with dims=2, or VolumeMapper")
        grid.check_memory(40, "the map")
        self._echoes = EchoFinder(spec := self._set_up(grid, spec, vehicle_radius_m))
        self._pose_errors, self._mount_errors = self._echoes.pose_errors, self._echoes.mount_errors
        self._floor_z_m = None if floor_z_m is None else checks.number("floor_z_m", floor_z_m, "mapper")
        self._tracker = SurfaceTracker(spec)
        self._silence = Silence(grid, spec)
        self._flown: dict[tuple[int, int], None] = {}  # places where the vehicle was in the plane
        self._height_m = grid.origin_m[2]

    def _set_up(self, grid: Grid, spec: LikelihoodSpec | None, vehicle_radius_m: float | None) -> LikelihoodSpec:
        """Set what planes and volumes share; return the parameters."""
        self.grid, self.spec = grid, spec or LikelihoodSpec()
        if vehicle_radius_m is not None:
            self.spec = replace(self.spec, vehicle_m=radius_of_vehicle(vehicle_radius_m))
        self._keyframes, self._work = KeyframeSelector(self.spec), Workload()
        self._wavelength_m, self._fold_m = 0.0, np.inf
        self._phase: bool | None = None
        self._apertures = self._thin = 0  # keyframes, and those with too few frames for a search
        self._published: OccupancyMap | None = None
        return self.spec

    def update(self, frames: Recording) -> None:
        """Add frames of one or several sensors.

        Raises:
            InputError: no poses, no phase, another carrier, a sample that is not finite, or a flight that leaves the
                grid.
        """
        parts = [as_baseband(part) for part in in_order(frames, self.grid)]
        for part in parts:
            self._check(part)
        self.grid = plane_of(self.grid, parts)
        for part in parts:
            place = part.believed.position
            here = ~(np.abs(place[:, 2] - self._height_m) > self.spec.vehicle_m)  # all, of a plane without a height
            for x, y in np.floor(place[here, :2] / CELL_M).astype(int).tolist():
                self._flown[x, y] = None
            self._keyframes.add(part)
        self._take_in(finish=False)
        self._work.spend(sum(len(part) for part in parts))

    def _check(self, part: Frames) -> None:
        phase = np.iscomplexobj(part.samples)
        self._phase = phase if self._phase is None else self._phase
        if phase != self._phase:
            raise InputError(
                "its samples have no phase, but another sensor's have"
                if self._phase
                else "its samples have phase, but another sensor's have not",
                where=part.sensor,
                allowed="samples with phase of all sensors, or amplitudes of all",
            )
        self._wavelength_m = self._wavelength_m or part.spec.wavelength_m
        staggered = part.spec.stagger_div not in (None, part.spec.prf_div)
        if not staggered:  # else the keyframes have true ranges
            self._fold_m = min(self._fold_m, part.spec.unambiguous_range_m)
        if part.spec.wavelength_m != self._wavelength_m:
            raise InputError(
                f"its carrier differs from the other sensors' ({part.spec.center_hz:g} Hz)",
                where=part.sensor,
                allowed="one center_hz for all sensors; or one map for each carrier",
            )

    def _take_in(self, *, finish: bool) -> None:
        for key in self._keyframes.ready(finish=finish):
            self._apertures += 1
            self._thin += len(key.aperture.offset) < LEAST_ROWS
            self._work.add(self._explained(key))

    def _explained(self, key: Keyframe) -> Iterator[None]:
        """What a keyframe adds to the surfaces, in steps of work."""
        known = self._tracker.known(key.position)
        if self._floor_z_m is not None:
            # first, for a surface that is given takes what another one would explain as well
            known = np.vstack([[key.position[2] - self._floor_z_m, *STRAIGHT_DOWN], known])
        echoes = yield from self._echoes.steps(key, known)
        yield
        self._tracker.update(echoes)
        self._silence.add(key, echoes, self._echoes.left, self._pose_errors.sigma_m)

    def finish(self) -> None:
        """Use the frames that waited for a complete aperture."""
        self._take_in(finish=True)
        self._work.finish()
        if self._thin and self._thin > self._apertures / 2:
            text = f"most places have fewer than {LEAST_ROWS} frames within {2 * self.spec.window_m:g} m of track, so "
            text += "nothing is mapped there; fly slower, or record more frames a second"
            warnings.warn(text, UllageWarning, stacklevel=3)

    def _rendered(self) -> tuple[OccupancyMap, tuple[MappedSurface, ...]]:
        """Return the map so far, and its surfaces."""
        self._work.finish()
        surfaces = self._tracker.confirmed()
        flown = (np.array(list(self._flown), float).reshape(-1, 2) + 0.5) * CELL_M
        radar = self._wavelength_m, self._fold_m
        omap, kept = render(self.grid, surfaces, flown, self._silence, *radar, self.spec)
        return omap, _mapped(surfaces, kept)

    def map(self) -> OccupancyMap:
        """The map so far, with its surfaces."""
        omap, surfaces = self._rendered()
        return OccupancyMap(omap.grid, omap.tiles, omap.method, surfaces=surfaces)

    def surfaces(self) -> list[MappedSurface]:
        """The surfaces that are sure so far, in order of their first echo."""
        return list(self._rendered()[1])

    @property
    def pose_sigma_m(self) -> float:
        """White error of one coordinate of the positions, as the latest echoes show it (standard deviation) [m]."""
        self._work.finish()
        return self._pose_errors.sigma_m

    @property
    def mount_coherence(self) -> float:
        """Coherence of the radars with each other, as the latest echoes show it: 1 where the mounts are as stated."""
        self._work.finish()
        return self._mount_errors.coherence

    def changed(self) -> Changes:
        """The blocks in which the map differs from that of the last call."""
        now = self._rendered()[0]
        out = now.changes(self._published)
        self._published = now
        return out


def _mapped(surfaces: list[Surface], kept: Bools) -> tuple[MappedSurface, ...]:
    out = []
    for one, on_map in zip(surfaces, kept, strict=True):
        place = np.array([seen.position for seen in one.sightings.values()])
        state, _ = smoothed(one)
        normal = -np.stack([np.cos(state[:, 1]), np.sin(state[:, 1])], axis=1)
        given = one.position, one.state, one.covariance, one.log_odds, len(place), bool(on_map)
        far = cut_or_foot(state) if one.lying else state[:, 0]
        out.append(MappedSurface(one.kind, *given, place - far[:, None] * normal, normal))
    return tuple(out)
