from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.errors import CalibrationError
from ullage.geometry import rpy_quat
from ullage.processing.bundle import Bundle
from ullage.processing.calibrate import _elsewhere, _Prior, _refuse
from ullage.processing.motion_match import Gains
from ullage.processing.point_focus import ARM, PARAMETERS

DATA = Path(__file__).parents[3] / "shared/data/pulson440"
RAIL, FLIGHT = DATA / "rail_a", DATA / "flight_a"
SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
POINTS = [(2.5, 0.6, 1.0), (3.4, 1.3, 1.0), (1.8, 1.5, 1.0), (2.9, -0.4, 1.0), (4.0, 0.2, 1.0)]


def uneven_track(n=3000, rate_hz=200.0):
    """Standing, an uneven run along y, standing again."""
    t = np.arange(n) / rate_hz
    speed = np.where((t > 4) & (t < 11), 0.2 + 0.1 * np.sin(1.7 * t), 0.0)
    y = np.cumsum(speed) / rate_hz
    position = np.stack([0.01 * np.sin(y * 3), y, np.full(n, 1.0)], axis=1)
    return ul.Trajectory(np.rint(t * 1e9).astype(np.int64), position, np.tile(rpy_quat(0, 0, 0), (n, 1)))


@pytest.fixture(scope="module")
def planted():
    """Frames of points, 2.5 s late on the track's clock and 0.3 m too far."""
    track = uneven_track()
    when = np.rint((2.5 + np.arange(380) / 40.0) * 1e9).astype(np.int64)
    clean = frames_of_points(POINTS, track.at(when), spec=SPEC, noise=0.05)
    return ul.Frames(clean.samples, clean.range_m + 0.3, when - when[0], SPEC, track=track, unit="normalised")


@pytest.fixture(scope="module")
def focused(planted):
    return ul.calibrate(planted)


@pytest.mark.slow
def test_planted_offsets_are_found_without_knowing_the_targets(focused):
    record = focused.calibration
    assert record is not None
    assert record.t_offset_s == pytest.approx(2.5, abs=0.02)
    assert record.range_offset_m == pytest.approx(-0.3, abs=0.01)
    assert 0 < record.t_sigma_s < 0.1
    assert 0 < record.range_sigma_m < 0.1
    assert record.gain_db > 0
    assert record.probability > 0.95
    assert record.modes[0][:2] == (record.t_offset_s, record.range_offset_m)
    assert np.array_equal(focused.believed.t_ns, focused.t_ns)
    image = ul.focus(focused, ul.Grid((2.2, 0.3, 1.0), 0.02, (30, 30)))
    assert np.linalg.norm(image.peak_m - (2.5, 0.6, 1.0)) < 0.05


@pytest.mark.slow
def test_range_is_found_to_millimetres_where_the_antenna_is_tracked(planted, focused):
    record = ul.calibrate(planted, guess=(2.5, 0.1), t_span_s=2.7, lever_arm_sigma_m=0).calibration
    assert record.range_offset_m == pytest.approx(-0.3, abs=0.006)
    assert abs(record.range_offset_m + 0.3) < 4 * record.range_sigma_m
    assert record.range_sigma_m < 0.006  # 5.2 mm, of which a scale of the track known to 1e-3 is a part
    assert focused.calibration.range_sigma_m == pytest.approx(0.05, abs=0.005)  # the unknown place of the antenna


@pytest.mark.parametrize("sigma_m", [-0.1, np.nan, np.inf])
def test_an_unusable_sigma_of_the_antenna_is_refused(planted, sigma_m):
    with pytest.raises(ul.InputError, match=r"lever_arm_sigma_m is .*allowed: metres"):
        ul.calibrate(planted, lever_arm_sigma_m=sigma_m)


def test_a_standing_sensor_cannot_be_calibrated():
    path = ul.Trajectory.stationary(n=20)
    frames = frames_of_points([(2.0, 0, 0)], path, spec=SPEC)
    with pytest.raises(ul.InputError, match=r"the track spans 0.00 m"):
        ul.calibrate(frames)


def test_a_track_in_millimetres_is_suspected(planted):
    track = planted.track
    wrong = ul.Trajectory(track.t_ns, 1e3 * track.position, track.quat_xyzw)
    with pytest.raises(ul.InputError, match="m/s; its positions may be in millimetres"):
        ul.calibrate(replace(planted, track=wrong))


