"""What is said on one bus is said on another, field by field, through ROS messages in any order."""

from __future__ import annotations

import random
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imc_peer import Peer
from test_imc_codec import PACKETS
from test_imc_pairs import sensible
from waiting import until

import ullage as ul
from conftest import same_message
from ullage.ports.imc.broker import LOCAL, Outgoing, RosToImc, passed, register, to_raw, to_ros
from ullage.ports.imc.codec import Message, Packet, encode, make
from ullage.ports.imc.interpreter import PAIRS
from ullage.ports.imc.table import own
from ullage.ports.protocol import Passed, Passing
from ullage.ports.schema import RAW, decoded, encoded

VEHICLE, OURS = 0x0803, 0x9001
PACKET = "imc/packet"


def quiet(_: str) -> None:
    pass


def sent_by(items: list[Passed], relay: RosToImc | None = None) -> list[Outgoing]:
    relay = relay or RosToImc(OURS, quiet)
    return [one for item in items for one in relay.take(item)]


def carried(names: set[str]) -> list[str]:
    return sorted(name for name in names if name not in LOCAL)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(carried(set(PAIRS))).flatmap(sensible), min_size=1, max_size=6), st.randoms())
def test_messages_come_back_whole_whatever_order_their_parts_take(messages: list[Message], rng: random.Random) -> None:
    packets = [Packet(m, 1.7e9 + 0.25 * k, VEHICLE, 7 + k) for k, m in enumerate(messages)]
    items = [item for packet in packets for item in passed(packet, 5)]
    rng.shuffle(items)
    got = sorted(sent_by(items), key=lambda one: one.t_s)
    assert [(one.t_s, one.part) for one in got] == [(p.t_s, f"{VEHICLE:#06x}/{p.src_ent}") for p in packets]
    assert [encode(Packet(one.message)) for one in got] == [encode(Packet(p.message)) for p in packets]


@settings(max_examples=100, deadline=None)
@given(PACKETS)
def test_any_packet_passes_whole_with_its_time_and_where_it_goes(packet: Packet) -> None:
    got = sent_by(list(passed(packet, 5)))
    if packet.src == OURS or packet.name in LOCAL:
        assert got == []
        return
    [one] = got
    assert encode(Packet(one.message)) == encode(Packet(packet.message))
    assert (one.t_s or 0.0, one.dst, one.dst_ent) == (packet.t_s, packet.dst, packet.dst_ent)


def test_a_message_goes_out_in_ros_words_by_name_and_whole() -> None:
    packet = Packet(make("DesiredVelocity", u=0.5, flags=1), 1.7e9, VEHICLE, 7)
    items = list(passed(packet, 5, typed=True))
    assert [item.topic for item in items] == [
        "imc/desired/velocity", "imc/desired/velocity/flags", "imc/typed/DesiredVelocity", PACKET,
    ]  # fmt: skip
    typed = decoded("imc_msgs/msg/DesiredVelocity", items[2].data)
    assert (typed["u"], typed["flags"], typed["src"], typed["header"]["stamp"]["sec"]) == (
        0.5,
        1,
        VEHICLE,
        1_700_000_000,
    )
    assert decoded(RAW, items[3].data)["data"] == encode(packet)
    assert len(sent_by(items)) == 1
    without = list(passed(Packet(make("Goto", lat=1.0), 1.7e9, VEHICLE, 7), 5))
    assert [item.topic for item in without] == [PACKET]


def test_frames_of_ullage_go_as_frames_only() -> None:
    for name in ("RadarFrame", "RadarSettings"):
        value = f"ullage_msgs/msg/{name}".encode() + b"\0\1\2"
        assert list(passed(Packet(make("DevDataBinary", value=value), 1.7e9, VEHICLE, 7), 5)) == []
    other = list(passed(Packet(make("DevDataBinary", value=b"\1\2"), 1.7e9, VEHICLE, 7), 5))
    assert [item.topic for item in other] == ["imc/device/data", PACKET]


def test_what_we_said_ourselves_is_not_said_again() -> None:
    assert sent_by(list(passed(Packet(make("DesiredZ", value=2.0), 1.7e9, OURS, 7), 5))) == []


@pytest.mark.parametrize("name", sorted(LOCAL))
def test_what_each_system_says_for_itself_is_shown_and_not_repeated(name: str) -> None:
    items = list(passed(Packet(make(name), 1.7e9, VEHICLE, 7), 5))
    assert items[-1].topic == PACKET
    assert sent_by(items) == []


