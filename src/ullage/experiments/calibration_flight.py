"""A calibration flight that separates all nine quantities, and tables of what a flight and a recording tell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ullage.arrays import Floats
from ullage.data import Calibration, Trajectory, sensors_of, strung
from ullage.errors import InputError
from ullage.flight.missions import Waypoints
from ullage.flight.vehicle import fly
from ullage.ports.registry import open as open_source
from ullage.ports.tracked import TRACK_FILES, RailSource, read_radar_track
from ullage.ports.tracks import read_survey
from ullage.processing.calibrate import calibrate
from ullage.processing.calibration_plan import CalibrationPlan, plan_calibration, quantities
from ullage.specs import RadarSpec

REST_NS = 2_000_000_000
REFLECTORS = ((3.0, -1.5, 1.2), (3.0, 1.5, 1.8), (-3.5, 0.0, 1.5), (0.0, 4.5, 1.2))
SEPARATED = 0.71  # of a prior sigma: above it the echoes add less than was known before
BESIDE_M = 2.0
"""Distance of assumed reflectors from the box around a track."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One leg: what it is, what it separates, its waypoints (x, y, z, yaw) and its speed."""

    what: str
    why: str
    points: tuple[tuple[float, float, float, float], ...]
    speed_m_s: float = 0.6
    acceleration_m_s2: float = 0.8


def _climbs(x: float, y: float, yaw: float) -> tuple[tuple[float, float, float, float], ...]:
    low, high = (x, y, 0.3, yaw), (x, y, 2.7, yaw)
    return low, high, low, high, low, high, low


LEGS = (
    Leg("to each reflector, with turns", "course, distance and bearing change: clock, lever arm, boresight sideways",
        ((0, -2, 1.5, 0), (1.7, -1.5, 1.5, 0), (-1.7, 0, 1.5, 180), (0, 2.5, 1.5, 90), (0, -2, 1.5, 0))),
    Leg("climbs close to each reflector", "elevations change: boresight upward, range zero, scale",
        ((0, -2, 1.5, 0), *_climbs(1.8, -1.5, 0), *_climbs(1.8, 1.5, 0), *_climbs(0, 3.3, 90), *_climbs(-2.3, 0, 180),
         (0, -2, 1.5, 0))),
    Leg("short fast dashes", "the body pitches and rolls: height of the antenna",
        ((0, -2, 1.5, 0), (0.8, -2, 1.5, 0), (0, -2, 1.5, 0), (0, -1.2, 1.5, 0), (0, -2, 1.5, 0)), 1.5, 3.0),
)  # fmt: skip


def calibration_flight() -> list[Trajectory]:
    """Fly the legs with a multirotor, one after the other."""
    out: list[Trajectory] = []
    for leg in LEGS:
        points = Waypoints(np.array(leg.points, float), leg.speed_m_s, stop=True, hold_s=1.0,
                           acceleration_m_s2=leg.acceleration_m_s2)  # fmt: skip
        flown = fly(points)
        start = int(out[-1].t_ns[-1]) + REST_NS if out else 0
        velocity, spin = flown.rates
        out.append(Trajectory(flown.t_ns - flown.t_ns[0] + start, flown.position, flown.quat_xyzw, velocity, spin))
    return out


