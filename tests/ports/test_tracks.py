"""Tracks beside a radar recording: every kind of file gives the same poses, and bad ones are refused in one line."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest

import ullage as ul

T_S = np.arange(0, 6, 0.01)
PLACE = np.stack([0.2 * T_S, np.sin(T_S), 1 + 0.1 * T_S], axis=1)
QUAT = np.stack([0 * T_S, 0 * T_S, np.sin(T_S / 20), np.cos(T_S / 20)], axis=1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    scans = np.random.default_rng(0).integers(-999, 999, (100, 60)).astype(np.int32)
    range_m = 0.5 + 0.00915 * np.arange(60)
    np.savez(tmp_path / "radar.npz", scans=scans, t_ms=np.arange(100, dtype=np.uint32) * 21, range_m=range_m,
             scan_start_ps=0, scan_stop_ps=1, scan_res=32, pii=11)  # fmt: skip
    return tmp_path


def tum(scale: float = 1.0, start_s: float = 0.0) -> str:
    rows = np.c_[PLACE * scale, QUAT]
    return "# time x y z qx qy qz qw\n" + "".join(
        f"{t + start_s:.6f} " + " ".join(f"{v:.9f}" for v in row) + "\n" for t, row in zip(T_S, rows, strict=True)
    )


def euroc() -> str:
    rows = np.c_[PLACE, QUAT[:, [3, 0, 1, 2]]]
    head = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    return head + "".join(
        f"{1_403_636_579_763_555_584 + round(t * 1e9)}," + ",".join(f"{v:.9f}" for v in row) + "\n"
        for t, row in zip(T_S, rows, strict=True)
    )


def named() -> str:
    rows = np.c_[QUAT, PLACE[:, ::-1], T_S]
    return "qx,qy,qz,qw,z_m,y_m,x_m,t_s\n" + "".join(",".join(f"{v:.9f}" for v in row) + "\n" for row in rows)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("track.txt", tum()),
        ("track.tum", tum()),
        ("track.txt", tum().replace(" ", "\t")),
        ("track.csv", euroc()),
        ("track.csv", named()),
    ],
)
def test_every_kind_of_track_gives_the_same_poses(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)
    track = ul.open(folder).trajectory()
    assert track is not None
    np.testing.assert_allclose(track.position, PLACE, atol=1e-8)
    np.testing.assert_allclose(track.quat_xyzw, QUAT, atol=1e-8)
    np.testing.assert_allclose((track.t_ns - track.t_ns[0]) * 1e-9, T_S, atol=1e-8)


def test_times_since_1970_keep_their_nanoseconds(folder: Path) -> None:
    (folder / "track.txt").write_text("1600000000.123456789 0 0 0 0 0 0 1\n1600000001.000000001 1 0 0 0 0 0 1\n")
    track = ul.open(folder).trajectory()
    assert track is not None
    assert track.t_ns.tolist() == [1_600_000_000_123_456_789, 1_600_000_001_000_000_001]


@pytest.mark.parametrize("text", [tum(), euroc(), named()])
@pytest.mark.parametrize(("cell", "what"), [("nan", "not finite"), ("inf", "not finite"), ("7", "not of unit length")])
def test_poses_that_cannot_be_are_dropped_and_counted(folder: Path, text: str, cell: str, what: str) -> None:
    mark = "," if "," in text else " "
    lines = text.splitlines()
    for row in (50, 400):
        cells = lines[row + 1].split(mark)
        cells[0 if lines[0].startswith("qx") else -1] = cell  # a component of the quaternion
        lines[row + 1] = mark.join(cells)
    (folder / "track.csv").write_text("\n".join(lines))
    with pytest.warns(ul.UllageWarning, match=f"dropped 2 bad .pose 50: .*{what}.*of 600 received"):
        track = ul.open(folder).trajectory()
    assert track is not None
    np.testing.assert_allclose(track.position, np.delete(PLACE, (50, 400), axis=0), atol=1e-8)


@pytest.mark.parametrize("start_ns", [0, 1_600_000_000_000_000_000])
def test_stamps_in_nanoseconds_are_recognised(folder: Path, start_ns: int) -> None:
    times = start_ns + np.rint(T_S * 1e9).astype(np.int64)
    rows = [" ".join(map(str, (t, *place, *quat))) for t, place, quat in zip(times, PLACE, QUAT, strict=True)]
    (folder / "track.txt").write_text("\n".join(rows))
    with pytest.warns(ul.UllageWarning, match=r"track\.txt: times are taken as nanoseconds"):
        track = ul.open(folder).trajectory()
    assert track is not None
    np.testing.assert_array_equal(track.t_ns, times)


def test_what_evo_reads_is_read_alike(folder: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface", reason="evo is not installed")
    (folder / "track.txt").write_text(tum())
    theirs = file_interface.read_tum_trajectory_file(folder / "track.txt")
    ours = ul.open(folder).trajectory()
    assert ours is not None
    np.testing.assert_allclose(ours.position, theirs.positions_xyz, atol=1e-9)
    np.testing.assert_allclose(ours.quat_xyzw[:, [3, 0, 1, 2]], theirs.orientations_quat_wxyz, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        ("a b c\n", "of no known kind of track.*Motive export, a TUM or EuRoC"),
        ("1 0 0 0 0 0 0 1\n2 0 0 zero 0 0 0 1\n", r"track\.txt:2: a cell is not a number"),
        ("1 0 0 0 0 0 0 1\n2 0 0\n", r"track\.txt:2: 3 cells"),
        ("1 0 0 0 0 0 0 1\n2 0 0 nan 0 0 0 1\n", "1 poses: dropped 1 bad .pose 1: position is not finite"),
        ("1 0 0 0 0 0 0 1\n", "1 poses.*at least 2"),
        ("1 0 0 0 0 0 0 3\n2 0 0 0 0 0 0 1\n", "pose 0: quaternion is not of unit length"),
        ("t_s,x_m,y_m\n1,2,3\n", "no column z_m"),
        ("t_s,x_m,y_m,z_m,qx\n1,2,3,4,0\n", "only qx of the attitude"),
        ("t_s,x_m,y_m,z_m,x_m\n1,2,3,4,5\n2,2,3,4,5\n", "stand twice: x_m"),
        ("".join(f"{-t} 0 0 0 0 0 0 1\n" for t in range(9)), r"track\.txt: 8 of 8 times are earlier.*in order of time"),
    ],
)
def test_what_is_no_track_is_refused_in_one_line(folder: Path, text: str, words: str) -> None:
    (folder / "track.txt").write_text(text)
    with pytest.raises(ul.InputError, match=words) as caught:
        ul.open(folder)
    assert "\n" not in str(caught.value)


def test_two_tracks_are_refused(folder: Path) -> None:
    (folder / "track.txt").write_text(tum())
    (folder / "track.csv").write_text(named())
    with pytest.raises(ul.InputError, match=r"two tracks, track\.csv and track\.txt"):
        ul.open(folder)


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_tracks_that_cannot_be_right_are_refused_by_calibration(folder: Path) -> None:
    (folder / "track.txt").write_text(tum(scale=1000.0))
    with pytest.raises(ul.InputError, match="may be in millimetres"):
        ul.calibrate(ul.open(folder).frames())
    (folder / "track.txt").write_text(tum(scale=1e-3))
    with pytest.raises(ul.InputError, match=r"the track spans 0\.00 m"):
        ul.calibrate(ul.open(folder).frames())


def test_pickles_are_named_and_not_opened(tmp_path: Path) -> None:
    (tmp_path / "radar.pkl").write_bytes(pickle.dumps({"scans": [1, 2]}))
    for target in (tmp_path, tmp_path / "radar.pkl"):
        with pytest.raises(ul.InputError, match=r"a Python pickle: not opened, because it can run code.*numpy\.savez"):
            ul.open(target)


def test_saturated_scans_are_reported(folder: Path) -> None:
    with np.load(folder / "radar.npz") as stored:
        arrays = dict(stored)
    arrays["scans"][7, 10:14] = 32767
    arrays["scans"][40, 20] = 32767
    (folder / "track.txt").write_text(tum())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ul.open(folder)
    np.savez(folder / "radar.npz", **arrays)
    with pytest.warns(ul.UllageWarning, match="1 of 100 scans are saturated, first scan 7"):
        frames = ul.open(folder).frames()
    assert isinstance(frames, ul.Frames)
    np.testing.assert_array_equal(frames.samples, arrays["scans"])
