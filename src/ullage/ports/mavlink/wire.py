"""Bytes to and from an autopilot, by UDP, TCP or a serial line, and the messages of MAVLink 2 in them."""

from __future__ import annotations

import importlib
import ipaddress
import select
import socket
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from ullage.errors import InputError, need
from ullage.ports.intake import Counters, Log
from ullage.ports.mavlink.options import LinkOptions
from ullage.ports.network import Place, address_of, bound_udp, datagrams

DIALECT = "pymavlink.dialects.v20.ardupilotmega"
"""It holds the messages of `common`, which PX4 and ArduPilot share, and those that ArduPilot sends beside them."""
Sender = tuple[str, int]
"""Where bytes came from: address and port, or the serial device."""
MOST_SENDERS = 8
FORGET_S = 10.0
"""A listening port answers those who sent within this time [s]."""
REOPEN_S = 1.0
CONNECT_S = 2.0
"""A peer that takes no packet of a connection for so long is gone [s]."""


def mavlink() -> Any:
    """The dialect's module.

    Raises:
        MissingExtra: pymavlink is not installed.
    """
    need("pymavlink", extra="mavlink")
    return importlib.import_module(DIALECT)


class Decoder:
    """Turns the bytes of one sender into messages; those that cannot be read are counted.

    Args:
        counters: count damaged packets and unknown messages.
        topic: the sender, for the counts.
    """

    def __init__(self, counters: Counters, topic: str) -> None:
        self._counters, self._topic = counters, topic
        self._parser = mavlink().MAVLink(None)
        self._parser.robust_parsing = True

    def feed(self, data: bytes) -> list[Any]:
        """Messages that are complete with these bytes."""
        out, start = [], 0
        while start < len(data):
            # no more than the parser asks for, so that it never holds more than one packet
            end = start + self._parser.bytes_needed()
            try:
                message = self._parser.parse_char(data[start:end])
            except Exception as error:  # bytes of a stranger: whatever they do to the parser, the rest goes on
                self._bad(str(error) or type(error).__name__)
                message = None
            start = end
            if message is not None and self._readable(message):
                out.append(message)
        return out

    def _readable(self, message: Any) -> bool:
        kind = message.get_type()
        if kind == "BAD_DATA":
            cause = "wrong checksum, or a message of another dialect" if "CRC" in message.reason else message.reason
            self._bad(cause)
        elif kind.startswith("UNKNOWN"):
            self._bad(f"message {kind.removeprefix('UNKNOWN_')} is not of this dialect")
        else:
            return True
        return False

    def _bad(self, cause: str) -> None:
        self._counters.drop(self._topic, "bad", cause)


def open_wire(place: Place, options: LinkOptions, log: Log) -> UdpWire | StreamWire:
    """The connection to a place.

    Raises:
        InputError: the host is unknown, the port is in use, nobody listens there, or the device cannot be opened.
        MissingExtra: pyserial is not installed.
    """
    if place.kind == "serial":
        return SerialWire(place.host, options.baud, log)
    if place.kind == "tcp":
        return TcpWire(place, log)
    return UdpWire(place, options)


class UdpWire:
    """UDP: sends to one place and takes what comes from that host, or listens and answers those who send.

    Args:
        place: of the autopilot (`udp`), or our own address (`udpin`).
        options: the local port and address.

    Raises:
        InputError: the host is unknown, or the local address is in use.
    """

    def __init__(self, place: Place, options: LinkOptions) -> None:
        self.name = f"{place.kind}://{place.host}:{place.port}"
        host = address_of(place.host, where=f"mavlink:{self.name}")
        local = ipaddress.ip_address(host).is_loopback
        if place.kind == "udpin":
            self._peer: Sender | None = None
            mine = (host, place.port)
        else:
            self._peer = (host, place.port)
            mine = (options.interface or ("127.0.0.1" if local else _route_to(host, place.port)), options.port)
        self._senders: dict[Sender, float] = {}  # who sent, and when
        self._socket = bound_udp(mine[0], [mine[1]], where=f"mavlink:{self.name}")

    def send(self, data: bytes) -> None:
        """Send one packet; it is lost where nobody takes it."""
        now = time.monotonic()
        recent = [sender for sender, last_s in self._senders.items() if now - last_s < FORGET_S]
        for there in [self._peer] if self._peer else recent:
            try:
                self._socket.sendto(data, there)
            except OSError:  # nobody listens there now; they may later
                continue

    def receive(self, timeout_s: float) -> list[tuple[Sender, bytes]]:
        """Datagrams that have come; waits at most so long for the first."""
        select.select([self._socket], [], [], timeout_s)
        return [(sender, data) for data, sender in datagrams(self._socket) if self._accepted(sender)]

    def _accepted(self, sender: Sender) -> bool:
        if self._peer is not None:
            return sender[0] == self._peer[0]
        now = time.monotonic()
        self._senders = {one: last_s for one, last_s in self._senders.items() if now - last_s < FORGET_S}
        if sender not in self._senders and len(self._senders) >= MOST_SENDERS:
            return False
        self._senders[sender] = now
        return True

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


