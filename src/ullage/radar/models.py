"""Echo models: how the frames of a radar follow from a world and a track. `simulate` chooses one by `fidelity`.

To add one, write a class as `EchoModel` and list it here, or in another package under the entry point group
`ullage.echo_models`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Protocol

import numpy as np

from ullage import plugins
from ullage.data import Samples, Trajectory, Unit
from ullage.errors import InputError
from ullage.fan import reaching_max_range
from ullage.radar.integration import integrated
from ullage.radar.rays import echoes_thesis
from ullage.radar.receiver import receive, receive_thesis
from ullage.specs import RadarSpec
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene


class EchoModel(Protocol):
    """What the radars of one body receive in one world; made by `Model(scene, max_bounces, seed)`.

    Frame k must depend on its own pose, velocities, time and number alone, so that a track cut anywhere gives the same
    bits.
    """

    unit: Unit  # of the samples
    forks: bool  # whether copies of this process are worth it, because much of the work holds Python's lock
    own_body: bool  # whether scenes may hold the parts of the radars' own body (`radar.own_body`)

    def sensor(self, spec: RadarSpec) -> RadarSpec:
        """Return the radar as this model simulates it: its range axis may be longer."""

    def check(self, path: Trajectory, sensors: Mapping[str, RadarSpec]) -> None:
        """Refuse with InputError, or warn, before the first frame of a track."""

    def samples(self, truth: Trajectory, spec: RadarSpec, *, seed: int, first_frame: int) -> Samples:
        """Return what one radar receives (n, b) at its true poses.

        Args:
            truth: of the sensor, x along the boresight; one pose a frame.
            spec: the radar.
            seed: of this radar's noise.
            first_frame: number of the first frame, which keys its noise.
        """


class Physical:
    """Coherent echoes (`radar.physical`), then the receiver."""

    unit: Unit = "path_gain"
    forks = True
    own_body = True

    def __init__(self, scene: Scene, max_bounces: int, seed: int) -> None:
        self.scene, self.max_bounces, self.seed = scene, max_bounces, seed

    def sensor(self, spec: RadarSpec) -> RadarSpec:
        """The radar as it is."""
        return spec

    def check(self, path: Trajectory, sensors: Mapping[str, RadarSpec]) -> None:
        """Refuse a radar inside of things, and warn of what has no echo."""
        from ullage.radar.checks import check

        check(self.scene, path, sensors)

    def samples(self, truth: Trajectory, spec: RadarSpec, *, seed: int, first_frame: int) -> Samples:
        """Baseband or RF samples with noise and leakage."""
        from ullage.radar.physical import echoes

        def along(path: Trajectory, one: RadarSpec) -> Samples:
            return integrated(partial(echoes, self.scene, spec=one, max_bounces=self.max_bounces, seed=self.seed),
                              path, one, self.scene, bounces=self.max_bounces)  # fmt: skip

        clean: Samples
        if spec.stagger_div is None:
            clean = along(truth, spec)
        else:
            odd = (first_frame + np.arange(len(truth))) % 2 == 1
            clean = np.zeros((len(truth), spec.bins), np.complex64)
            for rows, div in ((~odd, spec.prf_div), (odd, spec.stagger_div)):
                if rows.any():
                    clean[rows] = along(truth[np.flatnonzero(rows)], _of_interval(spec, div))
            clean = clean.real.copy() if spec.output == "rf" else clean
        return receive(clean, spec, seed=seed, first_frame=first_frame)


@lru_cache(maxsize=64)
def _of_interval(spec: RadarSpec, prf_div: int) -> RadarSpec:
    """The radar with one pulse interval."""
    return spec.but(prf_div=prf_div, stagger_div=None)


class Rays:
    """Amplitudes of the ray model of 2018 (`radar.rays`); it knows neither bounces nor the radars' own body."""

    unit: Unit = "thesis"
    forks = False
    own_body = False

    def __init__(self, scene: Scene, max_bounces: int, seed: int) -> None:
        self.scene, self.caster = scene, Raycaster(scene, wires=True)

    def sensor(self, spec: RadarSpec) -> RadarSpec:
        """The radar with a range axis that reaches R_max.

        Raises:
            InputError: the receiver has a polarisation of its own, which the ray model does not know.
        """
        if spec.antenna.receive_polarization not in (None, spec.antenna.polarization):
            raise InputError("the ray model has no polarisation", where="antenna.receive_polarization",
                             allowed='fidelity "physical"')  # fmt: skip
        return reaching_max_range(spec)

    def check(self, path: Trajectory, sensors: Mapping[str, RadarSpec]) -> None:
        """Nothing is refused."""

    def samples(self, truth: Trajectory, spec: RadarSpec, *, seed: int, first_frame: int) -> Samples:
        """Smoothed amplitudes with noise."""
        clean = integrated(partial(echoes_thesis, self.scene, spec=spec, caster=self.caster), truth, spec, self.scene)
        return receive_thesis(clean, spec, seed=seed, first_frame=first_frame)


ECHO_MODELS: Mapping[str, Callable[[Scene, int, int], EchoModel]] = {"physical": Physical, "thesis": Rays}
"""The models shipped, by fidelity."""


def echo_model(fidelity: str) -> Callable[[Scene, int, int], EchoModel]:
    """Return the model of a name, shipped or added by another package.

    Raises:
        InputError: there is none.
    """
    found = ECHO_MODELS.get(fidelity) if isinstance(fidelity, str) else None
    found = found or plugins.load("ullage.echo_models", fidelity)
    if found is None:
        allowed = ", ".join((*ECHO_MODELS, *plugins.names("ullage.echo_models")))
        raise InputError(f"no fidelity {fidelity!r}", where="simulate", allowed=allowed)
    model: Callable[[Scene, int, int], EchoModel] = found
    return model
