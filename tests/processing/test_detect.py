import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.processing.baseband import noise_correlation, noise_sigma
from ullage.processing.cfar import cell_average_factor, cfar_threshold
from ullage.processing.detect import roc
from ullage.processing.echoes import peaks

SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
STILL = ul.Trajectory.stationary(n=40)


def thesis_frames(rows):
    rows = np.asarray(rows, float)
    path = ul.Trajectory.stationary(n=len(rows))
    spec = SPEC.but(bins=rows.shape[1])
    return ul.Frames(rows, spec.range_m, path.t_ns, spec, poses=path, unit="thesis")


def noise_frames(n, *, correlated=True, bins=188, seed=1):
    rng = np.random.default_rng(seed)
    spec = SPEC.but(bins=bins)
    if correlated:
        from scipy.signal import firwin

        white = rng.standard_normal((n, 8 * bins + 31, 2)) @ [1, 1j]
        taps = firwin(32, 0.5e9, fs=spec.sampling_hz)
        x = np.stack([np.convolve(w, taps, "valid")[::8][:bins] for w in white])
    else:
        x = rng.standard_normal((n, bins, 2)) @ [1, 1j]
    path = ul.Trajectory.stationary(n=n)
    return ul.Frames(x * 1e-4, spec.range_m, path.t_ns, spec, poses=path)


def test_the_thesis_takes_the_first_top_over_its_threshold():
    rows = np.zeros((3, 16))
    rows[0, [3, 7, 11]] = 0.03, 0.05, 0.9  # the first top is too low, the second is taken
    rows[1, 5:8] = 0.02, 0.06, 0.02
    hits = ul.detect(thesis_frames(rows))
    assert hits.frame.tolist() == [0, 1]
    assert hits.range_m == pytest.approx(SPEC.range_m[[7, 6]])
    assert hits.amplitude == pytest.approx([0.05, 0.06])
    assert len(ul.detect(thesis_frames(rows), method="peaks")) == 3
    assert len(ul.detect(thesis_frames(rows), threshold=0.055)) == 2


def test_a_flank_over_the_threshold_is_no_top():
    rows = np.zeros((1, 16))
    rows[0, 4:9] = 0.04, 0.05, 0.06, 0.05, 0.04
    assert ul.detect(thesis_frames(rows)).range_m == pytest.approx(SPEC.range_m[6])
    assert peaks(np.array([[0, 1, 1, 1, 0.0]])).tolist() == [[False, True, False, False, False]]


@pytest.mark.parametrize("distance", [1.0, 1.013, 2.5267, 4.99])
def test_the_range_is_finer_than_a_bin(distance):
    hits = ul.detect(frames_of_points([(distance, 0, 0)], STILL[:1], spec=SPEC))
    assert hits.range_m == pytest.approx([distance], abs=0.004)
    assert hits.amplitude == pytest.approx([1.0], abs=0.05)  # a parabola under a Gaussian
    assert np.isnan(hits.point).all()


def test_noise_alone_is_rarely_an_object_and_snr_is_right():
    frames = frames_of_points([(3.0, 0, 0)], STILL, spec=SPEC, noise=0.01, seed=3)
    assert noise_sigma(frames) == pytest.approx(0.01 * np.sqrt(2), rel=0.05)
    hits = ul.detect(frames)
    assert len(hits) == len(frames)
    assert hits.snr_db == pytest.approx(np.full(40, 20 * np.log10(1 / 0.01414)), abs=1.0)
    assert hits.range_m == pytest.approx(np.full(40, 3.0), abs=0.01)


def test_the_direct_path_is_no_object():
    spec = SPEC.but(noise=ul.NoiseSpec())
    frames = frames_of_points([(0.15, 0, 0), (2.0, 0, 0)], STILL[:1], spec=spec)
    assert ul.detect(frames).range_m == pytest.approx([2.0], abs=0.01)
    assert ul.detect(frames, min_range_m=0.0).range_m == pytest.approx([0.15], abs=0.02)


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("ordered", [False, True])
def test_cfar_keeps_its_false_alarm_rate(ordered, correlated):
    pfa, frames = 1e-3, noise_frames(1500, correlated=correlated)
    lags = None if correlated else [1.0]
    over = np.abs(frames.samples) > cfar_threshold(frames, ordered=ordered, pfa=pfa, correlation=lags)
    per_frame = over.mean(1)
    sigma = per_frame.std() / np.sqrt(len(per_frame))  # over frames, since neighbouring bins are not independent
    assert abs(over.mean() - pfa) < 3 * sigma + 0.03 * pfa


