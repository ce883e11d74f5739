"""Encode and decode IMC packets [MartinsEtAl2009] in either byte order, and find packets in a byte stream."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.kernels import checksum
from ullage.kernels.checksum import crc16, powers
from ullage.ports.imc.table import HELD, VERSION, Field, Kind, Table, own

SYNC = 0xFE00 | VERSION[0] << 4 | VERSION[1]
HEADER = (struct.Struct("<HHHdHBHB"), struct.Struct(">HHHdHBHB"))
WORD = (struct.Struct("<H"), struct.Struct(">H"))
HEAD, TAIL = 20, 2
MOST = 65535  # bytes of a payload
NOBODY = 65535  # number of an absent message; broadcast address
DEEPEST = 12  # limit of nested inline messages
MOST_TRIED, MOST_READ = 1024, 1_000_000
"""Lengths tried for a message of unknown kind within another, and bytes read for that."""
PADDING = 4096


class Malformed(ValueError):
    """Raised for bytes that do not form a valid message."""


class _Unknown(Malformed):
    """Raised for an inline message whose kind is not in the table, so that its length is unknown."""

    def __init__(self, at: int) -> None:
        super().__init__("a message of unknown kind within it")
        self.at = at  # of its first field


@dataclass(frozen=True, slots=True)
class Message:
    """Name of a message and the value of every field.

    A message that is not in the table, or whose bytes do not fit its kind, has the name "" and the values `id`,
    `payload` (bytes) and `big` (their byte order).
    """

    name: str
    values: Mapping[str, Any]

    def __getitem__(self, key: str) -> Any:
        return self.values[key]


@dataclass(frozen=True, slots=True)
class Packet:
    """Message with its header."""

    message: Message
    t_s: float = 0.0  # Unix time [s]
    src: int = NOBODY
    src_ent: int = 255
    dst: int = NOBODY
    dst_ent: int = 255
    id: int = -1  # set when decoded

    def __getitem__(self, key: str) -> Any:
        return self.message.values[key]

    @property
    def name(self) -> str:
        """Name of the message."""
        return self.message.name


def readable(text: str, most: int = 64) -> str:
    """Return untrusted text that is safe to show and to use as a name: printable, at most `most` characters."""
    whole = text[:most].encode(errors="surrogateescape").decode(errors="replace")
    return "".join(c if c.isprintable() else "?" for c in whole)


def make(kind: str, /, *, table: Table | None = None, **values: Any) -> Message:
    """Make a message with these fields; the others are zero, empty or none.

    Raises:
        InputError: there is no such message or field.
    """
    blank = (table or own()).named(kind).empty()
    for name in values:
        if name not in blank:
            raise InputError(f"no field {name!r}", where=kind, allowed=", ".join(blank) or "none")
    return Message(kind, blank | values)


def encode(packet: Packet, *, big: bool = False, table: Table | None = None) -> bytes:
    """Encode a packet as bytes.

    Raises:
        InputError: a value does not fit its field, or the message is too long for a packet.
    """
    table, message = table or own(), packet.message
    if message.name:
        kind = table.named(message.name)
        number, payload = kind.id, b"".join(_fields(kind, message.values, big, table))
    else:
        number, payload = packet.id, bytes(message["payload"])
    if len(payload) > MOST:
        raise InputError(f"{len(payload)} bytes", where=message.name, allowed=f"at most {MOST} in one message")
    try:
        head = HEADER[big].pack(
            SYNC, number, len(payload), packet.t_s, packet.src, packet.src_ent, packet.dst, packet.dst_ent
        )
    except struct.error as error:
        raise InputError(f"header does not fit: {error}", where=message.name) from None
    return head + payload + WORD[big].pack(crc(head + payload))


def crc(data: bytes) -> int:
    """Return the CRC-16/ARC that IMC calls CRC-16-IBM; the standard library has no such CRC."""
    return int(crc16(np.frombuffer(data, np.uint8), 0))


def _fields(kind: Kind, values: Mapping[str, Any], big: bool, table: Table) -> Iterator[bytes]:
    for run, packer in zip(kind.runs, kind.packers[big], strict=True):
        if run[0].kind not in HELD:
            try:
                yield packer.pack(*(values[f.name] for f in run))
            except (struct.error, OverflowError) as error:
                raise InputError(f"{', '.join(f.name for f in run)}: {error}", where=kind.name) from None
            continue
        yield from _held(run[0], values[run[0].name], big, table, kind.name)


def _held(part: Field, value: Any, big: bool, table: Table, where: str) -> Iterator[bytes]:
    if part.kind in ("text", "raw"):
        data = value.encode(errors="surrogateescape") if isinstance(value, str) else bytes(value)
        if len(data) > MOST:
            raise InputError(f"{part.name} has {len(data)} bytes", where=where, allowed=f"at most {MOST}")
        yield WORD[big].pack(len(data))
        yield data
    elif part.kind == "message":
        yield from _inner(value, big, table)
    else:
        if len(value) > MOST:
            raise InputError(f"{part.name} has {len(value)} messages", where=where, allowed=f"at most {MOST}")
        yield WORD[big].pack(len(value))
        for one in value:
            yield from _inner(one, big, table)


def _inner(message: Message | None, big: bool, table: Table) -> Iterator[bytes]:
    if message is None:
        yield WORD[big].pack(NOBODY)
        return
    if not message.name:
        if message["big"] != big:
            raise InputError("its bytes are of the other byte order", where=f"message {message['id']}")
        yield WORD[big].pack(message["id"])
        yield message["payload"]
        return
    kind = table.named(message.name)
    yield WORD[big].pack(kind.id)
    yield from _fields(kind, message.values, big, table)


class _Reader:
    """Read the fields of a payload one by one.

    Args:
        data: the payload, with or without padding after it.
        big: whether it is big endian.
        table: the messages.
        end: offset of the payload's end [bytes].
        rest: bytes of the payload after an inline message of unknown kind; None: not known.
    """

    __slots__ = ("at", "big", "data", "end", "rest", "seen", "table")

    def __init__(self, data: bytes, big: bool, table: Table, end: int, rest: int | None = None) -> None:
        self.data, self.big, self.table, self.at = data, big, table, 0
        self.end, self.rest, self.seen = end, rest, False

    def message(self, kind: Kind, depth: int = 0) -> Message:
        """Read the fields of one message, in order."""
        if depth > DEEPEST:
            raise Malformed("messages within messages go too deep")
        values: dict[str, Any] = {}
        for run, packer in zip(kind.runs, kind.packers[self.big], strict=True):
            if run[0].kind in HELD:
                values[run[0].name] = self._held(run[0], depth)
                continue
            end = self.at + packer.size
            if end > len(self.data):
                raise Malformed("cut")
            values.update(zip((f.name for f in run), packer.unpack_from(self.data, self.at), strict=True))
            self.at = end
        return Message(kind.name, values)

    def _held(self, part: Field, depth: int) -> Any:
        if part.kind == "message":
            return self._inner(depth)
        size = self._word()
        if part.kind == "messages":
            if 2 * size > len(self.data) - self.at:
                raise Malformed("more messages than bytes")
            return tuple(self._inner(depth) for _ in range(size))
        if self.at + size > len(self.data):
            raise Malformed("cut")
        data = self.data[self.at : self.at + size]
        self.at += size
        return data.decode(errors="surrogateescape") if part.kind == "text" else data

    def _word(self) -> int:
        if self.at + 2 > len(self.data):
            raise Malformed("cut")
        value = int(WORD[self.big].unpack_from(self.data, self.at)[0])
        self.at += 2
        return value

    def _inner(self, depth: int) -> Message | None:
        number = self._word()
        if number == NOBODY:
            return None
        if number not in self.table.by_id:
            return self._unknown(number)
        return self.message(self.table.by_id[number], depth + 1)

    def _unknown(self, number: int) -> Message | None:
        """Return the bytes of a message of unknown kind, without those of the fields after it."""
        if self.at > self.end:
            return None  # this is padding
        if self.rest is None or self.seen:
            raise _Unknown(self.at)
        start, self.at, self.seen = self.at, self.end - self.rest, True
        return Message("", {"id": number, "payload": self.data[start : self.at], "big": self.big})


def decode(data: bytes, *, table: Table | None = None) -> Packet:
    """Decode one packet, from sync number to checksum.

    Raises:
        Malformed: the bytes are not a packet of this version.
    """
    if len(data) < HEAD + TAIL:
        raise Malformed("cut")
    word = WORD[data[:2] == SYNC.to_bytes(2, "big")]
    if word.unpack_from(data)[0] != SYNC or len(data) != HEAD + word.unpack_from(data, 4)[0] + TAIL:
        raise Malformed("sync or size does not fit")
    if crc(data[:-TAIL]) != word.unpack_from(data, len(data) - TAIL)[0]:
        raise Malformed("checksum does not fit")
    return decode_sound(data, table or own())


def body(number: int, payload: bytes, big: bool, table: Table) -> Message:
    """Decode the payload of a message by its number; a payload that does not fit gives a message without a name."""
    kind = table.by_id.get(number)
    if kind is not None:
        reader = _Reader(payload, big, table, len(payload))
        try:
            found = reader.message(kind)
        except _Unknown as unknown:
            around = _around(kind, payload, big, table, unknown.at)
            if around is not None:
                return around
        except Malformed:
            pass
        else:
            if reader.at == len(payload):
                return found
    return Message("", {"id": number, "payload": payload, "big": big})


def _around(kind: Kind, payload: bytes, big: bool, table: Table, at: int) -> Message | None:
    """Decode a message with an inline message of unknown kind, kept as bytes; None if earlier fields do not fit.

    IMC gives no length for an inline message. So the fields after the unknown one decide: they must
    fill the rest of the payload exactly. If no length fits, as with two unknown messages, the first takes all
    remaining bytes, and the fields after it are empty.

    Args:
        kind: of the outer message.
        payload: its fields.
        big: whether they are big endian.
        table: the messages.
        at: offset of the unknown message [bytes].
    """
    end = len(payload)
    for rest in range(min(end - at + 1, MOST_TRIED, MOST_READ // max(end, 1) + 1)):
        reader = _Reader(payload, big, table, end, rest)
        try:
            found = reader.message(kind)
        except Malformed:
            continue
        if reader.at == end:
            return found
    try:
        return _Reader(payload + bytes(PADDING), big, table, end, 0).message(kind)
    except Malformed:
        return None


@lru_cache(maxsize=1)
def _powers() -> NDArray[np.uint16]:
    out = np.zeros(HEAD + MOST + 1, np.uint16)
    powers(out)
    return out


@dataclass(slots=True)
class Parser:
    """Find packets in a byte stream; hold back at most one packet's length.

    Args:
        table: the messages; None: ours.
    """

    table: Table = field(default_factory=own)
    garbage: int = 0  # bytes outside any packet so far
    damaged: int = 0  # runs of such bytes: packets that were cut, or whose checksum does not fit
    strange: int = 0  # packets of another protocol version so far
    version: tuple[int, int] | None = None  # version of the last of those packets
    _held: bytearray = field(default_factory=bytearray)
    _lost: bool = False
    _wanted: int = 0  # bytes needed before the next search

    @property
    def waiting_bytes(self) -> int:
        """Number of bytes that wait for the rest of their packet."""
        return len(self._held)

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Return the packets that these bytes complete."""
        self._held += data
        if len(self._held) >= self._wanted:
            yield from self._find_packets(end=False)

    def finish(self) -> Iterator[Packet]:
        """Return the packets after a truncated one, at the end of the stream."""
        self._lost = True
        yield from self._find_packets(end=True)

    def _find_packets(self, *, end: bool) -> Iterator[Packet]:
        held = bytes(self._held)
        data = np.frombuffer(held, np.uint8)
        crcs = np.empty(len(data) + 1, np.uint16)
        checksum.running(data, crcs)
        at, found = 0, []
        while True:
            what, start, size = checksum.find(data, crcs, _powers(), at, SYNC & 0xFF, self._lost)
            self.garbage += start - at
            self.damaged += start > at and not self._lost
            self._lost = self._lost or start > at
            at = start
            if what not in (checksum.WHOLE, checksum.OTHER):
                break
            at += size
            if what == checksum.WHOLE:
                self._lost = False
                found.append(decode_sound(held[start:at], self.table))
            else:
                self.strange += 1
                minor = held[start] if held[start] != 0xFE else held[start + 1]
                self.version = (minor >> 4, minor & 15)
        if end:
            self.garbage += len(held) - at
            at = len(held)
        self._held = bytearray(held[at:])
        self._wanted = size if what == checksum.SHORT and size else len(self._held) + HEAD
        yield from found


def decode_sound(data: bytes, table: Table) -> Packet:
    """Decode a packet whose checksum has already been checked."""
    big = data[0] == 0xFE
    _, number, _, t_s, src, src_ent, dst, dst_ent = HEADER[big].unpack_from(data)
    return Packet(body(number, data[HEAD:-TAIL], big, table), t_s, src, src_ent, dst, dst_ent, number)


def compile_kernels() -> None:
    """Compile the parser's kernels, so that no packet waits for them."""
    list(Parser().feed(encode(Packet(make("Heartbeat")))))
