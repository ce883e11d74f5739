"""When stamps are due: by their own clock, and never in years."""

import time

import numpy as np
import pytest

import ullage as ul
from ullage.errors import UllageWarning
from ullage.ports.gazebo.topics import GazeboSink
from ullage.ports.publisher import Message, RateLimiter
from ullage.ports.ros2.sink import StampOrder

S = 10**9


DUE = {
    "by their own clock": (2.0, [(5, 100.0, 100.0), (6, 100.0, 100.5), (9, 100.0, 102.0)]),
    "anew after a jump back and a late maker": (1.0, [(50, 0, 0), (10, 1, 1), (11, 1, 2), (12, 7, 7), (13, 7, 8)]),
    "at once where late, and nothing moves": (1.0, [(10, 0, 0), (12, 2, 2), (11.5, 2, 1.5), (13, 2, 3)]),
    "at once": (0.0, [(10**9, 3, 3)]),
}
"""Rate; stamps [s], when they come, and when they are due [s]."""


@pytest.mark.parametrize("how", DUE)
def test_stamps_are_due(how):
    rate, stamps = DUE[how]
    pace = RateLimiter(rate)
    assert [pace.due_s(round(t * S), now_s) for t, now_s, _ in stamps] == [due_s for *_, due_s in stamps]


def at(t_ns: int, what: str = "frame") -> Message:
    return Message(t_ns, what, "", "stream", b"")


def test_what_is_made_of_a_piece_goes_out_with_it_in_the_order_of_the_stamps():
    order = StampOrder()
    out: list[list[int]] = []
    for start in (0, 4, 8, 12):
        out.append([message.t_ns for message in order.begin_piece(start, start + 3)])
        order.hold([at(start + k) for k in range(4)])
        order.hold([at(start + 1, "detection"), at(start + 3, "map")])
    out.append([message.t_ns for message in order.finish()])
    assert out == [[], [0, 1, 1, 2, 3, 3], [4, 5, 5, 6, 7, 7], [8, 9, 9, 10, 11, 11], [12, 13, 13, 14, 15, 15]]


def test_nothing_flows_before_as_much_is_complete_as_the_longest_piece_spans():
    order = StampOrder()
    out = []
    for first, last in ((0, 9), (10, 59), (60, 109), (110, 159)):
        out.append(len(order.begin_piece(first, last)))
        order.hold([at(t_ns) for t_ns in range(first, last + 1)])
    assert out == [0, 0, 60, 50]


def test_a_step_back_ends_the_stretch_before_it():
    order = StampOrder()
    order.begin_piece(50 * S, 51 * S)
    order.hold([at(51 * S), at(50 * S)])
    assert [message.t_ns for message in order.begin_piece(0, S)] == [50 * S, 51 * S]
    order.hold([at(0)])
    assert [message.t_ns for message in order.finish()] == [0]


def test_a_leap_ahead_is_said_and_not_waited_for():
    pace = RateLimiter(1.0)
    pace.due_s(0, 0.0)
    assert pace.due_s(9 * S, 0.0) == 9.0
    with pytest.warns(UllageWarning, match=r"the stamps leap 3\.16e\+08 s ahead, which is not waited for"):
        assert pace.due_s(9 * S + 316 * 10**6 * S, 9.0) == 9.0
    assert pace.due_s(10 * S + 316 * 10**6 * S, 9.0) == 10.0


class Topics:
    peer = None

    def __init__(self):
        self.kept = []

    def write(self, frames):
        self.kept.append(int(frames.t_ns[0]))


def test_a_paced_sink_goes_on_after_a_leap():
    path = ul.Trajectory(
        np.array([0, S // 10, 40 * S, 401 * S // 10]), np.zeros((4, 3)), np.tile([0, 0, 0, 1.0], (4, 1))
    )
    frames = ul.simulate(ul.scenes.plate(width_m=1, height_m=1, distance_m=2), path, ul.RadarSpec(), fidelity="thesis")
    topics, start = Topics(), time.monotonic()
    with pytest.warns(UllageWarning, match="leap 39.9 s ahead"):
        GazeboSink(topics, 1.0).write(frames)
    assert topics.kept == path.t_ns.tolist()
    assert time.monotonic() - start < 30
