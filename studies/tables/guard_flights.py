"""Fly seeded flights at obstacles with and without the guard: a row a flight, and a Markdown table by kind.

    python -m studies.tables.guard_flights --count 14 [--kind wire --kind pole] [--first 0] [--stagger] [--to FILE.csv]
    python -m studies.tables.guard_flights --table-only --to guard_flights.csv

The hall is a steel tunnel 30 m long, 9 m wide and 5 m high, open at its ends. The kind far_wall closes it 12 m ahead,
beyond the range at which echoes fold (9.87 m).
The seed decides the obstacle, the speed (0.3 to 1 m/s), the place and the angle. Rows go to a CSV file as they are
flown. Rows that it holds already are not flown again, so the command continues where it was stopped. `echo_db` is the
level over noise of the obstacle alone, at the distance where braking must begin. The guard never gets the truth.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import ullage as ul
from ullage.arrays import Bools, Floats, Ints
from ullage.config import make_scenario
from ullage.data import Frames, Trajectory, even_times
from ullage.experiments.guarded_flight import GuardedFlight, Loop, Step, WaypointFollower
from ullage.flight.airframe import airframe
from ullage.flight.live import Steered, Wish
from ullage.flight.obstacles import Body, bodies, into
from ullage.geometry import apply, transform
from ullage.processing.braking import stopping_distance
from ullage.world import shapes
from ullage.world.scene import Scene

RATE_HZ, HALL_M = 10.0, (30.0, 9.0, 5.0)
HULL = airframe("hector")
VISIBLE_DB = 16.0
"""OS-CFAR at a false alarm probability of 1e-4 finds a steady echo of this level in nearly every frame."""
FIELDS = ("kind", "seed", "guard", "speed_m_s", "echo_db", "hit", "impact_m_s", "closest_m", "stops", "false_stops",
          "arrived", "flight_s", "cpu_s")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One flight: the obstacle in a hall, the straight path along +x, and what is unusual about it."""

    obstacle: Scene
    speed_m_s: float
    end_m: float = 1.5  # the path ends so far past the origin, where the obstacle is
    start_m: float = 4.0  # and begins so far before it
    bounces: int = 1
    noise: float = 1.0
    radar: dict[str, Any] = field(default_factory=dict)  # changes of every radar
    lost_at_s: float = math.inf
    flight: dict[str, Any] = field(default_factory=dict)


def placed(mesh: tuple[Floats, Ints], at: Floats, rpy_deg: tuple[float, float, float], **given: Any) -> Scene:
    """A steel object at a place, turned by roll, pitch and yaw [deg]."""
    return Scene.of_mesh(apply(transform(at, np.radians(rpy_deg)), mesh[0]), mesh[1], name="obstacle", **given)


def wall(angle_deg: float, x_m: float = 0.0) -> Scene:
    """A wall 4 m wide and 3 m high, turned about the vertical; at 0 deg the path meets it head-on."""
    return placed(shapes.box((0.1, 4.0, 3.0)), np.array([x_m + 0.05, 0.0, 0.0]), (0, 0, angle_deg))


def rod(radius_m: float, at: Floats, along: Floats) -> Scene:
    """A steel rod, pipe or wire of 3 m length through a place."""
    half = 1.5 * along / np.linalg.norm(along)
    return Scene.of_wires(at - half, at + half, radius_m, name="obstacle")


def pipe(radius_m: float, at: Floats, rpy_deg: tuple[float, float, float]) -> Scene:
    """A meshed steel pipe of 3 m length, upright without a turn."""
    return placed(shapes.cylinder(radius_m, 3.0, segment_m=radius_m / 3), at, rpy_deg)


def offset(draw: np.random.Generator, most_m: float = 0.3) -> Floats:
    """Where an obstacle is across the path."""
    return np.array([0.0, draw.uniform(-most_m, most_m), 0.0])


def case_head_on(draw: np.random.Generator, speed: float) -> Case:
    return Case(wall(draw.uniform(-10, 10)), speed)


def case_grazing(draw: np.random.Generator, speed: float) -> Case:
    return Case(wall(draw.choice([-1, 1]) * draw.uniform(55, 75)), speed)


