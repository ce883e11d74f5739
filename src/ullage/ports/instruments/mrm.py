"""A PulsON 440 radar on UDP: `mrm:192.168.1.100` [TDSR-MRM].

The radar gets the settings of a RadarSpec and sends scans, each in packets of at most 350 samples. All numbers are big
endian. A scan of which a packet is missing is left out and counted.
"""

from __future__ import annotations

import itertools
import math
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ullage.errors import InputError
from ullage.geometry import C0
from ullage.ports.instruments.source import Instrument, InstrumentOptions, Scan, host_and_port
from ullage.ports.radar_logs import LEAD_S, PACKET, SCAN_INFO, STEP_S
from ullage.specs import RadarSpec

PORT = 21210
SET_CONFIG, GET_CONFIG, CONTROL, STATUS = 0x1001, 0x1002, 0x1003, 0xF001
CONFIRMS = 0x0100
"""A confirmation is the request's number and this."""
CONFIG = struct.Struct(">HHIiiHH4H4B4B")
"""Request and confirmation begin alike: kind, number, node, start and stop [ps], resolution, integration, segments that
are not used, antenna mode, transmit gain, code channel, whether to keep it."""
TEMPERATURE_AT = 24
"""Place of the board's temperature in the answer to `STATUS`, in quarters of a degree."""
RESOLUTION, ANTENNAS, GROUP = 32, 2, 96
"""Of a scan: steps of 1.907 ps in a sample, transmit on A and receive on B, and samples come by so many."""
ENDLESS = 65535
TRIES, ANSWER_S, SILENCE_S, PAUSE_S = 3, 0.5, 2.0, 0.2
MOST_WAITING = 4
"""Scans that wait for a packet; older ones are left out."""


class MrmOptions(InstrumentOptions):
    """Options of a PulsON radar; all others are fields of its RadarSpec."""

    gain: int = Field(63, ge=0, le=63, description="transmit gain; keep to what your country allows")
    channel: int = Field(0, ge=0, le=10, description="code channel, another one for each radar near")
    node: int = Field(100, ge=1, le=2**32 - 2, description="number of the radar")


