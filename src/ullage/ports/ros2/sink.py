"""What flows, as ROS 2 topics: `--to ros2:`."""

from __future__ import annotations

import queue
import threading
import time
import warnings
from typing import Self

from ullage.errors import InputError, UllageWarning
from ullage.ports import messages as ros
from ullage.ports.pace import LATE_S, Pace
from ullage.ports.protocol import Item
from ullage.ports.ros2 import encode
from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import SinkOptions
from ullage.ports.ros2.outgoing import Note, Outgoing

AHEAD_S = 2.0
"""How far the maker of frames may run ahead of what was published [s of stream]."""
NOW_S = 86400.0
"""Stamps nearer to the present than this [s] are a real clock's, which needs no /clock."""
SETTLE_S = 0.5
"""Between finding a listener and its having found every topic [s]."""


class Ros2Sink:
    """Publishes everything that flows, at the pace of its own clock, from a thread of its own.

    Args:
        namespace: of the topics.
        options: how.
        peer: the node to use; None: one of its own.

    Raises:
        InputError: the namespace is none.
        MissingExtra: there is no rclpy.
    """

    def __init__(self, namespace: str, options: SinkOptions, *, peer: Peer | None = None) -> None:
        self._options = options
        self._peer = peer or Peer(namespace, options)
        self._outgoing = Outgoing(map_full_s=options.map_full_s)
        self._notes: queue.Queue[Note | None] = queue.Queue()
        self._pace = Pace(options.pace)
        self._clock: bool | None = {"on": True, "off": False}.get(options.clock)
        self._clock_ns = -1
        self._spoken_ns: int | None = None
        self._spoken = threading.Condition()
        self._error: BaseException | None = None
        self._map_listeners, self._sent, self._late_s, self._told_s = 0, 0, 0.0, time.monotonic()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = threading.Thread(target=self._speak, name="ullage ros2", daemon=True)
        self._thread.start()

    def write(self, item: Item) -> None:
        """Take one item; waits while what was taken before is far from published.

        Raises:
            InputError: the sink is closed.
        """
        if self._thread is None:
            raise InputError("the sink is closed", where="ros2:")
        self._put(self._outgoing.notes(item))

    def _put(self, notes: list[Note]) -> None:
        for note in notes:
            self._notes.put(note)
        if notes and notes[-1].quality != "relayed":
            with self._spoken:
                self._spoken.wait_for(lambda: self._near(notes[-1].t_ns))
        if self._error is not None:
            raise self._error

    def _near(self, t_ns: int) -> bool:
        spoken = self._spoken_ns
        return self._error is not None or (spoken is not None and t_ns - spoken <= AHEAD_S * 1e9)

    def _speak(self) -> None:
        try:
            self._await_listeners()
            while (note := self._notes.get()) is not None:
                if note.quality == "relayed":  # has no pace of its own
                    self._sent += self._peer.send(note)
                    continue
                self._wait(note.t_ns)
                self._tick(note.t_ns)
                self._sent += self._peer.send(note, reliable=self._options.reliable or None)
                self._look_around(note.t_ns)
                with self._spoken:
                    self._spoken_ns = note.t_ns
                    self._spoken.notify_all()
        except BaseException as error:
            with self._spoken:
                self._error = error
                self._spoken.notify_all()

    def _await_listeners(self) -> None:
        """As `ros2 topic pub --wait-matching-subscriptions`; who subscribes to /tf subscribes to the rest with it."""
        wanted = self._options.listeners
        if not wanted:
            return
        self._peer.publisher("/tf", ros.TRANSFORMS, "transforms")
        self._peer.publisher("map", ros.GRID, "latched")
        said = time.monotonic()
        while (found := self._peer.listeners("/tf")) < wanted and not self._closing.wait(0.05):
            if time.monotonic() - said > 10.0:
                warnings.warn(f"waiting for subscribers of /tf: {found} of {wanted}", UllageWarning, stacklevel=2)
                said = time.monotonic()
        self._closing.wait(SETTLE_S)
        self._map_listeners = self._peer.listeners("map")  # they are no newcomers: the first map goes to them whole

    def _wait(self, t_ns: int) -> None:
        """Until the stamp is due; meanwhile the clock goes on."""
        step = 1 / self._options.clock_hz
        due = self._pace.due_s(t_ns, time.monotonic())
        while (left := due - (now := time.monotonic())) > 0:
            stamp = self._pace.stamp_at(now)
            if stamp is not None and self._spoken_ns is not None and stamp < t_ns:
                self._tick(stamp)
            time.sleep(min(left, step))
        self._late_s = max(self._late_s, -left)

    def _tick(self, t_ns: int) -> None:
        if self._clock is None:
            self._clock = abs(time.time() - t_ns * 1e-9) > NOW_S
        if self._clock and t_ns != self._clock_ns:
            self._clock_ns = t_ns
            self._peer.send(Note(t_ns, "/clock", encode.CLOCK, "stream", encode.clock_note(t_ns)))

    def _look_around(self, t_ns: int) -> None:
        """Once a second: who came, and how it goes."""
        now = time.monotonic()
        if now - self._told_s < 1.0:
            return
        listeners = self._peer.listeners("map")
        self._outgoing.changes.wanted |= listeners > self._map_listeners
        self._map_listeners = listeners
        late, rate = self._late_s, self._sent / (now - self._told_s)
        text = "publishing" if late < LATE_S else f"{late:.1f} s behind its pace"
        values = [("messages a second", f"{rate:.1f}"), ("most behind [s]", f"{late:.3f}")]
        values += [("waiting messages", str(self._notes.qsize()))]
        data = encode.diagnostics_note(t_ns, int(late >= LATE_S), f"{self._options.node}: sink", text, values)
        self._peer.send(Note(t_ns, "/diagnostics", encode.DIAGNOSTICS, "stream", data))
        self._sent, self._late_s, self._told_s = 0, 0.0, now

    def close(self) -> None:
        """Publish what waits, stay as long as asked for, and leave."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._closing.set()
        try:
            for note in self._outgoing.rest():
                self._notes.put(note)
            self._notes.put(None)
            thread.join()
            self._peer.settle(1.0)
            time.sleep(self._options.linger_s)
        finally:
            self._peer.close()
        if self._error is not None:
            raise self._error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
