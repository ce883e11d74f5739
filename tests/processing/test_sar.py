import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.processing.metrics_image import image_quality
from ullage.processing.summation import apex

SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)


@pytest.mark.parametrize(("yaw", "start", "end", "target"), [
    (0, (0, -1.5, 0), (0, 1.5, 0), (2.5, 0.2, 0)),
    (90, (-1.5, 0, 0), (1.5, 0, 0), (0.3, 2.4, 0)),
    (180, (0, -1.5, 0), (0, 1.5, 0), (-2.5, -0.2, 0)),
    (-90, (-1.5, 0, 0), (1.5, 0, 0), (-0.3, -2.4, 0)),
])  # fmt: skip
def test_the_hyperbolas_top_is_the_object(yaw, start, end, target):
    path = ul.Trajectory.line(start, end, 0.5, 17, yaw_deg=yaw)
    frames = frames_of_points([target], path, spec=SPEC, gain=lambda p, q: 1 / (1 + np.linalg.norm(
        np.asarray(q, float)[None] - p.position[:, None], axis=2) ** 4))  # fmt: skip
    image = ul.focus(frames, ul.Grid((-4, -4, 0), 0.05, (160, 160)), method="summation")
    assert apex(image) == pytest.approx(np.array(target), abs=0.1)
    assert apex(image, look_deg=yaw) == pytest.approx(np.array(target), abs=0.1)


@pytest.mark.parametrize("at_m", [1.0, 1.6])
def test_the_apex_is_that_of_a_hyperbola_and_not_of_a_parabola(at_m):
    grid = ul.Grid((0, -4, 0), 0.05, (160, 160))
    reach = np.hypot(at_m, grid.y_m - 0.3)
    ridge = np.exp(-(((grid.x_m[None, :] - reach[:, None]) / 0.06) ** 2)) / reach[:, None]
    found = apex(ul.Image(grid, ridge.astype(np.float32), None, "summation"), look_deg=0)
    assert found[:2] == pytest.approx([at_m, 0.3], abs=0.02)


def test_summation_adds_amplitude_straight_ahead():
    path = ul.Trajectory.stationary(n=4)
    frames = frames_of_points([(2.0, 1.0, 0)], path, spec=SPEC)
    image = ul.focus(frames, ul.Grid((0, -1.025, 0), 0.05, (41, 80)), method="summation")
    rows = image.values.sum(1)
    assert rows[20] == pytest.approx(rows.sum(), rel=1e-6)  # all on the line y = 0, though the object is at y = 1
    assert image.peak_m[0] == pytest.approx(np.hypot(2, 1), abs=0.05)
    twice = ul.focus({"a": frames, "b": frames}, image.grid, method="summation")
    assert twice.values == pytest.approx(2 * image.values)


def test_windows_trade_width_for_side_lobes():
    path = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0), 0.17, 17)
    frames = frames_of_points([(3.0, 0, 0)], path, spec=SPEC)
    grid = ul.Grid((2.995, -0.5, 0), 0.005, (200, 1))
    scores = {w: image_quality(ul.focus(frames, grid, window=w)) for w in ("none", "taylor", "hann")}
    assert scores["none"]["pslr_y"].value == pytest.approx(-13.3, abs=0.7)
    assert scores["taylor"]["pslr_y"].value < -30
    assert scores["hann"]["pslr_y"].value < -28
    assert scores["none"]["width_y_3db"].value < scores["taylor"]["width_y_3db"].value


def test_quality_of_a_known_shape():
    grid = ul.Grid((0, 0, 0), 0.01, (101, 201))
    y, x = np.meshgrid(grid.y_m, grid.x_m, indexing="ij")
    shape = np.exp(-((x - 1.003) ** 2) / (2 * 0.05**2) - ((y - 0.5) ** 2) / (2 * 0.03**2))
    score = image_quality(ul.Image(grid, shape.astype(np.float32)), target_m=(1.0, 0.5, 0))
    assert score["width_x_3db"].value == pytest.approx(2 * 0.05 * np.sqrt(np.log(10**0.3)), rel=0.02)
    assert score["width_y_6db"].value == pytest.approx(2 * 0.03 * np.sqrt(np.log(10**0.6)), rel=0.02)
    assert score["error"].value == pytest.approx(np.hypot(0.003, 0.005), abs=0.003)
    with pytest.raises(ul.InputError, match="no cell within"):
        image_quality(ul.Image(grid, shape.astype(np.float32)), target_m=(9, 9, 0))


