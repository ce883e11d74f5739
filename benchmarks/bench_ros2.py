"""Rates, latency and loss of ros2: between two processes on loopback, and how fast the simulator gives frames."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import ullage as ul
from ullage.grids import OccupancyMap
from ullage.ports import conversions
from ullage.ports import schema as ros

ROOT = Path(__file__).parents[1]
FRAME, GRID = "/bench/radar/front/frame", "/bench/map"
CASES = {  # topic, type, quality, how many a second (0: flat out), how many
    "frames, four radars at 17 Hz": (FRAME, ros.FRAME, "sensor", 68.0, 680),
    "frames, flat out": (FRAME, ros.FRAME, "sensor", 0.0, 5000),
    "grid 1000 x 1000 at 5 Hz": (GRID, ros.GRID, "latched", 5.0, 50),
    "update 100 x 100 at 20 Hz": ("/bench/map_updates", ros.UPDATE, "stream", 20.0, 200),
}


def payload(kind: str) -> bytes:
    """One message of a kind."""
    if kind == ros.FRAME:
        spec = ul.RadarSpec.preset("x4m05")
        frames = ul.Frames(np.ones((1, 188), np.complex64), spec.range_m, np.array([0]), spec, sensor="front")
        return conversions.frame_messages(frames, 0)[0]
    if kind == ros.GRID:
        return conversions.grid_message(
            OccupancyMap(ul.Grid((0.0, 0.0, 0.0), 0.1, (1000, 1000)), np.zeros((1000, 1000), np.int8)), 0
        )
    from ullage.ports.encode import update_message

    return update_message(0, 0, 0, np.zeros((100, 100), np.int8))


def stamped(data: bytearray) -> bytes:
    """The message with the present in its header, which it begins with."""
    now = time.time_ns()
    data[4:8], data[8:12] = (now // 10**9).to_bytes(4, "little"), (now % 10**9).to_bytes(4, "little")
    return bytes(data)


def listen(case: str, typed: bool) -> None:
    """Take messages until none came for two seconds; say how late they were."""
    import rclpy

    from ullage.ports.ros2.middleware import message_class, profile

    topic, kind, quality, _, _ = CASES[case]
    late: list[int] = []

    def raw(data: bytes) -> None:
        stamp = int.from_bytes(data[4:8], "little") * 10**9 + int.from_bytes(data[8:12], "little")
        late.append(time.time_ns() - stamp)

    def whole(message: Any) -> None:
        stamp = message.header.stamp
        late.append(time.time_ns() - stamp.sec * 10**9 - stamp.nanosec)

    rclpy.init()
    node = rclpy.create_node("bench_listener")
    how = profile(quality, depth=100)  # type: ignore[arg-type]
    node.create_subscription(message_class(kind), topic, whole if typed else raw, how, raw=not typed)
    print("ready", flush=True)
    last, count = time.monotonic(), 0
    while time.monotonic() - last < (180.0 if not late else 2.0):
        rclpy.spin_once(node, timeout_sec=0.2)
        if len(late) > count:
            last, count = time.monotonic(), len(late)
    print(json.dumps(late))


def speak(case: str) -> float:
    """Publish a case's messages; messages a second."""
    from ullage.ports.publisher import Message
    from ullage.ports.ros2.middleware import Peer
    from ullage.ports.ros2.options import NodeOptions

    topic, kind, quality, rate, count = CASES[case]
    peer = Peer("", NodeOptions(node="bench_speaker"))
    data = bytearray(payload(kind))
    out = peer.publisher(topic, kind, quality)  # type: ignore[arg-type]
    while not out.get_subscription_count():
        time.sleep(0.05)
    time.sleep(0.5)
    begin = time.monotonic()
    for number in range(count):
        if rate:
            time.sleep(max(0.0, begin + number / rate - time.monotonic()))
        peer.send(Message(0, topic, kind, quality, stamped(data)))  # type: ignore[arg-type]
    reached = count / (time.monotonic() - begin)
    peer.settle(5.0)
    time.sleep(1.0)
    peer.close()
    return reached


