"""The multirotor flown by hand: keys become velocities, frames and the readings of IMU and sonar come out."""

from __future__ import annotations

import math
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.cli import main
from ullage.errors import InputError
from ullage.flight.imu import MPU6000, white_noise
from ullage.flight.live import Steered
from ullage.flight.pilot import Pilot, PilotOptions, Velocity
from ullage.ports import schema as ros
from ullage.ports.by_hand import (
    IMU_TOPIC,
    SONAR_TOPIC,
    FlyOptions,
    HandFlight,
    HandFlownSource,
    Keyboard,
    Sonar,
    keys_in,
)
from ullage.ports.intake import Counters
from ullage.ports.protocol import Passed


class Script:
    """Velocities by time: each holds from its time on."""

    def __init__(self, *steps: tuple[float, Velocity]) -> None:
        self.counters, self.steps, self.closed = Counters(), steps, False

    def update(self, pilot: Pilot, now_s: float) -> None:
        for start_s, velocity in reversed(self.steps):
            if now_s >= start_s:
                pilot.command(velocity, now_s)
                return

    def close(self) -> None:
        self.closed = True


class Once(Script):
    """One velocity, once."""

    def update(self, pilot: Pilot, now_s: float) -> None:
        if self.steps:
            pilot.command(self.steps[0][1], now_s)
            self.steps = ()


def test_a_repeated_command_flies_on_and_a_single_one_ends_in_a_hover() -> None:
    far = {}
    for controls in (Script((0.0, Velocity(0.5))), Once((0.0, Velocity(0.5)))):
        flight = HandFlight(Steered(start=(0, 0, 2)), Pilot(PilotOptions()), controls, state_hz=50)
        states = flight.until(6_000_000_000)
        assert len(states) == 300
        far[type(controls)] = states[-1].position[0]
    assert far[Script] == pytest.approx(0.5 * 6, abs=0.4)
    assert far[Once] == pytest.approx(0.5 * 0.5, abs=0.1)
    assert flight.pilot.stale == 1


def test_the_flight_does_not_depend_on_how_often_it_is_advanced() -> None:
    script = Script((0.2, Velocity(0.4, turn_rad_s=0.3)))
    whole, parts = (HandFlight(Steered(start=(0, 0, 2)), Pilot(PilotOptions()), script, state_hz=50) for _ in range(2))
    one = whole.until(2_000_000_000)
    two = [state for k in range(1, 201) for state in parts.until(k * 10_000_000)]
    assert np.array_equal([s.position for s in one], [s.position for s in two])


def test_the_imu_reads_gravity_at_rest_and_the_push_of_a_take_off() -> None:
    script = Script((1.0, Velocity(up_m_s=0.5, turn_rad_s=0.4)))
    flight = HandFlight(Steered(start=(0, 0, 2)), Pilot(PilotOptions()), script, state_hz=100)
    states = flight.until(3_000_000_000)
    assert states[50].force_m_s2 == pytest.approx([0, 0, 9.81], abs=1e-6)
    assert states[-1].spin[2] == pytest.approx(0.4, abs=0.02)
    climb = sum(state.force_m_s2[2] - 9.81 for state in states) / 100
    assert climb == pytest.approx(flight.vehicle.velocity[2], abs=0.01)


def test_the_sonar_gives_the_height_and_infinity_beyond_its_reach() -> None:
    sonar = Sonar(ul.scenes.room(size_m=(6, 4, 8)))
    low, high = (
        HandFlight(Steered(start=(0, 0, z)), Pilot(PilotOptions()), Script(), state_hz=50).until(20_000_000)[0]
        for z in (-2.8, 0)
    )
    assert sonar.reading(low) == pytest.approx(1.2, abs=0.001)
    assert sonar.reading(low) is None  # ten readings a second
    assert Sonar(ul.scenes.room(size_m=(6, 4, 8))).reading(high) == math.inf


