"""The bytes of X4 modules: what is packed comes back, whatever lies around it and however it is cut."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ullage.ports.instruments import x4 as mcp

BODIES = st.binary(min_size=1, max_size=40)
FLOATS = st.lists(st.floats(-1, 1, width=32), min_size=1, max_size=60)


def test_bytes_of_a_published_exchange():
    """The answer of a module to a setting, and its message that it is ready, as published with their checksums."""
    assert mcp.pack(bytes([mcp.ACK])) == bytes.fromhex("7d106d7e")
    assert mcp.pack(bytes([0x30]) + struct.pack("<I", 0x10)) == bytes.fromhex("7d30100000005d7e")


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(BODIES, FLOATS), max_size=8), st.integers(1, 50))
def test_packets_come_back_in_pieces_of_any_size(sent, size):
    """A body in which four bytes 0x7C follow each other would be taken for the start of data, so none is sent."""
    sent = [one for one in sent if not (isinstance(one, bytes) and mcp.MARK in mcp.pack(one))]
    stream = b"".join(
        mcp.pack(one) if isinstance(one, bytes) else mcp.pack_data(np.array(one, np.float32), 7) for one in sent
    )
    unpacker = mcp.Unpacker()
    found = [body for at in range(0, len(stream), size) for body in unpacker.feed(stream[at : at + size])]
    assert unpacker.damaged == 0
    assert len(found) == len(sent)
    for body, one in zip(found, sent, strict=True):
        if isinstance(one, bytes):
            assert body == one
        else:
            data = mcp.floats_of(body)
            assert data.information == 7
            assert np.array_equal(data.values, np.array(one, np.float32))


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 250))
def test_garbage_and_lost_ends_cost_one_packet_each(garbage, kept):
    whole = mcp.pack_data(np.linspace(-1, 1, 60, dtype=np.float32), 1)
    garbage = garbage.replace(b"\x7c", b"\x00")
    unpacker = mcp.Unpacker()
    found = unpacker.feed(whole[:kept] + garbage + whole + whole)
    good = [body for body in found if mcp.floats_of(body) is not None and len(mcp.floats_of(body).values) == 60]
    assert len(good) >= 2 - (0 < kept < 9)  # where the length itself is cut, the next packet is taken for it


@given(st.binary(max_size=400))
def test_of_any_bytes_no_more_come_out_than_went_in(data):
    bodies = mcp.Unpacker().feed(data)
    assert sum(map(len, bodies)) <= len(data)
    for found in map(mcp.floats_of, bodies):
        assert found is None or 4 * len(found.values) <= len(data)
