"""Cells of a plane, rendered from surfaces: occupied where echoes show them, free along the paths of their echoes."""

from __future__ import annotations

import math
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from ullage.arrays import Bools, Floats, Longs
from ullage.grids import UNKNOWN, Grid, OccupancyMap
from ullage.kernels.surface_cells import (
    PARTS,
    Plane,
    Tubes,
    Views,
    draw_extensions,
    draw_surfaces,
    draw_tubes,
    find_crossed,
    find_hidden,
)
from ullage.processing.likelihood.folding import folded
from ullage.processing.likelihood.lying import cut_sigma, in_plane
from ullage.processing.likelihood.silence import Silence, without_surfaces
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.surfaces import UNFIT_SIGMA, Surface, smoothed

LIKELY = 50  # percent from which a cell that echoes show is published: it rather holds surface than not
FULL_NATS = 30.0  # an echo with as many counts in full
MOST_BEND = 2.0  # of the piece of a surface that one echo shows, in a volume [1/m]
MOST_HALF_M, MOST_ZONES, NEAR_FOOT_M = 1.2, 4.0, 1.0  # of what one echo shows; of points that share a level [m]
LEAST_RADIUS_M = 0.25  # of a round surface
DOUBT = 0.3  # standard deviations of the curvature by which that piece is narrowed
FLOWN_M, FLOWN_SHARE = 0.1, 0.3  # a surface whose specular points lie so near to the track, so many of them, is false
LEAST_FLATNESS = 0.1  # of edges and poles, whose own law differs
FULL_PERCENT, FULL_REACH_M = 90.0, 0.7  # level of a surface without obstacles, near one place of the track
LEAST_FULL = 0.5  # share of that over the whole track which it has at least
BLOCKED = 0.3  # half width of a path that a wall must fill, in radii of the first Fresnel zone
CLEAR = 0.8  # share of the full level that a clear path leaves; the level of an edge in its zone ripples by less
FAINT, FAINT_PERCENT = 0.05, 95.0  # an echo so far below the strongest ones may come by way of other things
SHOWN = 0.1  # evidence of a cell that ends a tube: what is hardly seen may be solid all the same
SEEN_SHARE = 0.34  # of a surface's echoes that must not be hidden
SURE_M = 0.4  # an echo excludes a possible extension of a surface only from so far behind it
SIGMAS = 2.0  # by which the slope of a surface may be off
ROUNDS = 3  # of hiding: what hides may be hidden itself


def render(
    grid: Grid,
    surfaces: list[Surface],
    flown: Floats,
    silence: Silence,
    wavelength_m: float,
    fold_m: float,
    spec: LikelihoodSpec,
) -> tuple[OccupancyMap, Bools]:
    """Draw a map.

    Args:
        grid: a plane.
        surfaces: those that are sure.
        flown: (f, 2) places of the track [m].
        silence: what was not received.
        wavelength_m: of the carrier [m].
        fold_m: unambiguous range of the radars [m].
        spec: parameters.

    Returns:
        The map, and which surfaces are on it: not hidden behind others, and not flown through.
    """
    plane, quiet = Plane(*grid.origin_m[:2], grid.step_m, *grid.shape), silence.nats
    percent = np.full(grid.size, UNKNOWN, np.int8)
    kept = np.zeros(len(surfaces), bool)
    body = _body(grid, flown, spec.vehicle_m)
    percent[body] = 0
    if surfaces:
        views, owner, cut, (wide, doubt) = _views(grid, surfaces, wavelength_m, fold_m, spec)
        sloped = np.array([one.sloped for one in surfaces])
        false = _flown_through(views, owner, flown)
        possible = (cut[0] | ~sloped[owner]) & ~false[owner]
        doubtful = cut[1] & ~cut[0] & ~false[owner]
        alive, evidence, level = _visible(plane, views, owner, possible, spec)
        kept = np.bincount(owner, alive, len(surfaces)) > 0
        shown = evidence >= spec.evidence
        widening = BLOCKED * math.sqrt(wavelength_m / 2)  # the first Fresnel zone: sqrt(wavelength distance / 2)
        solid = _solid(plane, (views, alive, widening), wide, (evidence, level), spec)
        likely = shown & (solid >= LIKELY)
        slopes = (sloped & ~false)[owner]
        clearance = _clearance(views, owner)
        extended = _extensions(plane, views, alive, spec.extension_m)
        ends = evidence.copy()
        draw_surfaces(plane, views, doubtful, ends, level)
        # surfaces whose place is open end the paths of other echoes
        nearest, reached = _nearest(views, owner, surfaces, spec.extension_m)
        ends += _unplaced(plane, nearest, slopes & ~cut[1] & reached, (views, alive, widening), spec)
        width = np.where(alive, spec.tube * clearance, 0.0)  # echoes of slopes leave the plane
        tubes = Tubes(width, doubt, wavelength_m, spec.margin_m, SURE_M)
        free = _passed(plane, views, tubes, ends, extended) & (quiet[0] >= 0)
        free |= _silent(plane, silence, ends, free | (percent == 0), spec)
        free &= ~shown & (percent != 0)
        percent[free] = free_percent(quiet[0, free], spec)
        percent[likely] = solid[likely]
    return OccupancyMap(grid, percent.reshape(grid.shape), "likelihood"), kept