@pytest.mark.slow
def test_swapped_axes_are_suspected(planted):
    track = planted.track
    lying = ul.Trajectory(track.t_ns, track.position, np.tile(rpy_quat(np.pi / 2, 0, 0), (len(track), 1)))
    with pytest.warns(ul.UllageWarning, match="axes may be swapped"):
        found = ul.calibrate(replace(planted, track=lying), guess=(2.5, 0.05), t_span_s=2.7)
    assert found.calibration.t_offset_s == pytest.approx(2.5, abs=0.02)  # it is only a suspicion


def test_a_span_without_overlap_is_refused(planted):
    track = planted.track
    late = ul.Trajectory(track.t_ns + 100_000_000_000, track.position, track.quat_xyzw)
    with pytest.raises(ul.InputError, match=r"do not overlap within 20\.0 s"):
        ul.calibrate(replace(planted, track=late), t_span_s=20.0)


@pytest.mark.slow
def test_a_radar_that_never_moved_is_refused(planted):
    rng = np.random.default_rng(2)
    still = np.repeat(planted.samples[:1], len(planted), 0)
    still = still + 0.05 * (rng.normal(size=still.shape) + 1j * rng.normal(size=still.shape))
    with pytest.raises(CalibrationError, match="echoes do not follow the track"):
        ul.calibrate(replace(planted, samples=still))


