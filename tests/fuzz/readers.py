"""What the fuzzer reads: for each reader real inputs, how to read one, and how to keep its outer shell sound.

An input is one or more files in a folder. Damage goes into the part that the reader understands: MCAP messages are
damaged before they are packed, so that checksums hold, and packed logs before they are packed.
"""

from __future__ import annotations

import gzip
import importlib
import importlib.util
import io
import json
import shutil
import struct
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import peers

import ullage as ul
from ullage import antenna, ports
from ullage.config import make_scenario
from ullage.errors import UllageError
from ullage.experiments.catalog import FOLDER, find_scenario

LARGEST = 60_000
SHARED = Path(__file__).parents[3] / "shared" / "data"
SCENE = """<sdf version="1.9"><world name="w"><model name="m"><static>true</static><pose>1 2 0 0 0 0.5</pose>
<link name="l"><collision name="c"><geometry><box><size>1 2 3</size></box></geometry></collision>
<visual name="v"><geometry><cylinder><radius>0.1</radius><length>2</length></cylinder></geometry></visual></link>
<joint name="j" type="fixed"><parent>world</parent><child>l</child></joint>
<frame name="f" attached_to="l"><pose relative_to="l">0 0 1 0 0 0</pose></frame></model>
<include><uri>part.sdf</uri><pose>0 0 1 0 0 0</pose></include></world></sdf>"""
PART = """<sdf version="1.6"><model name="p"><link name="l"><collision name="c"><geometry><plane><normal>0 0 1</normal>
<size>2 2</size></plane></geometry></collision></link></model></sdf>"""
ROBOT = """<robot name="arm"><link name="base"><collision><geometry><box size="1 1 0.2"/></geometry></collision></link>
<link name="upper"><visual><geometry><sphere radius="0.5"/></geometry></visual><collision><origin xyz="1 0 0"
 rpy="0 0 0"/><geometry><cylinder radius="0.2" length="1"/></geometry></collision></link>
<joint name="s" type="revolute"><origin xyz="0 0 1" rpy="0 0 1.5"/><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""
OPTIONS = (
    "map.step_m=0.2", "sensing.changes={bins: 100}", "flight.waypoints=[[0,0,1],[1,0,1]]", "seed=7",
    "sensing.changes.frame_area=[0.2, 5]", "do=[detect]", "expect.f1.min=0.1", "world.name=cargo-hold",
)  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """One reader: seeds, the name of the file that is damaged, and what is called on it."""

    name: str
    seeds: Callable[[Path], Sequence[bytes]]
    file: str
    read: Callable[[Path], object]
    pack: Callable[[bytes], bytes] = bytes
    before: Callable[[Path], object] = lambda folder: None


def _all_of(path: Path) -> None:
    """Everything that a recording gives; a part that is refused hides no other, and is passed on if there is none."""
    source: Any = ports.open(path)
    given, refused = [], []
    for part in (source.frames, source.trajectory, source.map):
        try:
            given.append(part())
        except ul.InputError as error:
            assert_one_line(error)
            refused.append(error)
    if all(part is None for part in given):
        raise refused[0]


def assert_one_line(error: Exception) -> None:
    """A refusal is one line of readable length."""
    assert str(error).isprintable()
    assert len(str(error)) < 2000


def _written(*items: object, name: str) -> Callable[[Path], Sequence[bytes]]:
    def seeds(folder: Path) -> Sequence[bytes]:
        with ul.sink(folder / name) as sink:
            for item in items:
                sink.write(item)
        return [(folder / name).read_bytes()]

    return seeds


def small_frames() -> ul.Frames:
    """Six frames of noise with poses."""
    rng, n, bins = np.random.default_rng(0), 6, 12
    spec = ul.RadarSpec.preset("x4m05", bins=bins, range_start_m=0.3, fps=25)
    t_ns = 1_700_000_000_000_000_000 + np.arange(n) * 40_000_000
    quat = rng.normal(size=(n, 4))
    poses = ul.Trajectory(t_ns, rng.normal(size=(n, 3)), quat / np.linalg.norm(quat, axis=1, keepdims=True))
    samples = rng.normal(size=(n, bins, 2)).astype(np.float32).view(np.complex64)[..., 0]
    return ul.Frames(samples, spec.range_m, t_ns, spec, poses=poses, truth=poses, sensor="front", unit="path_gain")


def plane() -> ul.OccupancyMap:
    percent = np.random.default_rng(0).integers(-2, 101, (6, 9)).astype(np.int8)
    return ul.OccupancyMap(ul.Grid((-1.0, 2.0, 0.5), 0.2, percent.shape), percent)


def volume() -> ul.OccupancyMap:
    percent = np.full((4, 5, 6), -1, np.int8)
    percent[1:3, 1:3, 2:5] = 100
    percent[0] = 0
    return ul.OccupancyMap(ul.Grid((-0.4, 0.0, 0.0), 0.2, percent.shape), percent)


def _messages(folder: Path) -> list[bytes]:
    """The messages of small recordings, as (schema, length, bytes) in a row."""
    from mcap.reader import make_reader

    out = []
    for number, items in enumerate(((small_frames(), plane()), (small_frames(), volume()))):
        path = folder / f"{number}.mcap"
        with ul.sink(path) as sink:
            for item in items:
                sink.write(item)
        with open(path, "rb") as file:
            rows = [(s.name, c.topic, m.data) for s, c, m in make_reader(file).iter_messages()]
        wanted = [r for r in rows if r[0].startswith("ullage") or "Odometry" in r[0] or "OccupancyGrid" in r[0]]
        seen: dict[str, int] = {}
        blob = b""
        for kind, topic, data in wanted:
            seen[kind] = seen.get(kind, 0) + 1
            if seen[kind] <= 3:
                head = f"{kind} {topic}".encode()
                blob += struct.pack("<HI", len(head), len(data)) + head + data
        out.append(blob)
    plain = [row for row in unrolled(out[0]) if not row[0].endswith("CellMap")]  # which is read before a plain grid
    heads = [(f"{kind} {topic}".encode(), data) for kind, topic, data in plain]
    return [*out, b"".join(struct.pack("<HI", len(head), len(data)) + head + data for head, data in heads)]


def unrolled(blob: bytes) -> Iterator[tuple[str, str, bytes]]:
    at = 0
    while at + 6 <= len(blob):
        head, size = struct.unpack_from("<HI", blob, at)
        kind, _, topic = blob[at + 6 : at + 6 + head].decode("latin1").partition(" ")
        yield kind, topic, blob[at + 6 + head : at + 6 + head + size]
        at += 6 + head + size


def mcap_of(blob: bytes) -> bytes:
    """A recording with sound checksums that holds these messages."""
    from mcap.writer import CompressionType, Writer

    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    channels: dict[tuple[str, str], int] = {}
    for number, (kind, topic, data) in enumerate(unrolled(blob)):
        if (kind, topic) not in channels:
            schema = writer.register_schema(kind, "ros2msg", b"")
            channels[kind, topic] = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channels[kind, topic], number, data, number)
    writer.finish()
    return out.getvalue()


def _bag(folder: Path) -> list[bytes]:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    kinds = store.types
    stamp, quaternion = kinds["builtin_interfaces/msg/Time"], kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    with Writer(folder / "a.bag") as writer:
        ranges = writer.add_connection("/range", "sensor_msgs/msg/Range", typestore=store)
        poses = writer.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store)
        for n in range(4):
            head = kinds["std_msgs/msg/Header"](n, stamp(10 + n, 0), "base_link")
            heard = kinds["sensor_msgs/msg/Range"](head, 0, 0.5, 0.1, 10.0, 2.0 + n)
            place = kinds["geometry_msgs/msg/Transform"](kinds["geometry_msgs/msg/Vector3"](0.0, 1.0, 2.0), quaternion)
            moved = kinds["geometry_msgs/msg/TransformStamped"](
                kinds["std_msgs/msg/Header"](n, stamp(10 + n, 0), "map"), "base_link", place
            )
            writer.write(poses, n, store.serialize_ros1(kinds["tf2_msgs/msg/TFMessage"]([moved]), poses.msgtype))
            writer.write(ranges, n + 1, store.serialize_ros1(heard, ranges.msgtype))
    return [(folder / "a.bag").read_bytes()]


BAGS = {
    "frames": ("RadarFrame", "RadarSettings", "Odometry"),
    "ranges": ("Range", "TFMessage"),
    "profiles": ("PointCloud2", "TFMessage"),
}
"""Types of messages in each seed: every type in a bag has its definition parsed at each opening, 5 ms apiece."""


def _db3(folder: Path) -> list[bytes]:
    from rosbags.rosbag2 import Writer

    from ullage.ports import schema as ros
    from ullage.ports.publisher import Publisher

    out = []
    for name, kinds in BAGS.items():
        with Writer(folder / name, version=9) as writer:
            connections: dict[str, Any] = {}
            for note in Publisher().messages({"front": small_frames()}):
                topic = "/" + note.topic.lstrip("/")
                if topic.startswith("/truth") or note.kind.rpartition("/")[2] not in kinds:
                    continue
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, note.kind, typestore=ros.typestore())
                writer.write(connections[topic], note.t_ns, note.data)
        out.append(next((folder / name).glob("*.db3")).read_bytes())
    return out


def _recorded(*parts: str, most: int = 40_000) -> Callable[[Path], Sequence[bytes]]:
    def seeds(folder: Path) -> Sequence[bytes]:
        path = SHARED.joinpath(*parts)
        return [path.read_bytes()[:most]] if path.exists() else []

    return seeds


def _map_files(folder: Path) -> list[bytes]:
    out = []
    for mode in ("trinary", "scale", "raw"):
        ports.write_map(plane(), folder / f"{mode}.yaml", mode=mode)
        text = (folder / f"{mode}.yaml").read_bytes()
        image = (folder / f"{mode}.{'png' if mode == 'scale' else 'pgm'}").read_bytes()
        text = text.replace(b"scale.png", b"m.img").replace(f"{mode}.pgm".encode(), b"m.img")
        out.append(struct.pack("<I", len(text)) + text + image)
    return out


def _read_map_server(path: Path) -> None:
    blob = path.read_bytes()
    size = int.from_bytes(blob[:4], "little") % (len(blob) + 1)
    path.with_name("m.img").write_bytes(blob[4 + size :])
    path.write_bytes(blob[4 : 4 + size])
    ports.read_map(path)


def _meshes(kind: str) -> Callable[[Path], Sequence[bytes]]:
    def seeds(folder: Path) -> Sequence[bytes]:
        import trimesh

        trimesh.creation.box((1, 2, 3)).export(folder / f"m.{kind}")
        return [(folder / f"m.{kind}").read_bytes()]

    return seeds


def _maps(omap: Callable[[], ul.OccupancyMap], kind: str) -> Callable[[Path], Sequence[bytes]]:
    def seeds(folder: Path) -> Sequence[bytes]:
        ports.write_map(omap(), folder / f"m.{kind}")
        return [(folder / f"m.{kind}").read_bytes()]

    return seeds


def _antenna(kind: str) -> Callable[[Path], Sequence[bytes]]:
    """A small table of an antenna's gains."""
    if kind == "csv":
        rows = [f"{az},{el},{3 + el / 30}" for az in (-180, 0, 180) for el in (-90, 0, 90)]
        return _text("\n".join(["azimuth_deg,elevation_deg,gain_dbi", *rows]))
    if kind == "msi":
        cut = "".join(f"{angle}.0 {angle % 50}\n" for angle in range(0, 360, 30))
        return _text(f"NAME a\nGAIN 3 dBi\nTILT\nHORIZONTAL 12\n{cut}VERTICAL 12\n{cut}")
    cuts = [f"{phi} {theta} 1 0 0 0" for phi in range(0, 360, 30) for theta in range(0, 181, 30)]
    head = ["// a", "3.0", "Farfield", "1", "0 0 0", "0 0 1", "1 0 0", "1 1 1 7e9", "12 7"]
    return _text("\n".join([*head, *cuts]))


