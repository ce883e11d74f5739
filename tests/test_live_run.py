"""Live runs: obstacles, state and recording do not wait for a map; what cannot keep up leaves out the oldest frames."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import ullage as ul
from tests.ports.waiting import until
from ullage.live_run import Delays
from ullage.ports import schema as ros
from ullage.ports.intake import Counters, Inbox
from ullage.ports.protocol import Passed, Passing
from ullage.processing.obstacles import ObstacleSectors, ObstacleStage

N = 30
LONG_S = 60.0


def frames() -> ul.Frames:
    path = ul.Trajectory.line((-1, 0, 0), (0.5, 0, 0), speed_m_s=0.5, rate_hz=(N - 1) / 3)
    return ul.simulate(ul.scenes.room(), path, ul.RadarSpec.preset("x4m05"), fidelity="thesis", seed=3)


class Port:
    """A live port that gives one frame after the other, and does what a test wants before some of them."""

    def __init__(self, *, lag_s: float | None = None, before: dict[int, Callable[[], None]] | None = None) -> None:
        self.frames, self.lag_s, self.before = frames(), lag_s, before or {}
        self.passing, self.stopping, self.given = Passing(), False, 0

    def stream(self) -> Iterator[dict[str, ul.Frames]]:
        for k in range(len(self.frames)):
            if k in self.before:
                self.before[k]()
            if self.stopping:
                return
            self.given += 1
            yield {"radar": self.frames[k : k + 1]}
        if len(self.frames) in self.before:
            self.before[len(self.frames)]()

    def stop(self) -> None:
        self.stopping = True


class Map:
    """A slow stage: it works on its first piece until the gate is opened."""

    def __init__(self) -> None:
        self.gate, self.begun, self.seen = threading.Event(), threading.Event(), list[int]()

    def update(self, chunk: dict[str, ul.Frames]) -> list[Any]:
        self.begun.set()
        assert self.gate.wait(LONG_S)
        self.seen += chunk["radar"].t_ns.tolist()
        return []

    def finish(self) -> list[Any]:
        return ["the map"]


class Kept:
    """A sink that keeps all."""

    takes_obstacles = gathers = False

    def __init__(self) -> None:
        self.items: list[Any] = []

    def write(self, item: Any) -> None:
        self.items.append(item)

    def close(self) -> None:
        pass

    @property
    def obstacles(self) -> list[int]:
        return [item.t_ns for item in self.items if isinstance(item, ObstacleSectors)]

    @property
    def frames(self) -> list[int]:
        return [int(item["radar"].t_ns[0]) for item in self.items if isinstance(item, dict)]


def test_obstacles_state_and_recording_go_out_while_the_map_is_busy() -> None:
    kept, stage = Kept(), Map()
    state = Passed(1, "raw_imu", ros.IMU, b"")
    port = Port()

    def check() -> None:
        until(lambda: len(kept.obstacles) == len(kept.frames) == N)
        port.passing.give(lambda: [state])
        until(lambda: state in kept.items)
        assert not stage.seen
        stage.gate.set()

    port.before[N] = check
    done = ul.run(port, stages=[stage, ObstacleStage()], sinks=[kept])
    assert kept.obstacles == kept.frames == stage.seen == port.frames.t_ns.tolist()
    assert (kept.items[-1], done.results, done.frames) == ("the map", ("the map",), N)
    assert done.live is not None
    assert (done.live.left_out, done.live.obstacles, done.interrupted) == (0, N, False)
    assert not threading.active_count() > 1 or all(
        not thread.name.startswith("ullage") for thread in threading.enumerate()
    )


def test_a_file_gets_what_came_meanwhile_in_one_piece() -> None:
    kept, file, port = Kept(), Kept(), Port()
    file.gathers = True
    ul.run(port, sinks=[kept, file])
    pieces = [item["radar"] for item in file.items if isinstance(item, dict)]
    assert [t for piece in pieces for t in piece.t_ns.tolist()] == kept.frames == port.frames.t_ns.tolist()
    assert len(pieces) < N


def test_a_sink_that_takes_obstacles_gets_them_before_a_busy_map_though_no_stage_finds_them() -> None:
    taker, other, stage, port = Kept(), Kept(), Map(), Port()
    taker.takes_obstacles = True

    def check() -> None:
        until(lambda: len(taker.obstacles) == N)
        assert not stage.seen
        stage.gate.set()

    port.before[N] = check
    ul.run(port, stages=[stage], sinks=[taker, other])
    assert taker.obstacles == port.frames.t_ns.tolist()
    assert not other.obstacles


def test_a_map_that_cannot_keep_up_is_that_of_now_and_the_recording_has_all() -> None:
    kept, stage, lags = Kept(), Map(), list[tuple[float, int]]()
    port = Port(lag_s=0.2)
    port.before[1] = lambda: until(stage.begun.is_set)

    def wait_too_long() -> None:
        until(lambda: len(kept.frames) == N - 1)
        time.sleep(0.25)

    def go_on() -> None:
        until(lambda: len(kept.frames) == N)
        stage.gate.set()

    port.before |= {N - 1: wait_too_long, N: go_on}
    done = ul.run(port, stages=[stage], sinks=[kept], on_lag=lambda *lag: lags.append(lag))
    assert done.live is not None
    assert stage.seen == port.frames.t_ns[[0, -1]].tolist()  # what waited too long is left out, the newest is not
    assert done.live.left_out == N - 2
    assert kept.frames == port.frames.t_ns.tolist()
    assert done.live.most_behind_s >= 0.25
    assert lags[-1][1] == N - 2
    assert any(f"{N - 2} frames came too late" in line for line in done.live.lines())


def test_the_status_says_what_is_left_out_on_diagnostics() -> None:
    kept = Kept()
    ul.run(Port(), stages=[], sinks=[kept])
    status = next(item for item in kept.items if isinstance(item, Passed))
    read = ros.from_bytes(status.kind, status.data).status[0]
    assert status.topic == "/diagnostics"
    assert {"behind [s]", "frames left out"} <= {pair.key for pair in read.values}


@pytest.mark.usefixtures("heeded_signals")
def test_the_first_ctrl_c_works_off_what_was_received() -> None:
    kept, stage = Kept(), Map()
    port = Port()

    def interrupt() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        stage.gate.set()
        until(lambda: port.stopping)

    port.before[N // 2] = interrupt
    done = ul.run(port, stages=[stage, ObstacleStage()], sinks=[kept])
    assert done.interrupted
    assert port.given == done.frames == N // 2
    assert stage.seen == kept.frames == kept.obstacles == port.frames.t_ns[: N // 2].tolist()
    assert done.live is not None
    assert done.live.left_out_s == 0
    assert done.results == ("the map",)


@pytest.mark.usefixtures("heeded_signals")
def test_the_second_ctrl_c_ends_it_and_says_how_much_is_left_out() -> None:
    stage, port = Map(), Port()
    port.before[1] = lambda: until(stage.begun.is_set)

    def twice() -> None:
        flag: Any = getattr(signal.getsignal(signal.SIGINT), "__self__", None)
        for count in (1, 2):  # signals of one kind that come before the first is handled are one
            os.kill(os.getpid(), signal.SIGINT)
            until(lambda count=count: flag.count == count)
        stage.gate.set()

    port.before[N] = twice
    done = ul.run(port, stages=[stage], sinks=[])
    assert done.interrupted
    assert len(stage.seen) == 1
    assert done.live is not None
    assert done.live.left_out_s == pytest.approx(3.0, abs=0.2)
    assert any("s of what was received are left out" in line for line in done.live.lines())


def test_what_fails_in_any_thread_ends_the_run_with_its_error() -> None:
    class Broken(Kept):
        def write(self, item: Any) -> None:
            raise ul.InputError("cannot write: No space left on device", where="disk")

    def refuse() -> None:
        raise ul.InputError("no HEARTBEAT", where="port")

    with pytest.raises(ul.InputError, match="No space left"):
        ul.run(Port(), stages=[], sinks=[Broken()])
    with pytest.raises(ul.InputError, match="no HEARTBEAT"):
        ul.run(Port(before={3: refuse}), stages=[], sinks=[Kept()])


def test_a_source_is_closed_where_a_stage_refuses_its_frames() -> None:
    class Instrument(Port):
        def __init__(self) -> None:
            super().__init__(before={1: lambda: self.closed.wait(LONG_S)})
            self.closed = threading.Event()

        def close(self) -> None:
            self.closed.set()

    class Refusing(Map):
        def update(self, chunk: dict[str, ul.Frames]) -> list[Any]:
            raise ul.InputError("no such frames")

    port = Instrument()
    with pytest.raises(ul.InputError, match="no such frames"):
        ul.run(port, stages=[Refusing()])
    assert port.closed.is_set()


def test_the_queue_drops_the_oldest_first_and_never_news() -> None:
    now, counters = [0.0], Counters()
    queue: Inbox[Any] = Inbox(counters, lag_s=2.0, now=lambda: now[0])
    queue.put("news")
    for k in range(10):
        now[0] = 0.5 * k
        queue.put(k, topic="frames", count=4)
    queue.put("obstacle", topic="obstacles", first=True)
    assert queue.behind_s == 4.5
    taken = []
    while (item := queue.get(0.0)) is not None:
        taken.append(item)
    assert taken == ["obstacle", "news", 5, 6, 7, 8, 9]
    assert queue.lost == counters.dropped("lost", topic="frames") == 20


def test_delays_are_counted_to_a_millisecond() -> None:
    delays = Delays()
    assert delays.within_s(0.99) == 0
    for k in range(1, 101):
        delays.add(k * 1e-3)
    assert delays.within_s(0.5) == pytest.approx(0.050)
    assert delays.within_s(0.99) == pytest.approx(0.099)
    delays.add(1e6)  # beyond ten seconds it is ten
    assert delays.within_s(1.0) == pytest.approx(10.0)
