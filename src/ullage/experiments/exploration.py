"""A vehicle that explores a world by its radars: the loop of vehicle, radars and guard, the mapper, and a view planner.

The planner gets poses, the map and the guard's distances, never the world. The box of the world bounds the map, as the
fence that a person draws around a flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ullage import checks
from ullage.arrays import Floats
from ullage.config import Scenario
from ullage.data import Frames, Trajectory, gathered, strung
from ullage.experiments.guarded_flight import Believe, Loop, WaypointFollower
from ullage.experiments.simulated import radars_and_world, waypoints_of
from ullage.flight.airframe import airframe
from ullage.flight.explore import RESERVE_S, Leg, Situation, ViewPlanner, direction
from ullage.flight.vehicle import check_clear
from ullage.flow import Sink
from ullage.geometry import quat_matrix, rpy_quat
from ullage.grids import OccupancyMap
from ullage.pipeline import LOGGER
from ullage.processing.obstacles import ObstacleSectors
from ullage.specs import Rig
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

PIECE_S = 0.5
"""Between two maps, and so between two decisions."""
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
        return "looking around" if self._leg is None else self._leg.words

    def velocity(self, position: Floats) -> Floats:
        """Velocity (3) wanted at a believed position (3) [m/s]."""
        if self.landing:
            over_m = position[2] - self._start[2] + (self._drop_m or 0.0)
            return np.array([0.0, 0.0, -SINK_M_S if over_m > TOUCH_M else -TOUCH_M_S])
        return self._follower.velocity(position)

    def take_map(self, omap: OccupancyMap) -> None:
        """Take the map so far."""
        self._omap = omap

    def update(self, believed: Trajectory, sectors: ObstacleSectors) -> None:
        """Take the pose of this moment and the guard's distances; decide where a decision is due."""
        here, now_s = believed.position[0], float(believed.t_ns[0]) * 1e-9
        forward = quat_matrix(believed.quat_xyzw[0])[:, 0]
        yaw = math.atan2(forward[1], forward[0])
        if np.linalg.norm(here[:2] - self._track[-1]) >= CRUMB_M:
            self._track.append(here[:2])
        since = here[:2] - self._moved[1]
        if np.linalg.norm(since) >= STUCK_M or abs(math.remainder(yaw - self._moved[2], math.tau)) >= STUCK_RAD:
            self._moved = now_s, here[:2], yaw
        if self.landing:
            self._land(here, now_s)
            return
        if self._planner is not None and not self._planner.grid.index(here[None, :2])[1][0]:
            self.why_home = "its poses left the box of the world"
            self._descend(here, now_s)
            return
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

    def _end(self, here: Floats, why: str) -> None:
        away = "at home" if self.at_home else f"{direction(here[:2] - self._start[:2])} of home"
        place = f"on the ground {away}" if self.landed else away
        self.ended = f"{place}: {why}"


class Exploration:
    """A flight that explores, as a source of frames; as a sink it takes the maps that its pilot decides by.

    Args:
        loop: vehicle, radars and guard.
        start: x, y, z [m], yaw [deg].
        time_s: of the flight, with the way home.
        report_progress: called with what the vehicle is doing, in words.
    """

    def __init__(
        self, loop: Loop, start: Floats, *, time_s: float, report_progress: Callable[[str], None] | None = None
    ) -> None:
        plan = loop.scenario.flight
        self.loop, self.start, self.report_progress = loop, start, report_progress
        clearance_m = airframe(plan.vehicle).radius_m + plan.guard.margin_m
        self.pilot = Explorer(start, time_s=time_s, speed_m_s=plan.speed_m_s, clearance_m=clearance_m,
                              drop_m=_height_over_ground(loop.scene, start))  # fmt: skip
        self.maps = MapFeed(self.pilot)
        self._flown: list[Trajectory] = []
        self._believed: list[Trajectory] = []
        self.states: list[str] = []  # of the guard

    def stream(self) -> Iterator[dict[str, Frames]]:
        """Give the frames of each radar, piece by piece, until the flight has ended."""
        held: list[dict[str, Frames]] = []
        most = max(round(PIECE_S * self.loop.rate_hz), 1)
        for now in self.loop.steps(self.pilot, self.start, longest_s=self.pilot.time_s + 2 * LATE_S):
            self._flown.append(now.truth)
            self._believed.append(now.believed)
            self.states.append(now.step.limit.state)
            held.append(now.frames)
            self.pilot.update(now.believed, now.step.sectors)
            if len(held) == most or self.pilot.ended:
                yield gathered(held)
                held = []
                if self.report_progress is not None:
                    self.report_progress(f"{self.maps.words}; {self.pilot.words}")
            if self.pilot.ended:
                return

    @property
    def first(self) -> Trajectory:
        """Its start, as a path of one pose."""
        quat = rpy_quat(0.0, 0.0, np.radians(self.start[3:]))
        return Trajectory(np.zeros(1, np.int64), self.start[None, :3], quat)

    @property
    def clearance_m(self) -> float:
        """Least distance of planned paths from the vehicle's centre to what is not known to be free [m]."""
        return self.pilot.clearance_m

    def summary(self) -> str:
        """Return how the flight ended and where it would go on, in one sentence."""
        ended, onward = self.pilot.ended or "by hand", self.pilot.upcoming
        if onward is None:
            return f"The flight ended {ended}."
        x, y = onward.goal
        return f"The flight ended {ended}. Next it would fly to ({x:.1f}, {y:.1f}) m, to learn {onward.gain_m2:.1f} m2."

    @property
    def flown(self) -> Trajectory:
        """True path of the body so far."""
        return strung(self._flown)

    @property
    def aloft(self) -> Trajectory:
        """The same before it lands."""
        flown, end_s = self.flown, self.pilot.landing_from_s
        return flown if end_s is None else flown[flown.t_ns <= end_s * 1e9]

    @property
    def contacts(self) -> tuple[tuple[float, str, float], ...]:
        """Time [s], object, speed [m/s] of each contact before it lands: from then on the ground is touched."""
        end_s = self.pilot.landing_from_s
        return tuple(one for one in self.loop.contacts if end_s is None or one[0] < end_s)

    @property
    def believed(self) -> Trajectory:
        """The same as navigation has it."""
        return strung(self._believed)


