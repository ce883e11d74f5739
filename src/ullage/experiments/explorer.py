"""The pilot of an exploring flight: where to fly next, by poses, the map and the guard's distances alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.experiments.guarded_flight import WaypointFollower
from ullage.flight.explore import RESERVE_S, Leg, Situation, ViewPlanner, direction
from ullage.geometry import quat_matrix
from ullage.grids import OccupancyMap
from ullage.processing.obstacles import ObstacleSectors

PROBE_M = 1.6  # of a careful flight into space that only the guard knows, to give the map an aperture
LISTEN_S = 1.0  # at the start, until the guard has its first distances
STUCK_S, STUCK_M, STUCK_RAD = 3.0, 0.15, 0.3  # a vehicle that moved and turned less in so long does not get on
MOST_PROBES = 16  # of a flight, so that it ends
BARRED_M = 0.4  # about a place before which the guard stopped, and how far ahead of the vehicle that lies
LOOK_M = 0.3  # between views that count
TURNED_RAD = 0.05  # from the heading asked for, after a turn
ASIDE_M = 0.5  # from a place where the guard stopped the flight
TURN_DEG = 90.0  # on the spot, after a careful flight: four beams leave a quarter of the circle out
CRUMB_M = 0.2  # between places of the track that lead back
REPLAN_S = 2.0  # between comparisons of the goal with other views
HOVER_S = 1.0  # at home, before it lands
SINK_M_S, TOUCH_M_S, TOUCH_M = 0.5, 0.2, 0.6  # on the way down, and so slowly from this height over the ground on
SETTLED_S, SETTLED_M = 0.6, 0.05  # on the ground it sinks less in so long
LATE_S = 20.0  # a guard that stops the flight home may delay it by so long
HOLD_S = 5.0  # of hovering with poses that are not to be trusted, before it lands


class Room(NamedTuple):
    """Distances of the guard."""

    way_rad: Floats  # (k) direction of each radar, counter-clockwise from east
    free_m: Floats  # (k) to the nearest obstacle there, 0 where unknown [m]


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """Where the explorer flew next."""

    t_s: float
    leg: Leg
    position: Floats  # (3) at that time [m]


class Explorer:
    """Pilot of an exploring flight.

    Args:
        start: x, y, z [m], yaw [deg].
        time_s: of the flight, with the way home.
        speed_m_s: of the flight.
        clearance_m: from the vehicle's centre to what is not known to be free.
        drop_m: height of the start over the ground that it took off from; None: it ends hovering [m].
    """

    def __init__(
        self, start: Floats, *, time_s: float, speed_m_s: float, clearance_m: float, drop_m: float | None = None
    ) -> None:
        self._start, self._speed, self.time_s, self.clearance_m = start, speed_m_s, time_s, clearance_m
        self._drop_m, self._sunk = drop_m, (0.0, math.inf)  # when and how low it was last clearly lower
        self._landing_s = 0.0 if drop_m is None else drop_m / SINK_M_S + TOUCH_M / TOUCH_M_S + SETTLED_S
        self.landing_from_s: float | None = None
        self.landed = False
        self.decisions: list[Decision] = []
        self.ended = ""  # why the flight ended, once it has
        self.at_home = False
        self.upcoming: Leg | None = None  # where it would fly next with more time
        self.why_home = ""
        self._planner: ViewPlanner | None = None
        self._omap: OccupancyMap | None = None  # a new one
        self._leg: Leg | None = None
        self._track = [start[:2]]
        self._looked = np.full(2, np.inf)
        self._moved = 0.0, start[:2], 0.0  # when it last got on, where, and at which heading
        self._planned_s, self._home_s = 0.0, math.inf  # of the last comparison of views; when it got home
        self._lost_s: float | None = None  # since when its poses are not to be trusted; None: they are
        self._probed: list[Floats] = []  # x, y [m] and direction [rad] of each probe
        self._follower = WaypointFollower(np.array([start, start]), speed_m_s)

    @property
    def heading_rad(self) -> float:
        """Heading wanted now [rad]."""
        return self._follower.heading_rad

    @property
    def landing(self) -> bool:
        """Whether it sinks to the ground, which the guard would not let come near."""
        return self.landing_from_s is not None

    @property
    def words(self) -> str:
        """What it is doing."""
        if self.landing:
            return "landing"
        if self._lost_s is not None:
            return "hovering, as its poses are lost"
        return "looking around" if self._leg is None else self._leg.words

    def velocity(self, position: Floats) -> Floats:
        """Velocity (3) wanted at a believed position (3) [m/s]."""
        if self.landing:
            over_m = position[2] - self._start[2] + (self._drop_m or 0.0)
            return np.array([0.0, 0.0, -SINK_M_S if over_m > TOUCH_M else -TOUCH_M_S])
        if self._lost_s is not None:
            return np.zeros(3)
        return self._follower.velocity(position)

    def take_map(self, omap: OccupancyMap) -> None:
        """Take the map so far."""
        self._omap = omap

    def update(self, believed: Trajectory, sectors: ObstacleSectors, *, lost: str = "") -> None:
        """Take the pose of this moment and the guard's distances; decide where a decision is due.

        Args:
            believed: the pose.
            sectors: the guard's distances.
            lost: why the pose is not to be trusted; empty: it is.
        """
        here, now_s = believed.position[0], float(believed.t_ns[0]) * 1e-9
        if self.landing:
            self._land(here, now_s)
            return
        forward = quat_matrix(believed.quat_xyzw[0])[:, 0]
        yaw = math.atan2(forward[1], forward[0])
        if self._planner is not None and not self._planner.grid.index(here[None, :2])[1][0]:
            lost = lost or "outside the box of the world"
        if self._holds(here, now_s, yaw, lost):
            return
        if np.linalg.norm(here[:2] - self._track[-1]) >= CRUMB_M:
            self._track.append(here[:2])
        since = here[:2] - self._moved[1]
        if np.linalg.norm(since) >= STUCK_M or abs(math.remainder(yaw - self._moved[2], math.tau)) >= STUCK_RAD:
            self._moved = now_s, here[:2], yaw
        if self._planner is not None:
            self._planner.flew(here)
        if now_s > self.time_s + LATE_S:
            self._end(here, "the guard kept it from getting home")
        omap, self._omap = self._omap, None
        if omap is None or self.ended or now_s < LISTEN_S:
            return
        if self._planner is None:
            self._planner = ViewPlanner(omap.grid, self._start, clearance_m=self.clearance_m, speed_m_s=self._speed)
        if self._follower.arrived or not np.linalg.norm(here[:2] - self._looked) < LOOK_M:
            self._planner.saw(omap, here)
            self._looked = here[:2]
        ways = sectors.centre_rad + yaw
        # no echo at all may be an obstacle that a hovering radar takes for its own echo
        room_m = np.where(np.isinf(sectors.distance_m), self.clearance_m + PROBE_M, sectors.distance_m)
        room_m = np.where(sectors.valid, room_m, 0.0)
        self._decide(self._planner, self._planner.at(omap, here), here, now_s, yaw, Room(ways, room_m))

    def _holds(self, here: Floats, now_s: float, yaw: float, lost: str) -> bool:
        """Whether it hovers because its poses are not to be trusted; where they stay so, it lands."""
        if not lost:
            if self._lost_s is not None:
                self._lost_s, self._leg, self._moved = None, None, (now_s, here[:2], yaw)
            return False
        if self._lost_s is None:
            self._lost_s = now_s
            stay = np.array([*here, math.degrees(yaw)])
            self._follower = WaypointFollower(np.array([stay, stay]), self._speed)
        if now_s - self._lost_s >= HOLD_S:
            self.why_home = f"its poses were lost for {HOLD_S:g} s ({lost})"
            self._descend(here, now_s)
        return True

    def _decide(self, planner: ViewPlanner, now: Situation, here: Floats, now_s: float, yaw: float, room: Room) -> None:
        leg, done = self._leg, self._done(yaw)
        stuck = now_s - self._moved[0] > (STUCK_S / 2 if leg is not None and leg.kind == "probe" else STUCK_S)
        if leg is not None and stuck and not done and leg.kind not in ("aside", "probe"):
            self._bar(planner, leg, here)
            self._fly(self._aside(here, room), here, now_s)
            return
        if leg is not None and leg.kind == "aside" and not (done or stuck):
            return
        if self.why_home:
            self._go_on_home(planner, now, here, now_s)
            return
        home, left_s = self._way_home(planner, now), self.time_s - now_s
        left_s -= self._landing_s + HOVER_S
        if left_s <= home.travel_s + RESERVE_S:
            self._turn_home(home, planner.next_view(now, math.inf), here, now_s, why="the time was up")
            return
        free = leg is None or done or stuck
        if leg is not None and not free and (leg.kind in ("probe", "turn") or not self._due(planner, now, now_s)):
            return
        view = planner.next_view(now, left_s, kept=None if free else leg)
        if view is not None:
            self._planned_s = now_s
            if free or leg is None or not np.allclose(view.goal, leg.goal) or not planner.is_open(now, self._ahead()):
                self._fly(view, here, now_s)
        elif leg is not None and leg.kind == "probe" and not stuck:
            self._fly(Leg("turn", here[None, :2], "turning to look between the beams"), here, now_s)
        elif (probe := self._probe(planner, now, here, room)) is not None:
            self._fly(probe, here, now_s)
        else:
            upcoming = planner.next_view(now, math.inf)
            why = "nothing is left that is worth a flight"
            if upcoming is not None:
                why = f"the views left are too far away for the {left_s:.0f} s left"
            elif now.narrow:
                why = "boxed in: neither map nor guard knows room to fly"
            self._turn_home(home, upcoming, here, now_s, why=why)

    def _done(self, yaw: float) -> bool:
        """Whether the vehicle is where it was to fly, and turned as far as it was to turn."""
        turned = abs(math.remainder(yaw - self._follower.heading_rad, math.tau)) < TURNED_RAD
        return self._follower.arrived and (turned or self._leg is None or self._leg.kind != "turn")

    def _due(self, planner: ViewPlanner, now: Situation, now_s: float) -> bool:
        """Whether the goal is to be reconsidered: every two seconds, and as soon as the path there is closed."""
        return now_s - self._planned_s >= REPLAN_S or not planner.is_open(now, self._ahead())

    def _ahead(self) -> Floats:
        """Return the rest (n, 2) of the path that is flown [m]."""
        return self._follower.ahead[:, :2]

    def _bar(self, planner: ViewPlanner, leg: Leg, here: Floats) -> None:
        """Avoid the place before which the guard stopped, and the goal behind it."""
        course = self._follower.heading_rad
        planner.bar(here[:2] + 2 * BARRED_M * np.array([math.cos(course), math.sin(course)]), BARRED_M)
        if leg.kind == "view":
            planner.bar(leg.goal, BARRED_M)

    def _way_home(self, planner: ViewPlanner, now: Situation) -> Leg:
        """Return the way home on the map, or else back along the track."""
        if (leg := planner.home(now)) is not None:
            return leg
        back = np.array([now.place, *self._track[::-1]])
        return Leg("home", back, "home along the track", travel_s=planner.path_s(back))

    def _turn_home(self, home: Leg, upcoming: Leg | None, here: Floats, now_s: float, *, why: str) -> None:
        self.why_home, self.upcoming = why, upcoming
        self._fly(home, here, now_s)

    def _aside(self, here: Floats, room: Room) -> Leg:
        """Return a short flight away from what the guard stopped for."""
        course = float(room.way_rad[np.argmax(room.free_m)])
        way = ASIDE_M * np.array([math.cos(course), math.sin(course)])
        return Leg("aside", np.array([here[:2], here[:2] + way]), "stopped by the guard, and moving aside")

    def _go_on_home(self, planner: ViewPlanner, now: Situation, here: Floats, now_s: float) -> None:
        homing = self._leg is not None and self._leg.kind == "home"
        if homing and self._follower.arrived:
            self._home_s = min(self._home_s, now_s)
            if now_s - self._home_s >= HOVER_S:
                self.at_home = True
                self._descend(here, now_s)
        elif not homing or not planner.is_open(now, self._ahead()):
            self._fly(self._way_home(planner, now), here, now_s)

    def _descend(self, here: Floats, now_s: float) -> None:
        """Begin to land here, or end hovering."""
        if self._drop_m is None:
            self._end(here, self.why_home)
        else:
            self.landing_from_s, self._sunk = now_s, (now_s, float(here[2]))

    def _land(self, here: Floats, now_s: float) -> None:
        """End the flight once the vehicle sinks no more, or where no ground came."""
        if here[2] < self._sunk[1] - SETTLED_M:
            self._sunk = now_s, float(here[2])
        self.landed = now_s - self._sunk[0] >= SETTLED_S
        if self.landed or now_s - (self.landing_from_s or 0.0) > self._landing_s + LATE_S:
            self._end(here, self.why_home)

    def _probe(self, planner: ViewPlanner, now: Situation, here: Floats, room: Room) -> Leg | None:
        """Return a short flight into unknown space where the guard measures room; None: there is none, or none new."""
        done = np.array([row[2] for row in self._probed if np.linalg.norm(row[:2] - here[:2]) < PROBE_M / 4])
        tried = np.cos(room.way_rad[:, None] - done).max(1, initial=-1.0) > 0.9
        free_m, solid = planner.free_m(now, room.way_rad, PROBE_M)
        new = (free_m < PROBE_M - planner.grid.step_m) & ~solid & ~tried
        spare = np.where(new, room.free_m - self.clearance_m, 0.0)
        ahead = np.cos(room.way_rad - self.heading_rad)  # a hovering radar tells no directions; ahead needs no turn
        worth = spare + ahead + free_m
        best = int(np.argmax(np.where(spare > 0, worth, -np.inf)))
        if spare[best] <= 0 or len(self._probed) >= MOST_PROBES:
            return None
        course = float(room.way_rad[best])
        self._probed.append(np.array([*here[:2], course]))
        way = PROBE_M * np.array([math.cos(course), math.sin(course)])
        return Leg("probe", np.array([here[:2], here[:2] + way]), f"a careful {direction(way)} for a first look")

    def _fly(self, leg: Leg, here: Floats, now_s: float) -> None:
        if self._leg is None or leg.kind != self._leg.kind or not np.allclose(leg.goal, self._leg.goal):
            self._moved = now_s, here[:2], self._moved[2]
            self.decisions.append(Decision(now_s, leg, here))
        self._leg = leg
        path = np.vstack([here[:2], leg.path[1:] if len(leg.path) > 1 else leg.path])
        courses = np.diff(path, axis=0)
        known = np.linalg.norm(courses, axis=1) > 1e-6
        still = math.degrees(self.heading_rad) + (TURN_DEG if leg.kind == "turn" else 0.0)
        yaw = np.where(known, np.degrees(np.arctan2(courses[:, 1], courses[:, 0])), still)
        height_m = np.full(len(path), self._start[2])
        self._follower = WaypointFollower(np.column_stack([path, height_m, np.append(yaw[:1], yaw)]), self._speed)

    def stop(self, why: str) -> None:
        """End the flight where it is."""
        self._end(self._track[-1], why)

    def _end(self, here: Floats, why: str) -> None:
        away = "at home" if self.at_home else f"{direction(here[:2] - self._start[:2])} of home"
        place = f"on the ground {away}" if self.landed else away
        self.ended = f"{place}: {why}"