class MrmRadar(Instrument):
    """One radar at `HOST`, or `HOST:PORT` where its port is not 21210."""

    scheme, settings, preset = "mrm", MrmOptions, "pulson440"

    def __init__(self, address: str, spec: RadarSpec, options: MrmOptions) -> None:
        super().__init__(address, spec, options)
        self._address = host_and_port(address, PORT, where=self.place, allowed="mrm:HOST or mrm:HOST:PORT")
        integration = round(math.log2(spec.pulses_per_step * spec.iterations))
        if not 6 <= integration <= 15 or 2**integration != spec.pulses_per_step * spec.iterations:
            pulses = spec.pulses_per_step * spec.iterations
            allowed = "pulses_per_step times iterations of 64, 128, ... 32768"
            raise InputError(f"{pulses} pulses a sample", where=self.place, allowed=allowed)
        self._integration = integration
        self._socket: socket.socket | None = None
        self._numbers = itertools.count(1)
        self._temperature_c: float | None = None

    def start(self) -> None:
        """Set the radar up, and let it scan without an end."""
        try:
            host, port = self._address
            family, _, _, _, peer = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.connect(peer)  # hears this radar only
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
            self._socket.settimeout(PAUSE_S)
        except OSError as error:
            allowed = "the radar's address"
            raise InputError(f"cannot be reached: {error.strerror}", where=self.place, allowed=allowed) from None
        self._set_up()

    def _set_up(self) -> None:
        spec, own = self._wanted, self._options
        self._ask(CONTROL, struct.pack(">HHI", 0, 0, 0), "a pause")
        bins = GROUP * math.ceil(spec.bins / GROUP)
        start_ps = round((2 * spec.range_start_m / C0 + LEAD_S) * 1e12)
        stop_ps = start_ps + math.floor(bins * STEP_S * 1e12)
        head, unused = (0, 0, own.node, start_ps, stop_ps, RESOLUTION, self._integration), (0,) * 8
        config = CONFIG.pack(*head, *unused, ANTENNAS, own.gain, own.channel, 0)
        self._ask(SET_CONFIG, config[4:], f"ranges from {spec.range_start_m:g} m and {2**self._integration} pulses")
        told = CONFIG.unpack_from(self._ask(GET_CONFIG, b"", "its settings", status=False))
        self.spec = spec.but(range_start_m=C0 / 2 * (told[3] * 1e-12 - LEAD_S), bins=bins)
        status = self._ask(STATUS, b"", "its status", status=False)
        if len(status) >= TEMPERATURE_AT + 4:
            self._temperature_c = 0.25 * struct.unpack_from(">i", status, TEMPERATURE_AT)[0]
        interval_us = round(1e6 / spec.fps)
        self._ask(CONTROL, struct.pack(">HHI", ENDLESS, 0, interval_us), f"fps {spec.fps:g}")

    def _ask(self, kind: int, body: bytes, what: str, *, status: bool = True) -> bytes:
        """Send a request, again where it is lost, and return its confirmation.

        Raises:
            InputError: no confirmation comes, or its status is an error.
        """
        for _ in range(TRIES):
            number = next(self._numbers) & 0xFFFF
            self._send(struct.pack(">HH", kind, number) + body)
            end_s = time.monotonic() + ANSWER_S
            while time.monotonic() < end_s:
                answer = self._receive()
                if len(answer) < 4 or struct.unpack_from(">HH", answer) != (kind | CONFIRMS, number):
                    continue
                if status and (code := int.from_bytes(answer[-4:], "big")):
                    raise InputError(f"the radar refuses {what}: status {code}", where=self.place)
                return answer
        raise InputError(f"no answer when asked for {what}", where=self.place, allowed="the address of a PulsON 440")

    def _send(self, request: bytes) -> None:
        if self._socket is None:
            raise OSError(0, "closed")
        try:
            self._socket.send(request)
        except ConnectionRefusedError:  # about an earlier request: nothing listens there yet
            time.sleep(PAUSE_S)

    def _receive(self) -> bytes:
        """Return the next packet; empty where none comes for a moment."""
        if self._socket is None:
            raise OSError(0, "closed")
        try:
            return self._socket.recv(65536)
        except TimeoutError:
            return b""
        except ConnectionRefusedError:  # nothing listens there yet
            time.sleep(PAUSE_S)
            return b""

    def scans(self) -> Iterator[Scan]:
        """Give whole scans until a while passes without a packet.

        Raises:
            OSError: the radar is silent for too long.
        """
        heard_s, waiting = time.monotonic(), dict[tuple[int, int], dict[int, NDArray[Any]]]()
        while time.monotonic() - heard_s < SILENCE_S:
            packet = self._receive()
            arrived_s = time.time()
            if len(packet) != PACKET.itemsize:
                continue
            one = np.frombuffer(packet, PACKET)[0]
            parts = int(one["packets"])
            if one["kind"] != SCAN_INFO or one["here"] > 350 or one["total"] != self.spec.bins or one["index"] >= parts:
                continue
            heard_s = time.monotonic()
            key = (int(one["message"]), int(one["t_ms"]))
            waiting.setdefault(key, {})[int(one["index"])] = one["samples"]
            if len(waiting[key]) == parts:
                whole = waiting.pop(key)
                for old in [old for old in waiting if old[1] < key[1]]:  # their packets will not come any more
                    del waiting[old]
                samples = np.concatenate([whole[k] for k in range(parts)])[: self.spec.bins]
                yield Scan(samples.astype(np.float32), 1e-3 * key[1], arrived_s)
            while len(waiting) > MOST_WAITING:
                del waiting[next(iter(waiting))]
        raise TimeoutError(0, f"silent for {SILENCE_S:g} s")

    def close(self) -> None:
        """Let the radar stop, and close the socket."""
        if self._socket is None:
            return
        try:
            self._send(struct.pack(">HHHHI", CONTROL, next(self._numbers) & 0xFFFF, 0, 0, 0))
        except OSError:
            pass  # it is gone
        finally:
            self._socket.close()
            self._socket = None

    def health(self) -> list[str]:
        """Return its temperature at the start."""
        return [] if self._temperature_c is None else [f"{self._temperature_c:g} deg C at the start"]


open_source = MrmRadar.open
