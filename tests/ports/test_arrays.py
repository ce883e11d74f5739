"""Recordings as plain arrays with documented keys: what they give, and how bad ones are refused."""

from __future__ import annotations

import io
import pickle
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

import ullage as ul

N, BINS = 30, 50
T_S = 0.02 * np.arange(N)
PLACE = np.stack([0.2 * T_S, np.sin(T_S), 1 + 0.1 * T_S], axis=1)
QUAT = np.stack([0 * T_S, 0 * T_S, np.sin(T_S / 4), np.cos(T_S / 4)], axis=1)
BAND = {"center_hz": 6.5e9, "bandwidth_hz": 1.2e9}


def keys(**changes: object) -> dict[str, object]:
    """The documented keys of a baseband recording, with some changed or, by None, left out."""
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(N, BINS)) + 1j * rng.normal(size=(N, BINS))
    made = {"samples": samples, "times_s": T_S, "ranges_m": 0.4 + 0.05 * np.arange(BINS), **BAND} | changes
    return {name: value for name, value in made.items() if value is not None}


def write(path: Path, **changes: object) -> Path:
    np.savez(path, **keys(**changes))
    return path


def opened(path: Path, **options: object) -> ul.Frames:
    frames = ul.open(path, **options).frames()
    assert isinstance(frames, ul.Frames)
    return frames


def test_baseband_samples_come_as_they_are(tmp_path: Path) -> None:
    frames = opened(write(tmp_path / "a.npz"))
    np.testing.assert_array_equal(frames.samples, keys()["samples"].astype(np.complex64))  # type: ignore[attr-defined]
    np.testing.assert_allclose(frames.range_m, keys()["ranges_m"])  # type: ignore[arg-type]
    np.testing.assert_allclose(frames.spec.range_m, frames.range_m, atol=1e-9)
    np.testing.assert_allclose(frames.t_ns * 1e-9, T_S, atol=1e-9)
    assert (frames.spec.center_hz, frames.spec.bandwidth_hz) == (6.5e9, 1.2e9)
    assert (frames.spec.output, frames.unit, frames.poses, frames.track) == ("baseband", "normalised", None, None)
    assert frames.spec.fps == pytest.approx(50)


@pytest.mark.parametrize("prefix", ["", "track_"])
def test_single_bad_poses_are_dropped_and_counted(tmp_path: Path, prefix: str) -> None:
    turns, places = np.tile([0.0, 0, 0, 1], (N, 1)), np.c_[T_S, 0 * T_S, 1 + 0 * T_S]
    places[7, 1], turns[9] = np.nan, 2 * turns[9]
    track = {f"{prefix}positions_m": places, f"{prefix}quaternions_xyzw": turns} | (
        {"track_times_s": T_S} if prefix else {}
    )
    with pytest.warns(
        ul.UllageWarning, match="dropped 2 bad .pose 7: position is not finite; pose 9: .*of 30 received"
    ):
        frames = opened(write(tmp_path / "a.npz", **track))
    if prefix:
        assert frames.track is not None
        assert len(frames.track) == N - 2
    else:
        assert frames.poses is not None
        np.testing.assert_allclose(frames.poses.position, np.c_[T_S, 0 * T_S, 1 + 0 * T_S], atol=1e-9)


def test_real_samples_are_rf_and_nanoseconds_are_exact(tmp_path: Path) -> None:
    t_ns = 1_600_000_000_123_456_789 + 20_000_000 * np.arange(N)
    rf = np.random.default_rng(0).normal(size=(N, BINS)).astype(np.float32)
    path = write(tmp_path / "a.npz", samples=rf, times_s=None, times_ns=t_ns, ranges_m=1 + 0.009 * np.arange(BINS))
    frames = opened(path)
    np.testing.assert_array_equal(frames.samples, rf)
    np.testing.assert_array_equal(frames.t_ns, t_ns)
    assert frames.spec.output == "rf"
    np.testing.assert_allclose(frames.spec.range_m, frames.range_m, atol=1e-9)