def test_wishes_of_ros_nodes_are_sent_as_they_come() -> None:
    float32, twist = "std_msgs/msg/Float32", "geometry_msgs/msg/Twist"
    relay = RosToImc(OURS, quiet)
    [height] = sent_by([Passed(0, "desired/height", float32, encoded(float32, {"data": 4.0}))], relay)
    assert (height.message.name, height.message["value"], height.message["z_units"]) == ("DesiredZ", 4.0, 3)
    assert height.t_s is None
    ahead = Passed(0, "desired/velocity", twist, encoded(twist, {"linear": {"x": 0.5, "y": 0.2, "z": 0.0}}))
    [every] = sent_by([ahead], relay)
    assert (every.message["u"], every.message["v"], every.message["flags"]) == (0.5, -0.2, 0x3F)
    flags = Passed(0, "desired/velocity/flags", "std_msgs/msg/UInt8", encoded("std_msgs/msg/UInt8", {"data": 1}))
    for given_ in ([flags, ahead], [ahead]):
        [one] = sent_by(given_, relay)
        assert one.message["flags"] == 1


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(sorted(name for name in PAIRS if PAIRS[name].both)).flatmap(sensible))
def test_ros_nodes_can_send_all_that_the_table_has_in_both_directions(message: Message) -> None:
    items = [item for item in passed(Packet(message, 1.7e9, VEHICLE, 7), 5) if item.topic != PACKET]
    items = [Passed(0, f"to_{item.topic}", item.kind, item.data) for item in reversed(items)]  # the main topic last
    got = sent_by(items)
    assert [one.message.name for one in got] == ([message.name] if items else [])


@pytest.mark.parametrize("name", ["Goto", "PlanControl", "GpsFix", "Abort", "SystemGroup"])
def test_ros_nodes_can_send_any_message_whole_or_by_name(name: str) -> None:
    packet = Packet(make(name), 1.7e9, 0x2001, 3, VEHICLE, 4)
    whole = Passed(0, "to_imc/packet", RAW, encoded(RAW, to_raw(packet)))
    kind = register(name)
    typed = Passed(0, f"to_imc/any/{name}", kind, encoded(kind, to_ros(packet)))
    assert sent_by([whole, typed]) == [Outgoing(packet.message, 1.7e9, "", VEHICLE, 4)] * 2


def test_an_optional_part_is_of_one_message_only() -> None:
    """A measured range that came once does not stand for the ranges after it."""
    relay = RosToImc(OURS, quiet)
    items = list(passed(Packet(make("Distance", value=3.0, validity=1), 1.7e9, VEHICLE, 7), 5))[:-1]
    items = [Passed(0, f"to_{item.topic}", item.kind, item.data) for item in items]
    first = [item for item in items if item.topic != "to_imc/range"] + items[:1]
    [one] = sent_by(first, relay)
    assert one.message["value"] == 3.0
    kind = "sensor_msgs/msg/Range"
    [two] = sent_by([Passed(0, "to_imc/range", kind, encoded(kind, {"range": 1.5}))], relay)
    assert (two.message["value"], two.message["validity"]) == (1.5, 1)


