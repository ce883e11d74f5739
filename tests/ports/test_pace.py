"""When stamps are due: by their own clock, and never in years."""

import time

import numpy as np
import pytest

import ullage as ul
from ullage.errors import UllageWarning
from ullage.ports.following import PacedSink
from ullage.ports.pace import Pace

S = 10**9


def test_stamps_are_due_by_their_own_clock():
    pace = Pace(2.0)
    assert [pace.due_s(t * S, 100.0) for t in (5, 6, 9)] == [100.0, 100.5, 102.0]
    assert pace.stamp_at(101.0) == 7 * S


def test_a_jump_back_and_a_late_maker_begin_anew():
    pace = Pace(1.0)
    pace.due_s(50 * S, 0.0)
    assert pace.due_s(10 * S, 1.0) == 1.0
    assert pace.due_s(11 * S, 1.0) == 2.0
    assert pace.due_s(12 * S, 7.0) == 7.0
    assert pace.due_s(13 * S, 7.0) == 8.0


def test_a_leap_ahead_is_said_and_not_waited_for():
    pace = Pace(1.0)
    pace.due_s(0, 0.0)
    assert pace.due_s(9 * S, 0.0) == 9.0
    with pytest.warns(UllageWarning, match=r"the stamps leap 3\.16e\+08 s ahead, which is not waited for"):
        assert pace.due_s(9 * S + 316 * 10**6 * S, 9.0) == 9.0
    assert pace.due_s(10 * S + 316 * 10**6 * S, 9.0) == 10.0


def test_at_once_is_at_once():
    assert Pace(0).due_s(10**18, 3.0) == 3.0


class Kept(PacedSink):
    def __init__(self):
        super().__init__(1.0)
        self.kept = []

    def give(self, frames):
        self.kept.append(int(frames.t_ns[0]))

    def close(self):
        pass


def test_a_paced_sink_goes_on_after_a_leap():
    path = ul.Trajectory(
        np.array([0, S // 10, 40 * S, 401 * S // 10]), np.zeros((4, 3)), np.tile([0, 0, 0, 1.0], (4, 1))
    )
    frames = ul.simulate(ul.scenes.plate(width_m=1, height_m=1, distance_m=2), path, ul.RadarSpec(), fidelity="thesis")
    sink, start = Kept(), time.monotonic()
    with pytest.warns(UllageWarning, match="leap 39.9 s ahead"):
        sink.write(frames)
    assert sink.kept == path.t_ns.tolist()
    assert time.monotonic() - start < 30