@pytest.mark.parametrize("start_ns", [0, 1_600_000_000_000_000_000])
@pytest.mark.parametrize("prefix", ["", "track_"])
def test_stamps_in_nanoseconds_are_recognised(tmp_path: Path, start_ns: int, prefix: str) -> None:
    times = start_ns + np.rint(T_S * 1e9).astype(np.int64)
    given = {f"{prefix}times_s": times, f"{prefix}positions_m": PLACE}
    with pytest.warns(ul.UllageWarning, match="times are taken as nanoseconds"):
        frames = opened(write(tmp_path / "a.npz", **given))
    track = frames.track if prefix else frames.believed
    assert track is not None
    np.testing.assert_allclose(track.t_ns - start_ns, times - start_ns, atol=256)  # doubles of 1.6e18


def test_poses_on_the_clock_of_the_frames_are_used(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", positions_m=PLACE, quaternions_xyzw=QUAT)
    frames = opened(path)
    assert frames.track is None
    np.testing.assert_allclose(frames.believed.position, PLACE)
    np.testing.assert_allclose(frames.believed.quat_xyzw, QUAT, atol=1e-12)
    turned = opened(path, mount=ul.MountSpec(yaw_deg=90))
    np.testing.assert_allclose(turned.believed.world_from_body[0, :3, 0], [0, 1, 0], atol=1e-12)


def test_a_track_on_its_own_clock_waits_for_calibration(tmp_path: Path) -> None:
    track = {"track_times_s": 100 + T_S, "track_positions_m": PLACE, "track_quaternions_xyzw": QUAT}
    frames = opened(write(tmp_path / "a.npz", **track))
    assert frames.track is not None
    np.testing.assert_allclose(frames.track.position, PLACE)
    np.testing.assert_allclose(frames.t_ns * 1e-9, 100 + T_S, atol=1e-9)


def test_a_folder_takes_the_keys_with_a_track_file_or_a_track_of_their_own(tmp_path: Path) -> None:
    write(tmp_path / "radar.npz")
    rows = "".join(f"{t},{x},{y},{z}\n" for t, (x, y, z) in zip(T_S, PLACE, strict=True))
    (tmp_path / "track.csv").write_text("t_s,x_m,y_m,z_m\n" + rows)
    frames = opened(tmp_path)
    assert frames.track is not None
    write(tmp_path / "radar.npz", positions_m=PLACE)
    with pytest.raises(ul.InputError, match=r"two tracks, track\.csv and radar\.npz"):
        ul.open(tmp_path)
    (tmp_path / "track.csv").unlink()
    frames = opened(tmp_path)
    assert frames.track is None
    np.testing.assert_allclose(frames.believed.position, PLACE)


@pytest.mark.parametrize("share", [0.001, 0.03, 0.2, 0.6])
def test_saturation_is_warned_of_at_any_share(tmp_path: Path, share: float) -> None:
    smooth = np.random.default_rng(0).normal(size=(N, 400)).cumsum(axis=1).astype(np.float32)
    limit = float(np.quantile(abs(smooth), 1 - share))
    cut = {"samples": np.clip(smooth, -limit, limit), "ranges_m": 1 + 0.009 * np.arange(400)}
    with pytest.warns(ul.UllageWarning, match=rf"{100 * share:.2g} % of all samples lie at the limit"):
        opened(write(tmp_path / "cut.npz", **cut))


def test_coarse_and_constant_samples_are_not_called_saturated(tmp_path: Path) -> None:
    rng, axis = np.random.default_rng(0), {"ranges_m": 1 + 0.009 * np.arange(400)}
    for k, samples in enumerate((np.rint(rng.normal(size=(N, 400)).cumsum(axis=1) / 9), np.ones((N, 400)))):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            frames = opened(write(tmp_path / f"{k}.npz", samples=samples, **axis))
        np.testing.assert_array_equal(frames.samples, samples)


def test_real_samples_of_no_known_radar_ask_for_it(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", samples=np.ones((N, BINS)), center_hz=None)
    with pytest.raises(ul.InputError, match=r"real samples without center_hz: of which radar\?.*preset= one of x4m05"):
        ul.open(path)
    assert opened(path, preset="x4m05-8ghz").spec.center_hz == 8.748e9
    assert opened(Path(f"{path}?preset=x4m05-8ghz")).spec.center_hz == 8.748e9
    assert opened(Path(f"{path}?preset=x4m05-8ghz&mount={{yaw_deg: 90}}")).spec.mount.yaw_deg == 90
    with pytest.raises(ul.InputError, match="yaw"):
        ul.open(Path(f"{path}?preset=x4m05-8ghz&mount={{yaw: 90}}"))


def test_an_unknown_band_is_assumed_and_said_or_given(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", center_hz=None, bandwidth_hz=None)
    with pytest.warns(ul.UllageWarning, match=r"center_hz 7\.29e\+09 and bandwidth_hz 1\.4e\+09 .* x4m05 assumed"):
        assert opened(path).spec.center_hz == 7.29e9
    assert opened(path, preset="x4m05-8ghz").spec.center_hz == 8.748e9
    with pytest.raises(ul.InputError, match="no radar preset"):
        ul.open(path, preset="x5")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"samples": None}, "no samples.*allowed: samples"),
        ({"ranges_m": None}, "no ranges_m"),
        ({"times_s": None}, "no times_s or times_ns"),
        ({"times_ns": np.arange(N)}, "both times_s and times_ns"),
        ({"times_s": T_S[1:]}, "samples is of shape .*29 times"),
        ({"times_s": np.full(N, np.nan)}, "times_s is .*not all finite"),
        ({"times_s": 1e22 * T_S}, "times_s is absurd"),
        ({"times_s": 1e10 + T_S}, "times_s is absurd"),
        ({"times_s": np.random.default_rng(1).permutation(T_S)}, "times are earlier than the one before"),
        ({"samples": np.full((N, BINS), np.inf)}, "samples of frame 0 are not finite"),
        ({"samples": np.array([["a"]])}, "samples is of shape"),
        ({"ranges_m": np.arange(BINS)[::-1]}, "ranges_m does not rise"),
        ({"ranges_m": np.arange(BINS) ** 2.0}, "ranges_m is not evenly spaced"),
        ({"center_hz": [1e9, 2e9]}, "center_hz is of shape"),
        ({"center_hz": 5.0}, "make no radar.*center_hz"),
        ({"positions_m": PLACE[:5]}, r"positions_m is of shape \(5, 3\).*allowed: \(30, 3\)"),
        ({"positions_m": 1e9 * PLACE}, "positions_m is absurd"),
        ({"quaternions_xyzw": QUAT}, "quaternions_xyzw without positions_m"),
        ({"positions_m": PLACE, "quaternions_xyzw": 2 * QUAT}, "0 poses: dropped 30 bad .pose 0: quaternion is not of"),
        ({"positions_m": np.where(np.arange(N)[:, None] < 1, np.nan, PLACE)}, "first or last frame has no pose"),
        ({"track_positions_m": PLACE}, "no track_times_s or track_times_ns"),
        ({"positions_m": PLACE, "track_positions_m": PLACE, "track_times_s": T_S}, "both positions_m and track"),
        ({"samples": np.array([[object()]])}, "a Python pickle: not opened, because it can run code.*convert it with"),
    ],
)
def test_bad_arrays_are_refused_in_one_line(tmp_path: Path, changes: dict[str, object], words: str) -> None:
    path = write(tmp_path / "a.npz", **changes)
    with pytest.raises(ul.InputError, match=words) as caught:
        ul.open(path)
    assert "\n" not in str(caught.value)
    assert "a.npz" in str(caught.value)


