"""The brake of `guard=brake`: when it asks ArduCopter for BRAKE, how often, and what it leaves to the pilot."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_autopilot import Autopilot
from pymavlink.dialects.v20 import common as mav
from test_mavlink_encode import sectors

from ullage.geometry import rpy_quat
from ullage.ports.mavlink import link as links
from ullage.ports.mavlink.brake import ModeBrake
from ullage.ports.mavlink.options import SinkOptions
from ullage.ports.mavlink.sink import MavlinkSink
from ullage.processing.obstacles import ObstacleSectors

AUTO, GUIDED, LOITER, BRAKE, LAND, STABILIZE = 3, 4, 5, 17, 9, 0
YAWS = [0.0, 90.0, 180.0, -90.0]
FREE = math.inf


def around(
    front: float = FREE, left: float = FREE, back: float = FREE, right: float = FREE, *, broken: Any = ()
) -> Any:
    return sectors(YAWS, [front, left, back, right], width_deg=95, broken=broken)


@dataclass
class FakeLink:
    """A link to an ArduCopter without wires."""

    sent: list[Any] = field(default_factory=list)
    watchers: list[Any] = field(default_factory=list)
    request_hz: float = 0.0
    poses_come: bool = False
    dialect: Any = mav
    autopilot: Any = field(default_factory=lambda: links.Autopilot(1, 1, 0.0))

    def send(self, message: Any) -> None:
        self.sent.append(message)


class Copter:
    """A vehicle that heads north-west, and the brake beside it, on a clock of their own."""

    def __init__(
        self,
        mode: int,
        velocity: tuple[float, float],
        *,
        armed: bool = True,
        obeys: bool = True,
        kind: int = mav.MAV_AUTOPILOT_ARDUPILOTMEGA,
        vehicle: int = mav.MAV_TYPE_QUADROTOR,
    ) -> None:
        self.mode, self.velocity, self.obeys = mode, np.array(velocity), obeys  # forward, right [m/s]
        self._kind, self._vehicle, self._flags = kind, vehicle, 128 if armed else 0
        self.link, self.texts, self.now = FakeLink(), list[str](), 0.0
        self.brake = ModeBrake(self.link, SinkOptions(), lambda _, text: self.texts.append(text), now=lambda: self.now)  # type: ignore[arg-type]

    def fly(self, seen: ObstacleSectors, *, seconds: float = 0.5, age_s: float = 0.1) -> Copter:
        """Judge ten times a second."""
        yaw = -math.pi / 4
        north, east = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]) @ self.velocity
        for k in range(round(10 * seconds)):
            self.now += 0.1
            self.link.watchers[0](
                mav.MAVLink_heartbeat_message(self._vehicle, self._kind, self._flags, self.mode, 4, 3)
            )
            quat = rpy_quat(0.1, 0.0, yaw)[[3, 0, 1, 2]]
            self.link.watchers[0](mav.MAVLink_attitude_quaternion_message(0, *quat, 0, 0, 0) if k % 2 else
                            mav.MAVLink_attitude_message(0, 0.1, 0.0, yaw, 0, 0, 0))  # fmt: skip
            self.link.watchers[0](mav.MAVLink_local_position_ned_message(0, 5, 5, -2, north, east, 0.5))
            before = self.asked
            self.brake.judge(self._approached(seen), age_s)
            if self.obeys and self.asked > before:
                self.mode = int(self.link.sent[-1].param2)
                self.link.watchers[0](mav.MAVLink_command_ack_message(mav.MAV_CMD_DO_SET_MODE, 0))
        return self

    def _approached(self, seen: ObstacleSectors) -> ObstacleSectors:
        """The obstacles, which rest, with the speeds at which it closes on them."""
        closing = seen.boresight[seen.tracks.sensor] @ np.array([self.velocity[0], -self.velocity[1], 0.0])
        tracks = replace(seen.tracks, closing_speed_m_s=closing, closing_sigma_m_s=np.full(len(closing), 0.05))
        return replace(seen, tracks=tracks)

    @property
    def asked(self) -> int:
        """Requests for BRAKE so far; nothing else is ever sent."""
        assert {(one.command, one.param1, one.param2) for one in self.link.sent} <= {
            (mav.MAV_CMD_DO_SET_MODE, 1, BRAKE)
        }
        return len(self.link.sent)


@pytest.mark.parametrize("mode", [AUTO, GUIDED, LOITER])
@pytest.mark.parametrize(
    ("velocity", "side"), [((1, 0), "front"), ((0, -1), "left"), ((-1, 0), "back"), ((0, 1), "right")]
)
def test_it_brakes_before_an_obstacle_on_the_side_that_it_moves_to(
    mode: int, velocity: tuple[float, float], side: str
) -> None:
    others = dict.fromkeys(("front", "left", "back", "right"), 1.0)
    assert Copter(mode, velocity).fly(around(**{side: 1.5})).mode == BRAKE
    assert Copter(mode, velocity).fly(around(**{side: 3.5})).asked == 0
    free = Copter(mode, velocity).fly(around(**others | {side: FREE}))
    assert free.asked == 0 or side not in free.texts[0]


def test_an_obstacle_aside_or_behind_brakes_nothing() -> None:
    assert Copter(AUTO, (1, 0)).fly(around(back=1.0)).asked == 0
    assert Copter(AUTO, (-0.5, 0)).fly(around(front=0.8)).asked == 0


@pytest.mark.parametrize("speed", [0.3, 0.5, 1.0, 1.5])
def test_a_vehicle_within_the_settings_stops_before_the_margin(speed: float) -> None:
    """BRAKE acts 0.2 s after the distances that ask for it. A real ArduCopter 4.7-dev then needed 1.5 m from 1 m/s."""
    copter, gap, v, braked_s = Copter(AUTO, (speed, 0)), 5.0, speed, math.inf
    for _ in range(300):
        copter.velocity = np.array([v, 0.0])
        copter.fly(around(gap), seconds=0.1)
        braked_s = min(braked_s, copter.now if copter.mode == BRAKE else math.inf)
        for k in range(10):
            v -= 0.01 * v / 1.5 if copter.now + 0.01 * k > braked_s + 0.2 else 0.0
            gap -= 0.01 * v
    assert copter.mode == BRAKE
    assert v < 1e-3
    assert gap > 0.4 + 0.3 - 1e-6  # hull and margin
    assert copter.asked == 1


@pytest.mark.parametrize(
    "copter",
    [
        Copter(STABILIZE, (1, 0)), Copter(LAND, (1, 0)), Copter(BRAKE, (1, 0)), Copter(AUTO, (1, 0), armed=False),
        Copter(AUTO, (0.05, 0)), Copter(AUTO, (1, 0), kind=mav.MAV_AUTOPILOT_PX4),
        Copter(AUTO, (1, 0), vehicle=mav.MAV_TYPE_FIXED_WING),
    ],
)  # fmt: skip
def test_what_is_not_its_own_it_leaves_alone(copter: Copter) -> None:
    assert copter.fly(around(1.0)).asked == 0


def test_another_autopilot_is_told_that_it_is_not_braked() -> None:
    copter = Copter(AUTO, (1, 0), kind=mav.MAV_AUTOPILOT_PX4).fly(around(1.0))
    assert copter.texts == ["guard=brake: no ArduCopter, so no brake"]


def test_a_dead_radar_stops_flight_to_its_side_only() -> None:
    ahead = Copter(GUIDED, (1, 0)).fly(around(broken=(0,)))
    assert (ahead.mode, ahead.texts[0]) == (BRAKE, "guard: BRAKE, no distance of radar radar0")
    assert Copter(GUIDED, (0, 1)).fly(around(broken=(0,))).asked == 0


def test_a_velocity_that_is_not_known_is_reported() -> None:
    copter = Copter(AUTO, (math.nan, 0)).fly(around(1.0))
    assert (copter.asked, copter.texts) == (0, ["guard: no velocity comes, so no brake"])


def test_distances_that_end_stop_a_vehicle_that_moves() -> None:
    copter = Copter(AUTO, (1, 0)).fly(around(), age_s=0.4)
    assert copter.asked == 0
    assert copter.fly(around(), age_s=0.6).texts == ["guard: BRAKE, no distances"]
    assert copter.mode == BRAKE


def test_older_distances_brake_sooner() -> None:
    assert Copter(AUTO, (1, 0)).fly(around(2.75), age_s=0.1).asked == 0
    assert Copter(AUTO, (1, 0)).fly(around(2.75), age_s=0.4).asked == 1


def test_the_pilot_has_the_last_word_until_the_event_is_over() -> None:
    copter = Copter(AUTO, (1, 0)).fly(around(1.0))
    copter.mode = LOITER
    assert copter.fly(around(1.0), seconds=5).asked == 1  # he flies on: it does not fight him
    copter.velocity = np.array([-0.5, 0.0])
    copter.fly(around(1.0), seconds=2)
    assert copter.texts[-1] == "guard: clear; choose a mode"
    copter.velocity = np.array([1.0, 0.0])
    assert copter.fly(around(1.0)).asked == 2


def test_a_request_that_is_lost_is_sent_again_and_one_without_answer_is_reported() -> None:
    copter = Copter(AUTO, (1, 0), obeys=False).fly(around(1.0), seconds=3)
    assert copter.asked == 5
    assert [one.confirmation for one in copter.link.sent] == list(range(5))
    assert copter.texts[-1] == "guard: no answer to BRAKE"


def test_the_pilots_mode_ends_the_requests() -> None:
    copter = Copter(AUTO, (1, 0), obeys=False).fly(around(1.0), seconds=0.1)
    copter.mode = LOITER
    assert copter.fly(around(1.0), seconds=3).asked == 1


@pytest.mark.parametrize("guard", ["off", "brake"])
def test_over_the_wire_it_stops_an_auto_flight_only_where_it_was_asked_for(guard: str) -> None:
    def poses(t_s: float) -> list[Any]:
        ms = round(1000 * t_s) % 2**32
        return [mav.MAVLink_attitude_message(ms, 0, 0, 0, 0, 0, 0),
                mav.MAVLink_local_position_ned_message(ms, 0, 0, -2, 1, 0, 0)]  # fmt: skip

    with Autopilot(mode=AUTO, poses=poses) as autopilot:
        options = SinkOptions(guard=guard)  # type: ignore[arg-type]
        with MavlinkSink(f"udp://127.0.0.1:{autopilot.port}", options, log=lambda _: None) as out:
            end = time.monotonic() + 30
            while autopilot.mode != BRAKE and time.monotonic() < end and len(autopilot.of("OBSTACLE_DISTANCE")) < 40:
                seen = around(broken=(0,))
                out.write(replace(seen, t_ns=time.time_ns()))
                time.sleep(0.02)
        texts = [one.text for one in autopilot.of("STATUSTEXT")]
    assert autopilot.mode == (BRAKE if guard == "brake" else AUTO)
    assert any(text.startswith("guard: BRAKE, ") for text in texts) == (guard == "brake")
