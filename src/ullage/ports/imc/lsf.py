"""DUNE's logs: `Data.lsf` and `Data.lsf.gz` are the packets of the bus, one after the other."""

from __future__ import annotations

import gzip
import time
import zlib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.files import write_whole, writing
from ullage.flow import Sink
from ullage.ports.imc.assemble import FrameAssembler, Track
from ullage.ports.imc.codec import Packet, Parser, encode, make
from ullage.ports.imc.frames import BODY, MessageEncoder
from ullage.ports.imc.options import LogOptions, LogSourceOptions
from ullage.ports.imc.table import from_xml, own, to_xml
from ullage.ports.imc.wires import Entity
from ullage.ports.intake import Counters, warn
from ullage.ports.live import options_of
from ullage.ports.ned import datum_of
from ullage.ports.protocol import Item, Recording, pieces

AT_ONCE = 1 << 19
STARTED, STOPPED = 1, 3
EPOCH_NS = 1_000_000_000_000_000_000
FLUSH_EVERY_S = 0.5
MOST_RATIO, MOST_UNPACKED = 200, 64 * 2**20
"""A packed log may grow to so many times its size, or to so many bytes; logs of vehicles grow 2 to 20 times."""


class LsfSource(Recording):
    """Reads a log.

    Args:
        path: `.lsf` or `.lsf.gz`.
        **options: what to take, as `LogSourceOptions` lists them.

    Raises:
        InputError: it cannot be read, or holds no packet of IMC.
    """

    holds = "DevDataBinary of ullage, or SonarData"

    def __init__(self, path: str | Path, **options: Any) -> None:
        super().__init__(path)
        self._options = options_of(LogSourceOptions, options, "imc")
        self._table = from_xml(self._options.xml) if self._options.xml else own()
        self._vehicle = self._options.vehicle or self._logger()

    def packets(self) -> Iterator[Packet]:
        """Every message, in order; what is damaged or cut is left out, with one warning at the end.

        Raises:
            InputError: it cannot be read, or holds no packet.
        """
        parser, seen = Parser(self._table), False
        for packet in chain(chain.from_iterable(map(parser.feed, self._unpacked())), parser.finish()):
            seen = True
            yield packet
        if not seen:
            other = parser.version
            what = f"packets of IMC {other[0]}.{other[1]}" if other else "no packet of IMC"
            raise InputError(f"{what} in it", where=self.path, allowed="a log of IMC 5.4")
        if parser.garbage:
            what = f"{parser.garbage} bytes belong to no whole packet"
            warn(f"{self.path}: {what}; all that can be read is used")

    def _unpacked(self) -> Iterator[bytes]:
        """The bytes of the log in pieces, as far as they can be unpacked."""
        given = 0
        try:
            most = max(MOST_RATIO * self.path.stat().st_size, MOST_UNPACKED)
            with open(self.path, "rb") as file:
                log: Any = gzip.GzipFile(fileobj=file) if file.peek(2)[:2] == b"\x1f\x8b" else file
                while data := log.read1(AT_ONCE):
                    yield data
                    given += len(data)
                    if given > most:
                        raise InputError(f"unpacks to over {most} bytes", where=self.path, allowed="a log")
        except EOFError:
            return  # packed and cut
        except (zlib.error, gzip.BadGzipFile) as error:
            warn(f"{self.path}: damaged ({error}); all that can be read before that is used")
        except OSError as error:
            raise InputError(f"cannot read: {error.strerror or error}", where=self.path) from None

    def _logger(self) -> str:
        """The number of the system that wrote the log; empty where it does not say."""
        for count, packet in enumerate(self.packets()):
            if packet.name == "LoggingControl" and packet["op"] == STARTED:
                return str(packet.src)
            if count > 2000:
                break
        return ""

    def _track(self, keep: int | None) -> Track:
        origin = datum_of(self._options.origin, "origin") if self._options.origin else None
        counters = Counters(self._warn)
        return Track(counters, state=self._options.state, origin=origin, vehicle=self._vehicle, keep=keep)

    def _warn(self, text: str) -> None:
        warn(f"{self.path}: {text}")

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """The same in pieces of at most `chunk` frames of each sensor, in order of time."""
        track = self._track(4096)
        gather = FrameAssembler(track, self._warn)
        waiting = 0
        for packet in self.packets():
            track.take(packet)
            waiting += gather.take(packet)
            if waiting >= chunk:
                waiting = 0
                yield from pieces(gather.give(), chunk)
        yield from pieces(gather.give(final=True), chunk)
        track.finish()
        for line in track.counters.lines():
            self._warn(line)

    def trajectory(self) -> Trajectory | None:
        """The path of the vehicle, where it is known."""
        track = self._track(None)
        for packet in self.packets():
            track.take(packet)
        return track.path()


class LsfSink(Sink):
    """Writes a log that DUNE's and Neptus' readers accept, with `IMC.xml.gz`, which tells its messages, beside it.

    Args:
        path: `.lsf`, or `.lsf.gz`, which is packed.
        **options: what to write, as `LogOptions` lists them.

    Raises:
        InputError: it exists already, or cannot be written.
    """

    def __init__(self, path: str | Path, **options: Any) -> None:
        self.path, self._options = Path(path), options_of(LogOptions, options, "imc")
        if self.path.exists() and not self._options.overwrite:
            raise InputError("exists already", where=self.path, allowed="a new name, or overwrite=True")
        with writing(self.path):
            zipped = self.path.suffix == ".gz"
            self._file: Any = gzip.open(self.path, "wb") if zipped else open(self.path, "wb")  # noqa: SIM115
        beside = self.path.parent / "IMC.xml.gz"
        if not beside.exists():
            write_whole(beside, lambda out: out.write(gzip.compress(to_xml(own()))))
        self._new: list[Entity] = []
        self._encoder = MessageEncoder(self._options, self._options.home(), self._new.append)
        self._shift_ns: int | None = None  # added to times that do not count from 1970
        self._last_ns, self._flushed_s = 0, time.monotonic()

    def write(self, item: Item) -> None:
        """Take frames, chunks of them, or the body's path; everything else passes by.

        Raises:
            InputError: the log is closed, or the disk is full.
        """
        if self._file is None:
            raise InputError("the log is closed", where=self.path)
        messages = self._encoder.messages(item)
        if messages and self._shift_ns is None:
            self._shift_ns = 0 if messages[0].t_ns > EPOCH_NS else time.time_ns() - messages[0].t_ns
            self._last_ns = messages[0].t_ns
            self._put(make("LoggingControl", op=STARTED, name=self.path.parent.name or "log"), BODY)
            self._new.append(Entity(BODY, self._options.name, "ullage"))
        for entity in self._new:
            info = make("EntityInfo", id=entity.id, label=entity.label, component=entity.component)
            self._put(info, entity.id)
        self._new.clear()
        for message in messages:
            self._last_ns = message.t_ns
            self._put(message.message, message.entity)
        if time.monotonic() - self._flushed_s > FLUSH_EVERY_S:
            self._flushed_s = time.monotonic()
            self._file.flush()

    def _put(self, message: Any, entity: int) -> None:
        t_s = (self._last_ns + (self._shift_ns or 0)) * 1e-9
        with writing(self.path):
            self._file.write(encode(Packet(message, t_s, self._options.system_id, entity)))

    def close(self) -> None:
        """Finish the log."""
        if self._file is None:
            return
        if self._shift_ns is not None:
            self._put(make("LoggingControl", op=STOPPED, name=self.path.parent.name or "log"), BODY)
        file, self._file = self._file, None
        file.close()