class StreamWire(ABC):
    """A stream of bytes that may end; it is opened again when the other side is back.

    Args:
        name: the place, for messages.
        log: takes a line when the other side goes or comes back.
    """

    def __init__(self, name: str, log: Log) -> None:
        self.name = name
        self._log, self._lost_s = log, 0.0
        self._line: Any = self._opened()

    @abstractmethod
    def _opened(self) -> Any:
        """Open it; OSError or ValueError where that fails."""

    @abstractmethod
    def _write(self, line: Any, data: bytes) -> None:
        """Write; OSError where it is lost."""

    @abstractmethod
    def _read(self, line: Any, timeout_s: float) -> bytes:
        """Read what has come; OSError where it is lost."""

    def send(self, data: bytes) -> None:
        """Send one packet; it is lost while the other side is away."""
        line = self._line  # once: another thread may lose it
        if line is None:
            return
        try:
            self._write(line, data)
        except (OSError, ValueError) as error:  # ValueError: closed by the other thread
            self._lose(error)

    def receive(self, timeout_s: float) -> list[tuple[Sender, bytes]]:
        """What has come; waits at most so long for it."""
        line = self._line or self._back(timeout_s)
        if line is None:
            return []
        try:
            data = self._read(line, timeout_s)
        except (OSError, TypeError, ValueError) as error:  # the last two: closed by another thread meanwhile
            self._lose(error)
            return []
        return [((self.name, 0), data)] if data else []

    def _lose(self, error: Exception) -> None:
        line, self._line = self._line, None
        self._lost_s = time.monotonic()
        if line is not None:
            line.close()
            self._log(f"{self.name} is lost ({_reason(error)}): waiting for it to come back")

    def _back(self, timeout_s: float) -> Any:
        """Open it again; None where that fails."""
        if time.monotonic() - self._lost_s < REOPEN_S:
            time.sleep(timeout_s)
            return None
        self._lost_s = time.monotonic()
        try:
            self._line = self._opened()
        except (OSError, ValueError):
            return None
        self._log(f"{self.name} is back")
        return self._line

    def close(self) -> None:
        """Let go of device or connection."""
        if self._line is not None:
            self._line.close()


class SerialWire(StreamWire):
    """A serial line.

    Args:
        device: as `/dev/ttyACM0`.
        baud: its speed.
        log: takes a line when the device goes or comes back.

    Raises:
        InputError: the device cannot be opened.
        MissingExtra: pyserial is not installed.
    """

    def __init__(self, device: str, baud: int, log: Log) -> None:
        need("serial", extra="mavlink")
        self._device, self._baud = device, baud
        try:
            super().__init__(f"serial://{device}", log)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            known = Path(device).exists()
            what = f"cannot be opened: {_reason(error)}" if known else "no such serial device"
            raise InputError(what, where=f"mavlink:serial://{device}", allowed="a device as /dev/ttyACM0") from None

    def _opened(self) -> Any:
        import serial

        return serial.Serial(self._device, self._baud, timeout=0.05, write_timeout=0.5)

    def _write(self, line: Any, data: bytes) -> None:
        line.write(data)

    def _read(self, line: Any, timeout_s: float) -> bytes:
        line.timeout = timeout_s
        data = line.read(1)
        return bytes(data + line.read(line.in_waiting)) if data else b""


class TcpWire(StreamWire):
    """A connection to an autopilot that listens, as ArduPilot's simulator does.

    Args:
        place: where it listens.
        log: takes a line when it goes or comes back.

    Raises:
        InputError: the host is unknown, or nobody listens there.
    """

    def __init__(self, place: Place, log: Log) -> None:
        name = f"tcp://{place.host}:{place.port}"
        self._there = (address_of(place.host, where=f"mavlink:{name}"), place.port)
        try:
            super().__init__(name, log)
        except OSError as error:
            what = f"cannot connect to {place.host} port {place.port}: {_reason(error)}"
            raise InputError(what, where=f"mavlink:{name}", allowed="the port of an autopilot that listens") from None

    def _opened(self) -> socket.socket:
        sock = socket.create_connection(self._there, timeout=CONNECT_S)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # distances must not wait for more of them
        return sock

    def _write(self, line: Any, data: bytes) -> None:
        line.sendall(data)

    def _read(self, line: Any, timeout_s: float) -> bytes:
        if not select.select([line], [], [], timeout_s)[0]:
            return b""
        data = line.recv(65535)
        if not data:
            raise ConnectionResetError("the other side closed it")
        return bytes(data)


def _route_to(host: str, port: int) -> str:
    """Return the address of this machine that reaches a host; empty where none does now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.connect((host, port))  # sends nothing
        except OSError:
            return ""
        return str(trial.getsockname()[0])


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
