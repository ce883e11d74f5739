"""The study of exploring flights: a person who walks is met by physics and judge."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from studies.tables import exploring
from ullage.data import strung
from ullage.experiments.exploration_report import clearances_m
from ullage.flight.airframe import airframe
from ullage.flight.live import Steered

ROOM = ul.scenes.room(size_m=(6, 5, 3))


def test_a_person_walks_from_wall_to_wall_at_a_constant_speed() -> None:
    person = exploring.walker(ROOM, 30.0)
    motion, (low, high) = person.objects[0].motion, ROOM.bounds
    assert motion is not None
    assert motion.duration_s == pytest.approx(30.0)
    steps = np.linalg.norm(np.diff(motion.position, axis=0), axis=1)
    assert steps == pytest.approx(0.1)  # 4 m there, 4 m back
    for when in motion.t_ns[::10].tolist():
        corners = person.corners(when).reshape(-1, 3)
        assert (corners >= low - 1e-9).all()
        assert (corners <= high + 1e-9).all()


def test_a_hovering_vehicle_is_hit_by_a_person_and_its_distance_follows_the_person() -> None:
    person = exploring.walker(ROOM, 10.0)
    motion, hull_m = person.objects[0].motion, airframe("hector").radius_m
    assert motion is not None
    scene = ROOM.add(person)
    vehicle = Steered(scene=scene, start=(0.0, 0.0, -0.6, 0.0), moving_s=10.0)
    flown = strung([vehicle.fly_to(t_ns) for t_ns in motion.t_ns[:30].tolist()])
    assert [scene.objects[owner].name for _, owner, _ in vehicle.contacts] == [exploring.PERSON]
    gaps = clearances_m(scene, flown, "hector")[:14]  # before it is hit
    assert gaps == pytest.approx(np.abs(motion.position[:14, 1]) - 0.25 - hull_m, abs=0.02)
