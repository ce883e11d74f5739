"""What comes from outside: bad messages are counted, clocks may step, frames wait for poses."""

import itertools
import threading
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ullage.ports.intake import (
    GAP_NS,
    LATE_NS,
    MOST_STEPS,
    MOST_TOPICS,
    OTHERS,
    REASONS,
    Clock,
    Counters,
    Inbox,
    Place,
    PoseQueue,
    checked_pose,
)

S = 1_000_000_000
STEP = S // 20  # a stream of 20 Hz


def clocked(stamps, topic="radar", clock=None):
    counters = clock.counters if clock else Counters()
    stream = (clock or Clock(counters)).stream(topic)
    out = [stamped for k, stamp in enumerate(stamps) for stamped in stream.take(stamp, k)]
    stream.finish()
    return out, counters, stream


def steady(start_ns=0, count=20):
    return [start_ns + k * STEP for k in range(count)]


@given(st.lists(st.integers(-(2**63), 2**63), max_size=60))
def test_times_rise_and_nothing_vanishes_whatever_the_stamps_are(stamps):
    out, counters, _ = clocked(stamps)
    times = [one.t_ns for one in out]
    assert all(a < b for a, b in itertools.pairwise(times))
    assert len(out) + counters.dropped() == len(stamps)
    assert [one.item for one in out] == sorted(one.item for one in out)
    assert all((one.track > 0) == (one.track > out[0].track) for one in out)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2**62)), max_size=80))
def test_streams_of_one_clock_rise_each_and_lose_nothing(messages):
    counters = Counters()
    clock = Clock(counters)
    streams = [clock.stream(str(k)) for k in range(4)]
    times, given_on = {k: [] for k in range(4)}, 0
    for which, stamp in messages:
        for one in streams[which].take(stamp, None):
            times[which].append(one.t_ns)
            given_on += 1
    for stream in streams:
        stream.finish()
    assert all(np.all(np.diff(np.array(one, object)) > 0) for one in times.values() if len(one) > 1)
    assert given_on + counters.dropped() == len(messages)


@given(st.integers(1, 18), st.integers(GAP_NS + S, 10**15), st.booleans())
def test_one_stamp_far_off_is_bad_and_changes_nothing(at, away, back):
    start = 2 * 10**15
    stamps = steady(start)
    stamps[at] += -away if back else away
    out, counters, _ = clocked(stamps)
    assert [one.stamp_ns for one in out] == [one.t_ns for one in out] == [s for k, s in enumerate(stamps) if k != at]
    assert counters.dropped("bad") == counters.dropped() == 1
    assert counters.steps == 0
    assert {one.track for one in out} == {0}


def test_a_step_over_what_was_left_out_says_so():
    said = []
    counters = Counters(said.append)
    stream = Clock(counters).stream("radar")
    for t_ns in steady():
        stream.take(t_ns, t_ns)
    counters.drop("radar", "lost", "waited longer than 2 s", count=1234)
    for t_ns in steady(100 * S):
        stream.take(t_ns, t_ns)
    assert any("(radar), 1,234 messages were left out before: a new track" in line for line in said)


@given(st.integers(GAP_NS + S, 10**15))
def test_a_step_ahead_begins_a_track_and_keeps_the_sources_own_times(step):
    said = []
    counters = Counters(said.append)
    out, _, stream = clocked([*steady(), *steady(step)], clock=Clock(counters))
    assert [one.t_ns for one in out] == [*steady(), *steady(step)]
    assert [one.starts for one in out] == [k in (0, 20) for k in range(40)]
    assert counters.dropped() == 0
    assert counters.steps == 1
    assert len(said) == 1
    assert said[0].startswith("time jumped ahead ")
    assert "radar" in said[0]
    assert stream.elapsed_ns == 2 * 19 * STEP


