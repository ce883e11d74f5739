import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.processing.baseband import noise_sigma
from ullage.processing.track import level_of_sums, tracked, window

SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
PATH = ul.Trajectory.line((0, -0.6, 0), (0, 0.6, 0), speed_m_s=0.5, rate_hz=25, yaw_deg=0)


def white(seed, sigma=1e-4):
    rng = np.random.default_rng(seed)
    x = sigma * (rng.standard_normal((len(PATH), SPEC.bins, 2)) @ [1, 1j])
    return ul.Frames(x, SPEC.range_m, PATH.t_ns, SPEC, poses=PATH)


@pytest.mark.parametrize("pfa", [1e-2, 1e-3])
def test_noise_alarms_no_more_often_than_stated(pfa):
    alarms = sum(len(ul.detect(white(seed), method="track", pfa=pfa)) for seed in range(12))
    rate = alarms / (12 * len(PATH) * SPEC.bins)
    assert pfa / 40 < rate < pfa


def test_the_level_of_a_sum_is_the_gamma_law():
    level = level_of_sums(1e-2)
    assert level[1] == pytest.approx(-np.log(1e-2))
    drawn = np.random.default_rng(1).exponential(size=(200_000, 8)).sum(axis=1)
    assert (drawn > level[8]).mean() == pytest.approx(1e-2, rel=0.1)


def test_a_hyperbola_is_found_that_no_frame_shows():
    frames = frames_of_points([(3.0, 0.2, 0)], PATH, spec=SPEC, noise=0.45, seed=4)
    truth = np.hypot(3.0, 0.2 - PATH.position[:, 1])

    def share(hits):
        near = abs(hits.range_m - truth[hits.frame]) < 0.1
        return len(set(hits.frame[near])) / len(frames)

    assert share(ul.detect(frames, method="track", pfa=1e-4)) > 0.95
    assert share(ul.detect(frames, method="cfar", pfa=1e-4)) < 0.5
    assert share(ul.detect(frames)) < 0.5


def test_range_and_signal_to_noise_are_told():
    frames = frames_of_points([(3.0, 0.0, 0)], PATH, spec=SPEC, noise=0.05, seed=5)
    hits = ul.detect(frames, method="track")
    middle = hits.frame == len(frames) // 2
    assert hits.range_m[middle] == pytest.approx([3.0], abs=0.02)
    assert hits.snr_db[middle] == pytest.approx([20 * np.log10(1 / 0.0707)], abs=1.5)


def test_standing_still_adds_no_frames():
    still = ul.Trajectory.stationary(n=20)
    rows, along = window(still, 7, 0.6)
    assert rows.tolist() == [7]
    assert along.tolist() == [0.0]
    rows, along = window(PATH, 30, 0.6)
    assert 20 < len(rows) <= 41
    assert abs(along).max() <= 0.3 + 1e-9


@pytest.mark.parametrize(("change", "words"), [({"pfa": 0.7}, "pfa is 0.7"), ({"window_m": -1.0}, "window_m is -1.0")])
def test_numbers_out_of_bounds_are_refused(change, words):
    with pytest.raises(ul.InputError, match=words):
        ul.detect(white(1), method="track", **change)


def test_frames_without_poses_or_noise_are_refused():
    from dataclasses import replace

    frames = white(1)
    with pytest.raises(ul.InputError, match="no poses"):
        ul.detect(replace(frames, poses=None), method="track")
    quiet = frames_of_points([(3.0, 0, 0)], PATH, spec=SPEC)
    assert noise_sigma(quiet) < 1e-6
    with pytest.raises(ul.InputError, match="no exponential noise"):
        tracked(quiet, 0.0, pfa=1e-4, window_m=0.6, min_range_m=0.0)


def test_frames_beyond_a_bend_are_left_out():
    corner = np.r_[np.arange(-0.3, 0, 0.02), np.zeros(15)], np.r_[np.zeros(15), np.arange(0, 0.3, 0.02)]
    path = ul.Trajectory(
        np.arange(30) * 40_000_000, np.column_stack([*corner, np.zeros(30)]), np.tile([0, 0, 0, 1.0], (30, 1))
    )
    for index in (12, 17):
        rows, _ = window(path, index, 0.6)
        assert index in rows
        assert np.ptp(rows) == len(rows) - 1, "one stretch"
        aside = path.position[rows][:, 1 if index < 15 else 0]
        assert abs(aside).max() < 0.05


def test_few_hyperbolas_that_only_cross_a_strong_echo_count():
    """Flying at a thing, those of the other bearing meet it at an end of the track, half a metre off in the middle."""
    path = ul.Trajectory.line((0.0, 0, 0), (1.2, 0, 0), speed_m_s=0.5, rate_hz=25, yaw_deg=0)
    frames = frames_of_points([(2.6, 0.0, 0)], path, spec=SPEC, noise=0.003, seed=6)
    hits = ul.detect(frames, method="track")
    gap = (2.6 - path.position[:, 0])[hits.frame] - hits.range_m
    assert np.isin(np.arange(len(frames)), hits.frame[abs(gap) < 0.1]).all()
    assert len(set(hits.frame[abs(gap) > 0.25])) < 0.2 * len(frames)  # half of the frames, were all power added
