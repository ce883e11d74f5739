"""Straight round wires, rods and thin pipes: the exact series of the infinite cylinder, integrated along the wire.

The series gives the strength of each length as if the wire were endless [Balanis2012, ch. 11]; the line integral with
its ends, the antenna's weight and what stands in between gives the echo. Echoes start at the near side of the wire.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.errors import InputError
from ullage.geometry import C0
from ullage.world.materials import Material
from ullage.world.scene import Scene

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

THINNEST_M = 1e-4
"""Wires thinner than this are refused [m]."""
_SINES = 65


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """A scene's wires, in the frame of their objects, and their series at one carrier."""

    starts: Floats  # (w, 3) [m]
    ends: Floats  # (w, 3) [m]
    radii: Floats  # (w) [m]
    stuffs: NDArray[np.int32]  # (w) object
    series: Complexes  # (w, 2, _SINES) TM and TE

    def __len__(self) -> int:
        return len(self.radii)


def backscatter(ka: ArrayLike, eps: complex | None = None, *, oblique: float = 1.0) -> tuple[Complexes, Complexes]:
    """Series S of the infinite cylinder straight back, TM and TE (electric field), so that the width is 4 |S|^2 / k.

    Args:
        ka: wave number times radius.
        eps: relative permittivity; None: a perfect conductor.
        oblique: sine of the angle between wave and axis, for the inside of a dielectric.
    """
    from scipy.special import h2vp, hankel2, jv, jvp

    x = np.atleast_1d(np.asarray(ka, float))
    order = np.arange(int(np.ceil(x.max() + 4 * x.max() ** (1 / 3))) + 12)
    n, z = order[:, None], np.maximum(x, 1e-9)[None]
    with np.errstate(all="ignore"):
        j, dj, h, dh = jv(n, z), jvp(n, z), hankel2(n, z), h2vp(n, z)
        if eps is None:
            tm, te = j / h, dj / dh
        else:
            m = np.sqrt(eps - 1 + oblique**2) / oblique
            inner = m * m
            ji, dji = jv(n, m * z), jvp(n, m * z)
            tm = (j * dji * m - dj * ji) / (h * dji * m - dh * ji)
            te = (j * dji * m / inner - dj * ji) / (h * dji * m / inner - dh * ji)
    sign = np.where(order == 0, 1, 2) * (-1.0) ** order
    tm, te = (np.where(np.isfinite(a), a, 0) for a in (tm, te))
    return -(sign @ tm), sign @ te


@lru_cache(maxsize=256)
def _series(radius_m: float, material: Material, center_hz: float) -> Complexes:
    """S over the sine of the angle to the axis (2, _SINES), less the phase of the near side's lead."""
    k = 2 * np.pi * center_hz / C0
    sine = np.maximum(np.linspace(0, 1, _SINES), 1e-3)
    if material.conductor:
        both = np.stack(backscatter(k * radius_m * sine))
    else:
        eps = material.permittivity(center_hz)
        both = np.stack([np.concatenate(p) for p in zip(
            *(backscatter(k * radius_m * s, eps, oblique=float(s)) for s in sine), strict=True)])  # fmt: skip
    return np.asarray(both * np.exp(-2j * k * radius_m * sine))


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
    rows = [_series(float(wires.radius_m[i]), scene.objects[wires.object_id[i]].material, center_hz) for i in held]
    series = np.stack(rows) if rows else np.zeros((0, 2, _SINES), complex)
    return Lines(wires.start[held], wires.end[held], wires.radius_m[held], wires.object_id[held], series)


def placed(lines: Lines, poses: Floats | None) -> tuple[Floats, Floats]:
    """Ends of the wires (w, 3), (w, 3) [m] where the objects have these poses (o, 4, 4); None: nothing moves."""
    starts, ends = moved((lines.starts, lines.ends), lines.stuffs, poses)
    return starts, ends


def moved(
    rows: Sequence[Floats], stuffs: NDArray[np.int32], poses: Floats | None, *, turn_only: bool = False
) -> Sequence[Floats]:
    """Points (w, 3) [m] of objects, or with `turn_only` directions, in the world by the objects' poses (o, 4, 4)."""
    if poses is None:
        return rows
    turn, shift = poses[stuffs, :3, :3], 0.0 if turn_only else poses[stuffs, :3, 3]
    return [np.einsum("nij,nj->ni", turn, points) + shift for points in rows]
