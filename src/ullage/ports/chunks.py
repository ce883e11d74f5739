"""Unpack chunks of MCAP recordings within a limit, whatever size their headers give."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

MOST_CHUNK_BYTES = 256 * 2**20
RECORD = struct.Struct("<BQ")
"""Opcode and length of a record."""
FIELDS = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time, before the data of a message."""


def chunk_records(chunk: Any) -> list[Any]:
    """The records of a chunk, its checksum compared.

    The library takes eight reads for a message; here the fixed fields are unpacked at once.

    Raises:
        ValueError: it is larger than allowed, not of the size that it promises, or its checksum is wrong; and what the
            libraries raise.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message, Schema

    data = unpacked(chunk.data, chunk.compression, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a wrong checksum")
    described: dict[int, Any] = {int(Opcode.SCHEMA): Schema, int(Opcode.CHANNEL): Channel}
    message, out, at = int(Opcode.MESSAGE), [], 0
    while at < len(data):
        opcode, length = RECORD.unpack_from(data, at)
        start, at = at + RECORD.size, at + RECORD.size + length
        if at > len(data):
            raise ValueError("a record longer than its chunk")
        if opcode == message:
            if length < FIELDS.size:
                raise ValueError(f"a message of {length} bytes")
            channel, sequence, logged, published = FIELDS.unpack_from(data, start)
            out.append(Message(channel, logged, data[start + FIELDS.size : at], published, sequence))
        elif opcode in described:
            out.append(described[opcode].read(ReadDataStream(io.BytesIO(data[start:at]))))
    return out


def unpacked(data: bytes, compression: str, size: int) -> bytes:
    """The plain bytes of packed data that promises to hold `size` of them.

    Raises:
        ValueError: the promise is not kept, too large, or the compression not known.
    """
    if size > MOST_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    if compression == "":
        return data
    if compression == "zstd":
        import zstandard

        out = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size + 1)
    elif compression == "lz4":
        import lz4.frame

        out = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    else:
        raise ValueError(f"compression {compression!r}")
    if len(out) != size:
        raise ValueError(f"a chunk that promises {size} bytes and does not hold them")
    return bytes(out)
