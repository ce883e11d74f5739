"""`ullage run imc:... --to ros2:` and `ullage run ros2: --to imc:...`, one after the other, over real ROS 2."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.ports.imc.assemble import FrameAssembler, Track
from ullage.ports.imc.broker import LOCAL
from ullage.ports.imc.codec import Packet, Parser, encode, make
from ullage.ports.imc.frames import BODY
from ullage.ports.imc.table import own
from ullage.ports.ned import Geodetic

from .network import ROOT, Network, result_of

pytestmark = pytest.mark.ros2
BUS = ROOT / "tests/ports/imc/imc_bus.py"
OTHER = 0x0804  # not the vehicle whose poses are followed


def bus(network: Network, seconds: float, kept: Path, *also: Path) -> tuple[subprocess.Popen[str], str]:
    """A process that stands for DUNE: what it is sent ends up in `kept`; it says what is in `also`."""
    started = network.start(BUS, "0", str(seconds), kept, *also)
    assert started.stdout is not None
    return started, f"tcp://127.0.0.1:{started.stdout.readline().strip()}"


def packets_in(kept: Path) -> list[Packet]:
    parser = Parser()
    found = list(parser.feed(kept.read_bytes()))
    assert parser.garbage == 0
    return found


@pytest.mark.slow
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
    heard = result_of(listener, stop=True)
    assert heard["count"]["/dune/odom"] > 20
    assert heard["last"]["/dune/odom"]["pose"]["pose"]["position"]["x"] == pytest.approx(0.0, abs=1e-6)
    assert heard["last"]["/tf"]["transforms"][0]["child_frame_id"] == "base_link"

    gather = FrameAssembler(Track(origin=Geodetic.degrees(63.4185, 10.4009, 40.0)))
    for packet in packets_in(tmp_path / "ground.bin"):
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


KINDS = [name for name in own().by_name if name not in LOCAL]


def every_message(count: int) -> list[Packet]:
    """Messages of every kind, in turn, none like the one before."""
    out = []
    for k in range(count):
        name = KINDS[k % len(KINDS)]
        blank = make(name).values
        fields = {key: (8 * (k % 41) + n) / 1024 for n, (key, v) in enumerate(blank.items()) if isinstance(v, float)}
        if name == "Distance":
            fields["location"] = (make("DeviceState", x=0.125 * k, psi=0.5),)
        if name == "SonarData":
            fields |= {"data": bytes(range(k % 250)), "bits_per_point": 8, "frequency": k, "max_range": 9}
        for unit in {"z_units", "speed_units"} & blank.keys():
            fields[unit] = k // len(KINDS) % 3
        if "description" in blank:
            fields["description"] = f"state {k}"
        out.append(Packet(make(name, **fields), 1.7e9 + k, OTHER, 9))
    return out


@pytest.mark.slow
def test_what_is_said_on_a_bus_is_said_on_ros_and_on_another_bus_and_what_ros_wants_too(
    network: Network, tmp_path: Path
) -> None:
    said = every_message(700)
    (tmp_path / "said.bin").write_bytes(b"".join(map(encode, said)))
    listener = network.ready(
        "hear.py", "/dune/imc/desired/heading=std_msgs/msg/Float64:stream",
        "/dune/imc/temperature=sensor_msgs/msg/Temperature:stream", "/dune/imc/packet=imc_msgs/msg/Raw:stream",
    )  # fmt: skip
    ground, where = bus(network, 60.0, tmp_path / "ground.bin")
    back = network.start(
        "-m", "ullage", "run", "ros2:/dune?idle_s=4&node=back", "--do", "", "--out", tmp_path / "back",
        "--to", f"imc:{where}?pace=0",
    )  # fmt: skip
    wishes = network.start("wish.py", "/dune/desired/height=4.25", "/dune/desired/speed=0.5", "/dune/to_imc/power=7.5")
    dune, place = bus(network, 18.5, tmp_path / "dune.bin", tmp_path / "said.bin")
    there = network.start(
        "-m", "ullage", "run", f"imc:{place}?reconnect=false", "--do", "", "--out", tmp_path / "there",
        "--to", "ros2:/dune?linger_s=2",
    )  # fmt: skip
    result_of(wishes, timeout=120)
    for process in (there, back):
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, out + err
    ground.communicate(timeout=60)
    dune.communicate(timeout=60)
    count = result_of(listener, stop=True)["count"]
    assert count["/dune/imc/packet"] > 300
    assert set(count) == {"/dune/imc/packet", "/dune/imc/temperature", "/dune/imc/desired/heading"}

    got = packets_in(tmp_path / "ground.bin")
    part = next(p["id"] for p in got if p.name == "EntityInfo" and p["label"] == f"{OTHER:#06x}/9")
    came = [p for p in got if p.src_ent == part and p.t_s < 1.7001e9]
    by_time = {p.t_s: p for p in said}
    for other in came:
        assert encode(Packet(by_time[other.t_s].message)) == encode(Packet(other.message))
    assert [p.t_s for p in came] == sorted({p.t_s for p in came})
    # until every topic is found its messages are gone; from then on none is
    assert [p.t_s for p in came[-len(KINDS) :]] == [p.t_s for p in said[-len(KINDS) :]]
    assert {p.name for p in came[-len(KINDS) :]} == set(KINDS)
    wanted = {
        (p.name, p["value"]) for p in got if p.src_ent == BODY and p.name in ("DesiredZ", "DesiredSpeed", "Power")
    }
    assert wanted == {("DesiredZ", 4.25), ("DesiredSpeed", 0.5), ("Power", 7.5)}
