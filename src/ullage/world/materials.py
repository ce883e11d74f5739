"""What surfaces are made of: permittivity over frequency, thickness, roughness, and the thesis' reflection."""

from __future__ import annotations

import math

from pydantic import Field

from ullage.errors import InputError
from ullage.specs import Spec

EPS0 = 8.8541878128e-12
"""Permittivity of vacuum [F/m]."""


class Material(Spec):
    """A homogeneous material after ITU-R P.2040 [ITU-R-P2040]: eps' = a f^b, sigma = c f^d [S/m], f in GHz."""

    name: str
    conductor: bool = Field(False, description="perfect conductor: reflects everything, a to d unused")
    a: float = Field(1.0, ge=1, le=200)
    b: float = 0.0
    c: float = Field(0.0, ge=0)
    d: float = 0.0
    valid_ghz: tuple[float, float] = (0.0, 1000.0)
    thickness_m: float | None = Field(None, gt=0, description="slab thickness; None: thick, nothing comes through")
    roughness_m: float = Field(0.0, ge=0, le=0.1, description="rms height")
    reflection: float = Field(1.0, ge=0, description="I_m of the thesis model (laser_retro)")
    source: str = ""

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
        return complex(self.a * ghz**self.b, -self.c * ghz**self.d / (2 * math.pi * frequency_hz * EPS0))


MATERIALS: dict[str, Material] = {
    m.name: m
    for m in (
        Material(name="pec", conductor=True, source="ideal"),
        Material(name="steel", conductor=True, source="ideal conductor at 1-10 GHz"),
        Material(name="concrete", a=5.24, c=0.0462, d=0.7822, valid_ghz=(1, 100), thickness_m=0.2, reflection=0.5,
                 source="ITU-R P.2040-3 table 3"),
        Material(name="wood", a=1.99, c=0.0047, d=1.0718, valid_ghz=(0.001, 100), thickness_m=0.02, reflection=0.3,
                 source="ITU-R P.2040-3 table 3"),
        Material(name="glass", a=6.31, c=0.0036, d=1.3394, valid_ghz=(0.1, 100), thickness_m=0.006, reflection=0.4,
                 source="ITU-R P.2040-3 table 3"),
        Material(name="plastic", a=2.75, c=0.0011, d=1.0, valid_ghz=(0.1, 30), thickness_m=0.004, reflection=0.2,
                 source="rigid PVC, loss tangent 0.007; von Hippel 1954"),
        Material(name="rubber", a=6.0, c=0.033, d=1.0, valid_ghz=(1, 20), reflection=0.2,
                 source="carbon-filled rubber, typical; loss tangent 0.1"),
        Material(name="skin", a=48.8, b=-0.193, c=0.328, d=1.388, valid_ghz=(4, 12), reflection=0.6,
                 source="dry skin, fitted to Gabriel 1996 at 5 and 10 GHz"),
    )
}  # fmt: skip


def material(name: str) -> Material:
    """A material by name.

    Raises:
        InputError: the name is unknown.
    """
    if name not in MATERIALS:
        raise InputError(f"no material {name!r}", where="material", allowed=", ".join(MATERIALS))
    return MATERIALS[name]
