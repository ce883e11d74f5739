"""The direction of an echo from its ranges along a bent track, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import fresnel

import ullage as ul
from ullage.antenna import boresight_pattern
from ullage.processing.inverse_sensor import least_cosine, mirror_m
from ullage.processing.mapper_echoes import Echo
from ullage.processing.mapper_looks import Heard, Look
from ullage.processing.mapper_screens import BEYOND_M, SHADE_SLOPE, screens_of
from ullage.processing.mapper_tracks import EchoTracks, normal_of, post_of

AHEAD = np.array([0.0, 1.0, 0.0])
LEAST = float(np.cos(np.radians(40)))


def waving(count: int = 40, *, rise_m: float = 0.3, step_m: float = 0.05) -> np.ndarray:
    x = step_m * np.arange(count)
    return np.column_stack([x, 0 * x, rise_m * np.sin(2.5 * x)])


def traced(at: np.ndarray, reach: np.ndarray, rng: np.random.Generator) -> list[Echo]:
    track = np.gradient(at, axis=0)
    track /= np.linalg.norm(track, axis=1)[:, None]
    cosine = -np.gradient(reach) / np.linalg.norm(np.gradient(at, axis=0), axis=1)
    cosine = cosine + rng.normal(0, 0.02, len(at))
    return [Echo(10**8 * i, at[i], track[i], reach[i], cosine[i], 1e-3, 0.02, 0.9) for i in range(len(at))]


def off_wall(normal, distance: float, at: np.ndarray, rng) -> list[Echo]:
    return traced(at, distance - at @ np.asarray(normal, float) + rng.normal(0, 0.004, len(at)), rng)


@pytest.mark.parametrize("elevation_deg", [-30, 0, 25])
def test_a_track_that_rises_and_sinks_tells_how_a_wall_leans(elevation_deg):
    rng = np.random.default_rng(1)
    up = np.radians(elevation_deg)
    normal = np.array([0.2 * np.cos(up), np.sqrt(0.96) * np.cos(up), np.sin(up)])
    found = normal_of(off_wall(normal, 3.0, waving(), rng), AHEAD, LEAST)
    assert found is not None
    assert found @ normal > np.cos(np.radians(5))


def test_a_straight_level_track_leaves_it_open():
    rng = np.random.default_rng(2)
    normal = np.array([0.1, 0.95, 0.3]) / np.linalg.norm([0.1, 0.95, 0.3])
    assert normal_of(off_wall(normal, 3.0, waving(rise_m=0.0), rng), AHEAD, LEAST) is None


def test_a_pole_is_no_wall_and_a_wall_no_pole():
    rng = np.random.default_rng(4)
    at, place = waving(), np.array([1.0, 2.0])
    echoes = traced(at, np.linalg.norm(place - at[:, :2], axis=1) + rng.normal(0, 0.003, len(at)), rng)
    found = post_of(echoes, AHEAD)
    assert found is not None
    np.testing.assert_allclose(found, place, atol=0.05)
    assert post_of(off_wall(AHEAD, 3.0, at, rng), AHEAD) is None


def follow_all(
    at: np.ndarray,
    reach: np.ndarray,
    *,
    levels: tuple = (),
    mirror_m: float = np.inf,
    step_m: float = 0.05,
    folded=lambda *_: False,
    height: np.ndarray | float = 1e-3,
) -> tuple[EchoTracks, list]:
    tracks, feet = EchoTracks(folded), []
    tracks.mirror_m["front"], tracks.wave_m = mirror_m, 0.041
    tracks.believe(list(levels), at[0])
    axes = np.column_stack([AHEAD, [-1.0, 0, 0], [0, 0, 1.0]])
    heights = np.broadcast_to(height, len(at))
    for k, echo in enumerate(traced(at, reach, np.random.default_rng(5))):
        heard = Heard(echo.t_ns, echo.position, axes, 1, np.zeros(16), np.zeros(16), np.zeros(8, bool), None)
        heard.step_m = step_m
        look = Look(
            heard, echo.track, np.array([[echo.range_m, 0.003, echo.cosine, 0.02, 1, heights[k]]]), np.zeros((1, 5))
        )
        feet += tracks.follow("front", look, np.array([echo.cosine]), np.array([0.02]), np.array([0.9]), LEAST)
    return tracks, feet + tracks.end()


def test_every_echo_of_a_wall_is_told_once_it_is_sure_and_none_twice():
    at = waving(60)
    tracks, feet = follow_all(at, 3.0 - at[:, 1])
    assert len(feet) >= 55
    assert len({foot.echo.t_ns for foot in feet}) == len(feet)
    assert max(abs(foot.at[1] - 3.0) for foot in feet) < 0.03
    (wall,) = tracks.walls
    assert wall[3] == pytest.approx(3.0, abs=0.03)


def test_what_is_30_db_fainter_than_a_mirror_makes_no_wall():
    at = waving(60)
    _, heard = follow_all(at, 3.0 - at[:, 1], mirror_m=0.01)
    tracks, feet = follow_all(at, 3.0 - at[:, 1], mirror_m=0.1)
    assert heard
    assert not feet
    assert not len(tracks.walls)


@pytest.mark.parametrize("onward", [1, -1])
def test_a_wall_ends_where_its_echo_has_fallen_by_half_on_the_way_there_and_on_the_way_past(onward):
    at = waving(60)[::onward]
    beyond = at[:, 0] - 1.5
    sine, cosine = fresnel(-2 * beyond / np.sqrt(0.041 * 3.0))
    mirror = 0.25 * 1e-3 * 3.0  # 12 dB under what an antenna of 6 dBi gives it out and back
    height = 1e-3 * np.abs(0.5 + cosine + 1j * (0.5 + sine)) / np.sqrt(2)
    _, feet = follow_all(at, 3.0 - at[:, 1], mirror_m=mirror, height=height)
    assert max(foot.at[0] for foot in feet) < 1.5 + 0.05
    assert sum(foot.at[0] < 1.45 for foot in feet) >= 25
    _, everywhere = follow_all(at, 3.0 - at[:, 1], mirror_m=mirror)
    assert max(foot.at[0] for foot in everywhere) > 2.5


def test_what_may_be_folded_is_told_once_nothing_farther_off_can_have_made_it():
    at = waving(60)
    tracks, feet = follow_all(at, 3.0 - at[:, 1], folded=lambda *_: True)
    assert not feet
    assert not len(tracks.walls)
    feet = follow_all(at, 3.0 - at[:, 1], folded=lambda name, echo, way: 25 < echo.t_ns // 10**8 != 40)[1]
    assert not [foot for foot in feet if foot.echo.t_ns // 10**8 > 25], "one that tells, out of many, is not enough"
    feet = follow_all(at, 3.0 - at[:, 1], folded=lambda name, echo, way: echo.t_ns < 35 * 10**8)[1]
    assert len(feet) >= 46, "the last 48 echoes are remembered"
    assert len({foot.echo.t_ns for foot in feet}) == len(feet)


def test_a_dozen_echoes_make_no_wall():
    at = waving(14)
    tracks, feet = follow_all(at, 3.0 - at[:, 1])
    assert not feet
    assert not len(tracks.walls)


def test_a_dozen_echoes_10_cm_apart_make_one():
    at = waving(14, step_m=0.1)
    tracks, feet = follow_all(at, 3.0 - at[:, 1], step_m=0.1)
    assert len(feet) == 14
    assert len(tracks.walls) == 1


def test_an_echo_of_a_known_floor_is_told_at_once():
    at = waving(6)
    _, feet = follow_all(at, at[:, 2] + 1.5, levels=((-1, -1.5),))
    assert len(feet) == 6
    assert max(abs(foot.at[2] + 1.5) for foot in feet) < 0.03


@pytest.mark.parametrize("slope_deg", [-25, 0, 20])
def test_the_wall_that_an_open_echo_came_from_is_among_its_screens(slope_deg):
    up = np.radians(slope_deg)
    normal = np.array([0.0, np.cos(up), np.sin(up)])
    echoes = off_wall(normal, 3.0, waving(12, rise_m=0.0), np.random.default_rng(6))
    screens = screens_of(echoes, AHEAD, LEAST)
    assert (screens[:, :3] @ AHEAD > LEAST).all()
    assert (screens[:, :3] @ normal).max() > np.cos(np.radians(8))
    np.testing.assert_allclose(screens[:, 3] - screens[:, :3] @ echoes[-1].position, echoes[-1].range_m)


def test_what_a_known_wall_explains_screens_that_wall_alone_as_far_again():
    at = waving(14, rise_m=0.0)
    tracks, _ = follow_all(at, 3.0 - at[:, 1])
    assert len(tracks.screens(tracks.walls)) > 3
    wall = np.array([[0, 1, 0, 3.0, *at[0], 5.0]])
    screens = tracks.screens(wall)
    assert (screens[:, :4] == wall[:, :4]).all()
    assert screens[:, 7].max() == pytest.approx(2 * (5.0 - BEYOND_M) + BEYOND_M)
    assert screens[:, 7].min() == pytest.approx(SHADE_SLOPE * 3.0), "where it is heard, all across the beam"
    assert len(tracks.screens(wall + np.array([0, 0, 0, 0.5, 0, 0, 0, 0]))) > 3


def test_a_floor_explains_no_echo_louder_than_a_mirror_beside_the_beam():
    at = waving(14, rise_m=0.0)
    floor = ((-1, -1.5),)
    abeam_dbi = float(boresight_pattern(ul.AntennaSpec()).gain_dbi(np.pi / 2))
    for gain_db, told in ((abeam_dbi + 2.5, 14), (5.0, 0)):  # of the mirror that would echo so, over one before 0 dBi
        tracks, feet = follow_all(at, np.full(14, 1.5), levels=floor, mirror_m=1.5e-3 / 10 ** (gain_db / 10))
        assert len(feet) == told
        assert (tracks.screens(tracks.walls)[:, 2] > -0.99).any() == (told == 0)


@pytest.mark.parametrize("off_deg", [10, 35, 60, 85])
def test_a_mirror_off_boresight_is_never_too_loud_for_where_it_stands(off_deg):
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    wall = ul.scenes.plate(8, 8, 2.0, yaw_deg=off_deg, material="pec")
    away = np.array([np.cos(np.radians(off_deg)), np.sin(np.radians(off_deg)), 0.0]) * 2.0
    wall = replace(wall, vertices=wall.vertices - [2.0, 0, 0] + away)
    frames = ul.simulate(wall, ul.Trajectory.stationary(), radar)
    strength = float((frames.range_m * abs(frames.samples[0]))[frames.range_m > 1].max())
    within = least_cosine(strength, mirror_m(frames), boresight_pattern(radar.antenna))
    assert within <= np.cos(np.radians(off_deg))
    assert off_deg > 20 or within > np.cos(np.radians(50))


def test_the_screens_of_a_tanks_wall_lie_nowhere_far_behind_it():
    """A plane that touches a hollow wall at the foot leaves it beside that: silence there would free the wall."""
    at = np.column_stack([np.linspace(-0.6, 0.6, 25), np.full(25, 1.3), np.zeros(25)])
    away = np.hypot(at[:, 0], at[:, 1])
    echoes = [Echo(j, at[j], np.array([1.0, 0, 0]), 3.2 - away[j], 0.0, 1e-3, 0.02, 0.9) for j in range(25)]
    screens = screens_of(echoes, AHEAD, LEAST)
    turn = np.radians(90 + np.arange(-45, 46, 5))
    wall = 3.2 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))])
    near = np.linalg.norm(wall[:, None] - screens[:, 4:7], axis=2) < screens[:, 7]
    behind = np.where(near, screens[:, 3] - wall @ screens[:, :3].T, np.inf)
    level = abs(screens[:, 2]) < 0.1
    assert behind[:, level].min(axis=1).max() < 0.1
