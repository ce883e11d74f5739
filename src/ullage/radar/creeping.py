"""Exact scattering of whole balls and rods, less what physical optics makes of them: mostly creeping waves.

Physical optics takes the currents of a tangent plane, and none in the shadow. On a ball the exact field is Mie's series
[Balanis2012, ch. 11], and the integral of physical optics over the same ball is known as well. Their difference is
added as a few impulses, from the near side of the ball to the wave that has crept around it once. It holds at any
radius: beyond ten wavelengths it is small, below one it is as strong as the echo itself. Along the axes of rods the
same difference comes from the series of the endless cylinder (`wires.rods`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ullage.arrays import Complexes, Floats
from ullage.geometry import C0
from ullage.kernels.facets import ONE, toward
from ullage.radar.context import RadarContext, RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.mirrors import across, dot
from ullage.radar.penetration import reflection_tables
from ullage.radar.pulse import spectrum
from ullage.radar.reflected_paths import accumulate
from ullage.radar.reflectors import PULL_M
from ullage.radar.sphere_echoes import smoothed
from ullage.radar.wires import Lines
from ullage.radar.wires import rods as lines_of
from ullage.specs import RadarSpec
from ullage.world.materials import Material

_SLOW = 1.3  # a creeping wave goes slower than light, around small balls by this at the most
_FIRM = 1e-3  # regularisation of the fit, over its largest singular value: 1e-3 of the difference is -60 dB


@dataclass(frozen=True, slots=True, eq=False)
class Impulses:
    """The difference as impulses (n), for a radar at unit distance."""

    delay_s: Floats  # (n) after a wave by way of the centre [s]
    value: Complexes  # (n) path gain amplitude times the squared distance [m2]


def mie(radius_m: float, material: Material, frequency_hz: Floats) -> Complexes:
    """Compute the scattering lengths (f) of a ball straight back at frequencies (f) [Hz], with the phase at its centre.

    The inside enters by its logarithmic derivatives, whose recurrence downwards is stable in lossy matter too.

    Returns:
        [m], after Mie's series [Balanis2012, ch. 11].
    """
    from scipy.special import spherical_jn, spherical_yn

    x = 2 * np.pi * frequency_hz / C0 * radius_m
    order = np.arange(int(x.max() + 4 * x.max() ** (1 / 3)) + 10)[:, None]
    psi = x * spherical_jn(order, x)
    with np.errstate(over="ignore", invalid="ignore"):
        xi = psi - 1j * x * spherical_yn(order, x)
    n = order[1:]
    of_electric, of_magnetic = np.broadcast_to(n / x, psi[1:].shape), None
    if not material.conductor:
        m = np.sqrt(np.array([material.permittivity(hz) for hz in frequency_hz], complex))
        inner, slope = np.zeros(psi.shape, complex), np.zeros(x.shape, complex)
        for i in range(int(abs(m * x).max()) + len(order) + 15, 0, -1):
            slope = i / (m * x) - 1 / (slope + i / (m * x))
            if i <= len(inner):
                inner[i - 1] = slope
        of_electric, of_magnetic = inner[1:] / m + n / x, inner[1:] * m + n / x
    electric = (of_electric * psi[1:] - psi[:-1]) / (of_electric * xi[1:] - xi[:-1])
    if of_magnetic is None:
        magnetic = psi[1:] / xi[1:]
    else:
        magnetic = (of_magnetic * psi[1:] - psi[:-1]) / (of_magnetic * xi[1:] - xi[:-1])
    terms = (-1.0) ** n * (2 * n + 1) * (magnetic - electric)
    return np.asarray(-1j * np.where(np.isfinite(terms), terms, 0).sum(0) * C0 / (4 * np.pi * frequency_hz))


def physical_optics(radius_m: float, reflection: Complexes, frequency_hz: Floats) -> Complexes:
    """Compute the same by physical optics, for a reflection (c) over equal steps of cos(incidence) from 0 to 1.

    Rings at a depth z give j k times the integral of the reflection and z e^{2jkz}.
    """
    wave = 2 * np.pi * frequency_hz / C0
    nodes, weights = np.polynomial.legendre.leggauss(int(wave.max() * radius_m) + 24)
    cosine, steps = (1 + nodes) / 2, np.linspace(0, 1, len(reflection))
    strength = weights / 2 * cosine * np.interp(cosine, steps, reflection)
    rings = np.exp(2j * radius_m * np.multiply.outer(wave, cosine)) @ strength
    return np.asarray(1j * wave * radius_m**2 * rings)


@lru_cache(maxsize=256)
def impulses(radius_m: float, material: Material, spec: RadarSpec) -> Impulses:
    """Fit impulses to the difference of both over the band of the pulse, by least squares."""
    band = 6 / (2 * np.pi * spec.pulse_sigma_s)
    last = np.pi * _SLOW
    if not material.conductor:  # through the ball and back
        last = max(last, 4 * abs(np.sqrt(complex(material.permittivity(spec.center_hz)))) - 2)
    delay = np.arange(-2 * radius_m / C0 - 2 / band, last * radius_m / C0 + 3 / band, 1 / band)
    offset = np.linspace(-band / 2, band / 2, 4 * len(delay) + 1)
    hz = spec.center_hz + offset
    reflection = reflection_tables([material], spec)[2][0, 0].mean(0)
    rest = (mie(radius_m, material, hz) - physical_optics(radius_m, reflection, hz)) * C0 / (4 * np.pi * hz)
    weight = spectrum(spec, offset)
    weight[len(weight) // 2] = len(weight)  # the carrier itself is met
    matrix = np.exp(-2j * np.pi * np.multiply.outer(hz, delay))
    value = np.linalg.lstsq(weight[:, None] * matrix, weight * rest, rcond=_FIRM / len(weight))[0]
    return Impulses(delay, np.asarray(value, complex))


def _bare(context: RadarContext, object_id: int) -> bool:
    """Return whether the series hold for an object: solid, of one material, smooth."""
    material = context.world.scene.objects[object_id].material
    return smoothed(context, object_id) and not material.layers and not material.roughness_m


@lru_cache(maxsize=256)  # a far field has a hundred contexts
def _impulses_of(context: RadarContext) -> dict[int, Impulses]:
    """Return the impulses of the balls for which the series holds, by their numbers."""
    objects = context.world.scene.objects
    return {
        k: impulses(round(ball.radius, 6), objects[ball.object_id].material, context.spec)
        for k, ball in enumerate(context.world.balls_at(None))
        if _bare(context, ball.object_id)
    }


def accumulate_creeping(frame: RadarFrame) -> list[EchoSet]:
    """Add what physical optics leaves out on whole balls in sight to the delay grids."""
    context, antennas, radar = frame.context, frame.antennas, frame.radar
    known = _impulses_of(context)
    if not known:
        return []
    balls = context.world.balls_at(frame.poses)
    rows = [balls[k] for k in known]
    centres, radii = np.array([ball.centre for ball in rows]).reshape(-1, 3), np.array([ball.radius for ball in rows])
    away = np.linalg.norm(centres - antennas.origins[:, None], axis=2)
    seen = np.flatnonzero((away.min(0) > radii) & (away.mean(0) - radii < context.gate[1]))
    if not len(seen):
        return []
    centres, radii, away, rows = centres[seen], radii[seen], away[:, seen], [rows[k] for k in seen]
    paths = (centres - antennas.origins[:, None]) / away[..., None]
    spots = centres - (radii + PULL_M)[:, None] * paths.mean(0)
    between = frame.transmission_to(spots)
    factor = antennas.factor * between.factor
    for s in range(2):
        factor = factor * [toward(radar.table, radar.isotropic, radar.frames, ONE, s, *u) for u in paths[s]]
    if not antennas.alike:  # a ball returns the polarisation that it meets
        sent, received = (
            across(np.broadcast_to(field, u.shape), u) for field, u in zip(antennas.fields, paths, strict=True)
        )
        factor = factor * dot(sent, received)
    every = list(known.values())
    made = [every[k] for k in seen]
    of = np.repeat(np.arange(len(made)), [len(one.delay_s) for one in made])
    late = np.concatenate([one.delay_s for one in made])
    middle, mean = away.sum(0) / C0 + between.delay_s, away.mean(0)[of]
    # the mirror echo spreads over the distances of the centre and of the near side, what comes later over the first
    near = mean + np.clip(late * C0 / 2, -radii[of], 0.0)
    spread = mean * (near**4 + (context.spec.wavelength_m / (8 * np.pi)) ** 4) ** 0.25  # at the end as `kernels.near`
    delay, value = middle[of] + late, factor[of] * np.concatenate([one.value for one in made]) / spread
    each = accumulate(context, delay, value, frame.grids, (1.0, 0.0))
    total = np.zeros(len(made), complex)
    np.add.at(total, of, each)

    def again(factors: Complexes, others: Complexes) -> None:
        accumulate(context, delay, value * factors[of], others, (1.0, 0.0))

    object_ids = np.array([ball.object_id for ball in rows], np.int32)
    return [EchoSet(object_ids, spots, total, middle - 2 * radii / C0, again)]


@lru_cache(maxsize=256)
def rods(context: RadarContext) -> Lines:
    """Return the whole cylinders as lines of what physical optics leaves out on them."""
    walls = [wall for wall in context.world.rods if _bare(context, wall.object_id)]
    return lines_of(context.world.scene, walls, context.spec.center_hz, context.bounce[:, 0])