@pytest.mark.slow
def test_noise_without_any_reflector_is_refused(planted):
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(2, *planted.samples.shape))
    with pytest.raises(CalibrationError, match="echoes do not follow the track"):
        ul.calibrate(replace(planted, samples=noise[0] + 1j * noise[1]), guess=(2.5, 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("ppm", [50, -200])
def test_a_radar_clock_of_another_rate_leaves_the_offset_within_its_doubt(planted, ppm):
    """The offset is that at the middle of the motion, since the rate is not corrected."""
    wrong = np.rint(planted.t_ns / (1 + ppm * 1e-6)).astype(np.int64)
    frames = replace(planted, t_ns=wrong)
    record = ul.calibrate(frames, guess=(2.5, 0.1), t_span_s=2.7, lever_arm_sigma_m=0).calibration
    middle_s = 5.0  # of the run along the track, on the radar's clock
    assert abs(record.t_offset_s - (2.5 + ppm * 1e-6 * middle_s)) < 4 * record.t_sigma_s + 1e-3
    assert abs(record.range_offset_m + 0.3) < 4 * record.range_sigma_m


@pytest.mark.slow
def test_a_track_that_covers_half_of_the_recording_is_enough(planted):
    track = planted.track
    late = track.t_ns >= 7_000_000_000
    part = ul.Trajectory(track.t_ns[late], track.position[late], track.quat_xyzw[late])
    with pytest.warns(ul.UllageWarning, match="frames outside the track are left out"):
        record = ul.calibrate(replace(planted, track=part)).calibration
    assert abs(record.t_offset_s - 2.5) < 4 * record.t_sigma_s
    assert abs(record.range_offset_m + 0.3) < 3 * record.range_sigma_m


@pytest.mark.slow
def test_even_motion_without_halts_is_refused_unless_the_clock_is_guessed():
    """A straight run at one speed looks the same at every clock offset."""
    t = np.arange(4000) / 200.0
    position = np.stack([0 * t, 0.2 * t, 1 + 0 * t], 1)
    track = ul.Trajectory(np.rint(t * 1e9).astype(np.int64), position, np.tile(rpy_quat(0, 0, 0), (4000, 1)))
    when = np.rint((7.0 + np.arange(240) / 40.0) * 1e9).astype(np.int64)
    clean = frames_of_points(POINTS, track.at(when), spec=SPEC, noise=0.05)
    frames = ul.Frames(clean.samples, clean.range_m, when - when[0], SPEC, track=track, unit="normalised")
    with pytest.raises(CalibrationError, match="no clock offset is certain"):
        ul.calibrate(frames, t_span_s=9.0)
    record = ul.calibrate(frames, guess=(7.0, 0.02), t_span_s=9.0).calibration
    assert record.t_offset_s == pytest.approx(7.0, abs=0.06)


@pytest.mark.slow
def test_surveyed_reflectors_settle_both_offsets(planted):
    record = ul.calibrate(planted, reflectors=[(2.5, 0.6, 1.0), (1.8, 1.5, 1.0)]).calibration
    assert record is not None
    assert record.t_offset_s == pytest.approx(2.5, abs=0.01)
    assert record.range_offset_m == pytest.approx(-0.3, abs=0.01)
    assert "surveyed" in record.method


@pytest.mark.slow
def test_a_measured_zero_is_weighed_with_the_focus(planted, focused):
    focus = focused.calibration

    def weighed(zero_m, sigma_m):
        measured = replace(planted, spec=SPEC.but(range_zero_m=zero_m, range_zero_sigma_m=sigma_m))
        return ul.calibrate(measured, guess=(2.5, 0.1), t_span_s=2.7).calibration

    near, far = weighed(0.32, 0.001), weighed(0.9, 0.02)
    assert focus is not None
    assert near is not None
    assert near.range_offset_m == pytest.approx(-0.32, abs=0.003)
    assert near.range_sigma_m <= 0.00101  # the prior has tails
    assert "range_zero_m" in near.method
    assert far is not None
    assert far.range_offset_m == pytest.approx(focus.range_offset_m, abs=0.05)


@pytest.mark.parametrize("guess", [(1.0,), (1.0, 0.0), (1.0, 0.1, 0.2), (np.nan, 1.0)])
def test_guesses_that_are_none_are_refused(planted, guess):
    with pytest.raises(ul.InputError, match=r"guess is .*allowed: \(clock, sigma\)"):
        ul.calibrate(planted, guess=guess)


def test_places_that_are_none_are_refused(planted):
    with pytest.raises(ul.InputError, match=r"reflectors of shape \(1, 2\)"):
        ul.calibrate(planted, reflectors=[(1, 2)])


@pytest.mark.slow
@pytest.mark.skipif(not RAIL.exists(), reason="the real rail recording is not here")
@pytest.mark.filterwarnings("ignore:.*packets are missing:ullage.errors.UllageWarning")
def test_the_real_rail_calibrates_itself():
    found = ul.calibrate(ul.open(str(RAIL)).frames())  # with the zero of the campaign's other rail
    record, fitted = found.calibration, np.load(RAIL / "decoded.npz")
    assert record is not None
    assert record.t_offset_s == pytest.approx(float(fitted["t_offset_s"]), abs=0.06)
    assert record.range_offset_m == pytest.approx(-float(fitted["range_offset_m"]), abs=0.03)
    x, up, south = fitted["reflectors_m"][0]
    truth = np.array([x, -south, up])
    image = ul.focus(found, ul.Grid.covering([truth - 0.5, truth + 0.5], 0.01, z_m=float(truth[2])))
    assert np.linalg.norm(image.peak_m - truth) < 0.03
    quality = ul.metrics.image_quality(image)
    assert quality["width_x_6db"].value < 0.20
    assert quality["width_y_6db"].value < 0.12


@pytest.mark.slow
@pytest.mark.skipif(not RAIL.exists(), reason="the real rail recording is not here")
@pytest.mark.filterwarnings("ignore:.*packets are missing:ullage.errors.UllageWarning")
def test_focus_alone_agrees_with_the_zero_within_its_own_doubt():
    raw = ul.open(str(RAIL)).frames()
    record = ul.calibrate(replace(raw, spec=raw.spec.but(range_zero_m=None))).calibration
    assert record is not None
    doubt = np.hypot(record.range_sigma_m, raw.spec.range_zero_sigma_m)
    assert abs(record.range_offset_m + raw.spec.range_zero_m) < 3 * doubt  # at which the zero would be left out


def rail_b():
    """The other rail's frames, and its surveyed reflectors."""
    kept = np.load(DATA / "rail_b_decoded.npz")
    track = ul.Trajectory(_ns(kept["t_mocap_s"]), _enu(kept["pos_m"]), _turned(kept["quat_xyzw"]))
    preset = ul.RadarSpec.preset("pulson440")
    spec = preset.but(bins=kept["range_m"].size, range_start_m=float(kept["range_m"][0]), range_zero_m=None)
    scans = kept["scans"].astype(float)
    raw = ul.Frames(scans, kept["range_m"], _ns(kept["t_radar_s"]), spec, track=track, unit="normalised")
    return raw, _enu(kept["reflectors_m"])


@pytest.mark.slow
@pytest.mark.skipif(not RAIL.exists(), reason="the real rail recordings are not here")
def test_the_pulson_zero_is_what_surveyed_reflectors_of_the_other_rail_say():
    """The preset's zero is an instrument's constant: measured anew here, from a recording that shares nothing else."""
    raw, places = rail_b()
    preset = ul.RadarSpec.preset("pulson440")
    both = ul.calibrate(raw, reflectors=places)
    strong = ul.calibrate(raw, reflectors=places[:1]).calibration
    assert preset.range_zero_m is not None
    assert both.calibration is not None
    assert strong is not None
    for record in (both.calibration, strong):
        assert -record.range_offset_m == pytest.approx(preset.range_zero_m, abs=preset.range_zero_sigma_m)
    image = ul.focus(both, ul.Grid.covering([places[0] - 0.6, places[0] + 0.6], 0.02, z_m=float(places[0, 2])))
    assert np.linalg.norm(image.peak_m - places[0]) < 0.04


@pytest.mark.slow
@pytest.mark.skipif(not RAIL.exists(), reason="the real rail recordings are not here")
def test_the_other_rail_finds_its_clock():
    raw, _ = rail_b()
    record = ul.calibrate(raw).calibration
    assert record.t_offset_s == pytest.approx(9.3, abs=0.06)


@pytest.mark.slow
@pytest.mark.skipif(not FLIGHT.exists(), reason="the real flight is not here")
def test_the_real_flight_finds_its_clock():
    """The published 6.60 s puts the reflector where it was surveyed; all other echoes say 6.53 s."""
    source = ul.open(FLIGHT)
    record = ul.calibrate(source.frames()).calibration
    assert record.t_offset_s == pytest.approx(6.60, abs=0.1)
    survey = ul.calibrate(source.frames(), reflectors=source.reflectors())
    assert survey.calibration.t_offset_s == pytest.approx(6.60, abs=0.03)
    place = source.reflectors()[0]
    image = ul.focus(survey, ul.Grid.covering([place - 0.4, place + 0.4], 0.01, z_m=float(place[2])))
    assert np.linalg.norm(image.peak_m - place) < 0.05


@pytest.mark.slow
@pytest.mark.skipif(not RAIL.exists(), reason="the real rail recording is not here")
@pytest.mark.filterwarnings("ignore:.*packets are missing:ullage.errors.UllageWarning")
def test_the_real_rail_with_its_track_backwards_is_refused():
    raw = ul.open(RAIL).frames()
    known = raw.track
    track = ul.Trajectory(known.t_ns[0] + (known.t_ns[-1] - known.t_ns)[::-1], known.position[::-1], known.quat_xyzw)
    with pytest.raises(CalibrationError, match=r"do not follow the track .*log-likelihood of -\d+, and"):
        ul.calibrate(replace(raw, track=track, poses=None))


def test_a_track_that_explains_less_than_unknown_motion_is_refused():
    modes, moving = ((1.0, 0.0, 1.0),), np.ones(30, bool)
    cases = ((1.0, 500.0, True), (-1.0, 500.0, True), (-5.0, 500.0, False), (1.0, 100.0, False), (-5.0, np.inf, True))
    for total, strongest, good in cases:  # -1: e^60 times less likely, were frames independent
        gains = Gains(np.full((2, 30), total), moving, np.zeros((2, 3)))
        if good:  # surveyed reflectors, with a strength of infinity, need no track that explains all echoes
            _refuse("radar", gains, modes, 1.0, strongest)
        else:
            with pytest.raises(CalibrationError, match="do not follow the track"):
                _refuse("radar", gains, modes, 1.0, strongest)


@pytest.mark.parametrize(("arm_m", "seen"), [(0.05, False), (0.14, False), (0.16, True), (-0.2, True)])
def test_an_antenna_three_sigma_from_its_mount_is_suspected(arm_m, seen):
    theta, known = np.zeros(PARAMETERS), np.eye(PARAMETERS) * 1e-6
    theta[ARM] = (0.01, arm_m, 0.0)
    bundle = Bundle(theta, known, 1.0, ())
    prior = _Prior(None, np.inf, 0.0, 0.02, 1.0, lever_sigma_m=0.05)
    assert ("elsewhere on the body" in _elsewhere(bundle, prior)) == seen
    assert not _elsewhere(bundle, replace(prior, lever_sigma_m=0.0))  # its place is exact, as the caller says


@pytest.mark.slow
@pytest.mark.skipif(not FLIGHT.exists(), reason="the real recordings are not here")
@pytest.mark.filterwarnings("ignore:.*packets are missing:ullage.errors.UllageWarning")
def test_the_track_of_another_flight_is_refused():
    rail, flight = ul.open(RAIL).frames(), ul.open(FLIGHT).frames()
    with pytest.raises(CalibrationError):
        ul.calibrate(replace(rail, track=flight.track, poses=None))


def _ns(seconds):
    return np.rint(seconds * 1e9).astype(np.int64)


def _enu(y_up):
    """Motive's (X, Y up, Z) as (X, -Z, Y)."""
    return np.stack([y_up[..., 0], -y_up[..., 2], y_up[..., 1]], axis=-1)


def _turned(quat_xyzw):
    return np.concatenate([_enu(quat_xyzw[:, :3]), quat_xyzw[:, 3:]], axis=1)
