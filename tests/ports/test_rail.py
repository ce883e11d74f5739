"""PulsON logs with motion capture: the real rail, and logs made by hand and broken."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ullage as ul
from ullage.ports.radar_logs import CONFIG, PACKET, read_log
from ullage.ports.tracks import read_tracks

DATA = Path(__file__).parents[3] / "shared" / "data" / "pulson440"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the real recordings are not here")


def log(scans: np.ndarray, *, t_ms: np.ndarray | None = None) -> bytes:
    """A log of these scans (n, b)."""
    n, bins = scans.shape
    packets = -(-bins // 350)
    rows = np.zeros((n, packets), PACKET)
    rows["kind"], rows["total"], rows["packets"] = 0xF201, bins, packets
    rows["message"] = np.arange(n)[:, None]
    rows["t_ms"] = (5000 + 21 * np.arange(n) if t_ms is None else t_ms)[:, None]
    rows["index"] = np.arange(packets)
    padded = np.zeros((n, packets * 350), np.int32)
    padded[:, :bins] = scans
    rows["samples"] = padded.reshape(n, packets, 350)
    rows["here"] = np.minimum(bins - 350 * np.arange(packets), 350)
    return CONFIG.pack(1, 16670, 86982, 32, 11, *[0] * 8, 2, 63, 0, 0) + rows.tobytes()


def motive(t_s: np.ndarray, position: np.ndarray, *, name: str = "Radar", units: str = "Meters", **header: str) -> str:
    """A Motive export of one rigid body that does not turn."""
    about = {
        "Format Version": "1.23",
        "Rotation Type": "Quaternion",
        "Length Units": units,
        "Coordinate Space": "Global",
    }
    first = ",".join(f"{k},{v}" for k, v in (about | {k.replace("_", " "): v for k, v in header.items()}).items())
    lines = [first, "", ",Type" + ",Rigid Body" * 8, ",Name" + f",{name}" * 8, ",ID" + ',"7"' * 8]
    lines += [",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Error Per Marker"]
    lines += ["Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,"]
    for k, (t, p) in enumerate(zip(t_s, position, strict=True)):
        lines.append(f"{k},{t:.6f},0,0,0,1,{p[0]:.6f},{p[1]:.6f},{p[2]:.6f},0.0001")
    return "\r\n".join(lines) + "\r\n"


@pytest.fixture
def rail(tmp_path: Path) -> Path:
    """A second of a radar that rises, then looks back south."""
    rng = np.random.default_rng(0)
    (tmp_path / "radar.out").write_bytes(log(rng.integers(-999, 999, (40, 400))))
    t = np.arange(0, 2, 1 / 120)
    (tmp_path / "mocap.csv").write_text(motive(t, np.stack([t, 1 + 0 * t, -2 * t], axis=1)))
    return tmp_path


@needs_data
@pytest.mark.filterwarnings("ignore:.*3 packets are missing:ullage.errors.UllageWarning")
def test_real_rail_to_the_last_sample() -> None:
    source = ul.open(DATA / "rail_a")
    frames = source.frames()
    assert isinstance(frames, ul.Frames)
    known = np.load(DATA / "rail_a/decoded.npz")
    assert abs(known["scans"]).max() < 2**24  # so float32 holds them all
    np.testing.assert_array_equal(frames.samples, known["scans"])
    np.testing.assert_allclose(frames.range_m, known["range_m"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(frames.spec.range_m, known["range_m"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(frames.t_ns * 1e-9, known["t_radar_s"], rtol=0, atol=1e-9)
    track = frames.track
    assert track is not None
    x, y, z = known["pos_m"].T
    np.testing.assert_allclose(track.position, np.stack([x, -z, y], axis=1), atol=1e-12)
    np.testing.assert_allclose(track.t_ns * 1e-9, known["t_mocap_s"], atol=1e-9)
    rx, ry, rz = known["reflectors_m"][0]
    np.testing.assert_allclose(source.reflectors(), [[rx, -rz, ry]], atol=1e-3)
    turn = ul.Trajectory(track.t_ns, track.position, track.quat_xyzw).world_from_body[:, :3, 0]
    assert (turn[:, 0] > 0.99).all()  # the radar looks east, at the reflector


def test_poses_follow_the_capture_as_if_clocks_started_together(rail: Path) -> None:
    frames = ul.open(rail).frames()
    assert isinstance(frames, ul.Frames)
    t = frames.t_ns * 1e-9
    assert frames.poses is not None
    np.testing.assert_allclose(frames.poses.position, np.stack([t, 2 * t, 1 + 0 * t], axis=1), atol=3e-6)
    np.testing.assert_allclose(frames.poses.quat_xyzw, np.tile([0, 0, 0, 1], (40, 1)), atol=1e-12)
    assert frames.truth is None
    assert ul.open(rail).trajectory() is not None


def test_mount_turns_the_sensor_on_the_body(rail: Path) -> None:
    mount = ul.MountSpec(position_m=(0, 0, -0.1), yaw_deg=90)
    frames = ul.open(rail, mount=mount).frames()
    assert isinstance(frames, ul.Frames)
    assert frames.spec.mount == mount
    np.testing.assert_allclose(frames.believed.world_from_body[0, :3, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(frames.believed.position[:, 2], 0.9, atol=1e-9)


def test_capture_shorter_than_the_log_is_held_and_said(rail: Path) -> None:
    t = np.arange(0, 0.5, 1 / 120)
    (rail / "mocap.csv").write_text(motive(t, np.stack([t, t, t], axis=1)))
    with pytest.warns(ul.UllageWarning, match="of 40 scans lie outside the motion capture"):
        frames = ul.open(rail).frames()
    np.testing.assert_allclose(frames.believed.position[-1], [t[-1], -t[-1], t[-1]], atol=1e-6)


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_log_cut_anywhere(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    scans = np.random.default_rng(1).integers(-(2**20), 2**20, (5, 400))
    content = log(scans)
    cut = data.draw(st.integers(0, len(content)))
    path = tmp_path_factory.mktemp("log") / "radar.out"
    path.write_bytes(content[:cut])
    if cut < 32 + 1452:
        with pytest.raises(ul.InputError, match=r"radar\.out.*hold no scan"):
            read_log(path)
        return
    got = read_log(path).samples
    whole = (cut - 32) // 1452 // 2
    np.testing.assert_array_equal(got[:whole], scans[:whole])


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@settings(deadline=None, max_examples=80)
@given(at=st.integers(0, 32 + 10 * 1452 - 1), junk=st.binary(min_size=1, max_size=60))
def test_log_damaged_anywhere(tmp_path_factory: pytest.TempPathFactory, at: int, junk: bytes) -> None:
    content = bytearray(log(np.ones((5, 400), int)))
    content[at : at + len(junk)] = junk
    path = tmp_path_factory.mktemp("log") / "radar.out"
    path.write_bytes(content)
    try:
        got = read_log(path)
    except ul.InputError as error:
        said = str(error)
        assert "\n" not in said
    else:
        assert (np.diff(got.t_ns) > 0).all()
        assert (got.samples == 1).mean() > 0.3


def test_missing_packets_leave_zeros(tmp_path: Path) -> None:
    content = log(np.ones((5, 400), int))
    (tmp_path / "radar.out").write_bytes(content[: 32 + 1452] + content[32 + 2 * 1452 :])
    with pytest.warns(ul.UllageWarning, match="1 packets are missing"):
        scans = read_log(tmp_path / "radar.out").samples
    assert scans.sum() == 5 * 400 - 50
    assert not scans[0, 350:].any()


def test_clock_that_jumps_back_keeps_every_scan(tmp_path: Path) -> None:
    t_ms = np.array([0, 20, 40, 60, 10, 30, 50])
    (tmp_path / "radar.out").write_bytes(log(np.ones((7, 20), int), t_ms=t_ms))
    with pytest.warns(ul.UllageWarning, match=r"jumps back.*first after frame 3 \(-0.050 s\).*20 ms"):
        got = read_log(tmp_path / "radar.out")
    assert (got.t_ns // 1_000_000).tolist() == [0, 20, 40, 60, 80, 100, 120]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda raw: b"", "0 bytes hold no scan"),
        (lambda raw: raw[:32] + b"\0" * len(raw[32:]), "no range scans"),
        (lambda raw: raw[: 32 + 44] + struct.pack(">I", 5) + raw[32 + 48 : 32 + 1452], "says 5 samples"),
    ],
)
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_what_is_no_log_is_refused(tmp_path: Path, change: object, words: str) -> None:
    (tmp_path / "radar.out").write_bytes(change(log(np.ones((2, 20), int))))  # type: ignore[operator]
    with pytest.raises(ul.InputError, match=words):
        read_log(tmp_path / "radar.out")


def test_units_of_length(tmp_path: Path) -> None:
    t = np.arange(5) / 100
    (tmp_path / "m.csv").write_text(motive(t, np.full((5, 3), 1500.0), units="Millimeters"))
    track = read_tracks(tmp_path / "m.csv")["Radar"]
    np.testing.assert_allclose(track.position, np.tile([1.5, -1.5, 1.5], (5, 1)))


@pytest.mark.parametrize(
    ("axis", "forward", "left"), [(0, (1, 0, 0), (0, 0, 1)), (1, (0, 1, 0), (-1, 0, 0)), (2, (0, 0, 1), (0, 1, 0))]
)
def test_attitude_turns_with_the_axes(
    tmp_path: Path, axis: int, forward: tuple[int, ...], left: tuple[int, ...]
) -> None:
    """A quarter turn about Motive's X, Y (up), Z is one about ENU's east, up, south."""
    quat = np.zeros(4)
    quat[[axis, 3]] = np.sqrt(0.5)
    text = motive(np.arange(3) / 100, np.zeros((3, 3))).replace(",0,0,0,1,", f",{','.join(map(str, quat))},")
    (tmp_path / "m.csv").write_text(text)
    pose = read_tracks(tmp_path / "m.csv")["Radar"].world_from_body[0]
    np.testing.assert_allclose(pose[:3, 0], forward, atol=1e-9)
    np.testing.assert_allclose(pose[:3, 1], left, atol=1e-9)


def test_unseen_moments_are_left_out(tmp_path: Path) -> None:
    lines = motive(np.arange(200) / 100, np.zeros((200, 3))).splitlines()
    lines[20] = "13,0.130000,,,,,,,,"
    lines[50:150] = [f"{k - 7},{(k - 7) / 100},,,,,,,," for k in range(50, 150)]
    (tmp_path / "m.csv").write_text("\n".join(lines))
    with pytest.warns(ul.UllageWarning, match=r"not seen for up to 1\.01 s"):
        assert len(read_tracks(tmp_path / "m.csv")["Radar"]) == 99


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no line that starts with Frame"),
        ("a,b\n" * 60, "no line that starts with Frame"),
        ("\nFrame,Time (Seconds),X,Y,Z", "no rigid body"),
        (motive(np.arange(3) / 9, np.zeros((3, 3)), Rotation_Type="XYZ"), "Rotation Type is XYZ.*Quaternion"),
        (motive(np.arange(3) / 9, np.zeros((3, 3)), Coordinate_Space="Local"), "Coordinate Space is Local"),
        (motive(np.arange(3) / 9, np.zeros((3, 3)), units="Furlongs"), "furlongs.*meters"),
        (motive(np.arange(0), np.zeros((0, 3))), "no rigid body was seen"),
        (motive(np.arange(3) * 1e9, np.zeros((3, 3))), "absurd"),
    ],
)
def test_what_is_no_track_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(ul.InputError, match=words):
        read_tracks(tmp_path / "m.csv")


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_tracks_cut_or_damaged_anywhere(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    content = bytearray(motive(np.arange(9) / 100, np.zeros((9, 3))).encode())
    at = data.draw(st.integers(0, len(content)))
    junk = data.draw(st.binary(max_size=9))
    content[at : at + len(junk) if junk else None] = junk
    path = tmp_path_factory.mktemp("m") / "m.csv"
    path.write_bytes(content)
    try:
        tracks = read_tracks(path)
    except ul.InputError as error:
        said = str(error)
        assert "\n" not in said
    else:
        assert all(len(track) for track in tracks.values())


def test_a_track_alone_is_refused(rail: Path) -> None:
    (rail / "radar.out").unlink()
    with pytest.raises(ul.InputError, match=r"mocap\.csv"):
        ul.open(rail)


def test_a_log_alone_gives_frames_without_poses(rail: Path) -> None:
    (rail / "mocap.csv").unlink()
    with pytest.warns(ul.UllageWarning, match=r"no track \(mocap\.csv"):
        frames = ul.open(rail).frames()
    alone = ul.open(rail / "radar.out").frames()
    for one in (frames, alone):
        assert isinstance(one, ul.Frames)
        assert (one.samples.shape, one.poses, one.track) == ((40, 400), None, None)
    assert isinstance(ul.detect(alone), ul.Detections)


@pytest.mark.parametrize(("kind", "tail"), [(0x1001, b""), (0x1102, bytes(8))])
def test_the_whole_configuration_message_may_stand_in_front(rail: Path, kind: int, tail: bytes) -> None:
    raw, known = (rail / "radar.out").read_bytes(), read_log(rail / "radar.out")
    (rail / "radar.out").write_bytes(struct.pack(">HH", kind, 1) + raw[: CONFIG.size] + tail + raw[CONFIG.size :])
    got = read_log(rail / "radar.out")
    np.testing.assert_array_equal(got.samples, known.samples)
    np.testing.assert_array_equal(got.range_m, known.range_m)
    assert got.spec == known.spec


def test_scans_of_a_p452_as_json(tmp_path: Path) -> None:
    scans = np.random.default_rng(0).integers(-999, 999, (5, 40))
    rows = [[0.02 * k, scan.tolist()] for k, scan in enumerate(scans)]
    path = tmp_path / "scans-1.json"
    path.write_text(json.dumps({"scan_start": 20014, "scan_end": 22454, "scans": rows}))
    frames = ul.open(path).frames()
    assert isinstance(frames, ul.Frames)
    np.testing.assert_array_equal(frames.samples, scans)
    np.testing.assert_array_equal(frames.t_ns, 20_000_000 * np.arange(5))
    assert frames.range_m[0] == pytest.approx(299792458 / 2 * (20014e-12 - 10e-9))
    for text, words in (
        ("{", "damaged"), ("{}", "scan_start"), (json.dumps({"scan_start": 1, "scans": [[0, [1]]]}), r"shape \(1, 1\)")
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(ul.InputError, match=words):
            ul.open(path)


def test_exports_without_rows_type_and_name_are_read_alike(tmp_path: Path) -> None:
    text = motive(np.arange(5) / 100, np.arange(15.0).reshape(5, 3))
    (tmp_path / "new.csv").write_text(text)
    (tmp_path / "old.csv").write_text(text.replace("1.23", "1.22").replace(",Type,", ",,").replace(",Name,", ",,"))
    new, old = (read_tracks(tmp_path / name) for name in ("new.csv", "old.csv"))
    assert new.keys() == old.keys() == {"Radar"}
    np.testing.assert_array_equal(old["Radar"].position, new["Radar"].position)


def arrays(scans: np.ndarray, **changes: object) -> dict[str, object]:
    """The documented keys of a log saved as plain arrays."""
    n, bins = scans.shape
    return {
        "scans": scans, "t_ms": 5000 + 21 * np.arange(n), "range_m": 1 + 0.009 * np.arange(bins),
        "scan_start_ps": 16670, "scan_stop_ps": 86982, "scan_res": 32, "pii": 11,
    } | changes  # fmt: skip


def test_a_log_saved_as_arrays_opens_like_a_log(rail: Path) -> None:
    scans = np.random.default_rng(0).integers(-999, 999, (40, 400))
    (rail / "radar.out").unlink()
    np.savez(rail / "radar.npz", **arrays(scans))
    frames = ul.open(rail).frames()
    assert isinstance(frames, ul.Frames)
    np.testing.assert_array_equal(frames.samples, scans)
    np.testing.assert_array_equal(np.diff(frames.t_ns), 21_000_000)
    assert frames.track is not None
    assert frames.spec.counts == 2**11


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pii": None}, "no pii"),
        ({"t_ms": np.arange(3)}, r"t_ms \(3,\).*allowed: scans \(n, b\)"),
        ({"range_m": np.zeros(400)}, "range_m does not rise"),
        ({"pii": 99}, "pii is 99"),
        ({"scans": np.array([[object()]])}, "an array in it is a Python pickle: not opened, because it can run code"),
    ],
)
def test_arrays_that_are_no_log_are_refused(rail: Path, changes: dict[str, object], words: str) -> None:
    (rail / "radar.out").unlink()
    kept = {name: value for name, value in (arrays(np.ones((40, 400), int)) | changes).items() if value is not None}
    np.savez(rail / "radar.npz", **kept)
    with pytest.raises(ul.InputError, match=words):
        ul.open(rail)


def test_two_radar_recordings_in_one_folder_are_refused(rail: Path) -> None:
    np.savez(rail / "radar.npz", **arrays(np.ones((40, 400), int)))
    with pytest.raises(ul.InputError, match="two radar recordings"):
        ul.open(rail)


@needs_data
def test_the_real_flight_opens_with_its_track() -> None:
    frames = ul.open(DATA / "flight_a").frames()
    assert isinstance(frames, ul.Frames)
    assert frames.samples.shape == (800, 1152)
    assert frames.track is not None
    assert np.ptp(frames.track.position, axis=0).max() > 5