def prepare(
    scenario: Scenario, *, time_s: float, height_m: float | None = None, scene: Scene | None = None,
    poses: Believe | None = None, report_progress: Callable[[str], None] | None = None,
    log: Callable[[str], None] = LOGGER.info,
) -> Exploration:  # fmt: skip
    """Get an exploring flight ready in the world of a scenario, from its first waypoint on.

    Args:
        scenario: world, radars, vehicle, guard and speed.
        time_s: of the flight, with the way home [s].
        height_m: of the flight, over the world's zero [m]; None: that of the first waypoint.
        scene: its world, if it is loaded already.
        poses: gives the believed poses; None: the scenario's navigation, which is exact by default.
        report_progress: called with what the vehicle is doing, in words.
        log: called with a change of the radars.

    Raises:
        InputError: the world, the start or the radars cannot be used, or a number is out of bounds.
    """
    checks.number("time_s", time_s, "explore", above=0.0, allowed="> 0")
    rig, scene = radars_and_world(scenario, scene)
    if longer := _without_folds(scenario, rig, scene):
        scenario = scenario.but(sensing=scenario.sensing.but(changes=scenario.sensing.changes | longer))
        rig, scene = radars_and_world(scenario, scene)
        log(f"the world is longer than the radars' unambiguous range, so they take {longer}")
    first = np.array(waypoints_of(scenario.flight, scenario.world, scene)[0], float)
    start = np.append(first, np.zeros(4 - len(first)))
    if height_m is not None:
        start[2] = checks.number("height_m", height_m, "explore")
    rate_hz = scenario.sensing.rate_hz or next(iter(rig.sensors.values())).fps
    check_clear(start, scenario.flight.vehicle, scene)
    loop = Loop(scenario, scene, rig, rate_hz, poses=poses)
    return Exploration(loop, start, time_s=time_s, report_progress=report_progress)


def _without_folds(scenario: Scenario, rig: Rig, scene: Scene) -> dict[str, int]:
    """Return changes of the radars in whose pulse interval the world fits; none where it does, or they are set."""
    longest_m = float(np.ptp(scene.bounds, axis=0).max())
    some = next(iter(rig.sensors.values()))
    times = 1 << max(math.ceil(math.log2(longest_m / some.unambiguous_range_m)), 0)
    if times == 1 or scenario.sensing.is_declared or {"prf_div", "stagger_div"} & scenario.sensing.changes.keys():
        return {}
    return {"prf_div": some.prf_div * times, "iterations": max(some.iterations // times, 1)}


@dataclass(slots=True)
class MapFeed(Sink):
    """Sink that hands each new map to the pilot."""

    pilot: Explorer
    words: str = "no map yet"

    def write(self, item: Any) -> None:
        """Take a map; everything else passes by."""
        if isinstance(item, OccupancyMap):
            self.pilot.take_map(item)
            area = item.grid.step_m**2
            self.words = (
                f"{item.free.sum() * area:.0f} m2 free, {item.occupied.sum() * item.grid.step_m:.0f} m of surface"
            )


def _height_over_ground(scene: Scene, start: Floats) -> float | None:
    """Return the height [m] of the start over what is below it; None: nothing is."""
    away_m = float(Raycaster(scene).distances(start[None, :3], np.array([[0.0, 0.0, -1.0]]))[0])
    return away_m if math.isfinite(away_m) else None