def case_corner(draw: np.random.Generator, speed: float) -> Case:
    angle = draw.uniform(30, 60)
    return Case(Scene.union([wall(angle), wall(angle - 90)]), speed)


def case_pipe(draw: np.random.Generator, speed: float) -> Case:
    turn = (draw.uniform(-90, 90), 0.0, draw.uniform(-20, 20))
    return Case(pipe(0.05, offset(draw), turn), speed)


def case_pole(draw: np.random.Generator, speed: float) -> Case:
    return Case(rod(0.01, offset(draw), np.array([0, 0, 1.0])), speed)


def case_wire(draw: np.random.Generator, speed: float) -> Case:
    roll, yaw = np.radians([draw.uniform(-90, 90), draw.uniform(-30, 30)])
    at = np.array([0.0, draw.uniform(-0.2, 0.2), draw.uniform(-0.08, 0.08)])
    along = np.array([math.sin(yaw) * math.sin(roll), math.cos(yaw) * math.sin(roll), math.cos(roll)])
    return Case(rod(0.0015, at, along), speed)


def case_wire_end_on(draw: np.random.Generator, speed: float) -> Case:
    yaw, pitch = np.radians(draw.uniform(-8, 8, 2))
    along = np.array([math.cos(yaw), math.sin(yaw), math.sin(pitch)])
    return Case(rod(0.0015, 1.5 * along, along), speed)


def case_tilted_plate(draw: np.random.Generator, speed: float) -> Case:
    tilt = draw.choice([-1, 1]) * draw.uniform(20, 50)
    return Case(placed(shapes.plane((0.8, 0.8), normal=(1, 0, 0)), offset(draw, 0.1), (0, tilt, 0)), speed)


def case_person(draw: np.random.Generator, speed: float) -> Case:
    """A body of 0.22 m radius crosses the path just when the drone comes, or walks towards it and halts."""
    mesh = shapes.cylinder(0.22, 1.8, segment_m=0.05)
    pace, t_s = draw.uniform(0.5, 1.2), np.arange(0, 30, 0.1)
    meet_s = 4.0 / speed + draw.uniform(-0.5, 0.5)
    zero = np.zeros_like(t_s)
    if draw.random() < 0.5:
        place = np.stack([zero, draw.choice([-1, 1]) * np.clip((t_s - meet_s) * pace, -4, 4), zero - 0.3], 1)
    else:
        place = np.stack([np.clip(3.5 - pace * t_s, -0.5, 3.5), zero + draw.uniform(-0.2, 0.2), zero - 0.3], 1)
    level = np.tile([0, 0, 0, 1.0], (len(t_s), 1))
    motion = Trajectory(even_times(10.0, count=len(t_s)), place, level)
    return Case(Scene.of_mesh(*mesh, name="obstacle", material="human", motion=motion), speed, end_m=2.5)


def case_passage(draw: np.random.Generator, speed: float) -> Case:
    """Two walls of 1.2 m width with a gap of 1.6 to 2 m: the hull, the margin on both sides, and a little more."""
    gap = draw.uniform(1.6, 2.0)
    sides = [placed(shapes.box((0.2, 1.2, 3.0)), np.array([0.0, s * (gap / 2 + 0.6), 0.0]), (0, 0, 0)) for s in (-1, 1)]
    return Case(Scene.union(sides), speed)


def case_far_wall(draw: np.random.Generator, speed: float) -> Case:
    """A wall 12 m before the start, whose echo folds to 2.1 m: no radar of one pulse rate can tell."""
    return Case(placed(shapes.box((0.1, 9.0, 5.0)), np.array([8.0, 0.0, 0.0]), (0, 0, 0)), speed, 2.0)


def case_far_wall_slow(draw: np.random.Generator, speed: float) -> Case:
    """The same with a pulse rate so low that echoes fold at 39.5 m."""
    return replace(case_far_wall(draw, speed), radar={"prf_div": 64, "iterations": 24})


def case_far_wall_staggered(draw: np.random.Generator, speed: float) -> Case:
    """The same with two pulse intervals in turn: the echo folds to two places."""
    return replace(case_far_wall(draw, speed), radar={"stagger_div": 17})


def case_sensor_lost(draw: np.random.Generator, speed: float) -> Case:
    return replace(case_head_on(draw, speed), lost_at_s=draw.uniform(1.0, 4.0))


