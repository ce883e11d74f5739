"""A DUNE controller flies a multirotor, simulated or external: EstimatedState goes out, commands come in.

`Commands` converts the messages of the controller to requests, as the thesis' interpreter_quadcopter: set-points,
references, and maneuvers that a multirotor can fly: by a velocity, to a place, along a straight path, or hovering
[Billdal2018, 3.5.2].
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ullage.flight.live import Steered, Wish
from ullage.ports.drone import Guided
from ullage.ports.imc.codec import NOBODY, Message, Packet, make
from ullage.ports.imc.frames import state_of
from ullage.ports.imc.link import Link
from ullage.ports.imc.options import SourceOptions
from ullage.ports.intake import PIECE_S, Inbox, Log, Once, Worker
from ullage.ports.ned import SWAP, Geodetic
from ullage.ports.pose_events import BodyState, path_along
from ullage.ports.protocol import Passing
from ullage.world.scene import Scene

DEPTH, ALTITUDE, HEIGHT = 1, 2, 3
METRES_A_SECOND = 0
FORCE_X, FORCE_Y, FORCE_Z = 1, 2, 4
SURGE, SWAY, HEAVE, YAW = 1, 2, 4, 32
FROM_START, NO_Z = 1, 4
AT_PLACE, AT_SPEED, AT_Z = 1, 2, 4
REQUEST, SUCCESS, FAILURE = 0, 1, 2
START, STOP = 0, 1
REQUESTS = {
    "VehicleCommand": ("maneuver", "command", "request_id", "calib_time"),
    "PlanControl": ("arg", "op", "request_id", "plan_id", "flags"),
}
"""Messages that ask for a maneuver: its field, the field that starts or stops it, and further fields of the answer."""
BRAKES = 1
PLACES = ("Goto", "Loiter", "StationKeeping", "StationKeepingExtended", "Takeoff")
"""Maneuvers that go to a place and hover there."""
HOVERS = ("IdleManeuver", "StopManeuver", "Teleoperation")
"""Maneuvers that hover: an operator's commands come as set-points of their own."""
MANEUVERS = (*PLACES, *HOVERS, "FollowReference")


