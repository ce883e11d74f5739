"""Hyperbola against speed, and resolution against the number of samples: python -m studies.tables.speed_and_samples.

The thesis sees no hyperbola in the images of its real, faster flights (7.1), and explains their resolution by fewer
samples. Here a wire is flown past by the physical law, with frames that integrate while the radar moves.
"""

from __future__ import annotations

import numpy as np

from studies.thesis.motion import fly_at
from studies.thesis.speeds import TARGET, ambiguous_db
from ullage.data import Trajectory
from ullage.grids import Grid, Image
from ullage.processing.metrics import image_quality
from ullage.processing.sar import focus
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec, Rig
from ullage.world import scenes
from ullage.world.scene import Scene

SPEEDS, RATES_HZ = (0.25, 0.5, 1.0, 1.5, 2.0), (34.0, 17.0, 8.5, 4.25, 2.125)
GRID = Grid((1.6, -1.2, 0), 0.02, (120, 90))
ARM_M = 0.9  # beside the target: 20 deg off the boresight at 2.5 m


def arms_db(image: Image) -> float:
    """Return the ridge's level beside the target over that at it [dB]."""
    ridge = np.abs(image.values).max(axis=1)
    at, beside = (float(ridge[abs(abs(image.grid.y_m) - y) < 0.1].mean()) for y in (0.0, ARM_M))
    return 20 * np.log10(max(beside, 1e-12) / at)


def main() -> None:
    spec = RadarSpec.preset("x4m05", noise=None)
    wire = Scene.of_wires(np.array([*TARGET, -1.5]), np.array([*TARGET, 1.5]), 0.005, name="wire")
    path = Trajectory.line((0, -1.2, 0), (0, 1.2, 0), speed_m_s=0.5, rate_hz=50)
    print("speed [m/s] | frames | wire: arms over apex [dB] | plate: arms over apex [dB]")
    for speed in SPEEDS:
        levels = []
        for scene in (wire, scenes.plate(0.5, 0.5, TARGET[0])):
            rig = Rig(sensors={"front": spec})
            frames = fly_at(scene, path, rig, speed_m_s=speed, path_speed_m_s=0.5)["front"]
            levels.append(arms_db(focus(frames, GRID, method="summation")))
        print(f"{speed:g} | {len(frames)} | " + " | ".join(f"{level:.1f}" for level in levels))
    print("frames/s at 0.5 m/s | frames | width across, back-projection [cm] | ambiguous energy [dB]")
    for rate in RATES_HZ:
        frames = simulate(wire, Trajectory.line((0, -1.2, 0), (0, 1.2, 0), speed_m_s=0.5, rate_hz=rate), spec)
        image = focus(frames, GRID)
        width = 100 * image_quality(image, target_m=(*TARGET, 0.0), search_m=0.3)["width_y_3db"].value
        print(f"{rate:g} | {len(frames)} | {width:.1f} | {ambiguous_db(image):.1f}")


if __name__ == "__main__":
    main()
