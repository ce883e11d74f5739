"""What is said on one bus is said on another, field by field, through ROS messages in any order."""

from __future__ import annotations

import random
import time
from itertools import product

import pytest
from conftest import same_message
from hypothesis import given, settings
from hypothesis import strategies as st
from imc_peer import Peer
from test_imc_pairs import sensible

import ullage as ul
from ullage.ports.imc.codec import Message, Packet, encode, make
from ullage.ports.imc.interpreter import PAIRS
from ullage.ports.imc.relay import ABOUT, PACKET, Joiner, passed
from ullage.ports.plain import decoded, encoded
from ullage.ports.protocol import Passed, Passing

VEHICLE, OURS = 0x0803, 0x9001


def quiet(_: str) -> None:
    pass


def joined(items: list[Passed], joiner: Joiner | None = None) -> list:
    joiner = joiner or Joiner(OURS, quiet)
    return [told for item in items for told in joiner.take(item)]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(sorted(PAIRS)).flatmap(sensible), min_size=1, max_size=6), st.randoms())
def test_messages_come_back_whole_whatever_order_their_parts_take(messages: list[Message], rng: random.Random) -> None:
    packets = [Packet(m, 1.7e9 + 0.25 * k, VEHICLE, 7 + k) for k, m in enumerate(messages)]
    items = [item for packet in packets for item in passed(packet, 5)]
    rng.shuffle(items)
    told = sorted(joined(items), key=lambda one: one.t_s)
    assert [(one.t_s, one.part) for one in told] == [(p.t_s, f"{VEHICLE:#06x}/{p.src_ent}") for p in packets]
    for one, packet in zip(told, packets, strict=True):
        same_message(packet.message, one.message)


def test_a_message_goes_out_only_once_all_its_parts_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    items = list(passed(Packet(make("DesiredVelocity", u=0.5, flags=1), 1.7e9, VEHICLE, 7), 5))
    assert [item.topic for item in items] == ["imc/desired/velocity", "imc/desired/velocity/flags", PACKET]
    said: list[str] = []
    joiner = Joiner(OURS, said.append)
    assert joined([items[2], items[0]], joiner) == []
    assert len(joined([items[1]], joiner)) == 1
    assert joined([items[1]], joiner) == []
    lost = list(passed(Packet(make("DesiredHeading", value=1.0), 1.7e9, VEHICLE, 7), 5))[1]
    assert joined([lost], joiner) == []
    later = time.monotonic() + 60
    monkeypatch.setattr(time, "monotonic", lambda: later)
    assert joined([items[1]], joiner) == []
    assert said == ["parts of a DesiredHeading of 0x0803/7 did not come; it is left out"]


def test_what_we_said_ourselves_is_not_said_again() -> None:
    assert joined(list(passed(Packet(make("DesiredZ", value=2.0), 1.7e9, OURS, 7), 5))) == []


def test_wishes_of_ros_nodes_are_sent_as_they_come() -> None:
    float32, twist = "std_msgs/msg/Float32", "geometry_msgs/msg/Twist"
    joiner = Joiner(OURS, quiet)
    [height] = joined([Passed(0, "desired/height", float32, encoded(float32, {"data": 4.0}))], joiner)
    assert (height.message.name, height.message["value"], height.message["z_units"]) == ("DesiredZ", 4.0, 3)
    assert height.t_s is None
    ahead = Passed(0, "desired/velocity", twist, encoded(twist, {"linear": {"x": 0.5, "y": 0.2, "z": 0.0}}))
    [every] = joined([ahead], joiner)
    assert (every.message["u"], every.message["v"], every.message["flags"]) == (0.5, -0.2, 0x3F)
    flags = Passed(0, "desired/velocity/flags", "std_msgs/msg/UInt8", encoded("std_msgs/msg/UInt8", {"data": 1}))
    [one] = joined([flags, ahead], joiner)
    assert one.message["flags"] == 1


