"""What an autopilot gets from the sink: contents, rates, order, and silence where the radars are silent."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_autopilot import Autopilot
from test_mavlink_encode import sectors
from waiting import until

import ullage as ul
from ullage.ports.mavlink.options import SinkOptions
from ullage.ports.mavlink.sink import MavlinkSink

YAWS = [0.0, 90.0, 180.0, -90.0]


@pytest.fixture
def autopilot() -> Iterator[Autopilot]:
    with Autopilot() as one:
        yield one


@pytest.fixture
def said() -> list[str]:
    return []


def sink(autopilot: Autopilot, said: list[str], **options: Any) -> MavlinkSink:
    return MavlinkSink(f"udp://127.0.0.1:{autopilot.port}", SinkOptions(**options), log=said.append)


def around(t_s: float, distance_m: float = 2.0, *, now_ns: int = 0) -> Any:
    """Four radars, one of which detects something, at a time of the stream."""
    return sectors(YAWS, [distance_m, np.inf, np.inf, np.inf], t_ns=now_ns + round(t_s * 1e9))


def deliver(out: MavlinkSink, autopilot: Autopilot) -> None:
    """Write distances of the present until some arrive: on a busy machine they may be late, and are dropped."""
    seen, end = len(autopilot.of("OBSTACLE_DISTANCE")), time.monotonic() + 60
    while len(autopilot.of("OBSTACLE_DISTANCE")) == seen and time.monotonic() < end:
        gone = seen + late(out)
        out.write(around(0.0, now_ns=time.time_ns()))
        while len(autopilot.of("OBSTACLE_DISTANCE")) + late(out) == gone and time.monotonic() < end:
            time.sleep(0.01)
    assert len(autopilot.of("OBSTACLE_DISTANCE")) == seen + 1


def late(out: MavlinkSink) -> int:
    """Distances that were dropped because they were too old."""
    return out.link.counters.dropped("late", topic="OBSTACLE_DISTANCE")


def test_a_stream_goes_out_at_its_own_pace_thinned_to_the_rate(autopilot: Autopilot, said: list[str]) -> None:
    begun = time.monotonic()
    with sink(autopilot, said, obstacle_hz=20) as out:
        for k in range(101):  # two seconds at 50 Hz
            out.write(around(k / 50, 3.0 - k / 50))
    found = autopilot.await_("OBSTACLE_DISTANCE", 41)
    stamps = [one.time_usec for one in found]
    assert len(found) == 41  # 20 a second in the mean
    assert set(np.diff(stamps)) == {40_000, 60_000}
    np.testing.assert_allclose([one.distances[0] for one in found], 300 - np.array(stamps) / 10_000, atol=1)
    assert time.monotonic() - begun > 1.99  # a busy machine may take longer, and none is quicker
    assert not [line for line in said if "a second are sent" in line]


def test_each_radar_comes_before_the_sectors_of_its_time(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said, pace=0) as out:
        for k in range(3):
            out.write(around(k / 10))
    autopilot.await_("OBSTACLE_DISTANCE", 3)
    kinds = [m.get_type() for _, m in autopilot.got if m.get_type() in ("DISTANCE_SENSOR", "OBSTACLE_DISTANCE")]
    assert kinds == (["DISTANCE_SENSOR"] * 4 + ["OBSTACLE_DISTANCE"]) * 3
    assert [m.id for m in autopilot.of("DISTANCE_SENSOR")[:4]] == [0, 1, 2, 3]
    assert [m.orientation for m in autopilot.of("DISTANCE_SENSOR")[:4]] == [0, 6, 4, 2]


def test_single_sensors_can_be_left_out(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said, pace=0, sensors=False) as out:
        out.write(around(0.0))
    assert autopilot.await_("OBSTACLE_DISTANCE")
    assert not autopilot.of("DISTANCE_SENSOR")


def test_stamps_of_the_present_become_those_of_the_autopilots_clock(said: list[str]) -> None:
    with Autopilot(boot_ns=-time.monotonic_ns() + 77 * 10**9) as autopilot, sink(autopilot, said) as out:
        until(lambda: out.link.clock.known)
        first = autopilot.clock_ns() * 1e-9
        deliver(out, autopilot)
        last, error = autopilot.clock_ns() * 1e-9, 0.5  # of the offset, on a busy machine; the clock says over 77 s
        (found,) = autopilot.of("OBSTACLE_DISTANCE")
        assert first - error < found.time_usec * 1e-6 < last + error
        assert autopilot.of("DISTANCE_SENSOR")[-1].time_boot_ms == found.time_usec // 1000


def test_silent_radars_make_the_sink_silent_and_its_state_critical(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said) as out:
        deliver(out, autopilot)
        sent = len(autopilot.of("OBSTACLE_DISTANCE"))
        until(lambda: 5 in {beat.system_status for beat in autopilot.of("HEARTBEAT")})
        assert autopilot.of("HEARTBEAT")[-1].system_status == 5  # MAV_STATE_CRITICAL
        assert len(autopilot.of("OBSTACLE_DISTANCE")) == sent
        assert any("no distances for 0.5 s, so none are sent" in line for line in said)
        deliver(out, autopilot)


def test_a_faulty_radar_is_told_to_the_pilot_until_it_is_sound(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said) as out:
        for k, fault in enumerate(("", "deaf", "deaf", "")):
            out.write(replace(around(k / 5), fault=("", fault, "", ""), valid=np.array([True, not fault, True, True])))
    texts = [(one.severity, one.text) for one in autopilot.of("STATUSTEXT")]
    assert texts == [(2, "radar radar1: deaf; its sector is blind"), (5, "radar radar1: sound again")]
    assert any("radar1: deaf" in line for line in said)


def test_distances_older_than_half_a_second_are_dropped_and_counted(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said) as out:
        deliver(out, autopilot)  # the stream is of the present
        before = late(out)
        out.write(around(-3.0, 1.0, now_ns=time.time_ns()))
        deliver(out, autopilot)
        assert late(out) > before
        assert {one.distances[0] for one in autopilot.of("OBSTACLE_DISTANCE")} == {200}  # not the old one


def test_too_few_distances_are_reported(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said) as out:
        for k in range(10):
            out.write(around(k / 4))
    assert any(line.endswith("distances a second are sent; autopilots expect 10") for line in said)


def test_how_late_live_distances_are_is_reported_at_the_end(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said) as out:
        deliver(out, autopilot)
    ages = [re.search(r"frame to message (\d+) ms \(median\), (\d+) ms", line) for line in said]
    (found,) = [one for one in ages if one]
    assert 0 <= int(found[1]) <= int(found[2]) <= 500


def test_frames_of_a_run_become_distances(autopilot: Autopilot, said: list[str]) -> None:
    scene = ul.scenes.plate(width_m=4, height_m=4, distance_m=2.5, material="pec")
    rig = ul.Rig.preset("thesis-4")
    path = ul.Trajectory.line((0, 0, 0), (0.3, 0, 0), speed_m_s=0.3, rate_hz=20)
    with sink(autopilot, said, pace=0) as out:
        out.write(ul.simulate(scene, path, rig, seed=1))
        out.write(scene)  # nothing for an autopilot
    (first, *_, last) = autopilot.await_("OBSTACLE_DISTANCE", len(path))
    assert first.distances[0] == first.max_distance + 1  # a track needs three detections
    assert last.distances[0] == pytest.approx(220, abs=10)


def test_obstacles_of_the_run_replace_our_own(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said, pace=0) as out:
        out.write(around(0.0, 1.0))
        frames = ul.simulate(
            ul.scenes.plate(width_m=4, height_m=4, distance_m=2.5, material="pec"),
            ul.Trajectory.line((0, 0, 0), (0.3, 0, 0), speed_m_s=0.3, rate_hz=20),
            ul.Rig.preset("single"),
            seed=1,
        )
        out.write(frames)
        out.write(around(1.0, 1.5))
    assert [one.distances[0] for one in autopilot.await_("OBSTACLE_DISTANCE", 2)] == [100, 150]


def test_without_an_autopilot_it_is_said_at_the_end(said: list[str]) -> None:
    with MavlinkSink("udp://127.0.0.1:9", SinkOptions(pace=0), log=said.append) as out:
        out.write(around(0.0))
    assert any("no HEARTBEAT of an autopilot came" in line for line in said)


def test_an_autopilot_that_is_waited_for_and_does_not_come_is_an_error(said: list[str]) -> None:
    with pytest.raises(ul.InputError, match=r"no HEARTBEAT of an autopilot within 0.2 s .*vehicle=ID"):
        MavlinkSink("udp://127.0.0.1:9", SinkOptions(wait_s=0.2), log=said.append)


def test_a_closed_sink_takes_nothing(autopilot: Autopilot, said: list[str]) -> None:
    out = sink(autopilot, said)
    out.close()
    with pytest.raises(ul.InputError, match="the sink is closed"):
        out.write(around(0.0))


def test_a_clock_that_is_set_back_does_not_stop_the_stream(autopilot: Autopilot, said: list[str]) -> None:
    with sink(autopilot, said, pace=0) as out:
        out.write(around(1000.0))
        out.write(around(999.99))  # late
        out.write(around(1.0))  # set back
        out.write(replace(around(1.1)))
    assert [one.time_usec // 1000 for one in autopilot.await_("OBSTACLE_DISTANCE", 3)] == [1_000_000, 1000, 1100]


@pytest.mark.parametrize("late_s", [2.0, 100.0])
def test_a_live_stream_whose_first_distances_are_late_is_not_replayed(
    autopilot: Autopilot, said: list[str], late_s: float
) -> None:
    """Frames of the present, whose distances come after the first of them were worked out for long."""
    frames = ul.simulate(
        ul.scenes.plate(width_m=4, height_m=4, distance_m=2.5, material="pec"),
        ul.Trajectory.stationary((0, 0, 0), n=1),
        ul.Rig.preset("single"),
        seed=1,
    )["front"]
    with sink(autopilot, said) as out:
        out.write(replace(frames, t_ns=np.array([time.time_ns()]), poses=None, truth=None))
        out.write(around(-late_s, 1.0, now_ns=time.time_ns()))
        deliver(out, autopilot)
    assert {one.distances[0] for one in autopilot.of("OBSTACLE_DISTANCE")} == {200}  # not those that are late
    assert late(out) >= 1
