"""The live port against a peer in a process of its own."""

from __future__ import annotations

import itertools
import json
import math
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from imc_bus import LAT, LON, estimated_state
from imc_peer import Peer

import ullage as ul
from ullage.ports.imc.codec import Packet, Parser
from ullage.ports.live import Address

BUS = Path(__file__).parent / "imc_bus.py"


@contextmanager
def bus(folder: Path, seconds: float) -> Iterator[tuple[str, Path]]:
    """The place of a bus, and the file that will hold what it was sent."""
    kept = folder / "kept.bin"
    command = [sys.executable, str(BUS), "0", str(seconds), str(kept)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield f"tcp://127.0.0.1:{process.stdout.readline().strip()}", kept
        process.wait(30)


def heard(kept: Path) -> list[Packet]:
    parser = Parser()
    found = list(parser.feed(kept.read_bytes()))
    assert parser.garbage == 0
    return found


def room_frames(rig: ul.Rig | None = None) -> dict[str, ul.Frames]:
    path = ul.Trajectory.line((-1, 0, 0), (-0.5, 0, 0), 0.5, 25)
    return ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, rig or ul.Rig.preset("thesis-4"), fidelity="thesis")


def test_radars_are_simulated_along_the_vehicle(tmp_path: Path) -> None:
    asked = "world=ntnu-room&fidelity=thesis&reconnect=false"
    with bus(tmp_path, 2.0) as (place, kept), ul.open(f"imc:{place}?{asked}") as source:
        frames = source.frames()
        flown = source.trajectory()
    assert set(frames) == {"front", "left", "back", "right"}
    front = frames["front"]
    assert len(front) >= 2.0 * 17 - 2
    assert np.allclose(np.diff(front.t_ns), 1e9 / 17, atol=2)
    # half a metre a second to the north, looking east: psi is clockwise from north, the radar sits 0.1 m ahead
    assert np.allclose(front.poses.position[:, [0, 2]], [0.1, 2.0], atol=1e-6)
    speed = (front.poses.position[-1, 1] - front.poses.position[0, 1]) / ((front.t_ns[-1] - front.t_ns[0]) * 1e-9)
    assert speed == pytest.approx(0.5, abs=1e-3)
    assert np.allclose(front.poses.world_from_body[:, :3, 0], [1, 0, 0], atol=1e-6)
    assert flown is not None
    assert np.allclose(flown.rates[0], [0, 0.5, 0], atol=1e-6)
    names = Counter(packet.name for packet in heard(kept))
    assert names["Announce"] >= 1
    assert names["Heartbeat"] >= 2
    assert names["EntityState"] >= 2


def test_poses_that_waited_are_simulated_in_short_pieces() -> None:
    sent = iter([b"".join(estimated_state(1e9 + k / 20, 0.02 * k, 0.0, -1.0, 0.0) for k in range(50))])
    asked = "world=ntnu-room&fidelity=thesis&rig=single&rate_hz=40&duration_s=2"
    with Peer(tick=lambda _: next(sent, b"")) as peer, ul.open(f"imc:{peer.place}?{asked}") as source:
        times = [part.t_ns for chunk in source.stream() for part in chunk.values()]
    assert max(np.ptp(part) for part in times) <= 0.2e9
    np.testing.assert_allclose(np.diff(np.concatenate(times)), 0.025e9, atol=2)


def test_a_bus_is_given_what_the_radars_saw(tmp_path: Path) -> None:
    frames = room_frames()
    with bus(tmp_path, 3.0) as (place, kept), ul.sink(f"imc:{place}?labels=front=Nose&pace=4") as sink:
        sink.write(frames)
    found = heard(kept)
    listed = [packet["list"] for packet in found if packet.name == "EntityList"]
    assert listed[-1] == "ullage=1;Nose=10;left=11;back=12;right=13"
    infos = {packet["id"]: packet["label"] for packet in found if packet.name == "EntityInfo"}
    assert infos[10] == "Nose"
    mine = [packet for packet in found if packet.src_ent == 10]
    names = Counter(packet.name for packet in mine)
    n = len(frames["front"])
    assert (names["Distance"], names["SonarData"], names["DevDataBinary"]) == (n, n, n + 1)
    near = [packet for packet in mine if packet.name == "Distance"]
    assert {packet["validity"] for packet in near} == {1}
    beam = near[0]["beam_config"][0]
    assert math.degrees(beam["beam_width"]) == pytest.approx(65.0)
    # the floor is 1.5 m below, first met at the edge of the opening
    assert near[0]["value"] == pytest.approx(1.5 / math.sin(math.radians(32.5)), abs=0.1)
    assert near[0]["location"][0]["x"] == pytest.approx(0.1)
    announced = next(packet for packet in found if packet.name == "Announce")
    assert (announced["lat"], announced["lon"]) == pytest.approx((LAT, LON))


