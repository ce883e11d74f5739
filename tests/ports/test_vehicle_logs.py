"""Tracks beside a radar's file: logs of autopilots, fixes of satellite receivers, topics of bags."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vehicle_logs as logs
from rosbags.rosbag2 import Writer

import ullage as ul
from ullage.errors import MissingExtra
from ullage.geometry import rpy_quat
from ullage.ports import schema as ros
from ullage.ports.encode import imu_message

S = 1_000_000_000
needs_pyulog = pytest.mark.skipif(importlib.util.find_spec("pyulog") is None, reason="pyulog is not installed")
needs_pymavlink = pytest.mark.skipif(importlib.util.find_spec("pymavlink") is None, reason="pymavlink is not installed")


def flown() -> ul.Trajectory:
    """Ten seconds of a climbing turn, on whole milliseconds."""
    t = np.arange(101) / 10
    place = np.stack([3 * np.sin(t / 2), 2 - 2 * np.cos(t / 2), 1 + t / 8], axis=1)
    return ul.Trajectory(np.rint(t * 1000).astype(np.int64) * 1_000_000, place, rpy_quat(t / 30, t / 40, t / 2))


@pytest.fixture
def radar(tmp_path: Path) -> Path:
    """A radar of 40 frames with a clock of its own."""
    rng, n, bins = np.random.default_rng(0), 40, 20
    samples = rng.normal(size=(n, bins)) + 1j * rng.normal(size=(n, bins))
    band = {"center_hz": 6.5e9, "bandwidth_hz": 1.2e9}
    np.savez(tmp_path / "radar.npz", samples=samples, times_s=np.arange(n) / 5, ranges_m=np.arange(bins) / 20, **band)
    return tmp_path / "radar.npz"


def track_of(opened: ul.Source) -> ul.Trajectory:  # type: ignore[name-defined]
    frames = opened.frames()
    assert isinstance(frames, ul.Frames)
    assert frames.track is not None
    np.testing.assert_array_equal(frames.t_ns, frames.track.t_ns[0] + np.arange(40) * S // 5)
    np.testing.assert_allclose(frames.believed.position, frames.track.at(frames.t_ns).position, atol=1e-9)
    return frames.track


def assert_same(got: ul.Trajectory, known: ul.Trajectory, *, metres: float, turned: bool = True) -> None:
    want = known.at(np.clip(got.t_ns - got.t_ns[0] + known.t_ns[0], known.t_ns[0], known.t_ns[-1]))
    np.testing.assert_allclose(got.position, want.position, atol=metres)
    if turned:
        assert np.abs((got.quat_xyzw * want.quat_xyzw).sum(1)).min() > 1 - 1e-6
    else:
        np.testing.assert_array_equal(got.quat_xyzw, np.tile([0, 0, 0, 1], (len(got), 1)))


@pytest.mark.parametrize(
    ("name", "made"),
    [
        pytest.param("track.ulg", logs.ulog, marks=needs_pyulog),
        pytest.param("track.bin", logs.dataflash, marks=needs_pymavlink),
    ],
)
def test_the_log_of_an_autopilot_is_the_track_in_the_folder_or_beside_the_file(
    radar: Path, name: str, made: Callable[[ul.Trajectory], bytes]
) -> None:
    known = flown()
    (radar.parent / name).write_bytes(made(known))
    got = track_of(ul.open(radar.parent))
    shifted = known if name.endswith("bin") else known.at(got.t_ns)
    assert_same(got, shifted, metres=1e-5)
    moved = (radar.parent / name).rename(radar.parent / f"flight{name[-4:]}")
    assert_same(track_of(ul.open(radar, track=moved)), shifted, metres=1e-5)
    assert_same(track_of(ul.open(f"{radar}?track={moved}")), shifted, metres=1e-5)


@needs_pymavlink
def test_a_log_whose_records_have_no_length_is_refused(radar: Path) -> None:
    layout = b"\xa3\x95\x80\x40\x24XKF1"
    damaged = logs.dataflash(flown()).replace(layout, layout[:4] + b"\x00XKF1")
    (radar.parent / "track.bin").write_bytes(damaged)
    with pytest.raises(ul.InputError, match=r"track\.bin: records of kind 64 of 0 bytes.*3 bytes or more"):
        ul.open(radar.parent)


@pytest.mark.skipif(importlib.util.find_spec("pyulog") is not None, reason="pyulog is installed")
def test_a_missing_library_is_named_with_its_extra(radar: Path) -> None:
    (radar.parent / "track.ulg").write_bytes(b"ULog\x01\x12\x35\x01")
    with pytest.raises(MissingExtra, match=r"pyulog is not installed.*ullage\[logs\]"):
        ul.open(radar.parent)


def test_fixes_are_east_north_up_of_a_datum(radar: Path) -> None:
    known = flown()
    damaged = logs.sentence(5.0, np.zeros(3)).replace("GPGGA,0", "GPGGA,1")
    infinite = "$GPGGA,0001inf,3330.0000000,S,07015.0000000,W,4,12,0.7,500,M,31.5,M,,\n"  # seconds past any integer
    (radar.parent / "track.nmea").write_text("$GPRMC,x\n" + logs.nmea(known) + damaged + infinite)
    with pytest.warns(ul.UllageWarning, match="2 GGA sentences cannot be read"):
        got = track_of(ul.open(radar.parent, datum="-33.5,-70.25,520"))
    assert len(got) == len(known)
    assert_same(got, known, metres=2e-3, turned=False)
    (radar.parent / "track.nmea").write_text(logs.nmea(known))
    with pytest.warns(ul.UllageWarning, match=r"of its first fix, -33\.50.*say datum="):
        first = track_of(ul.open(radar.parent))
    np.testing.assert_allclose(first.position, known.position - known.position[0], atol=2e-3)


@pytest.mark.parametrize(("kinds", "high", "metres"), [
    ("HPPOSLLH PVT POSLLH", 0, 1e-3), ("PVT POSLLH", 1, 0.02), ("POSLLH", 2, 0.02),
])  # fmt: skip
def test_fixes_of_a_u_blox_receiver_are_those_of_its_finest_message(
    radar: Path, kinds: str, high: float, metres: float
) -> None:
    known = flown()
    (radar.parent / "track.ubx").write_bytes(logs.ubx(known, kinds=kinds))
    got = track_of(ul.open(radar.parent, datum="-33.5,-70.25,520"))
    assert len(got) == len(known)
    np.testing.assert_array_equal(np.diff(got.t_ns), np.diff(known.t_ns))  # through the end of the week
    raised = ul.Trajectory(known.t_ns, known.position + np.array([0, 0, high]), known.quat_xyzw)
    assert_same(got, raised, metres=metres, turned=False)


def test_damage_to_a_u_blox_log_costs_no_message_but_its_own(radar: Path) -> None:
    known = flown()
    rows = [logs.ubx(known[k : k + 1], kinds="PVT") for k in range(len(known))]
    rows[3] = rows[3][:4] + b"\xff\xff" + rows[3][6:]  # a length beyond the file
    rows[5] = rows[5][:40] + bytes([rows[5][40] ^ 1]) + rows[5][41:]
    rows[7] = rows[7][:60]
    rows[9] = b"$GNGGA,\xff\xfe\r\n\xb5\x62" + rows[9]
    rows[11] = logs.ubx_message("PVT", 1, (0, 0, 0, 0), (), fixed=False)
    (radar.parent / "track.ubx").write_bytes(b"".join(rows))
    with pytest.warns(ul.UllageWarning, match=r"track\.ubx: 2 messages are damaged; left out"):
        got = track_of(ul.open(radar.parent, datum="-33.5,-70.25,520"))
    kept = np.delete(np.arange(len(known)), [3, 5, 7, 11])
    np.testing.assert_array_equal(got.t_ns - got.t_ns[0], known.t_ns[kept] - known.t_ns[0])


@pytest.mark.parametrize("kind", ["HPPOSLLH", "PVT", "POSLLH"])
def test_a_u_blox_log_without_a_fix_is_refused(radar: Path, kind: str) -> None:
    (radar.parent / "track.ubx").write_bytes(logs.ubx_message(kind, 5, (0, 0, 0, 0), (0, 0, 0, 0), fixed=False) * 3)
    with pytest.raises(ul.InputError, match=r"track\.ubx: no fix in it.*fixes of a satellite receiver"):
        ul.open(radar.parent)


def test_fixes_that_are_nowhere_on_earth_are_left_out(radar: Path) -> None:
    stray = logs.ubx_message("POSLLH", 604_795_050, (0, 950_000_000, 0, 0), ())
    (radar.parent / "track.ubx").write_bytes(stray + logs.ubx(flown(), kinds="POSLLH"))
    with pytest.warns(ul.UllageWarning, match="1 of 102 fixes are nowhere on earth"):
        assert len(track_of(ul.open(radar.parent, datum="-33.5,-70.25,520"))) == 101


def test_the_messages_of_this_test_are_those_of_another_library() -> None:
    pyubx2 = pytest.importorskip("pyubx2")
    for kind in ("HPPOSLLH", "PVT", "POSLLH"):
        raw = logs.ubx_message(kind, 7000, (-702_500_001, -335_000_002, 520_003, 488_503), (-4, 5, -6, 0))
        read = pyubx2.UBXReader.parse(raw)
        assert read.identity == f"NAV-{kind}"
        fine = np.array([-4e-9, 5e-9, -6e-1]) if kind == "HPPOSLLH" else np.zeros(3)
        want = np.array([-70.2500001, -33.5000002, 520_003]) + fine
        np.testing.assert_allclose([read.lon, read.lat, read.height], want, rtol=2e-12)
        assert read.iTOW == 7000
        assert getattr(read, "gnssFixOk", 1) == 1
        assert getattr(read, "invalidLlh", 0) == 0


@pytest.mark.parametrize(
    ("text", "datum", "words"),
    [
        ("$GPRMC,1\n", "", "no fix in it"),
        (logs.sentence(1.0, np.zeros(3)).replace(",4,12", ",0,12"), "", "no fix in it"),
        (logs.sentence(1.0, np.zeros(3)), "-33.5,-70.2", "a track of one pose"),
        (logs.sentence(1.0, np.zeros(3)), "0,0", "none of 1 poses.*1000 km"),
        (logs.sentence(1.0, np.zeros(3)), "95,0", "datum is '95,0'.*latitude,longitude"),
    ],
)
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_what_gives_no_track_is_refused(radar: Path, text: str, datum: str, words: str) -> None:
    (radar.parent / "track.nmea").write_text(text)
    with pytest.raises(ul.InputError, match=words):
        ul.open(radar.parent, datum=datum)


def bag_of(path: Path, rows: list[tuple[str, str, int, Any]]) -> Path:
    """A bag of messages, as (topic, type, time, message)."""
    with Writer(path, version=9) as writer:
        known: dict[str, Any] = {}
        for topic, kind, t_ns, message in rows:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=ros.typestore())
            writer.write(known[topic], t_ns, ros.to_bytes(kind, message))
    return next(path.glob("*.db3"))


def pose(position: np.ndarray, quat: np.ndarray) -> Any:
    point = ros.make("geometry_msgs/msg/Point", *map(float, position))
    return ros.make("geometry_msgs/msg/Pose", point, ros.make("geometry_msgs/msg/Quaternion", *map(float, quat)))


def placed(track: ul.Trajectory) -> list[tuple[str, str, int, Any]]:
    rows = zip(track.t_ns, track.position, track.quat_xyzw, strict=True)
    return [
        ("/vio", "geometry_msgs/msg/PoseStamped", t, ros.make(ros.POSE, ros.header(t, "map"), pose(p, q)))
        for t, p, q in ((int(t), p, q) for t, p, q in rows)
    ]


def transforms(track: ul.Trajectory, parent: str, child: str, topic: str = "/tf") -> list[tuple[str, str, int, Any]]:
    out = []
    for t, p, q in zip(track.t_ns, track.position, track.quat_xyzw, strict=True):
        move = ros.make(
            "geometry_msgs/msg/Transform",
            ros.make("geometry_msgs/msg/Vector3", *map(float, p)),
            ros.make("geometry_msgs/msg/Quaternion", *map(float, q)),
        )
        one = ros.make("geometry_msgs/msg/TransformStamped", ros.header(int(t), parent), child, move)
        out.append((topic, ros.TRANSFORMS, int(t), ros.make(ros.TRANSFORMS, [one])))
    return out


def test_a_topic_of_a_bag_is_the_track(radar: Path, tmp_path: Path) -> None:
    known, aside = flown(), ul.Trajectory.line((0, 0, 0), (1, 0, 0), speed_m_s=0.1, rate_hz=10)
    standing = ul.Trajectory.stationary(position_m=(0, 5, 0), yaw_deg=90)
    tree = transforms(standing, "world", "map", "/tf_static") + transforms(known, "map", "base_link")
    bag = bag_of(tmp_path / "bag", placed(known) + tree + transforms(aside, "map", "other"))
    with pytest.raises(ul.InputError, match=r"2 topics hold a track: say topic=.*/vio, /tf"):
        ul.open(radar, track=bag)
    with pytest.raises(ul.InputError, match="no track on /none"):
        ul.open(radar, track=bag, topic="/none")
    assert_same(track_of(ul.open(radar, track=bag, topic="/vio")), known, metres=1e-9)
    got = track_of(ul.open(radar, track=bag, topic="/tf"))
    turn = standing.world_from_body[0]
    np.testing.assert_allclose(got.position, known.position @ turn[:3, :3].T + turn[:3, 3], atol=1e-9)
    np.testing.assert_allclose(got.world_from_body, turn @ known.world_from_body, atol=1e-9)


def test_a_recording_of_ullage_gives_its_odometry(radar: Path, tmp_path: Path) -> None:
    known = flown()
    with ul.sink(tmp_path / "flight.mcap") as sink:
        sink.write(known)
    assert_same(track_of(ul.open(radar, track=tmp_path / "flight.mcap", topic="/odom")), known, metres=1e-9)


def test_fixes_of_a_bag(radar: Path, tmp_path: Path) -> None:
    known, kind = flown(), "sensor_msgs/msg/NavSatFix"
    rows = []
    for t, p in zip(known.t_ns, known.position, strict=True):
        at = logs.PLACE.moved(logs.SWAP @ p)
        where = (*np.degrees([at.lat_rad, at.lon_rad]).tolist(), at.height_m)
        state = ros.make("sensor_msgs/msg/NavSatStatus", 0, 1)
        rows.append(("/fix", kind, int(t), ros.make(kind, ros.header(int(t), "gps"), state, *where, np.zeros(9), 0)))
    bag = bag_of(tmp_path / "bag", rows)
    assert_same(track_of(ul.open(radar, track=bag, datum="-33.5,-70.25,520")), known, metres=1e-6, turned=False)


def test_any_radar_file_takes_a_track(tmp_path: Path) -> None:
    rows = np.zeros(60, [("id", "<u4"), ("n", "<u4"), ("size", "<u4"), ("iq", "<f4", 40)])
    rows["n"], rows["size"], rows["iq"] = np.arange(60), 40, 0.1
    rows.tofile(tmp_path / "radar.dat")
    (tmp_path / "track.csv").write_text("t_s,x_m,y_m,z_m\n" + "".join(f"{k / 10},{k / 20},0,1\n" for k in range(99)))
    frames = ul.open(f"{tmp_path / 'radar.dat'}?fps=20&range_start_m=0.2&track={tmp_path / 'track.csv'}").frames()
    assert isinstance(frames, ul.Frames)
    np.testing.assert_allclose(frames.believed.position[:, 0], np.arange(60) / 40, atol=1e-6)
    turned = ul.open(tmp_path, fps=20, range_start_m=0.2, mount=ul.MountSpec(yaw_deg=90)).frames()
    assert isinstance(turned, ul.Frames)
    np.testing.assert_allclose(turned.believed.world_from_body[0, :3, 0], [0, 1, 0], atol=1e-9)


def unit() -> ul.Imu:
    """Readings of a body that turns and speeds up, level at first."""
    t = np.arange(50) / 100
    turn = np.stack([0.1 * t, -0.2 * t, 0.3 + t], axis=1)
    return ul.Imu(np.rint(t * 1e9).astype(np.int64) + S, turn, np.stack([t, -2 * t, 9.81 + t], axis=1))


def bag_of_imu(path: Path, imu: ul.Imu) -> Path:
    still = np.array([0.0, 0.0, 0.0, 1.0])
    readings = zip(imu.t_ns.tolist(), imu.angular_velocity, imu.specific_force, strict=True)
    rows = [("/imu", ros.IMU, t, imu_message(t, still, turn, force, frame_id="base")) for t, turn, force in readings]
    return bag_of(path, [(topic, kind, t, ros.from_bytes(kind, data)) for topic, kind, t, data in rows])


@pytest.mark.parametrize(
    "made",
    [
        pytest.param("ulg", marks=needs_pyulog),
        pytest.param("bin", marks=needs_pymavlink),
        "bag",
    ],
)
def test_an_inertial_unit_is_read_in_the_axes_of_the_body(tmp_path: Path, made: str) -> None:
    known, path = unit(), tmp_path / f"flight.{made}"
    if made == "bag":
        path = bag_of_imu(tmp_path / "flight", known)
    else:
        path.write_bytes(logs.ulog_of_imu(known) if made == "ulg" else logs.dataflash_of_imu(known))
    got = ul.read_imu(path)
    np.testing.assert_array_equal(got.t_ns, known.t_ns)
    np.testing.assert_allclose(got.angular_velocity, known.angular_velocity, atol=1e-6)
    np.testing.assert_allclose(got.specific_force, known.specific_force, atol=1e-5)


def test_readings_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    known, down = unit(), np.full(3, 5.7)
    rows = [ros.from_bytes(ros.IMU, imu_message(t, np.array([0, 0, 0, 1.0]), np.full(3, w), down, frame_id="b"))
            for t, w in zip(known.t_ns.tolist(), [np.nan, *np.zeros(49)], strict=True)]  # fmt: skip
    path = bag_of(tmp_path / "flight", [("/imu", ros.IMU, S + k, one) for k, one in enumerate(rows)])
    with pytest.warns(ul.UllageWarning, match="1 of 50 readings of the inertial unit are no numbers"):
        assert len(ul.read_imu(path, topic="/imu")) == 49
    with pytest.raises(ul.InputError, match=r"no Imu on /else.*/imu"):
        ul.read_imu(path, topic="/else")


@pytest.mark.parametrize("factor", [1 / 9.81, 1 / 0.3048, 1000 / 9.81, 0.0])
def test_forces_in_another_unit_or_without_gravity_are_refused_and_not_guessed(tmp_path: Path, factor: float) -> None:
    known = unit()
    path = bag_of_imu(tmp_path / "flight", ul.Imu(known.t_ns, known.angular_velocity, factor * known.specific_force))
    with pytest.raises(ul.InputError, match=r"flight\.db3: a specific force of .* m/s2.*allowed: m/s2 with gravity"):
        ul.read_imu(path)


def test_what_holds_no_inertial_unit_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t\n")
    with pytest.raises(ul.InputError, match=r"a\.csv: no inertial unit is read from it.*\.ulg"):
        ul.read_imu(tmp_path / "a.csv")
    with pytest.raises(ul.InputError, match="no such file"):
        ul.read_imu(tmp_path / "b.ulg")
    with pytest.raises(ul.InputError, match="0 topics hold an inertial unit"):
        ul.read_imu(bag_of(tmp_path / "flight", placed(flown())))
    if importlib.util.find_spec("pymavlink") is not None:
        (tmp_path / "c.bin").write_bytes(logs.dataflash(flown()))
        with pytest.raises(ul.InputError, match="0 readings of an inertial unit"):
            ul.read_imu(tmp_path / "c.bin")
