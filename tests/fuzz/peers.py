"""What live peers send, for the fuzzer: bytes go the way of the network, without sockets, as far as poses and frames.

A damaged message must be counted and left out: nothing may raise. Input of which nothing could be used is refused.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import ullage as ul
from ullage.ports import schema as ros
from ullage.ports.imc import codec
from ullage.ports.imc.assemble import FrameAssembler, Track
from ullage.ports.intake import Counters
from ullage.ports.ros2.incoming import Incoming
from ullage.ports.ros2.options import SourceOptions

RECORD = struct.Struct("<HH")
MAVLINK_HEAD = struct.Struct("<BBBBBBB3s")


def records(*rows: tuple[int, bytes]) -> bytes:
    """Messages in a row: number, length, bytes."""
    return b"".join(RECORD.pack(number, len(data)) + data for number, data in rows)


def recorded(blob: bytes) -> Iterator[tuple[int, bytes]]:
    """The messages of such a row; the last may be cut."""
    at = 0
    while at + RECORD.size <= len(blob):
        number, size = RECORD.unpack_from(blob, at)
        at += RECORD.size
        yield number, blob[at : at + size]
        at += size


def used(count: int) -> None:
    """Refuse input of which nothing could be used."""
    if not count:
        raise ul.InputError("nothing of it can be used", where="peer")


def quiet(text: str) -> None:
    """Take a line for the user."""
    assert text.isprintable()


def imc_seeds(folder: Path, frames: ul.Frames) -> Sequence[bytes]:
    """The messages of a log of DUNE's, as numbers and payloads."""
    with ul.sink(folder / "a.lsf") as sink:
        sink.write(frames)
    packets = codec.Parser().feed((folder / "a.lsf").read_bytes())
    state = codec.make("EstimatedState", lat=1.1, lon=0.2, x=1.0, psi=0.5)
    made = [packet for packet in packets if packet.name not in ("EntityInfo",)][:12]
    made.append(codec.Packet(state, 5.0, 1, 1, 0xFFFF, 0xFF))
    raw = [codec.encode(packet) for packet in made]
    return [records(*((struct.unpack_from("<H", one, 2)[0], one[codec.HEAD : -codec.TAIL]) for one in raw))]


def read_imc(path: Path) -> None:
    """The stream through the parser, then each payload as if its checksum were sound."""
    blob, table, count = path.read_bytes(), codec.own(), 0
    counters = Counters(quiet)
    track = Track(counters)
    frames = FrameAssembler(track, quiet)
    packets = [*codec.Parser().feed(blob)]
    packets += [
        codec.Packet(codec.body(number, data, False, table), 0.1 * k, 1, 2, 0xFFFF, 0xFF, number)
        for k, (number, data) in enumerate(recorded(blob))
    ]
    for packet in packets:
        count += len(track.take(packet)) + frames.take(packet)
    frames.give(final=True)
    used(count)


def mavlink_seeds(_: Path) -> Sequence[bytes]:
    """A heartbeat, poses of every kind and a clock, as numbers and payloads."""
    from ullage.ports.mavlink.wire import mavlink

    d = mavlink()
    rows = [
        d.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3),
        d.MAVLink_attitude_quaternion_message(1000, 1.0, 0, 0, 0, 0, 0, 0),
        d.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 0, 0, 0),
        d.MAVLink_attitude_message(1100, 0.1, 0.2, 0.3, 0, 0, 0),
        d.MAVLink_odometry_message(
            2_000_000, 1, 12, 1.0, 2.0, -3.0, [1.0, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0.0] * 21, [0.0] * 21
        ),
        d.MAVLink_timesync_message(5, 6),
    ]
    link = d.MAVLink(None)
    return [records(*((one.get_msgId(), bytes(one.pack(link))[10:-2]) for one in rows))]


