"""What goes wrong on a network: peers that die, stall, shout nonsense, speak another version or use our number."""

from __future__ import annotations

import contextlib
import math
import os
import random
import socket
import struct
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest
from imc_bus import HEIGHT, LAT, LON, VEHICLE, announce, estimated_state, heartbeat, packed, text
from imc_peer import Peer
from waiting import until

import ullage as ul
from ullage.ports.imc.assemble import MOST_PARTS, FrameAssembler, Track
from ullage.ports.imc.codec import Packet, Parser, encode, make
from ullage.ports.imc.link import INBOX, Link, open_link
from ullage.ports.imc.options import LinkOptions
from ullage.ports.imc.table import own
from ullage.ports.imc.wires import MOST_PEERS, OUTBOX_BYTES, Identity, UdpWire
from ullage.ports.intake import Counters, Inbox


@contextmanager
def linked(place: str, me: Identity, **options: float | bool) -> Iterator[tuple[Link, list[str]]]:
    """A link of its own, and what it says."""
    told: list[str] = []
    link = open_link(place, LinkOptions(port=0, **options), me, role="vehicle", log=told.append)
    try:
        yield link, told
    finally:
        link.close()


def tcp(place: str, **options: float | bool) -> AbstractContextManager[tuple[Link, list[str]]]:
    return linked(place, Identity(0x9001, "ullage"), **options)


def udp(number: int, name: str, place: str = "", **options: float) -> AbstractContextManager[tuple[Link, list[str]]]:
    return linked(place, Identity(number, name), **options)


def names(link: Link, wanted: str) -> bool:
    return bool(until(lambda: any(packet.name == wanted for packet in link.arriving(0.1))))


def test_a_server_that_comes_late_is_waited_for() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with tcp(f"tcp://127.0.0.1:{port}") as (link, told):
        assert until(lambda: told)
        assert told == [f"waiting for tcp://127.0.0.1:{port} (Connection refused)"]
        with socket.create_server(("127.0.0.1", port)) as server:
            client, _ = server.accept()
            client.sendall(heartbeat(time.time()))
            assert names(link, "Heartbeat")
            client.close()


def test_a_peer_that_dies_is_waited_for_and_greeted_again() -> None:
    with Peer() as peer, tcp(peer.place) as (link, told):
        assert names(link, "Heartbeat")
        peer.drop()
        assert until(lambda: peer.clients == 2)
        assert names(link, "Announce")
        assert "the peer has gone; waiting for it to come back" in told
        assert until(lambda: sum(packet.name == "Announce" for packet in peer.heard) >= 2)


def test_without_reconnection_the_end_of_the_peer_is_the_end() -> None:
    with Peer() as peer, tcp(peer.place, reconnect=False) as (link, _):
        assert names(link, "Heartbeat")
        peer.drop()
        assert until(lambda: link.finished)


def test_a_half_open_connection_is_given_up() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    with server, tcp(f"tcp://127.0.0.1:{server.getsockname()[1]}", silence_s=0.5) as (_, told):
        first, _ = server.accept()
        server.settimeout(60)
        second, _ = server.accept()  # it came back without the first having been closed
        assert any("said nothing for 0.5 s" in line for line in told)
        first.close()
        second.close()


def test_a_slow_reader_costs_messages_not_memory() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with tcp(f"tcp://127.0.0.1:{server.getsockname()[1]}") as (link, told):
            client, _ = server.accept()
            big = make("DevDataBinary", value=bytes(60_000))
            for _ in range(400):
                link.send(big)
            assert len(link.out) * 60_000 <= OUTBOX_BYTES
            assert link.out.lost > 100
            assert told == ["the peer reads too slowly; the oldest messages to it are dropped"]
            client.close()


def test_a_flood_costs_messages_not_memory() -> None:
    flood = heartbeat(1.7e9) * 3000
    with Peer(tick=lambda _: flood) as peer, tcp(peer.place) as (link, told):
        assert until(lambda: link.counters.dropped("lost", topic="Heartbeat") > 1000)
        assert len(link.events) <= INBOX
        assert until(lambda: told)
        assert told == ["messages come faster than they are used; the oldest are dropped"]


def test_random_bytes_are_passed_over_and_what_follows_is_read() -> None:
    noise = [random.Random(k).randbytes(20_000) for k in range(50)]
    with Peer(tick=lambda _: noise.pop() if noise else b"") as peer, tcp(peer.place) as (link, told):
        assert until(lambda: not noise)
        assert names(link, "Heartbeat")
        assert any("bytes that are no IMC" in line for line in told)


def test_another_version_is_named() -> None:
    def older(data: bytes) -> bytes:
        head = data[:-2].replace(b"\x54\xfe", b"\x53\xfe", 1)
        from imc_bus import checksum

        return head + checksum(head).to_bytes(2, "little")

    with Peer(tick=lambda now: older(heartbeat(now))) as peer, tcp(peer.place) as (_, told):
        assert until(lambda: any("speaks IMC 5.3; this port speaks 5.4" in line for line in told))


