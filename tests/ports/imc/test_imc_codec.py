"""The codec against bytes packed by hand, against other people's codecs, and against garbage."""

from __future__ import annotations

import math
import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imc_bus import announce, checksum, estimated_state, heartbeat, packed

from ullage.errors import InputError
from ullage.ports.imc import table
from ullage.ports.imc.codec import Malformed, Message, Packet, Parser, crc, decode, encode, make

STATE = estimated_state(1.7e9, 1.0, 2.0, -3.0, 0.5)


def test_checksum_is_the_published_one() -> None:
    assert crc(b"123456789") == checksum(b"123456789") == 0xBB3D  # the check value of CRC-16/ARC


@pytest.mark.parametrize("order", "<>")
def test_reads_and_writes_the_bytes_of_a_packet_packed_by_hand(order: str) -> None:
    data = estimated_state(1.7e9 + 0.25, 1.0, 2.0, -3.0, 0.5, order=order)
    packet = decode(data)
    assert (packet.name, packet.t_s, packet.src, packet.src_ent) == ("EstimatedState", 1.7e9 + 0.25, 0x0803, 7)
    assert (packet["x"], packet["y"], packet["z"], packet["psi"]) == (1.0, 2.0, -3.0, 0.5)
    assert encode(packet, big=order == ">") == data


def values_of(field: table.Field, depth: int) -> st.SearchStrategy:
    kinds = table.own()
    if field.kind == "text":
        return st.text(max_size=20)
    if field.kind == "raw":
        return st.binary(max_size=40)
    if field.kind in ("message", "messages"):
        if depth > 2:
            return st.none() if field.kind == "message" else st.just(())
        names = [field.of] if field.of else ["Heartbeat", "DesiredZ", "EntityInfo", "PlanVariable"]
        one = st.sampled_from(names).flatmap(lambda name: messages_of(kinds.by_name[name], depth + 1))
        return st.one_of(st.none(), one) if field.kind == "message" else st.lists(one, max_size=3).map(tuple)
    if field.kind[0] == "f":
        return st.floats(width=int(field.kind[1:]), allow_nan=False)
    bits, signed = int(field.kind[1:]), field.kind[0] == "i"
    return st.integers(-(2 ** (bits - 1)) if signed else 0, 2 ** (bits - signed) - 1)


def messages_of(kind: table.Kind, depth: int = 0) -> st.SearchStrategy:
    parts = {field.name: values_of(field, depth) for field in kind.fields}
    return st.fixed_dictionaries(parts).map(lambda values: Message(kind.name, values))


PACKETS = st.builds(
    Packet,
    st.sampled_from(sorted(table.own().by_id)).flatmap(lambda number: messages_of(table.own().by_id[number])),
    t_s=st.floats(0, 4e9),
    src=st.integers(0, 65535),
    src_ent=st.integers(0, 255),
    dst=st.integers(0, 65535),
    dst_ent=st.integers(0, 255),
)


@settings(max_examples=80, deadline=None)
@given(PACKETS, st.booleans())
def test_every_message_survives_the_way_there_and_back(packet: Packet, big: bool) -> None:
    data = encode(packet, big=big)
    assert checksum(data[:-2]) == int.from_bytes(data[-2:], "big" if big else "little")
    got = decode(data)
    assert got.message == packet.message
    assert (got.t_s, got.src, got.src_ent, got.dst, got.dst_ent) == (
        packet.t_s, packet.src, packet.src_ent, packet.dst, packet.dst_ent,
    )  # fmt: skip


@settings(max_examples=100, deadline=None)
@given(st.lists(st.one_of(PACKETS, st.binary(max_size=60)), max_size=8), st.integers(1, 200), st.booleans())
def test_packets_are_found_between_garbage_however_the_bytes_are_cut(parts: list, size: int, big: bool) -> None:
    garbage = [p for p in parts if isinstance(p, bytes)]
    stream = b"".join(p if isinstance(p, bytes) else encode(p, big=big) for p in parts)
    parser = Parser()
    found = [q for k in range(0, len(stream), size) for q in parser.feed(stream[k : k + size])]
    found += parser.finish()
    assert [q.message for q in found] == [p.message for p in parts if isinstance(p, Packet)]
    assert parser.garbage == sum(map(len, garbage))


def test_a_million_random_bytes_neither_crash_nor_grow_nor_hide_what_follows() -> None:
    parser, noise = Parser(), random.Random(5).randbytes(1_000_000)
    most = 0
    for k in range(0, len(noise), 4096):
        assert list(parser.feed(noise[k : k + 4096])) == []
        most = max(most, parser.waiting_bytes)
    assert most < 2 * 65557 + 4096
    found = list(parser.feed(STATE)) + list(parser.finish())
    assert [q.name for q in found] == ["EstimatedState"]