def case_noise_x4(draw: np.random.Generator, speed: float) -> Case:
    return replace(draw.choice([case_head_on, case_pipe, case_pole])(draw, speed), noise=4.0)


def case_three_bounces(draw: np.random.Generator, speed: float) -> Case:
    return replace(draw.choice([case_head_on, case_corner])(draw, speed), bounces=3)


def case_wind(draw: np.random.Generator, speed: float) -> Case:
    blow = {"wind_m_s": (draw.uniform(-3, 3), draw.uniform(-3, 3), 0.0), "gust_m_s": 0.7}
    return replace(draw.choice([case_head_on, case_pipe, case_pole])(draw, speed), flight=blow)


def case_clear(draw: np.random.Generator, speed: float) -> Case:
    """A wall beside the path: nothing is in the way."""
    return Case(
        placed(shapes.box((4.0, 0.1, 3.0)), np.array([0.0, draw.uniform(1.2, 3.0), 0.0]), (0, 0, 0)), speed, 3.0
    )


KINDS: dict[str, Callable[[np.random.Generator, float], Case]] = {
    name.removeprefix("case_"): make for name, make in list(globals().items()) if name.startswith("case_")
}


def drawn(kind: str, seed: int, *, stagger: bool = False) -> Case:
    """The case of a kind and seed, with two pulse intervals in turn where this is asked for and no other is set."""
    draw = np.random.default_rng([sum(kind.encode()), seed])
    case = KINDS[kind](draw, float(draw.uniform(0.3, 1.0)))
    return replace(case, radar=case.radar or {"stagger_div": 17}) if stagger else case


def plan_of(case: Case, seed: int) -> Any:
    noise = {"noise": {"thermal": 1.16e-3 * case.noise}} if case.noise != 1 else {}
    flight = {"speed_m_s": case.speed_m_s, "guard": {"on": True, "give_up_s": 1.0}} | case.flight
    sensing = {"changes": noise | case.radar, "max_bounces": case.bounces}
    return make_scenario({"name": "guard", "seed": seed, "flight": flight, "sensing": sensing})


def hall() -> Scene:
    """Floor, ceiling and two side walls."""
    x, y, z = HALL_M
    flat, upright = shapes.plane((x, y)), shapes.plane((x, z))
    sides = [
        (flat, (0, 0, -z / 2), 0),
        (flat, (0, 0, z / 2), 0),
        (upright, (0, -y / 2, 0), 90),
        (upright, (0, y / 2, 0), 90),
    ]
    parts = [(apply(transform(at, np.radians([roll, 0, 0])), mesh[0]), mesh[1]) for mesh, at, roll in sides]
    return Scene.union([Scene.of_mesh(*part, name="hall") for part in parts])


def waypoints(case: Case) -> Floats:
    """The straight path of a case."""
    return np.array([[-case.start_m, 0, 0], [case.end_m, 0, 0]])


def flown(case: Case, seed: int) -> tuple[GuardedFlight, Scene]:
    """Fly a case in the hall with the guard."""
    plan, scene = plan_of(case, seed), Scene.union([hall(), case.obstacle])

    def receive(chunk: dict[str, Frames]) -> dict[str, Frames]:
        late = int(next(iter(chunk.values())).t_ns[0]) > case.lost_at_s * 1e9
        return {name: part for name, part in chunk.items() if not (late and name == "front")}

    return Loop(plan, scene, plan.sensing.radars(), RATE_HZ, receive=receive).fly(waypoints(case)), scene


