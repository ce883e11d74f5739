"""Instruments that are not there: an X4 module on a pseudo terminal, a PulsON 440 on UDP and an A121 on TCP.

They answer their protocols byte by byte, for tests and newcomers. Their echo is that of a sphere that swings in front
of the radar.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.ports.instruments import acconeer, mrm
from ullage.ports.instruments import x4 as mcp
from ullage.ports.radar_logs import DRIVER_C, LEAD_S, PACKET, SCAN_INFO, STEP_S, subsweep_fields
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec
from ullage.world import scenes

Fault = Literal["loss", "duplicate", "late", "garbage"]
EVERY = 10
"""A fault befalls one frame in so many."""
SWING_M, SWINGS = 0.02, 34
"""Amplitude of the sphere [m], and frames of a swing, which repeat."""
SPHERE_M = 3.0
COUNTS = 1e8
"""Counts of a PulsON for a sample of 1."""
PEAK, TICKS_HZ, CELSIUS = 1000.0, 1_000_000, 24
"""Counts of the A121's strongest echo, its ticks in a second, and its temperature."""
LATE_S, ROOM_S = 0.1, 2.0
"""How late a late frame comes, and for how much a serial line's buffer has room: 64 kB in Linux [s]."""


def faults_of(text: str) -> tuple[Fault, ...]:
    """Return the faults that a text names, with commas between.

    Raises:
        InputError: one is unknown.
    """
    names = tuple(part for part in text.split(",") if part)
    if unknown := [name for name in names if name not in get_args(Fault)]:
        raise InputError(f"no fault {unknown[0]!r}", where="--faults", allowed=", ".join(get_args(Fault)))
    return names  # type: ignore[return-value]


@lru_cache(maxsize=4)
def swing(spec: RadarSpec) -> np.ndarray:
    """Return the samples (SWINGS, b) of a sphere that swings in front of a radar."""
    x_m = SWING_M * np.sin(2 * np.pi * np.arange(SWINGS) / SWINGS)
    place = np.column_stack([x_m, np.zeros((SWINGS, 2))])
    path = Trajectory(np.arange(SWINGS) * 50_000_000, place, np.tile([0.0, 0.0, 0.0, 1.0], (SWINGS, 1)))
    return np.asarray(simulate(scenes.sphere(radius_m=0.3, distance_m=SPHERE_M), path, spec, seed=1).samples)


