"""The pilot of an exploring flight: where to fly next, by poses and the map alone. The guard limits its flight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.experiments.guarded_flight import WaypointFollower
from ullage.flight.explore import APERTURE_M, LEAST_GAIN_M2, RESERVE_S, Leg, Situation, ViewPlanner, direction
from ullage.geometry import quat_matrix
from ullage.grids import OccupancyMap

LISTEN_S = 1.0  # at the start, until the guard has its first distances
STUCK_S, STUCK_M = 3.0, 0.15  # a vehicle whose path became so little shorter in so long does not get on
STOPPED_M = 0.4  # about a place before which the guard stopped, and how far ahead of the vehicle it begins
LOOK_M = 0.3  # between views that count
CRUMB_M = 0.2  # between places of the track that lead back
REPLAN_S = 2.0  # between comparisons of the goal with other views
HOVER_S = 1.0  # at home, before it lands
SINK_M_S, TOUCH_M_S, TOUCH_M = 0.5, 0.2, 0.6  # on the way down, and so slowly from this height over the ground on
SETTLED_S, SETTLED_M = 0.6, 0.05  # on the ground it sinks less in so long
LATE_S = 20.0  # a guard that stops the flight home may delay it by so long
HOLD_S = 5.0  # of hovering with poses that are not to be trusted, before it lands


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
        clearance_m: from the vehicle's centre to mapped surfaces, or with `free_probability` to all not so free.
        drop_m: height of the start over the ground that it took off from; None: it ends hovering [m].
        free_probability: least probability that space on a path is free; None: paths also cross unknown space.
        free_start_m: unknown space within this distance of the start is free.
    """

    def __init__(
        self, start: Floats, *, time_s: float, speed_m_s: float, clearance_m: float, drop_m: float | None = None,
        free_probability: float | None = None, free_start_m: float = 0.0,
    ) -> None:  # fmt: skip
        self._start, self._speed, self.time_s, self.clearance_m = start, speed_m_s, time_s, clearance_m
        self.free_probability, self.free_start_m = free_probability, free_start_m
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
        self._moved = 0.0, math.inf  # when it last got on, and how far it was from its goal
        self._planned_s, self._home_s = 0.0, math.inf  # of the last comparison of views; when it got home
        self._lost_s: float | None = None  # since when its poses are not to be trusted; None: they are
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

    def update(self, believed: Trajectory, *, lost: str = "") -> None:
        """Take the pose of this moment; decide where a decision is due.

        Args:
            believed: the pose.
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
        if (left_m := self._left_m(here)) <= self._moved[1] - STUCK_M:
            self._moved = now_s, left_m
        if self._planner is not None:
            self._planner.flew(here)
        if now_s > self.time_s + LATE_S:
            self._end(here, "the guard kept it from getting home")
        omap, self._omap = self._omap, None
        if omap is None or self.ended or now_s < LISTEN_S:
            return
        if self._planner is None:
            self._planner = ViewPlanner(omap.grid, self._start, clearance_m=self.clearance_m, speed_m_s=self._speed,
                                        free_probability=self.free_probability,
                                        free_start_m=self.free_start_m)  # fmt: skip
        if self._follower.arrived or not np.linalg.norm(here[:2] - self._looked) < LOOK_M:
            self._planner.saw(omap, here)
            self._looked = here[:2]
        self._decide(self._planner, self._planner.at(omap, here), here, now_s)

    def _holds(self, here: Floats, now_s: float, yaw: float, lost: str) -> bool:
        """Whether it hovers because its poses are not to be trusted; where they stay so, it lands."""
        if not lost:
            if self._lost_s is not None:
                self._lost_s, self._leg = None, None
            return False
        if self._lost_s is None:
            self._lost_s = now_s
            stay = np.array([*here, math.degrees(yaw)])
            self._follower = WaypointFollower(np.array([stay, stay]), self._speed)
        if now_s - self._lost_s >= HOLD_S:
            self.why_home = f"its poses were lost for {HOLD_S:g} s ({lost})"
            self._descend(here, now_s)
        return True

    def _decide(self, planner: ViewPlanner, now: Situation, here: Floats, now_s: float) -> None:
        leg, stuck = self._leg, now_s - self._moved[0] > STUCK_S
        if leg is not None and stuck and not self._follower.arrived:
            course, self._moved = self._follower.heading_rad, (now_s, self._left_m(here))
            planner.stopped(here[:2] + 2 * STOPPED_M * np.array([math.cos(course), math.sin(course)]), STOPPED_M)
            now = planner.at(now.omap, here)
        if self.why_home:
            self._go_on_home(planner, now, here, now_s, stuck=stuck)
            return
        home, left_s = self._way_home(planner, now), self.time_s - now_s
        left_s -= self._landing_s + HOVER_S
        if left_s <= home.travel_s + RESERVE_S:
            self._turn_home(planner, now, here, now_s, why="the time was up")
            return
        free = leg is None or stuck or float(np.linalg.norm(leg.goal - here[:2])) < APERTURE_M
        if leg is not None and not free and not self._due(planner, now, now_s):
            return
        view = planner.next_view(now, left_s, kept=None if free else leg)
        if view is not None:
            self._planned_s = now_s
            if free or leg is None or not np.allclose(view.goal, leg.goal) or not planner.is_open(now, self._ahead()):
                self._fly(view, here, now_s)
            return
        why = "nothing is left that is worth a flight"
        if planner.next_view(now, math.inf) is not None:
            why = f"the views left are too far away for the {left_s:.0f} s left"
        elif now.narrow:
            why = f"boxed in: mapped {planner.barrier} leave no room to fly"
        self._turn_home(planner, now, here, now_s, why=why)

    def _due(self, planner: ViewPlanner, now: Situation, now_s: float) -> bool:
        """Whether the goal is to be reconsidered: every two seconds, and as soon as the path there is closed."""
        return now_s - self._planned_s >= REPLAN_S or not planner.is_open(now, self._ahead())

    def _ahead(self) -> Floats:
        """Return the rest (n, 2) of the path that is flown [m]."""
        return self._follower.ahead[:, :2]

    def _left_m(self, here: Floats) -> float:
        """Length of the path that is left [m]."""
        return float(np.linalg.norm(np.diff(np.vstack([here[:2], self._ahead()]), axis=0), axis=1).sum())

    def _way_home(self, planner: ViewPlanner, now: Situation) -> Leg:
        """Return the way home on the map, or else back along the track."""
        if (leg := planner.home(now)) is not None:
            return leg
        back = np.array([now.place, *self._track[::-1]])
        return Leg("home", back, "home along the track", travel_s=planner.path_s(back, now))

    def _turn_home(self, planner: ViewPlanner, now: Situation, here: Floats, now_s: float, *, why: str) -> None:
        self.why_home, self.upcoming = why, planner.next_view(now, math.inf)
        if (cut_m2 := planner.cut_off_m2(now)) >= LEAST_GAIN_M2:
            self.why_home += (
                f"; {cut_m2:.1f} m2 of free space could not be reached, as {planner.barrier} leave too little room"
            )
        self._fly(self._way_home(planner, now), here, now_s)

    def _go_on_home(self, planner: ViewPlanner, now: Situation, here: Floats, now_s: float, *, stuck: bool) -> None:
        homing = self._leg is not None and self._leg.kind == "home"
        if homing and self._follower.arrived:
            self._home_s = min(self._home_s, now_s)
            if now_s - self._home_s >= HOVER_S:
                self.at_home = True
                self._descend(here, now_s)
        elif not homing or stuck or not planner.is_open(now, self._ahead()):
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

    def _fly(self, leg: Leg, here: Floats, now_s: float) -> None:
        if self._leg is None or leg.kind != self._leg.kind or not np.allclose(leg.goal, self._leg.goal):
            self.decisions.append(Decision(now_s, leg, here))
        self._leg = leg
        path = np.vstack([here[:2], leg.path[1:] if len(leg.path) > 1 else leg.path])
        courses = np.diff(path, axis=0)
        known = np.linalg.norm(courses, axis=1) > 1e-6
        yaw = np.where(known, np.degrees(np.arctan2(courses[:, 1], courses[:, 0])), math.degrees(self.heading_rad))
        height_m = np.full(len(path), self._start[2])
        self._follower = WaypointFollower(np.column_stack([path, height_m, np.append(yaw[:1], yaw)]), self._speed)
        self._moved = now_s, self._left_m(here)

    def stop(self, why: str) -> None:
        """End the flight where it is."""
        self._end(self._track[-1], why)

    def _end(self, here: Floats, why: str) -> None:
        away = "at home" if self.at_home else f"{direction(here[:2] - self._start[:2])} of home"
        place = f"on the ground {away}" if self.landed else away
        self.ended = f"{place}: {why}"
