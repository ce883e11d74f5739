"""Bags of others: ROS 1 and rosbag2 sqlite3 files that `rosbags` wrote give frames, with poses of their transforms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import ullage as ul
from ullage.geometry import rpy_quat
from ullage.ports import conversions, encode
from ullage.ports import schema as ros
from ullage.ports.publisher import Message, Publisher, body_path

S = 1_000_000_000


@pytest.fixture(scope="module")
def flight() -> ul.Frames:
    spec = ul.RadarSpec.preset("x4m05", mount=ul.MountSpec(position_m=(0.1, 0, 0.05), yaw_deg=90))
    n = 40
    t_ns = 1_500_000_000 * S + np.arange(n) * S // 17
    path = ul.Trajectory(
        t_ns, np.stack([np.arange(n) * 0.03, np.zeros(n), np.ones(n)], 1), rpy_quat(0, 0, np.arange(n) * 0.02)
    )
    samples = np.random.default_rng(1).normal(size=(n, 188, 2)).astype(np.float32).view(np.complex64)[..., 0]
    return ul.Frames(
        samples, spec.range_m, t_ns, spec, poses=path.mounted(spec.mount.body_from_sensor()), sensor="left"
    )


def notes_of(frames: ul.Frames, *endings: str) -> list[Message]:
    return [loaded for loaded in Publisher().messages({"left": frames}) if loaded.topic.endswith(endings)]


def write_ros1(path: Path, notes: list[Message]) -> Path:
    """As a ROS 1 program would: every message made anew of ROS 1's own types, headers with their count."""
    from rosbags.rosbag1 import Writer

    store = get_typestore(Stores.ROS1_NOETIC)
    for name, text in ros.DEFINITIONS.items():
        if name not in store.types:
            store.register(get_types_from_msg(text, name))
    with Writer(path) as writer:
        connections: dict[str, Any] = {}
        for loaded in notes:
            if loaded.topic not in connections:
                connections[loaded.topic] = writer.add_connection(
                    "/" + loaded.topic.lstrip("/"), loaded.kind, typestore=store
                )
            message = old(store, ros.from_bytes(loaded.kind, loaded.data))
            writer.write(connections[loaded.topic], loaded.t_ns, store.serialize_ros1(message, loaded.kind))
    return path


def old(store: Any, value: Any) -> Any:
    """A ROS 2 message as the ROS 1 message of the same name."""
    name = getattr(type(value), "__msgtype__", "")
    if not name:
        return [old(store, v) for v in value] if isinstance(value, list) else value
    fields = [field for field, _ in store.fielddefs[name][1]]
    made = {f: old(store, getattr(value, f)) if hasattr(value, f) else 0 for f in fields}
    return store.types[name](**made)


