"""The study of exploring flights: a person who walks is met by physics and judge, and the summary loses no flight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ullage as ul
from studies.tables import exploring
from ullage.data import strung
from ullage.errors import InputError
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


MAPPED, COUNT = st.integers(0, 100), st.integers(0, 9)
FLIGHT = st.tuples(st.sampled_from(["silo", "office", "a, b"]), st.sampled_from(exploring.KINDS), st.integers(1, 20),
                   MAPPED, MAPPED, COUNT, st.integers(-20, 200), st.booleans())  # fmt: skip


@given(flights=st.lists(FLIGHT, min_size=1, max_size=20, unique_by=lambda one: one[:3]), data=st.data())
def test_a_summary_counts_every_flight_and_keeps_the_worst_of_each_kind(
    flights: list[Any], data: st.DataObject
) -> None:
    rows = [[f"{world}, {seed}", kind, "60; 1.5", f"{half / 100:.2f}; {end / 100:.2f}", f"{touched}; {gap / 100:.2f}",
             "0.10; 0.20; 50" if lost else ""]
            for world, kind, seed, half, end, touched, gap, lost in flights]  # fmt: skip
    out = exploring.summary(rows)
    assert exploring.summary(data.draw(st.permutations(rows))) == out
    assert sum(int(row[2]) for row in out) == len(rows)
    for row in out:
        assert len(row) == len(exploring.SUMMARY)
        mine = [one for one in flights if list(one[:2]) == row[:2]]
        assert row[3] == "60; 1.5"
        mean, *worst = row[4].rstrip(")").split(" (")
        shares = np.array([one[3:5] for one in mine]) / 100
        assert [*map(float, mean.split("; "))] == pytest.approx(shares.mean(0), abs=0.0051)
        assert [[*map(float, part.split("; "))] for part in worst] == [shares.min(0).tolist()] * (len(mine) > 1)
        assert row[5] == f"{sum(one[5] for one in mine)}; {min(one[6] for one in mine) / 100:.2f}"
        assert row[6] == ("0.10; 0.20; 50" if any(one[7] for one in mine) else "")


def test_a_survey_has_no_count_of_contacts_and_a_flight_that_is_there_twice_is_refused() -> None:
    row = ["silo, 1", "survey", "60; 1.2", "1.00; 1.00", "-; 0.57", ""]
    assert exploring.summary([row]) == [["silo", "survey", "1", "60; 1.2", "1.00; 1.00", "-; 0.57", ""]]
    with pytest.raises(InputError, match="'survey' in silo is there twice"):
        exploring.summary([row, row])


def test_the_summary_on_the_page_is_that_of_the_flights() -> None:
    assert exploring.summary(exploring.rows_of(exploring.FLIGHTS)) == exploring.rows_of(exploring.NAME)
