"""Materials of surfaces: permittivity over frequency, thickness, roughness, and the thesis' reflection."""

from __future__ import annotations

import math
import re
from typing import Literal

from pydantic import Field

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
    thickness_m: float | None = Field(None, gt=0, description="slab thickness; None: thick, nothing comes through")
    roughness_m: float = Field(0.0, ge=0, le=0.1, description="rms height")
    correlation_m: float | None = Field(
        None, gt=0, le=10, description="length over which heights are alike; None: ten times the height"
    )
    reflection: float = Field(1.0, ge=0, description="I_m of the thesis model (laser_retro)")
    source: str = ""

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
            return _water(frequency_hz)
        if self.model != "itu":
            return _cole_cole(self.model, frequency_hz)
        return complex(self.a * ghz**self.b, -self.c * ghz**self.d / (2 * math.pi * frequency_hz * EPS0))


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


def _water(frequency_hz: float, celsius: float = 20.0) -> complex:
    ghz, theta = frequency_hz / 1e9, 300 / (celsius + 273.15) - 1
    static, middle, high = 77.66 + 103.3 * theta, 0.0671 * (77.66 + 103.3 * theta), 3.52 - 7.52 * theta
    slow = 20.20 - 146.4 * theta + 316 * theta**2
    return complex((static - middle) / (1 + 1j * ghz / slow) + (middle - high) / (1 + 1j * ghz / (39.8 * slow)) + high)


def material(name: str) -> Material:
    """Return a material by name; `Concrete`, `itu_concrete` and `ceiling_board` are names too.

    Raises:
        InputError: the name is unknown.
    """
    key = re.sub(r"[\s_-]+", "-", name.strip().lower()).removeprefix("itu-")
    if key not in MATERIALS:
        raise InputError(f"no material {name!r}", where="material", allowed=", ".join(MATERIALS))
    return MATERIALS[key]
