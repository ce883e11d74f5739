"""Materials of surfaces: permittivity over frequency, thickness, roughness, and the thesis' reflection."""

from __future__ import annotations

import math
import re
from typing import Literal

import numpy as np
from pydantic import Field, field_validator

from ullage.errors import InputError
from ullage.specs import Spec

EPS0 = 8.8541878128e-12
"""Permittivity of vacuum [F/m]."""


class Material(Spec):
    """A homogeneous material after ITU-R P.2040 [ITU-R-P2040]: eps' = a f^b, sigma = c f^d [S/m], f in GHz."""

    name: str
    conductor: bool = Field(False, description="perfect conductor: reflects everything, a to d unused")
    model: Literal["itu", "water", "skin", "muscle"] = Field("itu", description="all but itu leave a to d unused")
    a: float = Field(1.0, ge=1, le=200)
    b: float = 0.0
    c: float = Field(0.0, ge=0)
    d: float = 0.0
    valid_ghz: tuple[float, float] = (0.0, 1000.0)
    celsius: float = Field(20.0, ge=-2, le=40, description="temperature of water, or of drops")
    salinity: float = Field(0.0, ge=0, le=40, description="of water or drops [g/kg]")
    water_share: float = Field(0.0, ge=0, le=0.7, description="volume of water in it, as fine drops")
    layers: tuple[tuple[str, float], ...] = Field(
        (), max_length=8, description="coating on every face: material and thickness [m], the outermost first"
    )
    thickness_m: float | None = Field(None, gt=0, description="slab thickness; None: thick, nothing comes through")
    roughness_m: float = Field(0.0, ge=0, le=0.1, description="rms height")
    correlation_m: float | None = Field(
        None, gt=0, le=10, description="length over which heights are alike; None: ten times the height"
    )
    reflection: float = Field(1.0, ge=0, description="I_m of the thesis model (laser_retro)")
    source: str = ""

    @field_validator("layers")
    @classmethod
    def _known(cls, layers: tuple[tuple[str, float], ...]) -> tuple[tuple[str, float], ...]:
        for name, thickness_m in layers:
            if material(name).conductor or not thickness_m > 0:
                raise ValueError(f"no layer can be {thickness_m:g} m of {name}")
        return layers

    @property
    def coating(self) -> list[tuple[Material, float]]:
        """Materials and thicknesses [m] of the layers."""
        return [(material(name), thickness_m) for name, thickness_m in self.layers]

    @property
    def correlation(self) -> float:
        """Correlation length of the roughness [m]."""
        return 10 * self.roughness_m if self.correlation_m is None else self.correlation_m

    def permittivity(self, frequency_hz: float) -> complex:
        """Relative permittivity, eps' - j eps'' (time e^{+jwt}).

        Raises:
            InputError: the frequency lies outside the data's range, or the material is a perfect conductor.
        """
        ghz = frequency_hz / 1e9
        low, high = self.valid_ghz
        if self.conductor:
            raise InputError(f"{self.name} is a perfect conductor: it has no permittivity", where="material")
        if not low <= ghz <= high:
            raise InputError(f"{self.name} has no data at {ghz:g} GHz", where="material",
                             allowed=f"{low:g} to {high:g} GHz")  # fmt: skip
        if self.model == "water":
            return _water(frequency_hz, self.celsius, self.salinity)
        if self.model != "itu":
            return _cole_cole(self.model, frequency_hz)
        own = complex(self.a * ghz**self.b, -self.c * ghz**self.d / (2 * math.pi * frequency_hz * EPS0))
        if not self.water_share:
            return own
        return _with_drops(own, _water(frequency_hz, self.celsius, self.salinity), self.water_share)


_ITU = "ITU-R P.2040-3, table 3 [ITU-R-P2040]"

