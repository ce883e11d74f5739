"""A XeThru X4 module on a serial line: `x4:/dev/ttyACM0` [NoveldaMCP].

The module is put into the mode in which the host drives the X4, gets the settings of a RadarSpec, and sends every frame
as it is measured. The driver's ranges are at 3e8 m/s [NoveldaX4Driver]; here they are at the vacuum speed of light.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Iterator
from glob import glob
from typing import Any

import numpy as np
from pydantic import Field

from ullage.data import Unit
from ullage.errors import InputError, need
from ullage.geometry import C0
from ullage.ports.instruments import x4_protocol as mcp
from ullage.ports.instruments.source import InstrumentOptions, InstrumentSource, Scan, split_options
from ullage.ports.protocol import Source
from ullage.ports.x4 import DRIVER_C
from ullage.specs import RadarSpec

CARRIERS = {7.29e9: 3, 8.748e9: 4}
"""Carriers [Hz] and their numbers in the module."""
ANSWER_S, SILENCE_S = 2.0, 3.0
"""How long an answer may take, and after how long without a byte the module counts as gone [s]."""
NOT_KNOWN = 0x01
ALLOWED = "x4:/dev/ttyACM0, the serial device of an X4 module"


class X4Options(InstrumentOptions):
    """Options of an X4 module; all others are fields of its RadarSpec."""

    baud: int = Field(115200, ge=1200, le=4_000_000, description="speed of a serial line; a USB port ignores it")
    power: int | None = Field(
        None, ge=0, le=3, description="transmitter: 0 off, 1 low, 2 medium, 3 high; none: as it is"
    )


def open_source(address: str, options: dict[str, Any]) -> Source:
    """Open an X4 module on a serial device, such as `/dev/ttyACM0`.

    Raises:
        InputError: it cannot be opened, does not answer, or refuses a setting.
        MissingExtra: pyserial is not installed.
    """
    place = f"x4:{address}"
    if not address:
        raise InputError("no device is named", where="x4:", allowed=_present())
    own, spec = split_options(X4Options, options, "x4m05", place)
    return InstrumentSource(X4Module(address, spec, own), own, "x4")


def _present() -> str:
    found = sorted([*glob("/dev/ttyACM*"), *glob("/dev/ttyUSB*")])
    return f"{ALLOWED}; here: {', '.join(found) or 'none'}"


class X4Module:
    """One module, and what it said of itself.

    Args:
        device: name of the serial device.
        spec: its settings.
        options: speed of the line, and power.

    Raises:
        InputError: the carrier is none of the module's, or the output is not baseband.
    """

    unit: Unit = "normalised"

    def __init__(self, device: str, spec: RadarSpec, options: X4Options) -> None:
        self.place, self._device, self._options = f"x4:{device}", device, options
        self.spec = self._wanted = spec
        if spec.center_hz not in CARRIERS or spec.output != "baseband":
            known = " or ".join(f"{hz:g}" for hz in CARRIERS)
            raise InputError(
                f"{spec.output} at {spec.center_hz:g} Hz", where=self.place, allowed=f"baseband at {known} Hz"
            )
        if spec.stagger_div is not None:
            raise InputError(f"stagger_div is {spec.stagger_div}", where=self.place, allowed="none: one pulse interval")
        self._serial: Any = need("serial", extra="instruments")
        self._line: Any = None
        self._unpacker = mcp.Unpacker()
        self._counter: int | None = None
        self._strange = 0

    def start(self) -> None:
        """Open the line, set the X4 up, and let it send frames."""
        if not os.path.exists(self._device):
            raise InputError("no such device", where=self.place, allowed=_present())
        try:
            self._line = self._serial.Serial(self._device, self._options.baud, timeout=0.2, exclusive=True)
        except (OSError, ValueError) as error:
            raise InputError(_why_not(error), where=self.place, allowed=_present()) from None
        self._unpacker, self._counter = mcp.Unpacker(), None
        self._set_up()

    def _set_up(self) -> None:
        spec = self._wanted
        for mode in (mcp.STOP, mcp.MANUAL):
            self._ask(bytes([mcp.SET_MODE, mode]), f"mode {mode:#x}", unknown=True)  # X4M03 has no modes
        self._ask(bytes([mcp.X4_DRIVER, mcp.INIT]), "a start of the X4", unknown=True)
        step_m = spec.decimation * C0 / (2 * spec.sampling_hz)
        area = np.array([spec.range_start_m, spec.range_start_m + spec.bins * step_m]) * (DRIVER_C / C0)
        whole, byte, real = (struct.Struct(kind).pack for kind in ("<I", "<B", "<f"))
        settings = [
            (mcp.FPS, real(0.0), "fps 0"),  # nothing comes while it is set up
            (mcp.BASEBAND, byte(1), "baseband"),
            (mcp.CARRIER, byte(CARRIERS[spec.center_hz]), f"center_hz {spec.center_hz:g}"),
            (mcp.ITERATIONS, whole(spec.iterations), f"iterations {spec.iterations}"),
            (mcp.PULSES, whole(spec.pulses_per_step), f"pulses_per_step {spec.pulses_per_step}"),
            (mcp.DAC_STEP, byte(spec.dac_step), f"dac_step {spec.dac_step}"),
            (mcp.DAC_MIN, whole(spec.dac_min), f"dac_min {spec.dac_min}"),
            (mcp.DAC_MAX, whole(spec.dac_max), f"dac_max {spec.dac_max}"),
            (mcp.PRF_DIV, byte(spec.prf_div), f"prf_div {spec.prf_div}"),
            (mcp.AREA_OFFSET, real(spec.frame_area_offset_m), f"frame_area_offset_m {spec.frame_area_offset_m:g}"),
            (mcp.AREA, struct.pack("<ff", *area), f"ranges of {area[0]:.3g} to {area[1]:.3g} m"),
        ]
        if self._options.power is not None:
            settings.append((mcp.POWER, byte(self._options.power), f"power {self._options.power}"))
        for name, value, text in settings:
            self._ask(mcp.setting(name, value), text)
        answer = mcp.floats_of(self._ask(struct.pack("<BBI", mcp.X4_DRIVER, mcp.GET, mcp.AREA), "its ranges"))
        start_m = (
            float(answer.values[0]) * (C0 / DRIVER_C) if answer and len(answer.values) == 2 else spec.range_start_m
        )
        self.spec = spec.but(range_start_m=start_m)
        self._ask(mcp.setting(mcp.FPS, real(spec.fps)), f"fps {spec.fps:g}")

    def _ask(self, body: bytes, what: str, *, unknown: bool = False) -> bytes:
        """Send a command and return its answer; `unknown` says that a module need not know it.

        Raises:
            InputError: no answer comes, or it is an error.
        """
        self._line.write(mcp.pack(body))
        end_s = time.monotonic() + ANSWER_S
        while time.monotonic() < end_s:
            for answer in self._unpacker.feed(self._line.read(max(self._line.in_waiting, 1))):
                if answer[0] in (mcp.ACK, mcp.REPLY):
                    return answer
                if answer[0] == mcp.ERROR:
                    code = int.from_bytes(answer[1:5], "little")
                    if unknown and code == NOT_KNOWN:
                        return answer
                    text = mcp.ERRORS.get(code, f"gives error {code:#x}")
                    raise InputError(f"the module refuses {what}: it {text}", where=self.place)
        allowed = f"an X4 module, and its speed: baud={self._options.baud}"
        raise InputError(f"no answer when asked for {what}", where=self.place, allowed=allowed)

    def scans(self) -> Iterator[Scan]:
        """Give frames until a while passes without one.

        Raises:
            OSError: the device is gone, or silent for too long.
        """
        heard_s = time.monotonic()
        while time.monotonic() - heard_s < SILENCE_S:
            came = self._line.read(max(self._line.in_waiting, 1))
            arrived_s = time.time()
            for body in self._unpacker.feed(came):
                scan = self._scan(body, arrived_s)
                if scan is not None:
                    heard_s = time.monotonic()
                    yield scan
        raise TimeoutError(0, f"silent for {SILENCE_S:g} s")

    def _scan(self, body: bytes, arrived_s: float) -> Scan | None:
        data = mcp.floats_of(body) if body[0] == mcp.DATA else None
        if data is None or len(data.values) % 2 or len(data.values) < 16 or not np.isfinite(data.values).all():
            self._strange += body[0] == mcp.DATA
            return None
        bins, before = len(data.values) // 2, self._counter
        if self._counter == data.information:  # the same frame again
            return None
        if before is None and bins != self.spec.bins:  # the module rounds the ranges that it was asked for
            self.spec = self.spec.but(bins=bins)
        if bins != self.spec.bins:
            self._strange += 1
            return None
        self._counter = data.information
        samples = np.empty(bins, np.complex64)
        samples.real, samples.imag = data.values[:bins], data.values[bins:]
        return Scan(samples, data.information / self.spec.fps, arrived_s)

    def close(self) -> None:
        """Let the X4 rest, and close the line."""
        if self._line is None:
            return
        try:
            self._line.write(mcp.pack(mcp.setting(mcp.FPS, struct.pack("<f", 0.0))))
            self._line.flush()
        except OSError:
            pass  # it is gone
        finally:
            self._line.close()
            self._line = None

    def health(self) -> list[str]:
        """Return how many packets came damaged."""
        count = self._unpacker.damaged + self._strange
        return [f"{count:,} packets came damaged"] if count else []


def _why_not(error: Exception) -> str:
    text = str(error)
    if "lock" in text:
        return "in use: another program has it open"
    if "ermission" in text:
        return "no permission; its group (dialout) may open it"
    return f"cannot be opened: {text.rpartition(': ')[2] or text}"
