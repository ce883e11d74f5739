"""Recordings: the same bits back, through other people's readers too."""

from __future__ import annotations

import struct
import time
import zlib
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

import ullage as ul
from conftest import assert_same, some_frames, tumbling
from ullage.data import Calibration, joined
from ullage.ports import conversions
from ullage.ports import schema as ros
from ullage.ports.replay import chunk_records
from ullage.ports.schema import topic_name


def record(path: Path, *items: object) -> Path:
    with ul.sink(path) as sink:
        for item in items:
            sink.write(item)
    return path


def written(path: Path, *messages: tuple[str, str, bytes]) -> Path:
    """A recording of other programs with these messages: topic, type and bytes."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for topic, kind, data in messages:
            schema = writer.register_schema(kind, "ros2msg", ros.schema_text(kind).encode())
            writer.add_message(writer.register_channel(topic, "cdr", schema), 0, data, 0)
        writer.finish()
    return path


KINDS = ["a.mcap", "run", *(["a.zarr"] if find_spec("zarr") else [])]


@settings(deadline=None, max_examples=40)
@given(
    kind=st.sampled_from(KINDS), n=st.integers(1, 30), bins=st.integers(8, 40), real=st.booleans(),
    chunk=st.integers(1, 40), known=st.integers(0, 3),
)  # fmt: skip
def test_same_bits_back(
    tmp_path_factory: pytest.TempPathFactory, kind: str, n: int, bins: int, real: bool, chunk: int, known: int
) -> None:
    want = some_frames(n, bins=bins, real=real, sensor="Röntgen 1")
    want = replace(want, poses=want.poses if known & 1 else None, truth=want.truth if known & 2 else None)
    path = record(tmp_path_factory.mktemp("bag") / kind, *want.chunks(chunk))
    got = ul.open(path).frames()
    assert isinstance(got, ul.Frames)
    assert_same(got, want)


@pytest.mark.parametrize("kind", KINDS)
def test_sensors_settings_and_a_map_come_back(tmp_path: Path, kind: str) -> None:
    want = {name: some_frames(300, seed=k, sensor=name) for k, name in enumerate(("back", "front", "left"))}
    track = tumbling(np.arange(10**9, 2 * 10**9, 10**7), np.random.default_rng(3))
    calibration = Calibration(4.44, 0.425, 1e-3, 2e-3, 9.5, "focus")
    want["left"] = replace(want["left"], truth=None, track=track, calibration=calibration)
    grid = ul.Grid((-1.0, -2.0, float("nan")), 0.1, (6, 5))
    omap = ul.OccupancyMap(grid, np.random.default_rng(2).integers(-2, 101, (6, 5)).astype(np.int8), "elfes", 70, 20)
    parts = [{name: frames[at : at + 70] for name, frames in want.items()} for at in range(0, 300, 70)]
    path = record(tmp_path / kind, *parts, omap)
    source = ul.open(path)
    whole, pieces = source.frames(), list(source.stream(8))
    assert sorted(source.sensors) == sorted(want)
    assert isinstance(whole, dict)
    assert max(len(frames) for piece in pieces for frames in piece.values()) <= 8
    for name, frames in want.items():
        assert_same(whole[name], frames)
        assert_same(source.frames(name), frames)
        assert_same(joined([piece[name] for piece in pieces if name in piece]), frames)
    with pytest.raises(ul.InputError, match=r"no sensor 'up'.*front"):
        source.frames("up")
    got = source.map()
    assert got is not None
    assert (got.grid.shape, got.grid.step_m, got.method) == ((6, 5), 0.1, "elfes")
    assert (got.occupied_from, got.free_to) == (70, 20)
    np.testing.assert_array_equal(got.percent, omap.percent)


@pytest.mark.parametrize("kind", KINDS)
def test_recordings_are_not_overwritten_unasked(tmp_path: Path, frames: ul.Frames, kind: str) -> None:
    path = record(tmp_path / kind, frames)
    with pytest.raises(ul.InputError, match="exists already"):
        ul.sink(path)
    with ul.sink(path, overwrite=True) as sink:
        sink.write(frames[:5])
    assert len(ul.open(path).frames()) == 5
    with pytest.raises(ul.InputError, match="closed"):
        sink.write(frames)


def test_settings_that_change_are_kept_apart(tmp_path: Path, frames: ul.Frames) -> None:
    later = replace(frames[20:], unit="normalised", spec=frames.spec.but(iterations=32))
    parts = [part["front"] for part in ul.open(record(tmp_path / "a.mcap", frames[:20], later)).stream(64)]
    assert [len(p) for p in parts] == [20, 20]
    assert [p.unit for p in parts] == ["path_gain", "normalised"]
    assert [p.spec.iterations for p in parts] == [64, 32]


def everything(tmp_path: Path, n: int = 40) -> Path:
    frames = {name: some_frames(n, sensor=name) for name in ("front", "left")}
    grid = ul.Grid((-1.0, -2.0, float("nan")), 0.1, (6, 5))
    percent = np.random.default_rng(2).integers(-2, 101, grid.shape).astype(np.int8)
    volume = ul.Grid((0.0, 0.0, 0.0), 0.5, (2, 3, 4))
    found = ul.Detections(
        np.array([0, 0, 3]), frames["front"].t_ns[[0, 0, 3]], np.array([1.0, 2.0, 1.5]), np.array([0.1, 0.2, 0.3]),
        np.array([10.0, 11.0, np.nan]), np.array([[1.0, 2, 3], [4, 5, 6], [np.nan] * 3]), "front",
    )  # fmt: skip
    scene = ul.Scene.union(
        [
            ul.Scene.of_mesh(np.eye(3), np.array([[0, 1, 2]]), name="tri"),
            ul.Scene.of_wires(np.zeros(3), np.ones(3), 0.003, name="wire"),
        ]
    )
    omap = ul.OccupancyMap(grid, percent, "elfes", 70, 20)
    cubes = ul.OccupancyMap(volume, np.full(volume.shape, 80, np.int8), "ullage")
    return record(tmp_path / "run", scene, frames, found, cubes, omap) / "frames.mcap"


def test_public_mcap_reader_with_its_index(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    with open(everything(tmp_path), "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        topics = {channel.topic for channel in summary.channels.values()}
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count
        assert reader.get_header().profile == "ros2"
    assert {"/radar/front/frame", "/radar/left/settings", "/tf", "/odom", "/truth/odom", "/map", "/world"} <= topics
    assert {"/map/cells", "/map/occupied", "/radar/front/detections", "/radar/front/profile"} <= topics


def test_rosbags_reads_the_folder_and_agrees_on_every_byte(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    folder = everything(tmp_path).parent
    seen = set()
    with AnyReader([folder]) as reader:
        for connection, t_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            again = reader.typestore.serialize_cdr(message, connection.msgtype)
            assert bytes(again) == bytes(raw), connection.topic
            assert t_ns >= some_frames().t_ns[0]
            seen.add(connection.topic)
            if connection.topic == "/radar/front/frame" and message.index == 7:
                want = some_frames().samples[7]
                np.testing.assert_array_equal(np.array(message.samples).view(np.complex64), want)
    assert seen >= {"/tf_static", "/radar/left/range", "/path", "/clock"}
    assert len(seen) == 21


def test_rosbags_reads_poses_where_we_put_them(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    mount = ul.MountSpec(position_m=(0.1, 0.2, 0.3), yaw_deg=90)
    body = ul.Trajectory.line((0, 0, 1), (2, 0, 1), yaw_deg=30)
    spec = ul.RadarSpec.preset("x4m05", mount=mount)
    samples = np.zeros((len(body), spec.bins), np.complex64)
    frames = ul.Frames(samples, spec.range_m, body.t_ns, spec, body.mounted(mount.body_from_sensor()), sensor="left")
    record(tmp_path / "run", frames)
    with AnyReader([tmp_path / "run"]) as reader:
        messages = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
        tree = {
            (c.topic, tf.header.frame_id, tf.child_frame_id)
            for c, _, raw in reader.messages() if c.topic in ("/tf", "/tf_static")
            for tf in reader.deserialize(raw, c.msgtype).transforms
        }  # fmt: skip
    at, twist = messages["/odom"].pose.pose.position, messages["/odom"].twist.twist.linear
    np.testing.assert_allclose((at.x, at.y, at.z), body.position[-1], atol=1e-12)
    np.testing.assert_allclose((twist.x, twist.y), 0.5 * np.array([np.cos(np.pi / 6), -np.sin(np.pi / 6)]), atol=1e-12)
    assert tree == {("/tf_static", "map", "odom"), ("/tf", "odom", "base_link"), ("/tf_static", "base_link", "left")}
    path = ul.open(tmp_path / "run").trajectory()
    assert path is not None
    np.testing.assert_allclose(path.position, body.position, atol=1e-12)
    np.testing.assert_allclose(path.rates[0], body.rates[0], atol=1e-12)


def test_maps_as_ros_has_them(tmp_path: Path) -> None:
    """-1 is the only unknown ROS knows; a grid from elsewhere comes back as a map."""
    grid = ul.Grid((-1.0, -2.0, 0.5), 0.1, (6, 5))
    percent = np.random.default_rng(2).integers(-2, 101, grid.shape).astype(np.int8)
    percent[0, :3] = -2, -1, 100
    data = conversions.grid_message(ul.OccupancyMap(grid, percent), 5_000_000_007)
    message = ros.from_bytes(ros.GRID, data)
    np.testing.assert_array_equal(message.data, np.maximum(percent, -1).ravel())
    assert (message.info.width, message.info.height, message.header.stamp.nanosec) == (5, 6, 7)
    got = ul.open(written(tmp_path / "other.mcap", ("/map", ros.GRID, data))).map()
    assert got is not None
    assert got.grid == grid
    np.testing.assert_array_equal(got.percent, np.maximum(percent, -1))


def test_clock_that_jumps_back_keeps_every_frame(tmp_path: Path, frames: ul.Frames) -> None:
    path = record(tmp_path / "a.mcap", frames[:30], replace(frames, poses=None, truth=None)[:25])
    with pytest.warns(ul.UllageWarning, match="time jumped back"):
        parts = list(ul.open(path).stream(10))
    t_ns = np.concatenate([part["front"].t_ns for part in parts])
    assert len(t_ns) == 55
    assert (np.diff(t_ns) > 0).all()
    np.testing.assert_array_equal(np.diff(t_ns[30:]), np.diff(frames.t_ns[:25]))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty file"),
        (b"\xff\xfeh\0i\0", "not an MCAP"),
        (b"\x89MCAP0\r\n", "no radar frames"),
        (b"PK" * 99, "not an MCAP"),
    ],
)
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(ul.InputError, match=words):
        ul.open(path).frames()


def test_unwritable_places_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ul.InputError, match="cannot write"):
        ul.sink(tmp_path / "file" / "a.mcap")


def test_a_damaged_message_costs_only_itself(tmp_path: Path, frames: ul.Frames) -> None:
    messages = conversions.frame_messages(frames, 0)
    size = ros.layout(ros.FRAME, b"front", b"front", 48).dtype.fields["believed"][1]  # type: ignore[index]
    messages[7] = messages[7][: size + 24] + bytes(32) + messages[7][size + 56 :]  # a quaternion of length 0
    messages[20] = messages[20][:4] + (10**9).to_bytes(4, "little") + messages[20][8:]  # a stamp of another year
    settings_first = ("/settings", ros.SETTINGS, conversions.settings_message(frames))
    path = written(tmp_path / "a.mcap", settings_first, *(("/frame", ros.FRAME, data) for data in messages))
    with pytest.warns(ul.UllageWarning, match=r"a\.mcap: front: dropped 2 bad"):
        got = ul.open(path).frames()
    assert_same(got, frames[np.delete(np.arange(len(frames)), [7, 20])])


def test_times_that_ros_cannot_say_are_refused(tmp_path: Path, frames: ul.Frames) -> None:
    early = replace(frames, t_ns=frames.t_ns - frames.t_ns[5], poses=None, truth=None)
    with ul.sink(tmp_path / "a.mcap") as sink, pytest.raises(ul.InputError, match="time cannot be recorded"):
        sink.write(early)


def test_frames_without_settings_are_read_as_assumed(tmp_path: Path, frames: ul.Frames) -> None:
    messages = (("/somewhere", ros.FRAME, data) for data in conversions.frame_messages(frames, 0))
    path = written(tmp_path / "a.mcap", *messages)
    with pytest.warns(ul.UllageWarning, match="no settings were recorded"):
        got = ul.open(path).frames()
    assert got.samples.tobytes() == frames.samples.tobytes()
    np.testing.assert_allclose(got.range_m, frames.range_m, atol=1e-12)


def test_unknown_settings_are_left_out_with_a_warning() -> None:
    values = ul.RadarSpec.preset("x4m05").model_dump() | {"tune": 3}
    with pytest.warns(ul.UllageWarning, match="tune"):
        assert conversions.spec_of(values, "a") == ul.RadarSpec.preset("x4m05")


@pytest.mark.parametrize(("name", "topic"), [("front", "front"), ("a b/c", "a_b_c"), ("4", "radar_4"), ("ø", "radar")])
def test_sensor_names_become_topics(name: str, topic: str) -> None:
    assert topic_name(name) == topic


def test_streaming_takes_the_same_memory_however_long(tmp_path: Path) -> None:
    import tracemalloc

    peaks = []
    for seconds in (20, 80):
        path = tmp_path / f"{seconds}.mcap"
        part = some_frames(25, bins=188)
        part = replace(part, poses=None, truth=None)
        with ul.sink(path) as sink:
            for k in range(seconds):
                sink.write(replace(part, t_ns=part.t_ns[0] + k * 10**9 + np.arange(25) * 40_000_000))
        tracemalloc.start()
        assert sum(len(chunk["front"]) for chunk in ul.open(path).stream(64)) == 25 * seconds
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]


def test_wall_clock_flushes_too(tmp_path: Path, frames: ul.Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = ul.sink(tmp_path / "a.mcap")
    sink.write(frames[:1])
    before = (tmp_path / "a.mcap").stat().st_size
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + 1)
    sink.write(frames[1:2])
    assert (tmp_path / "a.mcap").stat().st_size > before
    sink.close()


def chunk_of(*records: tuple[int, bytes], crc: int | None = None) -> Chunk:
    data = b"".join(struct.pack("<BQ", opcode, len(body)) + body for opcode, body in records)
    return Chunk("", data, 0, 0, zlib.crc32(data) if crc is None else crc, len(data))


def test_chunks_hold_what_the_mcap_library_finds_in_them(tmp_path: Path, frames: ul.Frames) -> None:
    with open(record(tmp_path / "a.mcap", frames), "rb") as file:
        chunks = [found for found in StreamReader(file, emit_chunks=True).records if isinstance(found, Chunk)]
    records = [found for chunk in chunks for found in chunk_records(chunk)]
    assert records == [found for chunk in chunks for found in breakup_chunk(chunk, validate_crc=True)]
    assert {type(found) for found in records} == {Schema, Channel, Message}


def test_unknown_records_of_a_chunk_are_passed_over() -> None:
    message = struct.pack("<HIQQ", 7, 1, 2, 3) + b"data"
    found = chunk_records(chunk_of((0x7F, b"of a later version"), (5, message)))
    assert found == [Message(channel_id=7, sequence=1, log_time=2, publish_time=3, data=b"data")]


@pytest.mark.parametrize(
    ("chunk", "words"),
    [
        (chunk_of((5, bytes(21))), "a message of 21 bytes"),
        (chunk_of((5, bytes(30)), crc=1), "checksum"),
        (Chunk("", struct.pack("<BQ", 5, 60) + bytes(30), 0, 0, 0, 39), "longer than its chunk"),
    ],
)
def test_chunks_that_cannot_be_are_refused(chunk: Chunk, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        chunk_records(chunk)