def _solid(
    plane: Plane, echoes: tuple[Views, Bools, float], wide: Floats, drawn: tuple[Floats, Floats], spec: LikelihoodSpec
) -> NDArray[np.int8]:
    """Chance (cells) that cells hold surface.

    Args:
        plane: the cells.
        echoes: views of the surfaces, which of them count, and the half width of their paths as of `find_crossed`.
        wide: (k) width of what each echo shows, over the first Fresnel zone.
        drawn: evidence and level (cells) of what they show.
        spec: parameters.
    """
    views, alive, widening = echoes
    evidence, level = drawn
    crossed, within = np.zeros((2, len(evidence)))
    find_crossed(plane, views, evidence, level, spec.evidence, alive, widening, crossed)
    # echoes from behind cross one zone each, so they weigh against what one zone shows
    draw_surfaces(plane, views._replace(half_m=views.half_m / wide), alive, within, level.copy())
    crossed *= evidence / np.maximum(within, 1e-9)
    return occupied_percent(evidence, crossed, spec.plane_odds, spec)


def occupied_percent(evidence: Floats, crossed: Floats, odds: float, spec: LikelihoodSpec) -> NDArray[np.int8]:
    """Chance (cells) that cells hold surface, from the weights of the echoes that show it and of those that cross it.

    The log-odds are linear in the logarithm of the evidence and in the crossed share of it, fitted to flights
    [Platt1999].
    """
    seen = np.maximum(evidence, 1e-9)
    grown = odds * seen**spec.odds_power * np.exp(-spec.crossed_nats * np.minimum(crossed / seen, 10.0))
    return np.rint(100 * grown / (1 + grown)).astype(np.int8)


def free_percent(nats: Floats, spec: LikelihoodSpec) -> NDArray[np.int8]:
    """Chance (cells) that cells held free are not, from their log-likelihood of silence [Platt1999].

    At least 1 %: only where the vehicle was, it is 0.
    """
    odds = spec.free_odds * np.exp(-np.maximum(nats, 0.0) / spec.free_nats)
    return np.maximum(np.rint(100 * odds / (1 + odds)), 1).astype(np.int8)


def _nearest(views: Views, owner: Longs, surfaces: list[Surface], extension_m: float) -> tuple[Views, Bools]:
    """Views with each surface where it may meet the plane first, and which may go on so far (k).

    A slope goes on straight. A lying cylinder of open bend may meet the plane anywhere from its range on.
    """
    sigma = np.sqrt([one.covariance[3, 3] for one in surfaces])[owner]
    cosine = np.minimum(views.state[:, 3] + SIGMAS * sigma, 1.0)
    straight = np.where(np.array([one.lying for one in surfaces])[owner], 1.0, cosine)
    state, range_m = views.state.copy(), views.state[:, 0]
    state[:, 0] = range_m / straight
    return views._replace(state=state), state[:, 0] ** 2 - range_m**2 <= extension_m**2