def test_somebody_with_our_number_is_named() -> None:
    twin = announce(1.7e9, src=0x9001, name=b"other")
    with Peer(tick=lambda _: twin) as peer, tcp(peer.place) as (_, told):
        assert until(lambda: told)
        assert told == ["'other' also uses the address 0x9001; give one of us another: system_id="]


def test_questions_are_answered() -> None:
    asked = iter([packed(5, b"\x01" + text(b""), t_s=1.7e9), packed(4, b"\x0a", t_s=1.7e9), packed(2, b"", t_s=1.7e9)])
    frames = ul.Frames(
        [[0j] * 8], ul.RadarSpec.preset("x4m05", bins=8).range_m, [1], ul.RadarSpec.preset("x4m05", bins=8)
    )
    with Peer(tick=lambda _: next(asked, b"")) as peer, ul.sink(f"imc:{peer.place}") as sink:
        sink.write(frames)
        assert until(lambda: any(p.name == "EntityState" and p.src_ent == 10 for p in peer.heard))
        assert until(lambda: any(p.name == "EntityList" and p["list"] == "ullage=1;radar=10" for p in peer.heard))
        assert until(lambda: sum(p.name == "EntityInfo" and p["id"] == 10 for p in peer.heard) >= 1)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_step_of_an_hour_begins_a_track_and_nothing_is_lost(step_s: float) -> None:
    began, sent = 1.7e9, [0]

    def tick(_: float) -> bytes:
        sent[0] += 1
        step = step_s if sent[0] > 25 else 0.0
        return estimated_state(began + step + sent[0] * 0.1, 0.1 * sent[0], 0.0, -1.5, 0.0)

    asked = "world=ntnu-room&fidelity=thesis&rig=single&rate_hz=5&duration_s=4"
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with Peer(tick=tick) as peer, ul.open(f"imc:{peer.place}?{asked}") as source:
            frames = source.frames()
            path = source.trajectory()
    told = [str(w.message) for w in said]
    direction = "ahead" if step_s > 0 else "back"
    assert sum(f"time jumped {direction} 3.6e+03 s" in line for line in told) == 1
    assert np.all(np.diff(frames.t_ns) > 0)
    assert 18 <= len(frames) <= 24  # of 4 s at 5 Hz, none of the hour
    north = frames.poses.position[:, 1]
    assert north.max() - north.min() > 3.0  # before and after the step, at 1 m/s
    assert np.all(np.diff(path.t_ns) > 0)
    assert path.position[0, 1] <= 0.2


def odd_state(**changed: float) -> bytes:
    fields = {"lat": LAT, "lon": LON, "height": HEIGHT} | changed
    return encode(Packet(make("EstimatedState", **fields), 1.7e9, VEHICLE, 7))


@pytest.mark.parametrize(
    ("damaged", "topic", "words"),
    [
        (odd_state(x=math.nan), "EstimatedState of 0x0803", "x is not finite"),
        (odd_state(lat=2.0), "EstimatedState of 0x0803", "latitude or longitude is out of range"),
        (odd_state(lon=-7.0), "EstimatedState of 0x0803", "latitude or longitude is out of range"),
        (odd_state(z=1e30), "EstimatedState of 0x0803", "more than 1000 km from its reference"),
        (odd_state()[:-1] + b"\0", "tcp://", "a packet is damaged or cut"),
        (odd_state()[:50], "tcp://", "a packet is damaged or cut"),
        (odd_state()[:4] + b"\xff\xff" + odd_state()[6:] + heartbeat(1.7e9) * 3000,  # as many bytes as it announces
         "tcp://", "a packet is damaged or cut"),
        (packed(350, b"abc", t_s=1.7e9), "EstimatedState", "its bytes do not fit its fields"),
    ],
)  # fmt: skip
def test_what_is_damaged_is_dropped_counted_and_reported(damaged: bytes, topic: str, words: str) -> None:
    sent = [0]

    def tick(_: float) -> bytes:
        sent[0] += 1
        good = estimated_state(1.7e9 + sent[0] * 0.1, 0.1 * sent[0], 0.0, -1.5, 0.0)
        return (damaged if sent[0] == 8 else b"") + good

    asked = "world=ntnu-room&fidelity=thesis&rig=single&rate_hz=5&duration_s=2"
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with Peer(tick=tick) as peer, ul.open(f"imc:{peer.place}?{asked}") as source:
            assert 8 <= len(source.frames()) <= 13
            assert source.counters.dropped("bad") == 1
    told = [str(w.message) for w in said]
    assert any(line.startswith(topic) and f"dropped 1 bad ({words})" in line for line in told), told


def test_two_peers_find_each_other_and_talk() -> None:
    with udp(0x9001, "one") as (one, _), udp(0x9002, "two") as (two, _):
        assert until(lambda: one.connected and two.connected)
        one.send(make("TextMessage", origin="one", text="hello"))
        assert until(lambda: any(p.name == "TextMessage" and p["text"] == "hello" for p in two.arriving(0.1)))
        two.send(make("Abort"))
        assert names(one, "Abort")


