"""Plane layers: Fresnel coefficients, slabs with all inner reflections, and transmission.

Time runs as e^{+jwt}; permittivity is eps' - j eps''. Both polarisations are given for the electric field's tangential
sense, so that at normal incidence TE and TM agree, and a perfect conductor reflects -1 in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Bools, Complexes, Floats
from ullage.geometry import C0
from ullage.specs import RadarSpec
from ullage.world.materials import Material

COSINES = 65
"""Entries of a table over cos(incidence), from 0 to 1."""
TAPS = 3
"""Echoes of a slab that are kept apart: its face, its back, and all later ones together."""
_BROAD = 0.25  # of a slab longer than this part of the pulse, there and back, only the face counts in bounces
_FAINT = 10 ** (-50 / 20)  # inner echoes below this are left out


def fresnel(eps: complex, cosine: ArrayLike) -> tuple[Complexes, Complexes]:
    """Compute the reflection of a half-space in air, TE and TM, against cos(incidence); air itself has none."""
    c = np.asarray(cosine, float)
    inner = np.sqrt(eps - (1 - c * c) + 0j)
    if eps == 1:
        return np.zeros_like(inner), np.zeros_like(inner)
    return (c - inner) / (c + inner), -(eps * c - inner) / (eps * c + inner)


def slab(
    eps: complex, thickness_m: float, frequency_hz: float, cosine: ArrayLike
) -> tuple[Complexes, Complexes, Complexes, Complexes]:
    """Compute reflection and transmission of a slab in air, TE and TM; transmission relative to the path without it.

    All inner reflections are summed [Orfanidis, ch. 8]; the transmitted wave's phase is that of the slab less that of
    the air it replaces.
    """
    c = np.asarray(cosine, float)
    k = 2 * np.pi * frequency_hz / C0
    inner = np.sqrt(eps - (1 - c * c) + 0j)
    once = np.exp(-1j * k * thickness_m * inner)
    free = np.exp(1j * k * thickness_m * c)
    out: list[Complexes] = []
    through: list[Complexes] = []
    for r in fresnel(eps, c):
        loop = 1 - r * r * once * once
        out.append(r * (1 - once * once) / loop)
        through.append((1 - r * r) * once * free / loop)
    return out[0], out[1], through[0], through[1]


@lru_cache(maxsize=512)
def _tables(material: Material, center_hz: float, bandwidth_hz: float) -> tuple[Complexes, Floats, Complexes]:
    """Compute a surface's echoes (TAPS, 2, COSINES), delays (TAPS, COSINES) [s] and reflection (1, 2, COSINES).

    Unused taps have delay -1.
    """
    c = np.linspace(0, 1, COSINES)
    gamma = np.zeros((TAPS, 2, COSINES), complex)
    lag = np.full((TAPS, COSINES), -1.0)
    lag[0] = 0.0
    if material.conductor:
        gamma[0] = -1.0
        bounce = gamma[:1]
    else:
        bounce = _fill_dielectric(material, center_hz, bandwidth_hz, c, gamma, lag)
    if material.roughness_m:
        wave = 2 * np.pi * center_hz / C0
        share = coherent(wave * material.roughness_m, c)
        gamma, bounce = gamma * share, bounce * share
    return gamma, lag, bounce


def _fill_dielectric(
    material: Material, center_hz: float, bandwidth_hz: float, c: Floats, gamma: Complexes, lag: Floats
) -> Complexes:
    """Fill the echoes of a half-space or slab and their delays; give what bounces (1, 2, c).

    With r of the face and one round trip P = exp(-2jkd sqrt(eps - sin^2)), a slab reflects
    r (1 - P) / (1 - r^2 P) = r - (1 - r^2) (r P + r^3 P^2 + ...) [Orfanidis, sec. 5.4]. Each term is an echo with a
    delay of its own, so the sum is right over the whole band, nulls included. The last echo stands for all later ones.
    """
    eps = material.permittivity(center_hz)
    face = fresnel(eps, c)
    gamma[0, 0], gamma[0, 1] = face
    if material.thickness_m is None:
        return gamma[:1]
    inner = np.sqrt(eps - (1 - c * c) + 0j)
    trip = 2 * material.thickness_m * inner.real / C0
    loss = np.exp(-2j * 2 * np.pi * center_hz / C0 * material.thickness_m * inner)
    if abs(loss).max() < _FAINT:
        return gamma[:1]
    lag[1:] = trip * np.arange(1, TAPS)[:, None]
    turn = np.exp(2j * np.pi * center_hz * trip)  # a delayed echo turns the carrier by itself
    whole = np.stack(slab(eps, material.thickness_m, center_hz, c)[:2])
    rest = whole - gamma[0]
    for n in range(1, TAPS):
        r = np.stack(face)
        term = rest if n == TAPS - 1 else -(1 - r * r) * r ** (2 * n - 1) * loss**n
        gamma[n] = term * turn**n
        rest = rest - term
    return whole[None] if trip.max() * bandwidth_hz < _BROAD else gamma[:1]


def coherent(roughness: float, cosine: ArrayLike) -> Floats:
    """Compute the share of the amplitude that a rough surface keeps coherent; `roughness` is k times the rms height.

    exp(-(2 k s cos)^2 / 2): the mean of the phase 2 k s cos over Gaussian heights, so that the *power* falls by
    exp(-(2 k s cos)^2) [Ament1953].
    """
    return np.asarray(np.exp(-0.5 * (2 * roughness * np.asarray(cosine, float)) ** 2))


def reflection_tables(materials: Sequence[Material], spec: RadarSpec) -> tuple[Complexes, Floats, Complexes]:
    """Compute the reflection of every material at the radar's carrier, against cos(incidence), TE and TM.

    Returns:
        Echoes (m, TAPS, 2, COSINES) of face, back and inner reflections, their delays (m, TAPS, COSINES) [s], and the
        single coefficient (m, 1, 2, COSINES) of a wave that goes on to other surfaces.

    Raises:
        InputError: the carrier lies outside a material's data.
    """
    rows = [_tables(m, spec.center_hz, spec.bandwidth_hz) for m in materials]
    if not rows:
        none = np.zeros((1, TAPS, 2, COSINES), complex)
        return none, np.zeros((1, TAPS, COSINES)), none[:, :1]
    gamma, lag, bounce = (np.stack(one) for one in zip(*rows, strict=True))
    return gamma, lag, bounce


@dataclass(frozen=True, slots=True, eq=False)
class Transmissive:
    """Two-way transmission factors at the carrier and delays, by object and cos(incidence)."""

    factor: Complexes  # (o, COSINES) two-way amplitude, the carrier's turn over `delay_s` taken out; 0: opaque
    delay_s: Floats  # (o, COSINES) two-way delay over that of the air replaced [s]
    thin: Bools  # (o) which objects let anything through


def transmissive_of(materials: Sequence[Material], spec: RadarSpec) -> Transmissive:
    """Compute the two-way transmission of every object's slab; one that costs more than 50 dB is opaque.

    Raises:
        InputError: the carrier lies outside a material's data.
    """
    rows = [_slab_transmission(m, spec.center_hz) for m in materials] or [
        (np.zeros(COSINES, complex), np.zeros(COSINES))
    ]
    factor = np.stack([r[0] for r in rows])
    return Transmissive(factor, np.stack([r[1] for r in rows]), np.asarray(abs(factor).max(1) > 0))


@lru_cache(maxsize=512)
def _slab_transmission(material: Material, center_hz: float) -> tuple[Complexes, Floats]:
    c = np.linspace(0, 1, COSINES)
    if material.conductor or material.thickness_m is None:
        return np.zeros(COSINES, complex), np.zeros(COSINES)
    eps = material.permittivity(center_hz)
    _, _, te, tm = slab(eps, material.thickness_m, center_hz, c)
    late = 2 * material.thickness_m * (np.sqrt(eps - (1 - c * c) + 0j).real - c) / C0
    factor = ((te + tm) / 2) ** 2 * np.exp(2j * np.pi * center_hz * late)
    return (factor if abs(factor).max() > _FAINT else np.zeros(COSINES, complex)), late
