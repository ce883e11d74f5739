"""What the radars of one body receive in one world: an echo model, asked for piece after piece of the track."""

from __future__ import annotations

import zlib

import numpy as np

from ullage import checks
from ullage.data import Frames, Samples, SimulatedFrom, Trajectory
from ullage.errors import InputError
from ullage.radar.models import echo_model
from ullage.radar.own_body import with_body
from ullage.specs import MOST_BOUNCES, RadarSpec, Rig
from ullage.world.scene import Scene

Fidelity = str
"""Name of an echo model: "physical", "thesis", or one that another package adds."""


class Receiving:
    """What the radars of one body receive in one world: made once, then asked for piece after piece of the track.

    Args:
        scene: the world.
        radar: one radar (called "radar"), or several on one body.
        fidelity: "physical" or "thesis".
        max_bounces: 1 to 6.
        seed: of the noise.

    Raises:
        InputError: an argument cannot be used.
    """

    def __init__(
        self, scene: Scene, radar: RadarSpec | Rig, *, fidelity: Fidelity, max_bounces: int, seed: int
    ) -> None:
        _check(scene, radar, max_bounces, seed)
        body, model = radar.body if isinstance(radar, Rig) else None, echo_model(fidelity)
        self.body = body if getattr(model, "own_body", False) else None
        self.model = model(with_body(scene, self.body), max_bounces, seed)
        sensors = radar.sensors if isinstance(radar, Rig) else {"radar": radar}
        self.sensors = {name: self.model.sensor(spec) for name, spec in sensors.items()}
        self.scene, self.fidelity, self.max_bounces, self.seed = scene, fidelity, max_bounces, seed
        self._made = SimulatedFrom(scene, max_bounces, seed, self.body)
        self._paths: dict[str, tuple[Trajectory, Trajectory]] = {}  # of body and radar, as last asked for

    def samples(self, name: str, body: Trajectory, *, first_frame: int = 0) -> Samples:
        """What one radar receives along a piece of the body's track (n, b).

        Args:
            name: of the radar.
            body: true poses, one a frame.
            first_frame: number of the first frame, which keys its noise.
        """
        spec, truth = self.sensors[name], self._truth(name, body)
        return self.model.samples(truth, spec, seed=sensor_seed(self.seed, name), first_frame=first_frame)

    def frames(self, name: str, samples: Samples, body: Trajectory, *, believed: Trajectory | None = None) -> Frames:
        """What one radar received as Frames.

        Args:
            name: of the radar.
            samples: what it received (n, b).
            body: true poses, one a frame.
            believed: poses as navigation has them, at the same times.
        """
        spec = self.sensors[name]
        truth = self._truth(name, body)
        poses = truth if believed is None else believed.mounted(spec.mount.body_from_sensor())
        return Frames(
            samples, spec.range_m, truth.t_ns, spec, poses, truth, name, self.model.unit, simulated=self._made,
        )  # fmt: skip

    def _truth(self, name: str, body: Trajectory) -> Trajectory:
        """Return the path of a radar; live, each piece of track is asked for twice and is a frame long."""
        last, truth = self._paths.get(name, (None, body))
        if last is not body:
            truth = body.mounted(self.sensors[name].mount.body_from_sensor())
            self._paths[name] = body, truth
        return truth


def sensor_seed(seed: int, name: str) -> int:
    """A 64-bit seed of one sensor's own noise."""
    mixed = np.random.SeedSequence([seed, zlib.crc32(name.encode())])
    return int(mixed.generate_state(1, np.uint64)[0])


def _check(scene: Scene, radar: RadarSpec | Rig, max_bounces: int, seed: int) -> None:
    if not isinstance(scene, Scene):
        raise InputError(f"scene is a {type(scene).__name__}", where="simulate", allowed="a Scene")
    if not isinstance(radar, RadarSpec | Rig):
        raise InputError(f"radar is a {type(radar).__name__}", where="simulate", allowed="a RadarSpec or Rig")
    checks.whole("max_bounces", max_bounces, "simulate", low=1, high=MOST_BOUNCES)
    checks.whole("seed", seed, "simulate", low=0)