def _read_antenna(path: Path) -> None:
    """A table, past the store of those read already."""
    read = antenna._far_field if path.suffix == ".ffs" else antenna._table
    read.__wrapped__(str(path))


def _text(*texts: str) -> Callable[[Path], Sequence[bytes]]:
    return lambda folder: [text.encode() for text in texts]


def _zarr(folder: Path) -> list[bytes]:
    with ul.sink(folder / "seed.zarr") as sink:
        sink.write(small_frames())
        sink.write(plane())
    files = sorted(p for p in (folder / "seed.zarr").rglob("*") if p.is_file())
    blob = b""
    for path in files:
        name, data = str(path.relative_to(folder / "seed.zarr")).encode(), path.read_bytes()
        blob += struct.pack("<HI", len(name), len(data)) + name + data
    return [blob]


def _read_zarr(path: Path) -> None:
    """Files of a store in a row; names come from the seed alone, so that nothing else is written to."""
    home = path.with_name("a.zarr")
    shutil.rmtree(home, ignore_errors=True)
    for name, _, data in unrolled(path.read_bytes()):
        place = (home / name.replace("\0", "")[:80]).resolve()
        if place.is_relative_to(home.resolve()) and place != home.resolve():
            try:
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(data)
            except OSError:
                continue
    _all_of(home)


