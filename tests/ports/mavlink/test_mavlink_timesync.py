"""The autopilot's clock: offset and drift from exchanges whose round trips vary."""

from __future__ import annotations

import numpy as np
import pytest

from ullage.ports.intake import Counters
from ullage.ports.mavlink.link import ClockOffset

BOOT_NS = -1_700_000_000_123_456_789


def exchanges(count: int, *, drift_ppm: float, seed: int, every_s: float = 0.5) -> list[tuple[int, int, int]]:
    """Sent, peer's time, received: each way takes 1 ms and more, now and then much more, independently."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        sent = 5_000_000_000 + round(k * every_s * 1e9)
        there, back = (1e6 + rng.exponential(2e5) + 3e7 * (rng.random() < 0.1) for _ in range(2))
        middle = sent + there
        out.append((sent, truth_ns(middle, drift_ppm), round(middle + back)))
    return out


def truth_ns(local_ns: float, drift_ppm: float) -> int:
    """The peer's clock at a time of this one."""
    return round(local_ns * (1 + drift_ppm * 1e-6)) - BOOT_NS


@pytest.mark.parametrize("drift_ppm", [0.0, 40.0, -80.0])
@pytest.mark.parametrize("seed", range(3))
def test_offset_and_drift_are_found_though_one_in_five_answers_is_late(drift_ppm: float, seed: int) -> None:
    clock = ClockOffset(Counters())
    known = exchanges(60, drift_ppm=drift_ppm, seed=seed)
    for one in known:
        clock.take(*one)
    now = known[-1][2]
    error_s = (clock.offset_ns(now) + now - truth_ns(now, drift_ppm)) * 1e-9
    assert abs(error_s) < 100e-6
    assert clock.sigma_s is not None
    assert abs(error_s) < 5 * clock.sigma_s
    assert clock.drift_ppm == pytest.approx(drift_ppm, abs=15)


def test_nothing_is_said_before_there_are_five_exchanges() -> None:
    clock = ClockOffset(Counters())
    for k, one in enumerate(exchanges(5, drift_ppm=0, seed=1)):
        assert not clock.known
        assert clock.offset_ns(0) is None
        clock.take(*one)
        assert clock.known == (k == 4)


def test_a_step_of_the_autopilots_clock_is_measured_anew_and_a_single_wrong_answer_is_not() -> None:
    said: list[str] = []
    counters = Counters(said.append)
    clock = ClockOffset(counters)
    for sent, peer, received in exchanges(20, drift_ppm=0, seed=2)[:10]:
        clock.take(sent, peer, received)
    sent, peer, received = exchanges(20, drift_ppm=0, seed=2)[10]
    clock.take(sent, peer + 10**10, received)
    assert not said
    for k, (sent, peer, received) in enumerate(exchanges(30, drift_ppm=0, seed=2)[11:]):
        step = 0 if k == 0 else 3 * 10**9
        clock.take(sent, peer + step, received)
    assert counters.dropped("bad", topic="TIMESYNC") == 1
    assert said == ["the autopilot's clock jumped +3 s: it is measured anew"]
    now = received
    assert abs(clock.offset_ns(now) + now - truth_ns(now, 0) - 3 * 10**9) < 200_000


def test_answers_from_before_their_question_are_counted() -> None:
    counters = Counters()
    clock = ClockOffset(counters)
    clock.take(100, 50, 90)
    clock.take(100, 0, 190)
    assert counters.dropped("bad", topic="TIMESYNC") == 2