def test_peers_without_end_cost_no_memory_and_are_counted() -> None:
    counters = Counters()
    options = LinkOptions(port=0, silence_s=3600.0)
    wire = UdpWire(None, Identity(0x9001, "one"), options, own(), lambda _: None, counters)
    speaker = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    place = wire.services[0].removeprefix("imc+udp://").rstrip("/").split(":")
    found, count = 0, MOST_PEERS + 100

    def take() -> int:
        nonlocal found
        found += len(wire.exchange(Inbox(counters), 0.2))
        return found + counters.dropped()

    try:
        for k in range(count):
            services = f"imc+udp://127.0.0.1:{1024 + k}/;imc+udp://127.0.0.1:{'9' * 5000}/".encode()
            speaker.sendto(announce(1.7e9, src=100 + k, name=b"n" * 900, services=services), (place[0], int(place[1])))
            speaker.sendto(announce(1.7e9, src=100 + k)[:-3], (place[0], int(place[1])))
            until(lambda: take() >= 2 * (k + 1))  # noqa: B023
    finally:
        speaker.close()
        wire.close()
    assert found == MOST_PEERS
    assert counters.dropped("lost", topic="Announce") == 100
    assert counters.dropped("bad", topic="udp://127.0.0.1") == count


def test_radars_and_labels_without_end_are_bounded() -> None:
    track = Track()
    gather = FrameAssembler(track)
    profile = make("SonarData", type=1, max_range=9, bits_per_point=8, scale_factor=1.0, data=bytes(16))
    many = ";".join(f"\x1b[31m{k}={'9' * 500}" for k in range(300))  # more than are read of one message
    count = 3 * MOST_PARTS
    for k in range(count):
        gather.take(Packet(profile, 1.7e9, k, 1))
        gather.take(Packet(make("EntityInfo", id=k % 256, label="x" * 5000), 1.7e9, k, 1))
        gather.take(Packet(make("EntityList", list=f"a={k % 256};{many}"), 1.7e9, k, 1))
        track.take(Packet(make("Announce", sys_name=f"{k}"), 1.7e9, k, 1))
    labels = [gather.label((k, part)) for k in range(count) for part in range(256)]
    learned = [label for label in labels if not label.startswith("entity")]
    assert 0 < len(learned) <= MOST_PARTS
    assert max(map(len, learned)) <= 64
    assert track.counters.dropped("bad") == count - MOST_PARTS


def test_a_peer_that_falls_silent_is_forgotten() -> None:
    with udp(0x9001, "one", silence_s=2.5) as (one, told):
        with udp(0x9002, "two") as (two, _):
            assert until(lambda: one.connected and two.connected)
        assert until(lambda: not one.connected)
        assert told[0] == "'two' has said nothing for 2.5 s"


def test_two_peers_with_one_number_are_told_apart() -> None:
    with udp(0x9001, "one") as (one, told), udp(0x9002, "two") as (two, _):
        assert until(lambda: one.connected and two.connected)
        with udp(0x9002, "three"):
            assert until(lambda: any("'two' and 'three' both use the address 0x9002" in line for line in told))
        two.send(make("Abort"))
        assert names(one, "Abort")


def test_who_has_not_announced_itself_is_not_listened_to_and_noise_does_no_harm() -> None:
    with udp(0x9001, "one") as (one, _), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        port = int(one.wire.services[0].rsplit(":", 1)[1].strip("/"))
        rng = random.Random(3)
        for _ in range(100):
            stranger.sendto(rng.randbytes(500), ("127.0.0.1", port))
        stranger.sendto(estimated_state(1.7e9, 0, 0, 0, 0), ("127.0.0.1", port))
        time.sleep(0.3)
        assert list(one.arriving(0.1)) == []
        services = f"imc+udp://127.0.0.1:{stranger.getsockname()[1]}/".encode()
        stranger.sendto(announce(1.7e9, services=services), ("127.0.0.1", port))
        stranger.sendto(estimated_state(1.7e9, 0, 0, 0, 0), ("127.0.0.1", port))
        assert names(one, "EstimatedState")


def test_a_place_named_beforehand_needs_no_announcement() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        there.settimeout(60)
        with udp(0x9001, "one", place="udp://{}:{}".format(*there.getsockname())) as (one, _):
            data, back = there.recvfrom(65535)
            assert [p.name for p in Parser().feed(data)] == ["Announce"]
            there.sendto(heartbeat(1.7e9), back)
            assert names(one, "Heartbeat")


def bound_udp() -> set[str]:
    """Addresses that this process receives datagrams at."""
    mine = set()
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            mine.add(os.readlink(entry))
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    held = [row[1].split(":")[0] for row in rows if f"socket:[{row[9]}]" in mine]
    return {socket.inet_ntoa(struct.pack("=I", int(address, 16))) for address in held}


@pytest.mark.skipif(sys.platform != "linux", reason="Linux lists a process' sockets in /proc")
def test_nothing_leaves_this_machine_by_itself() -> None:
    before = bound_udp()
    with udp(0x9001, "one"):
        bound = bound_udp() - before
        assert bound
        assert bound <= {"127.0.0.1", "224.0.75.69"}
    assert threading.active_count() < 50