def _npz(folder: Path) -> list[bytes]:
    """Plain arrays with poses of each frame, RF samples with a track on its own clock, and the least that is read."""
    frames = small_frames()
    poses = {"positions_m": frames.poses.position, "quaternions_xyzw": frames.poses.quat_xyzw} if frames.poses else {}
    track = {f"track_{name}": values for name, values in poses.items()}
    least = {"samples": frames.samples, "times_ns": frames.t_ns, "ranges_m": frames.range_m}
    rf = {"samples": frames.samples.real, "times_s": frames.t_ns * 1e-9, "ranges_m": frames.range_m}
    rf |= {"center_hz": 7.29e9, "bandwidth_hz": 1.4e9, "track_times_ns": frames.t_ns, **track}
    out = []
    for arrays in (least | poses, rf, least):
        packed = io.BytesIO()
        np.savez(packed, **arrays)
        out.append(packed.getvalue())
    return out


def _stored(blob: bytes) -> bytes:
    """The same archive with sound checksums, where its entries can be read at all."""
    out = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(blob)) as damaged, zipfile.ZipFile(out, "w") as sound:
            for one in damaged.infolist():
                with damaged.open(one) as entry:
                    entry._expected_crc = None  # type: ignore[attr-defined]
                    sound.writestr(one.filename, entry.read(LARGEST))
    except Exception:  # damaged beyond that: the reader must refuse it as it is
        return blob
    return out.getvalue()


