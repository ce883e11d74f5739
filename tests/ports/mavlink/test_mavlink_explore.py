"""The explorer flies a copter by real MAVLink bytes, until it lands, the pilot takes over, or the copter is gone."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_autopilot import Copter
from pymavlink.dialects.v20 import common as mav
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app
from ullage.errors import InputError
from ullage.experiments import exploration
from ullage.flight.pilot import Velocity
from ullage.geometry import quat_matrix, quat_rpy, rpy_quat
from ullage.ports.live import Address
from ullage.ports.mavlink.drone import MavlinkDrone
from ullage.ports.mavlink.options import DroneOptions
from ullage.ports.pose_events import BodyState
from ullage.ports.vehicle import GONE_S, LiveVehicle
from ullage.radar.receiving import Receiving

pytestmark = pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
ROOM = ul.scenes.room(size_m=(6, 5, 3))
QUICK = ["sensing.rate_hz=10", "sensing.fidelity=thesis"]


def address(copter: Copter, options: str = "") -> str:
    return f"mavlink:udp://127.0.0.1:{copter.port}?{options}"


def explore(copter: Copter, time_s: float, **more: Any) -> ul.Explored:
    return ul.explore(ROOM, time_s=time_s, vehicle=address(copter), options=QUICK, **more)


class At:
    """Does something once, so long after it was first called: in flight."""

    def __init__(self, after_s: float, act: Any) -> None:
        self._after_s, self._act, self._begun_s, self.at_s = after_s, act, 0.0, 0.0

    def __call__(self, words: str) -> None:
        self._begun_s = self._begun_s or time.monotonic()
        if not self.at_s and time.monotonic() - self._begun_s > self._after_s:
            self.at_s = time.monotonic()
            self._act()


def state(drone: MavlinkDrone, settled_s: float) -> BodyState:
    """The newest state after some time."""
    end, found = time.monotonic() + settled_s, []
    while time.monotonic() < end or not found:
        found = drone.states() or found
        time.sleep(0.01)
    return found[-1]


def test_a_velocity_reaches_the_copter_in_the_frame_of_its_heading_wherever_its_origin_lies() -> None:
    with Copter((1.0, 2.0, -3.0)) as copter:
        drone = MavlinkDrone(f"udp://127.0.0.1:{copter.port}", DroneOptions(origin="10,20,1,30"))
        first = state(drone, 0.5)
        wanted = Velocity(0.4, 0.2, 0.1, 0.2)
        for _ in range(40):
            drone.steer(wanted)
            last = state(drone, 0.04)
        drone.close()
    yaw = float(quat_rpy(last.quat_xyzw)[2])
    turned = np.array([[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    assert turned @ last.velocity == pytest.approx(wanted[:3], abs=0.06)
    assert last.spin[2] == pytest.approx(0.2)
    assert first.position == pytest.approx(quat_matrix((0, 0, math.sin(math.pi / 12), math.cos(math.pi / 12)))
                                           @ [2.0, 1.0, 3.0] + [10, 20, 1], abs=0.01)  # fmt: skip


def test_a_set_point_is_the_place_in_the_autopilot_s_own_frame() -> None:
    with Copter((0.0, 0.0, 0.0), mode="LOITER") as copter:
        drone = MavlinkDrone(f"udp://127.0.0.1:{copter.port}", DroneOptions(origin="1,2,3,90"))
        assert drone.away == "the pilot flies, in mode LOITER and not GUIDED"
        drone.go_to((1.0, 4.0, 5.0), math.pi / 2)
        (message,) = copter.await_("SET_POSITION_TARGET_LOCAL_NED")
        drone.close()
    assert (message.x, message.y, message.z) == pytest.approx((0.0, 2.0, -2.0), abs=1e-6)  # 2 m along its east
    assert message.yaw == pytest.approx(math.pi / 2)
    assert message.type_mask == 0x9F8


def test_poses_that_turn_against_the_frame_of_set_points_are_refused() -> None:
    def odometry(t_s: float) -> list[Any]:
        state = (0.0, 1.0, 0.0), [1, 0, 0, 0], *[0.0] * 6
        return [mav.MAVLink_odometry_message(round(t_s * 1e6), mav.MAV_FRAME_LOCAL_FRD, 12, *state[0], *state[1:],
                                             [0.0] * 21, [0.0] * 21, 0, 0, 100)]  # fmt: skip

    with Copter((0.0, -1.0, 0.0)) as copter:
        copter.tell(odometry)
        with pytest.raises(InputError, match=r"not in MAV_FRAME_LOCAL_NED, as set-points are \(poses=local"):
            explore(copter, 10.0)


@pytest.mark.parametrize("px4", [False, True])
def test_a_copter_explores_by_set_points_comes_home_and_stops_its_motors(px4: bool) -> None:
    with Copter((0.0, -1.0, 0.8), px4=px4, boot_ns=10**12) as copter:
        explored = explore(copter, 24.0)
        places = np.array([place for _, place in copter.track])
        assert explored.summary.startswith("The flight ended on the ground at home: ")
        assert not copter.armed
        assert np.abs(places[:, 0]).max() < 2.5 - 0.4
        assert np.abs(places[:, 1]).max() < 3.0 - 0.4
        assert np.linalg.norm(np.diff(explored.flown.position[:, :2], axis=0), axis=1).sum() > 2.0
        assert (np.diff(explored.flown.t_ns) > 0).all()
        assert len(explored.decisions) > 1
        assert 0.0 < np.median(copter.lags_s) < 1.0  # from a pose to the set-point that answers it


def test_a_pilot_who_chooses_another_mode_has_the_copter_at_once() -> None:
    with Copter((0.0, -1.0, 0.0)) as copter:
        takes = At(2.0, lambda: setattr(copter, "chosen", "LOITER"))
        explored = explore(copter, 60.0, progress=takes)
        told = len(copter.of("SET_POSITION_TARGET_LOCAL_NED"))
        time.sleep(0.5)
        assert "the pilot flies, in mode LOITER and not GUIDED" in explored.summary
        assert copter.chosen == "LOITER"
        assert not [one for one in copter.of("COMMAND_LONG") if one.command == 176]
        assert len(copter.of("SET_POSITION_TARGET_LOCAL_NED")) == told
        assert explored.flown.duration_s < 30.0


def test_a_copter_that_is_gone_ends_the_flight_with_one_line() -> None:
    with Copter((0.0, -1.0, 0.0)) as copter:
        explored = explore(copter, 60.0, progress=At(1.5, lambda: setattr(copter, "silent", True)))
        assert f"no state of the vehicle for {GONE_S:g} s" in explored.summary


def test_an_autopilot_that_starts_again_is_told_to_hold() -> None:
    with Copter((0.0, -1.0, 0.0), boot_ns=10**12) as copter:
        explored = explore(copter, 60.0, progress=At(1.5, lambda: copter.restart(10**11)))
        assert "the autopilot's clock went back: it was started again" in explored.summary
        assert copter.chosen == "BRAKE"


def test_a_pilot_who_has_not_handed_over_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[float] = []
    monkeypatch.setattr(LiveVehicle, "wait", lambda self, _wait=LiveVehicle.wait: begun.append(_wait(self)) or begun[0])
    with Copter((0.0, -1.0, 0.0), px4=True, mode="HOLD") as copter:

        def hand_over(_: object) -> None:
            assert copter.await_("SET_POSITION_TARGET_LOCAL_NED", 5)  # PX4 wants set-points before OFFBOARD
            copter.chosen = "OFFBOARD"

        thread = threading.Thread(target=hand_over, args=(None,))
        thread.start()
        explored = explore(copter, 60.0, progress=At(1.5, lambda: setattr(copter, "armed", False)))
        thread.join()
        assert begun
        assert "the vehicle is disarmed" in explored.summary


class RealRadars:
    """Frames of radars on a copter, with the times of this machine's clock and no poses."""

    def __init__(self, copter: Copter) -> None:
        self._copter, self._closed = copter, False
        self._work = Receiving(ROOM, ul.Rig.preset("thesis-4"), fidelity="thesis", max_bounces=1, seed=3)

    def stream(self) -> Iterator[dict[str, ul.Frames]]:
        for number in count():
            if self._closed:
                return
            (north, east, down), t_ns = self._copter.place, np.array([time.time_ns()])
            quat = rpy_quat(0.0, 0.0, math.pi / 2 - self._copter.yaw)[None]
            body = ul.Trajectory(t_ns, np.array([[east, north, -down]]), quat)
            work = self._work
            yield {name: replace(work.frames(name, work.samples(name, body, first_frame=number), body),
                                 poses=None, truth=None, simulated=None) for name in work.sensors}  # fmt: skip
            time.sleep(0.08)

    def close(self) -> None:
        self._closed = True