@pytest.mark.parametrize(
    ("topic", "kind", "data", "words"),
    [
        ("desired/height", "std_msgs/msg/Float64", b"\0\1\0\0" + bytes(8), "carries std_msgs/msg/Float64"),
        ("desired/height", "std_msgs/msg/Float32", b"\0\1", "2 bytes are no std_msgs/msg/Float32"),
        ("desired/colour", "std_msgs/msg/Float32", b"", "no IMC message has the topic 'desired/colour'"),
        ("to_imc/odom", "nav_msgs/msg/Odometry", encoded("nav_msgs/msg/Odometry", {}), "also needs origin"),
        ("to_imc/system", "sensor_msgs/msg/NavSatFix", encoded("sensor_msgs/msg/NavSatFix", {}), "to ROS only"),
        ("to_imc/any", "imc_msgs/msg/Nonsense", b"", "no IMC message 'Nonsense'"),
        (PACKET, "std_msgs/msg/String", b"", "carries std_msgs/msg/String"),
        (PACKET, RAW, encoded(RAW, {"data": b"nonsense"}), "cut"),
    ],
)
def test_what_cannot_be_used_is_said_once(topic: str, kind: str, data: bytes, words: str) -> None:
    said: list[str] = []
    relay = RosToImc(OURS, said.append)
    assert sent_by([Passed(0, topic, kind, data)] * 2, relay) == []
    assert len(said) == 1
    assert words in said[0]
    assert sent_by([Passed(0, "map", "nav_msgs/msg/OccupancyGrid", b"")], relay) == []


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from([i for n in PAIRS for i in passed(Packet(make(n), 1.7e9, VEHICLE, 7), 5)]), st.binary(max_size=64),
    st.sampled_from(["", "to_"]),
)  # fmt: skip
def test_bytes_of_a_stranger_do_no_harm(item: Passed, data: bytes, before: str) -> None:
    relay = RosToImc(OURS, quiet)
    for one in sent_by([Passed(0, before + item.topic, item.kind, data)], relay):
        encode(Packet(one.message))  # bytes that happen to be a message are one
    assert sent_by([item], relay) == sent_by([item], RosToImc(OURS, quiet))  # as a relay that met no such bytes


def test_numbers_of_a_stranger_that_ros_cannot_hold_leave_the_packet() -> None:
    nan = float("nan")
    for message in (make("LogBookEntry", htime=nan), make("LogBookEntry", htime=1e300), make("GpsFix", sog=nan)):
        items = list(passed(Packet(message, nan, VEHICLE, 7), 5, typed=True))
        assert items[-1].topic == PACKET
        assert decoded(RAW, items[-1].data)["name"] == message.name


@pytest.mark.parametrize("kind", sorted({i.kind for n in PAIRS for i in passed(Packet(make(n), 1.7e9, VEHICLE, 7), 5)}))
def test_plain_fields_are_all_the_message(kind: str) -> None:
    once = decoded(kind, encoded(kind, {}, t_ns=5, frame_id="imc"))
    assert decoded(kind, encoded(kind, once)) == once
    with pytest.raises(ul.InputError, match="no field 'colour'"):
        encoded(kind, {"colour": 1})


def test_nothing_is_made_until_somebody_takes_it() -> None:
    made: list[int] = []
    item = Passed(0, "imc/packet", RAW, b"")
    passing = Passing()
    passing.give(lambda: [made.append(1) or item])
    assert made == []
    got: list[Passed] = []
    passing.to(got.append)
    passing.give(lambda: [item])
    assert (got, made) == ([item, item], [1])


def relayed(heard: list[Packet]) -> list[Packet]:
    """What was passed on, without what the entity says of itself every second."""
    parts = {p["label"]: p["id"] for p in list(heard) if p.name == "EntityInfo"}
    there = [p for p in list(heard) if p.src_ent == parts.get(f"{VEHICLE:#06x}/9") and p.name != "EntityInfo"]
    return [p for p in there if not (p.name == "EntityState" and p["description"] == "active")]


@pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
def test_every_message_goes_from_one_bus_to_another_over_sockets() -> None:
    """`tests/ports/ros2` has real topics between them."""
    messages = [make(name) for name in carried(set(own().by_name))] + [
        make("DesiredZ", value=k, z_units=u) for k, u in product((1, 2), (2, 3))
    ]
    sent = [Packet(m, 1.7e9 + 0.01 * k, VEHICLE, 9) for k, m in enumerate(messages)]
    pieces = [b"".join(map(encode, sent))]
    items: list[Passed] = []

    def take(item: Passed) -> None:
        items.append(item)
        if sum(decoded(RAW, i.data)["src_ent"] == 9 for i in items if i.topic == PACKET) == len(sent):
            raise KeyboardInterrupt

    peer = Peer(tick=lambda _: pieces.pop() if pieces else b"")
    with peer, ul.open(f"imc:{peer.place}?reconnect=false") as source:
        source.passing.to(take)
        with pytest.raises(KeyboardInterrupt):
            next(source.stream())
    with Peer() as peer, ul.sink(f"imc:{peer.place}") as sink:
        for item in items:
            sink.write(item)
        until(lambda: len(relayed(peer.heard)) >= len(sent))
        got = relayed(peer.heard)
    assert [p.t_s for p in got] == [p.t_s for p in sent]
    for one, other in zip(sent, got, strict=True):
        same_message(one.message, other.message)