def _read_options(path: Path) -> None:
    make_scenario({"name": "x"}, options=path.read_bytes().decode("utf-8", "replace").splitlines())


def _read_address(path: Path) -> None:
    """The options of a live port, as far as they are read before anything is connected."""
    from ullage.ports.imc.options import SourceOptions, endpoint
    from ullage.ports.live import Address, options_of, point_of

    address = Address.of(path.read_bytes().decode("utf-8", "replace"))
    if address is None:
        raise ul.InputError("no address", where=path.name)
    endpoint(address.place)
    options = options_of(SourceOptions, address.options, "imc")
    options.waypoints(), options.place(), point_of(options.start, "start", where="imc", yaw=True)


def _read_motive(path: Path) -> None:
    from ullage.ports.tracks import read_tracks

    read_tracks(path)


def _pulson(folder: Path) -> list[bytes]:
    """A log with the bare configuration, and with the whole messages."""
    from ullage.ports.radar_logs import CONFIG

    out = list(_recorded("pulson440", "rail_a", "radar.out")(folder))
    for kind, tail in ((0x1001, b""), (0x1102, bytes(8))):
        out += [struct.pack(">HH", kind, 1) + raw[: CONFIG.size] + tail + raw[CONFIG.size :] for raw in out[:1]]
    return out


