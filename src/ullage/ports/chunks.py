"""Chunks of MCAP recordings, unpacked within a limit whatever their headers promise."""

from __future__ import annotations

import dataclasses
from typing import Any

MOST_CHUNK_BYTES = 256 * 2**20


def chunk_records(chunk: Any) -> list[Any]:
    """The records of a chunk, its checksum compared.

    Raises:
        ValueError: it is larger than allowed, or not of the size that it promises; and what the libraries raise.
    """
    from mcap.stream_reader import breakup_chunk

    plain = dataclasses.replace(
        chunk, compression="", data=unpacked(chunk.data, chunk.compression, chunk.uncompressed_size)
    )
    return list(breakup_chunk(plain, validate_crc=True))


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