MATERIALS: dict[str, Material] = {
    m.name: m
    for m in (
        Material(name="pec", conductor=True, source="ideal conductor"),
        Material(name="steel", conductor=True, source="ideal conductor: 1e6 S/m and more lose under 0.01 dB"),
        Material(name="aluminium", conductor=True, source="ideal conductor, as steel"),
        Material(name="metal", conductor=True, source="ideal conductor, as steel"),
        Material(name="concrete", a=5.24, c=0.0462, d=0.7822, valid_ghz=(1, 100), thickness_m=0.2, reflection=0.5,
                 source=_ITU),
        Material(name="brick", a=3.91, c=0.0238, d=0.16, valid_ghz=(1, 40), thickness_m=0.1, reflection=0.4,
                 source=_ITU),
        Material(name="plasterboard", a=2.73, c=0.0085, d=0.9395, valid_ghz=(1, 100), thickness_m=0.0125,
                 reflection=0.3, source=_ITU),
        Material(name="wood", a=1.99, c=0.0047, d=1.0718, valid_ghz=(0.001, 100), thickness_m=0.02, reflection=0.3,
                 source=_ITU),
        Material(name="glass", a=6.31, c=0.0036, d=1.3394, valid_ghz=(0.1, 100), thickness_m=0.006, reflection=0.5,
                 source=_ITU),
        Material(name="ceiling-board", a=1.48, c=0.0011, d=1.075, valid_ghz=(1, 100), thickness_m=0.015,
                 reflection=0.2, source=_ITU),
        Material(name="chipboard", a=2.58, c=0.0217, d=0.78, valid_ghz=(1, 100), thickness_m=0.018, reflection=0.3,
                 source=_ITU),
        Material(name="plywood", a=2.71, c=0.33, valid_ghz=(1, 40), thickness_m=0.015, reflection=0.3, source=_ITU),
        Material(name="marble", a=7.074, c=0.0055, d=0.9262, valid_ghz=(1, 60), thickness_m=0.02, reflection=0.5,
                 source=_ITU),
        Material(name="floorboard", a=3.66, c=0.0044, d=1.3515, valid_ghz=(50, 100), thickness_m=0.02,
                 reflection=0.3, source=_ITU),
        Material(name="very-dry-ground", a=3.0, c=0.00015, d=2.52, valid_ghz=(1, 10), reflection=0.3, source=_ITU),
        Material(name="medium-dry-ground", a=15.0, b=-0.1, c=0.035, d=1.63, valid_ghz=(1, 10), reflection=0.5,
                 source=_ITU),
        Material(name="wet-ground", a=30.0, b=-0.4, c=0.15, d=1.3, valid_ghz=(1, 10), reflection=0.7, source=_ITU),
        Material(name="plastic", a=2.84, c=8.7e-4, d=1.0, valid_ghz=(1, 25), thickness_m=0.003, reflection=0.2,
                 source="rigid PVC, 3 GHz value taken as flat, tan d 0.0055 [VonHippel1954]"),
        Material(name="polyethylene", a=2.25, c=4.5e-5, d=1.0, valid_ghz=(1, 25), thickness_m=0.003, reflection=0.2,
                 source="10 GHz value taken as flat, tan d 0.00036 [VonHippel1954]"),
        Material(name="rubber", a=6.0, c=0.033, d=1.0, valid_ghz=(1, 20), reflection=0.2,
                 source="carbon-filled rubber, typical value without a single source; tan d 0.1"),
        Material(name="water", model="water", valid_ghz=(0.1, 1000), reflection=0.8,
                 source="pure water at 20 C, double Debye of ITU-R P.527-6 [ITU-R-P527]"),
        Material(name="sea-water", model="water", salinity=35.0, valid_ghz=(0.1, 1000), reflection=0.8,
                 source="sea water at 20 C, double Debye of ITU-R P.527-6 [ITU-R-P527]"),
        Material(name="oil", a=2.18, c=3.4e-4, d=1.0, valid_ghz=(1, 25), reflection=0.2,
                 source="transformer oil, 3 GHz value taken as flat, tan d 0.0028 [VonHippel1954]"),
        Material(name="sludge", a=2.18, c=3.4e-4, d=1.0, water_share=0.4, valid_ghz=(1, 25), reflection=0.4,
                 source="oil as above with 40 % of water in fine drops [Bruggeman1935]; real contents differ widely"),
        Material(name="skin", model="skin", valid_ghz=(0.01, 100), reflection=0.7,
                 source="dry skin, four-term Cole-Cole [Gabriel1996]"),
        Material(name="muscle", model="muscle", valid_ghz=(0.01, 100), reflection=0.7,
                 source="muscle, four-term Cole-Cole [Gabriel1996]"),
        Material(name="human", model="skin", valid_ghz=(0.01, 100), reflection=0.7,
                 source="as dry skin, which holds the wave at 7 GHz within 4 mm [Gabriel1996]"),
    )
}  # fmt: skip

