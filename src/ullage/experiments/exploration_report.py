"""Judge an exploring flight by the true world: what it mapped of all that could be mapped, and what it missed and why.

The denominator does not depend on the flight. It is the surface that the radars could observe from anywhere in the
space that the vehicle fits into at the height of the flight and that is connected with its start.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from ullage.arrays import Bools, Floats
from ullage.data import Frames, Metric, Trajectory
from ullage.errors import InputError
from ullage.experiments.exploration import Exploration
from ullage.experiments.radar_poses import of_flight
from ullage.flight.airframe import airframe
from ullage.flight.obstacles import bodies, into
from ullage.flight.random_flights import LATTICE_M
from ullage.flight.tour import level_at
from ullage.geometry import rpy_quat
from ullage.grids import Grid, OccupancyMap
from ullage.processing.metrics import on_map
from ullage.processing.truth import Surface, surface_of
from ullage.specs import Rig
from ullage.world.scene import Scene

MOST_POSES = 300
"""Places of the reachable space from which surfaces are looked for."""
HEADINGS_RAD = (0.0, math.pi / 4)
SHARES = (0.25, 0.5, 0.75, 1.0)
"""Moments of a flight, as shares of it, at which the mapped surface is given."""


def reachable(scene: Scene, start: Floats, *, clearance_m: float, vehicle: str = "hector") -> Floats:
    """Return places (n, 3) on a lattice that a vehicle reaches from its start at its height, with a clearance [m].

    Raises:
        InputError: the start itself has less room.
    """
    level = level_at(scene, float(start[2]), vehicle=vehicle)
    part, _ = label(level.gap_m >= clearance_m)
    here = np.rint((start[:2] - level.corner_m) / LATTICE_M).astype(int)[::-1]
    cells = np.argwhere(part > 0)
    if not len(cells):
        raise InputError(f"no space with {clearance_m:g} m of room at the height of the start", where="explore")
    nearest = cells[np.argmin(np.abs(cells - here).sum(1))]
    return level.points(np.argwhere(part == part[tuple(nearest)]))


def observable_from(scene: Scene, grid: Grid, rig: Rig, places: Floats) -> Surface:
    """Return the surface on a plane, with the views that radars would have of it from places (n, 3) [m]."""
    some = places[:: max(1, -(-len(places) // MOST_POSES))]
    at = np.repeat(some, len(HEADINGS_RAD), 0)
    path = Trajectory(np.arange(len(at)) * 1_000_000, at, rpy_quat(0, 0, np.tile(HEADINGS_RAD, len(some))))
    return surface_of(scene, grid, {name: _empty(name, rig, path) for name in rig.sensors})


def _empty(name: str, rig: Rig, body: Trajectory) -> Frames:
    spec = rig.sensors[name]
    poses = body.mounted(spec.mount.body_from_sensor())
    samples = np.zeros((len(body), len(spec.range_m)), np.complex64)
    return Frames(samples, spec.range_m, body.t_ns, spec, poses, poses, name, "path_gain")


def clearances_m(scene: Scene, flown: Trajectory, vehicle: str) -> Floats:
    """Return the least distance (n) between the hull, an ellipsoid, and any surface at each pose [m]; < 0: inside."""
    hull, parts = airframe(vehicle), bodies(scene)
    squash = hull.radius_m / hull.half_height_m
    gaps = [
        min(float(part.gaps(into(part, point, int(t_ns)), 1.0, squash=squash)[1].min(initial=np.inf)) for part in parts)
        for point, t_ns in zip(flown.position, flown.t_ns, strict=True)
    ]
    return np.array(gaps) - hull.radius_m


def closest_m(scene: Scene, flown: Trajectory, vehicle: str) -> float:
    """Return the least of these distances along a flight [m]."""
    return float(clearances_m(scene, flown, vehicle).min())


@dataclass(frozen=True, slots=True)
class Verdict:
    """Scores and sentences of an exploring flight."""

    metrics: list[Metric]
    lines: list[str]


def judge(
    flight: Exploration, maps: Sequence[tuple[float, OccupancyMap]], scene: Scene, frames: Mapping[str, Frames]
) -> Verdict:
    """Judge a flight.

    Args:
        flight: that has ended.
        maps: some maps of it, each with its time [s]; the last one counts as the final map.
        scene: the true world.
        frames: some frames of each radar along all of the flight.
    """
    plan, flown = flight.loop.scenario.flight, flight.flown
    length_m = float(np.linalg.norm(np.diff(flown.position, axis=0), axis=1).sum())
    gap_m = closest_m(scene, flight.aloft, plan.vehicle)
    touched = f", with {len(flight.contacts)} contacts" if flight.loop.vehicle is None else " by its reported poses"
    metrics = [
        Metric("flight_length", length_m, "m"),
        Metric("closest_approach", gap_m, "m"),
        *([Metric("contacts", len(flight.contacts))] if flight.loop.vehicle is None else []),
        Metric("guard_stops", 100 * float(np.mean([state in ("stop", "back_off") for state in flight.states])), "%"),
    ]
    far = f"{length_m:.1f} m in {flown.duration_s:.0f} s"
    lines = [flight.summary(), f"It flew {far} and came within {gap_m:.2f} m of a surface{touched}."]
    if (by := of_flight(flight.loop.poses, flown)) is not None:
        words, scores = by.report()
        lines, metrics = [*lines, *words], [*metrics, *scores]
    if not maps or not maps[-1][1].occupied.any():
        return Verdict(metrics, [*lines, "It mapped no surface."])
    grid = maps[-1][1].grid
    places = reachable(scene, flight.start, clearance_m=flight.clearance_m, vehicle=plan.vehicle)
    anywhere = observable_from(scene, grid, flight.loop.rig, places)
    wanted = anywhere.observable(1)
    points, length = anywhere.points[wanted], flown.duration_s
    share = [float(on_map(omap, points).mean()) if len(points) else 0.0 for _, omap in maps]
    for part in SHARES:
        soonest = [value for (at, _), value in zip(maps, share, strict=True) if at <= part * length + 1e-6]
        name = "explored" if part == 1 else f"explored_at_{part * 100:.0f}"
        metrics.append(Metric(name, soonest[-1] if soonest else 0.0))
    lines += _missed(maps[-1][1], anywhere, surface_of(scene, grid, frames), wanted)
    return Verdict(metrics, lines)


def _missed(omap: OccupancyMap, anywhere: Surface, flown: Surface, wanted: Bools) -> list[str]:
    """Return sentences on the surface that is not on the map, by reason."""
    shown, enough = on_map(omap, anywhere.points), flown.observable(3)
    count = max(int(wanted.sum()), 1)
    reasons = {
        "out of beams, range or sight of this flight": ~flown.seen & ~enough,
        "passed, but never along its normal, so its echo went elsewhere": flown.seen & ~enough,
        "observable on this flight, and not mapped yet": enough,
    }
    parts = [f"{100 * (wanted & ~shown & why).sum() / count:.0f} % was {text}" for text, why in reasons.items()]
    return [
        f"Of the surface that can be observed at this height, {100 * (shown & wanted).sum() / count:.0f} % is mapped; "
        + "; ".join(parts) + ".",
        f"{100 * (~wanted).mean():.0f} % of all surface at this height cannot be observed from where the vehicle fits.",
    ]  # fmt: skip
