"""When stamps are due: by their own clock, and never in years."""

import time

import numpy as np
import pytest

import ullage as ul
from ullage.errors import UllageWarning
from ullage.ports.gazebo.sink import GazeboSink
from ullage.ports.publisher import Message
from ullage.ports.rate_limiter import RateLimiter
from ullage.ports.ros2.sink import StampOrder

S = 10**9


def test_stamps_are_due_by_their_own_clock():
    pace = RateLimiter(2.0)
    assert [pace.due_s(t * S, 100.0) for t in (5, 6, 9)] == [100.0, 100.5, 102.0]


def test_a_jump_back_and_a_late_maker_begin_anew():
    pace = RateLimiter(1.0)
    pace.due_s(50 * S, 0.0)
    assert pace.due_s(10 * S, 1.0) == 1.0
    assert pace.due_s(11 * S, 1.0) == 2.0
    assert pace.due_s(12 * S, 7.0) == 7.0
    assert pace.due_s(13 * S, 7.0) == 8.0


def test_a_late_message_is_due_at_once_and_moves_nothing():
    pace = RateLimiter(1.0)
    pace.due_s(10 * S, 0.0)
    assert pace.due_s(12 * S, 2.0) == 2.0
    assert pace.due_s(11_500_000_000, 2.0) == 1.5
    assert pace.due_s(13 * S, 2.0) == 3.0


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


def test_at_once_is_at_once():
    assert RateLimiter(0).due_s(10**18, 3.0) == 3.0


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