def test_correlation_matters():
    white, real = cell_average_factor(1e-6, 8, [1.0]), cell_average_factor(1e-6, 8, noise_correlation(SPEC))
    assert white == pytest.approx(16 * (1e-6 ** (-1 / 16) - 1))  # the textbook's closed form
    assert real > 1.2 * white


def test_noise_correlation_is_the_measured_one():
    assert np.abs(noise_correlation(SPEC)[1:4]) == pytest.approx([0.635, 0.155, 0.02], abs=0.03)


def test_the_threshold_is_the_mean_of_the_training_cells_against_its_twin():
    power, spec = np.random.default_rng(0).exponential(size=(2, 30)), SPEC.but(bins=30)
    path = ul.Trajectory.stationary(n=2)
    noise = ul.Frames(np.sqrt(power).astype(np.complex64), spec.range_m, path.t_ns, spec, poses=path)
    threshold = cfar_threshold(noise, pfa=1e-3, guard=2, train=4, correlation=[1.0])
    out = threshold**2 / cell_average_factor(1e-3, 4, np.ones(1), 2)
    for b in range(30):
        left = list(range(b - 3, -1, -1))
        right = list(range(b + 3, 30))
        want_left = max(min(4, len(left)), 8 - min(4, len(right)))
        want_right = max(min(4, len(right)), 8 - min(4, len(left)))
        cells = left[:want_left] + right[:want_right]
        assert len(cells) == 8
        assert out[:, b] == pytest.approx(power[:, cells].mean(1), rel=1e-5)


@pytest.mark.parametrize("method", ["cfar", "os-cfar", "clean"])
def test_every_method_finds_a_clear_echo(method):
    frames = frames_of_points([(2.0, 0, 0), (5.0, 0.0, 0)], STILL, spec=SPEC, noise=0.01)
    hits = ul.detect(frames, method=method, pfa=1e-6)
    for distance in (2.0, 5.0):
        assert (abs(hits.range_m - distance) < 0.02).sum() == 40


def test_os_cfar_sees_two_echoes_that_hide_each_other_from_ca():
    rows = noise_frames(200, correlated=False)
    strong = rows.samples.copy()
    strong[:, [60, 66, 70, 74, 78]] += 1.2e-3
    frames = ul.Frames(strong, rows.range_m, rows.t_ns, rows.spec)
    ca, ordered = (ul.detect(frames, method=m, correlation=[1.0]) for m in ("cfar", "os-cfar"))
    near = [np.sum(abs(h.range_m - SPEC.range_m[66]) < 0.06) for h in (ca, ordered)]
    assert near[1] > 2 * near[0]


def test_a_low_quantile_finds_a_weak_echo_where_most_bins_hold_strong_ones():
    """As in a room: walls take more than a quarter of the training cells, and the usual threshold follows them."""
    rows = noise_frames(200, correlated=False)
    crowded, sigma = rows.samples.copy(), noise_sigma(rows)
    for k in (*range(46, 62, 3), *range(72, 88, 3)):
        crowded[:, k] += 30 * sigma
    crowded[:, 67] += 8 * sigma
    frames = ul.Frames(crowded, rows.range_m, rows.t_ns, rows.spec)
    usual, low = (ul.detect(frames, method="os-cfar", correlation=[1.0], quantile=q) for q in (0.75, 0.25))
    near = [np.sum(abs(h.range_m - SPEC.range_m[67]) < 0.06) for h in (usual, low)]
    assert near[0] < 20
    assert near[1] > 180


@pytest.mark.parametrize("quantile", [0.25, 0.5])
def test_the_false_alarm_rate_of_noise_does_not_depend_on_the_quantile(quantile):
    rows = noise_frames(2000, correlated=False)
    over = np.abs(rows.samples) > cfar_threshold(rows, ordered=True, pfa=1e-2, quantile=quantile, correlation=[1.0])
    assert over[:, 30:-30].mean() == pytest.approx(1e-2, rel=0.1)