def test_a_clock_that_steps_back_is_mended(tmp_path: Path) -> None:
    times = T_S.copy()
    times[10:] -= 0.05
    with pytest.warns(ul.UllageWarning, match="the clock jumps back"):
        frames = opened(write(tmp_path / "a.npz", times_s=times))
    assert len(frames) == N


@pytest.mark.parametrize("folder", [False, True])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (pickle.dumps({"samples": [1]}), "a Python pickle: not opened, because it can run code"),
        (b"", "cannot be read"),
        (b"PK\x03\x04 and then nothing", "cannot be read"),
        (b"\x93NUMPY", "cannot be read"),
    ],
)
def test_files_of_another_kind_are_refused(tmp_path: Path, content: bytes, words: str, folder: bool) -> None:
    (tmp_path / "radar.npz").write_bytes(content)
    with pytest.raises(ul.InputError, match=words):
        ul.open(tmp_path if folder else tmp_path / "radar.npz")


def test_an_archive_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("samples.npy", b"")
    raw = bytearray(packed.getvalue())
    central = raw.index(b"PK\x01\x02")
    raw[central + 24 : central + 28] = (0xF0000000).to_bytes(4, "little")  # the size it claims
    (tmp_path / "a.npz").write_bytes(bytes(raw))
    with pytest.raises(ul.InputError, match=r"samples\.npy promises 4026531840 bytes and holds 0"):
        ul.open(tmp_path / "a.npz")
