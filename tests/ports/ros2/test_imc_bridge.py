"""`ullage run imc:... --to ros2:` and `ullage run ros2: --to imc:...`, one after the other, over real ROS 2."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.ports.imc.codec import Packet, Parser
from ullage.ports.imc.gather import Gatherer, Track
from ullage.ports.imc.places import Geodetic

from .network import ROOT, Network, told

pytestmark = pytest.mark.ros2
BUS = ROOT / "tests/ports/imc/imc_bus.py"


def bus(network: Network, seconds: float, kept: Path) -> tuple[subprocess.Popen[str], str]:
    """A process that stands for DUNE: what it is sent ends up in `kept`."""
    started = network.start(BUS, "0", str(seconds), kept)
    assert started.stdout is not None
    return started, f"tcp://127.0.0.1:{started.stdout.readline().strip()}"


def heard(kept: Path) -> list[Packet]:
    parser = Parser()
    found = list(parser.feed(kept.read_bytes()))
    assert parser.garbage == 0
    return found


def test_a_vehicle_goes_to_ros_and_from_ros_to_a_bus_without_losing_a_bit(network: Network, tmp_path: Path) -> None:
    listener = network.ready(
        "hear.py",
        "/dune/odom=nav_msgs/msg/Odometry:stream",
        "/dune/radar/front/frame=ullage_msgs/msg/RadarFrame:sensor",
        "/tf=tf2_msgs/msg/TFMessage:stream",
    )
    ground, where = bus(network, 60.0, tmp_path / "ground.bin")
    origin = "origin=63.4185,10.4009,40"
    back = network.start(
        "-m", "ullage", "run", "ros2:/dune?idle_s=4&node=back", "--do", "", "--out", tmp_path / "back",
        "--to", f"imc:{where}?pace=0&truth=true&state=true&{origin}",
    )  # fmt: skip
    dune, place = bus(network, 8.0, tmp_path / "dune.bin")
    there = network.start(
        "-m", "ullage", "run", f"imc:{place}?world=ntnu-room&fidelity=thesis&reconnect=false&{origin}", "--do", "",
        "--out", tmp_path / "there", "--to", "ros2:/dune?reliable=true&linger_s=2",
    )  # fmt: skip
    for process in (there, back):
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, out + err
    ground.communicate(timeout=60)
    dune.communicate(timeout=60)

    flown = ul.open(next((tmp_path / "there").glob("imc-*/frames.mcap"))).frames()
    assert set(flown) == {"front", "left", "back", "right"}
    told_ = told(listener, stop=True)
    assert told_["count"]["/dune/odom"] > 20
    assert told_["last"]["/dune/odom"]["pose"]["pose"]["position"]["x"] == pytest.approx(0.0, abs=1e-6)
    assert told_["last"]["/tf"]["transforms"][0]["child_frame_id"] == "base_link"

    gather = Gatherer(Track(origin=Geodetic.degrees(63.4185, 10.4009, 40.0)))
    for packet in heard(tmp_path / "ground.bin"):
        gather.take(packet)
    got = gather.give(final=True)
    assert set(got) == set(flown)
    for name, frames in got.items():
        rows = np.searchsorted(flown[name].t_ns, frames.t_ns)
        assert len(rows) > 15  # what was said before its topic was found is gone
        assert np.array_equal(np.diff(rows), np.ones(len(rows) - 1))
        for of in ("t_ns", "samples", "range_m"):
            want = getattr(flown[name], of)
            assert np.array_equal(getattr(frames, of), want if of == "range_m" else want[rows])
        assert frames.spec == flown[name].spec
        assert frames.unit == flown[name].unit
        np.testing.assert_array_equal(frames.poses.position, flown[name].poses.position[rows])
        np.testing.assert_array_equal(frames.poses.quat_xyzw, flown[name].poses.quat_xyzw[rows])