def _p452(_: Path) -> list[bytes]:
    rows = [[0.02 * n, [n, -9, 1 << 20, 0, 5, 6, 7, 8]] for n in range(4)]
    return [json.dumps({"scan_start": 20014, "scan_end": 22454, "scans": rows}).encode()]


def _matlab(_: Path) -> list[bytes]:
    from scipy.io import savemat

    packed = io.BytesIO()
    samples, ranges = np.ones((3, 9), np.complex64), np.arange(9) / 20
    savemat(packed, {"samples": samples, "times_s": np.arange(3.0), "ranges_m": ranges, "positions_m": np.eye(3)})
    return [packed.getvalue()]


def _hdf5(folder: Path) -> list[bytes]:
    import h5py

    entry, about = "sessions/session_0/group_0/entry_0", {"base_step_length_m": 0.0025, "max_sweep_rate": 9.0}
    one = {"profile": "PROFILE_1", "hwaas": 8, "start_point": 8, "step_length": 4}
    pairs = np.ones((4, 2, 9), [("real", "<i2"), ("imag", "<i2")])
    session = {
        "server_info": json.dumps({"ticks_per_second": 1000}),
        "sessions/session_0/session_config": json.dumps({"groups": [{"1": {"subsweeps": [one]}}]}),
        f"{entry}/metadata": json.dumps(about | {"subsweep_data_offset": [0], "subsweep_data_length": [9]}),
        f"{entry}/result/frame": pairs, f"{entry}/result/tick": np.arange(4), f"{entry}/result/data_saturated": [0] * 4,
    }  # fmt: skip
    plain = {"samples": np.ones((3, 9), np.complex64), "times_s": np.arange(3.0), "ranges_m": np.arange(9) / 20}
    out = []
    for values in (session, plain):
        with h5py.File(folder / "seed.h5", "w") as file:
            for name, value in values.items():
                file[name] = value
        out.append((folder / "seed.h5").read_bytes())
    return out


def _track(made: str) -> Callable[[Path], Sequence[bytes]]:
    """The log of a short flight, as the tests of these readers write it."""

    def seeds(_: Path) -> Sequence[bytes]:
        sys.path.insert(0, str(Path(__file__).parents[1] / "ports"))
        import vehicle_logs

        n = np.arange(6)
        place = np.stack([n, 0 * n, 1 + n], axis=1) / 5
        made_of = ul.Trajectory(n * 100_000_000, place, np.tile([0.0, 0.0, 0.0, 1.0], (6, 1)))
        log = getattr(vehicle_logs, made)(made_of)
        return [log.encode() if isinstance(log, str) else log]

    return seeds


TRACK_TOPICS = ("/fix", "/tf", "/vio")


