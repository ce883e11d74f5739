"""What is published, and when: the sink of ROS 2 and the intake of Gazebo, each beside a peer that only writes down."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np
import pytest
from waiting import until

import ullage as ul
from conftest import some_frames
from ullage.ports import schema as ros
from ullage.ports.protocol import Passed
from ullage.ports.publisher import LATE_S
from ullage.ports.ros2.options import SinkOptions
from ullage.ports.ros2.sink import AHEAD_S, Ros2Sink


class Notebook:
    """A peer that writes down what it is sent, and when."""

    def __init__(self, *, subscribers=(0,), fails_at=None):
        self.sent, self.moments, self.closed, self.spun = [], [], False, False
        self._subscribers, self._fails_at = deque(subscribers), fails_at

    def spin(self):
        self.spun = True

    def publisher(self, topic, kind, quality):
        pass

    def listeners(self, topic):
        return self._subscribers.popleft() if len(self._subscribers) > 1 else self._subscribers[0]

    def send(self, message, *, reliable=None):
        if self._fails_at is not None and len(self.sent) >= self._fails_at:
            raise RuntimeError("the network is gone")
        self.moments.append(time.monotonic())
        self.sent.append((message, reliable))
        return True

    def settle(self, timeout_s):
        pass

    def enter(self, topic):
        return 0.0

    def leave(self, topic):
        pass

    def close(self):
        self.closed = True


def old_frames(count=20, *, start_s=1000.0, step_s=0.02):
    """Frames whose stamps are not of the present."""
    frames = some_frames(count)
    t_ns = (round(start_s * 1e9) + np.arange(count) * round(step_s * 1e9)).astype(np.int64)
    return ul.Frames(frames.samples, frames.range_m, t_ns, frames.spec, sensor="front", unit=frames.unit)


def frame_stamps(peer):
    return [message.t_ns for message, _ in peer.sent if message.topic.endswith("/frame")]


def test_a_stream_of_the_past_leaves_in_order_at_its_pace():
    peer, frames = Notebook(), old_frames(40, step_s=0.02)
    begun = time.monotonic()
    with Ros2Sink("", SinkOptions(pace=4.0), peer=peer) as sink:
        for start in range(0, 40, 10):
            sink.write(frames[start : start + 10])
    assert frame_stamps(peer) == frames.t_ns.tolist()
    stamps = [message.t_ns for message, _ in peer.sent if message.topic != "/diagnostics"]
    assert stamps == sorted(stamps)
    assert peer.moments[-1] - begun >= (frames.t_ns[-1] - frames.t_ns[0]) * 1e-9 / 4.0
    assert peer.closed


@pytest.mark.parametrize("when", ["present", "pace=0"])
def test_a_stream_of_the_present_and_one_without_pace_wait_for_nothing(when):
    """An hour of stamps passes at once."""
    start_s, options = (time.time(), SinkOptions()) if when == "present" else (1000.0, SinkOptions(pace=0))
    peer, frames = Notebook(), old_frames(2, start_s=start_s, step_s=3600.0)
    sink = Ros2Sink("", options, peer=peer)
    sink.write(frames)
    until(lambda: len(frame_stamps(peer)) >= 2)
    assert frame_stamps(peer) == frames.t_ns.tolist()  # before it is closed
    sink.close()


def test_a_source_waits_where_it_is_far_ahead_of_what_is_published():
    """What was written and is not yet published spans no more than `AHEAD_S` and a piece or two."""
    peer, frames = Notebook(), old_frames(80, step_s=0.1)
    with Ros2Sink("", SinkOptions(pace=10.0), peer=peer) as sink:
        for row in range(80):
            sink.write(frames[row : row + 1])
            published = frame_stamps(peer)
            ahead_s = (frames.t_ns[row] - (published[-1] if published else frames.t_ns[0])) * 1e-9
            assert ahead_s <= AHEAD_S + 0.3
    assert frame_stamps(peer) == frames.t_ns.tolist()


def test_what_is_passed_on_has_no_pace():
    peer = Notebook()
    sink = Ros2Sink("", SinkOptions(), peer=peer)
    sink.write(old_frames(2, step_s=3600.0)[:1])
    messages = [Passed(n * 10**12, "imc/x", "std_msgs/msg/String", b"") for n in range(3)]
    for message in messages:
        sink.write(message)
    until(lambda: len(peer.sent) >= 3)
    assert [message.t_ns for message, _ in peer.sent if message.quality == "relayed"] == [n.t_ns for n in messages]
    sink.close()


@pytest.mark.parametrize("reliable", [False, True])
def test_frames_are_reliable_only_where_that_is_asked_for(reliable):
    peer = Notebook()
    with Ros2Sink("", SinkOptions(pace=0, reliable=reliable), peer=peer) as sink:
        sink.write(old_frames(3))
    assert {found for message, found in peer.sent if message.topic.endswith("/frame")} == {reliable or None}


def test_the_first_message_waits_for_as_many_subscribers_as_asked_for():
    peer = Notebook(subscribers=(0, 1, 2))
    with Ros2Sink("", SinkOptions(pace=0, listeners=2), peer=peer) as sink:
        sink.write(old_frames(3))
    assert len(frame_stamps(peer)) == 3
    assert peer.listeners("/tf") == 2  # all were counted before


def test_a_peer_that_fails_ends_the_sink_with_its_error():
    peer = Notebook(fails_at=5)
    sink = Ros2Sink("", SinkOptions(pace=0), peer=peer)

    def write_on():
        for _ in range(100):
            sink.write(old_frames(20))

    with pytest.raises(RuntimeError, match="the network is gone"):
        write_on()
    with pytest.raises(RuntimeError, match="the network is gone"):
        sink.close()
    assert peer.closed


def test_a_closed_sink_takes_nothing():
    sink = Ros2Sink("", SinkOptions(pace=0), peer=Notebook())
    sink.close()
    sink.close()
    with pytest.raises(ul.InputError, match="the sink is closed"):
        sink.write(old_frames(1))
    assert not any(thread.name == "ullage ros2" for thread in threading.enumerate())


@pytest.mark.parametrize("subscribers", [0, 1])
def test_a_new_subscriber_of_the_map_gets_it_whole(subscribers):
    """Between whole maps only changes are sent; a subscriber that came meanwhile brings one more whole one."""
    peer, cells = Notebook(subscribers=(subscribers,)), np.full((20, 20), -1, np.int8)
    grid, limit, n = ul.Grid((0.0, 0.0, 0.0), 0.1, cells.shape), time.monotonic() + 60, 0

    def topics():
        return [message.topic for message, _ in peer.sent]

    with Ros2Sink("", SinkOptions(pace=10.0, map_full_s=1e6), peer=peer) as sink:
        while topics().count("/diagnostics") < 2 and time.monotonic() < limit:
            sink.write(old_frames(2, start_s=1000.0 + 0.5 * n, step_s=0.25))
            cells[n % 10, :5] = 100 if n % 20 < 10 else 0
            sink.write(ul.OccupancyMap(grid, cells.copy()))
            n += 1
        before_the_end = topics()
    assert before_the_end.count("map") == 1 + subscribers
    assert "map_updates" in before_the_end


def test_a_peer_behind_its_pace_says_so():
    class Slow(Notebook):
        def send(self, message, *, reliable=None):
            time.sleep(0.06)
            return super().send(message, reliable=reliable)

    peer = Slow()
    with Ros2Sink("", SinkOptions(pace=100.0, clock="off"), peer=peer) as sink:
        for n in range(3):
            sink.write(old_frames(5, start_s=1000.0 + 5.0 * n, step_s=1.0))
    messages = [message.data for message, _ in peer.sent if message.topic == "/diagnostics"]
    found = [ros.from_bytes("diagnostic_msgs/msg/DiagnosticArray", message).status[0] for message in messages]
    assert any("behind its pace" in status.message for status in found)
    for status in found:
        values = {value.key: float(value.value) for value in status.values if value.key != "faults so far"}
        assert values["messages a second"] <= 1 / 0.06
        assert values["waiting messages"] >= 0
        late = values["most behind [s]"] >= LATE_S
        level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
        assert ("behind its pace" in status.message) == late
        assert level == (2 if "deaf" in status.message else int(late))  # these frames hold no echo: an error