def beside(track: Trajectory) -> Floats:
    """Places (4, 3) of reflectors at the corners of a box around a track, low and high in turn."""
    low, high = track.position.min(0) - BESIDE_M, track.position.max(0) + BESIDE_M
    z = track.position[:, 2].mean() + np.array([-0.7, 0.7])
    return np.array(
        [[low[0], low[1], z[0]], [low[0], high[1], z[1]], [high[0], high[1], z[0]], [high[0], low[1], z[1]]]
    )


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A flight, its reflectors, and what their echoes will tell."""

    what: str
    legs: list[Trajectory]  # one, unless it is the flight of this module
    spec: RadarSpec
    places: Floats  # (r, 3) world [m]

    def plan(self, *, surveyed: bool = True, but: int | None = None) -> CalibrationPlan:
        """Predict the sigmas, with or without a survey of the reflectors, or but for one leg."""
        legs = [leg for k, leg in enumerate(self.legs) if k != but]
        survey = {} if surveyed else {"survey_sigma_m": float("inf")}
        return plan_calibration(strung(legs), self.spec, self.places, **survey)

    def leg_rows(self) -> list[tuple[str, ...]]:
        """Rows of a table: each leg, its length, its reason, and what suffers most without it."""
        rows: list[tuple[str, ...]] = []
        whole = self.plan()
        for k, (leg, flown) in enumerate(zip(LEGS, self.legs, strict=False) if len(self.legs) > 1 else ()):
            growth = self.plan(but=k).sigma / whole.sigma
            worst = whole.quantities[int(growth.argmax())].name
            rows.append((leg.what, f"{flown.duration_s:.0f} s", leg.why, f"{worst}: {growth.max():.1f} times"))
        return rows

    def rows(self) -> list[tuple[str, ...]]:
        """Rows of a table: each quantity, the wanted sigma, and those predicted with and without a survey."""
        plans = self.plan(), self.plan(surveyed=False)
        return [
            (one.name, f"{one.wanted * one.factor:.3g} {one.unit}", *(_shown(s * one.factor, one.unit) for s in sigma))
            for one, *sigma in zip(plans[0].quantities, *(plan.sigma for plan in plans), strict=True)
        ]

    def verdicts(self) -> list[str]:
        """Sentences on what the echoes do not determine, with and without a survey."""
        out = []
        for name, surveyed in (("places surveyed", True), ("places unknown", False)):
            open_ones = "; ".join(self.plan(surveyed=surveyed).undetermined)
            out.append(f"{name}: {f'not within the wanted sigma: {open_ones}' if open_ones else 'all nine determined'}")
        return out


def _shown(value: float, unit: str) -> str:
    return "not shown" if not np.isfinite(value) else f"{value:.2g} {unit}" if value < 100 else f"{value:.0f} {unit}"


def planned(source: str, *, reflectors: Path | None, radar: str) -> Planned:
    """Take a flight from a file of a track, from a recording, or, without a source, from this module.

    Args:
        source: file of a track, recording, or nothing.
        reflectors: file of surveyed places; None: four places beside the track.
        radar: preset of the radar, where the source has none.

    Raises:
        InputError: a file cannot be read, or holds no track.
    """
    spec, path = RadarSpec.preset(radar), Path(source)
    if not source:
        legs, places = calibration_flight(), np.array(REFLECTORS)
    elif path.suffix.lower() in TRACK_FILES:
        legs = [read_radar_track(path)]
    else:
        recording = open_source(source)
        spec, found = sensors_of(recording.frames())[0].spec, recording.trajectory()
        if found is None:
            raise InputError("the recording has no track", where=source, allowed="a recording with one, or its file")
        legs = [found]
    if reflectors is not None:
        places = read_survey(reflectors).places
    elif source:
        places = beside(legs[0])
    return Planned(source or "the calibration flight", legs, spec, places)


def found_in(source: str, reflectors: Path | None) -> dict[str, Calibration]:
    """Calibrate each radar of a recording, from its echoes or from surveyed reflectors.

    Raises:
        CalibrationError: the recording does not decide.
        InputError: it cannot be read, or has no track.
    """
    places = None if reflectors is None else read_survey(reflectors).places
    recording = open_source(source)
    floor_z_m = recording.floor_z_m if isinstance(recording, RailSource) else None
    each = {
        one.sensor: calibrate(one, reflectors=places, floor_z_m=floor_z_m) for one in sensors_of(recording.frames())
    }
    return {name: frames.calibration for name, frames in each.items() if frames.calibration is not None}


def offset_rows(found: Calibration) -> list[tuple[str, str, str]]:
    """Rows of a table: each estimate with its sigma, and which ones the echoes leave as they were assumed."""
    scale = f"{found.scale_sigma:.3f}" if found.scale_sigma else "not estimated"
    rows = [
        ("clock, pose clock less radar clock", f"{found.t_offset_s:+.4f} s", f"{found.t_sigma_s:.4f} s"),
        ("range, added to the range axis", f"{found.range_offset_m:+.3f} m", f"{found.range_sigma_m:.3f} m"),
        ("scale of the track, not applied", f"{found.scale:.3f}", scale),
    ]
    for one, (value, sigma, assumed) in zip(quantities(RadarSpec()), found.estimates, strict=False):
        known = f"{sigma * one.factor:.2g} {one.unit}" if sigma < assumed * SEPARATED else "not separated"
        rows.append((f"joint: {one.name}", f"{value * one.factor:+.4g} {one.unit}", known))
    return rows