def unguarded(case: Case, seed: int) -> dict[str, Any]:
    """Fly the same without radars, until the drone hits something or arrives."""
    plan, scene, points = plan_of(case, seed).flight, Scene.union([hall(), case.obstacle]), waypoints(case)
    longest_s = 2 * (case.start_m + case.end_m) / case.speed_m_s + 5
    drone = Steered(plan.vehicle, scene=scene, start=(*points[0], 0.0), wind_m_s=plan.wind_m_s, gust_m_s=plan.gust_m_s,
                    seed=seed, moving_s=longest_s)  # fmt: skip
    follower, parts, closest = WaypointFollower(points, case.speed_m_s), bodies(scene), math.inf
    for row in range(round(longest_s * RATE_HZ)):
        drone.advance(round(row * 1e9 / RATE_HZ))
        closest = min(closest, gap_m(parts, drone.position, drone.t_ns))
        if drone.contacts or follower.arrived:
            break
        x, y, z = follower.velocity(drone.position)
        drone.ask(Wish(velocity_m_s=(x, y), climb_m_s=z, heading_rad=0.0))
    impact = drone.contacts[0][2] if drone.contacts else math.nan
    return {"hit": int(bool(drone.contacts)), "impact_m_s": f"{impact:.2f}", "closest_m": f"{max(closest, 0.0):.2f}",
            "stops": 0, "false_stops": 0, "arrived": int(follower.arrived), "flight_s": f"{drone.t_ns * 1e-9:.1f}",
            "cpu_s": ""}  # fmt: skip


def gap_m(parts: list[Body], point: Floats, t_ns: int) -> float:
    """From the hull, an ellipsoid of its radius and half height, to the nearest surface [m]."""
    squash = HULL.radius_m / HULL.half_height_m
    return (
        min(float(part.gaps(into(part, point, t_ns), 1.0, squash=squash)[1].min(initial=np.inf)) for part in parts)
        - HULL.radius_m
    )


def is_false(step: Step, point: Floats, parts: list[Body], margin_m: float) -> bool:
    """Whether the hull could fly on for 1 m, at 0.5 m/s, and keep its margin; no stop of a lost radar is false."""
    way = step.wanted / max(float(np.linalg.norm(step.wanted)), 1e-9)
    if not step.sectors.valid.all():
        return False
    return all(gap_m(parts, point + s * way, step.t_ns + round(s * 2e9)) > margin_m for s in np.arange(0, 1.05, 0.1))


def echo_db(case: Case, seed: int) -> float:
    """Level over noise of the obstacle alone in the 0.4 m before the place where braking must begin [dB]."""
    plan = plan_of(case, seed)
    spec = plan.sensing.radars().sensors["front"]
    guard = plan.flight.guard
    need = HULL.radius_m + guard.margin_m + float(stopping_distance(case.speed_m_s, guard))
    t_ns, level = even_times(RATE_HZ, count=9), np.tile([0, 0, 0, 1.0], (9, 1))
    path = Trajectory(t_ns, np.linspace((-need - 0.4, 0, 0), (-need, 0, 0), 9), level)
    still = replace(case.obstacle, objects=tuple(replace(thing, motion=None) for thing in case.obstacle.objects))
    quiet = ul.simulate(still, path, spec.but(noise=None))
    noise = ul.simulate(Scene.empty(), path, spec, seed=seed)
    own = noise.samples - noise.samples.mean(0)
    near = noise.range_m > 0.6
    sigma = np.sqrt(np.median((np.abs(own[:, near]) ** 2).mean(0)) * 9 / 8)
    peak = np.abs(quiet.samples[:, near]).max(1)
    return float(20 * np.log10(max(np.median(peak) / sigma, 1e-6)))


def guarded(case: Case, seed: int) -> dict[str, Any]:
    """Fly with the guard and judge every stop by the truth."""
    began = time.process_time()
    flight, scene = flown(case, seed)
    cpu_s = time.process_time() - began
    parts, margin = bodies(scene), plan_of(case, seed).flight.guard.margin_m
    states = [step.limit.state in ("stop", "back_off") for step in flight.steps]
    begins = [k for k, now in enumerate(states) if now and not (k and states[k - 1])]
    place, t_ns = flight.flown.position, flight.flown.t_ns
    false = [k for k in begins if is_false(flight.steps[k], place[k], parts, margin)]
    closest = min(gap_m(parts, point, int(when)) for point, when in zip(place, t_ns, strict=True))
    impact = flight.contacts[0][2] if flight.contacts else math.nan
    return {"hit": int(bool(flight.contacts)), "impact_m_s": f"{impact:.2f}", "closest_m": f"{max(closest, 0.0):.2f}",
            "stops": len(begins), "false_stops": len(false), "arrived": int(flight.arrived),
            "flight_s": f"{flight.flown.duration_s:.1f}", "cpu_s": f"{cpu_s:.2f}"}  # fmt: skip