def test_frames_of_real_radars_are_put_on_the_reported_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    with Copter((0.0, -1.0, 0.8)) as copter:
        monkeypatch.setattr(Address, "open", lambda self, part: RealRadars(copter))
        target = address(copter, "radars=x4:/dev/ttyACM0")
        explored = ul.explore(ROOM, time_s=20.0, vehicle=target, options=QUICK)
    front = explored.frames["front"]
    assert front.truth is None
    assert front.poses is not None
    body = front.poses.mounted(np.linalg.inv(front.spec.mount.body_from_sensor()))
    inside = (front.t_ns > explored.flown.t_ns[0]) & (front.t_ns < explored.flown.t_ns[-1])
    there = explored.flown.at(front.t_ns[inside]).position
    assert np.linalg.norm(body.position[inside] - there, axis=1).max() < 0.02
    assert np.linalg.norm(np.diff(explored.flown.position[:, :2], axis=0), axis=1).sum() > 1.0
    assert explored.map.occupied.any()


@pytest.mark.usefixtures("heeded_signals")
def test_ctrl_c_leaves_the_copter_hovering_and_a_run_that_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    stops = At(2.0, lambda: signal.raise_signal(signal.SIGINT))
    monkeypatch.setattr(exploration.MapFeed, "write", lambda self, item, _write=exploration.MapFeed.write: (
        _write(self, item), stops("")))  # fmt: skip
    with Copter((1.0, -0.5, -1.2)) as copter:
        words = ["explore", "ntnu-room", "--vehicle", address(copter), *(w for o in QUICK for w in ("-o", o))]
        done = CliRunner().invoke(app, words)
        assert done.exit_code in (0, 130), done.output
        assert copter.chosen == "BRAKE"
    folder = Path("runs/latest")
    verdict = (folder / "verdict.txt").read_text()
    assert "The flight ended by hand" in verdict
    assert "An aircraft flew it, its radars simulated at its reported poses" in verdict
    assert "of a surface by its reported poses." in verdict  # it cannot know of contacts
    assert "contacts" not in verdict
    assert len(ul.open(folder / "frames.mcap").frames()) == 4


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("x4:/dev/null", r"vehicle: no vehicle at 'x4:/dev/null' .*mavlink:PLACE"),
        ("hector", "no vehicle at 'hector'"),
        ("mavlink:udp://127.0.0.1:{port}?hull=1", "no option 'hull'"),
        ("mavlink:udp://127.0.0.1:{port}?wait_s=0.3", r"no HEARTBEAT of an autopilot within 0.3 s"),
    ],
)
def test_what_is_no_aircraft_is_refused_in_one_line(target: str, says: str) -> None:
    with Copter((0.0, 0.0, 0.0)) as copter:
        copter.silent = True
        with pytest.raises(InputError, match=says):
            ul.explore(ROOM, vehicle=target.format(port=copter.port), options=QUICK)


def test_an_aircraft_flies_at_its_own_height_and_by_its_own_poses() -> None:
    for more in ({"height_m": 1.0}, {"poses": "radar"}):
        with pytest.raises(InputError, match=r"of its own.*its reported poses"):
            ul.explore(ROOM, vehicle="mavlink:udp://127.0.0.1:1", options=QUICK, **more)  # type: ignore[arg-type]
