"""Fly ArduPilot's own simulator by ullage's radars, and write a table of how near it comes to obstacles.

    python tools/fly_autopilot.py --binary PATH/TO/arducopter [--only wall] [--to autopilot_flights] [--do obstacles]

The binary is ArduCopter's software-in-the-loop build, which is not part of ullage. Each flight starts it and
`ullage run mavlink:... --to mavlink:...` on loopback UDP: the radars follow the autopilot's poses in a world of this
file, and the autopilot gets their distances. A pilot's link takes off, then asks for the same speed all the time.
Distances from obstacles are those of the simulated vehicle (SIM_STATE) in the same world. Rows that the folder holds
already are not flown again. Without a binary nothing is flown, and the table says so.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ullage.flight.obstacles import bodies
from ullage.world.load import load_scene

HOME = (-35.363261, 149.165230, 584.0)
M_PER_UNIT = 0.011131884502145034
"""Metres of a 1e-7 degree of latitude on ArduPilot's sphere."""
HULL_M = 0.25
"""A surface nearer than this to the body's centre counts as hit."""
HEIGHT_M, AHEAD_M, MARGIN_M, CEILING_M = 1.5, 6.0, 1.5, 5.0
READY_S = 240.0
PARAMETERS = {
    "FRAME_CLASS": 1, "FRAME_TYPE": 0, "PRX1_TYPE": 2, "AVOID_ENABLE": 7, "AVOID_MARGIN": MARGIN_M, "FS_THR_ENABLE": 0,
    "COMPASS_OFS_X": 5, "COMPASS_OFS_Y": 13, "COMPASS_OFS_Z": -18, "COMPASS_OFS2_X": 5, "COMPASS_OFS2_Y": 13,
    "COMPASS_OFS2_Z": -18, "COMPASS_OFS3_X": 5, "COMPASS_OFS3_Y": 13, "COMPASS_OFS3_Z": -18, "BATT_MONITOR": 4,
    **{f"INS_ACC{k}{name}_{axis}": value for k in ("", "2") for axis in "XYZ"
       for name, value in (("OFFS", 0.001), ("SCAL", 1.001))},
    **{f"RC{k}_{end}": value for k in range(1, 9) for end, value in (("MIN", 1000), ("MAX", 2000), ("TRIM", 1500))},
}  # fmt: skip
"""The simulated sensors count as calibrated; the rest is as docs/mavlink.md sets it."""
MODES = {"loiter": 5, "guided": 4, "auto": 3}
Send = Callable[[], None]


def sdf(text: str) -> str:
    """A file that holds a world or a model."""
    names = 'xmlns:ullage="urn:ullage:sdf" xmlns:gz="http://gazebosim.org/schema"'
    return f'<?xml version="1.0"?><sdf version="1.9" {names}>{text}</sdf>'


def box(name: str, at: tuple[float, float, float], size: tuple[float, float, float], yaw_deg: float = 0.0) -> str:
    """A static SDF model of a box."""
    shape = f"<box><size>{size[0]} {size[1]} {size[2]}</size></box>"
    return _model(name, (*at, 0.0, 0.0, math.radians(yaw_deg)), shape)


def rod(name: str, at: tuple[float, float, float], radius_m: float, length_m: float, *, level: bool = False) -> str:
    """A static SDF model of a cylinder: upright, or level across the path."""
    shape = f"<cylinder><radius>{radius_m}</radius><length>{length_m}</length></cylinder>"
    return _model(name, (*at, math.pi / 2 if level else 0.0, 0.0, 0.0), shape)


def _model(name: str, pose: tuple[float, ...], shape: str) -> str:
    at = " ".join(f"{value:.6g}" for value in pose)
    return (
        f'<model name="{name}"><static>true</static><pose>{at}</pose><link name="l"><collision name="c"><geometry>'
        f"{shape}</geometry></collision></link></model>\n"
    )


