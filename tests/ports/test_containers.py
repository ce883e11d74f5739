"""Named arrays in MATLAB and HDF5 files, and A121 recordings: the same frames as of plain arrays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import ullage as ul

N, BINS = 12, 40
T_S = 0.05 * np.arange(N)
PLACE = np.stack([T_S, 0 * T_S, 1 + T_S], axis=1)


def keys(**changes: object) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    samples = (rng.normal(size=(N, BINS)) + 1j * rng.normal(size=(N, BINS))).astype(np.complex64)
    ranges = 0.4 + 0.05 * np.arange(BINS)
    band = {"center_hz": 6.5e9, "bandwidth_hz": 1.2e9}
    return {"samples": samples, "times_s": T_S, "ranges_m": ranges, "positions_m": PLACE, **band} | changes


def opened(path: Path) -> ul.Frames:
    frames = ul.open(path).frames()
    assert isinstance(frames, ul.Frames)
    return frames


def assert_the_same(path: Path) -> None:
    np.savez(path.with_suffix(".npz"), **keys())
    got, known = opened(path), opened(path.with_suffix(".npz"))
    np.testing.assert_array_equal(got.samples, known.samples)
    np.testing.assert_array_equal(got.range_m, known.range_m)
    np.testing.assert_array_equal(got.t_ns, known.t_ns)
    np.testing.assert_array_equal(got.believed.position, known.believed.position)
    assert got.spec == known.spec


@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_files_are_read_by_the_same_keys(tmp_path: Path, compressed: bool) -> None:
    savemat(tmp_path / "a.mat", keys(note="text", other={"x": 1}), do_compression=compressed)
    assert_the_same(tmp_path / "a.mat")
    assert opened(tmp_path / "a.mat").unit == "normalised"


def test_matlab_files_that_unpack_too_far_are_refused_unread(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", keys(samples=np.zeros((N, BINS))), do_compression=False)
    raw = (tmp_path / "a.mat").read_bytes()
    assert raw.count(np.array([N, BINS], np.int32).tobytes()) == 1
    large = np.array([200_000, 200_000], np.int32).tobytes()
    (tmp_path / "a.mat").write_bytes(raw.replace(np.array([N, BINS], np.int32).tobytes(), large))
    with pytest.raises(ul.InputError, match=r"unpacks to \d+ bytes"):
        ul.open(tmp_path / "a.mat")
    (tmp_path / "a.mat").write_bytes(raw[:300])
    with pytest.raises(ul.InputError, match=r"a\.mat"):
        ul.open(tmp_path / "a.mat")


def test_hdf5_files_are_read_by_the_same_keys(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, value in keys().items():
            file[name] = value
    assert_the_same(tmp_path / "a.h5")
    (tmp_path / "secret.bin").write_bytes(bytes(8 * N))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file["times_s"]
        file.create_dataset("times_s", (N,), "f8", external=[(str(tmp_path / "secret.bin"), 0, 8 * N)])
    with pytest.raises(ul.InputError, match="no array of its own"):
        ul.open(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file["times_s"]
        file["times_s"] = h5py.ExternalLink("b.h5", "/x")
    with pytest.raises(ul.InputError, match=r"links to another file|no times_s"):
        ul.open(tmp_path / "a.h5")


def test_axes_of_newer_matlab_files_come_back_in_order(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, value in keys().items():
            whole = np.atleast_2d(value).T
            pairs = whole.astype(np.complex128).view([("real", "f8"), ("imag", "f8")]) if name == "samples" else whole
            file[name] = pairs
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(512))
    assert_the_same(tmp_path / "a.mat")


def session(path: Path, frame: np.ndarray, **changes: Any) -> Path:
    """An A121 recording of one sensor with two subsweeps of 10 and 4 points, two sweeps a frame."""
    h5py = pytest.importorskip("h5py")
    one = {"profile": "PROFILE_3", "hwaas": 8, "phase_enhancement": True}
    subsweeps = [
        one | {"start_point": 80, "num_points": 10, "step_length": 4},
        one | {"step_length": 24, "start_point": 0},
    ]
    config = {"groups": [{"2": {"sweep_rate": 100.0, "subsweeps": subsweeps}}]}
    about = {"subsweep_data_offset": [0, 10], "subsweep_data_length": [10, 4], "base_step_length_m": 0.0025,
             "max_sweep_rate": 1000.0}  # fmt: skip
    pairs = np.zeros(frame.shape, [("real", "<i2"), ("imag", "<i2")])
    pairs["real"], pairs["imag"] = frame.real, frame.imag
    with h5py.File(path, "w") as file:
        file["server_info"] = json.dumps({"ticks_per_second": 1000})
        file["sessions/session_0/session_config"] = json.dumps(config)
        entry = file.create_group("sessions/session_0/group_0/entry_0")
        entry["metadata"], entry["sensor_id"] = json.dumps(about | changes), 2
        entry["result/frame"], entry["result/tick"] = pairs, 7000 + 50 * np.arange(len(frame))
        entry["result/data_saturated"] = np.zeros(len(frame), bool)
    return path


def test_each_subsweep_of_an_a121_is_a_radar(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frame = rng.integers(-999, 999, (5, 2, 14)) + 1j * rng.integers(-999, 999, (5, 2, 14))
    path = session(tmp_path / "a.h5", frame)
    with pytest.warns(ul.UllageWarning, match="1 subsweeps of sensor2 have fewer than 8 points"):
        source = ul.open(path, mount=ul.MountSpec(yaw_deg=90))
    frames = source.frames()
    assert isinstance(frames, ul.Frames)
    assert frames.sensor == "sensor2_1"
    np.testing.assert_array_equal(frames.samples, frame.reshape(10, 14)[:, :10].conj())
    np.testing.assert_allclose(frames.range_m, 0.2 + 0.01 * np.arange(10), atol=1e-12)
    np.testing.assert_array_equal(frames.t_ns, np.add.outer(50_000_000 * np.arange(5), [0, 10_000_000]).ravel())
    assert (frames.spec.center_hz, frames.spec.mount.yaw_deg) == (60.5e9, 90)


@pytest.mark.parametrize("changes", [{"subsweep_data_length": [10, 400]}, {"base_step_length_m": "x"}])
def test_sessions_that_do_not_fit_are_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(ul.InputError, match=r"a\.h5"):
        ul.open(session(tmp_path / "a.h5", np.ones((3, 2, 14), complex), **changes))