class Commands:
    """Convert commands to requests.

    Args:
        vehicle: its position and last request complete some commands.
        origin: geodetic place of the world's origin.
        log: takes a line for a command that is not possible.
    """

    def __init__(self, vehicle: Vehicle, origin: Geodetic, log: Log) -> None:
        self._vehicle, self._origin, self._log, self._once = vehicle, origin, log, Once(log)
        self._known: dict[str, Callable[[Mapping[str, Any]], Wish | None]] = {
            "DesiredZ": self._height, "DesiredSpeed": self._speed, "DesiredVelocity": self._velocity,
            "DesiredHeading": lambda m: Wish(heading_rad=math.pi / 2 - m["value"]),
            "DesiredHeadingRate": lambda m: Wish(turn_rad_s=-m["value"]),
            "DesiredVerticalRate": lambda m: Wish(climb_m_s=m["value"]),
            "DesiredControl": self._force, "DesiredPath": self._path, "Reference": self._reference,
            "Brake": lambda m: self.hover() if m["op"] == BRAKES else None,
            "Abort": lambda m: self.hover(),
        } | dict.fromkeys(PLACES, self._place) | dict.fromkeys(HOVERS, lambda m: self.hover())  # fmt: skip

    def wish(self, packet: Packet) -> Wish | None:
        """Return the request of a message, or None if it is no valid command."""
        if packet.name == "Abort":
            self._log(f"system {packet.src:#06x} says abort: hovering")
        return self._of(packet.message)

    def answer(self, packet: Packet) -> tuple[Wish | None, Message] | None:
        """Return the request and the answer of a packet, or None if it is no request."""
        if packet.name not in REQUESTS or packet["type"] != REQUEST:
            return None
        maneuver, order, *others = REQUESTS[packet.name]
        stops = packet[order] == STOP
        known = stops or packet[order] == START
        wish, wrong = self._started(None if stops else packet[maneuver]) if known else (None, "not supported")
        same = {key: packet[key] for key in (order, *others)}
        return wish, make(packet.name, type=FAILURE if wrong else SUCCESS, info=wrong, **same)

    def _started(self, maneuver: Message | None) -> tuple[Wish | None, str]:
        """Return the request of a maneuver (None: hover), and why it is not possible."""
        if maneuver is None or maneuver.name == "FollowReference":
            return self.hover(), ""
        if maneuver.name not in MANEUVERS:
            return None, f"a multirotor of ullage does not fly {maneuver.name or 'this'}: {', '.join(MANEUVERS)}"
        wish = self._of(maneuver)
        return wish, "" if wish is not None else f"{maneuver.name} has no use here"

    def _of(self, message: Message) -> Wish | None:
        numbers = [value for value in message.values.values() if isinstance(value, float)]
        if message.name not in self._known or not all(map(math.isfinite, numbers)):
            return None
        return self._known[message.name](message.values)

    def hover(self) -> Wish:
        """Stay here."""
        here = self._vehicle.position
        return Wish(height_m=None if here is None else float(here[2]), velocity_m_s=(0.0, 0.0), turn_rad_s=0.0)

    def _metres_a_second(self, m: Mapping[str, Any], key: str) -> float | None:
        if m["speed_units"] != METRES_A_SECOND:
            self._once(f"{key} is taken in m/s only")
            return None
        return float(m["value" if key == "DesiredSpeed" else "speed"])

    def _speed(self, m: Mapping[str, Any]) -> Wish | None:
        """Read a forward speed, or the greatest speed towards a goal."""
        speed = self._metres_a_second(m, "DesiredSpeed")
        if speed is None:
            return None
        if self._vehicle.wish.position_m is not None and speed > 0:
            return Wish(speed_m_s=speed)
        return Wish(velocity_m_s=(speed, 0.0))

    def _velocity(self, m: Mapping[str, Any]) -> Wish:
        flags = m["flags"]
        return Wish(
            velocity_m_s=(m["u"] if flags & SURGE else 0.0, -m["v"] if flags & SWAY else 0.0),
            climb_m_s=-m["w"] if flags & HEAVE else None,
            turn_rad_s=-m["r"] if flags & YAW else None,
        )

    def _force(self, m: Mapping[str, Any]) -> Wish | None:
        flags = m["flags"]
        if not flags & (FORCE_X | FORCE_Y | FORCE_Z):
            return None
        signs = ((FORCE_X, "x", 1), (FORCE_Y, "y", -1), (FORCE_Z, "z", -1))
        forward, left, up = (sign * m[key] if flags & flag else 0.0 for flag, key, sign in signs)
        return Wish(force_n=(forward, left, up))

    def _metres_up(self, value: float, units: int) -> float | None:
        """The z in the world of a height over the ellipsoid, an altitude over the ground, or a depth."""
        return {HEIGHT: value - self._origin.height_m, ALTITUDE: value, DEPTH: -value}.get(units)

    def _height(self, m: Mapping[str, Any]) -> Wish | None:
        """Read a height, or the height of the present goal."""
        up, goal = self._metres_up(m["value"], m["z_units"]), self._vehicle.wish.position_m
        if up is None or goal is None:
            return None if up is None else Wish(height_m=up)
        return Wish(position_m=(goal[0], goal[1], up), speed_m_s=self._vehicle.wish.speed_m_s)

    def _point(self, lat: float, lon: float, up: float | None) -> tuple[float, float, float]:
        """A place in the world; without a height, as high as the last one asked for, or as now."""
        there = Geodetic(lat, lon, self._origin.height_m).earth_centred - self._origin.earth_centred
        east, north, _ = (float(v) for v in SWAP @ self._origin.earth_from_ned.T @ there)
        if up is None:
            wish, here = self._vehicle.wish, self._vehicle.position
            last = wish.position_m[2] if wish.position_m is not None else wish.height_m
            up = last if last is not None else 0.0 if here is None else float(here[2])
        return east, north, up

    def _place(self, m: Mapping[str, Any]) -> Wish:
        where = self._point(m["lat"], m["lon"], self._metres_up(m["z"], m["z_units"]))
        return Wish(position_m=where, speed_m_s=self._metres_a_second(m, "speed") or None)

    def _path(self, m: Mapping[str, Any]) -> Wish:
        """The straight path of a DesiredPath; it begins here unless the message says where."""
        level = bool(m["flags"] & NO_Z)
        end = self._point(m["end_lat"], m["end_lon"], None if level else self._metres_up(m["end_z"], m["end_z_units"]))
        if m["flags"] & FROM_START:
            up = end[2] if level else self._metres_up(m["start_z"], m["start_z_units"])
            start: tuple[float, float, float] | None = self._point(m["start_lat"], m["start_lon"], up)
        else:
            here = self._vehicle.position
            start = None if here is None else (float(here[0]), float(here[1]), float(here[2]))
        return Wish(position_m=end, from_m=start, speed_m_s=self._metres_a_second(m, "speed") or None)

    def _reference(self, m: Mapping[str, Any]) -> Wish | None:
        """A Reference: a place, a height and a speed, each where its flag is set."""
        flags, last = m["flags"], self._vehicle.wish
        z, speed = m["z"] if flags & AT_Z else None, m["speed"] if flags & AT_SPEED else None
        up = None if z is None else self._metres_up(z["value"], z["z_units"])
        most = None if speed is None else self._metres_a_second(speed.values, "DesiredSpeed") or None
        if flags & AT_PLACE:
            return Wish(position_m=self._point(m["lat"], m["lon"], up), speed_m_s=most or last.speed_m_s)
        if up is not None and last.position_m is not None:
            return Wish(position_m=(*last.position_m[:2], up), speed_m_s=most or last.speed_m_s)
        return Wish(height_m=up) if up is not None else Wish(speed_m_s=most) if most else None


