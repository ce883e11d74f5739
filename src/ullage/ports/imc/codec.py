"""IMC packets [MartinsEtAl2009]: bytes to messages and back, in either byte order, and a parser for what comes in."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError
from ullage.ports.imc.table import HELD, VERSION, Field, Kind, Table, own

SYNC = 0xFE00 | VERSION[0] << 4 | VERSION[1]
HEADER = (struct.Struct("<HHHdHBHB"), struct.Struct(">HHHdHBHB"))
WORD = (struct.Struct("<H"), struct.Struct(">H"))
HEAD, TAIL = 20, 2
MOST = 65535  # bytes of a payload
NOBODY = 65535  # number of a message that is not there; address of everybody
DEEPEST = 12  # messages within messages
MOST_TRIED, MOST_READ = 1024, 1_000_000
"""Lengths tried for a message of unknown kind within another, and bytes read for that."""
PADDING = 4096


class Malformed(ValueError):
    """Bytes that are no message of their kind."""


class _Unknown(Malformed):
    """A message within another is of a kind that the table has not, so its length is not known."""

    def __init__(self, at: int) -> None:
        super().__init__("a message of unknown kind within it")
        self.at = at  # of its first field


@dataclass(frozen=True, slots=True)
class Message:
    """One message: its name, and the value of every field.

    A message that the table has not, or whose bytes do not fit its kind, has the name "" and the values `id`,
    `payload` (bytes) and `big` (their byte order).
    """

    name: str
    values: Mapping[str, Any]

    def __getitem__(self, key: str) -> Any:
        return self.values[key]


@dataclass(frozen=True, slots=True)
class Packet:
    """A message with its header."""

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
    """What a stranger wrote, fit to be shown and used as a name: printable, and no longer than `most`."""
    whole = text[:most].encode(errors="surrogateescape").decode(errors="replace")
    return "".join(c if c.isprintable() else "?" for c in whole)


def make(kind: str, /, *, table: Table | None = None, **values: Any) -> Message:
    """A message with these fields; the others are zero, empty or none.

    Raises:
        InputError: there is no such message or field.
    """
    known = (table or own()).named(kind)
    blank = known.empty()
    for name in values:
        if name not in blank:
            raise InputError(f"no field {name!r}", where=kind, allowed=", ".join(blank) or "none")
    return Message(kind, blank | values)


def encode(packet: Packet, *, big: bool = False, table: Table | None = None) -> bytes:
    """The bytes of a packet.

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
    from ullage.kernels.checksum import crc16

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
    """Takes a payload apart.

    Args:
        data: the payload, with padding behind it or not.
        big: whether it is big endian.
        table: the messages.
        end: where the payload ends.
        rest: number of bytes of the payload that follow a message of unknown kind within it; None: not known.
    """

    __slots__ = ("at", "big", "data", "end", "rest", "seen", "table")

    def __init__(self, data: bytes, big: bool, table: Table, end: int, rest: int | None = None) -> None:
        self.data, self.big, self.table, self.at = data, big, table, 0
        self.end, self.rest, self.seen = end, rest, False

    def message(self, kind: Kind, depth: int = 0) -> Message:
        """The fields of one message, in order."""
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
        """The bytes of a message of unknown kind, as far as the bytes that follow it leave room."""
        if self.at > self.end:
            return None  # this is padding
        if self.rest is None or self.seen:
            raise _Unknown(self.at)
        start, self.at, self.seen = self.at, self.end - self.rest, True
        return Message("", {"id": number, "payload": self.data[start : self.at], "big": self.big})


def decode(data: bytes, *, table: Table | None = None) -> Packet:
    """The packet that these bytes are, from sync to checksum.

    Raises:
        Malformed: they are no packet of this version.
    """
    if len(data) < HEAD + TAIL:
        raise Malformed("cut")
    big = data[:2] == SYNC.to_bytes(2, "big")
    sync, number, size, t_s, src, src_ent, dst, dst_ent = HEADER[big].unpack_from(data)
    if sync != SYNC or len(data) != HEAD + size + TAIL:
        raise Malformed("sync or size does not fit")
    if crc(data[:-TAIL]) != WORD[big].unpack_from(data, HEAD + size)[0]:
        raise Malformed("checksum does not fit")
    return Packet(body(number, data[HEAD:-TAIL], big, table or own()), t_s, src, src_ent, dst, dst_ent, number)


def body(number: int, payload: bytes, big: bool, table: Table) -> Message:
    """The message of this number that a payload holds; one without a name where it holds none."""
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
    """A message that holds one of unknown kind, which is kept as bytes; None where the fields before it do not fit.

    IMC does not tell the length of a message within another. So the fields behind the unknown one decide: they must
    fill what is left of the payload exactly. Where no length fits, as with two unknown messages, the first takes all
    that is left, and the fields behind it are empty.

    Args:
        kind: of the outer message.
        payload: its fields.
        big: whether they are big endian.
        table: the messages.
        at: where the unknown message begins.
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
    from ullage.kernels.checksum import powers

    out = np.zeros(HEAD + MOST + 1, np.uint16)
    powers(out)
    return out


@dataclass(slots=True)
class Parser:
    """Finds packets in bytes as they come; holds back no more than one packet's length.

    Args:
        table: the messages; None: ours.
    """

    table: Table = field(default_factory=own)
    garbage: int = 0  # bytes so far that belonged to no packet
    damaged: int = 0  # runs of such bytes: packets that were cut, or whose checksum does not fit
    strange: int = 0  # packets so far of another version of the protocol
    version: tuple[int, int] | None = None  # of the last of those
    _held: bytearray = field(default_factory=bytearray)
    _lost: bool = False
    _wanted: int = 0  # bytes needed before the next search

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait for the rest of their packet."""
        return len(self._held)

    def feed(self, data: bytes) -> Iterator[Packet]:
        """The packets that these bytes complete."""
        self._held += data
        if len(self._held) >= self._wanted:
            yield from self._find_packets(end=False)

    def finish(self) -> Iterator[Packet]:
        """What is left when nothing more comes: packets behind one that was cut."""
        self._lost = True
        yield from self._find_packets(end=True)

    def _find_packets(self, *, end: bool) -> Iterator[Packet]:
        from ullage.kernels import checksum

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
    """The packet that these bytes are, whose checksum is known to fit."""
    big = data[0] == 0xFE
    _, number, _, t_s, src, src_ent, dst, dst_ent = HEADER[big].unpack_from(data)
    return Packet(body(number, data[HEAD:-TAIL], big, table), t_s, src, src_ent, dst, dst_ent, number)


def compile_kernels() -> None:
    """Compile what the parser needs, so that no packet waits for it."""
    list(Parser().feed(encode(Packet(make("Heartbeat")))))