def radars(mounts: dict[str, str]) -> str:
    """A model with radars: names and poses."""
    sensors = "".join(
        f'<sensor name="{name}" type="custom" gz:type="ullage_radar"><pose>{pose}</pose><update_rate>17</update_rate>'
        "<ullage:radar><preset>x4m05</preset></ullage:radar></sensor>"
        for name, pose in mounts.items()
    )
    return f'<model name="copter"><link name="l">{sensors}</link></model>'


UP = radars({"front": "0.1 0 0 0 0 0", "left": "0 0.1 0 0 0 1.5708", "back": "-0.1 0 0 0 0 3.14159",
             "right": "0 -0.1 0 0 0 -1.5708", "up": "0 0 0.06 0 -1.5708 0"})  # fmt: skip
FLOOR = box("floor", (0, 0, -0.05), (60, 60, 0.1))


def wall(yaw_deg: float = 0.0) -> str:
    """A wall across the path, whose face is met at `AHEAD_M`."""
    away = AHEAD_M + 0.1 / math.cos(math.radians(yaw_deg))
    return box("wall", (away, 0, 2), (0.2, 20, 6), yaw_deg)


def gap(width_m: float) -> str:
    """Two walls across the path with a gap between them."""
    side = 8 + width_m / 2
    return "".join(box(f"wall{sign}", (AHEAD_M, sign * side, 2), (0.2, 16, 6)) for sign in (-1, 1))


def hall(length_m: float, height_m: float) -> str:
    """Four walls and a ceiling."""
    half, up = length_m / 2, height_m / 2
    sides = [("x", (half, 0)), ("-x", (-half, 0)), ("y", (0, half)), ("-y", (0, -half))]
    walls = [box(f"wall{name}", (x, y, up), (0.2, length_m, height_m) if x else (length_m, 0.2, height_m))
             for name, (x, y) in sides]  # fmt: skip
    return "".join(walls) + box("ceiling", (0, 0, height_m + 0.05), (length_m, length_m, 0.1))


@dataclass(frozen=True)
class Case:
    """One kind of flight."""

    world: str  # models
    modes: tuple[str, ...] = ("guided",)
    speeds_m_s: tuple[float, ...] = (0.5, 1.0, 1.5)
    passes: bool = False  # it is right to fly on
    floor: bool = True
    rig: str = "thesis-4"  # or a model with radars
    climbs: bool = False  # it is pushed up, not ahead
    lost_at_m: float = math.inf  # ullage ends once the vehicle is there
    parameters: dict[str, float] = field(default_factory=dict)


CASES = {
    "wall": Case(wall(), ("guided", "loiter", "auto")),
    "wall, no floor": Case(wall(), ("guided", "loiter"), floor=False),
    "wall, no backing away": Case(wall(), floor=False, speeds_m_s=(1.0,), parameters={"AVOID_BACKUP_SPD": 0}),
    "wall at 30 deg": Case(wall(30), ("guided", "loiter", "auto")),
    "corner": Case(wall() + box("side", (AHEAD_M / 2, 3, 2), (AHEAD_M, 0.2, 6)), speeds_m_s=(1.0,)),
    "pole 5 cm": Case(rod("pole", (AHEAD_M, 0, 2), 0.025, 4)),
    "wire 3 mm": Case(rod("wire", (AHEAD_M, 0, HEIGHT_M), 0.0015, 12, level=True)),
    "gap 1.5 m": Case(gap(1.5), speeds_m_s=(1.0,), passes=True, parameters={"AVOID_MARGIN": 0.5}),
    "gap 2.2 m": Case(gap(2.2), speeds_m_s=(0.5, 1.0), passes=True, parameters={"AVOID_MARGIN": 0.7}),
    "wall 1 m beside": Case(
        box("wall", (AHEAD_M, -1.1, 2), (8, 0.2, 6)),
        speeds_m_s=(0.5, 1.0),
        passes=True,
        parameters={"AVOID_MARGIN": 0.7},
    ),
    "hover in a hall": Case(hall(14, 6), speeds_m_s=(0.0,)),
    "radars lost": Case(wall(), ("guided", "auto"), (1.0,), lost_at_m=2.0),
    "wall 10 m ahead, one radar": Case(
        box("wall", (10.1, 0, 2), (0.2, 20, 6)), speeds_m_s=(0.0,), floor=False, rig="single"
    ),
    "ceiling on climb": Case(
        box("ceiling", (0, 0, CEILING_M + 0.05), (20, 20, 0.1)), speeds_m_s=(0.5,), rig=UP, climbs=True
    ),
}


