"""The other side of the link: an autopilot made of pymavlink alone, which sends, answers and keeps what it gets."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mav


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
        end = time.monotonic() + timeout_s
        while len(self.of(kind)) < count and time.monotonic() < end:
            time.sleep(0.01)
        found = self.of(kind)
        assert len(found) >= count, f"{len(found)} {kind} came, not {count}"
        return found

    def _run(self) -> None:
        heartbeat = pose = question = 0.0
        while not self._closing.is_set():
            self._receive()
            now = time.monotonic()
            if self.silent or self._there is None:
                continue
            if now - heartbeat >= 0.5:
                heartbeat = now
                kind, flags = (
                    (mav.MAV_AUTOPILOT_PX4, 0) if self.mode is None else (mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 209)
                )
                self.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, kind, flags, self.mode or 0, 4, 3))
            if now - question >= 0.5:
                question = now
                self.send(mav.MAVLink_timesync_message(0, self.clock_ns()))
            if self._poses is not None and now - pose >= 0.02:
                pose = now
                for message in self._poses(self.clock_ns() * 1e-9):
                    self.send(message)

    def _receive(self) -> None:
        try:
            data, self._there = self.socket.recvfrom(65535)
        except OSError:
            return
        now = time.monotonic_ns()
        for message in self._mav.parse_buffer(data) or []:
            self.got.append((now * 1e-9, message))
            if message.get_type() == "COMMAND_LONG" and message.command == mav.MAV_CMD_DO_SET_MODE:
                self.mode = int(message.param2)
                self.send(mav.MAVLink_command_ack_message(message.command, mav.MAV_RESULT_ACCEPTED))
            elif message.get_type() == "COMMAND_LONG" and self._denies is not None:
                result = mav.MAV_RESULT_DENIED if message.param1 in self._denies else mav.MAV_RESULT_ACCEPTED
                self.send(mav.MAVLink_command_ack_message(message.command, result))
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
