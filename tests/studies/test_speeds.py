"""Speed and frame rate: a frame of a moving radar follows the sinc law, keeps its noise, and has the right poses."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from studies.thesis import motion, speeds

SPEC = ul.RadarSpec.preset("x4m05")
AHEAD = ul.Trajectory.line((0, 0, 0), (0.4, 0, 0), speed_m_s=0.5, rate_hz=50)


def flown(speed_m_s: float, spec: ul.RadarSpec = SPEC, scene: ul.Scene | None = None, **options: bool) -> ul.Frames:
    world = ul.scenes.plate(0.5, 0.5, 4.0) if scene is None else scene
    return motion.fly_at(
        world, AHEAD, ul.Rig(sensors={"front": spec}), speed_m_s=speed_m_s, path_speed_m_s=0.5, **options
    )["front"]


def test_the_integration_time_is_that_of_the_highest_frame_rate() -> None:
    assert SPEC.sweeps_s == pytest.approx(SPEC.duty / SPEC.max_fps)
    assert motion.blind_speed_m_s(SPEC) == pytest.approx(0.369, abs=0.001)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 1.5])
def test_an_echo_ahead_loses_what_the_sinc_law_says(share: float) -> None:
    quiet = SPEC.but(noise=None)
    speed = share * motion.blind_speed_m_s(SPEC)
    frames = flown(speed, quiet)
    still = ul.simulate(ul.scenes.plate(0.5, 0.5, 4.0), frames.believed, quiet)
    level = 20 * np.log10(np.median(abs(frames.samples).max(1) / abs(still.samples).max(1)))
    assert level == pytest.approx(float(motion.loss_db(speed, SPEC)), abs=0.3)


def test_instantaneous_frames_lose_nothing() -> None:
    frames = flown(motion.blind_speed_m_s(SPEC), SPEC.but(noise=None), integrate=False)
    still = ul.simulate(ul.scenes.plate(0.5, 0.5, 4.0), frames.believed, SPEC.but(noise=None))
    assert np.allclose(frames.samples, still.samples, rtol=1e-3, atol=1e-9)


def test_summing_in_motion_leaves_the_noise_as_it_was() -> None:
    empty = ul.scenes.plate(0.1, 0.1, 30.0)
    rows = [flown(0.4, scene=empty, integrate=whole).samples[:, 100:] for whole in (True, False)]
    summed, instant = (np.std(np.diff(row, axis=0)) for row in rows)
    assert summed == pytest.approx(instant, rel=0.1)


def test_a_faster_flight_has_fewer_frames_at_the_same_rate_and_place() -> None:
    slow, fast = flown(0.25), flown(1.0)
    assert len(slow) == pytest.approx(4 * len(fast), abs=4)
    for frames, speed in ((slow, 0.25), (fast, 1.0)):
        assert np.diff(frames.t_ns) == pytest.approx(1e9 / SPEC.fps, abs=2)
        assert np.diff(frames.believed.position[:, 0]) == pytest.approx(speed / SPEC.fps, rel=1e-3)


def test_spacing_beyond_the_beam_s_limit_spreads_the_image() -> None:
    assert speeds.spacing(SPEC, 0.5) == pytest.approx(0.5 / 17 / SPEC.wavelength_m)
    assert speeds.widest(SPEC) > 0.25
    energy, width = speeds.past_wire(SPEC, (0.5, 1.5))
    assert energy.value[1] > energy.value[0] + 6
    assert np.all(width.value > 0.01)
