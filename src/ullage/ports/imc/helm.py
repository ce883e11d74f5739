"""A DUNE controller flies a multirotor, simulated or external: EstimatedState goes out, commands come in."""

from __future__ import annotations

import threading
import time
from typing import Any, Protocol

from ullage.arrays import Floats
from ullage.flight.live import Steered, Wish
from ullage.ports.drone import Guided
from ullage.ports.geodetic import Geodetic
from ullage.ports.imc.codec import NOBODY, Packet, make
from ullage.ports.imc.commands import Commands
from ullage.ports.imc.geodetic import Pose, state_of
from ullage.ports.imc.link import Link
from ullage.ports.intake import Log


class Vehicle(Protocol):
    """A vehicle that a controller can fly."""

    @property
    def wish(self) -> Wish:
        """The last request."""

    @property
    def position(self) -> Floats | None:
        """Its position (3) [m]; None: not known yet."""

    def ask(self, wish: Wish) -> None:
        """Change the request."""

    def fly(self) -> list[Pose]:
        """Fly until now, and return the poses since the last call."""

    def close(self) -> None:
        """Hover, and release it."""


class Simulated:
    """Our own multirotor, flown in wall time from the first call on.

    Args:
        vehicle: in the air.
        rate_hz: poses a second of flight.
        pace: times real time.
        log: takes a line when it hits something.
    """

    def __init__(self, vehicle: Steered, *, rate_hz: float, pace: float, log: Log) -> None:
        self._vehicle, self._log, self._pace = vehicle, log, pace
        self._period_ns = round(1e9 / rate_hz)
        self._begun: float | None = None
        self._count = 0
        self._epoch_ns = time.time_ns()
        self._touched = False

    @property
    def wish(self) -> Wish:
        """The last request."""
        return self._vehicle.wish

    @property
    def position(self) -> Floats | None:
        """Its position (3) [m]."""
        return self._vehicle.position

    def ask(self, wish: Wish) -> None:
        """Change the request."""
        self._vehicle.ask(wish)

    def fly(self) -> list[Pose]:
        """Fly until now, and return the poses since the last call."""
        now = time.monotonic()
        if self._begun is None:
            self._begun = now
        due_ns = int((now - self._begun) * self._pace * 1e9)
        out: list[Pose] = []
        v = self._vehicle
        while (self._count + 1) * self._period_ns <= due_ns:
            self._count += 1
            v.advance(self._count * self._period_ns)
            out.append(Pose(self._epoch_ns + v.t_ns, v.position, v.quat_xyzw, v.velocity, v.spin))
            if len(out) >= 50:  # first handle commands that came meanwhile
                break
        if v.touched and not self._touched:
            self._touched = True
            self._log("the vehicle hit something")
        return out

    def close(self) -> None:
        """Do nothing."""


class ExternalDrone:
    """A drone outside of ullage.

    Args:
        drone: the commanded drone.
        rate_hz: greatest number of poses a second.
    """

    def __init__(self, drone: Guided, *, rate_hz: float) -> None:
        self._drone, self._period_ns, self._last_ns = drone, round(1e9 / rate_hz), 0

    @property
    def wish(self) -> Wish:
        """The last request."""
        return self._drone.wish

    @property
    def position(self) -> Floats | None:
        """Its last position (3) [m]; None before the first state."""
        return self._drone.position

    def ask(self, wish: Wish) -> None:
        """Change the request."""
        self._drone.ask(wish)

    def fly(self) -> list[Pose]:
        """Return the poses since the last call, at most at the given rate."""
        out = []
        for state in self._drone.fly():
            if state.t_ns - self._last_ns >= 0.9 * self._period_ns:
                self._last_ns = state.t_ns
                out.append(Pose(state.t_ns, state.position, state.quat_xyzw, state.velocity, state.spin))
        return out

    def close(self) -> None:
        """Hover, and release it."""
        self._drone.close()


class Helm:
    """Fly a vehicle as a controller on the bus commands.

    The multirotor takes the address of the first peer that sends a message, because DUNE's controllers use only the
    EstimatedState of their own system. When the controller falls silent, the vehicle hovers.

    Args:
        vehicle: the multirotor.
        link: to the controller.
        origin: geodetic place of the world's origin.
        timeout_s: silence after which the vehicle hovers [s].
        log: takes a line for a command that is not possible.
    """

    def __init__(self, vehicle: Vehicle, link: Link, *, origin: Geodetic, timeout_s: float, log: Log) -> None:
        self._vehicle, self._link, self._origin, self._log = vehicle, link, origin, log
        self._commands = Commands(vehicle, origin, log)
        self._timeout_s, self._received_s = timeout_s, 0.0
        self._commanded = self._adopted = False

    def take(self, packet: Packet) -> None:
        """Carry out the command of a message."""
        if not self._adopted and packet.name in ("Heartbeat", "Announce"):
            self._adopted, self._link.me.system_id, self._link.me.shared = True, packet.src, True
        self._received_s = time.monotonic()
        if packet.dst not in (NOBODY, self._link.me.system_id):
            return
        answered = self._commands.answer(packet)
        if answered is not None:
            wish, reply = answered
            self._link.send(reply, entity=1, dst=packet.src, dst_ent=packet.src_ent)
        else:
            wish = self._commands.wish(packet)
        if wish is not None:
            self._commanded = True
            self._vehicle.ask(wish)

    def fly(self) -> list[Pose]:
        """Fly until now, send each pose to the controller and return the poses; none before a controller comes."""
        if not self._received_s and not self._link.connected:
            return []
        if self._commanded and time.monotonic() - self._received_s > self._timeout_s:
            self._commanded = False
            self._log(f"the controller has said nothing for {self._timeout_s:g} s: hovering")
            self._vehicle.ask(self._commands.hover())
        poses = self._vehicle.fly()
        if self._link.connected:
            for pose in poses:
                fields: dict[str, Any] = state_of(pose, self._origin)
                self._link.send(make("EstimatedState", **fields), entity=1, t_s=pose.t_ns * 1e-9)
        return poses

    def close(self) -> None:
        """Hover, and let go of the vehicle."""
        self._vehicle.close()


class Flight:
    """Run the helm in a thread, so that the simulation of radars does not delay the flight.

    Args:
        helm: carries out the commands of the controller.
        link: to the controller.
    """

    def __init__(self, helm: Helm, link: Link) -> None:
        self._helm, self._link = helm, link
        self._poses: list[Pose] = []
        self._lock = threading.Condition()
        self._ending = False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="imc-flight", daemon=True)
        self._thread.start()

    def poses(self, timeout_s: float) -> list[Pose]:
        """Return the poses since the last call; wait for one until the timeout."""
        with self._lock:
            if not self._poses:
                self._lock.wait(timeout_s)
            found, self._poses = self._poses, []
        if self._error is not None:
            raise self._error
        return found

    def _run(self) -> None:
        try:
            while not self._ending and not self._link.finished:
                for packet in self._link.receive(0.01):
                    self._helm.take(packet)
                fresh = self._helm.fly()
                with self._lock:
                    self._poses += fresh
                    if fresh:
                        self._lock.notify_all()
        except BaseException as error:  # `poses` raises it
            self._error = error

    def close(self) -> None:
        """End the thread, and release the vehicle."""
        self._ending = True
        self._thread.join(3.0)
        self._helm.close()
