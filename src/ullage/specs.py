"""Every number a person sets about a radar: frozen, bounded, with the unit in the name.

Facts about the X4 come from [NoveldaXTAN13] (user guide), [NoveldaX4Driver] (published driver) and [NoveldaX4A02]
(antenna data sheet); docs/references.bib has them all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from ullage.errors import InputError, shown
from ullage.geometry import C0, GRAVITY_M_S2, transform
from ullage.untrusted import read_yaml

MOST_DIV = 255
"""Greatest divider of a radar's clock."""
MOST_BOUNCES = 6
"""Greatest number of reflections between sending and receiving."""


def refusal(error: ValidationError, model: type[BaseModel]) -> InputError:
    """Return the first error of pydantic as one line: field, given value, allowed values."""
    first = error.errors()[0]
    field, given = first["loc"], first.get("input")
    text, _, allowed = first["msg"].removeprefix("Value error, ").partition("Input should be ")
    plain = not isinstance(given, dict | BaseModel)
    if first["type"] == "extra_forbidden":
        text, allowed = ": no such setting", _settings(model, field[:-1])
    elif first["type"] == "missing":
        text = " is missing"
    elif allowed:
        text, allowed = f" is {shown(given)}" if plain else " is a group", allowed.partition(", unable")[0]
    else:
        text = f": {text}, not {shown(given)}" if plain else f": {text}"
    path = ".".join(str(part) for part in field)
    return InputError((path + text).removeprefix(": "), where=model.__name__, allowed=allowed, field=field)


def _settings(model: type[BaseModel], path: tuple[str | int, ...]) -> str:
    """The names of all settings in the group at `path`."""
    for part in path:
        field = model.model_fields.get(str(part))
        kinds = (field.annotation, *get_args(field.annotation)) if field else ()
        model = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), model)
    return ", ".join(model.model_fields)


DEVICES = Path(__file__).parent / "devices"
"""A YAML file for each device whose receiver was measured."""


def _read(path: Path) -> dict[str, Any]:
    """The fields of a radar in a YAML file.

    Raises:
        InputError: it is missing, or no group of settings.
    """
    tree, _ = read_yaml(path)
    if not isinstance(tree, dict) or not all(isinstance(key, str) for key in tree):
        raise InputError("not the settings of a radar", where=path, allowed="a YAML file as Receiver.write makes it")
    return tree


_nested: ContextVar[bool] = ContextVar("nested", default=False)


class Spec(BaseModel):
    """A group of settings: unknown names and non-finite numbers are refused, nothing changes after it is made."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="strings")

    def __init__(self, /, **values: Any) -> None:
        outermost = not _nested.get()
        mark = _nested.set(True)
        try:
            super().__init__(**values)
        except ValidationError as error:
            if not outermost:  # the group that holds this one tells the whole path to the field
                raise
            raise refusal(error, type(self)) from None
        finally:
            _nested.reset(mark)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Its name, and the fields that differ from their defaults; pydantic calls this."""
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if name == "name" or field.is_required() or value != field.get_default(call_default_factory=True):
                yield name, value

    def __dir__(self) -> list[str]:
        """Return the names that a prompt completes: pydantic's old ones, as `dict` and `copy`, only warn."""
        old = {name for name in dir(BaseModel) if not name.startswith(("_", "model_"))}
        return [name for name in super().__dir__() if name not in old]

    def but(self, /, **changes: Any) -> Self:
        """A checked copy with some fields changed."""
        return type(self)(**{name: getattr(self, name) for name in type(self).model_fields} | changes)


Vector = tuple[float, float, float]


class MountSpec(Spec):
    """Where a sensor sits on the body (FLU): translation [m], then fixed-axis roll, pitch, yaw [deg]."""

    position_m: Vector = (0.0, 0.0, 0.0)
    roll_deg: float = 0.0
    pitch_deg: float = Field(0.0, description="positive looks down")
    yaw_deg: float = Field(0.0, description="positive looks to the left")
    position_sigma_m: float = Field(0.001, ge=0, le=1, description="one sigma of each coordinate of the position")
    angle_sigma_deg: float = Field(1.0, ge=0, le=90, description="one sigma of the direction of the boresight")

    def body_from_sensor(self) -> NDArray[np.float64]:
        """The (4, 4) transform from sensor to body."""
        return _mounted(self.position_m, (self.roll_deg, self.pitch_deg, self.yaw_deg)).copy()


