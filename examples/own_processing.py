"""A stage of one's own in the loop: how far the radar came nearer, read from the phase of one echo."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import ullage as ul


@dataclass
class Displacement:
    """Line-of-sight motion of the strongest echo [m], one value a frame."""

    _bin: int | None = None
    _values: list[complex] = field(default_factory=list)

    def update(self, chunk: dict[str, ul.Frames]) -> Iterable[Any]:
        """Nothing is given before the end."""
        for frames in chunk.values():
            if self._bin is None:
                self._bin = int(np.argmax(frames.amplitude.mean(axis=0)))
            self._values += list(frames.samples[:, self._bin])
            self._wavelength_m = frames.spec.wavelength_m
        return ()

    def finish(self) -> Iterable[Any]:
        """The whole motion."""
        yield -np.unwrap(np.angle(self._values)) * self._wavelength_m / (4 * np.pi)


def main() -> None:
    swing = ul.Trajectory.line((0, 0, 0), (0.02, 0, 0), speed_m_s=0.01, rate_hz=17)  # the radar nears by 2 cm
    frames = ul.simulate(
        ul.scenes.sphere(radius_m=0.3, distance_m=3.0), swing, ul.RadarSpec.preset("x4m05", noise=None)
    )
    outcome = ul.run(frames, stages=[Displacement()])
    moved = outcome.results[0][-1] - outcome.results[0][0]
    frames.plot().figure.savefig("own_processing.png")
    print(f"range changed by {1000 * moved:.2f} mm over {outcome.frames} frames")
    if not abs(moved + 0.02) < 2e-4:
        raise SystemExit("phase does not tell how far the radar went")


if __name__ == "__main__":
    main()