@given(st.integers(S, 10**15))
def test_a_step_back_begins_a_track_and_times_go_on(step):
    start = 2 * 10**15
    said = []
    out, counters, _stream = clocked([*steady(start), *steady(start - step)], clock=Clock(Counters(said.append)))
    times = [one.t_ns for one in out]
    assert times[:20] == steady(start)
    assert len(times) == 40
    assert 0 < times[20] - times[19] < S
    assert np.all(np.diff(times[20:]) == STEP)
    assert [one.track for one in out] == [0] * 20 + [1] * 20
    assert counters.dropped() == 0
    assert len(said) == 1
    assert said[0].startswith("time jumped back ")


def test_a_clock_that_is_set_right_again_gives_its_own_times_again():
    stamps = [*steady(), *steady(-20 * S + 100 * S), *steady(60 * S), *steady(200 * S)]
    out, *_ = clocked(stamps)
    assert [one.t_ns for one in out[:40]] == stamps[:40]
    assert out[40].t_ns > stamps[39] > out[40].stamp_ns
    assert [one.t_ns for one in out[60:]] == stamps[60:]


@given(st.integers(1, LATE_NS - 1), st.integers(5, 18))
def test_what_comes_late_or_twice_is_counted(behind, at):
    stamps = steady()
    stamps[at:at] = [stamps[at - 1] - behind, stamps[at - 1]]
    out, counters, _ = clocked([max(stamp, 0) for stamp in stamps])
    assert [one.t_ns for one in out] == steady()
    assert counters.dropped("late") == 1
    assert counters.dropped("duplicate") == 1


def test_one_message_that_was_overtaken_by_half_a_second_is_late_not_a_step():
    stamps = steady(10 * S)
    stamps.insert(12, 10 * S)
    out, counters, _ = clocked(stamps)
    assert [one.t_ns for one in out] == steady(10 * S)
    assert counters.dropped("late") == 1
    assert counters.steps == 0


def test_a_slow_stream_loses_nothing():
    stamps = [k * 3 * S for k in range(10)]
    out, counters, _ = clocked([*stamps])
    assert [one.t_ns for one in out] == stamps[:-1]  # nothing confirms the last one
    assert counters.dropped() == 1


def test_all_streams_of_a_clock_take_one_step_and_report_it_once():
    said = []
    clock = Clock(Counters(said.append))
    streams = [clock.stream(name) for name in ("front", "left", "poses")]
    out = {stream.topic: [] for stream in streams}
    for stamp in [*steady(10 * S), *steady(2 * S)]:
        for k, stream in enumerate(streams):
            out[stream.topic] += stream.take(stamp + k * 1000, None)
    assert len(said) == 1
    offsets = {one.t_ns - one.stamp_ns for times in out.values() for one in times if one.track == 1}
    assert len(offsets) == 1
    assert all(len(times) == 40 for times in out.values())


def test_a_stream_does_not_begin_far_from_the_others_by_one_message():
    clock = Clock(Counters())
    one, other = clock.stream("front"), clock.stream("left")
    for stamp in steady(10 * S):
        one.take(stamp, None)
    assert other.take(5000 * S, None) == []
    assert [k.t_ns for k in other.take(11 * S, None)] == [11 * S]
    assert clock.counters.dropped("bad", topic="left") == 1
    assert clock.counters.steps == 0


finite = st.floats(-1e6, 1e6)


@given(st.tuples(finite, finite, finite), st.lists(finite, min_size=4, max_size=4))
def test_a_pose_is_used_only_with_a_quaternion_of_unit_length(position, quat):
    found = checked_pose(position, quat)
    square = float(np.dot(quat, quat))
    if abs(square - 1) > 0.01:
        assert found == "quaternion is not of unit length"
    else:
        np.testing.assert_array_equal(found[0], position)
        np.testing.assert_allclose(np.linalg.norm(found[1]), 1.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("at", range(7))
def test_a_pose_of_no_number_is_refused(at, bad):
    values = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]
    values[at] = bad
    assert "is not finite" in checked_pose(values[:3], values[3:])


