"""The codec against bytes packed by hand, against other people's codecs, and against garbage."""

from __future__ import annotations

import math
import random

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
        most = max(most, len(parser._held))
    assert most < 2 * 65557 + 4096
    found = list(parser.feed(STATE)) + list(parser.finish())
    assert [q.name for q in found] == ["EstimatedState"]


def test_syncs_without_end_cost_no_more_than_their_length() -> None:
    parser = Parser()
    for _ in range(16):
        assert list(parser.feed(b"\xfe\x54" * 8192)) == []
    assert len(parser._held) < 2 * 65557


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


@settings(max_examples=80, deadline=None)
@given(st.sampled_from(sorted(table.own().by_id)), st.binary(max_size=200), st.sampled_from("<>"))
def test_a_sound_packet_with_a_senseless_payload_is_kept_as_bytes(number: int, payload: bytes, order: str) -> None:
    got = decode(packed(number, payload, t_s=0, order=order))
    assert got.id == number
    if got.name == "":
        assert got["payload"] == payload
    else:
        assert len(encode(got)) == 22 + len(payload)


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
    assert len(table.own().by_id) == len(table.own().by_name) == len(table.MESSAGES.replace("\\\n", "").split("\n")) - 2
    assert all(
        field.kind in (*table.NUMBERS, *table.HELD) for kind in table.own().by_id.values() for field in kind.fields
    )
    named = {f.of for kind in table.own().by_id.values() for f in kind.fields if f.of}
    assert named <= table.own().by_name.keys()


def test_an_announce_in_big_endian_is_read() -> None:
    got = decode(announce(1.0, services=b"imc+udp://127.0.0.1:6002/", order=">"))
    assert got["sys_name"] == "test-copter"
    assert math.isclose(math.degrees(got["lat"]), 63.4185)


@settings(max_examples=100, deadline=None)
@given(packet=PACKETS)
def test_imcpy_understands_every_message_and_writes_the_same_bytes(packet: Packet) -> None:
    imcpy = pytest.importorskip("imcpy", reason="imcpy, which holds DUNE's own codec, is not installed")
    data = encode(packet)
    there = imcpy.Packet.deserialize(data)
    assert type(there).__name__ == packet.name
    assert bytes(there.serialize()) == data
