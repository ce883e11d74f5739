"""One call, any number of sensors, any cut of the track: the same bits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ullage as ul
from ullage.data import Frames, Trajectory, joined
from ullage.errors import InputError
from ullage.fan import reaching_max_range
from ullage.geometry import rpy_quat
from ullage.radar.receiving import sensor_seed
from ullage.radar.simulate import LEAD, simulate, simulate_stream
from ullage.specs import RadarSpec, Rig, ThesisSpec

X4 = RadarSpec.preset("x4m05", thesis=ThesisSpec(rays_per_side=12))
ROOM = ul.scenes.room(size_m=(6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})


def winding(n):
    t = np.arange(n) * 58_823_529
    s = t * 1e-9
    place = np.stack([np.sin(s), 0.5 * np.cos(s), 0.2 * s], 1)
    return Trajectory(t, place, rpy_quat(0.1 * np.sin(s), 0.05 * s, 0.7 * s))


PATH = winding(23)
WHOLE = {f: simulate(ROOM, PATH, X4, fidelity=f, seed=5) for f in ("thesis", "physical")}


@pytest.mark.parametrize("fidelity", ["thesis", "physical"])
@given(chunk=st.integers(1, 30), cut=st.integers(1, 22))
@settings(max_examples=8, deadline=None)
def test_cutting_the_track_changes_no_bit(fidelity, chunk, cut):
    whole = WHOLE[fidelity]
    pieces = [p["radar"] for p in simulate_stream(ROOM, PATH, X4, fidelity=fidelity, seed=5, chunk=chunk)]
    assert len(pieces[0]) == min(chunk, LEAD)  # somebody waits for it
    assert [len(p) for p in pieces[1:-1]] == [chunk] * (len(pieces) - 2)
    assert joined(pieces).samples.tobytes() == whole.samples.tobytes()
    rest = list(simulate_stream(ROOM, PATH[cut:], X4, fidelity=fidelity, seed=5, first_frame=cut, chunk=64))
    assert joined([p["radar"] for p in rest]).samples.tobytes() == whole.samples[cut:].tobytes()
    assert np.array_equal(joined(pieces).truth.quat_xyzw, whole.truth.quat_xyzw)


def test_what_the_frames_say_of_themselves():
    thesis, physical = WHOLE["thesis"], WHOLE["physical"]
    assert (thesis.unit, physical.unit) == ("thesis", "path_gain")
    assert (thesis.samples.dtype, physical.samples.dtype) == (np.float32, np.complex64)
    for frames in WHOLE.values():
        assert frames.sensor == "radar"
        assert np.array_equal(frames.t_ns, PATH.t_ns)
        assert np.array_equal(frames.range_m, frames.spec.range_m)
        assert np.array_equal(frames.truth.position, PATH.position)
    assert (thesis.spec, physical.spec) == (reaching_max_range(X4), X4)


def test_a_rig_gives_each_sensor_its_own_rays_and_its_own_noise():
    rig = Rig.preset("thesis-4", radar=X4)
    out = simulate(ROOM, PATH, rig, fidelity="thesis", seed=5)
    assert list(out) == ["front", "left", "back", "right"]
    alone = simulate(ROOM, PATH, Rig(sensors={"left": rig.sensors["left"]}), fidelity="thesis", seed=5)["left"]
    assert np.array_equal(alone.samples, out["left"].samples)
    assert np.allclose(out["left"].truth.position, PATH.mounted(rig.sensors["left"].mount.body_from_sensor()).position)
    empty = simulate(ul.Scene.empty(), PATH, rig, fidelity="thesis", seed=5)
    assert abs(np.corrcoef(empty["front"].samples.ravel(), empty["back"].samples.ravel())[0, 1]) < 0.1
    assert sensor_seed(5, "front") != sensor_seed(5, "back") != sensor_seed(6, "back")


@pytest.mark.parametrize("fidelity", ["thesis", "physical"])
def test_the_seed_decides_and_noise_none_is_clean(fidelity):
    again = simulate(ROOM, PATH[:3], X4, fidelity=fidelity, seed=5)
    assert np.array_equal(again.samples, WHOLE[fidelity].samples[:3])
    other = simulate(ROOM, PATH[:3], X4, fidelity=fidelity, seed=6)
    assert not np.array_equal(again.samples, other.samples)
    silent = [simulate(ul.Scene.empty(), PATH[:3], X4.but(noise=None), fidelity=fidelity, seed=s) for s in (1, 2)]
    assert not silent[0].samples.any()
    assert silent[0].samples.dtype == silent[1].samples.dtype == again.samples.dtype


def test_believed_poses_are_what_processing_sees():
    wrong = Trajectory(PATH.t_ns, PATH.position + np.array([0.1, 0, 0]), PATH.quat_xyzw)
    frames = simulate(ROOM, PATH, X4, fidelity="thesis", seed=5, believed=wrong)
    assert np.array_equal(frames.samples, WHOLE["thesis"].samples)
    assert frames.poses.position == pytest.approx(PATH.position + np.array([0.1, 0, 0]))
    assert frames.truth.position == pytest.approx(PATH.position)


def test_progress_counts_every_sensors_frames():
    seen = []
    simulate(ROOM, PATH, Rig.preset("thesis-4", radar=X4), fidelity="thesis", progress=lambda *a: seen.append(a))
    assert seen[-1] == (92, 92)


def test_a_stream_can_be_left_early_and_starts_at_once():
    stream = simulate_stream(ROOM, PATH, X4, fidelity="thesis", chunk=2)
    first = next(stream)["radar"]
    assert isinstance(first, Frames)
    assert len(first) == 2
    stream.close()


def test_rf_output_of_both_models():
    rf = X4.but(output="rf", bins=1504)
    for fidelity, spec in (("thesis", reaching_max_range(rf)), ("physical", rf)):
        frames = simulate(ROOM, PATH[:2], rf, fidelity=fidelity)
        assert frames.samples.shape == (2, spec.bins)
        assert frames.samples.dtype == np.float32
        assert np.isfinite(frames.samples).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fidelity": "optical"}, "no fidelity 'optical' .allowed: physical, thesis."),
        ({"max_bounces": 7}, "max_bounces is 7 .*1 to 6"),
        ({"max_bounces": 1.0}, "max_bounces is 1.0"),
        ({"seed": -1}, "seed is -1"),
        ({"scene": "room.sdf"}, "scene is a str .allowed: a Scene"),
        ({"path": np.zeros((3, 3))}, "path is a ndarray .allowed: a Trajectory"),
        ({"radar": {"name": "x4m05"}}, "radar is a dict .allowed: a RadarSpec or Rig"),
        ({"believed": winding(5)}, "believed is not at the times of path"),
        ({"believed": 3}, "believed is a int"),
    ],
)
def test_bad_input_is_refused_in_one_line(changes, words):
    good = {"scene": ROOM, "path": PATH, "radar": X4, "fidelity": "thesis"}
    with pytest.raises(InputError, match=words) as caught:
        simulate(**(good | changes))
    assert "\n" not in str(caught.value)


def test_a_bad_chunk_is_refused_before_the_first_frame():
    with pytest.raises(InputError, match="chunk is 0"):
        simulate_stream(ROOM, PATH, X4, fidelity="thesis", chunk=0)
