"""What surfaces are made of: permittivity over frequency, thickness, roughness, and the thesis' reflection coefficient."""

from __future__ import annotations

from pydantic import Field

from ullage.errors import InputError
from ullage.specs import Spec


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


MATERIALS: dict[str, Material] = {
    m.name: m
    for m in (
        Material(name="pec", conductor=True, source="ideal"),
        Material(name="steel", conductor=True, source="ideal conductor at 1-10 GHz"),
        Material(name="concrete", a=5.24, c=0.0462, d=0.7822, valid_ghz=(1, 100), thickness_m=0.2, reflection=0.5,
                 source="ITU-R P.2040-3 table 3"),
        Material(name="wood", a=1.99, c=0.0047, d=1.0718, valid_ghz=(0.001, 100), thickness_m=0.02, reflection=0.3,
                 source="ITU-R P.2040-3 table 3"),
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
