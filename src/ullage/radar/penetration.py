"""Plane layers: Fresnel coefficients, coated surfaces and slabs with all inner reflections, and transmission.

Time runs as e^{+jwt}; permittivity is eps' - j eps''. Both polarisations are given for the electric field's tangential
sense, so that at normal incidence TE and TM agree, and a perfect conductor reflects -1 in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Bools, Complexes, Floats
from ullage.geometry import C0
from ullage.specs import RadarSpec
from ullage.world.materials import Material

COSINES = 65
"""Entries of a table over cos(incidence), from 0 to 1."""
TAPS, SLAB_TAPS = 5, 3
"""Echoes of layers that are kept apart. A slab has its face, its back, and all later ones: each echo costs time."""
_BROAD = 0.25  # of layers longer than this part of the pulse, there and back, only the nearest echoes bounce
_FAINT = 10 ** (-50 / 20)  # inner echoes below this are left out


def fresnel(eps: complex, cosine: ArrayLike) -> tuple[Complexes, Complexes]:
    """Compute the reflection of a half-space in air, TE and TM, against cos(incidence); air itself has none."""
    c = np.asarray(cosine, float)
    te, tm = _interface(1.0, c + 0j, eps, np.sqrt(eps - (1 - c * c) + 0j))
    return te, tm


def slab(
    eps: complex, thickness_m: float, frequency_hz: float, cosine: ArrayLike
) -> tuple[Complexes, Complexes, Complexes, Complexes]:
    """Compute reflection and transmission of a slab in air, TE and TM; transmission as of `stack`."""
    reflected, through = stack([(eps, thickness_m)], 1.0, frequency_hz, cosine)
    return reflected[0], reflected[1], through[0], through[1]


def stack(
    layers: Sequence[tuple[complex, float]], behind: complex | None, frequency_hz: float, cosine: ArrayLike
) -> tuple[Complexes, Complexes]:
    """Compute reflection and transmission (2, c) of plane layers in air, TE and TM.

    All inner reflections are summed from the last interface to the first [Orfanidis, eq. 6.1.3]. Transmission is
    relative to the path without the layers: its phase is theirs less that of the air they replace.

    Args:
        layers: permittivity and thickness [m] of each, the outermost first.
        behind: permittivity of what follows; None: a perfect conductor.
        frequency_hz: of the wave [Hz].
        cosine: (c) of the incidence.
    """
    c = np.asarray(cosine, float)
    k = 2 * np.pi * frequency_hz / C0
    eps = [1.0 + 0j, *(complex(one) for one, _ in layers)]
    inner = [c + 0j, *(np.sqrt(one - (1 - c * c) + 0j) for one in eps[1:])]
    if behind is None:
        out, through = np.full((2, *c.shape), -1.0 + 0j), np.zeros((2, *c.shape), complex)
    else:
        out = _interface(eps[-1], inner[-1], complex(behind), np.sqrt(behind - (1 - c * c) + 0j))
        through = 1 + out
    for n in range(len(layers), 0, -1):
        thickness_m = layers[n - 1][1]
        once = np.exp(-1j * k * thickness_m * inner[n])
        r = _interface(eps[n - 1], inner[n - 1], eps[n], inner[n])
        loop = 1 + r * out * once * once
        through = (1 + r) * through * once * np.exp(1j * k * thickness_m * c) / loop
        out = (r + out * once * once) / loop
    return out, through


def _interface(eps: complex, inner: Complexes, other: complex, beyond: Complexes) -> Complexes:
    """Reflection (2, c) at the interface of two media, TE and TM; none between like ones."""
    if eps == other:
        return np.zeros((2, *inner.shape), complex)
    te = (inner - beyond) / (inner + beyond)
    return np.stack([te, -(other * inner - eps * beyond) / (other * inner + eps * beyond)])


def _layers_of(material: Material, frequency_hz: float) -> tuple[list[tuple[complex, float]], complex | None]:
    """Layers of a material from its face on, and what follows, as of `stack`; a sheet is coated on both sides."""
    coat = [(one.permittivity(frequency_hz), thick) for one, thick in material.coating]
    if material.conductor:
        return coat, None
    eps = material.permittivity(frequency_hz)
    if material.thickness_m is None:
        return coat, eps
    return [*coat, (eps, material.thickness_m), *reversed(coat)], 1.0


@lru_cache(maxsize=512)
def _tables(material: Material, center_hz: float, bandwidth_hz: float) -> tuple[Complexes, Floats, Complexes]:
    """Compute a surface's echoes (TAPS, 2, COSINES), delays (TAPS, COSINES) [s] and reflection (1, 2, COSINES).

    Unused taps have delay -1.
    """
    c = np.linspace(0, 1, COSINES)
    gamma = np.zeros((TAPS, 2, COSINES), complex)
    lag = np.full((TAPS, COSINES), -1.0)
    layers, behind = _layers_of(material, center_hz)
    found = _echoes_of(layers, behind, center_hz, c, TAPS if material.layers else SLAB_TAPS)
    loudest = max(one.level for one in found)
    found = found[:1] + [one for one in found[1:] if one.level > _FAINT * loudest]
    for tap, one in enumerate(found):
        gamma[tap] = one.value * np.exp(2j * np.pi * center_hz * one.delay_s)  # a delay turns the carrier by itself
        lag[tap] = one.delay_s
    longest = sum(2 * thick * abs(np.sqrt(eps)) / C0 for eps, thick in layers) * bandwidth_hz
    near = [one for one in found if longest < _BROAD or one.delay_s.max() * bandwidth_hz < _BROAD]
    bounce = np.asarray(sum(one.value for one in near))[None]
    if material.roughness_m:
        wave = 2 * np.pi * center_hz / C0
        share = coherent(wave * material.roughness_m, c)
        gamma, bounce = gamma * share, bounce * share
    return gamma, lag, bounce


class _Echo(NamedTuple):
    """An echo of plane layers, TE and TM, against cos(incidence)."""

    delay_s: Floats  # (c) after the echo of the face [s]
    value: Complexes  # (2, c) amplitude, with the carrier's phase at that delay

    @property
    def level(self) -> float:
        """Its greatest amplitude."""
        return float(np.abs(self.value).max())


def _echoes_of(
    layers: Sequence[tuple[complex, float]], behind: complex | None, center_hz: float, c: Floats, most: int
) -> list[_Echo]:
    """Compute the echoes of plane layers one by one, in order of delay; their sum is the reflection at the carrier.

    With r of an interface, G of all that lies behind it and P of the way through the layer and back, the reflection is
    (r + G P) / (1 + r G P) = r + (1 - r^2) (G P - r (G P)^2 + ...) [Orfanidis, eq. 6.1.3]. Each product of G's echoes
    is an echo with a delay of its own, so that the sum is right over the whole band, nulls included.

    Args:
        layers: as of `stack`.
        behind: as of `stack`.
        center_hz: carrier [Hz].
        c: (c) cosines of the incidence.
        most: echoes that are kept apart. Those that lie nearest, and the faintest, become one.
    """
    eps = [1.0 + 0j, *(one for one, _ in layers)]
    inner = [c + 0j, *(np.sqrt(one - (1 - c * c) + 0j) for one in eps[1:])]
    last = np.full((2, len(c)), -1.0 + 0j)
    if behind is not None:
        last = _interface(eps[-1], inner[-1], behind, np.sqrt(behind - (1 - c * c) + 0j))
    k, here, out = 2 * np.pi * center_hz / C0, np.zeros_like(c), [_Echo(np.zeros_like(c), last)]
    for n in range(len(layers), 0, -1):
        thickness_m = layers[n - 1][1]
        trip_s, phase = 2 * thickness_m * inner[n].real / C0, np.exp(-2j * k * thickness_m * inner[n])
        r = _interface(eps[n - 1], inner[n - 1], eps[n], inner[n])
        inside = [_Echo(one.delay_s + trip_s, one.value * phase) for one in out]
        total = sum(one.value for one in inside)
        total = (r + total) / (1 + r * total)
        out, bounced = [_Echo(here, r)], [_Echo(one.delay_s, (1 - r * r) * one.value) for one in inside]
        for _ in range(most):
            out += bounced
            products = [_Echo(a.delay_s + b.delay_s, -r * a.value * b.value) for a in bounced for b in inside]
            bounced = _joined(products, most)
        out = _joined(out, most)
        rest = total - sum(one.value for one in out)  # of all later echoes
        out[-1] = _Echo(out[-1].delay_s, out[-1].value + rest)
    return out


def _joined(echoes: list[_Echo], most: int) -> list[_Echo]:
    """Join echoes until few are left, first those with the least product of gap and fainter amplitude."""
    out = sorted(echoes, key=lambda one: float(one.delay_s[-1]))
    while len(out) > most:
        cost = [(b.delay_s[-1] - a.delay_s[-1]) * min(a.level, b.level) for a, b in pairwise(out)]
        n = int(np.argmin(cost))
        a, b = out[n], out[n + 1]
        first, second = (np.sum(np.abs(one.value) ** 2, axis=0) + 1e-30 for one in (a, b))
        delay_s = (first * a.delay_s + second * b.delay_s) / (first + second)
        out[n : n + 2] = [_Echo(delay_s, a.value + b.value)]
    return out


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
    layers, behind = _layers_of(material, center_hz)
    te, tm = stack(layers, behind, center_hz, c)[1]
    late = sum(2 * thick * (np.sqrt(eps - (1 - c * c) + 0j).real - c) / C0 for eps, thick in layers)
    factor = ((te + tm) / 2) ** 2 * np.exp(2j * np.pi * center_hz * late)
    return (factor if abs(factor).max() > _FAINT else np.zeros(COSINES, complex)), late