def _unit(_: Path) -> list[bytes]:
    """A log with a few readings of an inertial unit."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "ports"))
    import vehicle_logs

    n = np.arange(6)
    return [vehicle_logs.dataflash_of_imu(ul.Imu(n * 10_000_000, np.ones((6, 3)) * n[:, None], np.full((6, 3), 5.7)))]


def _tracks_in_a_bag(_: Path) -> list[bytes]:
    """Fixes, transforms and poses with a stamp, as messages in a row."""
    from ullage.ports import schema as ros

    turn = ros.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    kinds = ("sensor_msgs/msg/NavSatFix", ros.TRANSFORMS, ros.POSE)
    blob = b""
    for n in range(4):
        state = ros.make("sensor_msgs/msg/NavSatStatus", 0, 1)
        fix = ros.make(kinds[0], ros.header(n, "gps"), state, 63.4 + n * 1e-6, 10.4, 50.0, np.zeros(9), 0)
        move = ros.make("geometry_msgs/msg/Transform", ros.make("geometry_msgs/msg/Vector3", 0.1 * n, 1.0, 2.0), turn)
        one = ros.make("geometry_msgs/msg/TransformStamped", ros.header(n, "map"), "base_link", move)
        pose = ros.make("geometry_msgs/msg/Pose", ros.make("geometry_msgs/msg/Point", 0.1 * n, 1.0, 2.0), turn)
        made = (fix, ros.make(ros.TRANSFORMS, [one]), ros.make(ros.POSE, ros.header(n, "map"), pose))
        for kind, topic, message in zip(kinds, TRACK_TOPICS, made, strict=True):
            data, head = ros.to_bytes(kind, message), f"{kind} {topic}".encode()
            blob += struct.pack("<HI", len(head), len(data)) + head + data
    return [blob]


def _read_tracks(path: Path) -> None:
    """The track on each topic; the last refusal is passed on if there is none."""
    from ullage.ports.ros2.bags import read_track

    refused: list[ul.InputError] = []
    for topic in TRACK_TOPICS:
        try:
            read_track(path, topic=topic)
        except ul.InputError as error:
            assert_one_line(error)
            refused.append(error)
    if len(refused) == len(TRACK_TOPICS):
        raise refused[-1]


def _read_pulson(path: Path) -> None:
    from ullage.ports.radar_logs import read_log

    read_log(path)


def _reader(module: str, name: str) -> Callable[[Path], object]:
    """A reader of ullage.ports by its name."""
    reader: Callable[[Path], object] = getattr(importlib.import_module(f"ullage.ports.{module}"), name)
    return reader


def _there(library: str) -> bool:
    """Whether an optional library is installed; its readers are left out otherwise."""
    return importlib.util.find_spec(library) is not None


READERS = [
    Reader(
        "scenario",
        lambda _: [p.read_bytes() for p in sorted(FOLDER.glob("*.yaml"))],
        "s.yaml",
        lambda path: find_scenario(str(path)),
    ),
    Reader("options", _text(*OPTIONS), "o.txt", _read_options),
    Reader(
        "address",
        _text(
            "imc:tcp://127.0.0.1:6006?world=cargo-hold&mission=0,0,1;1,1,1&speed_m_s=0.5&origin=63,10&system_id=0x9001"
        ),
        "a.txt",
        _read_address,
    ),
    Reader("sdf", _text(SCENE, PART), "w.sdf", ul.load_scene, before=lambda f: (f / "part.sdf").write_text(PART)),
    Reader("urdf", _text(ROBOT), "r.urdf", ul.load_scene),
    *(
        Reader(f"mesh-{kind}", _meshes(kind), f"m.{kind}", ul.load_scene)
        for kind in ("stl", "obj", "ply", "glb", "dae")
    ),
    *(Reader(f"antenna-{kind}", _antenna(kind), f"a.{kind}", _read_antenna) for kind in ("csv", "ffs", "msi")),
    Reader("map-server", _map_files, "m.yaml", _read_map_server),
    Reader("octomap-bt", _maps(volume, "bt"), "m.bt", ports.read_map),
    Reader("octomap-ot", _maps(volume, "ot"), "m.ot", ports.read_map),
    Reader("map-ply", _maps(volume, "ply"), "m.ply", ports.read_map),
    Reader("mcap", _written(small_frames(), plane(), name="a.mcap"), "a.mcap", _all_of),
    Reader("mcap-messages", _messages, "a.mcap", _all_of, pack=mcap_of),
    Reader("bag", _bag, "a.bag", _all_of),
    Reader("db3", _db3, "a.db3", _all_of),
    Reader("zarr", _zarr, "store", _read_zarr),
    Reader("lsf", _written(small_frames(), name="a.lsf"), "a.lsf", _all_of),
    Reader("lsf-gz", _written(small_frames(), name="a.lsf"), "a.lsf.gz", _all_of, pack=lambda b: gzip.compress(b, 1)),
    Reader(
        "x4",
        lambda f: [
            *_recorded("x4", "xethru_baseband_iq_20170913_150437.dat")(f),
            *_recorded("x4", "xethru_datafloat_20190614_141837.dat")(f),
        ],
        "a.dat",
        _all_of,
    ),
    Reader("npz", _npz, "a.npz", _all_of, pack=_stored),
    Reader("pulson", _pulson, "radar.out", _read_pulson),
    Reader("p452", _p452, "scans.json", _all_of),
    Reader("matlab", _matlab, "a.mat", _all_of),
    *([Reader("hdf5", _hdf5, "a.h5", _all_of)] if _there("h5py") else []),
    *([Reader("ulog", _track("ulog"), "a.ulg", _reader("vehicle_logs", "read_ulog"))] if _there("pyulog") else []),
    *(
        [Reader("dataflash", _track("dataflash"), "a.bin", _reader("vehicle_logs", "read_dataflash"))]
        if _there("pymavlink")
        else []
    ),
    *([Reader("imu", _unit, "a.bin", _reader("vehicle_logs", "imu_of_dataflash"))] if _there("pymavlink") else []),
    *(Reader(kind, _track(kind), f"a.{kind}", _reader("vehicle_logs", f"read_{kind}")) for kind in ("nmea", "ubx")),
    Reader("tracks", _tracks_in_a_bag, "a.mcap", _read_tracks, pack=mcap_of),
    Reader("motive", _recorded("pulson440", "rail_a", "mocap.csv", most=12_000), "mocap.csv", _read_motive),
    Reader("peer-imc", lambda folder: peers.imc_seeds(folder, small_frames()), "a.bytes", peers.read_imc),
    Reader("peer-ros2", _messages, "a.bytes", peers.ros2_reader(unrolled)),
    *(
        Reader(f"peer-{name}", seeds, "a.bytes", read)
        for name, seeds, read, library in (
            ("mavlink", peers.mavlink_seeds, peers.read_mavlink, "pymavlink"),
            ("gazebo", peers.gazebo_seeds, peers.read_gazebo, "google.protobuf"),
            ("classic", peers.classic_seeds, peers.read_classic, "google.protobuf"),
        )
        if peers.there(library)
    ),
]

READER = {reader.name: reader for reader in READERS}


def read_one(reader: Reader, data: bytes, folder: Path) -> str:
    """Give one damaged input to a reader, which may refuse it in one line and nothing else; return that line."""
    path = folder / reader.file
    path.write_bytes(reader.pack(data))
    try:
        reader.read(path)
    except UllageError as error:
        assert_one_line(error)
        return str(error)
    return ""


TEXT_WORDS = r"999999999999999999999 -1 nan 1e999 null [ ] { } \x00 \xff ../.. &a *a !!int 0x"
BYTE_WORDS = r"\xff\xff\xff\xff \x00\x00\x00\x00 \xff\xff\xff\x7f \x00\x00\xc0\x7f \x00\x00\x80\x7f"


def dictionary(seed: bytes) -> str:
    """What the fuzzer puts in beside random bytes, in libFuzzer's format."""
    words = TEXT_WORDS if seed.isascii() else BYTE_WORDS
    return "".join(f'"{word}"\n' for word in words.split())
