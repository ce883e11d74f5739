"""What is followed of a frame's paths and outlines and what is not: loops against the same over arrays."""

import numpy as np
import pytest

import ullage as ul
from ullage.antenna import gain
from ullage.kernels import lit
from ullage.kernels import outlines as draw
from ullage.kernels.edges import Outline
from ullage.radar import multipath, zones
from ullage.radar.physical import echoes

RADAR = ul.RadarSpec.preset("x4m05", noise=None)


def room(plate=True):
    there = {"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0} if plate else None
    return ul.scenes.room((6, 4, 3), plate=there)


def outline(rng, count=40):
    """Pieces, ends beside some of them and ends by themselves, of no shape at all."""
    pieces, tips = rng.uniform(-1, 1, (count, 12)), rng.uniform(-1, 1, (count, 9))
    pieces[:, 6:8] += 3
    tips[:, 3] += 3
    ties = np.where(rng.random(count) < 0.5, rng.integers(0, count, count), -1)
    owner, holders = (rng.integers(0, 5, count).astype(np.int32) for _ in range(2))
    return Outline(pieces, owner, tips, holders, ties.astype(np.int32), np.ones(5))


def test_an_end_from_which_a_piece_goes_on_is_as_loud_as_either():
    parted, gains = outline(np.random.default_rng(2)), np.arange(1.0, 6)
    louds, paths = np.empty((2, 80))
    count = lit.outline_louds(parted, gains, 2.0, louds, paths)
    lone = parted.ties < 0
    ends = 2 * np.hypot(parted.tips[:, 4], parted.tips[:, 5]) * gains[parted.holders]
    pieces = 2 * parted.pieces[:, 8:10].max(1) * abs(parted.pieces[:, 10]) * gains[parted.owner]
    np.maximum.at(pieces, parted.ties[~lone], ends[~lone])
    assert count == 40 + lone.sum()
    assert louds[:count] == pytest.approx(np.concatenate([pieces, ends[lone]]))
    assert paths[:count] == pytest.approx(np.concatenate([parted.pieces[:, 6], parted.tips[lone, 3]]) / 2)


def test_ends_are_seen_where_the_piece_is_that_goes_on_or_by_themselves():
    parted, normals = outline(np.random.default_rng(3)), np.tile([0.0, 0, 1], (5, 1))
    spots, faces, seats = np.empty((80, 3)), np.empty(80, np.int64), np.empty(80, np.int64)
    count = draw.look_at(parted, normals, 0.0, draw.Spots(spots, faces), seats)
    lone = np.flatnonzero(parted.ties < 0)
    assert count == 40 + len(lone)
    assert spots[:40] == pytest.approx((parted.pieces[:, :3] + parted.pieces[:, 3:6]) / 2)
    assert spots[40:count] == pytest.approx(parted.tips[lone, :3])
    assert (faces[:count] == np.concatenate([parted.owner, parted.holders[lone]])).all()
    tied = parted.ties >= 0
    assert (seats[40:][tied] == parted.ties[tied]).all()
    assert (seats[40:][lone] == np.arange(40, count)).all()


def followed(monkeypatch, scene, place=(0.1, 0.2, 0.1)):
    """Beams as they are followed, what they would bring, and which of them are laid."""
    kept, shares, accumulate = {}, multipath.shares, multipath.accumulate_outline

    def shares_of(context, planar, antennas, beams, path, strong, clear):
        kept.update(
            path=path, beams=beams, antennas=antennas, level=strong.level.copy(), excess=strong.excess, planar=planar
        )
        return shares(context, planar, antennas, beams, path, strong, clear)

    def added(frame, outline, points, which, *more):
        kept["owner"] = np.unique(np.concatenate([outline.owner, outline.holders, which]))
        return accumulate(frame, outline, points, which, *more)

    monkeypatch.setattr(multipath, "shares", shares_of)
    monkeypatch.setattr(multipath, "accumulate_outline", added)
    echoes(scene, ul.Trajectory.stationary(place), RADAR, max_bounces=3)
    return kept


def test_beams_that_hold_nothing_that_echoes_are_not_followed(monkeypatch):
    kept = followed(monkeypatch, ul.scenes.hold(), (0.1, -7, 4))
    silent = np.ones(len(kept["level"]), bool)
    silent[kept["owner"]] = False
    assert silent.mean() > 0.3
    assert (kept["level"][silent] == 0).all()
    assert (kept["level"][~silent] > 0).mean() > 0.9


def test_beams_are_as_strong_as_their_gains_reflections_and_length(monkeypatch):
    """In a room of metal that reflects all, with one antenna for both ways."""
    scene = ul.scenes.room((6, 4, 3), material="pec")
    kept = followed(monkeypatch, scene)
    path, beams, planar = kept["path"], kept["beams"], kept["planar"]
    heard = np.flatnonzero(kept["level"])
    full = heard[beams.weights[heard] == 1.0]  # over one mirror some count twice or not at all, and fields may turn
    first = np.where((path[full, 1] == path[full, 0]).all(1)[:, None], path[full, 2], path[full, 1])
    turn = kept["antennas"].frames[0].T
    gains = gain(RADAR.antenna, (first - path[full, 0]) @ turn) * gain(
        RADAR.antenna, (path[full, 3] - path[full, 4]) @ turn
    )
    there = np.linalg.norm(path[full, 3] - beams.images[full], axis=1)
    back = np.linalg.norm(path[full, 4] - path[full, 3], axis=1)
    most = 2 * gains * RADAR.wavelength_m / (4 * np.pi * (there + back))
    assert len(full) > 10
    assert (kept["level"][full] <= 1.01 * most).all()
    assert (kept["level"][full] > 0.45 * most).any()
    normals = planar.normals[beams.ends_on]
    height = np.einsum("bi,bi->b", normals, beams.images) - planar.offsets[beams.ends_on]
    mirror = np.linalg.norm(beams.images - 2 * height[:, None] * normals - kept["antennas"].origins[1], axis=1)
    assert kept["excess"][full] == pytest.approx(there + back - mirror[full], abs=1e-9)


def test_zones_are_asked_in_cells_of_like_weight():
    """Each cell of a ray holds as much of the fading weight: phases are where (1 - phase / last)^2 falls evenly."""
    lit_at, axes = np.array([[1.0, 2, 3]]), np.array([[[0.1, 0, 0], [0, 0.2, 0]]])
    ends, angles = np.full((1, 8), 5.0), 2 * np.pi * (np.arange(8) + 0.5) / 8
    turn = np.stack([np.cos(angles), np.sin(angles)], 1)
    asked, out = np.empty((1, 4, 3)), np.empty((12, 3))
    zones.kernel.places(lit_at, axes, ends, turn, 7.0, asked, out)
    left = (1 - asked / 7.0) ** 2
    assert left[0, 0] == pytest.approx(1 - (np.arange(3) + 0.5) / 3 * (1 - (2 / 7) ** 2))
    away = np.sqrt(asked[0, :, :, None]) * (turn[::2] @ axes[0])[:, None]
    assert out == pytest.approx((lit_at + away).reshape(-1, 3))