def _unplaced(
    plane: Plane, views: Views, unplaced: Bools, others: tuple[Views, Bools, float], spec: LikelihoodSpec
) -> Floats:
    """Evidence (cells) of surfaces whose place in the plane is open, where stronger echoes do not come through them.

    Args:
        plane: the cells.
        views: of the surfaces, where they may stand.
        unplaced: (k) which are open.
        others: views of the surfaces on the map, which of them count, and the half width of their paths as of
            `find_crossed`.
        spec: parameters.
    """
    evidence, level, crossed = np.zeros((3, plane.rows * plane.columns))
    draw_surfaces(plane, views, unplaced, evidence, level)
    through, alive, widening = others
    find_crossed(plane, through, evidence, level, SHOWN, alive, widening, crossed)
    return np.where(occupied_percent(evidence, crossed, spec.plane_odds, spec) > 0, evidence, 0.0)


def _passed(plane: Plane, views: Views, tubes: Tubes, evidence: Floats, extensions: Floats) -> Bools:
    """Cells that echoes came through, in all their parts (cells)."""
    fine = Plane(plane.x, plane.y, plane.step / PARTS, plane.rows * PARTS, plane.columns * PARTS)
    free = np.zeros(fine.rows * fine.columns, bool)
    draw_tubes(fine, views, tubes, evidence >= SHOWN, extensions, free)
    return np.asarray(free.reshape(plane.rows, PARTS, plane.columns, PARTS).all(axis=(1, 3)).ravel())


def _silent(plane: Plane, silence: Silence, evidence: Floats, free: Bools, spec: LikelihoodSpec) -> Bools:
    """Cells from which poles and surfaces would have been received (cells)."""
    shown = evidence >= SHOWN
    beside = binary_dilation(shown.reshape(plane.rows, plane.columns), np.ones((3, 3), bool)).ravel()
    pole, edge = silence.nats >= spec.silence
    possible, ends = pole & ~shown & ~free, beside | ~edge
    return without_surfaces(plane, silence.hearing(), shown, free, possible, ends) & ~beside


def _extensions(plane: Plane, views: Views, alive: Bools, extension_m: float) -> Floats:
    """Outward normal of the surface that may go on in each cell, and its distance; -inf where none may (cells, 3)."""
    out = np.zeros((plane.rows * plane.columns, 3))
    out[:, 2] = -np.inf
    draw_extensions(plane, views, alive, extension_m, out)
    return out


def _body(grid: Grid, flown: Floats, radius_m: float) -> Longs:
    """Flat index of the cells within the radius of the vehicle about the track."""
    if not len(flown):
        return np.zeros(0, np.int64)
    reach = np.arange(-radius_m, radius_m + 1e-9, min(grid.step_m, radius_m))
    dx, dy = (part.ravel() for part in np.meshgrid(reach, reach))
    near = dx**2 + dy**2 <= radius_m**2 + 1e-9
    points = flown[:, None] + np.stack([dx[near], dy[near]], axis=1)
    cell, inside = grid.index(np.unique(points.reshape(-1, 2), axis=0))
    return np.unique(np.ravel_multi_index(tuple(cell[inside].T), grid.shape))