def test_syncs_without_end_cost_no_more_than_their_length() -> None:
    parser = Parser()
    for _ in range(16):
        assert list(parser.feed(b"\xfe\x54" * 8192)) == []
    assert parser.waiting_bytes < 2 * 65557


@settings(max_examples=80, deadline=None)
@given(PACKETS, st.data())
def test_a_damaged_packet_is_refused_and_the_next_one_read(packet: Packet, data: st.DataObject) -> None:
    whole = bytearray(encode(packet))
    at = data.draw(st.integers(0, len(whole) - 1))
    whole[at] ^= data.draw(st.integers(1, 255))
    with pytest.raises(Malformed):
        decode(bytes(whole))
    parser = Parser()
    found = [*parser.feed(bytes(whole) + STATE), *parser.finish()]
    assert [q.name for q in found][-1] == "EstimatedState"


NEWER = frozenset({
    "Power", "MessagePartControl", "QueryTypedEntityParameters", "TypedEntityParameter", "ValuesIf", "BDI",
    "TypedEntityParameterEditor", "QueryBmsData", "BmsData", "BmsCellVoltage", "BmsRegister",
})  # fmt: skip
"""What came to IMC 5.4.31 after imcpy 1.1.2."""


class Draw:
    """Random messages; those within them are of the kinds named, and numbers are no larger than `most`."""

    def __init__(self, inner: list[str], seed: int, most: float) -> None:
        self.inner, self.rng, self.most = inner, random.Random(seed), most

    def message(self, kind: table.Kind, depth: int = 0) -> Message:
        return Message(kind.name, {field.name: random_value(field, self, depth) for field in kind.fields})


def random_value(field: table.Field, draw: Draw, depth: int) -> object:
    rng, kinds = draw.rng, table.own().by_name
    if field.kind in ("message", "messages"):
        chosen = [field.of] if field.of else rng.choices(draw.inner, k=2)
        some = tuple(draw.message(kinds[name], depth + 1) for name in chosen if depth < 2)
        return some if field.kind == "messages" else some[0] if some else None
    if field.kind in ("text", "raw"):
        text = "".join(chr(rng.randint(1, 0x2FF)) for _ in range(rng.randint(0, 12)))
        return text if field.kind == "text" else text.encode()
    if field.values is not None:
        return rng.choice(sorted(field.values.numbers.values()))
    if field.kind[0] == "f":
        number = rng.uniform(0 if draw.most == 1 else -draw.most, draw.most)
        return number if field.kind == "f64" else struct.unpack("<f", struct.pack("<f", number))[0]
    bits, signed = int(field.kind[1:]), field.kind[0] == "i"
    return 1 if draw.most == 1 else rng.randint(-(2 ** (bits - 1)) if signed else 0, 2 ** (bits - signed) - 1)


def one_of_each(names: list[str], *, seed: int = 54, most: float = 1e6) -> list[Packet]:
    """A packet of each of these kinds of messages, with random values."""
    draw = Draw(names, seed, most)
    some = [draw.message(table.own().by_name[name]) for name in names]
    return [Packet(message, 1.7e9, 0x0803, 7, 0x9001, 1) for message in some]


@pytest.mark.parametrize("big", [False, True])
def test_imcpy_reads_all_that_it_knows_of_the_349_messages_in_either_byte_order(big: bool) -> None:
    imcpy = pytest.importorskip("imcpy", reason="imcpy, which holds DUNE's own codec, is not installed")
    known = [name for name in table.own().by_name if hasattr(imcpy, name)]
    assert set(table.own().by_name) - set(known) <= NEWER
    for packet in one_of_each(known) + one_of_each(known, seed=55):
        data = encode(packet, big=big)
        assert decode(data).message == packet.message
        there = imcpy.Packet.deserialize(data)
        assert type(there).__name__ == packet.name
        assert bytes(there.serialize()) == encode(packet)  # imcpy writes little endian


UNKNOWN = st.integers(5000, 60000)


@settings(max_examples=60, deadline=None)
@given(UNKNOWN, st.binary(max_size=80), st.text("abc xyz", max_size=30), st.booleans())
def test_an_unknown_inner_message_never_hides_the_outer_one(number: int, raw: bytes, info: str, big: bool) -> None:
    order = "big" if big else "little"
    if raw.endswith(b"\0"):  # else the text behind it could begin earlier
        raw += b"\1"
    inner = number.to_bytes(2, order) + raw
    head = b"\1\0" + (7).to_bytes(2, order) + (4).to_bytes(2, order) + b"plan" + bytes(2)
    data = packed(559, head + inner + len(info).to_bytes(2, order) + info.encode(), t_s=1.0, order="<>"[big])
    got = decode(data)
    assert (got.name, got["type"], got["op"], got["request_id"], got["plan_id"]) == ("PlanControl", 1, 0, 7, "plan")
    assert got["info"] == info
    assert (got["arg"].name, got["arg"]["id"], got["arg"]["payload"]) == ("", number, raw)
    assert encode(got, big=big) == data


