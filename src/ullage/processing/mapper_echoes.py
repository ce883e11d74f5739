"""An echo of one keyframe in the mapper by rules, and its specular point once its direction is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ullage.antenna import BoresightPattern, boresight_pattern
from ullage.arrays import Floats
from ullage.specs import AntennaSpec

LEAST_RIM = 2.0  # Fresnel parameter out to which no edge stands, at the least


@dataclass(slots=True, eq=False)
class Echo:
    """One echo of one keyframe."""

    t_ns: int
    position: Floats  # (3) of the sensor
    track: Floats  # (3) unit vector along the track
    range_m: float
    cosine: float
    height: float
    sigma: float
    trust: float
    ahead: Floats = field(default_factory=lambda: np.zeros(3))  # (3) boresight
    within: float = -1.0  # cosine to it below which no flat surface returns this level
    looks: float = 1.0  # keyframes of a dense flight that it counts for, by the metre flown
    level_db: float = np.inf  # against a perfect mirror's with an antenna of 0 dBi; infinite where unknown
    laid: bool = False
    way: Floats | None = None  # (3) to the wall that it is assigned to
    sensor: str = ""
    pattern: BoresightPattern = field(default_factory=lambda: boresight_pattern(AntennaSpec()))  # of the sensor


@dataclass(frozen=True, slots=True, eq=False)
class SpecularPoint:
    """An echo whose direction is known."""

    echo: Echo
    way: Floats  # (3) unit vector to the surface
    flat: bool  # a wall, not an edge or a pole
    rim: float = LEAST_RIM  # Fresnel parameter out to which the surface goes on
    radius_m: float = np.inf  # of a hollow wall [m]
    post: Floats | None = None  # (3) unit vector along a post or edge that is known as a whole

    @property
    def at(self) -> Floats:
        """Its place (3) [m]."""
        return np.asarray(self.echo.position + self.echo.range_m * self.way)