def test_sensors_add_in_power_or_in_phase():
    path = ul.Trajectory.line((0, -0.25, 0), (0, 0.25, 0), 0.17, 17)
    frames = frames_of_points([(2.0, 0, 0)], path, spec=SPEC)
    grid = ul.Grid((1.9, -0.1, 0), 0.02, (10, 10))
    one, power = ul.focus(frames, grid), ul.focus([frames, frames], grid)
    phase = ul.focus([frames, frames], grid, combine="coherent")
    assert power.values == pytest.approx(np.sqrt(2) * one.amplitude, rel=1e-5)
    assert phase.values == pytest.approx(one.values, rel=1e-4)


def test_pieces_of_the_way_are_as_sharp_as_their_length():
    path = ul.Trajectory.line((0, -1.0, 0), (0, 1.0, 0), 0.17, 17)
    frames = frames_of_points([(3.0, 0, 0)], path, spec=SPEC)
    grid = ul.Grid((2.995, -0.4, 0), 0.005, (160, 1))
    whole, halves = ul.focus(frames, grid), ul.focus(frames, grid, subaperture_m=0.5)
    assert np.abs(whole.values).max() == pytest.approx(np.abs(halves.values).max(), rel=0.05)
    width = image_quality(halves)["width_y_3db"].value / image_quality(whole)["width_y_3db"].value
    assert 3.3 < width < 4.6  # a quarter of the aperture; the outer pieces look askance
    one = ul.focus(frames, grid, subaperture_m=5.0)
    np.testing.assert_allclose(one.values, np.abs(whole.values), rtol=1e-5)


def test_pieces_bear_a_bend_in_the_poses_that_the_whole_does_not():
    path = ul.Trajectory.line((0, -1.0, 0), (0, 1.0, 0), 0.17, 17)
    bend = 0.012 * np.cos(np.linspace(0, 4 * np.pi, len(path)))[:, None] * [1, 0, 0]
    believed = ul.Trajectory(path.t_ns, path.position + bend, path.quat_xyzw)
    frames = frames_of_points([(3.0, 0, 0)], path, spec=SPEC, believed=believed)
    grid = ul.Grid((2.8, -0.4, 0), 0.02, (40, 20))
    whole, pieces = (ul.focus(frames, grid, subaperture_m=m) for m in (None, 0.25))
    assert pieces.coherence.max() > 0.9
    assert whole.coherence.max() < 0.6
    assert np.abs(pieces.values).max() > 1.3 * np.abs(whole.values).max()


def test_carriers_that_differ_are_never_added_in_phase():
    path = ul.Trajectory.line((0, -0.2, 0), (0, 0.2, 0), 0.2, 17)
    low, high = SPEC, SPEC.but(center_hz=8.748e9)
    grid = ul.Grid((2.5, -0.5, 0), 0.05, (20, 20))
    frames = {n: frames_of_points([(3, 0, 0)], path, spec=spec) for n, spec in (("low", low), ("high", high))}
    assert ul.focus(frames, grid).peak_m[0] == pytest.approx(3.0, abs=0.06)
    with pytest.raises(ul.InputError, match=r"8\.748 GHz after one of 7\.290 GHz .*in power"):
        ul.focus(frames, grid, combine="coherent")
    with pytest.raises(ul.InputError, match="several sensors in phase"):
        ul.focus(frames, grid, combine="coherent", subaperture_m=0.1)
    with pytest.raises(ul.InputError, match="subaperture_m is 0"):
        ul.focus(frames["low"], grid, subaperture_m=0)


def test_the_summation_image_sums_amplitudes_and_shares_them_between_the_nearest_cells():
    path = ul.Trajectory.stationary()
    rows = np.zeros((1, SPEC.bins), np.float32)
    near, far = 30, 60
    rows[0, near], rows[0, far] = 0.5, 0.25
    frames = ul.Frames(rows, SPEC.range_m, path.t_ns, SPEC, path, unit="thesis")
    grid = ul.Grid((0.0, -0.30, 0.0), 0.1, (6, 40))  # the boresight, y = 0, is the border of rows 2 and 3
    values = ul.focus(frames, grid, method="summation").values
    one, two = (values[:, int(SPEC.range_m[k] / 0.1) - 2 : int(SPEC.range_m[k] / 0.1) + 3].sum() for k in (near, far))
    assert one / two == pytest.approx(2, rel=0.15)  # 4 of powers; bins are sampled twice a cell, so not exactly 2
    assert values[2] == pytest.approx(values[3])
    assert values[2].sum() + values[3].sum() == pytest.approx(values.sum())
