"""The likelihood mapper of a plane or of a volume, by the grid."""

from __future__ import annotations

from ullage.grids import Grid
from ullage.processing.likelihood.mapper import LikelihoodMapper
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.volume_mapper import VolumeMapper


def likelihood_mapper(
    grid: Grid,
    *,
    spec: LikelihoodSpec | None = None,
    floor_z_m: float | None = None,
    vehicle_radius_m: float | None = None,
) -> LikelihoodMapper:
    """A mapper of a plane or of a volume.

    Args:
        grid: what it maps.
        spec: parameters; None: the defaults.
        floor_z_m: height of a level floor, a known surface [m]; None: none is known.
        vehicle_radius_m: radius of the ball about the antenna that the vehicle fills [m]; None: that of `spec`.

    Raises:
        InputError: an option is out of bounds.
    """
    mapper = LikelihoodMapper if grid.dims == 2 else VolumeMapper
    return mapper(grid, spec=spec, floor_z_m=floor_z_m, vehicle_radius_m=vehicle_radius_m)