def test_frames_imu_and_sonar_come_out_and_the_controls_are_let_go() -> None:
    controls, items = Script((0.0, Velocity(0.3))), list[Passed | ul.Trajectory]()
    room = ul.scenes.room(size_m=(6, 4, 3))
    source = HandFlownSource(
        room, ul.Rig.preset("thesis-4"), FlyOptions(fidelity="thesis", duration_s=1.0), controls, start=(0, 0, 0)
    )
    source.passing.to(items.append)
    pieces = list(source.stream())
    messages = [item for item in items if isinstance(item, Passed)]
    paths = [item for item in items if isinstance(item, ul.Trajectory)]
    assert sum(map(len, paths)) >= 50
    assert paths[0].t_ns[0] <= pieces[0]["front"].t_ns[0] + 20_000_000
    front = [piece["front"] for piece in pieces if "front" in piece]
    assert sum(map(len, front)) >= 17
    t_ns = np.concatenate([part.t_ns for part in front])
    assert (np.diff(t_ns) > 0).all()
    assert front[-1].believed.position[-1, 0] > 0.05
    topics = [message.topic for message in messages]
    status = next(
        ros.from_bytes(message.kind, message.data) for message in messages if message.topic == "/diagnostics"
    ).status[0]
    assert {"frames simulated", "late frames", "dropped", "contacts"} <= {pair.key for pair in status.values}
    assert topics.count(IMU_TOPIC) >= 50
    assert topics.count(SONAR_TOPIC) >= 10
    imu = ros.from_bytes(ros.IMU, next(message.data for message in messages if message.topic == IMU_TOPIC))
    assert imu.header.frame_id == "base_link"
    assert imu.linear_acceleration.z == pytest.approx(9.81, abs=0.5)
    assert controls.closed


def test_the_state_of_a_flight_that_takes_longer_than_real_time_comes_in_short_pieces() -> None:
    class Slow(Script):
        def update(self, pilot: Pilot, now_s: float) -> None:
            time.sleep(0.08)  # for 0.02 s of flight

    said, items = list[str](), list[Passed | ul.Trajectory]()
    source = HandFlownSource(
        ul.scenes.room(size_m=(6, 4, 3)), ul.Rig.preset("single"), FlyOptions(fidelity="thesis", duration_s=0.7),
        Slow(), start=(0, 0, 0), log=said.append,
    )  # fmt: skip
    source.passing.to(items.append)
    list(source.stream())
    pieces = [len(item) for item in items if isinstance(item, ul.Trajectory)]
    assert sum(pieces) >= 35
    assert max(pieces) <= 3  # 0.05 s at 50 Hz
    assert any("longer than real time" in line for line in said)


def test_frames_that_nobody_took_in_time_are_left_out_and_the_rest_comes_after_the_landing() -> None:
    items, options = list[Passed | ul.Trajectory](), FlyOptions(fidelity="thesis", rate_hz=10)
    room = ul.scenes.room(size_m=(6, 4, 3))
    with HandFlownSource(room, ul.Rig.preset("single"), options, Script(), start=(0, 0, 0)) as source:
        source.passing.to(items.append)
        pieces = source.stream()
        next(pieces)
        source.keep_up(0.5)
        while source.behind_s < 1.5:
            time.sleep(0.02)
        fresh = next(iter(next(pieces).values()))
        assert source.counters.dropped("lost", topic="frames") >= 5
        source.stop()
        last = [fresh, *(frames for piece in pieces for frames in piece.values())][-1]
    landed = [item.t_ns[-1] for item in items if isinstance(item, ul.Trajectory)][-1]
    assert 0 <= landed - last.t_ns[-1] < 1.1e8  # the frames at 10 Hz go on to the last pose


def test_a_start_in_or_near_something_is_refused() -> None:
    room = ul.scenes.room(size_m=(6, 4, 3))
    with pytest.raises(InputError, match=r"the start at \(2\.90, 0\.00, 0\.00\) m is .* from"):
        HandFlownSource(room, ul.Rig.preset("thesis-4"), FlyOptions(), Script(), start=(2.9, 0, 0))
    with pytest.raises(InputError, match=r"start is '1,2'.*X,Y,Z"):
        FlyOptions(start="1,2").place()


def test_keys_and_sequences_are_told_apart_also_where_one_comes_in_two_parts() -> None:
    assert keys_in("i\x1b[A\x1bOBk\x1b[5~") == (["i", "up", "down", "k", "page up"], "")
    keys, rest = keys_in("j\x1b[")
    assert (keys, rest) == (["j"], "\x1b[")
    assert keys_in(rest + "D") == (["left"], "")
    assert keys_in("\x1b[1;5C") == ([""], "")


