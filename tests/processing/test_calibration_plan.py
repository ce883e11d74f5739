"""What a planned flight tells of the nine quantities: laws, and the scatter of fits to simulated echoes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

import ullage as ul
from ullage.antenna import gain
from ullage.geometry import C0, quat_matrix, rpy_quat
from ullage.processing import calibration_plan
from ullage.processing.calibration_plan import CalibrationPlan, plan_calibration, quantities

RADAR = ul.RadarSpec.preset("pulson440", fps=20.0)
CLOCK, RATE, ZERO, ARM_X, ARM_Y, ARM_Z, UP, SIDE, SCALE = range(9)
PLACES = np.array([[3.0, -1.0, 1.0], [2.5, 1.5, 2.0], [3.5, 0.0, 1.8]])
UNKNOWN = {"survey_sigma_m": np.inf}


def track(position: np.ndarray, rpy_deg: np.ndarray | None = None, *, step_s: float = 0.05) -> ul.Trajectory:
    """A track with a pose each `step_s`."""
    turn = np.zeros_like(position) if rpy_deg is None else np.radians(rpy_deg)
    t_ns = np.rint(np.arange(len(position)) * step_s * 1e9).astype(np.int64)
    return ul.Trajectory(t_ns, position, rpy_quat(*turn.T))


def straight(n: int = 200) -> ul.Trajectory:
    y = np.linspace(-2, 2, n)
    return track(np.stack([0 * y, y, 0 * y + 1.5], 1))


def winding(n: int = 400) -> ul.Trajectory:
    s = np.linspace(0, 1, n)
    position = np.stack([0.8 * np.sin(9 * s), 1.5 * np.sin(7 * s + 1), 1.5 + 0.7 * np.sin(13 * s)], 1)
    return track(position, np.stack([8 * np.sin(40 * s), 8 * np.cos(33 * s), 40 * np.sin(11 * s)], 1))


def undetermined(plan: CalibrationPlan) -> np.ndarray:
    return plan.sigma > [one.wanted for one in plan.quantities]


def test_a_straight_run_at_one_speed_leaves_the_clock_to_the_places() -> None:
    unknown, surveyed = (plan_calibration(straight(), RADAR, PLACES, **case) for case in (UNKNOWN, {}))
    assert np.isinf(unknown.sigma[[CLOCK, ARM_X, ARM_Y]]).all()
    assert "clock" in unknown.undetermined
    assert surveyed.sigma[ZERO] < 0.02
    back = np.concatenate([straight().position, straight().position[::-1]])
    assert plan_calibration(track(back), RADAR, PLACES, **UNKNOWN).sigma[CLOCK] < 0.01  # the way back separates them


def test_scale_trades_with_range_zero_on_a_short_straight_track() -> None:
    place, level = [[3.0, 0.0, 1.5]], {"level_sigma_db": 1e3}
    found = []
    for path in (track(straight().position * [1, 0.2, 1]), winding()):
        plan = plan_calibration(path, RADAR, place, **UNKNOWN, **level)
        pair = np.ix_([ZERO, SCALE], [ZERO, SCALE])
        wanted = np.array([plan.quantities[k].wanted for k in (ZERO, SCALE)])
        covariance = np.linalg.inv(plan.information[pair]) * wanted[:, None] * wanted
        found.append((covariance[0, 1] / covariance[1, 1], np.sqrt(covariance[1, 1])))
    assert abs(found[0][0]) == pytest.approx(2 * 3.0, rel=0.05)  # 1 % of scale is 2 % of the range of 3 m
    assert found[0][1] > 20 * found[1][1]


def test_information_adds_over_reflectors_and_never_falls_with_frames() -> None:
    parts = [plan_calibration(winding(), RADAR, part).information for part in (PLACES[:1], PLACES[1:])]
    whole = plan_calibration(winding(), RADAR, PLACES)
    np.testing.assert_allclose(sum(parts), whole.information, rtol=1e-6, atol=1e-6 * whole.information.max())
    part = winding()[:250]
    assert (plan_calibration(part, RADAR, PLACES).sigma > whole.sigma).all()
    assert (plan_calibration(winding(), RADAR, PLACES, **UNKNOWN).sigma >= whole.sigma * (1 - 1e-9)).all()


def test_more_noise_and_a_narrower_band_cost_what_theory_says() -> None:
    exact = {"track_sigma_m": 1e-9, "level_sigma_db": 1e3}  # phases and envelopes alone
    good, bad = (plan_calibration(winding(), RADAR, PLACES, snr_db=snr, **exact, **UNKNOWN) for snr in (30.0, 10.0))
    known = [CLOCK, RATE, ZERO, ARM_X, ARM_Y, ARM_Z, SCALE]
    near = np.sqrt(np.diag(np.linalg.inv(good.information[np.ix_(known, known)])))
    far = np.sqrt(np.diag(np.linalg.inv(bad.information[np.ix_(known, known)])))
    np.testing.assert_allclose(far / near, 10.0, rtol=1e-3)
    exact["survey_sigma_m"] = 1e-9
    half = RADAR.but(bandwidth_hz=RADAR.bandwidth_hz / 2)
    wide, narrow = (
        plan_calibration(winding(), spec, PLACES, **exact).information[ZERO, ZERO] for spec in (RADAR, half)
    )
    assert wide / narrow == pytest.approx(4.0, rel=1e-3)  # the range zero acts on envelopes only


def echoes(theta: np.ndarray, path: ul.Trajectory, spec: ul.RadarSpec, at: np.ndarray) -> np.ndarray:
    """Complex samples (k, n, bins) of the model, written anew: nine quantities, then five of each reflector."""
    nine, rest = theta[:9] * [1e-3, 1e-4, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2], theta[9:].reshape(-1, 5)
    t_s = (path.t_ns - path.t_ns.mean()) * 1e-9
    late = nine[CLOCK] + nine[RATE] * t_s
    velocity, spin = path.rates
    turn = quat_matrix(path.quat_xyzw)
    half = np.linalg.norm(spin, axis=1) * late / 2
    axis = spin / np.maximum(np.linalg.norm(spin, axis=1), 1e-12)[:, None]
    later = quat_matrix(np.column_stack([axis * np.sin(half)[:, None], np.cos(half)]))
    body = turn @ later
    mount = spec.mount.body_from_sensor()
    arm = mount[:3, 3] + nine[3:6]
    place = (path.position + velocity * late[:, None]) * (1 + nine[SCALE]) + body @ arm
    tilt = quat_matrix(np.r_[0.0, np.sin(nine[UP] / 2), np.sin(nine[SIDE] / 2), 1.0][None] / np.linalg.norm(
        [0.0, np.sin(nine[UP] / 2), np.sin(nine[SIDE] / 2), 1.0]))[0]  # fmt: skip
    sensor = body @ mount[:3, :3] @ tilt
    out = []
    for where, (x, y, z, phase, level) in zip(PLACES, rest * [1e-2, 1e-2, 1e-2, 1.0, 1.0], strict=True):
        ray = where + np.array([x, y, z]) - place
        away = np.linalg.norm(ray, axis=1)
        pattern = gain(spec.antenna, np.einsum("nij,ni->nj", sensor, ray)) / gain(spec.antenna, [[1.0, 0, 0]])
        size = np.exp(level) * pattern**2 * (3.0 / away) ** 2
        envelope = np.exp(-0.5 * ((away[:, None] - nine[ZERO] - at) * 2 / C0 / spec.pulse_sigma_s) ** 2)
        turned = np.exp(1j * (phase - 4 * np.pi / spec.wavelength_m * away))
        out.append((size * turned)[:, None] * envelope)
    return np.array(out)


@pytest.mark.slow
def test_sigmas_are_the_scatter_of_fits_to_noisy_echoes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration_plan, "DISPERSION", 1.0)
    spec = RADAR.but(fps=4.0, mount=ul.MountSpec(position_m=(0.2, -0.1, 0.05), yaw_deg=20, pitch_deg=-10))
    path, at = winding().resampled(4.0), np.arange(1.0, 6.5, 0.05)
    energy = np.sqrt(np.pi) * C0 * spec.pulse_sigma_s / 2 / 0.05  # of the pulse over its peak, in bins
    sigma = np.sqrt(energy / 1e3)  # noise of one bin: 30 dB for the pulse
    plan = plan_calibration(path, spec, PLACES, survey_sigma_m=0.01, snr_db=30.0, level_sigma_db=1e-6,
                            track_sigma_m=1e-9)  # fmt: skip
    rng, found, theta = np.random.default_rng(2), [], np.zeros(9 + 5 * len(PLACES))
    clean = echoes(theta, path, spec, at)
    step = 1e-4

    def samples(value: np.ndarray) -> np.ndarray:
        return value.ravel().view(float) / (sigma / np.sqrt(2))

    slope = np.stack([samples(echoes(theta + step * one, path, spec, at) - echoes(theta - step * one, path, spec, at))
                      for one in np.eye(len(theta))], 1) / (2 * step)  # fmt: skip
    survey = np.zeros((9, len(theta)))
    for k in range(3):
        survey[3 * k : 3 * k + 3, 9 + 5 * k : 12 + 5 * k] = np.eye(3)
    unit = np.array([1e-3, 1e-4, *7 * [1e-2]])
    linear = unit * np.sqrt(np.diag(np.linalg.inv(slope.T @ slope + survey.T @ survey)))[:9]
    np.testing.assert_allclose(plan.sigma, linear, rtol=0.1)
    for _ in range(40):
        noisy = clean + sigma / np.sqrt(2) * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
        told = rng.normal(0, 1, 9)

        def misfit(value: np.ndarray, noisy: np.ndarray = noisy, told: np.ndarray = told) -> np.ndarray:
            return np.concatenate([samples(echoes(value, path, spec, at) - noisy), survey @ value - told])

        jacobian = np.vstack([slope, survey])
        fit = least_squares(misfit, theta, jac=lambda _, whole=jacobian: whole, method="lm")
        found.append(fit.x[:9] * unit)
    np.testing.assert_allclose(np.std(found, axis=0) / plan.sigma, 1.0, atol=0.35)  # 40 fits: 11 %, three sigma


def test_what_is_wanted_is_what_radar_and_mount_claim() -> None:
    mount = ul.MountSpec(angle_sigma_deg=2.5)
    wanted = [one.wanted for one in quantities(RADAR.but(mount=mount, range_zero_sigma_m=0.04))]
    assert wanted[ZERO : UP + 1] == pytest.approx([0.04, 0.01, 0.01, 0.01, np.radians(2.5)])
    shown = plan_calibration(straight(), RADAR.but(mount=mount), PLACES, **UNKNOWN).undetermined
    assert {"clock", "lever arm x"} <= set(shown)


def test_changes_that_hide_each_other_are_named_together() -> None:
    one = np.zeros(9)
    one[[CLOCK, ARM_Y]] = 2.0, 1.0  # all that is shown of the two
    information = 1e4 * (np.outer(one, one) + np.diag([0.0, 1, 1, 1, 0, 1, 1, 1, 1]))
    plan = CalibrationPlan(quantities(RADAR), information)
    assert plan.undetermined == ("lever arm y by +10 mm with clock by -5 ms",)
    assert np.isinf(plan.sigma[[CLOCK, ARM_Y]]).all()
    assert plan.sigma[RATE] == pytest.approx(5e-5 / 100)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reflectors": [[1.0, 2.0]]}, r"\(r, 3\)"),
        ({"reflectors": [[1.0, np.nan, 2.0]]}, r"finite"),
        ({"survey_sigma_m": 0.0}, "survey_sigma_m is 0"),
        ({"track_sigma_m": -1.0}, "track_sigma_m is -1"),
        ({"track": ul.Trajectory.stationary()}, "one pose"),
    ],
)
def test_impossible_plans_are_refused(changes: dict, words: str) -> None:
    given = {"track": straight(), "spec": RADAR, "reflectors": PLACES} | changes
    with pytest.raises(ul.InputError, match=words):
        plan_calibration(**given)