def read_mavlink(path: Path) -> None:
    """Raw bytes into the decoder, then each payload in a packet with a sound checksum; poses of what comes out."""
    from pymavlink.generator.mavcrc import x25crc

    from ullage.ports.mavlink.source import PoseBuilder
    from ullage.ports.mavlink.wire import Decoder, mavlink

    blob, counters, d = path.read_bytes(), Counters(quiet), mavlink()
    decoder, poses = Decoder(counters, "peer"), PoseBuilder(counters, "auto", np.eye(4))
    messages = Decoder(counters, "raw").feed(blob)
    for number, data in recorded(blob):
        known = d.mavlink_map.get(number)
        head = MAVLINK_HEAD.pack(0xFD, len(data[:255]), 0, 0, 0, 1, 1, number.to_bytes(3, "little")) + data[:255]
        sum_ = x25crc(head[1:])
        if known is not None:
            sum_.accumulate(struct.pack("<B", known.crc_extra))
        messages += decoder.feed(head + struct.pack("<H", sum_.crc))
    kinds = ("ODOMETRY", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION", "ATTITUDE")
    used(sum(len(poses.take(one)) for one in messages if one.get_type() in kinds))


class Peer:
    """A peer of a simulator whose events are all there already."""

    def __init__(self, events: Sequence[Any]) -> None:
        self._events, self.counters, self.events = deque(events), Counters(quiet), SimpleNamespace(behind_s=0.0)

    def wait(self, timeout_s: float) -> Any:
        return self._events.popleft() if self._events else None

    def subscribe(self, *_: Any) -> None:
        pass

    advertise = publish = close = subscribe


def taken(feed: Any) -> int:
    """How much a feed makes of the events of its peer."""
    count = 0
    while feed.next(0.0) is not None:
        count += 1
    return count


GAZEBO_TOPICS = ("/world/w/pose/info", "/world/w/dynamic_pose/info", "/world/w/stats", "/world/w/scene/info",
                 "/model/m/link/l/sensor/front/scan")  # fmt: skip


def gazebo_seeds(_: Path) -> Sequence[bytes]:
    """Poses, statistics, a scene and a scan, and a datagram that offers them."""
    from ullage.ports.gazebo import messages, transport

    gz = messages.gz()
    head = gz.Header(stamp=gz.Time(sec=3))
    pose = gz.Pose(name="m", position=gz.Vector3d(x=1), orientation=gz.Quaternion(w=1))
    moved = gz.Pose_V(header=head, pose=[pose, gz.Pose(name="o", orientation=gz.Quaternion(w=1))])
    scan = gz.LaserScan(header=head, angle_step=1, range_min=0.1, range_max=9, count=2, vertical_count=1, ranges=[2, 3])
    rows = (moved, moved, gz.WorldStatistics(header=head, sim_time=gz.Time(sec=3)), gz.Scene(name="w"), scan)
    sent = [(k, one.SerializeToString()) for k, one in enumerate(rows)]
    pub = gz.Publisher(topic="@/p@/world/w/pose/info", address="tcp://127.0.0.1:1", scope=2)
    return [records(*sent, (9, transport.datagram(transport.ADVERTISE, "x", pub=pub)))]


def read_gazebo(path: Path) -> None:
    """Datagrams and messages of Gazebo Transport, with and without rays."""
    from ullage.ports.gazebo.peer import Received, TopicOffered
    from ullage.ports.gazebo.transport import read_datagram
    from ullage.ports.gazebo.transport_source import TransportFeed, TransportOptions

    blob, count = path.read_bytes(), 0
    read_datagram(blob)
    for rays in ("", "front"):
        events: list[Any] = [TopicOffered(topic, "gz.msgs.Pose_V", "x") for topic in GAZEBO_TOPICS]
        for number, data in recorded(blob):
            read_datagram(data)
            events.append(Received(GAZEBO_TOPICS[number % len(GAZEBO_TOPICS)], data))
        options = TransportOptions(model="m", world="hall", rays=rays)
        mounts = {"front": np.eye(4)} if rays else {}
        feed = TransportFeed(Peer(events), options, "w", mounts, frozenset({"o"}))
        count += taken(feed) - 1  # the notice of the offer
    used(count)


CLASSIC_TOPICS = ("pose/info", "world_stats", "response", "model/info", "request", "m/l/front/scan")


def classic_seeds(_: Path) -> Sequence[bytes]:
    """Framed messages of a gzserver; their first byte stands for the topic."""
    from ullage.ports.gazebo.classic import framed
    from ullage.ports.gazebo.messages import classic

    g = classic()
    pose = g.Pose(name="m", position=g.Vector3d(x=1, y=0, z=0), orientation=g.Quaternion(x=0, y=0, z=0, w=1))
    stamp = g.Time(sec=3, nsec=0)
    moved = g.PosesStamped(time=stamp, pose=[pose])
    sent = [(0, moved.SerializeToString()), (0, moved.SerializeToString()), (1, b""), (2, b""), (3, b""), (4, b"")]
    return [b"".join(framed(bytes([number]) + data) for number, data in sent)]


async def cut(blob: bytes) -> list[bytes]:
    """The messages of a gzserver's stream, as far as it goes."""
    from ullage.ports.gazebo.classic import messages

    reader, found = asyncio.StreamReader(), []
    reader.feed_data(blob)
    reader.feed_eof()
    with contextlib.suppress(asyncio.IncompleteReadError):
        async for one in messages(reader):
            found.append(one)  # noqa: PERF401 (what came before the end counts)
    return found


def read_classic(path: Path) -> None:
    """The stream cut into messages, and each on its topic."""
    from ullage.ports.gazebo.classic_source import ClassicFeed, ClassicOptions
    from ullage.ports.gazebo.peer import Connected, Received

    try:
        found = asyncio.run(cut(path.read_bytes()))
    except ValueError:  # the peer drops the connection
        raise ul.InputError("not framed", where="peer") from None
    root = "/gazebo/w/"
    events: list[Any] = [Connected(("w",))]
    events += [Received(root + CLASSIC_TOPICS[one[0] % len(CLASSIC_TOPICS)], one[1:]) for one in found if one]
    count = 0
    for rays in ("", "front"):
        options = ClassicOptions(model="m", world="hall", rays=rays)
        count += taken(ClassicFeed(Peer(events), options, frozenset({"o"}))) - 1  # the notice of the server
    used(count)


KINDS = (ros.FRAME, ros.SETTINGS, ros.CLOUD, ros.RANGE, ros.TRANSFORMS, ros.ODOMETRY)


def ros2_reader(unrolled: Callable[[bytes], Iterator[tuple[str, str, bytes]]]) -> Callable[[Path], None]:
    """CDR messages as a live port takes them."""

    def read(path: Path) -> None:
        count, incoming = 0, Incoming(SourceOptions(), quiet)
        for kind, topic, data in unrolled(path.read_bytes()):
            if kind in KINDS:
                incoming.take(topic, incoming.taker(topic, kind), data)
            count += sum(map(len, incoming.ready(64).values()))
        incoming.finish()
        used(count + len(incoming.sensors))

    return read


def there(*libraries: str) -> bool:
    """Whether optional libraries are installed; their peers are left out otherwise."""
    return all(importlib.util.find_spec(name) is not None for name in libraries)
