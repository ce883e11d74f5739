"""A DUNE controller at the helm of ullage's multirotor: EstimatedState goes out, what it desires comes in."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from ullage.flight.live import Steered, Wish
from ullage.ports.imc.codec import Packet, make
from ullage.ports.imc.link import Link
from ullage.ports.imc.places import Geodetic, Pose, state_of

DEPTH, ALTITUDE, HEIGHT = 1, 2, 3
METRES_A_SECOND = 0
FORCE_X, FORCE_Y, FORCE_Z = 1, 2, 4
SURGE, SWAY = 1, 2


class Helm:
    """Flies the vehicle in the wall's time and takes what a controller asks of it.

    The multirotor is the vehicle: it takes the address of the first peer that speaks, for DUNE's controllers listen to
    the EstimatedState of their own system alone.

    Args:
        vehicle: the multirotor.
        link: to the controller.
        origin: where the world lies.
        rate_hz: EstimatedStates a second [Hz].
        pace: times real time.
        say: told of what cannot be done.
    """

    def __init__(
        self, vehicle: Steered, link: Link, *, origin: Geodetic, rate_hz: float, pace: float,
        say: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._vehicle, self._link, self._origin, self._say = vehicle, link, origin, say
        self._period_ns, self._pace = round(1e9 / rate_hz), pace
        self._told: set[str] = set()
        self._begun: float | None = None
        self._count = 0  # of states told
        self._epoch_ns = time.time_ns()
        self._adopted = False

    def take(self, packet: Packet) -> None:
        """Do what this message asks for."""
        if not self._adopted and packet.name in ("Heartbeat", "Announce"):
            self._adopted, self._link.me.system_id, self._link.me.shared = True, packet.src, True
        wish = self._wish(packet)
        if wish is not None:
            self._vehicle.ask(wish)

    def _wish(self, packet: Packet) -> Wish | None:
        """What a message of a controller asks for; None where it is another, or makes no sense."""
        known: dict[str, Callable[[Packet], Wish | None]] = {
            "DesiredZ": self._height, "DesiredSpeed": self._speed, "DesiredHeading": self._heading,
            "DesiredVelocity": self._velocity, "DesiredControl": self._force, "Abort": self._abort,
        }  # fmt: skip
        if packet.name not in known or not all(math.isfinite(value) for value in packet.message.values.values()):
            return None
        return known[packet.name](packet)

    def _speed(self, packet: Packet) -> Wish | None:
        if packet["speed_units"] != METRES_A_SECOND:
            self._once("speed", "DesiredSpeed is taken in m/s only")
            return None
        return Wish(velocity_m_s=(packet["value"], 0.0))

    def _heading(self, packet: Packet) -> Wish:
        return Wish(heading_rad=math.pi / 2 - packet["value"])

    def _velocity(self, packet: Packet) -> Wish:
        flags = packet["flags"]
        return Wish(velocity_m_s=(packet["u"] if flags & SURGE else 0.0, -packet["v"] if flags & SWAY else 0.0))

    def _force(self, packet: Packet) -> Wish | None:
        flags = packet["flags"]
        if not flags & (FORCE_X | FORCE_Y | FORCE_Z):
            return None
        signs = ((FORCE_X, "x", 1), (FORCE_Y, "y", -1), (FORCE_Z, "z", -1))
        forward, left, up = (sign * packet[key] if flags & flag else 0.0 for flag, key, sign in signs)
        return Wish(force_n=(forward, left, up))

    def _abort(self, packet: Packet) -> Wish:
        self._say(f"system {packet.src:#06x} says abort: hovering")
        return Wish(height_m=float(self._vehicle.position[2]), velocity_m_s=(0.0, 0.0))

    def _height(self, packet: Packet) -> Wish | None:
        units, value = packet["z_units"], packet["value"]
        if units == HEIGHT:
            return Wish(height_m=value - self._origin.height_m)
        if units == ALTITUDE:
            return Wish(height_m=value)
        if units == DEPTH:
            return Wish(height_m=-value)
        return None

    def _once(self, key: str, text: str) -> None:
        if key not in self._told:
            self._told.add(key)
            self._say(text)

    def fly(self) -> list[Pose]:
        """The poses until now, each told to the controller as well."""
        if not self._link.connected:
            return []
        now = time.monotonic()
        if self._begun is None:
            self._begun = now
        due_ns = int((now - self._begun) * self._pace * 1e9)
        out: list[Pose] = []
        v = self._vehicle
        while (self._count + 1) * self._period_ns <= due_ns:
            self._count += 1
            v.advance(self._count * self._period_ns)
            pose = Pose(self._epoch_ns + v.t_ns, v.position, v.quat_xyzw, v.velocity, v.spin)
            fields: dict[str, Any] = state_of(pose, self._origin)
            self._link.send(make("EstimatedState", **fields), entity=1, t_s=pose.t_ns * 1e-9)
            out.append(pose)
            if len(out) >= 50:  # what was asked meanwhile is heard before the flight goes on
                break
        if v.touched:
            self._once("touched", "the vehicle hit something")
        return out


class Flight:
    """Keeps the helm going in the background, so that no simulation of radars holds up the flight.

    Args:
        helm: at which the controller stands.
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
        """The poses since the last call; waits for one at most so long."""
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
        except BaseException as error:  # whoever asks for poses is told
            self._error = error

    def close(self) -> None:
        """Land: end the thread."""
        self._ending = True
        self._thread.join(3.0)