@lru_cache(maxsize=256)  # live radars ask for it with every frame
def _mounted(position_m: Vector, rpy_deg: Vector) -> NDArray[np.float64]:
    return transform(position_m, np.radians(rpy_deg))


class AntennaSpec(Spec):
    """One-way antenna pattern, the same for transmit and receive, and the polarisation of each."""

    kind: Literal["isotropic", "x4a02", "cosine", "table"] = "x4a02"
    gain_dbi: float | None = Field(
        None, ge=-30, le=60, description="peak gain; None takes the kind's own (0 isotropic, 5.97 x4a02)"
    )
    azimuth_deg: float = Field(65.0, gt=0, le=360, description="-3 dB opening in azimuth (cosine)")
    elevation_deg: float = Field(65.0, gt=0, le=360, description="-3 dB opening in elevation (cosine)")
    file: str | None = Field(
        None,
        description="table: CSV with azimuth_deg, elevation_deg, gain_dbi; cuts of MSI Planet, .msi or .pln; "
        "or a far field of CST, .ffs, with phase and polarisation, at all frequencies in the radar's band",
    )
    frequency_hz: float | None = Field(
        None,
        gt=0,
        description="of a far field's gain for processing; a radar puts its center_hz here; None: the middle one",
    )
    polarization: Literal["vertical", "horizontal"] = Field(
        "vertical",
        description="electric field along sensor z or y; a far field as it is, or rolled with its z to the left",
    )
    receive_polarization: Literal["vertical", "horizontal"] | None = Field(
        None, description="the same for the receiver; None: as transmitted"
    )


class DirectPathSpec(Spec):
    """The instrument's own response over range: direct path and ring-down, as `ul.Receiver.fit` measures it.

    The complex envelope of the samples as they are recorded, in the sensor's normalised units.
    """

    range_start_m: float = Field(0.0, ge=-5, le=1000, description="range of the first value")
    step_m: float = Field(gt=0, le=1, description="range between values")
    in_phase: tuple[float, ...] = Field(min_length=4, max_length=4096)
    quadrature: tuple[float, ...] = Field(min_length=4, max_length=4096)

    @model_validator(mode="after")
    def _pairs(self) -> Self:
        if len(self.in_phase) != len(self.quadrature):
            raise ValueError(f"{len(self.in_phase)} in_phase and {len(self.quadrature)} quadrature values")
        return self


class NoiseSpec(Spec):
    """What the receiver adds to the echoes; the values are those measured on the X4 recordings [X4Recordings]."""

    thermal: float = Field(
        1.16e-3, ge=0, description="sigma of one RF sample at one count, in the sensor's normalised units"
    )
    unit_gain: float = Field(
        5.0, gt=0, description="normalised RF units per unit of sqrt(path gain); estimated, good to about 6 dB"
    )
    baseband_gain: float = Field(0.78, gt=0, le=10, description="baseband amplitude per RF envelope")
    leakage: bool = Field(True, description="the direct path from transmitter to receiver")
    phase_rad: float = Field(
        0.010,
        ge=0,
        description="sigma of the phase common to a whole frame: the part that integration leaves; devices "
        "measured have 0 to 17 mrad, see the presets x4-2019, x4m300-2017, pulson440, pulson440-flight",
    )
    phase_thermal_rad: float = Field(
        0.0314, ge=0, description="the same at one count: the part that falls with the root of the counts"
    )
    amplitude: float = Field(0.001, ge=0, description="sigma of the relative amplitude common to a whole frame")
    direct_path: DirectPathSpec | None = Field(
        None,
        description="of Receiver.fit: {range_start_m, step_m, in_phase: [..], quadrature: [..]}; none: the X4's",
    )
    clip: bool = Field(True, description="the DAC window limits strong echoes")
    lattice: bool = Field(True, description="values lie on the lattice of the counts")