def test_a_flood_is_bounded_in_number_and_bytes_and_every_message_is_accounted_for():
    counters = Counters()
    inbox = Inbox(counters, most=100, most_bytes=5000)
    for k in range(500):
        inbox.put(k, topic="pose", size=10)
        inbox.put(-k, topic="scene", size=400)
    inbox.put("the server has gone")
    taken = []
    while (item := inbox.get(0.0)) is not None:
        taken.append(item)
    assert len(inbox) == 0
    assert taken[-1] == "the server has gone"  # such news finds room always
    assert taken[-5:-1] == [498, -498, 499, -499]  # the oldest are dropped
    assert len(taken) - 1 + counters.dropped("lost") == counters.received() == 1000
    assert counters.dropped("lost", topic="scene") >= 488
    threading.Timer(0.05, inbox.put, ["late"]).start()
    assert inbox.get(5.0) == "late"


def test_frames_wait_for_their_poses_in_order():
    counters = Counters()
    queue = PoseQueue(counters, "front", patience_s=2.0)
    known = {}

    def place(frame):
        return Place("known", known[frame]) if frame in known else Place("wait", missing="odom to base")

    for frame in range(5):
        queue.put(frame, now_s=0.1 * frame)
    known |= {0: "a", 2: "c"}
    assert list(queue.ready(place, 0.5)) == [(0, "a")]
    assert queue.waits_for == "odom to base"
    assert len(queue) == 4
    assert list(queue.ready(place, 2.15)) == [(2, "c")]
    assert counters.dropped("no pose") == 1
    known |= {3: "d", 4: "e"}
    assert [frame for frame, _ in queue.ready(place, 2.15)] == [3, 4]
    assert not queue.waits_for


def test_frames_whose_pose_never_comes_are_dropped_at_once_and_the_queue_is_bounded():
    counters = Counters()
    queue = PoseQueue(counters, "front", most=10)
    for frame in range(25):
        queue.put(frame, 0.0)
    assert len(queue) == 10
    assert counters.dropped("no pose") == 15
    assert list(queue.ready(lambda frame: Place("never", missing="a gap"), 0.0)) == []
    assert counters.lines() == ["front: dropped 25 no pose (more than 10 frames wait; a gap)"]
    queue.put(1, 0.0)
    queue.clear()
    assert counters.dropped(topic="front") == 26
    assert len(queue) == 0


def test_counts_come_in_one_line_a_topic_and_as_pairs():
    counters = Counters()
    counters.receive("odom", 1204)
    counters.receive("scan", 3)
    for cause in ("position is not finite", "too short", "position is not finite"):
        counters.drop("odom", "bad", cause)
    counters.drop("odom", "late")
    assert counters.lines() == ["odom: dropped 3 bad (position is not finite; too short), 1 late, of 1,204 received"]
    assert counters.values() == [
        ("odom: received", "1204"), ("odom: bad", "3"), ("odom: late", "1"), ("scan: received", "3"),
        ("clock steps", "0"),
    ]  # fmt: skip
    assert counters.received() == 1207
    assert counters.received("odom") == 1204
    counters.step("time jumped")
    assert len(counters.lines()) == 1
    counters.step("time jumped")
    assert counters.lines()[-1] == "the clock stepped twice"
    assert counters.values()[-1] == ("clock steps", "2")


def test_reports_come_at_once_and_then_ever_more_rarely():
    said, now = [], [0.0]
    counters = Counters(said.append, now=lambda: now[0])
    for second in range(600):
        now[0] = float(second)
        counters.drop("odom", "bad", "NaN")
        counters.report()
    assert said[0] == "odom: dropped 1 bad (NaN)"
    assert 8 <= len(said) <= 15
    counters.report()
    assert len(said) <= 15
    for _ in range(1000):
        counters.step("time jumped")
    assert said.count("time jumped") == MOST_STEPS


def test_a_million_topics_and_stamps_cost_no_memory():
    counters = Counters()
    streams = Clock(counters).stream("a")
    rng = np.random.default_rng(1)
    tracemalloc.start()
    for k in range(20_000):
        counters.drop(f"topic {k}", REASONS[k % 5], f"cause {k}")
        streams.take(int(rng.integers(0, 2**61)), k)
        if k == 1000:
            before = tracemalloc.get_traced_memory()[0]
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 50_000
    assert len(counters.lines()) <= MOST_TOPICS + 2
    assert counters.dropped(topic=OTHERS) > 19_000
