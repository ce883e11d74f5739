"""Rate, delay and CPU of the node `radar_mapping`, with four simulated radars that another process publishes.

Each row starts the node anew. The radars come from a recording of a flight, published at the pace of its stamps.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
TOPICS = {  # of the node: type and quality of service
    "map": ("nav_msgs/msg/OccupancyGrid", "latched"),
    "map_updates": ("map_msgs/msg/OccupancyGridUpdate", "stream"),
    "image": ("sensor_msgs/msg/Image", "latched"),
}
FRONT = "flying/radar/front/frame"
SCENARIOS = {"elfes": "cargo-hold", "likelihood": "cargo-hold-physical"}
REACH_M = "25.0"  # the thesis' map of 50 x 50 m, in cells of 0.1 m
CASES = [  # method, further parameters of the node
    ("elfes", {}),
    ("likelihood", {}),
    ("elfes", {"image": "true", "image_method": "summation"}),
    ("likelihood", {"image": "true"}),
]
NAN = float("nan")


def record(path: Path, scenario: str, seconds: float) -> None:
    """Simulate the first seconds of a flight with four radars at 17 Hz each."""
    from ullage.experiments.catalog import find_scenario
    from ullage.experiments.simulated import prepare
    from ullage.ports import sink
    from ullage.radar.simulate import simulate_stream

    found = find_scenario(scenario)
    sensing = found.sensing.model_copy(update={"rate_hz": 17.0})
    simulated = prepare(found.model_copy(update={"sensing": sensing}))
    flown = simulated.flown[: int(np.searchsorted(simulated.flown.t_ns, seconds * 1e9)) + 1]
    with sink(path) as out:
        for piece in simulate_stream(simulated.scene, flown, simulated.rig, fidelity=sensing.fidelity, seed=found.seed):
            out.write(piece)


def speak(path: str, pace: float) -> None:
    """Publish the recording at `pace` times real time, once somebody subscribes."""
    import ullage as ul

    ul.run(ul.open(path), sinks=[ul.sink(f"ros2:/flying?node=speaker&listeners=1&pace={pace}")])


@dataclass
class Arrivals:
    """Stamps and arrival times of one topic [s]."""

    stamp_s: list[float] = field(default_factory=list)
    at_s: list[float] = field(default_factory=list)

    def take(self, data: bytes) -> None:
        """Take one message, which begins with its header."""
        self.at_s.append(time.monotonic())
        self.stamp_s.append(int.from_bytes(data[4:8], "little") + 1e-9 * int.from_bytes(data[8:12], "little"))

    def rate_hz(self) -> float:
        """Messages a second of stamps."""
        stamps = np.unique(self.stamp_s)
        return (len(stamps) - 1) / float(stamps[-1] - stamps[0]) if len(stamps) > 1 else NAN

    def gaps_s(self) -> list[tuple[float, float]]:
        """Where the stamps are more than 0.3 s apart: after how long, and how far."""
        stamps = np.unique(self.stamp_s)
        steps = np.diff(stamps)
        return [
            (round(float(stamps[i] - stamps[0]), 2), round(float(steps[i]), 2)) for i in np.flatnonzero(steps > 0.3)
        ]

    def late_s(self, frames: Arrivals) -> np.ndarray:
        """Time from the arrival of the newest frame up to each stamp to the arrival of the message."""
        row = np.searchsorted(frames.stamp_s, np.array(self.stamp_s) + 1e-6) - 1
        return (np.array(self.at_s) - np.array(frames.at_s)[row])[row >= 0]


def cpu_s(process: int) -> float:
    """CPU time of a process so far, all of its threads."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def peak_mb(process: int) -> float:
    """Peak resident memory of a process."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6


def subscribe(node: Any) -> dict[str, Arrivals]:
    """Listen to what the node publishes, and to one radar."""
    from ullage.ports import schema as ros
    from ullage.ports.ros2.middleware import message_class, profile

    found = {}
    for topic, (kind, quality) in (TOPICS | {FRONT: (ros.FRAME, "sensor")}).items():
        found[topic] = Arrivals()
        how = profile(quality, depth=100)
        node.create_subscription(message_class(kind), "/" + topic, found[topic].take, how, raw=True)
    return found


def start_node(words: dict[str, str]) -> subprocess.Popen[str]:
    """Start the mapping node with these parameters."""
    command = [sys.executable, "-m", "ullage.experiments.ros2_nodes", "radar_mapping", "--ros-args"]
    for name, value in words.items():
        command += ["-p", f"{name}:={value}"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def watch(node: Any, speaker: subprocess.Popen[bytes], mapper: int, begun: Callable[[], bool]) -> tuple[float, float]:
    """Spin until the speaker ends; CPU and wall seconds of the mapper since two seconds after it began."""
    import rclpy

    first: tuple[float, float] | None = None
    due = float("inf")
    while speaker.poll() is None:
        rclpy.spin_once(node, timeout_sec=0.1)
        now = time.monotonic()
        due = min(due, now + 2.0) if begun() else due
        if first is None and now > due:
            first = cpu_s(mapper), now
    used, now = cpu_s(mapper), time.monotonic()
    for _ in range(20):
        rclpy.spin_once(node, timeout_sec=0.1)
    return (NAN, NAN) if first is None else (used - first[0], now - first[1])


def measure(recording: Path, words: dict[str, str], pace: float) -> dict[str, Any]:
    """Figures of one run of the node; CPU and rates by the clock of the flight."""
    import rclpy

    rclpy.init()
    node = rclpy.create_node("bench")
    mapper = start_node(words)
    time.sleep(3.0)  # it discovers nobody yet, but has its node
    heard = subscribe(node)
    speaker = subprocess.Popen([sys.executable, __file__, "--speak", str(recording), "--pace", str(pace)])
    used, wall = watch(node, speaker, mapper.pid, lambda: bool(heard["map"].at_s))
    peak = peak_mb(mapper.pid)
    mapper.send_signal(signal.SIGINT)
    _, err = mapper.communicate(timeout=120)
    node.destroy_node()
    rclpy.shutdown()
    whole, updates = heard["map"], heard["map_updates"]
    maps = Arrivals(whole.stamp_s + updates.stamp_s, whole.at_s + updates.at_s)
    late = maps.late_s(heard[FRONT])
    late_image = heard["image"].late_s(heard[FRONT]) if heard["image"].at_s else np.array([NAN])
    return {
        "maps_hz": maps.rate_hz(),
        "images_hz": heard["image"].rate_hz(),
        "late_ms": [1e3 * float(np.percentile(late, p)) for p in (50, 99)],
        "late_image_ms": [1e3 * float(np.percentile(late_image, p)) for p in (50, 99)],
        "cpu_percent": 100 * used / (wall * pace),
        "peak_mb": peak,
        "counts": {topic: len(taken.at_s) for topic, taken in heard.items()},
        "gaps_s": maps.gaps_s(),
        "image_gaps_s": heard["image"].gaps_s(),
        "drops": [line for line in err.splitlines() if "lost" in line or "late" in line],
    }


def row(method: str, words: dict[str, str], got: dict[str, Any]) -> str:
    """One line of the table."""
    name = method + (f", image by {words.get('image_method', 'backprojection')}" if "image" in words else "")
    late = " / ".join(f"{v:.0f}" for v in got["late_ms"])
    late_image = " / ".join(f"{v:.0f}" for v in got["late_image_ms"]) if got["counts"]["image"] else "-"
    images = f"{got['images_hz']:.2f}" if got["counts"]["image"] else "-"
    return (
        f"| {name} | {got['maps_hz']:.2f} | {images} | {late} | {late_image} | {got['cpu_percent']:.0f} "
        f"| {got['peak_mb']:.0f} |"
    )


def in_ros() -> bool:
    """Whether this interpreter has rclpy; else the one of .venv-ros2 takes over, where there is one."""
    try:
        import rclpy  # noqa: F401
    except ImportError:
        other = ROOT / ".venv-ros2/bin/python"
        if other.exists() and Path(sys.executable) != other:
            os.environ["PYTHONPATH"] = str(ROOT / "src")
            os.execv(other, [str(other), __file__, *sys.argv[1:]])
        print("no rclpy: make ros2 first")
        return False
    return True


def main() -> None:
    """Every case."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--seconds", type=float, default=60.0, help="of flight, each case")
    words.add_argument("--speak", help=argparse.SUPPRESS)
    words.add_argument("--pace", type=float, default=1.0, help="times real time; a busy machine needs less than 1")
    words.add_argument("--keep", type=Path, help="folder for the recordings, used again where they are there")
    words.add_argument("--details", action="store_true", help="every figure of each run as JSON")
    words.add_argument("--only", default="", help="only the cases whose name holds this")
    given = words.parse_args()
    if not in_ros():
        return
    if given.speak:
        speak(given.speak, given.pace)
        return
    os.environ.setdefault("ROS_DOMAIN_ID", "102")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from ullage.experiments import warmup

    if not warmup.compiled():
        warmup.compile_kernels()
    print("| node | maps/s | images/s | map p50 / p99 [ms] | image p50 / p99 [ms] | CPU [%] | memory [MB] |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as made:
        folder = given.keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        for method, extra in CASES:
            if given.only not in f"{method} {extra}":
                continue
            path = folder / f"{SCENARIOS[method]}.mcap"
            if not path.exists():
                record(path, SCENARIOS[method], given.seconds)
            got = measure(path, {"method": method, "every_s": "0.2", "reach_m": REACH_M} | extra, given.pace)
            print(row(method, extra, got), flush=True)
            if given.details:
                print(json.dumps(got), flush=True)


if __name__ == "__main__":
    main()
