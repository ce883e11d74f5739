"""Backseat both ways: a mission leads a vehicle on the bus, and a controller on the bus flies our multirotor."""

from __future__ import annotations

import struct
import time
import warnings

import numpy as np
import pytest
from imc_bus import HEIGHT, VEHICLE, packed
from imc_peer import Follower, Peer
from waiting import until

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.ports import schema as ros
from ullage.ports.imc import backseat
from ullage.ports.imc.codec import Packet, encode, make
from ullage.ports.imc.source import ImcSource


def desired_z(value: float, units: int) -> bytes:
    return packed(401, struct.pack("<fB", value, units), t_s=time.time())


def test_a_mission_leads_a_vehicle_through_its_waypoints() -> None:
    vehicle = Follower()
    goals = np.array([(0.0, 5.0, 2.0), (4.0, 5.0, 2.0), (4.0, 0.0, 1.0)])
    with Peer(react=vehicle.react, tick=vehicle.tick) as peer:
        text = ";".join(",".join(map(str, goal)) for goal in goals)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            with ul.open(f"imc:{peer.place}?mission={text}&speed_m_s=2&near_m=0.3&duration_s=60") as source:
                list(source.stream())
                path = source.trajectory()
        time.sleep(0.2)
        heard = list(peer.heard)
    told = [str(w.message) for w in said]
    assert any("follows" in line for line in told)
    assert any("the mission is flown" in line for line in told)
    asked = [packet for packet in heard if packet.name == "PlanControl"]
    assert asked[0]["arg"].name == "FollowReference"
    assert asked[0]["arg"]["control_src"] == asked[0].src == 0x9001
    assert asked[0].dst == VEHICLE
    assert vehicle.stopped
    references = [packet for packet in heard if packet.name == "Reference"]
    assert {packet["speed"]["value"] for packet in references} == {2.0}
    assert {packet["z"]["z_units"] for packet in references} == {3}
    assert references[0]["z"]["value"] == pytest.approx(HEIGHT + 2.0, abs=1e-3)
    beat = np.diff([packet.t_s for packet in references[:-1]])
    assert np.median(beat) == pytest.approx(0.5, abs=0.15)
    for goal in goals:
        assert np.linalg.norm(path.position - goal, axis=1).min() < 0.35


def test_a_vehicle_that_does_not_follow_says_why() -> None:
    vehicle = Follower(refuses=b"no such maneuver")
    with Peer(react=vehicle.react, tick=vehicle.tick) as peer:
        place = f"imc:{peer.place}?mission=9,0,0"
        with pytest.warns(UllageWarning, match="does not follow: no such maneuver"), ul.open(place) as source:
            list(source.stream())
        time.sleep(0.2)
        led = [packet for packet in peer.heard if packet.name == "Reference"]
    assert len(led) <= 2  # not led on after its answer


STATISTICS = encode(Packet(make("PlanStatistics", plan_id="ullage", durations="Total=60")))[20:-2]
ARGUMENTS = {
    "PlanStatistics": struct.pack("<H", 564) + STATISTICS,
    "a message nobody knows": struct.pack("<H", 5001) + b"\x01whatever it holds",
}