def _views(
    grid: Grid, surfaces: list[Surface], wavelength_m: float, fold_m: float, spec: LikelihoodSpec
) -> tuple[Views, Longs, Bools, tuple[Floats, Floats]]:
    """All sightings as rows, the surface of each, where the plane cuts lying cylinders, and two numbers of each row.

    These are its width in Fresnel zones and the standard deviation of its bearing [rad].

    The flags (2, k) are: the cut is confirmed, and the surface may go on to there. A folded echo shows the surface that
    it comes from, at its true range.
    """
    states, sigmas = zip(*(smoothed(one) for one in surfaces), strict=True)
    state, (sigma, doubt) = np.concatenate(states), np.concatenate(sigmas, axis=1)
    seen = [one for surface in surfaces for one in surface.sightings.values()]
    owner = np.repeat(np.arange(len(surfaces)), [len(one.sightings) for one in surfaces])
    place, level = np.array([one.position for one in seen]), np.array([one.level for one in seen])
    unit = np.stack([np.cos(state[:, 1]), np.sin(state[:, 1])], axis=1)
    far = folded(place, unit, state[:, 0], owner, fold_m)[owner]
    level[far] *= 1 + fold_m / state[far, 0]
    state[far, 0] += fold_m
    weight = np.minimum(np.array([one.nats for one in seen]) / FULL_NATS, 1.0)
    rows, cut = _cut(_Rows(place, state, sigma, owner, level, weight, doubt), surfaces, grid, spec)
    place, state, sigma, owner, level, weight, doubt = rows
    range_m, curvature = state[:, 0], state[:, 2]
    flatness = 1 - curvature * range_m  # by which the specular point moves as the sensor moves: 1 for a flat wall
    narrowed = np.maximum(np.abs(flatness) - DOUBT * sigma * range_m, 0)
    foot = place + range_m[:, None] * np.stack([np.cos(state[:, 1]), np.sin(state[:, 1])], axis=1)
    wide = np.concatenate([steadiness(foot[owner == one], level[owner == one]) for one in range(len(surfaces))])
    half = spec.support * np.sqrt(0.5 * wavelength_m * range_m * narrowed)
    wide = np.minimum(wide, np.maximum(MOST_HALF_M / np.maximum(half, 1e-9), 1.0))
    steep = np.abs(flatness) > 0.2
    bend = np.where(steep, curvature / np.where(steep, flatness, 1.0), 0.0)
    bend = np.clip(bend, -1 / LEAST_RADIUS_M, 1 / LEAST_RADIUS_M)
    return Views(place, np.ascontiguousarray(state), wide * half, bend, level, weight), owner, cut, (wide, doubt)


def steadiness(foot: Floats, level: Floats) -> Floats:
    """Distance (k) to the next edge that the level of an echo allows, in radii of the first Fresnel zone.

    At a distance of v sqrt(wavelength range) / 2 from an edge the level ripples by 0.225 / v [BornWolf1999].
    """
    near = np.linalg.norm(foot[:, None] - foot, axis=2) < NEAR_FOOT_M
    count = near.sum(axis=1)
    mean = near @ level / count
    ripple = np.sqrt(np.maximum(near @ level**2 / count - mean**2, 0)) / np.maximum(mean, 1e-30)
    zones = np.clip(0.225 / np.maximum(ripple, 1e-3), math.sqrt(2), MOST_ZONES)
    return np.asarray(np.where(count >= 4, zones, math.sqrt(2)) / math.sqrt(2))


class _Rows(NamedTuple):
    """Sightings as rows."""

    place: Floats  # (k, 2) [m]
    state: Floats  # (k, 4)
    sigma: Floats  # (k) of the curvature [1/m]
    owner: Longs  # (k) surface
    level: Floats  # (k) amplitude times range [m]
    weight: Floats  # (k)
    doubt: Floats  # (k) standard deviation of the bearing [rad]


def _cut(rows: _Rows, surfaces: list[Surface], grid: Grid, spec: LikelihoodSpec) -> tuple[_Rows, Bools]:
    """Rows with those of lying cylinders where the plane cuts these, and the flags of `_views`."""
    state, level, sigma = rows.state.copy(), rows.level.copy(), rows.sigma.copy()
    sources, states, flags = [np.arange(len(state))], [state], [np.zeros((2, len(state)), bool)]
    for index in [k for k, one in enumerate(surfaces) if one.lying]:
        one, mine = surfaces[index], np.flatnonzero(rows.owner == index)
        sure = (sigma[mine] < UNFIT_SIGMA) & (cut_sigma(one.state, one.covariance) < grid.step_m)
        level[mine] /= np.sqrt(np.maximum(np.abs(1 - state[mine, 2] * state[mine, 0]), LEAST_FLATNESS))
        cut, count = in_plane(state[mine], sure, spec.extension_m, spec.least_keyframes), len(mine)
        state[mine], sigma[mine] = cut.state[:count], 0.0
        flags[0][:, mine] = cut.confirmed[:count], cut.possible[:count]
        sources.append(mine[cut.sighting[count:]])
        states.append(cut.state[count:])
        flags.append(np.stack([cut.confirmed[count:], cut.possible[count:]]))
    row = np.concatenate(sources)
    rest = sigma[row], rows.owner[row], level[row], rows.weight[row], rows.doubt[row]
    return _Rows(rows.place[row], np.concatenate(states), *rest), np.concatenate(flags, axis=1)