class ThesisSpec(Spec):
    """The 2018 ray model [Billdal2018, ch. 4]: fan of rays, cosine law, histogram, noise, moving average."""

    rays_per_side: int = Field(30, ge=2, le=4096, description="n of the n x n fan; 58 gives 0.2 m at 10 m (eq. 4.5)")
    fov_deg: float = Field(65.0, gt=0, le=360, description="opening of the fan; at 360 it is a ring")
    rays_up: int | None = Field(None, ge=2, le=1000, description="rays one above the other; none: rays_per_side")
    elevation_deg: float | None = Field(None, gt=0, lt=180, description="opening upright; none: fov_deg")
    ring_rays: int | None = Field(
        None, ge=4, le=4096, description="rays of a full circle that the fan is cut from (fig. 4.6); none: own fan"
    )
    ring_start_deg: float = Field(-180.0, description="azimuth of the circle's first ray in the sensor's frame")
    max_range_m: float = Field(
        10.0, gt=0, le=1000, description="R_max; the ray model's range axis reaches at least this far"
    )
    min_range_m: float = Field(0.2, ge=0)
    noise_sigma: float = Field(0.002, ge=0, description="white noise on each range bin")
    smoothing_bins: int = Field(
        3, ge=1, description="width of the moving average; 3 bins are the width of the X4's pulse"
    )
    threshold: float = Field(0.038, gt=0, description="first peak above this is an object")

    @model_validator(mode="after")
    def _fan_can_be(self) -> Self:
        if self.elevation_deg is None and self.fov_deg >= 180:
            raise ValueError(f"fov_deg {self.fov_deg:g} needs an elevation_deg below 180")
        if self.ring_rays is not None and self.ring_rays * self.fov_deg < 2 * 360:
            raise ValueError(f"ring_rays {self.ring_rays} leaves fewer than two rays in {self.fov_deg:g} deg")
        return self


_X4_NAMES = {
    "downconversion": ("output",),
    "frame_area_offset": ("frame_area_offset_m",),
    "frame_area": ("range_start_m", "bins"),
}