def test_a_quantile_that_is_no_share_is_refused():
    with pytest.raises(ul.InputError, match=r"quantile is 1.0 \(allowed: >= 0, < 1\)"):
        ul.detect(noise_frames(3), method="os-cfar", quantile=1.0)


def test_clean_parts_echoes_nearer_than_the_pulse():
    frames = frames_of_points([(2.0, 0, 0), (2.13, 0.0, 0)], STILL[:1], spec=SPEC)
    hits = ul.detect(frames, method="clean", threshold=0.3)
    assert len(hits) >= 2
    assert min(abs(hits.range_m - 2.0)) < 0.03
    assert min(abs(hits.range_m - 2.13)) < 0.03


def test_roc_rises_with_the_echo():
    empty = noise_frames(400)
    area = []
    for level in (0.0, 0.4e-4, 4e-4):
        shape = np.exp(-((SPEC.range_m - 3.0) ** 2) / (2 * 0.0517**2))
        found = roc(
            ul.Frames(noise_frames(400, seed=2).samples + level * shape, empty.range_m, empty.t_ns, SPEC), empty, 3.0
        )
        assert np.all(np.diff(found[1]) <= 0)
        assert np.all(np.diff(found[2]) <= 0)
        area.append(found[1][np.searchsorted(-found[2], -1e-3)])
    assert area[0] < 0.1
    assert area[0] < area[1] < area[2]
    assert area[2] > 0.99


def test_several_sensors_by_name():
    frames = frames_of_points([(2.0, 0, 0)], STILL[:2], spec=SPEC)
    hits = ul.detect({"left": frames, "right": frames})
    assert set(hits) == {"left", "right"}
    assert len(hits["left"]) == 2


def test_bad_input_is_refused_in_one_line():
    frames = frames_of_points([(2.0, 0, 0)], STILL[:1], spec=SPEC)
    with pytest.raises(ul.InputError, match=r"no method .best. \(allowed: first_peak, .* clean, track\)"):
        ul.detect(frames, method="best")
    with pytest.raises(ul.InputError, match="threshold is -1"):
        ul.detect(frames, threshold=-1)
    with pytest.raises(ul.InputError, match="do not fit 188 bins"):
        ul.detect(frames, method="cfar", train=100)
    with pytest.raises(ul.InputError, match="pfa is 2"):
        ul.detect(frames, method="cfar", pfa=2)


def flown_past(n=24):
    path = ul.Trajectory.line((0, -0.6, 0), (0, 0.6, 0), speed_m_s=0.5, rate_hz=10)[:n]
    spec = SPEC.but(noise=ul.NoiseSpec())
    return frames_of_points([(0.2, 0, 0), (2.0, 0, 0), (5.0, 0.3, 0)], path, spec=spec, noise=0.004, seed=5)


def test_pieces_of_a_recording_give_the_echoes_of_the_whole():
    frames = flown_past()
    whole = ul.detect(frames, method="peaks")
    pieces = [ul.detect(frames[i : i + 1], method="peaks") for i in range(len(frames))]
    assert np.concatenate([p.range_m for p in pieces]) == pytest.approx(whole.range_m)


def test_noise_crosses_the_level_as_seldom_as_stated():
    from ullage.processing.echoes import echo_level

    frames = noise_frames(3000, correlated=False)
    for rate in (1e-2, 1e-3):
        over = np.abs(frames.samples) > echo_level(frames, false_alarm=rate)[:, None]
        assert 0.9 * rate < over.mean() < 2 * rate  # one profile's noise is known to 7 %


def test_what_lies_under_the_dynamic_range_is_no_echo():
    frames = frames_of_points([(2.0, 0, 0), (5.0, 0.0, 0)], STILL[:1], spec=SPEC)
    for fall_db, count in ((35.0, 2), (45.0, 1)):
        weak = frames.samples.copy()
        weak[:, frames.range_m > 3.5] *= 10 ** (-fall_db / 20)
        hits = ul.detect(ul.Frames(weak, frames.range_m, frames.t_ns, frames.spec), method="peaks")
        assert len(hits) == count
