"""Command a DUNE vehicle by references while it follows them: the maneuver FollowReference of IMC [MartinsEtAl2009]."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ullage.flight.pilot import Velocity
from ullage.ports.drone import Drone
from ullage.ports.imc.assemble import Track
from ullage.ports.imc.backseat import Follow
from ullage.ports.imc.link import leave, open_link
from ullage.ports.imc.options import VehicleOptions
from ullage.ports.imc.wires import Entity, Identity
from ullage.ports.intake import warn
from ullage.ports.pose_events import BodyState

EXECUTING = 3
"""State of PlanControlState."""
LEAST_M_S = 0.1
"""Least speed to a place, for a vehicle that holds its place also needs one."""


class ImcDrone(Drone):
    """A vehicle that follows references. It is no longer ours once its plan ends, or another one runs.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: which vehicle, and how.

    Raises:
        InputError: the place or an option is not valid.
    """

    settings = VehicleOptions
    takes = ("pose",)
    refusal = "a vehicle that follows references takes no velocities"

    def __init__(self, place: str, options: VehicleOptions) -> None:
        me = Identity(options.system_id, options.name, entities=[Entity(1, options.name, "ullage")])
        self._link = open_link(place, options, me, role="source", log=warn)
        super().__init__(options.state, self._link.counters)
        self._track = Track(self.counters, state=options.state, origin=options.place(), vehicle=options.vehicle)
        self._follow = Follow(self._link, z=options.z, radius_m=1.0, log=warn)
        self._limit_m_s, self._plan = options.limit_m_s, ""  # why its plan is not ours
        self._runs = False  # our plan was reported to run

    @property
    def away(self) -> str:  # type: ignore[override]
        """Why it does not follow references."""
        return self._plan or ("" if self._follow.accepted else "the vehicle has not accepted the plan yet")

    @property
    def broken(self) -> str:  # type: ignore[override]
        """Whether it refused."""
        return "the vehicle does not follow" if self._follow.refused else ""

    def _arrived(self) -> Iterator[BodyState]:
        for packet in self._link.arriving(0.0):
            self._follow.take(packet)
            if packet.src == self._follow.vehicle and packet.name == "PlanControlState":
                ours = packet["plan_id"] == "ullage" and packet["state"] == EXECUTING
                self._runs = self._runs or ours
                self._plan = "" if ours or not self._runs else "another plan runs, or none: the operator took over"
            elif packet.src == self._follow.vehicle and packet.name == "Abort":
                self._plan = "the operator aborted"
            for found in self._track.take(packet):
                self._follow.vehicle = self._track.followed
                yield found.item

    def steer(self, velocity: Velocity) -> None:
        """Let it hover where it is: it takes no velocities."""
        if self._last is not None:
            x, y, z = (float(value) for value in self._last.position)
            self.go_to((x, y, z), 0.0)

    def go_to(self, position: tuple[float, float, float], heading_rad: float) -> None:
        """Send a reference, as fast as the place is away; a vehicle turns towards it by itself."""
        if self._last is None or self._track.origin is None or self._follow.refused:
            return
        self._follow.start()
        away_m = float(np.linalg.norm(np.array(position) - self._last.position))
        self._follow.refer(position, min(max(away_m, LEAST_M_S), self._limit_m_s), self._track.origin)

    def hold(self) -> None:
        """Stop the plan: DUNE holds the vehicle as its configuration says."""
        self._follow.stop()

    def close(self) -> None:
        """Leave the bus after the last messages were sent."""
        self._link.flush(1.0)
        leave(self._link, "source")