def _over(known: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Known fields and changes, where a change by the X4's name takes the place of our fields."""
    gone = {ours for theirs in changes for ours in _X4_NAMES.get(theirs, ())}
    if "downconversion" in changes and "frame_area" not in changes:
        gone.add("bins")  # the X4's whole frame, as it is in this kind of output
    return {name: value for name, value in known.items() if name not in gone} | changes


def _of_the_x4(values: dict[str, Any]) -> dict[str, Any]:
    """Settings as the X4's driver names them [NoveldaX4Driver], converted to ours."""
    out = dict(values)
    both = [(theirs, name) for theirs in out for name in _X4_NAMES.get(theirs, ()) if name in out]
    if both:
        raise ValueError(f"{both[0][0]} and {both[0][1]} set the same thing: give one of them")
    if "downconversion" in out:
        out["output"] = "baseband" if out.pop("downconversion") else "rf"
        if out["output"] == "rf" and "frame_area" not in out:
            out.setdefault("bins", 1536)
    if "frame_area_offset" in out:
        out["frame_area_offset_m"] = out.pop("frame_area_offset")
    if "frame_area" in out:
        out |= _frame_area(out.pop("frame_area"), out)
    return out


def _frame_area(area: Any, values: dict[str, Any]) -> dict[str, Any]:
    """First range and number of bins of a frame from start to end [m]."""
    try:
        start, end = (float(edge) for edge in area)
        rate, decimation = (
            float(values.get(name, RadarSpec.model_fields[name].default)) for name in ("sampling_hz", "decimation")
        )
        step = C0 / 2 * (1 if values.get("output") == "rf" else decimation) / rate
        return {"range_start_m": start, "bins": math.floor((end - start) / step + 1e-9) + 1}
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise ValueError(f"frame_area is {shown(area)} (allowed: two ranges, start and end [m])") from None


class RadarSpec(Spec):
    """One radar: waveform, sampling, antenna, receiver settings under the names X4 users know, noise and mount.

    The X4 driver's own names are taken as well: `frame_area=(start, end)` [m] sets `range_start_m` and `bins`,
    `frame_area_offset` [m] sets `frame_area_offset_m`, `downconversion` 1 or 0 an `output` of baseband or rf.
    Lengths on the range axis use the vacuum speed of light, 299792458 m/s; the X4 driver labels its bins with 3e8.
    """

    name: str = "x4m05"
    center_hz: float = Field(7.29e9, gt=1e8, le=1e11)
    bandwidth_hz: float = Field(1.4e9, gt=1e6, le=2e10, description="-10 dB width of the pulse spectrum")
    pulse: Literal["gaussian", "raised-cosine"] = Field(
        "gaussian", description="envelope; raised-cosine at 1.46e9 Hz has all three widths of recorded X4 pulses"
    )
    sampling_hz: float = Field(23.328e9, gt=1e8, le=1e12, description="RF sampling rate")
    decimation: int = Field(8, ge=1, le=64, description="RF samples per baseband bin")
    output: Literal["baseband", "rf"] = "baseband"
    range_start_m: float = Field(0.0, ge=-1, le=1000, description="range of bin 0 (X4: frame_area start)")
    bins: int = Field(188, ge=8, le=65536)
    frame_area_offset_m: float = Field(
        0.0, ge=-5, le=5, description="zero offset of the hardware, already taken off range_start_m"
    )
    range_zero_m: float | None = Field(
        None, ge=-5, le=5, description="of recordings: what cables and antennas add to every range, if once measured"
    )
    own_echo_m: float = Field(
        0.45, ge=0, le=100, description="range up to which the direct path and the ring-down of the instrument last"
    )
    range_zero_sigma_m: float = Field(0.02, gt=0, le=5, description="one sigma of range_zero_m")
    antenna: AntennaSpec = AntennaSpec()
    antenna_offset_m: float = Field(0.0, ge=0, le=2, description="distance between Tx and Rx along sensor y")
    fps: float = Field(17.0, gt=0, le=10000)
    iterations: int = Field(64, ge=1, le=255)
    pulses_per_step: int = Field(87, ge=1, le=65535)
    dac_min: int = Field(949, ge=0, le=2047)
    dac_max: int = Field(1100, ge=0, le=2047)
    dac_step: int = Field(0, ge=0, le=3)
    prf_div: int = Field(16, ge=4, le=MOST_DIV, description="pulse repetition frequency = 243 MHz / prf_div")
    stagger_div: int | None = Field(
        None,
        ge=4,
        le=MOST_DIV,
        description="prf_div of every second frame: folded echoes then change place; none: prf_div",
    )
    duty: float = Field(0.95, gt=0, le=1)
    integration_s: float = Field(
        0.0, ge=0, le=1, description="time about its stamp over which a simulated frame is averaged, in motion; 0: an "
        "instant; an X4 takes its sweeps_s"
    )  # fmt: skip
    noise: NoiseSpec | None = NoiseSpec()
    mount: MountSpec = MountSpec()
    thesis: ThesisSpec = ThesisSpec()

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "x4m05": {},
        "x4m05-8ghz": {"name": "x4m05-8ghz", "center_hz": 8.748e9, "bandwidth_hz": 1.5e9},
        "x4m300": {"name": "x4m300", "frame_area_offset_m": 0.18},
        "a121": {  # profile 3, a bin of 24 steps of 2.5 mm [AcconeerET]
            "name": "a121", "center_hz": 60.5e9, "bandwidth_hz": 1.218e9, "sampling_hz": 19.986e9, "bins": 80,
            "range_start_m": 0.2, "fps": 20.0, "iterations": 1, "pulses_per_step": 32, "own_echo_m": 0.0, "noise": None,
        },
    }  # fmt: skip

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of the presets: those of data sheets, then the devices that were measured."""
        return (*cls.presets, *sorted(file.stem for file in DEVICES.glob("*.yaml")))

    @classmethod
    def preset(cls, name: str, /, **changes: Any) -> RadarSpec:
        """A known radar, with some fields changed: `preset("x4m05", noise=None)`.

        Args:
            name: one of `names()`, or a YAML file as `Receiver.write` makes it.
            **changes: fields, by name.

        Raises:
            InputError: the name or a field is unknown, or a value is out of bounds.
        """
        if name in cls.presets:
            return cls(**_over(cls.presets[name], changes))
        if name.endswith((".yaml", ".yml")):
            return cls(**_over(_read(Path(name)), changes))
        if name not in cls.names():
            raise InputError(f"no radar preset {name!r}", where="preset",
                             allowed=f"{', '.join(cls.names())}, or a YAML file")  # fmt: skip
        return cls(**_over(_read(DEVICES / f"{name}.yaml"), changes))

    def but(self, /, **changes: Any) -> Self:
        """A checked copy with some fields changed."""
        return type(self)(**_over({name: getattr(self, name) for name in type(self).model_fields}, changes))

    def staggered(self) -> Self:
        """The radar with two pulse intervals in turn, the second about a sixteenth longer."""
        if self.stagger_div is not None:
            return self
        longer = self.prf_div + max(self.prf_div // 16, 1)
        return self.but(stagger_div=longer if longer <= MOST_DIV else self.prf_div - self.prf_div // 16)

    def on_axis(self, range_m: NDArray[np.float64], t_ns: NDArray[np.int64], **changes: Any) -> Self:
        """A checked copy with the range axis and the frame rate of a recording.

        Args:
            range_m: of each bin (b), evenly spaced [m].
            t_ns: of each frame (n) [ns].
            **changes: further fields; `output` is "rf" or "baseband".

        Raises:
            InputError: a value is out of bounds.
        """
        bin_m = float(range_m[-1] - range_m[0]) / (len(range_m) - 1)
        decimation = 1 if changes.get("output", self.output) == "rf" else self.decimation
        step = np.diff(t_ns)
        fps = 1e9 / float(np.median(step[step > 0])) if (step > 0).any() else self.fps
        axis = {"decimation": decimation, "sampling_hz": decimation * C0 / (2 * bin_m), "bins": len(range_m),
                "range_start_m": float(range_m[0]), "fps": fps}  # fmt: skip
        return self.but(**axis | changes)

    @model_validator(mode="before")
    @classmethod
    def _names_of_the_x4(cls, values: Any) -> Any:
        return _of_the_x4(values) if isinstance(values, dict) else values

    @field_validator("antenna", mode="before")
    @classmethod
    def _antenna_kind(cls, value: Any) -> Any:
        return {"kind": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.dac_max <= self.dac_min:
            raise ValueError(f"dac_max {self.dac_max} must be above dac_min {self.dac_min}")
        if self.output == "baseband" and self.bandwidth_hz > 1.2 * self.sampling_hz / self.decimation:
            rate = self.sampling_hz / self.decimation
            raise ValueError(f"bandwidth_hz {self.bandwidth_hz:g} does not fit the baseband rate {rate:g} Hz")
        if self.antenna.kind == "table":
            object.__setattr__(self, "antenna", self.antenna.but(frequency_hz=self.center_hz))
        return self

    @property
    def step_s(self) -> float:
        """Time between output bins [s]."""
        return (self.decimation if self.output == "baseband" else 1) / self.sampling_hz

    @property
    def bin_m(self) -> float:
        """Range between output bins [m]."""
        return C0 / 2 * self.step_s

    @property
    def range_m(self) -> NDArray[np.float64]:
        """Range of each bin (b) [m]."""
        return np.asarray(self.range_start_m + self.bin_m * np.arange(self.bins), np.float64)

    @property
    def wavelength_m(self) -> float:
        """Wavelength at the centre frequency [m]."""
        return C0 / self.center_hz

    @property
    def prf_hz(self) -> float:
        """Pulse repetition frequency [Hz]."""
        return 243e6 / self.prf_div

    @property
    def unambiguous_range_m(self) -> float:
        """Echoes from beyond this range fold back into the frame [m]."""
        return C0 / 2 / self.prf_hz

    @property
    def counts(self) -> int:
        """N = iterations x pulses_per_step, the number of one-bit samples summed into each DAC step."""
        return self.iterations * self.pulses_per_step

    @property
    def max_fps(self) -> float:
        """Highest frame rate these settings allow [Hz] [NoveldaXTAN13]."""
        return self.duty / self.sweeps_s

    @property
    def sweeps_s(self) -> float:
        """Time in which an X4 sums the pulses of all DAC steps of a frame [s] [NoveldaXTAN13]."""
        return self.counts * (self.dac_max - self.dac_min + 1) / self.prf_hz

    @property
    def pulse_sigma_s(self) -> float:
        """Standard deviation of the Gaussian pulse envelope [s]: its spectrum is down 10 dB at +-bandwidth_hz / 2."""
        return math.sqrt(math.log(10)) / (math.pi * self.bandwidth_hz)


def _ring(count: int, first_names: tuple[str, ...], radius_m: float) -> dict[str, MountSpec]:
    angles = [360.0 * i / count for i in range(count)]
    return {
        name: MountSpec(
            position_m=(radius_m * math.cos(math.radians(a)), radius_m * math.sin(math.radians(a)), 0.0),
            yaw_deg=a if a <= 180 else a - 360,
        )
        for name, a in zip(first_names, angles, strict=True)
    }


class RotorSpec(Spec):
    """A propeller of flat blades that turns evenly about the body's z axis."""

    position_m: Vector = Field(description="of the hub on the body (FLU)")
    radius_m: float = Field(0.127, gt=0, le=5)
    chord_m: float = Field(0.02, gt=0, le=1, description="width of a blade")
    pitch_deg: float = Field(15.0, ge=0, le=90, description="angle of the blades to the plane in which they turn")
    blades: int = Field(2, ge=1, le=12)
    rate_hz: float = Field(ge=-1000, le=1000, description="turns a second, above zero to the left seen from above")
    yaw_deg: float = Field(0.0, description="direction of the first blade at the time 0")
    material: str = Field("metal", description="carbon fibre echoes as metal; plastic is 3 mm thick")


