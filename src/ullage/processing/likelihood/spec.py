"""The numbers of the likelihood mapper, each with its meaning, unit and reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ullage.errors import InputError


@dataclass(frozen=True, slots=True)
class LikelihoodSpec:
    """Parameters of the likelihood mapper.

    Raises:
        InputError: a number is not finite, or not above zero.
    """

    # keyframes and matched sums
    keyframe_m: float = 0.06  # track between keyframes: a quarter of the window, so that a surface is seen often
    window_m: float = 0.22  # half length of the aperture: a lobe of 5 deg at 7.3 GHz, short enough for round walls
    spacing_m: float = 0.015  # least track between frames that count
    directions: int = 108  # bearings of the first search, every 3.3 deg: less than the width of the aperture's lobe
    most_curvature: float = 3.0  # greatest curvature of the range along the track [1/m]
    most_echoes: int = 12  # of one keyframe
    least_snr: float = 20.0  # explained energy over noise; noise alone exceeds it in 2e-9 of all sums
    model_error: float = 0.02  # share of an echo's energy that the model leaves behind near its range
    slope_nats: float = 40.0  # that a slope must explain more than an upright reflector; rows are not independent
    known_nats: float = 12.0  # by which a known surface is preferred to a new hypothesis for the same echo
    # surfaces
    least_coherence: float = 0.5  # share of the energy that an echo must explain to start a surface
    phase_sigma_rad: float = 0.6  # error of a sample's phase against the model, which sets the errors of bearings
    envelope_sigma: float = 0.15  # error of a sample's range by its envelope alone, in standard deviations of the pulse
    range_sigma_m: float = 0.012  # of an echo's range: a quarter of a range bin
    bearing_sigma_deg: float = 0.5  # added to what the phases give
    curvature_sigma: float = 0.1  # the same of the curvature [1/m]
    cosine_sigma: float = 0.001  # the same of the cosine of the elevation
    process_noise: float = 1.0  # variance by which surfaces may bend; 1: (0.6 mm, 0.1 deg, 0.015 /m)^2 a keyframe
    upright_nats: float = 20.0  # by which an upright surface is preferred to a slope at first: most are upright
    gate: float = 12.0  # greatest squared Mahalanobis distance of an echo: 99 % of three parameters
    echo_cost: float = 6.0  # nats that an echo must explain before it speaks for a surface
    dependence_m: float = 0.4  # track after which an echo counts in full: the length of the window
    least_odds: float = 30.0  # log-odds of a surface on the map
    least_lead: float = 6.0  # nats by which the direction of a surface must lead its rivals: odds of 400 to 1
    least_keyframes: int = 3  # of a surface on the map
    # cells
    evidence: float = 1.5  # sum of the weights of echoes in an occupied cell
    plane_odds: float = 2.19  # that a cell with an evidence of 1 holds surface; these numbers are fitted [Platt1999]
    volume_odds: float = 1.07  # the same in a volume, where one echo shows more cells
    odds_power: float = 0.75  # of the evidence in these odds
    crossed_nats: float = 11.8  # that echoes from behind take, if stronger and as many as the cell's own
    free_odds: float = 0.0069  # that a free cell without silence holds surface
    free_nats: float = 10.8  # of silence that divide these odds by e: looks from near places are not independent
    support: float = 1.0  # half width of what one echo shows of a surface, in radii of the first Fresnel zone
    tube: float = 0.6  # half width of the free space before an echo of full level, in Fresnel radii: an edge costs none
    margin_m: float = 0.05  # before an echo that is not declared free: its range's errors, and roughness
    vehicle_m: float = 0.25  # radius about the antenna that the vehicle fills
    extension_m: float = 1.0  # how far a surface may go on unseen where an echo passes
    least_obstacle_m: float = 0.05  # diameter of the thinnest upright pole that silence excludes
    silence: float = 4.6  # nats from which silence excludes it: 99 %

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value) or value <= 0:
                raise InputError(f"{field.name} is {value!r}", where="LikelihoodSpec", allowed="a number above 0")
