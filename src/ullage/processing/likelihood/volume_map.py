"""Cells of a volume: occupied where the echoes of surfaces show them, free where nothing was received."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Longs
from ullage.grids import AMBIGUOUS, UNKNOWN, Grid, OccupancyMap
from ullage.kernels.volume_cells import (
    Box,
    SpatialViews,
    draw_discs,
    find_crossed,
    find_hidden,
)
from ullage.processing.likelihood.cells import (
    FLOWN_M,
    FLOWN_SHARE,
    FULL_NATS,
    LEAST_FLATNESS,
    LIKELY,
    MOST_BEND,
    MOST_HALF_M,
    ROUNDS,
    SEEN_SHARE,
    free_percent,
    occupied_percent,
    steadiness,
)
from ullage.processing.likelihood.folding import folded
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.surfaces import CONSISTENT_M
from ullage.processing.likelihood.volume_silence import Radar, Sighted, VolumeSilence, box_of
from ullage.processing.likelihood.volume_surfaces import (
    CYLINDER,
    EDGE,
    FAINTEST_DB,
    PROJECTORS,
    SpatialSurface,
    transported,
)

RESOLVED = 0.9  # share of the likelihood that the direction of a surface on the map has
LEAST_SHARE = 0.05  # of a rival whose cells are ambiguous
LOUDEST_DB = 3.0  # of a flat surface against a mirror: other echoes at its range may add as much
NARROW = 0.5  # width of the path that a crossed surface must fill, over that of a tube of free space in a plane


def render(
    grid: Grid, surfaces: list[SpatialSurface], silence: VolumeSilence, flown: Floats, radar: Radar,
    spec: LikelihoodSpec,
) -> tuple[OccupancyMap, Bools]:  # fmt: skip
    """Draw a map.

    Args:
        grid: a volume.
        surfaces: those that are sure to exist.
        silence: what the keyframes did not receive.
        flown: (f, 3) places of the track [m].
        radar: the sensors.
        spec: parameters.

    Returns:
        The map, and which surfaces are on it: of one direction, not hidden behind others, and not flown through.
    """
    wavelength_m = radar.wavelength_m
    box = box_of(grid)
    percent = np.full(grid.size, UNKNOWN, np.int8)
    resolved = np.array([one.share >= RESOLVED for one in surfaces], bool)
    plausible = np.array([_is_plausible(one, radar.mirror_m) for one in surfaces], bool)
    kept = np.zeros(len(surfaces), bool)
    likely, shown = np.zeros((2, grid.size), bool)
    solid = np.zeros(grid.size, np.int8)
    fold_m = np.zeros(len(surfaces))
    if resolved.any():
        views, owner, _ = _views(
            [one for one, sure in zip(surfaces, resolved, strict=True) if sure], wavelength_m, spec
        )
        far = folded(views.position, views.unit, views.range_m, owner, radar.fold_m)
        views = _unfolded(views, far[owner], wavelength_m, radar.fold_m)
        fold_m[resolved] = np.where(far, radar.fold_m, 0.0)
        possible = plausible[resolved] & ~_flown_through(views, owner, flown)
        detour = _detours(views.level / radar.mirror_m) * math.sqrt(wavelength_m / 2)
        alive, evidence, level = _visible(box, views, owner, possible, detour, spec)
        kept[np.flatnonzero(resolved)] = np.bincount(owner, alive) > 0
        shown = evidence >= spec.evidence
        crossed, tube = np.zeros(grid.size), NARROW * spec.tube * math.sqrt(wavelength_m / 2)
        find_crossed(box, views, evidence, level, spec.evidence, alive, tube, crossed)
        solid[shown] = occupied_percent(evidence[shown], crossed[shown], spec.volume_odds, spec)
        likely = shown & (solid >= LIKELY)
    sure = [Sighted(*one) for one in zip(surfaces, fold_m.tolist(), strict=True) if one[0].share >= RESOLVED]
    silent = silence.free(sure, likely, radar)
    _ambiguous(
        box, [one for one, sure in zip(surfaces, resolved, strict=True) if not sure], wavelength_m, spec, percent
    )
    beside = maximum_filter(shown.reshape(grid.shape), 3).ravel()
    percent[silent & ~beside] = free_percent(np.zeros(1), spec)
    percent[_body(grid, flown, spec.vehicle_m)] = 0
    percent[likely] = solid[likely]
    return OccupancyMap(grid, percent.reshape(grid.shape), "likelihood"), kept


def _body(grid: Grid, flown: Floats, radius_m: float) -> Longs:
    """Flat index of the cells within a radius about the track."""
    reach = np.arange(-radius_m, radius_m + 1e-9, min(grid.step_m, radius_m))
    ball = np.stack([part.ravel() for part in np.meshgrid(reach, reach, reach)], axis=1)
    ball = ball[(ball**2).sum(axis=1) <= radius_m**2 + 1e-9]
    cell, inside = grid.index((flown[:, None] + ball).reshape(-1, 3))
    return np.unique(np.ravel_multi_index(tuple(cell[inside].T), grid.shape))


def smoothed(surface: SpatialSurface) -> tuple[Floats, Bools]:
    """States (k, 5) of a surface at all its sightings, by what is known of it in the end where that fits (k)."""
    seen = list(surface.sightings.values())
    place, best = np.array([one.position for one in seen]), surface.leader
    then = np.array([(one.range_m, *one.direction, one.curvature) for one in seen])
    projector = np.repeat(PROJECTORS[surface.shapes[best]][None], len(seen), 0)
    back = transported(np.repeat(surface.states[best][None], len(seen), 0), projector, place - surface.position)
    fits = np.abs(back[:, 0] - then[:, 0]) < CONSISTENT_M
    return np.asarray(np.where(fits[:, None], back, then)), fits


def _is_plausible(surface: SpatialSurface, mirror_m: float) -> bool:
    """Whether a surface is as strong as smooth walls are: not above a mirror, and no flat one as weak as an edge."""
    if not math.isfinite(mirror_m):
        return True
    flat = np.array([abs(1 - one.curvature * one.range_m) for one in surface.sightings.values()])
    level = np.array([one.level for one in surface.sightings.values()]) / np.sqrt(np.maximum(flat, LEAST_FLATNESS))
    level_db = 20 * math.log10(max(float(np.median(level)), 1e-30) / mirror_m)
    return bool(level_db < LOUDEST_DB and (np.median(flat) < EDGE or level_db > FAINTEST_DB))


def _across(unit: Floats) -> Floats:
    """Frames (k, 2, 3) across directions (k, 3): upwards as far as possible, and level."""
    up = np.where(np.abs(unit[:, 2:]) < 0.99, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    up = up - np.sum(up * unit, axis=1, keepdims=True) * unit
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return np.stack([up, np.cross(unit, up)], axis=1)


def _views(
    surfaces: list[SpatialSurface], wavelength_m: float, spec: LikelihoodSpec
) -> tuple[SpatialViews, Longs, Bools]:
    """All sightings of all surfaces as rows, the surface of each, and whether it agrees with the others."""
    states, fits = (np.concatenate(parts) for parts in zip(*(smoothed(one) for one in surfaces), strict=True))
    state = np.asarray(states)
    seen = [one for surface in surfaces for one in surface.sightings.values()]
    owner = np.repeat(np.arange(len(surfaces)), [len(one.sightings) for one in surfaces])
    round_ = np.array([one.shapes[one.leader] == CYLINDER for one in surfaces])[owner]
    range_m, place = state[:, 0], np.array([one.position for one in seen])
    flat = np.ones((len(state), 2))
    flat[:, 1] -= np.where(round_, state[:, 4] * range_m, 0.0)
    foot, level = place + range_m[:, None] * state[:, 1:4], np.array([one.level for one in seen])
    wide = np.concatenate([steadiness(foot[owner == one], level[owner == one]) for one in range(len(surfaces))])
    half = spec.support * wide[:, None] * np.sqrt(0.5 * wavelength_m * range_m[:, None] * np.abs(flat))
    half = np.minimum(half, MOST_HALF_M)
    bend = np.zeros_like(flat)
    bend[:, 1] = np.where(np.abs(flat[:, 1]) > 0.2, state[:, 4] * round_ / np.where(flat[:, 1] == 0, 1, flat[:, 1]), 0)
    return SpatialViews(
        place, np.ascontiguousarray(state[:, 1:4]), _across(state[:, 1:4]),
        np.ascontiguousarray(range_m), half, np.clip(bend, -MOST_BEND, MOST_BEND),
        level, np.minimum(np.array([one.nats for one in seen]) / FULL_NATS, 1.0),
    ), owner, fits  # fmt: skip


def _unfolded(views: SpatialViews, far: Bools, wavelength_m: float, fold_m: float) -> SpatialViews:
    """Views with the folded ones (k) at their true range."""
    range_m = views.range_m + np.where(far, fold_m, 0.0)
    grown = range_m / views.range_m
    return views._replace(
        range_m=range_m,
        half_m=np.minimum(views.half_m * np.sqrt(grown)[:, None], MOST_HALF_M),
        level=views.level * grown,
    )


def _flown_through(views: SpatialViews, owner: Longs, flown: Floats) -> Bools:
    """Whether the track passes the specular points of each surface, as it passes those of false ones only (s)."""
    near = cKDTree(flown).query(views.position + views.range_m[:, None] * views.unit)[0] < FLOWN_M
    return np.asarray(np.bincount(owner, near) / np.bincount(owner) > FLOWN_SHARE)


def _detours(level: Floats) -> Floats:
    """Half widths (k) of the widest obstacle that echoes may have come around, in radii of the first Fresnel zone.

    Past both edges of an obstacle come 6 dB more than past one, which takes 13 dB + 20 log v each way [ITU-R-P526].

    Args:
        level: (k) of echoes against a mirror; 0 where that is unknown.
    """
    below_db = -20 * np.log10(np.maximum(level, 1e-3))
    return np.asarray(np.where(level > 0, np.maximum(10 ** ((below_db / 2 - 7) / 20), 1.0), 1.0))


def _visible(
    box: Box, views: SpatialViews, owner: Longs, possible: Bools, detour: Floats, spec: LikelihoodSpec
) -> tuple[Bools, Floats, Floats]:
    """Which echoes come straight from a surface, and evidence and level of these in each cell (cells)."""
    count, alive, cells = np.bincount(owner), possible[owner], box.levels * box.rows * box.columns
    for last in (False,) * ROUNDS + (True,):
        evidence, level = np.zeros(cells), np.zeros(cells)  # new ones cost less than to clear these
        draw_discs(box, views, alive, 1.0, evidence, level, np.zeros(cells, np.int32))
        if last:
            break
        alive = possible[owner]
        find_hidden(box, views, evidence, level, spec.evidence, detour, alive)
        alive &= (np.bincount(owner, alive) / count > SEEN_SHARE)[owner]
    return alive, evidence, level


def _ambiguous(
    box: Box, surfaces: list[SpatialSurface], wavelength_m: float, spec: LikelihoodSpec, percent: np.ndarray
) -> None:
    """Mark the cells of all rivals of surfaces of open direction."""
    rivals = []
    for one in surfaces:
        weight = np.exp(one.evidence - one.evidence.max())
        for row in np.flatnonzero(weight / weight.sum() >= LEAST_SHARE).tolist():
            alone = SpatialSurface(
                one.position, one.states[[row]], one.frames[[row]], one.covariances[[row]], one.evidence[[row]],
                one.shapes[[row]], one.number, sightings=one.sightings,
            )  # fmt: skip
            rivals.append(alone)
    if rivals:
        views, _, _ = _views(rivals, wavelength_m, spec)
        evidence, level, mark = np.zeros(len(percent)), np.zeros(len(percent)), np.zeros(len(percent), np.int32)
        draw_discs(box, views, np.ones(len(views.range_m), bool), 1.0, evidence, level, mark)
        percent[evidence > 0] = AMBIGUOUS