class Simulated(Steered):
    """Our own multirotor, flown in wall time from the first call on.

    Args:
        name: of the vehicle.
        scene: what can be hit; None: free space.
        start: where it hovers at first: x, y, z [m], and yaw [deg] or not.
        rate_hz: poses a second of flight.
        pace: times real time.
        log: takes a line when it hits something.
    """

    def __init__(
        self, name: str, *, scene: Scene | None, start: tuple[float, ...], rate_hz: float, pace: float, log: Log
    ) -> None:
        super().__init__(name, scene=scene, start=start)
        self._once, self._pace = Once(log), pace
        self._period_ns = round(1e9 / rate_hz)
        self._begun: float | None = None
        self._count = 0
        self._epoch_ns = time.time_ns()

    def fly(self) -> list[BodyState]:
        """Fly until now, and return the poses since the last call."""
        now = time.monotonic()
        if self._begun is None:
            self._begun = now
        due_ns = int((now - self._begun) * self._pace * 1e9)
        out: list[BodyState] = []
        while (self._count + 1) * self._period_ns <= due_ns:
            self._count += 1
            self.advance(self._count * self._period_ns)
            t_ns = self._epoch_ns + self.t_ns
            out.append(BodyState(t_ns, self.position, self.quat_xyzw, self.velocity, self.spin))
            if len(out) >= 50:  # first handle commands that came meanwhile
                break
        if self.touched:
            self._once("the vehicle hit something")
        return out

    def close(self) -> None:
        """Do nothing."""


Vehicle = Simulated | Guided
"""A multirotor that can be flown: ours, or one of others."""


class Helm:
    """Fly a vehicle as a controller on the bus commands, in a thread that no simulation of radars delays.

    The multirotor takes the address of the first peer that sends a message, because DUNE's controllers use only the
    EstimatedState of their own system. When the controller falls silent, the vehicle hovers.

    Args:
        vehicle: the multirotor.
        link: to the controller.
        origin: geodetic place of the world's origin.
        options: rate of EstimatedState, and the silence after which the vehicle hovers.
        log: takes a line for a command that is not possible.
        take: called with each packet of the controller.
        passing: gets the path at once.
    """

    def __init__(
        self, vehicle: Vehicle, link: Link, origin: Geodetic, options: SourceOptions, *, log: Log,
        take: Callable[[Packet], None], passing: Passing,
    ) -> None:  # fmt: skip
        self._vehicle, self._link, self._origin, self._log = vehicle, link, origin, log
        self._take, self._passing = take, passing
        self._commands = Commands(vehicle, origin, log)
        self._timeout_s, self._period_ns = options.timeout_s, round(1e9 / options.state_hz)
        self._received_s, self._last_ns = 0.0, 0
        self._commanded = self._adopted = self._ending = False
        self.inbox: Inbox[BodyState] = Inbox(link.counters)
        self._worker = Worker(self._run, "imc-flight")
        self._worker.start()

    def poses(self, timeout_s: float) -> list[BodyState]:
        """Return the poses that wait, at most those of `PIECE_S`; wait for one until the timeout."""
        found: list[BodyState] = []
        while (pose := self.inbox.get(0.0 if found else timeout_s)) is not None:
            found.append(pose)
            if pose.t_ns - found[0].t_ns >= PIECE_S * 1e9:
                break
        self._worker.check()
        return found

    def _run(self) -> None:
        while not self._ending and not self._link.finished:
            for packet in self._link.arriving(0.01):
                self._carry_out(packet)
                self._take(packet)
            if fresh := self._fly():
                self._passing.give(partial(map, path_along, [fresh]))
            for pose in fresh:
                self.inbox.put(pose, topic="flight")

    def _carry_out(self, packet: Packet) -> None:
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

    def _fly(self) -> list[BodyState]:
        """Fly until now, send each pose to the controller and return the poses; none before a controller comes."""
        if not self._received_s and not self._link.connected:
            return []
        if self._commanded and time.monotonic() - self._received_s > self._timeout_s:
            self._commanded = False
            self._log(f"the controller has said nothing for {self._timeout_s:g} s: hovering")
            self._vehicle.ask(self._commands.hover())
        poses = []
        for pose in self._vehicle.fly():
            if pose.t_ns - self._last_ns < 0.9 * self._period_ns:
                continue  # a drone of others may come faster
            self._last_ns = pose.t_ns
            poses.append(pose)
            if self._link.connected:
                fields: dict[str, Any] = state_of(pose, self._origin)
                self._link.send(make("EstimatedState", **fields), entity=1, t_s=pose.t_ns * 1e-9)
        return poses

    def close(self) -> None:
        """End the thread, hover, and release the vehicle."""
        self._ending = True
        self._worker.join(3.0)
        self._vehicle.close()
