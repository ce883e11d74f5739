"""Messages of `imc_msgs` with their own fields, both ways over real rclpy.

ULLAGE_ROS2_PYTHON names an interpreter that has the whole package.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from ullage.ports.imc.codec import Packet, Parser, encode, make

from .network import ROOT, Network, result_of

pytestmark = [pytest.mark.ros2, pytest.mark.slow, pytest.mark.timeout(600)]
BUS = ROOT / "tests/ports/imc/imc_bus.py"
NAMES = ("DesiredZ", "LogBookControl", "PlanControl")  # a constant, a list of messages, a message of any kind


@pytest.fixture(scope="module", autouse=True)
def typed(network: Network) -> None:
    """Skip where ROS 2 does not know these messages."""
    known = network.start("-c", f"from imc_msgs.msg import {', '.join(NAMES)}")
    known.communicate(timeout=120)
    if known.returncode:
        pytest.skip("imc_msgs has no typed messages here: docs/dune.md says how to build them")


def test_messages_of_a_bus_become_those_of_imc_msgs(network: Network, tmp_path: Path) -> None:
    plan = make("PlanControl", plan_id="survey", arg=make("DesiredZ", value=7.5), info="go")
    said = [make("DesiredZ", value=4.25, z_units=3), plan]
    packets = [Packet(said[k % 2], 1.7e9 + k, 0x0804, 9) for k in range(400)]
    (tmp_path / "said.bin").write_bytes(b"".join(map(encode, packets)))
    listener = network.ready(
        "hear.py", "/dune/imc/typed/DesiredZ=imc_msgs/msg/DesiredZ:stream",
        "/dune/imc/typed/PlanControl=imc_msgs/msg/PlanControl:stream",
    )  # fmt: skip
    bus = network.start(BUS, "0", "12", tmp_path / "dune.bin", tmp_path / "said.bin")
    assert bus.stdout is not None
    port = bus.stdout.readline().strip()
    relay = network.start(
        "-m", "ullage", "run", f"imc:tcp://127.0.0.1:{port}?reconnect=false&typed=true", "--do", "",
        "--out", tmp_path / "there", "--to", "ros2:/dune?linger_s=2",
    )  # fmt: skip
    out, err = relay.communicate(timeout=120)
    assert relay.returncode == 0, out + err
    bus.communicate(timeout=60)
    got = result_of(listener, stop=True)
    assert min(got["count"].values()) > 20
    height, control = (got["last"][f"/dune/imc/typed/{name}"] for name in ("DesiredZ", "PlanControl"))
    assert (height["value"], height["z_units"], height["src"], height["src_ent"]) == (4.25, 3, 0x0804, 9)
    assert (control["plan_id"], control["info"]) == ("survey", "go")
    (held,) = control["arg"]
    assert held["id"] == int.from_bytes(encode(packets[0])[2:4], "little")


def test_messages_of_imc_msgs_reach_a_bus(network: Network, tmp_path: Path) -> None:
    speaker = network.start("typed.py", "/dune")
    bus = network.start(BUS, "0", "90", tmp_path / "ground.bin")
    assert bus.stdout is not None
    port = bus.stdout.readline().strip()
    relay = network.start(
        "-m", "ullage", "run", "ros2:/dune?idle_s=4&node=back", "--do", "", "--out", tmp_path / "back",
        "--to", f"imc:tcp://127.0.0.1:{port}?pace=0",
    )  # fmt: skip
    assert result_of(speaker) == 2
    out, err = relay.communicate(timeout=120)
    assert relay.returncode == 0, out + err
    bus.communicate(timeout=120)
    found = {packet.name: packet for packet in Parser().feed((tmp_path / "ground.bin").read_bytes())}
    assert (found["DesiredZ"]["value"], found["DesiredZ"]["z_units"]) == (4.25, 3)
    book = found["LogBookControl"]
    assert (book["command"], book["htime"]) == (3, 2.0)
    assert [(entry["context"], entry["text"], entry["htime"]) for entry in book["msg"]] == [
        ("dive", "first", 12.5), ("dive", "second", 12.5),
    ]  # fmt: skip