class BoxSpec(Spec):
    """A box on the body that hides what is behind it and has no echo of its own."""

    position_m: Vector = Field(description="of its centre on the body (FLU)")
    size_m: Vector = Field(description="edges along x, y, z before the turn")
    yaw_deg: float = 0.0

    @field_validator("size_m")
    @classmethod
    def _has_size(cls, value: Vector) -> Vector:
        if min(value) <= 0:
            raise ValueError("each edge must be above zero")
        return value

    def holds(self, place_m: Vector) -> bool:
        """Whether a place on the body lies in the box."""
        yaw, (x, y, z) = math.radians(self.yaw_deg), np.subtract(place_m, self.position_m)
        across = (math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x, z)
        return all(abs(gap) <= edge / 2 for gap, edge in zip(across, self.size_m, strict=True))


class BodySpec(Spec):
    """What the radars see of the drone that carries them."""

    rotors: tuple[RotorSpec, ...] = Field((), max_length=32)
    boxes: tuple[BoxSpec, ...] = Field((), max_length=64)


class Rig(Spec):
    """Several radars on one body, by name, and what they see of that body."""

    sensors: dict[str, RadarSpec] = Field(min_length=1)
    body: BodySpec | None = Field(
        None, description="what the radars see of the drone itself, by the physical law; none: nothing"
    )

    presets: ClassVar[tuple[str, ...]] = ("thesis-4", "thesis-4-down", "thesis-ring", "single")

    @classmethod
    def preset(cls, name: str, *, radar: RadarSpec | None = None, **changes: Any) -> Rig:
        """A known mount: "thesis-4" has four radars looking ahead, left, back and right [Billdal2018, fig. 4.6].

        Four 65 deg openings cover 260 deg of the circle between them, not 360. "thesis-4-down" has one more below the
        body that points down. "thesis-ring" has the four radars at one place below the body. The ray model cuts their
        fans from one ring of rays, 360 by 65 deg and as dense as one radar's own fan, as the thesis did in Gazebo.

        Raises:
            InputError: the name is unknown.
        """
        base = (radar or RadarSpec.preset("x4m05")).but(**changes) if changes or radar else RadarSpec.preset("x4m05")
        around, below = _ring(4, ("front", "left", "back", "right"), 0.10), (0.0, 0.0, -0.06)
        mounts = {
            "thesis-4": around,
            "thesis-4-down": around | {"down": MountSpec(position_m=below, pitch_deg=90.0)},
            "thesis-ring": {name: MountSpec(position_m=below, yaw_deg=mount.yaw_deg) for name, mount in around.items()},
            "single": {"front": MountSpec()},
        }
        if name not in mounts:
            raise InputError(f"no rig preset {name!r}", where="preset", allowed=", ".join(cls.presets))
        rig = cls(sensors={key: base.but(mount=mount) for key, mount in mounts[name].items()})
        return rig if name != "thesis-ring" else rig.cut_from_ring()

    def cut_from_ring(self, rays: int | None = None) -> Rig:
        """The rig whose ray models share one ring of rays about the body's upright axis [Billdal2018, fig. 4.6].

        Each radar's fan is the section of the ring about its own heading. The ring's first ray points back.

        Args:
            rays: of the ring; None: those that each radar's settings name, else as dense as its own fan.
        """
        return self.but(sensors={name: _section(spec, rays) for name, spec in self.sensors.items()})

    @model_validator(mode="after")
    def _radars_are_outside(self) -> Self:
        for name, spec in self.sensors.items():
            for k, box in enumerate(self.body.boxes if self.body else ()):
                if box.holds(spec.mount.position_m):
                    raise ValueError(f"radar {name!r} lies in box {k} of the body (allowed: outside)")
        return self