def write_ros2(path: Path, notes: list[Message], storage: StoragePlugin) -> Path:
    with Ros2Writer(path, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for loaded in notes:
            if loaded.topic not in connections:
                topic = "/" + loaded.topic.lstrip("/")
                connections[loaded.topic] = writer.add_connection(topic, loaded.kind, typestore=ros.typestore())
            writer.write(connections[loaded.topic], loaded.t_ns, loaded.data)
    return path


def write(kind: str, folder: Path, notes: list[Message]) -> Path:
    """A bag of another program: ROS 1's, rosbag2's in sqlite3, or rosbag2's in MCAP."""
    if kind == "ros1":
        return write_ros1(folder / "a.bag", notes)
    return write_ros2(folder / "a", notes, StoragePlugin.SQLITE3 if kind == "sqlite" else StoragePlugin.MCAP)


@pytest.mark.parametrize("kind", ["ros1", "sqlite", "mcap"])
@pytest.mark.parametrize("what", ["/range", "/profile"])
def test_a_bag_of_others_has_the_poses_of_its_transforms(
    tmp_path: Path, flight: ul.Frames, kind: str, what: str
) -> None:
    source = ul.open(write(kind, tmp_path, notes_of(flight, what, "/tf", "/tf_static")))
    frames = source.frames()
    assert isinstance(frames, ul.Frames)
    assert np.array_equal(frames.t_ns, flight.t_ns)
    assert frames.poses is not None
    np.testing.assert_allclose(frames.poses.world_from_body, flight.poses.world_from_body, atol=1e-9)  # type: ignore[union-attr]
    assert source.map() is None


@pytest.mark.parametrize("kind", ["ros1", "sqlite"])
def test_frames_without_poses_get_those_of_the_transforms(tmp_path: Path, flight: ul.Frames, kind: str) -> None:
    notes = notes_of(flight, "/frame", "/settings", "/tf", "/tf_static")
    bare = {
        loaded.t_ns: data
        for loaded, data in zip(
            [n for n in notes if n.topic.endswith("/frame")],
            conversions.frame_messages(
                ul.Frames(flight.samples, flight.range_m, flight.t_ns, flight.spec, sensor="left"), 0
            ),
            strict=True,
        )
    }
    notes = [n._replace(data=bare[n.t_ns]) if n.topic.endswith("/frame") else n for n in notes]
    source = ul.open(write(kind, tmp_path, notes))
    frames = source.frames()
    assert source.sensors == ("left",)
    assert isinstance(frames, ul.Frames)
    assert np.array_equal(frames.samples, flight.samples)
    assert np.array_equal(frames.t_ns, flight.t_ns)
    assert frames.spec == flight.spec
    assert flight.poses is not None
    assert frames.poses is not None
    np.testing.assert_allclose(frames.poses.world_from_body, flight.poses.world_from_body, atol=1e-9)


def test_a_ros1_bag_of_profiles_and_odometry_can_be_mapped(tmp_path: Path, flight: ul.Frames) -> None:
    body = body_path(flight, flight.poses)  # type: ignore[arg-type]
    odometry = [
        Message(int(t), "/odom", ros.ODOMETRY, "stream", data)
        for t, data in zip(body.t_ns, conversions.odometry_messages(body), strict=True)
    ]
    notes = sorted(notes_of(flight, "/profile") + odometry, key=lambda loaded: loaded.t_ns)
    frames = ul.open(write_ros1(tmp_path / "a.bag", notes), radar="x4m05").frames()
    np.testing.assert_allclose(frames.amplitude, flight.amplitude, atol=1e-6)
    np.testing.assert_allclose(frames.poses.position, body.position, atol=1e-9)  # the radar's mount is not told


def test_a_ros1_bag_of_ranges(tmp_path: Path, flight: ul.Frames) -> None:
    frames = ul.open(write_ros1(tmp_path / "a.bag", notes_of(flight, "/range"))).frames()
    assert len(frames) == len(flight)
    assert frames.poses is None


def test_a_range_outside_its_own_limits_is_no_echo(tmp_path: Path) -> None:
    ranges = [2.0, 4.0, 4.01, 40.0, 0.25, 0.2, 0.19, 0.0, -1.0, np.inf, -np.inf, np.nan]
    notes = [
        Message(t, "/sonar", ros.RANGE, "sensor", encode.range_message(t, reach, (0.2, 4.0), 0.3, frame_id="sonar"))
        for t, reach in zip((S * np.arange(1, len(ranges) + 1)).tolist(), ranges, strict=True)
    ]
    frames = ul.open(write("sqlite", tmp_path, notes)).frames()
    assert isinstance(frames, ul.Frames)
    peak = frames.range_m[np.argmax(frames.amplitude, axis=1)]
    met = frames.amplitude.max(axis=1) > 0
    assert met.tolist() == [0.2 <= reach <= 4.0 for reach in ranges]
    np.testing.assert_allclose(peak[met], np.array(ranges)[met], atol=0.03)


@pytest.mark.parametrize(("name", "words"), [("broken.bag", "not a bag"), ("empty.db3", "not a bag")])
def test_what_is_no_bag_is_one_line(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_bytes(b"#ROSBAG V2.0\nrubbish" * 3)
    with pytest.raises(ul.InputError, match=words):
        ul.open(tmp_path / name)


def test_a_bag_without_radar_says_what_is_in_it(tmp_path: Path, flight: ul.Frames) -> None:
    path = write_ros1(tmp_path / "a.bag", notes_of(flight, "/tf"))
    with pytest.raises(ul.InputError, match=r"no radar frames.*/tf \(tf2_msgs/msg/TFMessage\)"):
        ul.open(path)
    full = write_ros1(tmp_path / "b.bag", notes_of(flight, "/tf", "/range"))
    with pytest.raises(ul.InputError, match=r"no frames on /x.*/range"):
        ul.open(full, topics="/x")
