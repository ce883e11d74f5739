"""The client of a server such as DUNE's Transports.TCP.Server."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Sequence
from contextlib import suppress

from ullage.ports.imc.codec import Packet, Parser
from ullage.ports.imc.link import Outbox, report_foreign_bytes
from ullage.ports.imc.table import Table
from ullage.ports.intake import Counters, Log

AT_ONCE = 65536


class Waker:
    """End a wait on sockets from another thread."""

    def __init__(self) -> None:
        self.reading, self._writing = socket.socketpair()
        self.reading.setblocking(False)
        self._writing.setblocking(False)

    def wake(self) -> None:
        """End the wait."""
        with suppress(OSError):  # full, so it will wake anyway; or closed
            self._writing.send(b"!")

    def drain(self) -> None:
        """Discard the wake-up bytes."""
        with suppress(OSError):
            while self.reading.recv(4096):
                pass

    def close(self) -> None:
        """Close both ends."""
        self.reading.close()
        self._writing.close()


class TcpWire:
    """Keep a connection to one server, and connect again when it is lost.

    Args:
        host: of the server.
        port: of the server.
        table: the messages.
        silence_s: longest silence of the server before the connection is dropped [s].
        reconnect: connect again after the connection is lost.
        log: takes lines for the user.
        counters: count damaged packets.
    """

    services: Sequence[str] = ()

    def __init__(
        self, host: str, port: int, *, table: Table, silence_s: float, reconnect: bool, log: Log,
        counters: Counters | None = None,
    ) -> None:  # fmt: skip
        self._counters, self._damaged = counters or Counters(), 0
        self._place, self._table, self._silence, self._again, self._log = (host, port), table, silence_s, reconnect, log
        self._where = f"tcp://{host}:{port}"
        self._waker = Waker()
        self._sock: socket.socket | None = None
        self._was_there = False
        self._next_try = self._received_s = 0.0
        self._wait_s = 0.25
        self._rest = memoryview(b"")
        self._parser = Parser(table)
        self._reported: set[str] = set()

    @property
    def connected(self) -> bool:
        """Whether the connection is open."""
        return self._sock is not None

    @property
    def finished(self) -> bool:
        """Whether it is lost for good."""
        return self._was_there and self._sock is None and not self._again

    def exchange(self, out: Outbox, timeout_s: float) -> list[Packet]:
        """Send and receive what is possible; wait until the timeout if nothing is."""
        if self._sock is None and not self._connect(timeout_s):
            return []
        sock = self._sock
        if sock is None:
            return []
        if not len(self._rest):
            self._rest = memoryview(out.take() or b"")
        wants = [sock] if len(self._rest) else []
        ready, writable, _ = select.select([sock, self._waker.reading], wants, [], timeout_s)
        if self._waker.reading in ready:
            self._waker.drain()
        if writable:
            self._write(sock, out)
        packets = self._read(sock) if sock in ready else []
        if self._sock is not None and time.monotonic() - self._received_s > self._silence:
            self._log(f"{self._where} has said nothing for {self._silence:g} s; connecting anew")
            self._drop()
        return packets

    def _connect(self, timeout_s: float) -> bool:
        now = time.monotonic()
        if self.finished or now < self._next_try:
            select.select([self._waker.reading], [], [], timeout_s)
            self._waker.drain()
            return False
        try:
            sock = socket.create_connection(self._place, timeout=2.0)
        except OSError as error:
            if "waiting" not in self._reported:
                self._reported.add("waiting")
                self._log(f"waiting for {self._where} ({error.strerror or error})")
            self._next_try, self._wait_s = now + self._wait_s, min(2 * self._wait_s, 2.0)
            return False
        if sock.getsockname() == sock.getpeername():  # the socket connected to itself: nobody listens there
            sock.close()
            self._next_try = now + self._wait_s
            return False
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._sock, self._was_there, self._wait_s, self._received_s = sock, True, 0.25, time.monotonic()
        self._reported.discard("waiting")
        self._parser, self._damaged = Parser(self._table), 0
        return True

    def _write(self, sock: socket.socket, out: Outbox) -> None:
        try:
            while len(self._rest):
                self._rest = self._rest[sock.send(self._rest) :]
                if not len(self._rest):
                    self._rest = memoryview(out.take() or b"")
        except BlockingIOError:
            pass
        except OSError:
            self._drop()

    def _read(self, sock: socket.socket) -> list[Packet]:
        try:
            data = sock.recv(AT_ONCE)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop()
            return []
        self._received_s = time.monotonic()
        packets = list(self._parser.feed(data))
        fresh, self._damaged = self._parser.damaged - self._damaged, self._parser.damaged
        self._counters.drop(self._where, "bad", "a packet is damaged or cut", count=fresh)
        report_foreign_bytes(self._parser, self._where, self._log, self._reported)
        return packets

    def _drop(self) -> None:
        if self._sock is not None:
            self._sock.close()
        self._sock, self._rest = None, memoryview(b"")
        self._next_try = time.monotonic() + self._wait_s

    def greet(self, announce: bytes) -> None:
        """Do nothing: only the server receives."""

    def wake(self) -> None:
        """End a running `exchange` early."""
        self._waker.wake()

    def close(self) -> None:
        """Close the connection."""
        self._drop()
        self._waker.close()
