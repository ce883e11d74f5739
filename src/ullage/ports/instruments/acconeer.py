"""An Acconeer A121 behind an exploration server: `acconeer:192.168.0.2` or `acconeer:/dev/ttyUSB0` [AcconeerET].

Acconeer's own library speaks with the server; it waits for ever where the server closes the line within a frame. Each
frame is one sweep; the server's ticks time it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import Field

from ullage.errors import InputError, need, one_line
from ullage.geometry import C0
from ullage.ports.instruments.source import Instrument, InstrumentOptions, InstrumentSource, Scan, host_and_port
from ullage.ports.radar_logs import subsweep_fields
from ullage.specs import RadarSpec

PORT = 6110
STEP_M = 0.0025
"""Range of one step, about: the sensor answers its own [m]."""
BLIND_M = 4.5
"""The sensor measures so much less far than its pulses are apart, at every pulse rate [m] [AcconeerET, PRF]."""
SETTLED = ("center_hz", "bandwidth_hz", "sampling_hz", "decimation", "output", "stagger_div")
"""Fields of a RadarSpec that profile and step length settle, or the sensor does not have."""
ALLOWED = "acconeer:HOST, acconeer:HOST:PORT or acconeer:/dev/ttyUSB0, an exploration server with an A121"


class AcconeerOptions(InstrumentOptions):
    """Options of an A121; all others are fields of its RadarSpec."""

    profile: int = Field(3, ge=1, le=5, description="pulse: 1 is the shortest, 5 has the greatest gain")
    step_length: int = Field(24, ge=1, le=960, description="steps of 2.5 mm in a bin: a divisor of 24 or a multiple")
    number: int = Field(1, ge=1, le=5, description="of the sensor on its board")


class A121(Instrument):
    """One sensor behind an exploration server: at `HOST`, `HOST:PORT`, or on a serial device.

    Of its RadarSpec it takes bins, range_start_m, fps, and iterations times pulses_per_step as hwaas.
    """

    scheme, settings, preset = "acconeer", AcconeerOptions, "a121"

    def __init__(self, address: str, spec: RadarSpec, options: AcconeerOptions) -> None:
        super().__init__(address, spec, options)
        self._host, self._port = host_and_port(address, PORT, where=self.place, allowed=ALLOWED)
        self._library: Any = need("acconeer.exptool.a121", extra="acconeer")
        self._client: Any = None
        self._ticks_hz = 1.0
        self._frames = self._saturated = self._late = 0
        self._temperature_c: int | None = None

    @classmethod
    def open(cls, address: str, options: dict[str, Any]) -> InstrumentSource:
        """Open it as any instrument; profile and step length settle some fields of its RadarSpec."""
        if fixed := [name for name in options if name in SETTLED]:
            where = f"{cls.scheme}:{address}"
            raise InputError(f"{fixed[0]} cannot be set", where=where, allowed="profile= and step_length= instead")
        return super().open(address, options)

    def start(self) -> None:
        """Connect, set the sensor up with a calibration, and let it measure."""
        try:
            self._client = self._connected()
            sensor = self._settings()
            about = self._client.setup_session(self._library.SessionConfig({self._options.number: sensor}))
            if isinstance(about, list):
                about = about[0][self._options.number]
            self._ticks_hz = float(self._client.server_info.ticks_per_second)
            self._client.start_session()
        except InputError:
            raise
        except Exception as error:  # the library raises any kind
            raise InputError(_why(error), where=self.place, allowed=ALLOWED) from None
        settled = {name: getattr(sensor, name) for name in ("start_point", "step_length", "hwaas")}
        fields = subsweep_fields(settled | {"profile": sensor.profile.name}, float(about.base_step_length_m))
        self.spec = self._wanted.but(**fields)

    def _connected(self) -> Any:
        client = self._library.Client
        where = {"serial_port": self._host} if self._host.startswith("/") else {"ip_address": self._host}
        if hasattr(client, "open"):  # from version 6 on
            return client.open(**where, **({} if self._port == PORT else {"tcp_port": self._port}))
        if self._port != PORT:
            what = f"acconeer-exptool before version 6 knows port {PORT} only"
            raise InputError(what, where=self.place, allowed=f"acconeer:{self._host}")
        made = client(**where)
        made.connect()
        return made

    def _settings(self) -> Any:
        """The sensor's settings, with the fastest pulses whose next one comes after the last range."""
        spec, own = self._wanted, self._options
        end_m = spec.range_start_m + spec.bins * own.step_length * STEP_M
        rates = {float(np.ravel(one.value)[0]): one for one in self._library.PRF}
        fast = [hz for hz in rates if C0 / (2 * hz) - BLIND_M >= end_m and (hz < 19e6 or own.profile == 1)]
        if not fast:
            most_m = C0 / (2 * min(rates)) - BLIND_M
            raise InputError(f"ranges to {end_m:.1f} m", where=self.place, allowed=f"to {most_m:.1f} m")
        return self._library.SensorConfig(
            sweeps_per_frame=1, frame_rate=spec.fps, start_point=round(spec.range_start_m / STEP_M),
            num_points=spec.bins, step_length=own.step_length, hwaas=spec.iterations * spec.pulses_per_step,
            profile=self._library.Profile(own.profile), prf=rates[max(fast)],
        )  # fmt: skip

    def scans(self) -> Iterator[Scan]:
        """Give sweeps until the server is silent.

        Raises:
            OSError: the server is gone, or silent for too long.
            InputError: the sensor asks for a new calibration, which a new start makes.
        """
        last: int | None = None
        while True:
            try:
                result = self._client.get_next()
            except Exception as error:  # the library raises any kind
                raise OSError(0, _why(error)) from None
            arrived_s = time.time()
            if last == result.tick:  # the same frame again
                continue
            if result.calibration_needed:
                raise InputError("its temperature changed, so that it calibrates anew", where=self.place)
            last, self._temperature_c = result.tick, result.temperature
            self._frames += 1
            self._saturated += bool(result.data_saturated)
            self._late += bool(result.frame_delayed)
            samples = np.conj(result.frame[0]).astype(np.complex64)  # the phase falls with range, as in a file
            yield Scan(samples, last / self._ticks_hz, arrived_s)

    def close(self) -> None:
        """Let the sensor stop, and close the line."""
        client, self._client = self._client, None
        if client is None:
            return
        try:
            (client.close if hasattr(client, "close") else client.disconnect)()
        except Exception:
            return  # it is gone

    def health(self) -> list[str]:
        """Return its temperature, and how many frames were saturated or late."""
        lines = [] if self._temperature_c is None else [f"{self._temperature_c} deg C at the end"]
        if self._saturated:
            lines.append(
                f"{self._saturated:,} of {self._frames:,} frames are saturated: their strongest echoes are cut"
            )
        if self._late:
            lines.append(f"{self._late:,} of {self._frames:,} frames came late: lower fps, bins or pulses_per_step")
        return lines


open_source = A121.open


def _why(error: Exception) -> str:
    """What a library's error says, with that of its cause."""
    said = [str(one) for one in (error, error.__cause__) if one is not None and str(one)]
    return one_line(": ".join(said) or type(error).__name__, most=300)