def test_a_vehicle_of_imcpy_and_ullage_find_each_other_by_multicast(tmp_path: Path) -> None:
    pytest.importorskip("imcpy", reason="imcpy, which holds DUNE's own codec, is not installed")
    alone = ["unshare", "-n", "sh", "-c"]  # a network of its own: nobody else's announcements
    there_is = all(map(shutil.which, ("unshare", "ip")))
    if not there_is or subprocess.run([*alone, "ip link set lo up"], check=False).returncode:
        pytest.skip("no network of its own can be had here (unshare, ip)")
    there = "imc:?world=ntnu-room&fidelity=thesis&duration_s=2"
    script = f"""
ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo
timeout 60 {sys.executable} {BUS.parent / "imcpy_vehicle.py"} > vehicle.json &
timeout 60 {sys.executable} -m ullage run '{there}' --do '' --to 'imc:?pace=0' --out .
wait
"""
    ran = subprocess.run([*alone, script], check=False, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "also uses the address" not in ran.stderr
    told = json.loads((tmp_path / "vehicle.json").read_text())
    assert told["speakers"] == [0x9001]
    assert told["listed"] == "ullage=1;front=10;left=11;back=12;right=13"
    flown = ul.open(next(tmp_path.glob("imc-*/frames.mcap"))).frames()
    n = sum(map(len, flown.values()))
    assert n >= 4 * (2 * 17 - 2)
    for kind, sent in (("Distance", n), ("SonarData", n), ("DevDataBinary", n + 4)):
        assert 0 < told["count"][kind] <= sent  # a busy machine loses datagrams; over TCP another test counts each
    assert "EstimatedState" not in told["count"]  # what it said itself is not said to it again
    front = flown["front"]
    speed = np.diff(front.poses.position[[0, -1]], axis=0)[0] / (np.ptp(front.t_ns) * 1e-9)
    np.testing.assert_allclose(speed, [0, 0.5, 0], atol=0.02)
    np.testing.assert_allclose(front.poses.position[:, 2], 1.5, atol=1e-3)


def test_a_source_and_a_sink_on_one_bus_are_one_system(tmp_path: Path) -> None:
    asked = "world=ntnu-room&fidelity=thesis&duration_s=0.5"
    with bus(tmp_path, 2.0) as (place, kept), ul.open(f"imc:{place}?{asked}") as source:
        with ul.sink(f"imc:{place}?pace=0") as sink:
            for part in source.stream():
                sink.write(part)
        list(source.stream())  # the sink has gone, the link has not
    found = [packet for packet in heard(kept) if packet.name == "Announce"]
    systems = {packet["services"].partition("/uid/")[2][:16] for packet in found}
    assert len(systems) == 1
    assert any(packet.name == "DevDataBinary" for packet in heard(kept))


def test_the_bus_gives_poses_for_frames_from_elsewhere() -> None:
    sent = iter([b"".join(estimated_state(1e9 + k / 20, 0.5 * k, 0.0, -1.0, 0.0) for k in range(50))])
    with Peer(tick=lambda _: next(sent, b"")) as peer:
        address = Address.of(f"imc:{peer.place}?reconnect=false")
        assert address is not None
        feed = address.open("poses")
        poses = list(itertools.islice(filter(None, iter(lambda: feed.next(0.1), object())), 49))
        feed.close()
    np.testing.assert_array_equal([pose.t_ns for pose in poses], [round(1e18 + k * 5e7) for k in range(49)])
    np.testing.assert_allclose([pose.position[1] for pose in poses], 0.5 * np.arange(49), atol=1e-6)