def measure(case: str, typed: bool) -> str:
    """One row."""
    import ullage.ports.ros2.middleware  # noqa: F401 (what is slow to load, before anybody waits)

    child = subprocess.Popen(
        [sys.executable, __file__, "--listen", case, *(["--typed"] if typed else [])], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    child.stdout.readline()
    reached = speak(case)
    late = np.array(json.loads(child.communicate(timeout=60)[0].splitlines()[-1])) * 1e-6
    count = CASES[case][-1]
    shown = "as rclpy messages" if typed else "as bytes"
    p50, p99 = np.percentile(late, [50, 99]) if len(late) else (np.nan, np.nan)
    return f"| {case}, {shown} | {reached:.0f} | {p50:.2f} | {p99:.2f} | {100 * (1 - len(late) / count):.1f} |"


def simulator_rate(fidelity: str, seconds: float = 6.0) -> float:
    """Frames a second of four radars in the room, with the poses of a robot at 50 Hz."""
    from ullage.radar.live import LiveRadars
    from ullage.world.library import WORLDS

    radars = LiveRadars(WORLDS["ntnu-room"].scene(), ul.Rig.preset("thesis-4"), fidelity=fidelity)  # type: ignore[arg-type]
    at, count, begin = 0, 0, None
    end = time.monotonic() + 1e9
    while time.monotonic() < end:
        x = -2.0 + 4.0 * (at % 10**10) / 10**10
        found = radars.advance(at, (x, 0.3, 1.1), (0.0, 0.0, np.sin(at * 1e-10), np.cos(at * 1e-10)))
        at += 20_000_000
        if begin is None and at > 10**9:  # what is compiled and loaded first does not count
            begin = time.monotonic()
            end = begin + seconds
        elif begin is not None:
            count += sum(map(len, found.values()))
    radars.close()
    return count / seconds


def node_rate(fidelity: str, seconds: float = 8.0) -> float:
    """Frames a second that the node publishes when it is asked for more than it can, by the frames' own numbers."""
    import rclpy

    from ullage.ports.ros2.middleware import message_class, profile

    there = dict(os.environ) | {"PYTHONPATH": str(ROOT / "src")}
    words = ["simulate:=ntnu-room", "pose:=/robot/odom", f"fidelity:={fidelity}", "rate_hz:=250.0"]
    node = [sys.executable, "-m", "ullage.experiments.ros2_nodes", "radar_simulator", "--ros-args"]
    started = [
        subprocess.Popen(
            [sys.executable, ROOT / "tests/ports/ros2/move.py"], env=there, stdin=-1, stdout=-3, stderr=-3
        ),
        subprocess.Popen([*node, *(part for word in words for part in ("-p", word))], env=there, stderr=-3),
    ]
    seen: dict[str, list[tuple[float, int]]] = {}
    rclpy.init()
    hearing = rclpy.create_node("bench_hearing")
    kind = message_class(ros.FRAME)
    for name in ("front", "left", "back", "right"):
        take = seen.setdefault(name, [])
        how = profile("sensor", depth=100)
        hearing.create_subscription(
            kind, f"/radar/{name}/frame", lambda m, take=take: take.append((time.monotonic(), m.index)), how
        )
    while not all(seen.values()):
        rclpy.spin_once(hearing, timeout_sec=0.2)
    begin = time.monotonic() + 2.0  # what waited while it got ready is worked off
    while time.monotonic() < begin + seconds:
        rclpy.spin_once(hearing, timeout_sec=0.2)
    for child in started:
        child.terminate()
        child.wait()
    rclpy.shutdown()
    cut = [[moment for moment in took if moment[0] > begin] for took in seen.values()]
    return sum((took[-1][1] - took[0][1]) / (took[-1][0] - took[0][0]) for took in cut)


def main() -> None:
    """Every case; in the environment with the ROS 2 wheels if this one has none."""
    try:
        import rclpy  # noqa: F401
    except ImportError:
        other = ROOT / ".venv-ros2/bin/python"
        if not other.exists():
            print("no rclpy: make ros2 first")
            return
        os.environ["PYTHONPATH"] = str(ROOT / "src")
        os.execv(other, [str(other), __file__, *sys.argv[1:]])
    if "--listen" in sys.argv:
        listen(sys.argv[2], "--typed" in sys.argv)
        return
    os.environ.setdefault("ROS_DOMAIN_ID", "101")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    print("| what | sent a second | p50 [ms] | p99 [ms] | lost [%] |\n|---|---|---|---|---|")
    for case in CASES:
        print(measure(case, False), flush=True)
    print(measure(next(iter(CASES)), True), flush=True)
    print("\n| simulator in the room, four radars | frames a second |\n|---|---|")
    for fidelity in ("thesis", "physical"):
        print(f"| {fidelity} | {simulator_rate(fidelity):.0f} |", flush=True)
        print(f"| {fidelity}, as a node with its listener | {node_rate(fidelity):.0f} |", flush=True)


if __name__ == "__main__":
    main()
