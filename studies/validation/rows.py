"""Rows of the validation tables, and measurements of path gains for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.data import Trajectory
from ullage.geometry import quat_matrix
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.physical import accumulate, path_gain_cw
from ullage.specs import AntennaSpec, RadarSpec
from ullage.world.scene import Scene

HERE = Trajectory.stationary()


@dataclass(frozen=True, slots=True)
class Row:
    """One comparison: reference, result, and the largest accepted difference."""

    oracle: str
    reference: float
    ours: float
    bound: float
    unit: str = "dB"

    @property
    def difference(self) -> float:
        """The result minus the reference."""
        return self.ours - self.reference

    @property
    def passed(self) -> bool:
        """Whether the difference is within the bound."""
        return abs(self.difference) <= self.bound


def radar(polarization: str = "vertical") -> RadarSpec:
    """Return the X4M05 with isotropic antennas and no noise."""
    antenna = AntennaSpec.model_validate({"kind": "isotropic", "polarization": polarization})
    return RadarSpec.preset("x4m05", antenna=antenna, noise=None)


def db(value: complex | float) -> float:
    """Return 20 log10 of a magnitude."""
    return float(20 * np.log10(max(abs(value), 1e-30)))


def gain(
    scene: Scene, *, spec: RadarSpec | None = None, hz: float | None = None, bounces: int = 1, edges: bool = True
) -> complex:
    """Compute the path gain at the origin at one frequency; without `edges` by plain physical optics."""
    return complex(path_gain_cw(scene, HERE, spec or radar(), hz, max_bounces=bounces, edges=edges)[0])


def gain_via(scene: Scene, pose: Trajectory, spec: RadarSpec, thing: str, via: tuple[str, ...]) -> complex:
    """Compute the path gain at the carrier of one object's echo via other objects, in the order of the path."""
    context = radar_context(scene, spec)
    antennas = antenna_pair(spec, pose.position[0], quat_matrix(pose.quat_xyzw)[0])
    names = [o.name for o in scene.objects]
    wanted = [*(names.index(name) for name in via), -1, -1][:2]
    echoes = accumulate(radar_frame(context, antennas, None, 1 + len(via)))
    return complex(sum(
        part.echo[(part.object_ids == names.index(thing)) & (part.via == wanted).all(1)].sum()
        for part in echoes if part.via is not None
    ))  # fmt: skip