@pytest.mark.parametrize("big", [False, True])
def test_an_unknown_message_deep_within_others_keeps_all_that_is_around(big: bool) -> None:
    strange = Message("", {"id": 5001, "payload": b"\x07strange", "big": big})
    maneuver = make("PlanManeuver", maneuver_id="first", data=strange, end_actions=(make("Heartbeat"),))
    packet = Packet(make("PlanSpecification", plan_id="p", maneuvers=(maneuver, make("PlanManeuver"))), 1.0)
    data = encode(packet, big=big)
    assert decode(data).message == packet.message
    with pytest.raises(InputError, match="message 5001: its bytes are of the other byte order"):
        encode(packet, big=not big)


def test_two_unknown_messages_are_kept_together_and_cost_little() -> None:
    strange = Message("", {"id": 5001, "payload": bytes(range(1, 200)), "big": False})
    for filler in ((), (make("TextMessage", text="x" * 20_000),) * 3):
        data = encode(Packet(make("MsgList", msgs=(*filler, strange, strange, make("Heartbeat"))), 1.0))
        got = decode(data)
        assert got.name == "MsgList"
        assert got["msgs"][: len(filler)] == filler
        first = got["msgs"][len(filler)]
        assert first["id"] == 5001
        assert first["payload"].startswith(strange["payload"])


@settings(max_examples=80, deadline=None)
@given(st.sampled_from(sorted(table.own().by_id)), st.binary(max_size=200), st.sampled_from("<>"))
def test_a_sound_packet_with_a_senseless_payload_is_kept_as_bytes(number: int, payload: bytes, order: str) -> None:
    got = decode(packed(number, payload, t_s=0, order=order))
    assert got.id == number
    if got.name == "":
        assert got["payload"] == payload
    elif not named(got.message, ""):
        assert len(encode(got)) == 22 + len(payload)


def named(message: Message, name: str) -> bool:
    """Whether it, or a message within it, has this name."""
    inner = [one for value in message.values.values() for one in (value if isinstance(value, tuple) else (value,))]
    return message.name == name or any(named(one, name) for one in inner if isinstance(one, Message))


def test_messages_within_messages_without_end_are_refused() -> None:
    nested = b"\x14\x00\x01\x00" * 2000 + b"\x96\x00"
    assert decode(packed(20, b"\x01\x00" + nested, t_s=0)).name == ""


def test_a_message_we_do_not_know_is_passed_over_and_counted_as_no_garbage() -> None:
    parser = Parser()
    found = list(parser.feed(packed(914, b"abc", t_s=1.0) + heartbeat(2.0)))
    assert [q.name for q in found] == ["", "Heartbeat"]
    assert found[0].id == 914
    assert encode(found[0]) == packed(914, b"abc", t_s=1.0)
    assert parser.garbage == 0


def test_another_version_of_the_protocol_is_recognised() -> None:
    def older(data: bytes) -> bytes:
        head = data[:1].replace(b"\x54", b"\x53") + data[1:-2]
        return head + checksum(head).to_bytes(2, "little")

    parser = Parser()
    assert [q.name for q in parser.feed(older(STATE) * 3 + STATE)] == ["EstimatedState"]
    assert (parser.strange, parser.version) == (3, (5, 3))


def test_what_does_not_fit_a_field_is_said() -> None:
    with pytest.raises(InputError, match=r"no field 'hight'.*height"):
        make("EstimatedState", hight=1)
    with pytest.raises(InputError, match="DesiredZ: value, z_units"):
        encode(Packet(make("DesiredZ", z_units=300)))
    with pytest.raises(InputError, match="65536 bytes"):
        encode(Packet(make("DevDataBinary", value=bytes(65536))))
    with pytest.raises(InputError, match="no IMC message 'Nonsense'"):
        make("Nonsense")


def test_the_table_has_no_two_of_one_kind() -> None:
    assert len(table.own().by_id) == len(table.own().by_name) == 349
    assert all(
        field.kind in (*table.NUMBERS, *table.HELD) for kind in table.own().by_id.values() for field in kind.fields
    )
    named = {f.of for kind in table.own().by_id.values() for f in kind.fields if f.of}
    assert named <= table.own().by_name.keys()


def test_an_announce_in_big_endian_is_read() -> None:
    got = decode(announce(1.0, services=b"imc+udp://127.0.0.1:6002/", order=">"))
    assert got["sys_name"] == "test-copter"
    assert math.isclose(math.degrees(got["lat"]), 63.4185)
