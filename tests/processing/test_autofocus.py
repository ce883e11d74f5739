import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.processing.autofocus import PointEchoes, autofocus

SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
TRUE = ul.Trajectory.line((0, -0.7, 0), (0, 0.7, 0), 0.17, 17)
POINTS = [(2.0, 0.1, 0), (2.6, -0.5, 0), (3.1, 0.6, 0), (1.6, -0.2, 0)]
GRID = ul.Grid((1.2, -1.0, 0), 0.03, (67, 75))


def moved(step):
    return ul.Trajectory(TRUE.t_ns, TRUE.position + step, TRUE.quat_xyzw)


def sharpness(frames):
    power = np.abs(ul.focus(frames, GRID).values).astype(float) ** 2
    return float((power**2).sum() / power.sum() ** 2)


def white(sigma, seed=0):
    return np.random.default_rng(seed).normal(0, sigma, (len(TRUE), 3))


def drift():
    phase = np.linspace(0, 1, len(TRUE))
    return np.stack([0.02 * np.sin(5 * phase), 0.01 * np.cos(4 * phase), 0 * phase], axis=1)


@pytest.mark.parametrize(
    ("error", "regained"),
    [pytest.param(white(0.003), 0.2, id="white", marks=pytest.mark.slow), pytest.param(drift(), 0.5, id="drift")],
)
def test_autofocus_sharpens_what_pose_errors_blurred(error, regained):
    frames = frames_of_points(POINTS, TRUE, spec=SPEC, noise=0.05, believed=moved(error))
    ideal = sharpness(frames_of_points(POINTS, TRUE, spec=SPEC, noise=0.05))
    before, after = sharpness(frames), sharpness(autofocus(frames, GRID))
    assert before < 0.75 * ideal
    assert after > before + regained * (ideal - before)


def test_good_poses_stay_good():
    frames = frames_of_points(POINTS, TRUE, spec=SPEC, noise=0.05)
    assert sharpness(autofocus(frames, GRID)) > 0.97 * sharpness(frames)


def test_noise_alone_moves_nothing_far():
    frames = frames_of_points([(50.0, 0, 0)], TRUE, spec=SPEC, noise=1.0)
    after = autofocus(frames, GRID)
    assert np.abs(after.believed.position - TRUE.position).max() < 0.05


def test_the_gradient_is_that_of_the_entropy():
    frames = frames_of_points(POINTS, TRUE, spec=SPEC, believed=moved(white(0.003)))
    echoes = PointEchoes.of(frames, np.array(POINTS)[:, None, :].repeat(3, 1).reshape(-1, 3) + white(0.03)[:12])
    step = white(0.002, seed=5)
    value, slope = echoes.entropy(step)
    for n, k in ((3, 0), (40, 1), (100, 0)):
        nudge = np.zeros_like(step)
        nudge[n, k] = 2e-3
        up, down = echoes.entropy(step + nudge)[0], echoes.entropy(step - nudge)[0]
        assert slope[n, k] == pytest.approx((up - down) / 4e-3, rel=0.15, abs=2e-3)
    assert value > 0


def test_bad_priors_are_refused():
    with pytest.raises(ul.InputError, match="white_m -1"):
        autofocus(frames_of_points(POINTS, TRUE, spec=SPEC), GRID, white_m=-1)