def _visible(
    plane: Plane, views: Views, owner: Longs, possible: Bools, spec: LikelihoodSpec
) -> tuple[Bools, Floats, Floats]:
    """Which echoes come straight from a surface, and the evidence of these in each cell (cells)."""
    count = np.maximum(np.bincount(owner, possible), 1)
    alive = possible.copy()
    evidence, level = np.zeros((2, plane.rows * plane.columns))
    for _ in range(ROUNDS):
        evidence[:], level[:] = 0, 0
        draw_surfaces(plane, views, alive, evidence, level)
        alive = possible.copy()
        find_hidden(plane, views, evidence, level, spec.evidence, alive)
        alive &= (np.bincount(owner, alive) / count > SEEN_SHARE)[owner]
    evidence[:], level[:] = 0, 0
    draw_surfaces(plane, views, alive, evidence, level)
    return alive, evidence, level


def _clearance(views: Views, owner: Longs) -> Floats:
    """Width of the free path of each echo, 1 at the full level of its surface (k).

    A knife edge on the path of an echo takes three quarters of its amplitude there and back. One beside it takes less,
    about as the root of the level falls from 1 to 1/2 [Balanis2012]. So the level shows how near an edge may be.
    A round surface changes the level of a flat one by the root of how its specular point moves against the sensor's.
    """
    flatness = np.abs(1 - views.state[:, 2] * views.state[:, 0])
    level = views.level / np.sqrt(np.maximum(flatness, LEAST_FLATNESS))
    full = _percentiles(level, owner, FULL_PERCENT)
    apart = np.column_stack([views.position, owner * 1e4])
    near: Any = cKDTree(apart).query_ball_point(apart, FULL_REACH_M, return_sorted=False)
    echo = np.repeat(np.arange(len(near)), [len(one) for one in near])
    local = _percentiles(level[np.fromiter(chain.from_iterable(near), np.int64, len(echo))], echo, FULL_PERCENT)
    share = np.minimum(level / np.maximum(local, LEAST_FULL * full[owner]), 1.0)
    known = (share >= CLEAR) & (level >= FAINT * np.percentile(level, FAINT_PERCENT))
    return np.where(known, 2 * np.sqrt(share) - 1, 0.0)


def _percentiles(values: Floats, group: Longs, percent: float) -> Floats:
    """Percentile of the values of each group 0 to g-1, interpolated as by `np.percentile` (g); no group is empty."""
    ordered = values[np.lexsort((values, group))]
    size = np.bincount(group)
    place = (size - 1) * (percent / 100)
    below = place.astype(np.int64)
    share, first = place - below, np.cumsum(size) - size + below
    low, high = ordered[first], ordered[first + (share > 0)]
    return np.asarray(np.where(share < 0.5, low + (high - low) * share, high - (high - low) * (1 - share)))


def _flown_through(views: Views, owner: Longs, flown: Floats) -> Bools:
    """Whether the track passes the specular points of each surface, as it passes those of false ones only (s)."""
    range_m, bearing = views.state[:, 0], views.state[:, 1]
    unit = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    along = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    tree = cKDTree(flown)
    near = np.zeros(len(range_m), bool)
    for share in (-1.0, -0.5, 0.0, 0.5, 1.0):
        point = views.position + range_m[:, None] * unit + (share * views.half_m)[:, None] * along
        near |= tree.query(point)[0] < FLOWN_M
    return np.asarray(np.bincount(owner, near) / np.bincount(owner) > FLOWN_SHARE)
