"""Fit the ray model's reflection coefficients: python -m studies.fit_reflections RECORDING WORLD [SENSOR].

RECORDING is anything with frames and poses; WORLD is the name of a library world or a world file.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ullage.config import WorldSpec
from ullage.data import Frames
from ullage.errors import InputError, UllageError
from ullage.experiments.simulated import load_world
from ullage.ports.registry import open as open_source
from ullage.radar.reflection_fit import ReflectionFit, fit_reflections


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
