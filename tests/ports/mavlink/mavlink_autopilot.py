"""The other side of the link: an autopilot made of pymavlink alone, which sends, answers and keeps what it gets."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import common as mav
from waiting import until


def free_port() -> int:
    """A UDP port that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


class Autopilot:
    """Listens on a loopback port, or sends to one; speaks from a thread of its own.

    Args:
        system: its system id.
        component: its component id.
        boot_ns: what its clock is ahead of this machine's monotonic one [ns].
        drift: how much faster its clock goes.
        poses: gives messages for a time of its clock [s]; called 50 times a second.
        to: a port that it sends to before anybody spoke to it.
        timesync: whether it answers TIMESYNC.
        denies: ids of messages whose rate it does not set; None: it answers no such command.
        mode: it is an ArduCopter that flies in this mode, and takes another by DO_SET_MODE; None: a PX4 on the ground.
    """

    def __init__(
        self, *, system: int = 1, component: int = 1, boot_ns: int = 0, drift: float = 0.0,
        poses: Callable[[float], list[Any]] | None = None, to: int | None = None, timesync: bool = True,
        denies: set[int] | None = None, mode: int | None = None,
    ) -> None:  # fmt: skip
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.005)
        self.port = int(self.socket.getsockname()[1])
        self.got: list[tuple[float, Any]] = []  # when [s, monotonic], and what
        self.offsets: list[int] = []  # what its own TIMESYNC questions gave [ns]
        self.silent, self.mode = False, mode
        self._boot_ns, self._drift, self._poses, self._timesync = boot_ns, drift, poses, timesync
        self._denies = denies
        self._begun_ns = time.monotonic_ns()
        self._there: tuple[str, int] | None = ("127.0.0.1", to) if to else None
        self._mav = mav.MAVLink(None, srcSystem=system, srcComponent=component)
        self._mav.robust_parsing = True
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def clock_ns(self, now_ns: int | None = None) -> int:
        """Its clock [ns]."""
        now = time.monotonic_ns() if now_ns is None else now_ns
        return now + self._boot_ns + round(self._drift * (now - self._begun_ns))

    def restart(self, boot_ns: int) -> None:
        """Begin its clock anew."""
        self._boot_ns, self._begun_ns = boot_ns, time.monotonic_ns()

    def send(self, message: Any, *, system: int | None = None, component: int | None = None) -> None:
        """Send a message, also under other ids."""
        mine = self._mav.srcSystem, self._mav.srcComponent
        self._mav.srcSystem, self._mav.srcComponent = system or mine[0], component or mine[1]
        self.raw(bytes(message.pack(self._mav)))
        self._mav.srcSystem, self._mav.srcComponent = mine

    def raw(self, data: bytes) -> None:
        """Send bytes."""
        if self._there is not None:
            self.socket.sendto(data, self._there)

    def of(self, kind: str) -> list[Any]:
        """Messages of one type that came."""
        return [message for _, message in list(self.got) if message.get_type() == kind]

    def times(self, kind: str) -> list[float]:
        """When they came [s, monotonic]."""
        return [at for at, message in list(self.got) if message.get_type() == kind]

    def await_(self, kind: str, count: int = 1, timeout_s: float = 20.0) -> list[Any]:
        """Wait for messages of a type."""
        until(lambda: len(self.of(kind)) >= count, timeout_s)
        return self.of(kind)

    def _run(self) -> None:
        heartbeat = pose = question = 0.0
        while not self._closing.is_set():
            self._receive()
            now = time.monotonic()
            if self.silent or self._there is None:
                continue
            if now - heartbeat >= 0.5:
                heartbeat = now
                self.send(self._heartbeat())
            if now - question >= 0.5:
                question = now
                self.send(mav.MAVLink_timesync_message(0, self.clock_ns()))
            if self._poses is not None and now - pose >= 0.02:
                pose = now
                for message in self._poses(self.clock_ns() * 1e-9):
                    self.send(message)

    def _heartbeat(self) -> Any:
        kind, flags = (mav.MAV_AUTOPILOT_PX4, 0) if self.mode is None else (mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 209)
        return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, kind, flags, self.mode or 0, 4, 3)

    def _commanded(self, message: Any) -> None:
        """Answer a COMMAND_LONG."""
        if message.command == mav.MAV_CMD_DO_SET_MODE:
            self.mode = int(message.param2)
            self.send(mav.MAVLink_command_ack_message(message.command, mav.MAV_RESULT_ACCEPTED))
        elif self._denies is not None:
            result = mav.MAV_RESULT_DENIED if message.param1 in self._denies else mav.MAV_RESULT_ACCEPTED
            self.send(mav.MAVLink_command_ack_message(message.command, result))

    def _receive(self) -> None:
        try:
            data, self._there = self.socket.recvfrom(65535)
        except OSError:
            return
        now = time.monotonic_ns()
        for message in self._mav.parse_buffer(data) or []:
            self.got.append((now * 1e-9, message))
            if message.get_type() == "COMMAND_LONG":
                self._commanded(message)
            if message.get_type() != "TIMESYNC" or self.silent:
                continue
            if message.tc1 == 0 and self._timesync:
                self.send(mav.MAVLink_timesync_message(self.clock_ns(), message.ts1))
            elif message.tc1:
                self.offsets.append(message.tc1 - (message.ts1 + self.clock_ns()) // 2)

    def close(self) -> None:
        """End."""
        self._closing.set()
        self._thread.join()
        self.socket.close()

    def __enter__(self) -> Autopilot:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def local_poses(
    at: Callable[[float], tuple[float, float, float]], yaw_rad: float = 0.0
) -> Callable[[float], list[Any]]:
    """LOCAL_POSITION_NED and ATTITUDE_QUATERNION of a level vehicle; `at` gives north, east, down for a time [s]."""

    def poses(t_s: float) -> list[Any]:
        ms, half = round(t_s * 1000), yaw_rad / 2
        return [
            mav.MAVLink_attitude_quaternion_message(ms, math.cos(half), 0, 0, math.sin(half), 0, 0, 0),
            mav.MAVLink_local_position_ned_message(ms, *at(t_s), 0, 0, 0),
        ]

    return poses


class Copter(Autopilot):
    """A multirotor that flies SET_POSITION_TARGET_LOCAL_NED while its pilot lets it, with dynamics of its own.

    It reaches a velocity with a lag of 0.25 s. Without a set-point for a second it hovers.

    Args:
        start: north, east, down [m].
        ground_m: how far down the ground is [m].
        px4: it speaks as PX4; else as ArduCopter.
        mode: as the pilot chose it: "GUIDED" or "OFFBOARD", "LOITER", "BRAKE", "LAND".
        boot_ns: what its clock is ahead of this machine's monotonic one [ns].
    """

    MODES: ClassVar = {"GUIDED": 4, "OFFBOARD": 6 << 16, "LOITER": 5, "BRAKE": 17, "HOLD": 4 << 16 | 3 << 24}

    def __init__(
        self, start: tuple[float, float, float], *, ground_m: float = 1.4, px4: bool = False, mode: str = "",
        boot_ns: int = 0,
    ) -> None:  # fmt: skip
        self.place, self.velocity, self.yaw, self.ground_m = np.array(start), np.zeros(3), 0.0, ground_m
        self.chosen, self.armed, self.px4, self.lags_s = mode or ("OFFBOARD" if px4 else "GUIDED"), True, px4, []
        self.track: list[tuple[float, Any]] = []
        self._seen, self._then, self._wish, self._wish_s = 0, 0.0, (np.zeros(3), 0.0), -math.inf
        super().__init__(poses=self._fly, boot_ns=boot_ns)

    def tell(self, poses: Callable[[float], list[Any]]) -> None:
        """Send other poses."""
        self._poses = poses

    @property
    def follows(self) -> bool:
        """Whether it flies set-points."""
        return self.armed and self.chosen == ("OFFBOARD" if self.px4 else "GUIDED")

    def _heartbeat(self) -> Any:
        kind = mav.MAV_AUTOPILOT_PX4 if self.px4 else mav.MAV_AUTOPILOT_ARDUPILOTMEGA
        return mav.MAVLink_heartbeat_message(2, kind, 209 if self.armed else 81, self.MODES[self.chosen], 4, 3)

    def _commanded(self, message: Any) -> None:
        if message.command == mav.MAV_CMD_DO_SET_MODE:
            self.chosen = "HOLD" if self.px4 and (message.param2, message.param3) == (4, 3) else "BRAKE"
        elif message.command == mav.MAV_CMD_NAV_LAND:
            self.armed = False
        self.send(mav.MAVLink_command_ack_message(message.command, mav.MAV_RESULT_ACCEPTED))

    def _fly(self, t_s: float) -> list[Any]:
        step_s, self._then = min(t_s - self._then, 0.1) if self._then else 0.0, t_s
        for at_s, message in self.got[self._seen :]:
            self._seen += 1
            if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                assert message.type_mask == 0x5C7 or not self.follows
                assert message.coordinate_frame == mav.MAV_FRAME_LOCAL_NED
                self._wish = np.array([message.vx, message.vy, message.vz]), message.yaw_rate
                self._wish_s = at_s
                self.lags_s.append(self.clock_ns(round(at_s * 1e9)) * 1e-9 - message.time_boot_ms * 1e-3)
        fresh = self.follows and time.monotonic() - self._wish_s < 1.0
        velocity, turn = self._wish if fresh else (np.zeros(3), 0.0)
        self.velocity = self.velocity + np.clip((velocity - self.velocity) / 0.25, -3, 3) * step_s
        self.place = self.place + self.velocity * step_s
        self.place[2] = min(self.place[2], self.ground_m)
        self.yaw += turn * step_s
        self.track.append((t_s, self.place.copy()))
        ms, half = round(t_s * 1000), self.yaw / 2
        return [
            mav.MAVLink_attitude_quaternion_message(ms, math.cos(half), 0, 0, math.sin(half), 0, 0, turn),
            mav.MAVLink_local_position_ned_message(ms, *self.place, *self.velocity),
        ]