@pytest.mark.parametrize(
    ("topic", "kind", "data", "words"),
    [
        ("desired/height", "std_msgs/msg/Float64", b"\0\1\0\0" + bytes(8), "carries std_msgs/msg/Float64"),
        ("desired/height", "std_msgs/msg/Float32", b"\0\1", "2 bytes are no std_msgs/msg/Float32"),
        (PACKET, ABOUT, encoded(ABOUT, {"name": "Nonsense"}), "no pair for 'Nonsense'"),
        (PACKET, ABOUT, encoded(ABOUT, {"name": "DesiredZ"}), "cannot be sent: 'src'"),
    ],
)
def test_what_cannot_be_used_is_said_once(topic: str, kind: str, data: bytes, words: str) -> None:
    said: list[str] = []
    joiner = Joiner(OURS, said.append)
    assert joined([Passed(0, topic, kind, data)] * 2, joiner) == []
    assert len(said) == 1
    assert words in said[0]
    assert joined([Passed(0, "map", "nav_msgs/msg/OccupancyGrid", b"")], joiner) == []


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from([i for n in PAIRS for i in passed(Packet(make(n), 1.7e9, VEHICLE, 7), 5)]), st.binary(max_size=64)
)
def test_bytes_of_a_stranger_do_no_harm(item: Passed, data: bytes) -> None:
    joiner = Joiner(OURS, quiet)
    assert joined([Passed(0, item.topic, item.kind, data)], joiner) == []
    assert joined([item], joiner) == [] or item.topic == PACKET  # the joiner still works


@pytest.mark.parametrize("kind", sorted({i.kind for n in PAIRS for i in passed(Packet(make(n), 1.7e9, VEHICLE, 7), 5)}))
def test_plain_fields_are_all_the_message(kind: str) -> None:
    once = decoded(kind, encoded(kind, {}, t_ns=5, frame_id="imc"))
    assert decoded(kind, encoded(kind, once)) == once
    with pytest.raises(ul.InputError, match="no field 'colour'"):
        encoded(kind, {"colour": 1})


def test_nothing_is_made_until_somebody_takes_it() -> None:
    made: list[int] = []
    item = Passed(0, "imc/packet", ABOUT, b"")
    passing = Passing()
    passing.give(lambda: [made.append(1) or item])
    assert made == []
    got: list[Passed] = []
    passing.to(got.append)
    passing.give(lambda: [item])
    assert (got, made) == ([item, item], [1])


def relayed(heard: list[Packet]) -> list[Packet]:
    """What was passed on, without what the entity says of itself every second."""
    there = [p for p in list(heard) if p.name in PAIRS and p.src_ent == 100]
    return [p for p in there if not (p.name == "EntityState" and p["description"] == "active")]


@pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
def test_every_pair_goes_from_one_bus_to_another_over_sockets() -> None:
    """`tests/ports/ros2` has real topics between them."""
    messages = [make(name) for name in PAIRS] + [
        make("DesiredZ", value=k, z_units=u) for k, u in product((1, 2), (2, 3))
    ]
    sent = [Packet(m, 1.7e9 + 0.01 * k, VEHICLE, 7) for k, m in enumerate(messages)]
    pieces = [b"".join(map(encode, sent))]
    items: list[Passed] = []

    def take(item: Passed) -> None:
        items.append(item)
        if sum(i.topic == PACKET for i in items) == len(sent):
            raise KeyboardInterrupt

    peer = Peer(tick=lambda _: pieces.pop() if pieces else b"")
    with peer, ul.open(f"imc:{peer.place}?reconnect=false") as source:
        source.passing.to(take)
        with pytest.raises(KeyboardInterrupt):
            next(source.stream())
    with Peer() as peer, ul.sink(f"imc:{peer.place}") as sink:
        for item in items:
            sink.write(item)
        end = time.monotonic() + 60
        while len(told := relayed(peer.heard)) < len(sent) and time.monotonic() < end:
            time.sleep(0.02)
    assert [p.t_s for p in told] == [p.t_s for p in sent]
    for one, other in zip(sent, told, strict=True):
        same_message(one.message, other.message)