def rows_of(kind: str, seed: int, *, stagger: bool = False) -> list[dict[str, str]]:
    """The rows of a case: without the guard and with it."""
    case = drawn(kind, seed, stagger=stagger)
    key = {"kind": kind, "seed": seed, "speed_m_s": f"{case.speed_m_s:.2f}", "echo_db": f"{echo_db(case, seed):.1f}"}
    both = (unguarded(case, seed), guarded(case, seed))
    return [{name: str(value) for name, value in (key | {"guard": k} | row).items()} for k, row in enumerate(both)]


def table(rows: list[dict[str, str]]) -> str:
    """One line a kind as Markdown; hits of visible and of hidden obstacles apart."""
    head = ("kind", "flights", "echo over noise [dB]", "hits unguarded", "hits, visible", "hits, hidden", "closest [m]",
            "false stops a minute", "passed", "passage [s] unguarded, guarded", "CPU-s a simulated second")  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    kinds = [kind for kind in KINDS if any(row["kind"] == kind for row in rows)]
    for kind in [*kinds, "all"]:
        mine = [row for row in rows if kind in (row["kind"], "all")]
        on, off = ([row for row in mine if row["guard"] == flag] for flag in "10")
        if on and off:
            lines.append("| " + " | ".join([kind, *_summary(on, off)]) + " |")
    return "\n".join(lines)


def _summary(on: list[dict[str, str]], off: list[dict[str, str]]) -> list[str]:
    def numbers(rows: list[dict[str, str]], name: str) -> Floats:
        return np.array([float(row[name]) for row in rows])

    def hits(rows: list[dict[str, str]]) -> Bools:
        """Contacts, and surfaces within the ellipsoid of the hull, which the rotors fill in part."""
        return np.asarray((numbers(rows, "hit") > 0) | (numbers(rows, "closest_m") <= 0))

    hit, seen = hits(on), numbers(on, "echo_db") >= VISIBLE_DB
    both = {
        row["kind"] + row["seed"] for row, bad in zip(off, hits(off), strict=True) if row["arrived"] == "1" and not bad
    }
    passed = [row for row in on if row["arrived"] == "1" and row["kind"] + row["seed"] in both]
    twins = [row for row in off if row["kind"] + row["seed"] in {p["kind"] + p["seed"] for p in passed}]
    times = [f"{numbers(part, 'flight_s').mean():.1f}" if part else "-" for part in (twins, passed)]
    level, length = numbers(on, "echo_db"), numbers(on, "flight_s").sum()
    return [
        str(len(on)), f"{level.min():.0f} to {level.max():.0f}", f"{hits(off).sum():.0f}",
        f"{hit[seen].sum():.0f} of {seen.sum()}", f"{hit[~seen].sum():.0f} of {(~seen).sum()}",
        f"{numbers(on, 'closest_m').min():.2f}", f"{60 * numbers(on, 'false_stops').sum() / length:.2f}",
        f"{numbers(on, 'arrived').sum():.0f}", ", ".join(times), f"{numbers(on, 'cpu_s').sum() / length:.2f}",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", action="append", choices=list(KINDS), help="again for several; none: all")
    parser.add_argument("--count", type=int, default=14, help="flights of each kind")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--stagger", action="store_true", help="two pulse intervals in turn in all kinds")
    parser.add_argument("--table-only", action="store_true", help="fly nothing")
    parser.add_argument("--to", type=Path, default=Path("guard_flights.csv"))
    given = parser.parse_args()
    rows = list(csv.DictReader(given.to.open())) if given.to.exists() else []
    if not rows and not given.table_only:
        given.to.write_text(",".join(FIELDS) + "\n")
    known = {(row["kind"], row["seed"]) for row in rows if row["guard"] == "1"}
    seeds = () if given.table_only else range(given.first, given.first + given.count)
    for seed, kind in itertools.product(seeds, given.kind or KINDS):
        if (kind, str(seed)) in known:
            continue
        new = rows_of(kind, seed, stagger=given.stagger)
        with given.to.open("a", newline="") as file:
            csv.DictWriter(file, FIELDS, lineterminator="\n").writerows(new)
        rows += new
        print(", ".join(f"{name} {value}" for name, value in new[1].items()), flush=True)
    print("\n" + table(rows))


if __name__ == "__main__":
    main()
