"""Straight round wires, rods and thin pipes: the exact series of the infinite cylinder, integrated along the wire.

The series gives the strength of each length as if the wire were endless [Balanis2012, ch. 11]; the line integral with
its ends, the antenna's weight and what stands in between gives the echo. Echoes start at the near side of the wire.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Complexes, Floats, Ints, Longs
from ullage.errors import InputError
from ullage.geometry import C0, invert
from ullage.radar.echo_set import OnObjects
from ullage.radar.quadrics import Quadric
from ullage.world.materials import Material
from ullage.world.scene import Scene

THINNEST_M = 1e-4
"""Wires thinner than this are refused [m]."""
_SINES = 65
_LEAST = 1e-10  # orders weaker than this are left out


@dataclass(frozen=True, slots=True, eq=False)
class Lines(OnObjects):
    """A scene's wires, in the frame of their objects, and their series at one carrier."""

    POINTS = ("starts", "ends")
    starts: Floats  # (w, 3) [m]
    ends: Floats  # (w, 3) [m]
    radii: Floats  # (w) [m]
    object_ids: Ints  # (w) object
    series: Complexes  # (w, 2, _SINES) TM and TE, straight back
    modes: Complexes  # (k, 2, n, _SINES) TM and TE by order, for other directions, of every kind of wire
    kinds: Longs  # (w) which of these each wire is
    covers: Floats  # (w) radius of a mesh around the line [m], 0 for wires

    def __len__(self) -> int:
        return len(self.radii)


def _orders(ka: ArrayLike, eps: complex | None = None, *, oblique: ArrayLike = 1.0) -> tuple[Complexes, Complexes]:
    """Terms (n, k) of the field scattered by the infinite cylinder: E along the axis (TM), H along it (TE).

    Term n times cos(n psi) goes out at psi from the direction in which the wave came [Balanis2012, ch. 11].
    """
    from scipy.special import jv, yv

    x = np.atleast_1d(np.asarray(ka, float))
    order = np.arange(-1, int(np.ceil(x.max() + 4 * x.max() ** (1 / 3))) + 13)[:, None]
    n, z = order[1:-1], np.maximum(x, 1e-9)[None]

    def slopes(rows: Complexes) -> Complexes:
        return (rows[:-2] - rows[2:]) / 2

    with np.errstate(all="ignore"):
        js = jv(order, z)
        hs = js - 1j * yv(order, z)
        j, dj, h, dh = js[1:-1], slopes(js), hs[1:-1], slopes(hs)
        if eps is None:
            tm, te = j / h, dj / dh
        else:
            m = np.sqrt(eps - 1 + np.square(oblique)) / oblique
            inner = m * m
            jis = jv(order, m * z)
            ji, dji = jis[1:-1], slopes(jis)
            tm = (j * dji * m - dj * ji) / (h * dji * m - dh * ji)
            te = (j * dji * m / inner - dj * ji) / (h * dji * m / inner - dh * ji)
    twice = np.where(n == 0, -1, -2)
    return np.asarray(twice * np.where(np.isfinite(tm), tm, 0)), np.asarray(twice * np.where(np.isfinite(te), te, 0))


@lru_cache(maxsize=256)
def _modes(radius_m: float, material: Material, center_hz: float) -> Complexes:
    """Orders of the scattered field (2, n, _SINES) over the sine of the angle to the axis, less the lead."""
    k = 2 * np.pi * center_hz / C0
    sine = np.maximum(np.linspace(0, 1, _SINES), 1e-3)
    eps = None if material.conductor else material.permittivity(center_hz)
    both = np.stack(_orders(k * radius_m * sine, eps, oblique=sine))
    count = int(np.flatnonzero(abs(both).max((0, 2)) > _LEAST * abs(both).max())[-1]) + 1
    return np.asarray((both * np.exp(-2j * k * radius_m * sine))[:, :count])