_COLE: dict[str, tuple[float, float, tuple[tuple[float, float, float], ...]]] = {
    # high-frequency permittivity, conductivity [S/m], then (step, relaxation time [s], spread) of each term
    "skin": (4.0, 2e-4, ((32.0, 7.234e-12, 0.0), (1100.0, 32.481e-9, 0.2))),
    "muscle": (4.0, 0.2, ((50.0, 7.234e-12, 0.1), (7000.0, 353.678e-9, 0.1), (1.2e6, 318.31e-6, 0.1),
                          (2.5e7, 2.274e-3, 0.0))),
}  # fmt: skip


def _cole_cole(tissue: str, frequency_hz: float) -> complex:
    high, conductivity, terms = _COLE[tissue]
    jw = 2j * math.pi * frequency_hz
    return complex(high + sum(d / (1 + (jw * t) ** (1 - a)) for d, t, a in terms) + conductivity / (jw * EPS0))


def _water(frequency_hz: float, t: float, s: float) -> complex:
    """Permittivity of water of `t` deg C with `s` g/kg of sea salt [ITU-R-P527]."""
    ghz, theta = frequency_hz / 1e9, 300 / (t + 273.15) - 1
    static, slow = 77.66 + 103.3 * theta, 20.20 - 146.4 * theta + 316 * theta**2
    middle, fast, high = 0.0671 * static, 39.8 * slow, 3.52 - 7.52 * theta
    static *= math.exp(s * (-3.56417e-3 + 4.74868e-6 * s + 1.15574e-5 * t))
    slow *= 1 + s * (2.39357e-3 - 3.13530e-5 * t + 2.52477e-7 * t**2)
    middle *= math.exp(s * (-6.28908e-3 + 1.76032e-4 * s - 9.22144e-5 * t))
    fast *= 1 + s * (-1.99723e-2 + 1.81176e-4 * t)
    high *= 1 + s * (-2.04265e-3 + 1.57883e-4 * t)
    relaxed = (static - middle) / (1 + 1j * ghz / slow) + (middle - high) / (1 + 1j * ghz / fast) + high
    return complex(relaxed - 1j * _conductivity(t, s) / (2 * math.pi * frequency_hz * EPS0))


def _with_drops(around: complex, drops: complex, share: float) -> complex:
    """Permittivity of an emulsion of small drops in a liquid [Bruggeman1935].

    With u^3 the permittivity over that around the drops, 1 - share = (d - u^3) / ((d - 1) u), d that of the drops.
    """
    ratio = drops / around
    roots = np.roots([1.0, 0.0, (1 - share) * (ratio - 1), -ratio])
    return complex(around * roots[roots.real.argmax()] ** 3)  # the other two have real parts below zero


def _conductivity(t: float, s: float) -> float:
    """Conductivity of sea water [S/m] [ITU-R-P527]."""
    at_35 = 2.903602 + t * (8.607e-2 + t * (4.738817e-4 + t * (-2.991e-6 + t * 4.3047e-9)))
    at_15_c = s * (37.5109 + 5.45216 * s + 1.4409e-2 * s**2) / (1004.75 + 182.283 * s + s**2)
    warmer = (6.9431 + 3.2841 * s - 9.9486e-2 * s**2) / (84.850 + 69.024 * s + s**2)
    return at_35 * at_15_c * (1 + warmer * (t - 15) / (49.843 - 0.2276 * s + 0.198e-2 * s**2 + t))


def material(name: str) -> Material:
    """Return a material by name; `Concrete`, `itu_concrete` and `ceiling_board` are names too.

    Raises:
        InputError: the name is unknown.
    """
    key = re.sub(r"[\s_-]+", "-", name.strip().lower()).removeprefix("itu-")
    if key not in MATERIALS:
        raise InputError(f"no material {name!r}", where="material", allowed=", ".join(MATERIALS))
    return MATERIALS[key]