class Simulated(ABC):
    """A thread that answers requests and sends frames when they are due.

    Args:
        faults: what befalls one frame in ten.
    """

    address: str
    """Where a driver finds it."""

    def __init__(self, faults: Sequence[Fault] = ()) -> None:
        self._faults, self._stop = tuple(faults), threading.Event()
        self._interval_s: float | None = None
        self._due_s, self.sent = 0.0, 0
        self._random = np.random.default_rng(7)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._stop.is_set():
            wait_s = 0.05 if self._interval_s is None else min(max(self._due_s - time.monotonic(), 0.0), 0.05)
            try:
                self._answer(wait_s)
            except OSError:
                self._stop.wait(0.05)  # nobody has it open
            if self._interval_s is not None and time.monotonic() >= self._due_s:
                self._due_s += self._interval_s
                self._send(self._with_faults(self._frame(self.sent)))
                self.sent += 1

    def _begin(self, interval_s: float | None) -> None:
        self._interval_s, self._due_s = interval_s, time.monotonic()

    def _with_faults(self, packets: list[bytes]) -> list[bytes]:
        if not self._faults or self.sent % EVERY != EVERY - 1:
            return packets
        fault = self._faults[self.sent // EVERY % len(self._faults)]
        if fault == "late":
            time.sleep(LATE_S)
        if fault == "duplicate":
            return packets + packets
        if fault == "garbage":
            return [self._random.bytes(200), *packets]
        return packets if fault == "late" else packets[:-1]

    @abstractmethod
    def _answer(self, wait_s: float) -> None:
        """Answer what is asked; wait no longer than this [s]."""

    @abstractmethod
    def _frame(self, number: int) -> list[bytes]:
        """Return a frame as it goes over the line, in pieces."""

    @abstractmethod
    def _send(self, packets: Iterable[bytes]) -> None:
        """Put pieces on the line."""

    def wait(self) -> None:
        """Wait until it is closed."""
        while not self._stop.wait(1.0):
            pass

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join(2.0)


class SimulatedX4(Simulated):
    """An X4 module at the other end of a pseudo terminal, whose name is `path`."""

    def __init__(self, faults: Sequence[Fault] = ()) -> None:
        import pty
        import tty

        super().__init__(faults)
        self._fd, slave = pty.openpty()
        tty.setraw(slave)
        self.address = self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._fd, False)
        self._unpacker = mcp.Unpacker()
        self._values: dict[int, bytes] = {}
        self._rows = swing(RadarSpec.preset("x4m05"))  # compiles while nobody waits
        self._thread.start()

    def _answer(self, wait_s: float) -> None:
        try:
            came = os.read(self._fd, 4096)
        except BlockingIOError:
            time.sleep(min(wait_s, 0.005))
            return
        for body in self._unpacker.feed(came):
            self._send([mcp.pack(self._reply(body))])

    def _reply(self, body: bytes) -> bytes:
        if body[0] == mcp.SET_MODE or body[:2] == bytes([mcp.X4_DRIVER, mcp.INIT]):
            return bytes([mcp.ACK])
        if body[:1] != bytes([mcp.X4_DRIVER]) or len(body) < 6:
            return struct.pack("<BI", mcp.ERROR, 0x01)
        name = int.from_bytes(body[2:6], "little")
        if body[1] == mcp.GET:
            values = np.frombuffer(self._values[name], "<f4")
            return mcp.ARRAY.pack(mcp.REPLY, mcp.FLOATS, name, 0, len(values)) + values.tobytes() + b"\x04"
        self._values[name] = body[6:]
        if name == mcp.AREA:
            self._values[name] = self._round(body[6:])
        if name == mcp.FPS:
            fps = struct.unpack("<f", body[6:10])[0]
            if fps > 0 and not self._possible(fps):
                return struct.pack("<BI", mcp.ERROR, 0x21)
            if fps > 0:
                self._rows = swing(self._spec())
            self._begin(1 / fps if fps > 0 else None)
        return bytes([mcp.ACK])

    def _number(self, name: int) -> int:
        return int.from_bytes(self._values[name], "little")

    def _possible(self, fps: float) -> bool:
        """Whether all pulses of a frame fit into its time."""
        steps = self._number(mcp.DAC_MAX) - self._number(mcp.DAC_MIN) + 1
        pulses = self._number(mcp.ITERATIONS) * self._number(mcp.PULSES) * steps
        return fps * pulses * self._number(mcp.PRF_DIV) / 243e6 <= 1

    @staticmethod
    def _round(area: bytes) -> bytes:
        bin_m = 8 * DRIVER_C / (2 * 23.328e9)
        start, stop = struct.unpack("<ff", area)
        return struct.pack("<ff", bin_m * round(start / bin_m), bin_m * round(stop / bin_m))

    def _spec(self) -> RadarSpec:
        start, stop = struct.unpack("<ff", self._values[mcp.AREA])
        bins = round((stop - start) * 2 * 23.328e9 / (8 * DRIVER_C))
        return RadarSpec.preset("x4m05", range_start_m=start * C0 / DRIVER_C, bins=bins)

    def _frame(self, number: int) -> list[bytes]:
        row = self._rows[number % SWINGS]
        data = mcp.pack_data(np.concatenate([row.real, row.imag]).astype(np.float32), number)
        return [data[k : k + 512] for k in range(0, len(data), 512)]

    def _send(self, packets: Iterable[bytes]) -> None:
        left, end_s = b"".join(packets), time.monotonic() + ROOM_S
        while left and time.monotonic() < end_s:  # what nobody reads is lost
            try:
                left = left[os.write(self._fd, left) :]
            except BlockingIOError:
                time.sleep(0.001)

    def close(self) -> None:
        """End the thread and the terminal, as if the module were unplugged."""
        super().close()
        os.close(self._fd)