def strung(scene: Scene, center_hz: float) -> Lines:
    """The scene's wires with their series.

    Raises:
        InputError: a wire is thinner than 0.1 mm or has no length, or its material has no data at the carrier.
    """
    wires = scene.wires
    thin = np.flatnonzero(wires.radius_m < THINNEST_M)
    if len(thin):
        name = scene.objects[wires.object_id[thin[0]]].name
        raise InputError(f"wire {name!r} has a radius of {wires.radius_m[thin[0]] * 1e3:g} mm", where=scene.name,
                         allowed=f"at least {THINNEST_M * 1e3:g} mm")  # fmt: skip
    held = np.flatnonzero(np.linalg.norm(wires.end - wires.start, axis=1) > 1e-9)
    wanted = [(float(wires.radius_m[i]), scene.objects[wires.object_id[i]].material) for i in held]
    known = list(dict.fromkeys(wanted))
    rows = [_modes(radius, material, center_hz) for radius, material in known]
    modes = np.zeros((len(rows), 2, max([r.shape[1] for r in rows], default=0), _SINES), complex)
    for i, row in enumerate(rows):
        modes[i, :, : row.shape[1]] = row
    kinds = np.array([known.index(kind) for kind in wanted], np.int64)
    series = np.array([_straight_back(row) for row in rows]).reshape(-1, 2, _SINES)[kinds]
    return Lines(wires.start[held], wires.end[held], wires.radius_m[held], wires.object_id[held], series, modes, kinds,
                 np.zeros(len(held)))  # fmt: skip


def _straight_back(modes: Complexes) -> Complexes:
    """Sum orders (2, n, s) to the series (2, s) straight back."""
    # the electric field across the axis then points the other way for the same magnetic one
    signs = np.multiply.outer([1.0, -1.0], (-1.0) ** np.arange(modes.shape[1]))
    return np.asarray(np.einsum("pn,pns->ps", signs, modes))


def rods(scene: Scene, walls: Sequence[Quadric], center_hz: float, reflection: Complexes) -> Lines:
    """Return cylinders (w) as lines of the exact series less that of physical optics, whose facets echo already.

    Args:
        scene: what there is.
        walls: cylinders at the initial poses.
        center_hz: carrier [Hz].
        reflection: (o, 2, c) of the objects over cos(incidence), across the plane of incidence and in it.
    """
    objects, start = scene.objects, scene.poses()
    own = [invert(start[w.object_id]) if objects[w.object_id].motion is not None else np.eye(4) for w in walls]
    ends = np.array([[m[:3, :3] @ (w.centre + z * w.axes[2]) + m[:3, 3] for z in (w.low, w.high)]
                     for m, w in zip(own, walls, strict=True)]).reshape(-1, 2, 3)  # fmt: skip
    radii, object_ids = np.array([round(w.radius, 6) for w in walls]), np.array([w.object_id for w in walls], np.int32)
    known: dict[tuple[float, Material], Complexes] = {}
    for radius, k in zip(radii.tolist(), object_ids, strict=True):
        kind = radius, objects[k].material
        if kind not in known:
            known[kind] = _straight_back(_modes(*kind, center_hz)) - _physical_optics(radius, reflection[k], center_hz)
    series = [known[radius, objects[k].material] for radius, k in zip(radii.tolist(), object_ids, strict=True)]
    first, last = (np.ascontiguousarray(ends[:, k]) for k in range(2))  # as of wires: kernels compile once
    return Lines(first, last, radii, object_ids, np.array(series).reshape(-1, 2, _SINES),
                 np.zeros((0, 2, 0, _SINES), complex), np.zeros(len(walls), np.int64), radii)  # fmt: skip


def _physical_optics(radius_m: float, reflection: Complexes, center_hz: float) -> Complexes:
    """Compute the series (2, _SINES) of physical optics: an integral around the lit half of the cylinder."""
    x = 2 * np.pi * center_hz / C0 * radius_m * np.maximum(np.linspace(0, 1, _SINES), 1e-3)[:, None]
    nodes, weights = np.polynomial.legendre.leggauss(int(x.max()) + 24)
    cosine, steps = np.cos(np.pi / 2 * nodes), np.linspace(0, 1, reflection.shape[1])
    strength = np.array([np.interp(cosine * x / x.max(), steps, row) for row in reflection])
    return np.asarray(x[:, 0] * np.pi / 4 * (strength * weights * cosine * np.exp(2j * x * (cosine - 1))).sum(2))
