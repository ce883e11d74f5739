"""The explorer leads a DUNE vehicle by references, until it is done, refused, or the operator takes over."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from imc_peer import Copter, Follower, Peer

import ullage as ul

pytestmark = pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
ROOM = ul.scenes.room(size_m=(6, 5, 3))
QUICK = ["sensing.rate_hz=10", "sensing.fidelity=thesis"]


def explore(peer: Peer, time_s: float, **more: Any) -> ul.Explored:
    return ul.explore(ROOM, time_s=time_s, vehicle=f"imc:{peer.place}", options=QUICK, **more)


def test_a_vehicle_explores_by_references_and_its_plan_is_stopped() -> None:
    copter = Copter((0.0, 0.0, 0.0))
    with Peer(react=copter.react, tick=copter.tick) as peer:
        explored = explore(peer, 30.0)  # on a busy machine decisions come late
        time.sleep(0.2)
        references = [packet for packet in peer.heard if packet.name == "Reference"]
    places = np.array(copter.track)
    assert copter.stopped
    assert np.abs(places[:, 0]).max() < 2.5 - 0.4
    assert np.abs(places[:, 1]).max() < 3.0 - 0.4
    assert np.linalg.norm(np.diff(explored.flown.position[:, :2], axis=0), axis=1).sum() > 1.5
    assert {packet["speed"]["value"] <= 1.0 for packet in references} == {True}
    assert explored.summary.startswith("The flight ended on the ground at home: ")
    assert len(explored.decisions) > 1


def test_an_operator_who_starts_another_plan_has_the_vehicle() -> None:
    copter, begun = Copter((0.0, 0.0, 0.0)), time.monotonic()

    def take_over(words: str) -> None:
        if time.monotonic() - begun > 3.0:
            copter.plan = "inspect"

    with Peer(react=copter.react, tick=copter.tick) as peer:
        explored = explore(peer, 60.0, progress=take_over)
        time.sleep(0.2)
    assert "another plan runs, or none: the operator took over" in explored.summary
    assert not copter.stopped
    assert copter.plan == "inspect"


def test_a_vehicle_that_does_not_follow_is_no_vehicle() -> None:
    vehicle = Follower(refuses=b"no such maneuver")
    with (
        Peer(react=vehicle.react, tick=vehicle.tick) as peer,
        pytest.raises(ul.InputError, match="vehicle: the vehicle does not follow"),
    ):
        explore(peer, 10.0)