@dataclass
class Flight:
    """What was seen of one flight."""

    case: str
    mode: str
    speed_m_s: float
    floor: bool = True
    do: str = ""
    options: str = ""  # of the place that takes the distances
    parameters: dict[str, float] = field(default_factory=dict)  # set beside those of the case
    closest_m: float = math.nan
    hold_m: float = math.nan  # median distance in the last 5 s
    ahead_m: float = math.nan  # place along the path at the end
    moved_m: float = math.nan  # farthest from where it was asked to fly on
    backwards_m: float = math.nan  # farthest behind there
    fastest_m_s: float = math.nan
    hit: bool = False
    estimate_off_m: float = math.nan  # greatest difference of the estimated pose from the simulated one
    late: int = 0  # distances that ullage dropped
    ages_ms: tuple[float, ...] = ()  # from frame to message: median, and 99 %
    messages: list[str] = field(default_factory=list)  # of ArduPilot, from take-off on
    failed: str = ""  # why it did not fly


class Pilot:
    """A ground station with sticks, on a loopback port that the autopilot sends to."""

    def __init__(self, port: int) -> None:
        from pymavlink import mavutil

        self.mav: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
        self.truth: list[tuple[float, float, float, float]] = []  # when, and place in the world [s, m]
        self.estimate: list[tuple[float, float, float, float]] = []
        self.texts: list[str] = []
        self.armed, self.mode = False, -1
        self.clock: list[tuple[float, float]] = []  # of this machine, and of the autopilot [s]
        self._beat_s = 0.0

    def fly(self, seconds: float, send: Send | None = None, *, until: Callable[[], bool] = lambda: False) -> bool:
        """Take messages, and send ten times a second, until a condition holds; whether it does."""
        end, due_s = time.monotonic() + seconds, 0.0
        while (now := time.monotonic()) < end and not until():
            if now - self._beat_s >= 1.0:
                self._beat_s = now
                self.mav.mav.heartbeat_send(6, 8, 0, 0, 0)
            if send is not None and now >= due_s:
                due_s = now + 0.1
                send()
            self._take(self.mav.recv_match(blocking=True, timeout=0.02))
        return until()

    def _take(self, message: Any) -> None:
        kind = message.get_type() if message is not None else ""
        if kind == "HEARTBEAT" and message.autopilot == 3:
            self.mode, self.armed = message.custom_mode, bool(message.base_mode & 128)
        elif kind == "STATUSTEXT":
            self.texts.append(message.text)
        elif kind == "SIM_STATE":
            north = (message.lat_int - HOME[0] * 1e7) * M_PER_UNIT
            east = (message.lon_int - HOME[1] * 1e7) * M_PER_UNIT * math.cos(math.radians(HOME[0]))
            self.truth.append((time.monotonic(), east, north, message.alt - HOME[2]))
        elif kind == "LOCAL_POSITION_NED":
            self.estimate.append((time.monotonic(), message.y, message.x, -message.z))
            self.clock.append((time.monotonic(), message.time_boot_ms * 1e-3))

    @property
    def at(self) -> tuple[float, float, float]:
        """Where it is: east, north, up [m]."""
        return self.truth[-1][1:] if self.truth else (0.0, 0.0, 0.0)

    def command(self, number: int, *values: float) -> None:
        """Send a COMMAND_LONG."""
        self.mav.mav.command_long_send(1, 1, number, 0, *values, *[0.0] * (7 - len(values)))

    def take_off(self, height_m: float = HEIGHT_M) -> str:
        """Arm and climb; why that failed."""
        if not self.fly(READY_S, until=lambda: self.mode >= 0):
            return "no HEARTBEAT"

        def ask() -> None:
            self.command(511, 108, 50_000)  # SIM_STATE and LOCAL_POSITION_NED, 20 a second
            self.command(511, 32, 50_000)
            self.command(176, 1, MODES["guided"])
            self.command(400, 1)

        end = time.monotonic() + READY_S
        while not self.armed and time.monotonic() < end:
            ask()
            self.fly(2.0, until=lambda: self.armed)
        if not self.armed:
            return f"not armed: {[text for text in self.texts if 'Arm' in text][-1:]}"
        self.texts.clear()
        for _ in range(5):
            self.command(22, 0, 0, 0, 0, 0, 0, height_m)
            if self.fly(6.0, until=lambda: self.at[2] > 0.9 * height_m):
                self.fly(4.0)
                return ""
        return "did not climb"

    def push(self, mode: str, speed_m_s: float, *, climbs: bool) -> Send:
        """What asks for a speed along +x in a mode, or upwards."""
        if mode == "guided":
            only_velocity = 0b0000110111000111
            velocity = (0, 0, -speed_m_s) if climbs else (0, speed_m_s, 0)
            return lambda: self.mav.mav.set_position_target_local_ned_send(
                0, 1, 1, 1, only_velocity, 0, 0, 0, *velocity, 0, 0, 0, math.radians(90), 0
            )
        self.command(176, 1, MODES[mode])
        if mode == "auto":
            return lambda: None
        pitch = 1000 if speed_m_s else 1500
        return lambda: self.mav.mav.rc_channels_override_send(1, 1, 1500, pitch, 1500, 1500, 0, 0, 0, 0)

    def upload(self, ahead_m: float) -> bool:
        """Write a mission of one waypoint along +x; whether the autopilot took it."""
        east = ahead_m / M_PER_UNIT / math.cos(math.radians(HOME[0]))
        places = [(HOME[0] * 1e7, HOME[1] * 1e7), (HOME[0] * 1e7, HOME[1] * 1e7 + east)]
        self.mav.mav.mission_count_send(1, 1, len(places), 0)
        end = time.monotonic() + 20
        while time.monotonic() < end:
            asked = self.mav.recv_match(
                type=["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=1
            )
            if asked is None:
                continue
            if asked.get_type() == "MISSION_ACK":
                return bool(asked.type == 0)
            lat, lon = places[asked.seq]
            self.mav.mav.mission_item_int_send(
                1, 1, asked.seq, 3, 16, 0, 1, 0, 0, 0, math.nan, round(lat), round(lon), HEIGHT_M, 0
            )
        return False


def free_port() -> int:
    """A UDP port that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def simulator(
    binary: Path, folder: str, parameters: dict[str, float], gcs: int, radars: int, out: Any
) -> subprocess.Popen[bytes]:
    """Start ArduCopter in a folder, with links to two loopback ports."""
    Path(folder, "own.parm").write_text("".join(f"{name} {value}\n" for name, value in parameters.items()))
    home = ",".join(str(value) for value in (*HOME, 90))
    words = [str(binary), "--model", "quad", "--home", home, "--speedup", "1", "--wipe", "--defaults", "own.parm",
             "--serial0", f"udpclient:127.0.0.1:{gcs}", "--serial1", f"udpclient:127.0.0.1:{radars}",
             "--base-port", str(free_port()), "--rc-in-port", str(free_port())]  # fmt: skip
    return subprocess.Popen(words, cwd=folder, stdout=out, stderr=out, env=os.environ)


def flown(binary: Path, flight: Flight, do: str, push_s: float) -> str:
    """Fly once, fill in what was seen, and return the lines of ullage."""
    case, gcs, radars = CASES[flight.case], free_port(), free_port()
    speed_cm_s = 100 * flight.speed_m_s
    parameters = PARAMETERS | {"LOIT_SPEED": max(speed_cm_s, 20), "WPNAV_SPEED": max(speed_cm_s, 20)}
    parameters |= case.parameters | flight.parameters
    with tempfile.TemporaryDirectory(prefix="fly_autopilot") as folder:
        world, log = Path(folder, "world.sdf"), Path(folder, "ullage.log")
        world.write_text(sdf(f'<world name="w">{case.world}{FLOOR if case.floor else ""}</world>'))
        rig = case.rig
        if rig.startswith("<"):
            rig = str(Path(folder, "rig.sdf"))
            Path(rig).write_text(sdf(case.rig))
        place = f"mavlink:udpin://127.0.0.1:{radars}"
        ours = [sys.executable, "-m", "ullage", "run", f"{place}?world={world}&rig={rig}&wait_s=300",
                "--to", f"{place}?{flight.options}", "--out", folder, *(["--do", do] if do else [])]  # fmt: skip
        started = []
        try:
            with log.open("w") as out, Path(folder, "ardupilot.log").open("w") as own:
                started.append(simulator(binary, folder, parameters, gcs, radars, own))
                started.append(subprocess.Popen(ours, stdout=out, stderr=out))
                _fly_case(flight, case, Pilot(gcs), started[1], push_s)
        finally:
            for one in started:
                end(one)
        lines = log.read_text()
        flight.late = sum(int(count) for count in re.findall(r"OBSTACLE_DISTANCE: .*?(\d+) late", lines))
        ages = re.search(r"frame to message (\d+) ms \(median\), (\d+) ms", lines)
        flight.ages_ms = tuple(float(value) for value in ages.groups()) if ages else ()
        if flight.failed:
            flight.failed += f" (ullage: {lines.strip().splitlines()[-1:]})"
    return lines


def end(process: subprocess.Popen[bytes]) -> None:
    """End a program."""
    process.terminate()
    try:
        process.wait(30)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _fly_case(flight: Flight, case: Case, pilot: Pilot, ours: subprocess.Popen[bytes], push_s: float) -> None:
    flight.failed = pilot.take_off()
    if flight.failed:
        return
    if flight.mode == "auto" and not pilot.upload(3 * AHEAD_M):
        flight.failed = "the mission was refused"
        return
    begun, x0 = time.monotonic(), pilot.at
    send = pilot.push(flight.mode, flight.speed_m_s, climbs=case.climbs)
    way_s = (1.5 * AHEAD_M if case.passes else AHEAD_M) / flight.speed_m_s if flight.speed_m_s else 0.0
    far = lambda: pilot.at[0] > 2 * AHEAD_M  # noqa: E731
    if math.isfinite(case.lost_at_m):
        pilot.fly(push_s, send, until=lambda: pilot.at[0] > case.lost_at_m)
        ours.terminate()
    pilot.fly(way_s + push_s, send, until=far)
    flight.messages = list(dict.fromkeys(pilot.texts))
    measure(flight, case, np.array([row for row in pilot.truth if row[0] >= begun]), x0)
    there = np.array([row for row in pilot.estimate if row[0] >= begun])
    if len(there):
        track = np.array(pilot.truth)
        same = np.stack([np.interp(there[:, 0], track[:, 0], track[:, k]) for k in (1, 2, 3)], axis=1)
        flight.estimate_off_m = float(np.linalg.norm(there[:, 1:] - same, axis=1).max())


def measure(flight: Flight, case: Case, track: Any, x0: tuple[float, float, float]) -> None:
    """Fill in the distances of a track (n, 4) of times and places from the obstacles of a case, floor left out."""
    with tempfile.NamedTemporaryFile("w", suffix=".sdf") as world:
        world.write(sdf(f'<world name="w">{case.world}</world>'))
        world.flush()
        body = bodies(load_scene(world.name))[0]
    away = np.array([body.gaps(place, 0.0)[1].min() for place in track[:, 1:]])
    last = track[:, 0] > track[-1, 0] - 5.0
    flight.closest_m, flight.hold_m = float(away.min()), float(np.median(away[last]))
    flight.ahead_m = float(track[-1, 1])
    flight.moved_m = float(np.linalg.norm(track[:, 1:] - x0, axis=1).max())
    flight.backwards_m = float(x0[0] - track[:, 1].min())
    steps = track[:: max(round(len(track) / max(track[-1, 0] - track[0, 0], 1.0)), 1)]  # a second apart
    way = 3 if case.climbs else 1
    flight.fastest_m_s = float((np.diff(steps[:, way]) / np.diff(steps[:, 0])).max(initial=0.0))
    flight.hit = bool(flight.closest_m < HULL_M)


def table(flights: list[Flight]) -> str:
    """The rows in Markdown."""
    head = [
        "case",
        "mode",
        "asked [m/s]",
        "fastest [m/s]",
        "closest [m]",
        "held [m]",
        "ended at x [m]",
        "hit",
        "late",
        "99 % [ms]",
    ]
    rows = [head, ["---"] * len(head)]
    for one in flights:
        if one.failed:
            rows.append([one.case, one.mode, f"{one.speed_m_s:g}", one.failed, *[""] * 6])
            continue
        rows.append([
            one.case, one.mode, f"{one.speed_m_s:g}", f"{one.fastest_m_s:.2f}", f"{one.closest_m:.2f}",
            f"{one.hold_m:.2f}", f"{one.ahead_m:.1f}", "hit" if one.hit else "", str(one.late),
            f"{one.ages_ms[1]:.0f}" if one.ages_ms else "",
        ])  # fmt: skip
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    said = dict.fromkeys(text for one in flights for text in one.messages)
    return "\n".join([*lines, "", "ArduPilot's own messages in flight:", "", *(f"- `{text}`" for text in said), ""])


def main() -> None:
    """Fly the cases that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, help="ArduCopter's software-in-the-loop build")
    parser.add_argument("--only", action="append", help=f"cases: {', '.join(CASES)}")
    parser.add_argument("--mode", action="append", choices=sorted(MODES))
    parser.add_argument("--speed", action="append", type=float)
    parser.add_argument("--do", default="obstacles", help="stages of ullage; '' for those that it takes by itself")
    parser.add_argument("--options", default="", help="of the sink's place, such as guard=brake&stop_s=0.5")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter of ArduPilot")
    parser.add_argument("--push", type=float, default=20.0, help="seconds that it is pushed on at an obstacle")
    parser.add_argument("--to", type=Path, default=Path("autopilot_flights"), help="folder of the table")
    chosen = parser.parse_args()
    chosen.to.mkdir(parents=True, exist_ok=True)
    rows = chosen.to / "flights.json"
    if chosen.binary is None or not os.access(chosen.binary, os.X_OK):
        print(f"skipped: no program at {chosen.binary}; --binary PATH names ArduCopter's simulator")
        return
    if unknown := set(chosen.only or ()) - set(CASES):
        parser.error(f"no case {sorted(unknown)} (allowed: {', '.join(CASES)})")
    flights = [Flight(**row) for row in json.loads(rows.read_text())] if rows.exists() else []
    chosen.set = {name: float(value) for name, _, value in (text.partition("=") for text in chosen.set)}
    done = [(one.case, one.mode, one.speed_m_s, one.do, one.options, one.parameters) for one in flights
            if not one.failed]  # fmt: skip
    flights = [one for one in flights if not one.failed]
    for name in chosen.only or CASES:
        for mode in CASES[name].modes:
            for speed_m_s in CASES[name].speeds_m_s:
                wanted = mode in (chosen.mode or MODES) and speed_m_s in (chosen.speed or [speed_m_s])
                if not wanted or (name, mode, speed_m_s, chosen.do, chosen.options, chosen.set) in done:
                    continue
                flight = Flight(name, mode, speed_m_s, CASES[name].floor, chosen.do, chosen.options, chosen.set)
                lines = flown(chosen.binary.resolve(), flight, chosen.do, chosen.push)
                flights.append(flight)
                (chosen.to / f"ullage{len(flights)}.log").write_text(lines)
                rows.write_text(json.dumps([asdict(one) for one in flights], indent=1))
                (chosen.to / "flights.md").write_text(table(flights))
                print(table([flight]).splitlines()[2], flush=True)


if __name__ == "__main__":
    main()
