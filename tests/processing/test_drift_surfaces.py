from dataclasses import replace

import mirror_world as world
import numpy as np
import pytest
from test_mapper import GRID, PLAN, loop, moved, score

import ullage as ul
from ullage.data import Trajectory
from ullage.processing.baseband import as_baseband
from ullage.processing.drift_surfaces import correct_drift_by_surfaces
from ullage.processing.likelihood.drift_prior import Drift, DriftPrior
from ullage.processing.likelihood.pose_graph import PoseGraph, find_track
from ullage.processing.likelihood.spec import LikelihoodSpec


def wander(path, size_m):
    phase = np.linspace(0, 1, len(path))[:, None]
    offset = size_m * np.sin(2 * np.pi * phase * [1.3, 0.9, 0] + [0.5, 2.0, 0]) * [1, 1, 0]
    return offset - offset[0]


def shape_error(found, true):
    """Rms distance [m] of two tracks (n, 2) after the best turn and shift, and that turn [rad]."""
    a, b = found - found.mean(0), true - true.mean(0)
    turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turned = a @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return float(np.sqrt(((turned - b) ** 2).sum(1).mean())), float(turn)


def test_the_prior_is_a_matern_process_with_sparse_precision():
    """Correlation (1 + a + 2 a^2 / 5 + a^3 / 15) exp(-a), a = sqrt(5) t / T [Rasmussen2006]; the rate is sigma / T."""
    sigma, time = 0.2, 4.0
    prior = DriftPrior(10.0, 34.0, sigma, time)
    t_s = np.arange(10.0, 34.1, time / 5)  # at the knots, where the states are exact
    basis, precision = prior.basis(t_s).toarray(), prior.precision().toarray()
    got = basis @ np.linalg.inv(precision) @ basis.T
    a = np.sqrt(5.0) * np.abs(t_s[:, None] - t_s) / time
    np.testing.assert_allclose(got, sigma**2 * (1 + a + 0.4 * a**2 + a**3 / 15) * np.exp(-a), atol=1e-6)
    assert np.count_nonzero(precision) <= 12 * len(precision)
    rate = prior.basis(t_s, 1).toarray()
    np.testing.assert_allclose(np.diag(rate @ np.linalg.inv(precision) @ rate.T), (sigma / time) ** 2, rtol=1e-5)


def test_a_drift_keeps_its_values_and_rates_under_another_prior():
    """A process with three derivatives in its state follows them exactly at the knots of the other prior."""
    slow, quick = (DriftPrior(0.0, 30.0, 0.2, time_s) for time_s in (10.0, 2.5))
    t_s = np.arange(0.0, 30.1, 0.5)  # the knots of the second prior
    covariance = np.linalg.inv(slow.precision().toarray())
    drift = Drift(slow, np.random.default_rng(2).multivariate_normal(np.zeros(slow.size), covariance, 2))
    other = drift.under(quick)
    np.testing.assert_allclose(other.at(t_s), drift.at(t_s), atol=1e-9)
    np.testing.assert_allclose(other.at(t_s, 1), drift.at(t_s, 1), atol=1e-9)
    between = t_s[:-1] + 0.25
    np.testing.assert_allclose(other.at(between), drift.at(between), atol=1e-4)


@pytest.fixture(scope="module")
def flight():
    return world.rig(loop(rate=12.5), PLAN, seed=1)


@pytest.fixture(scope="module")
def drifted(flight):
    shift = wander(flight["front"], 0.2)
    return {
        name: moved(part, Trajectory(part.t_ns, part.believed.position + shift, part.believed.quat_xyzw))
        for name, part in flight.items()
    }


def evidence(frames):
    """Evidence of poses as they are."""
    parts, spec = [as_baseband(part) for part in frames.values()], LikelihoodSpec()
    prior = DriftPrior(*(parts[0].t_ns[[0, -1]] * 1e-9), 1e-3, 5.0)
    graph = PoseGraph(find_track(parts, spec), prior, spec, Drift(prior, np.zeros((2, prior.size))))
    return graph.evidence(graph.solve())


@pytest.mark.slow
def test_true_poses_have_the_most_evidence(flight, drifted):
    """Each of a thousand echoes that a surface predicts is worth about a nat; a drift costs many of them."""
    assert evidence(flight) > evidence(drifted) + 500


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_room_gives_a_drifting_track_back(flight, drifted):
    true = flight["front"].believed.position[:, :2]
    done = correct_drift_by_surfaces(drifted)
    got = done.frames["front"].believed.position[:, :2]
    found, turn = shape_error(got, true)
    assert done.corrected
    assert found < 0.01
    assert abs(turn) < np.radians(0.35)
    assert np.sqrt(((got - true) ** 2).sum(1).mean()) < 3 * np.sqrt((done.sigma_m**2).sum(1).mean()) < 0.15
    before, after = (score(ul.map_occupancy(frames, GRID), flight) for frames in (drifted, done.frames))
    assert after["f1"] > before["f1"] + 0.1
    assert after["surface_declared_free"] <= 0.01


def test_one_wall_leaves_the_offset_along_it_open():
    path = ul.Trajectory.line((-2, 0, 0), (2, 0, 0), rate_hz=25)
    mount = ul.Rig.preset("thesis-4").sensors["left"].mount.body_from_sensor()
    one = world.listen(path, [((-9.0, 2.0), (9.0, 2.0))], sensor="left", mount=mount)
    with pytest.warns(ul.UllageWarning, match="drift is not corrected"):
        got = correct_drift_by_surfaces(one)
    np.testing.assert_array_equal(got.frames[one.sensor].believed.position, one.believed.position)
    assert (got.sigma_m == 0.2).all()


def test_good_poses_are_kept_with_and_without_phase_and_bad_input_is_refused():
    path = ul.Trajectory.line((-0.2, 0, 0), (0.2, 0, 0), rate_hz=25)
    frames = world.listen(path, PLAN)
    for samples in (frames.samples, frames.amplitude):
        got = correct_drift_by_surfaces(replace(frames, samples=samples))
        assert not got.corrected
        np.testing.assert_array_equal(got.frames[frames.sensor].believed.position, frames.believed.position)
    for wrong in ({"drift_m": -1.0}, {"time_s": 0.0}, {"time_s": float("nan")}):
        with pytest.raises(ul.InputError, match=next(iter(wrong))):
            correct_drift_by_surfaces(frames, **wrong)
    with pytest.raises(ul.InputError, match="no poses"):
        correct_drift_by_surfaces(replace(frames, poses=None, truth=None))


def test_sensors_of_different_carriers_are_left_as_they_are():
    path = ul.Trajectory.line((-0.2, 0, 0), (0.2, 0, 0), rate_hz=25)
    one = world.listen(path, PLAN, sensor="one")
    other = replace(one, sensor="other", spec=one.spec.but(center_hz=1.1 * one.spec.center_hz))
    with pytest.warns(ul.UllageWarning, match="the carriers of the sensors differ"):
        assert not correct_drift_by_surfaces({"one": one, "other": other}).corrected