def test_keys_of_a_terminal_become_velocities_and_the_terminal_is_given_back() -> None:
    import pty
    import termios

    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    keyboard, pilot = Keyboard(slave, speed_m_s=0.4, turn_rad_s=0.8), Pilot(PilotOptions())
    cases = {b"\x1b[A": ((0.4, 0), 0, 0), b"\x1b[D": ((0, 0), 0, 0.8), b"t": ((0, 0), 0.4, 0), b"J": ((0, 0.4), 0, 0)}
    for sent, (velocity, climb, turn) in cases.items():
        os.write(master, sent)
        keyboard.update(pilot, 1.0)
        asked = pilot.request(1.0)
        assert asked is not None
        assert asked.velocity_m_s == pytest.approx(velocity)
        assert (asked.climb_m_s, asked.turn_rad_s) == pytest.approx((climb, turn))
    os.write(master, b"ww,")
    keyboard.update(pilot, 1.0)
    asked = pilot.request(1.0)
    assert asked is not None
    assert asked.velocity_m_s == pytest.approx((-0.4 * 1.1 * 1.1, 0))
    keyboard.close()
    assert termios.tcgetattr(slave)[3] == before[3]
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("fly", "nowhere"), "no scenario or world 'nowhere'"),
        (("fly", "ntnu-room", "--by", "foo:"), "no commands come from 'foo:' (allowed: keys, ros2:"),
        (("fly", "ntnu-room"), "the keyboard needs a terminal (allowed: a terminal, or --by ros2:"),
    ],
)
def test_a_flight_that_cannot_be_is_refused_in_one_line(words, said, monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115
    with pytest.raises(SystemExit) as end:
        main([*words, "--out", str(tmp_path)])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def imu_readings(**options) -> np.ndarray:
    """Turn rate and acceleration of a vehicle that hovers (n, 6)."""
    messages, room = list[Passed | ul.Trajectory](), ul.scenes.room(size_m=(6, 4, 3))
    chosen = FlyOptions(fidelity="thesis", duration_s=1.0, rate_hz=5, **options)
    source = HandFlownSource(room, ul.Rig.preset("single"), chosen, Script(), start=(0, 0, 0))
    source.passing.to(messages.append)
    list(source.stream())
    read = [ros.from_bytes(one.kind, one.data) for one in messages
            if isinstance(one, Passed) and one.topic == IMU_TOPIC]  # fmt: skip
    return np.array(
        [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z, m.linear_acceleration.x,
          m.linear_acceleration.y, m.linear_acceleration.z] for m in read[:40]]
    )  # fmt: skip


def test_imu_noise_repeats_with_its_seed_and_can_be_switched_off() -> None:
    quiet, one, again, other = (
        imu_readings(imu_noise=False), imu_readings(seed=1), imu_readings(seed=1), imu_readings(seed=2)
    )  # fmt: skip
    assert np.array_equal(one, again)
    assert np.ptp(quiet[:, :3]) < 1e-6
    assert not np.array_equal(one, other)
    assert abs(one - quiet).max() < 0.2


def test_imu_noise_has_the_density_of_the_data_sheet() -> None:
    turned, pushed = white_noise(np.arange(4000) * 5_000_000, MPU6000.but(rate_hz=196.0), seed=4)
    assert np.degrees(turned.std()) == pytest.approx(0.05, rel=0.03)  # the data sheet's own figure for 98 Hz
    assert pushed.std() == pytest.approx(400e-6 * 9.81 * math.sqrt(98), rel=0.03)


def test_commands_are_recorded_as_the_vehicle_got_them_and_read_again(tmp_path: Path) -> None:
    asked = [Velocity(0.3, -0.1, 0.2, 0.4), Velocity(9.0), (0.5, 0.25, 0.0)]

    class Commands(Script):
        def update(self, pilot: Pilot, now_s: float) -> None:
            if asked and round(now_s * 50) % 5 == 0:
                step = asked.pop(0)
                pilot.command(step, now_s) if isinstance(step, Velocity) else pilot.go_to(step, 0.7)

    options = FlyOptions(fidelity="thesis", duration_s=0.5, speed_m_s=0.8)
    source = HandFlownSource(
        ul.scenes.room(size_m=(6, 4, 3)), ul.Rig.preset("single"), options, Commands(), start=(0, 0, 0)
    )
    ul.run(source, sinks=[ul.sink(tmp_path / "flight.mcap")])
    first, second, third = (wish for _, wish in ul.open(tmp_path / "flight.mcap").commands())
    assert (first.velocity_m_s, first.climb_m_s, first.turn_rad_s) == ((0.3, -0.1), 0.2, 0.4)
    assert second.velocity_m_s == pytest.approx((0.8, 0.0))  # within the limits
    assert third.position_m == (0.5, 0.25, 0.0)
    assert third.heading_rad == pytest.approx(0.7)
    times = [t_ns for t_ns, _ in ul.open(tmp_path / "flight.mcap").commands()]
    assert np.diff(times) == pytest.approx(1e8, abs=1)