def _section(spec: RadarSpec, rays: int | None) -> RadarSpec:
    fan = spec.thesis
    dense = math.ceil(360 * (fan.rays_per_side - 1) / fan.fov_deg)
    ring = fan.but(ring_rays=rays or fan.ring_rays or dense, ring_start_deg=-180.0 - spec.mount.yaw_deg)
    return spec.but(thesis=ring)


class ImuSpec(Spec):
    """A MEMS inertial unit: by default the BMI088 of many flight controllers [BMI088].

    The data sheet gives the densities and the offset of the gyroscopes. It gives 20 mg for the accelerometers, of which
    the calibration in six positions that autopilots ask for leaves the drift with temperature: 0.2 mg/K over 25 K. It
    gives no random walk: that of the gyroscopes changes them by 2 deg/h in 100 s, that of the accelerometers by 1 mg in
    1000 s. Densities count as two-sided, sigma being density times sqrt(rate): 3 dB more than one-sided ones.
    """

    rate_hz: float = Field(200.0, gt=1, le=10_000, description="readings a second")
    gyro_noise_deg_s: float = Field(0.014, ge=0, le=10, description="density of the turn rate [deg/s/sqrt(Hz)]")
    accel_noise_ug: float = Field(190.0, ge=0, le=1e5, description="density of the specific force [ug/sqrt(Hz)]")
    gyro_bias_deg_s: float = Field(1.0, ge=0, le=100, description="offset of each turn rate, one sigma")
    accel_bias_mg: float = Field(5.0, ge=0, le=1000, description="offset of each specific force, one sigma")
    gyro_walk_deg_s: float = Field(5.6e-5, ge=0, le=1, description="random walk of that offset [deg/s/sqrt(s)]")
    accel_walk_ug: float = Field(32.0, ge=0, le=1e5, description="random walk of that offset [ug/sqrt(s)]")

    @property
    def gyro_noise(self) -> float:
        """Density of the turn rate [rad/s/sqrt(Hz)]."""
        return math.radians(self.gyro_noise_deg_s)

    @property
    def accel_noise(self) -> float:
        """Density of the specific force [m/s2/sqrt(Hz)]."""
        return self.accel_noise_ug * 1e-6 * GRAVITY_M_S2

    @property
    def sigma(self) -> tuple[float, float]:
        """One sigma of the white noise of turn rate [rad/s] and specific force [m/s2]."""
        return self.gyro_noise * math.sqrt(self.rate_hz), self.accel_noise * math.sqrt(self.rate_hz)

    @property
    def bias(self) -> tuple[float, float]:
        """One sigma of the offsets of turn rate [rad/s] and specific force [m/s2]."""
        return math.radians(self.gyro_bias_deg_s), self.accel_bias_mg * 1e-3 * GRAVITY_M_S2

    @property
    def walk(self) -> tuple[float, float]:
        """Random walk of the offsets of turn rate [rad/s/sqrt(s)] and specific force [m/s2/sqrt(s)]."""
        return math.radians(self.gyro_walk_deg_s), self.accel_walk_ug * 1e-6 * GRAVITY_M_S2
