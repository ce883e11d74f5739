"""Obstacle distances: laws of the range tracks, sectors from frames, and sensors that fail."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.data import Frames, Trajectory, even_times
from ullage.errors import InputError
from ullage.geometry import rpy_quat
from ullage.processing.obstacles import ObstacleSectors, ObstacleStage
from ullage.processing.range_tracks import Motion, RangeTracker, Track, TrackerSpec

RATE_HZ = 17.0
PERIOD_NS = round(1e9 / RATE_HZ)
AHEAD = np.array([1.0, 0.0, 0.0])


def motion(speed_m_s: float) -> Motion:
    return Motion(speed_m_s * AHEAD, AHEAD, math.radians(47.5))


def feed(tracker: RangeTracker, row: int, range_m: list[float], speed_m_s: float = 0.0) -> list[Track]:
    found = np.array(range_m, float)
    return tracker.step(row * PERIOD_NS, found, np.full(len(found), 0.01), np.full(len(found), 20.0), motion(speed_m_s))


def test_track_error_agrees_with_its_sigma() -> None:
    """The normalised error squared of range and closing speed averages two, its number of components (NEES)."""
    rng = np.random.default_rng(5)
    nees = []
    for _ in range(60):
        tracker, speed, place = RangeTracker(TrackerSpec(acceleration_m_s2=0.5)), 0.0, 6.0
        rate = rng.normal(0, 0.5)
        for row in range(40):
            if row:
                push = rng.normal(0, 0.5)
                place += rate / RATE_HZ + push / RATE_HZ**2 / 2
                rate += push / RATE_HZ
                change = 0.03 if 10 <= row < 30 else 0.0  # the drone speeds up: known from odometry
                speed, rate, place = speed + change, rate - change, place - change / RATE_HZ
            tracks = feed(tracker, row, [place + rng.normal(0, 0.01)], speed)
        track = tracks[0]
        error = np.array([track.range_m - place, track.rate_m_s - rate])
        cov = np.array([[track.var_r, track.cov], [track.cov, track.var_v]])
        nees.append(error @ np.linalg.solve(cov, error))
    assert 1.0 < np.mean(nees) < 2.7  # 60 flights know a mean of two to 0.26


def test_odometry_moves_the_closing_speed_at_once() -> None:
    tracker = RangeTracker()
    place = 4.0
    for row in range(20):
        feed(tracker, row, [place])
    (track,) = feed(tracker, 20, [place], 0.0)
    assert abs(track.closing_m_s) < 0.05
    (track,) = feed(tracker, 21, [place - 0.5 / RATE_HZ], 0.5)
    assert track.closing_m_s == pytest.approx(0.5, abs=0.1)


def test_a_track_is_born_of_three_hits_in_five_frames_and_no_fewer() -> None:
    assert not any(feed(RangeTracker(), row, [3.0]) for row in range(1))
    often, rare = RangeTracker(), RangeTracker()
    born = [bool(feed(often, row, [3.0] if hit else [])) for row, hit in enumerate((1, 0, 1, 0, 1))]
    assert born == [False, False, False, False, True]
    assert not any(feed(rare, row, [3.0] if row % 3 == 0 else []) for row in range(30))


def test_a_score_keeps_out_tracks_that_jump_between_unrelated_echoes() -> None:
    false = {}
    for odds in (1.0, TrackerSpec().odds):
        rng, tracker, found, false[odds] = np.random.default_rng(3), RangeTracker(TrackerSpec(odds=odds)), 0, 0
        for row in range(120):
            tracks = feed(tracker, row, [*rng.uniform(1.0, 9.0, 24), 3.0 + rng.normal(0, 0.01)])
            near = [abs(track.range_m - 3.0) < 0.1 for track in tracks]
            found += any(near)
            false[odds] += len(near) - sum(near)
        assert found > 100
    assert false[TrackerSpec().odds] < false[1.0] / 8


def test_a_confirmed_track_ends_when_it_is_hit_too_seldom() -> None:
    """A hit in four frames is what a track among unrelated echoes gets; a coast alone would keep it for ever."""
    for every, alive in ((2, True), (4, False)):
        tracker = RangeTracker()
        for row in range(60):
            tracks = feed(tracker, row, [3.0] if row < 8 or row % every == 0 else [])
        assert bool(tracks) == alive


def test_a_track_dies_when_its_echo_stays_away_but_not_inside_the_blind_range() -> None:
    for place, alive in ((2.0, False), (0.4, True)):
        tracker = RangeTracker(TrackerSpec(coast_s=0.4, blind_s=5.0))
        for row in range(10):
            feed(tracker, row, [place])
        tracker.blind_m = 0.45
        assert bool([feed(tracker, row, []) for row in range(10, 30)][-1]) == alive


@pytest.mark.parametrize("staggered", [False, True])
def test_an_echo_in_every_second_frame_is_a_fold_where_the_pulse_interval_alternates(staggered: bool) -> None:
    fold, steady = RangeTracker(staggered=staggered), RangeTracker(staggered=staggered)
    folds = [bool(feed(fold, row, [3.0] if row % 2 else [])) for row in range(40)]
    assert any(folds) != staggered
    assert all([bool(feed(steady, row, [3.0])) for row in range(40)][2:])


def box(place: str, size: str) -> str:
    return (
        f"<model name='{place}'><static>1</static><pose>{place} 0 0 0</pose><link name='l'><collision name='c'>"
        f"<geometry><box><size>{size}</size></box></geometry></collision></link></model>"
    )


FLOOR, WALL, LEFT_WALL = box("0 0 -0.1", "40 40 0.2"), box("4 0 3", "0.2 30 12"), box("0 4 3", "30 0.2 12")
POLE = (
    "<model name='pole'><static>1</static><pose>1.5 0 1.5 0 0 0</pose><link name='l'><collision name='c'>"
    "<geometry><cylinder><radius>0.05</radius><length>2.9</length></cylinder></geometry></collision></link></model>"
)


def world(tmp_path: Path, *models: str) -> ul.Scene:
    file = tmp_path / "w.sdf"
    file.write_text(f"<sdf version='1.9'><world name='w'>{''.join(models)}</world></sdf>")
    return ul.load_scene(str(file))


def flown(
    scene: ul.Scene, start: tuple[float, float, float], speed: tuple[float, float, float] = (0, 0, 0), *,
    pitch_deg: float = 0.0, frames: int = 30, rig: ul.Rig | None = None,
) -> list[ObstacleSectors]:  # fmt: skip
    t_ns = even_times(RATE_HZ, count=frames)
    quat = rpy_quat(np.zeros(frames), np.full(frames, math.radians(pitch_deg)), np.zeros(frames))
    path = Trajectory(t_ns, np.array(start) + t_ns[:, None] * 1e-9 * np.array(speed), quat)
    return one_by_one(ObstacleStage(), ul.simulate(scene, path, rig or ul.Rig.preset("thesis-4"), seed=1))


def filled(found: ObstacleSectors, below_m: float = 5.0) -> list[int]:
    """Azimuths of the elements with an obstacle nearer than a distance, counter-clockwise [deg], -175 to 180."""
    return sorted((5 * k + 175) % 360 - 175 for k in np.flatnonzero(found.nearest_m() < below_m).tolist())


@pytest.mark.parametrize("speed_m_s", [0.0, 0.7])
def test_a_wall_ahead_fills_the_elements_ahead_and_no_others(tmp_path: Path, speed_m_s: float) -> None:
    """The sides hear it 25 dB and the back 38 dB weaker: side lobes of one obstacle."""
    last = flown(world(tmp_path, WALL), (0.5, 0, 3), (speed_m_s, 0, 0))[-1]
    truth = 3.9 - 0.5 - speed_m_s * 29 / RATE_HZ
    assert 0 in filled(last)
    assert max(map(abs, filled(last))) <= 20
    assert np.nanmin(last.nearest_m()) == pytest.approx(truth, abs=0.05)
    assert np.degrees(np.abs(last.tracks.azimuth_rad)).max() < 15


@pytest.mark.parametrize(
    ("height_m", "speed", "pitch_deg"),
    [
        (1.5, (0, 0, 0), 0),
        (3.5, (0, 0, 0), 0),
        (1.5, (0, 0, 0), 10),
        (2.0, (0.7, 0, 0), 0),
        (2.0, (1.0, 0, 0), 10),
        (2.0, (0, 0, 0.5), 0),
    ],
)
def test_a_bare_floor_is_no_obstacle(
    tmp_path: Path, height_m: float, speed: tuple[float, float, float], pitch_deg: float
) -> None:
    for found in flown(world(tmp_path, FLOOR), (0, 0, height_m), speed, pitch_deg=pitch_deg):
        assert filled(found) == []


def test_a_pole_as_far_as_the_floor_counts(tmp_path: Path) -> None:
    last = flown(world(tmp_path, FLOOR, POLE), (0, 0, 1.45))[-1]
    assert 0 in filled(last)
    assert not {-90, -60, 60, 90, 180} & set(filled(last))


def test_the_direction_of_a_pole_is_where_it_is_now(tmp_path: Path) -> None:
    """It passes 1 m to the left: its range bends, which that to a wall does not."""
    for found in flown(world(tmp_path, POLE), (-0.4, -1, 1.5), (1, 0, 0), frames=40)[-8:]:
        left = np.argmin(np.where(found.tracks.sensor == 1, found.tracks.distance_m, np.inf))
        truth = math.degrees(math.atan2(0.9, 1.9 - found.t_ns * 1e-9))  # of the radar on the left side
        assert np.degrees(found.tracks.azimuth_rad[left]) == pytest.approx(truth, abs=4)  # type: ignore[index]


def test_a_hover_before_two_equal_walls_leaves_neither_free(tmp_path: Path) -> None:
    """Their levels and ranges are those of one thing between them too: all of it is reported."""
    scene = world(tmp_path, WALL, LEFT_WALL)
    assert {0, 45, 90} <= set(filled(flown(scene, (1, 1, 3))[-1]))
    moving = filled(flown(scene, (0.9, 1, 3), (0.5, 0, 0))[-1])
    assert {0, 90} <= set(moving)
    assert not {30, 45, 60} & set(moving)


def test_a_floor_of_known_height_is_no_obstacle_to_one_radar(tmp_path: Path) -> None:
    path = Trajectory.stationary(position_m=(0, 0, 2), n=20)
    frames = ul.simulate(world(tmp_path, FLOOR), path, ul.Rig.preset("single"), seed=1)
    for floor_z_m, free in ((None, False), (0.0, True)):
        last = one_by_one(ObstacleStage(floor_z_m=floor_z_m), frames)[-1]
        assert (0 not in filled(last)) == free


@pytest.mark.parametrize(
    ("rig", "wall_m", "speed_m_s"),
    [("single", 12, 0), ("single", 10, 0.5), ("thesis-4", 12, 0), ("thesis-4", -11.5, 0.5)],
)
def test_a_folded_wall_is_never_near_with_a_staggered_pulse_interval(
    tmp_path: Path, rig: str, wall_m: float, speed_m_s: float
) -> None:
    """A wall 10 m ahead pushed a vehicle back; 11.5 m past another one an obstacle stood 1.58 m behind."""
    wall = world(tmp_path, box(f"{wall_m + math.copysign(0.1, wall_m)} 0 3", "0.2 30 12"))
    one, two = (
        flown(wall, (0, 0, 3), (speed_m_s, 0, 0), rig=ul.Rig.preset(rig, **changes))
        for changes in ({}, {"stagger_div": 17})
    )
    assert not any(filled(found) for found in two)
    near = [found.tracks.ambiguous[found.tracks.distance_m < 5.0] for found in one]  # type: ignore[index]
    assert np.concatenate(near).size
    assert np.concatenate(near).all()


def test_the_level_of_a_near_wall_excludes_a_fold_and_that_of_a_wire_does_not(tmp_path: Path) -> None:
    wire = POLE.replace("<radius>0.05", "<radius>0.0015")
    for model, ambiguous in ((box("1.6 0 3", "0.2 30 12"), False), (wire, True)):
        tracks = flown(world(tmp_path, model), (0, 0, 1.5), rig=ul.Rig.preset("single"))[-1].tracks
        assert tracks.ambiguous[0] == ambiguous


@pytest.fixture(scope="module")
def hall() -> dict[str, Frames]:
    """Four radars fly at a wall 4 m ahead in a hall, 1.2 m over the floor."""
    path = Trajectory.line((-3, 0, -0.3), (-1.0, 0, -0.3), 0.7, RATE_HZ)
    return ul.simulate(ul.scenes.room(size_m=(8, 5, 3)), path, ul.Rig.preset("thesis-4"), seed=1)


def one_by_one(stage: ObstacleStage, frames: dict[str, Frames]) -> list[ObstacleSectors]:
    count = max(len(part) for part in frames.values())
    pieces = ({name: part[i : i + 1] for name, part in frames.items() if i < len(part)} for i in range(count))
    return [found for piece in pieces for found in stage.update(piece)]


def test_the_wall_ahead_bounds_the_sector_ahead(hall: dict[str, Frames]) -> None:
    last = one_by_one(ObstacleStage(), hall)[-1]
    front = last.sensors.index("front")
    truth = 4.0 - hall["front"].truth.position[-1, 0] + 0.1  # type: ignore[union-attr]
    assert last.distance_m[front] == pytest.approx(truth, abs=0.06)
    assert last.closing_speed_m_s[front] == pytest.approx(0.7, abs=0.05)
    assert last.time_to_collision_s[front] == pytest.approx(truth / 0.7, rel=0.1)
    assert last.time_to_collision_sigma_s[front] < 1.0
    assert last.valid.all()
    assert not last.stale.any()
    assert list(last.covers(0.0)) == [name == "front" for name in last.sensors]


def test_a_silent_sensor_has_an_unknown_distance(hall: dict[str, Frames]) -> None:
    stage = ObstacleStage()
    cut = hall | {"front": hall["front"][:20]}
    before, *_, after = one_by_one(stage, cut)
    front = after.sensors.index("front")
    assert before.valid[front]
    assert not after.valid[front]
    assert after.stale[front]
    assert math.isnan(after.distance_m[front])
    assert math.isnan(after.time_to_collision_s[front])
    assert after.valid.sum() == 3
    assert not stage.sectors(after.t_ns + 10**9).valid.any()


def test_distances_go_on_closing_between_the_frames_of_a_sensor(hall: dict[str, Frames]) -> None:
    """A sensor that is late but not yet stale does not leave its obstacle where it was."""
    stage = ObstacleStage()
    last = one_by_one(stage, hall)[-1]
    front = last.sensors.index("front")
    later = stage.sectors(last.t_ns + 400_000_000)
    assert later.valid[front]
    assert last.distance_m[front] - later.distance_m[front] == pytest.approx(0.4 * 0.7, abs=0.03)
    assert later.sigma_m[front] > last.sigma_m[front]
    assert np.isclose(later.tracks.distance_m, later.distance_m[front]).any()


@pytest.mark.parametrize("fault", ["zeros", "frozen"])
def test_a_sensor_that_repeats_itself_is_not_alive(hall: dict[str, Frames], fault: str) -> None:
    samples = hall["front"].samples.copy()
    samples[20:] = 0 if fault == "zeros" else samples[19]
    dead = hall | {"front": replace(hall["front"], samples=samples)}
    last = one_by_one(ObstacleStage(), dead)[-1]
    assert [name for name, ok in zip(last.sensors, last.valid, strict=True) if not ok] == ["front"]


def test_an_expected_sensor_that_never_reports_is_stale(hall: dict[str, Frames]) -> None:
    stage = ObstacleStage(expected=ul.Rig.preset("thesis-4").sensors)
    three = {name: part for name, part in hall.items() if name != "left"}
    last = one_by_one(stage, three)[-1]
    assert [last.sensors[k] for k in np.flatnonzero(~last.valid)] == ["left"]
    with pytest.raises(InputError, match=r"unknown radar 'roof'.*front, left, back, right"):
        list(stage.update({"roof": replace(hall["front"], sensor="roof")}))


def test_frames_in_pieces_or_at_once_give_the_same_distances(hall: dict[str, Frames]) -> None:
    at_once = list(ObstacleStage(own_echo=None).update(hall))
    pieces = one_by_one(ObstacleStage(own_echo=None), hall)
    assert len(at_once) == len(pieces)
    for a, b in zip(at_once, pieces, strict=True):
        assert a.t_ns == b.t_ns
        np.testing.assert_allclose(a.distance_m, b.distance_m, atol=1e-3)


def test_a_radar_mounted_upside_down_is_noticed_by_the_floor() -> None:
    scene = ul.scenes.room(size_m=(5, 4, 5))
    rig = ul.Rig.preset("thesis-4-down")
    down = rig.sensors["down"]
    real = ul.Rig(sensors={"down": down.but(mount=down.mount.but(pitch_deg=-90.0))})
    path = Trajectory.line((0, 0, -1.0), (0, 0, 0.8), 0.6, RATE_HZ)
    frames = ul.simulate(scene, path, real, seed=3)["down"]
    for spec, words in ((real.sensors["down"], ""), (down, "upside down")):
        turn = Trajectory(path.t_ns, path.position, path.quat_xyzw, path.velocity, path.angular_velocity).mounted(
            spec.mount.body_from_sensor()
        )
        believed = replace(frames, spec=spec, poses=turn, truth=None)
        last = one_by_one(ObstacleStage(), {"down": believed})[-1]
        assert words in last.fault[0]
        assert last.valid[0] == (not words)
