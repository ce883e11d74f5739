"""Frames and poses brought together, message by message, without any middleware."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from ullage.errors import InputError
from ullage.geometry import rpy_quat
from ullage.ports import conversions
from ullage.ports import schema as ros
from ullage.ports.encode import fixed_message
from ullage.ports.publisher import Publisher, body_path, shifted
from ullage.ports.ros2.incoming import SETTINGS_S, Incoming
from ullage.ports.ros2.options import SourceOptions

S = 1_000_000_000


@pytest.fixture(scope="module")
def flight() -> ul.Frames:
    spec = ul.RadarSpec.preset("x4m05", mount=ul.MountSpec(position_m=(0.1, 0, 0.05), yaw_deg=90, pitch_deg=20))
    n = 30
    t_ns = 5 * S + np.arange(n) * S // 17
    path = ul.Trajectory(
        t_ns,
        np.stack([np.arange(n) * 0.03, np.sin(np.arange(n) / 9), np.ones(n)], 1),
        rpy_quat(0, 0, np.arange(n) * 0.02),
    )
    samples = np.random.default_rng(1).normal(size=(n, 188, 2)).astype(np.float32).view(np.complex64)[..., 0]
    poses = path.mounted(spec.mount.body_from_sensor())
    return ul.Frames(samples, spec.range_m, t_ns, spec, poses=poses, sensor="left")


def incoming(**options: object) -> tuple[Incoming, list[str]]:
    said: list[str] = []
    return Incoming(SourceOptions(**options), said.append), said  # type: ignore[arg-type]


def hear(into: Incoming, frames: ul.Frames, *, settings: bool = True) -> None:
    if settings:
        into.take_settings("/radar/left/settings", conversions.settings_message(frames))
    for message in conversions.frame_messages(frames, 0):
        into.take_frame("/radar/left/frame", message)


def posed(into: Incoming, frames: ul.Frames, *, every: int = 1, fixed: bool = True) -> None:
    body = body_path(frames, frames.poses)[np.arange(0, len(frames), every)]
    for message in conversions.transform_messages("base_link", body):
        into.take_poses(ros.TRANSFORMS, message)
    if fixed:
        mount = {("base_link", "left"): frames.spec.mount.body_from_sensor()}
        into.take_poses(ros.TRANSFORMS, fixed_message(0, mount), fixed=True)


@pytest.mark.parametrize("fixed", [True, False])
def test_poses_from_transforms_are_those_of_the_flight(flight: ul.Frames, fixed: bool) -> None:
    into, said = incoming(poses="tf")
    hear(into, flight)
    assert into.ready() == {}  # nothing tells yet where it is
    assert "nothing tells where left or base_link is" in into.waits_for
    posed(into, flight, fixed=fixed)
    frames = into.ready()["left"]
    assert np.array_equal(frames.samples, flight.samples)
    assert np.array_equal(frames.t_ns, flight.t_ns)
    assert frames.spec == flight.spec
    assert flight.poses is not None
    np.testing.assert_allclose(frames.poses.world_from_body, flight.poses.world_from_body, atol=1e-9)
    np.testing.assert_allclose(frames.poses.velocity, flight.poses.velocity, atol=0.05)
    assert not said


def test_frames_wait_for_the_transform_after_them_and_no_longer_than_asked(flight: ul.Frames) -> None:
    into, said = incoming(poses="tf", patience_s=0.0)
    posed(into, flight[:10])
    hear(into, flight)
    assert len(into.ready()["left"]) == 10
    assert into.counters.dropped("no pose") == 20
    assert into.counters.lines() == ["/radar/left: dropped 20 no pose (map to base_link), of 30 received"]
    patient, said = incoming(poses="tf", patience_s=60)
    posed(patient, flight[:10])
    hear(patient, flight)
    assert len(patient.ready()["left"]) == 10
    assert patient.ready() == {}
    posed(patient, flight[10:])
    later = patient.ready()["left"]
    assert len(later) == 20
    assert later.poses.velocity[0] == pytest.approx(flight.poses.velocity[10], abs=0.05)
    assert not said


def test_frames_without_settings_are_taken_for_an_x4m05_after_a_while(flight: ul.Frames) -> None:
    said: list[str] = []
    clock = [100.0]
    into = Incoming(SourceOptions(), said.append, now=lambda: clock[0])
    hear(into, flight, settings=False)
    clock[0] += SETTINGS_S
    assert into.ready() == {}
    clock[0] += 0.01
    assert len(into.ready()["left"]) == len(flight)
    assert "no settings were recorded" in said[0]


def test_odometry_stands_in_for_transforms(flight: ul.Frames) -> None:
    into, said = incoming(poses="tf")
    for message in conversions.odometry_messages(body_path(flight, flight.poses), parent="odom"):
        into.take_poses(ros.ODOMETRY, message)
    hear(into, flight)
    frames = into.ready()["left"]
    np.testing.assert_allclose(frames.poses.position, flight.poses.position, atol=1e-9)
    assert "base_link hangs on odom, not on map" in said[0]


def test_a_profile_of_points_gives_the_same_ranges(flight: ul.Frames) -> None:
    into, _ = incoming(poses="none")
    for message in conversions.profile_messages(flight):
        into.take_profile("/radar/left/profile", message)
    frames = into.ready()["left"]
    assert frames.poses is None
    np.testing.assert_allclose(frames.amplitude, flight.amplitude, atol=1e-6)
    np.testing.assert_allclose(frames.range_m, flight.range_m, atol=1e-4)


def test_a_range_becomes_one_echo_there(flight: ul.Frames) -> None:
    into, _ = incoming(poses="none")
    ranges = np.array([1.0, 2.345, np.inf, 4.0])
    layout = ros.layout(ros.RANGE, b"left")
    for message in layout.fill(S * np.arange(4), {"min_range": 0.1, "max_range": 6.0, "range": ranges}):
        into.take_range("/sonar/range", message)
    frames = into.ready()["sonar"]
    found = ul.detect(frames)
    assert found.frame.tolist() == [0, 1, 3]
    np.testing.assert_allclose(found.range_m, ranges[[0, 1, 3]], atol=0.03)


def test_a_cloud_without_intensity_is_refused(flight: ul.Frames) -> None:
    into, _ = incoming()
    points = np.zeros((1, 9), [(axis, "<f4") for axis in "xyz"])
    message = conversions.cloud_messages(np.zeros(1, np.int64), points, frame_id="left")[0]
    with pytest.raises(InputError, match=r"without intensity.*x, y, z and intensity"):
        into.take_profile("/p/profile", message)


def test_what_goes_out_comes_in_again(flight: ul.Frames) -> None:
    into, _ = incoming(poses="tf")
    for message in Publisher().messages({"left": flight}):
        if message.topic in ("/tf", "/tf_static"):
            into.take_poses(ros.TRANSFORMS, message.data, fixed=message.topic == "/tf_static")
        elif message.topic.endswith("/settings"):
            into.take_settings("/" + message.topic, message.data)
        elif message.topic.endswith("/frame"):
            into.take_frame("/" + message.topic, message.data)
    frames = into.ready()["left"]
    assert np.array_equal(frames.samples, flight.samples)
    np.testing.assert_allclose(frames.poses.world_from_body, flight.poses.world_from_body, atol=1e-9)


def broken(message: bytes, sensor: str, what: str) -> bytes:
    """A RadarFrame with a pose or samples that cannot be."""
    layout = ros.layout(ros.FRAME, sensor.encode(), sensor.encode(), 376)
    record = np.frombuffer(bytearray(message), layout.dtype)
    if what == "quaternion":
        record["believed"][0, 3:7] = 0.3, 0, 0, 0
    elif what == "position":
        record["believed"][0, 0] = np.nan
    else:
        record["samples.count"] = 10**9
    return record.tobytes()


@pytest.mark.parametrize("what", ["quaternion", "position", "samples"])
def test_a_frame_that_cannot_be_is_counted_and_the_others_go_on(flight: ul.Frames, what: str) -> None:
    into, _ = incoming()
    into.take_settings("/radar/left/settings", conversions.settings_message(flight))
    for k, message in enumerate(conversions.frame_messages(flight, 0)):
        into.take_frame("/radar/left/frame", broken(message, "left", what) if k == 7 else message)
    frames = into.ready()["left"]
    assert np.array_equal(frames.t_ns, np.delete(flight.t_ns, 7))
    assert into.counters.dropped("bad") == 1
    assert dict(into.counters.values())["/radar/left: bad"] == "1"


@pytest.mark.parametrize("junk", [b"", b"\0\1\0\0", b"\xff" * 60, b"\0\1\0\0" + b"\xff" * 400])
def test_bytes_that_are_no_message_are_counted(flight: ul.Frames, junk: bytes) -> None:
    into, _ = incoming()
    takers = (into.take_settings, into.take_frame, into.take_profile, into.take_range)
    for take in takers:
        into.take("/radar/left/frame", take, "/radar/left/frame", junk)
    into.take("/tf", into.take_poses, ros.TRANSFORMS, junk)
    into.take("/odom", into.take_poses, ros.ODOMETRY, junk)
    hear(into, flight)
    assert len(into.ready(1000)["left"]) == len(flight)
    assert into.counters.dropped("bad") >= len(takers)


def test_transforms_that_are_not_numbers_give_no_frozen_pose(flight: ul.Frames) -> None:
    into, _ = incoming(poses="tf", patience_s=60)
    body = body_path(flight, flight.poses)
    layout = ros.layout(ros.TRANSFORMS, 1, b"odom", b"base_link")
    mount = {("base_link", "left"): flight.spec.mount.body_from_sensor()}
    into.take_poses(ros.TRANSFORMS, fixed_message(0, mount), fixed=True)
    for message in conversions.transform_messages("base_link", body, parent="odom"):
        record = np.frombuffer(bytearray(message), layout.dtype)
        record["transforms.0.transform"][0, 0] = np.nan
        into.take_poses(ros.TRANSFORMS, record.tobytes())
    hear(into, flight)
    assert into.ready() == {}
    assert "nothing tells where base_link is" in into.waits_for
    assert into.counters.dropped("bad", topic="pose of base_link") == len(flight)
    for message in conversions.transform_messages("base_link", body, parent="odom"):
        into.take_poses(ros.TRANSFORMS, message)
    np.testing.assert_allclose(into.ready()["left"].poses.position, flight.poses.position, atol=1e-9)


@pytest.mark.parametrize("away_s", [1000, -3, 3600])
def test_one_stamp_far_off_is_dropped_and_a_step_of_the_clock_begins_a_track(flight: ul.Frames, away_s: int) -> None:
    into, said = incoming()
    messages = conversions.frame_messages(flight, 0)
    into.take_settings("/radar/left/settings", conversions.settings_message(flight))
    stepped = conversions.frame_messages(shifted(flight, away_s * S), 0)
    for message in [*messages[:10], stepped[10], *messages[11:]]:
        into.take_frame("/radar/left/frame", message)
    frames = into.ready()["left"]
    assert np.array_equal(frames.t_ns, np.delete(flight.t_ns, 10))
    assert into.counters.dropped("bad") + into.counters.dropped("late") == 1
    assert into.counters.steps == 0
    for message in stepped:
        into.take_frame("/radar/left/frame", message)
    later = into.ready()["left"]
    assert np.array_equal(later.samples, flight.samples)
    assert later.t_ns[0] > frames.t_ns[-1]
    assert np.array_equal(np.diff(later.t_ns), np.diff(flight.t_ns))
    assert np.array_equal(later.poses.t_ns, later.t_ns)
    assert sum("a new track begins" in text for text in said) == 1


def test_frames_that_never_came_are_counted_by_their_numbers(flight: ul.Frames) -> None:
    into, _ = incoming()
    into.take_settings("/radar/left/settings", conversions.settings_message(flight))
    for k, message in enumerate(conversions.frame_messages(flight, 0)):
        if not 5 <= k < 12:
            into.take_frame("/radar/left/frame", message)
    assert into.counters.dropped("lost") == 7


def test_a_vehicle_with_a_prefix_is_found(flight: ul.Frames) -> None:
    into, _ = incoming(poses="tf", frame_prefix="drone2/")
    body = body_path(flight, flight.poses)
    for message in conversions.transform_messages("drone2/base_link", body):
        into.take_poses(ros.TRANSFORMS, message)
    into.take_settings("/radar/left/settings", conversions.settings_message(flight))
    for message in conversions.frame_messages(flight, 0, frame_id="drone2/left"):
        into.take_frame("/radar/left/frame", message)
    np.testing.assert_allclose(into.ready()["left"].poses.position, flight.poses.position, atol=1e-9)