@pytest.mark.parametrize("argument", ARGUMENTS)
def test_a_plan_is_started_once_whatever_the_answer_carries(argument: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """DUNE's answers carry PlanStatistics: when that was not known, the plan was started anew every five seconds."""
    monkeypatch.setattr(backseat, "ANSWER_S", 0.3)
    vehicle = Follower(argument=ARGUMENTS[argument])
    with Peer(react=vehicle.react, tick=vehicle.tick) as peer:
        place = f"imc:{peer.place}?mission=0,30,2&speed_m_s=2&duration_s=2"
        with pytest.warns(UllageWarning, match="follows"), ul.open(place) as source:
            list(source.stream())
    assert vehicle.starts == 1


def flown(source: ImcSource) -> ul.Trajectory:
    """The path until the stream ends."""
    list(source.stream())
    path = source.trajectory()
    assert path is not None
    return path


@pytest.mark.parametrize("reports", [True, False])
def test_a_vehicle_that_circles_a_point_on_its_loiter_radius_has_reached_it(reports: bool) -> None:
    """DUNE's lauv-simulator loiters at 7.5 m, and never comes within a metre of a point."""
    vehicle = Follower(radius_m=7.5, reports=reports)
    goals = ((0.0, 40.0, 2.0), (40.0, 40.0, 2.0))
    with Peer(react=vehicle.react, tick=vehicle.tick) as peer:
        text = ";".join(",".join(map(str, goal)) for goal in goals)
        place = f"imc:{peer.place}?mission={text}&speed_m_s=4&duration_s=60"
        with pytest.warns(UllageWarning, match="the mission is flown"), ul.open(place) as source:
            path = flown(source)
        time.sleep(0.2)
    for goal in goals:
        assert 1.0 < np.linalg.norm((path.position - goal)[:, :2], axis=1).min() < 8.0
    assert vehicle.stopped


def test_a_vehicle_is_released_when_the_run_ends_before_the_mission() -> None:
    vehicle = Follower()
    with Peer(react=vehicle.react, tick=vehicle.tick) as peer:
        place = f"imc:{peer.place}?mission=0,300,2&duration_s=1.5"
        with pytest.warns(UllageWarning, match="follows"), ul.open(place) as source:
            flown(source)
        time.sleep(0.2)
        (stop,) = [packet for packet in peer.heard if packet.name == "PlanControl" and packet["op"] == 1]
    assert vehicle.stopped
    assert stop["plan_id"] == "ullage"


class HeightController:
    """Wants another height after three seconds of the vehicle's clock."""

    def __init__(self) -> None:
        self.first: float | None = None
        self.asked_at: float | None = None
        self.seen: list[tuple[float, float]] = []

    def react(self, packet: Packet, now: float) -> bytes:
        if packet.name != "EstimatedState":
            return b""
        if self.first is None:
            self.first = packet.t_s
        t_s = packet.t_s - self.first
        self.seen.append((t_s, packet["height"] - packet["z"]))
        if self.asked_at is None and t_s >= 3.0:
            self.asked_at = t_s
            return desired_z(packet["height"] + 2.0, 3)
        return b""


def test_a_controller_on_the_bus_sets_the_height_of_our_multirotor() -> None:
    controller = HeightController()
    with Peer(react=controller.react) as peer:
        asked = "fly=hector&start=0,0,1&pace=4&world=ntnu-room&fidelity=thesis&rig=single&duration_s=10"
        with ul.open(f"imc:{peer.place}?{asked}&rate_hz=5") as source:
            frames = source.frames()
        heard = list(peer.heard)
    states = [packet for packet in heard if packet.name == "EstimatedState"]
    assert {packet.src for packet in states[5:]} == {VEHICLE}  # it has become DUNE's own vehicle
    assert np.diff([packet.t_s for packet in states]) == pytest.approx(0.05, abs=0.0021)
    t_s, height = np.array(controller.seen).T
    before, after = height[t_s < 3.0], height[t_s > 9.0]
    assert before == pytest.approx(1.0, abs=1e-3)
    assert after == pytest.approx(2.0, abs=0.02)
    assert height.max() < 2.03
    assert len(frames) >= 45
    assert frames.poses.position[0, 2] == pytest.approx(1.0, abs=1e-3)
    assert frames.poses.position[-1, 2] == pytest.approx(2.0, abs=0.02)


def test_the_path_and_the_commands_of_a_flight_come_before_frames_that_are_late() -> None:
    controller, came = HeightController(), list[object]()
    asked = "fly=hector&start=0,0,1&world=ntnu-room&fidelity=thesis&rig=single&rate_hz=5&pace=3"
    with Peer(react=controller.react) as peer, ul.open(f"imc:{peer.place}?{asked}") as source:
        source.passing.to(came.append)
        stream = source.stream()
        next(piece for piece in stream if piece)
        source.keep_up(0.5)
        flown = sum(len(item) for item in came if isinstance(item, ul.Trajectory))
        until(lambda: sum(len(i) for i in came if isinstance(i, ul.Trajectory)) >= flown + 80)  # and asks for no frames
        assert source.behind_s > 1.0
        paths = [item for item in came if isinstance(item, ul.Trajectory)]
        assert sum(map(len, paths)) >= flown + 80
        after = next(piece for piece in stream if piece)
        assert source.counters.dropped("lost", topic="frames") > 0  # and what is used is of now
        assert next(iter(after.values())).t_ns[0] > paths[-1].t_ns[-1] - 3e9
    packets = [item for item in came if getattr(item, "topic", "") == "imc/packet"]
    assert any(ros.from_bytes(ros.RAW, item.data).name == "DesiredZ" for item in packets)


def forces(newton: float) -> bytes:
    return packed(407, struct.pack("<6dB", 0, 0, newton, 0, 0, 0, 4), t_s=time.time())


def test_forces_are_taken_down_as_ned_has_them() -> None:
    sent = []

    def react(packet: Packet, now: float) -> bytes:
        if packet.name == "EstimatedState" and len(sent) < 3:
            sent.append(packet)
            return forces(-0.3)
        return b""

    with Peer(react=react) as peer, ul.open(f"imc:{peer.place}?fly=hector&start=0,0,2&pace=2&duration_s=3") as source:
        assert list(source.stream()) == []
        path = source.trajectory()
    assert path.rates[0][-1, 2] > 0.2  # up


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("fly=kite", "no vehicle 'kite'"),
        ("mission=1,2", "mission is '1,2'.*X,Y,Z in metres"),
        ("mission=world", "world of the library"),
        ("fly=hector&start=1", "start is '1'"),
        ("speed=3", "no option 'speed'.*speed_m_s"),
        ("z=up", "z is .up.*height"),
        ("world=nowhere", "no world 'nowhere'.*cargo-hold"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(options: str, words: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(InputError, match=words) as told:
            ul.open(f"imc:tcp://127.0.0.1:1?{options}")
    assert "\n" not in str(told.value)
