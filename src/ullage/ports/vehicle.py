"""Fly an aircraft of others in closed loop with radars and guard, in this machine's time."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np

from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.flight.live import Wish
from ullage.ports.drone import Drone, Guided, Limits, VehicleOptions
from ullage.ports.intake import PATIENCE_S, Log, Once, Worker
from ullage.ports.live import Address, options_of
from ullage.ports.pose_events import BodyState, path_along

POLL_S = 0.005
GONE_S = 5.0
"""A drone without a state for so long is gone [s]."""
WAIT_S = 30.0
"""How long the first state is waited for [s]."""
VEHICLES = "mavlink:PLACE, imc:PLACE, ros2:NAMESPACE or gazebo:MODEL"
STAY = Wish(velocity_m_s=(0.0, 0.0), climb_m_s=0.0, turn_rad_s=0.0)
"""Hover here."""


class LiveVehicle:
    """Fly a drone of others in closed loop, in this machine's time, in a thread that no simulation of radars delays.

    The drone hovers before the first request, and where none came for `hold_s`. Once somebody else flies it, or it
    gives no state for `GONE_S`, the flight is over. A drone that another flies gets no more commands.

    Args:
        drone: to command; closed at the end.
        options: of the commands.
        hold_s: how long a request holds [s].
        log: takes lines for the user.
    """

    contacts: tuple[tuple[int, int, float], ...] = ()

    def __init__(self, drone: Drone, options: VehicleOptions, *, hold_s: float, log: Log) -> None:
        limits = Limits(level_m_s=options.limit_m_s)
        self._drone, self._guided = drone, Guided(drone, options.takes, limits, log=log)
        self.options, self.hull_m, self._hold_s, self._log = options, options.hull_m, hold_s, log
        self.ended = ""
        self.delays_s: list[float] = []  # from the time of a pose until the command that answers it was sent
        self.epoch_ns = 0
        """When the flight began; 0: not yet."""
        self._state: BodyState | None = None
        self._asked_s = self._came_s = -math.inf
        self._news, self._closing = threading.Condition(), threading.Event()
        self._worker = Worker(self._run, "ullage vehicle", failed=self._wake)
        self._worker.start()

    def wait(self) -> Trajectory:
        """Wait until the drone follows; its pose then. The flight begins.

        Raises:
            InputError: it gives no state, or refuses.
        """
        begun, logged = time.monotonic(), Once(self._log)
        with self._news:
            while self._state is None or self._drone.away or self._drone.broken:
                self._worker.check()
                if self._drone.broken:
                    raise InputError(self._drone.broken, where="vehicle")
                if self._state is not None:
                    logged(f"waiting: {self._drone.away} (Ctrl-C ends)")
                elif time.monotonic() - begun > WAIT_S:
                    what = f"no state of the vehicle within {WAIT_S:g} s"
                    raise InputError(what, where="vehicle", allowed="a vehicle that reports its pose")
                self._news.wait(PATIENCE_S)
        start = self.fly_to(0)
        if start is None:
            raise InputError(self.ended, where="vehicle")
        return start

    def fly_to(self, t_ns: int) -> Trajectory | None:
        """Return the first pose at or after a time of the flight [ns]; None: the flight is over.

        The flight begins with the newest pose each time that its time 0 is asked for.
        """
        with self._news:
            if t_ns == 0 and self._state is not None:
                self.epoch_ns = self._state.t_ns
            while not self.ended:
                self._worker.check()
                if self._state is not None and self._state.t_ns - self.epoch_ns >= t_ns:
                    self._drone.answered_ns = self._state.t_ns
                    path = path_along([self._state])
                    return replace(path, t_ns=path.t_ns - self.epoch_ns)
                self._news.wait(1.0)
        return None

    def ask(self, wish: Wish) -> None:
        """Change the request, and command the drone at once."""
        with self._news:
            if self.ended:
                return
            self._asked_s = time.monotonic()
            self._guided.ask(wish)
            self._guided.command()
            self.delays_s.append(time.time() - self._drone.answered_ns * 1e-9)

    def release(self, *, landed: bool) -> None:
        """Let the drone hover or tell it that it has landed, and leave it; not where somebody else flies it."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._worker.join(3.0)
        try:
            if not self._drone.away:
                self._drone.land() if landed else self._drone.hold()
        finally:
            self._drone.close()
            for line in self._drone.counters.lines():
                self._log(line)

    @property
    def words(self) -> str:
        """How it was flown, in sentences."""
        radars = f"received from {self.options.radars}" if self.options.radars else "simulated at its reported poses"
        flown = f"An aircraft flew it, its radars {radars}."
        if not self.delays_s:
            return flown
        middle, most = np.percentile(self.delays_s, [50, 99]) * 1e3
        return f"{flown} Set-points left {middle:.0f} ms (median) and {most:.0f} ms (99 %) after the poses they answer."

    def _run(self) -> None:
        while not self._closing.wait(POLL_S):
            with self._news:
                self._advance(time.monotonic())

    def _wake(self) -> None:
        with self._news:
            self._news.notify_all()

    def _advance(self, now: float) -> None:
        """Take the drone's states; command it, unless the flight is over."""
        if self.ended:
            return
        flies = self.epoch_ns > 0
        if flies and self._drone.away:
            self.ended = self._drone.away
        elif flies and self._drone.broken:
            self.ended = self._drone.broken
        elif flies and now - self._came_s > GONE_S:
            self.ended = f"no state of the vehicle for {GONE_S:g} s"
        elif self._state is not None and now - self._asked_s > self._hold_s:
            self._asked_s = math.inf if not flies else now
            self._guided.ask(STAY)
        states = [] if self.ended else self._guided.fly()
        if states:
            self._state, self._came_s = states[-1], now
        if states or self.ended:
            self._news.notify_all()


def open_vehicle(target: str, *, hold_s: float, log: Log) -> LiveVehicle:
    """Open an aircraft as `scheme:place?key=value`.

    Args:
        target: a live port that takes commands.
        hold_s: how long a request holds [s].
        log: takes lines for the user.

    Raises:
        InputError: there is no such port, or an option is of no use.
        MissingExtra: a library of the port is not installed.
    """
    address = Address.of(target)
    made: Any = None if address is None else address.part("drone")
    if address is None or made is None:
        raise InputError(f"no vehicle at {target!r}", where="vehicle", allowed=VEHICLES)
    options = options_of(made.settings, address.options, f"{address.scheme}:{address.place}")
    if options.takes not in made.takes:
        raise InputError(made.refusal, where=target, allowed=f"takes={made.takes[0]}")
    return LiveVehicle(made(address.place, options), options, hold_s=hold_s, log=log)
