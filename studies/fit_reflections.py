"""Fit the ray model's reflection coefficients: python -m studies.fit_reflections RECORDING WORLD [SENSOR].

RECORDING is anything with frames and poses; WORLD is the name of a library world or a world file. The echo of each
object is proportional to its coefficient I_m [Billdal2018, eq. 4.2], and which ray meets which object does not depend
on it. A recording is therefore a sum of one template for each object, and the coefficients are the non-negative
least-squares weights. The thesis set them by hand from a real sensor (section 4.2).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.config import WorldSpec
from ullage.data import Frames
from ullage.errors import InputError, UllageError
from ullage.experiments.simulated import load_world
from ullage.ports.registry import open as open_source
from ullage.radar.simulate import simulate
from ullage.specs import MountSpec
from ullage.world.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class ReflectionFit:
    """Fitted coefficients, one for each object of the scene.

    In a recording of an unknown gain, only their ratios have a meaning.
    """

    names: tuple[str, ...]
    coefficient: Floats  # (o); NaN where no ray met the object, or where another gives the same echoes
    sigma: Floats  # (o) one sigma, from the residual taken as white; infinite where the coefficient is NaN
    floor: float  # constant level of the recording, in its unit
    misfit: float  # rms residual over rms recording


def fit_reflections(frames: Frames, scene: Scene) -> ReflectionFit:
    """Fit the reflection coefficient of each object to the amplitudes of one radar.

    Args:
        frames: with poses; their own settings say what the ray model sees.
        scene: the world of the recording; its own coefficients are not used.

    Raises:
        InputError: the frames have no poses or no echo, or the scene has no object in view.
    """
    if frames.poses is None:
        raise InputError("the frames have no poses", where=frames.sensor, allowed="poses for every frame")
    received = np.asarray(frames.amplitude, float).ravel()
    if not received.any():
        raise InputError("the frames hold no echo", where=frames.sensor)
    templates = np.stack([template(frames, scene, index) for index in range(len(scene.objects))], axis=1)
    seen = np.asarray(templates.any(axis=0), np.bool_).reshape(-1)
    if not seen.any():
        raise InputError("no ray of these poses meets an object", where=scene.name, allowed="the recording's own world")
    return _solve(received, templates, seen, tuple(thing.name for thing in scene.objects))


def template(frames: Frames, scene: Scene, index: int) -> Floats:
    """Amplitudes (n * b) that the ray model gives when one object reflects with 1 and every other with 0."""
    objects = tuple(
        replace(thing, material=thing.material.but(reflection=float(k == index)))
        for k, thing in enumerate(scene.objects)
    )
    spec = frames.spec.but(noise=None, mount=MountSpec())
    alone = simulate(replace(scene, objects=objects), frames.believed, spec, fidelity="thesis")
    return np.asarray(alone.amplitude, float).ravel()


def _solve(received: Floats, templates: Floats, seen: Bools, names: tuple[str, ...]) -> ReflectionFit:
    from scipy.optimize import nnls

    design = np.column_stack([templates[:, seen], np.ones(len(received))])
    scale = np.linalg.norm(design, axis=0)
    weights = nnls(design / scale, received)[0] / scale
    residual = received - design @ weights
    variance = float(residual @ residual) / max(len(received) - design.shape[1], 1)
    spread = _spread(design / scale) * np.sqrt(variance) / scale
    coefficient, sigma = np.full(len(names), np.nan), np.full(len(names), np.inf)
    sigma[seen] = spread[:-1]
    known = np.isfinite(sigma)
    coefficient[known] = weights[:-1][known[seen]]
    misfit = float(np.linalg.norm(residual) / np.linalg.norm(received))
    return ReflectionFit(names, coefficient, sigma, float(weights[-1]), misfit)


def _spread(design: Floats) -> Floats:
    """One sigma of each weight for unit noise; infinite for those that the columns cannot tell apart."""
    power, direction = np.linalg.eigh(design.T @ design)
    clear = power > 1e-6 * power[-1]
    mixed = (direction[:, ~clear] ** 2).sum(axis=1) > 1e-3
    return np.where(mixed, np.inf, np.sqrt((direction[:, clear] ** 2 / power[clear]).sum(axis=1)))


def fit_recording(recording: str, world: str, sensor: str = "") -> ReflectionFit:
    """Fit the objects of a world to one sensor of a recording; without a name, to the first.

    Raises:
        InputError: either cannot be read, or there is no such sensor.
    """
    spec = WorldSpec(file=world) if Path(world).suffix else WorldSpec(name=world)
    scene = load_world(spec)
    found = open_source(recording).frames()
    parts = {found.sensor: found} if isinstance(found, Frames) else dict(found)
    name = sensor or next(iter(parts))
    if name not in parts:
        raise InputError(f"no sensor {name!r}", where=recording, allowed=", ".join(parts))
    return fit_reflections(parts[name], scene)


def report(fit: ReflectionFit) -> str:
    """One line for each object, then the misfit."""
    rows = [
        f"{name}: {value:.3f} +- {sigma:.3f}" if np.isfinite(value) else f"{name}: not determined"
        for name, value, sigma in zip(fit.names, fit.coefficient, fit.sigma, strict=True)
    ]
    return "\n".join([*rows, f"floor {fit.floor:.4g}; misfit {100 * fit.misfit:.1f} % of the recording's rms"])


def main(arguments: Sequence[str]) -> int:
    """Print the coefficients; return 2 with one line on bad input."""
    if not 2 <= len(arguments) <= 3:
        print(str(__doc__).splitlines()[0], file=sys.stderr)
        return 2
    try:
        print(report(fit_recording(*arguments)))
    except UllageError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