class SimulatedMrm(Simulated):
    """A PulsON 440 on a UDP port of this computer, `address`.

    Args:
        port: 0 takes a free one.
        faults: what befalls one scan in ten.
    """

    def __init__(self, port: int = 0, faults: Sequence[Fault] = ()) -> None:
        super().__init__(faults)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._peer: tuple[str, int] | None = None
        self._config = mrm.CONFIG.pack(0, 0, 1, 0, 100_000, mrm.RESOLUTION, 11, *(0,) * 8, 2, 0, 0, 0)
        self._rows = swing(RadarSpec.preset("pulson440"))  # compiles while nobody waits
        self._thread.start()

    def _answer(self, wait_s: float) -> None:
        self._socket.settimeout(max(wait_s, 0.001))
        try:
            request, peer = self._socket.recvfrom(2048)
        except TimeoutError:
            return
        self._peer = peer
        kind, number = struct.unpack_from(">HH", request)
        head, good = struct.pack(">HH", kind | mrm.CONFIRMS, number), struct.pack(">I", 0)
        if kind == mrm.SET_CONFIG:
            self._config = request
        answers = {
            mrm.GET_CONFIG: self._config[4:] + good + good,
            mrm.STATUS: bytes(20) + struct.pack(">i", 120) + good,
        }
        self._socket.sendto(head + answers.get(kind, good), peer)
        if kind == mrm.CONTROL:
            count, _, interval_us = struct.unpack_from(">HHI", request, 4)
            if count:
                self._rows = swing(self._spec(1e6 / interval_us))
            self._begin(1e-6 * interval_us if count else None)

    def _spec(self, fps: float) -> RadarSpec:
        _, _, _, start_ps, stop_ps, *_ = mrm.CONFIG.unpack_from(self._config)
        bins = round((stop_ps - start_ps) * 1e-12 / STEP_S)
        return RadarSpec.preset("pulson440", range_start_m=C0 / 2 * (start_ps * 1e-12 - LEAD_S), bins=bins, fps=fps)

    def _frame(self, number: int) -> list[bytes]:
        row = np.round(self._rows[number % SWINGS] * COUNTS).astype(">i4")
        parts = -(-len(row) // 350)
        out = np.zeros(parts, PACKET)
        out["kind"], out["message"], out["total"], out["packets"] = SCAN_INFO, number & 0xFFFF, len(row), parts
        out["t_ms"] = round(1e3 * number * (self._interval_s or 0.0))
        for k in range(parts):
            piece = row[350 * k : 350 * (k + 1)]
            out[k]["index"], out[k]["here"], out[k]["samples"][: len(piece)] = k, len(piece), piece
        return [one.tobytes() for one in out]

    def _send(self, packets: Iterable[bytes]) -> None:
        for packet in packets:
            if self._peer is not None:
                self._socket.sendto(packet, self._peer)

    def close(self) -> None:
        """End the thread and the socket."""
        super().close()
        self._socket.close()


class SimulatedA121(Simulated):
    """An exploration server with an A121 on a TCP port of this computer, `address` [AcconeerET].

    Args:
        port: 0 takes a free one.
        faults: what befalls one frame in ten.
        host: address of this computer.
    """

    def __init__(self, port: int = 0, faults: Sequence[Fault] = (), *, host: str = "127.0.0.1") -> None:
        super().__init__(faults)
        self._server = socket.create_server((host, port))
        self.address = f"{host}:{self._server.getsockname()[1]}"
        self._peer: socket.socket | None = None
        self._came = b""
        self.info = {"data_saturated": False, "frame_delayed": False, "calibration_needed": False}
        """What each frame says of itself."""
        self._spec = RadarSpec.preset("a121")
        self._rows = swing(self._spec)  # compiles while nobody waits
        self._thread.start()

    def _answer(self, wait_s: float) -> None:
        self._server.settimeout(max(wait_s, 0.001))
        if self._peer is None:
            try:
                self._peer, self._came = self._server.accept()[0], b""
            except TimeoutError:
                return
        self._peer.settimeout(max(wait_s, 0.001))
        try:
            came = self._peer.recv(4096)
        except TimeoutError:
            return
        except OSError:
            came = b""
        if not came:
            self._leave()
        *lines, self._came = (self._came + came).split(b"\n")
        for line in lines:
            self._send([_line(self._reply(json.loads(line)))])

    def _leave(self) -> None:
        self._begin(None)
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def _reply(self, asked: dict[str, Any]) -> dict[str, Any]:
        command = asked.get("cmd")
        if command == "get_system_info":
            info = {"rss_version": "a121-v1.0.0", "sensor": "a121", "sensor_count": 1, "ticks_per_second": TICKS_HZ}
            return {"status": "ok", "system_info": info}
        if command == "get_sensor_info":
            return {"status": "ok", "sensor_info": [{"connected": True, "serial": "simulated"}]}
        if command == "setup":
            return self._set_up(asked["groups"][0][0]["config"])
        if command == "start_streaming":
            self.info["calibration_needed"] = False
            self._begin(1 / self._spec.fps)
            return {"status": "start"}
        if command == "stop_streaming":
            self._begin(None)
            return {"status": "stop"}
        return {"status": "error", "message": f"no command {command}"}

    def _set_up(self, sensor: dict[str, Any]) -> dict[str, Any]:
        one = sensor["subsweeps"][0]
        if sensor["frame_rate"] * one["hwaas"] * one["num_points"] > 1e6:
            return {"status": "error", "message": "the frame rate is too high for this sweep"}
        named = one | {"profile": f"PROFILE_{one['profile']}"}
        fields = subsweep_fields(named, acconeer.STEP_M) | {"bins": one["num_points"], "fps": sensor["frame_rate"]}
        self._spec = RadarSpec.preset("a121", **fields)
        self._rows = swing(self._spec)
        points = self._spec.bins
        about = {
            "frame_data_length": points, "sweep_data_length": points, "subsweep_data_offset": [0],
            "subsweep_data_length": [points], "calibration_temperature": CELSIUS, "max_sweep_rate": 1000.0,
            "base_step_length_m": acconeer.STEP_M,
        }  # fmt: skip
        return {"status": "ok", "tick_period": round(TICKS_HZ / self._spec.fps), "metadata": [[about]]}

    def _frame(self, number: int) -> list[bytes]:
        row = self._rows[number % SWINGS] * (PEAK / (np.abs(self._rows).max() or 1.0))
        pairs = np.round(np.stack([row.real, -row.imag], axis=1)).astype("<i2").tobytes()
        info = self.info | {"tick": round(number * TICKS_HZ / self._spec.fps), "temperature": CELSIUS}
        return [_line({"status": "ok", "result_info": [[info]], "payload_size": len(pairs)}) + pairs]

    def _send(self, packets: Iterable[bytes]) -> None:
        if self._peer is None:
            return
        self._peer.settimeout(ROOM_S)
        try:
            self._peer.sendall(b"".join(packets))
        except OSError:
            self._leave()

    def close(self) -> None:
        """End the thread and the connections."""
        super().close()
        self._leave()
        self._server.close()


def _line(values: dict[str, Any]) -> bytes:
    """A message of the server: JSON on a line."""
    return json.dumps(values).encode() + b"\n"
