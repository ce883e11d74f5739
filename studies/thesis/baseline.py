"""Check the thesis' ray model, Elfes' grid and the apex term by term against their formulas (4.2 to 5.3).

The flights of chapter 6 hardly show a wrong term. Here each statement isolates one: a plate, one reading, one ridge.
"""

from __future__ import annotations

import numpy as np

from studies.thesis.targets import decibel, radars
from studies.thesis.workspace import Workspace
from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.geometry import rpy_quat
from ullage.grids import Grid
from ullage.processing.occupancy import map_occupancy
from ullage.processing.sar import focus
from ullage.processing.summation import apex
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec, Rig
from ullage.world import scenes
from ullage.world.scene import Scene

HERE = Trajectory.stationary()
LOBE_DEG = 65.0
"""Opening that the thesis gives [deg] (4.3.1)."""
SPREAD_M = 0.15
"""Half thickness of the arc on which a reading is occupied [m]; the thesis prints none."""


def run(work: Workspace) -> None:
    """Check every term once."""
    work.log("eq. 4.2, term by term")
    intensity(work)
    axis(work)
    work.log("four sensors around the drone")
    opening(work)
    work.log("readings of Elfes' grid")
    readings(work)
    work.log("apex")
    vertex(work)


def _received(scene: Scene, spec: RadarSpec, path: Trajectory = HERE) -> Frames:
    return simulate(scene, path, spec, fidelity="thesis")


def _fine() -> RadarSpec:
    """Return a noiseless fan so dense that a plate's area is known to 2 %."""
    _, quiet = radars()
    return quiet.but(thesis=quiet.thesis.but(rays_per_side=300))


def _strength(distance_m: float, yaw_deg: float = 0.0, material: str = "pec") -> float:
    """Return the amplitude of a plate of 0.6 m, summed over range."""
    return float(_received(scenes.plate(0.6, 0.6, distance_m, yaw_deg, material), _fine()).samples.sum())


def intensity(work: Workspace) -> None:
    """Check range, cosine and coefficient of eq. 4.2, the ranges of echoes, the moving average and the noise."""
    hold = work.results.add_statement
    hold("a plate's amplitude summed over range is the same at 2 and 4 m: the ray's area grows as eq. 4.2 has it",
         "eq. 4.2", decibel(_strength(4.0) / _strength(2.0)), "dB", low=-0.5, high=0.5)  # fmt: skip
    hold("turned by 45 deg it loses 6 dB: 3 by the area across the rays, 3 by the cosine", "eq. 4.1 and 4.2",
         decibel(_strength(3.0, 45.0) / _strength(3.0)), "dB", low=-6.5, high=-5.5)  # fmt: skip
    wood = scenes.plate(0.6, 0.6, 3.0, material="wood").objects[0].material.reflection
    hold("a wooden plate's amplitude over a metal one's, less the ratio of their coefficients", "eq. 4.2",
         _strength(3.0, material="wood") / _strength(3.0) - wood, low=-0.01, high=0.01)  # fmt: skip
    errors = [_peak_m(_received(scenes.plate(0.6, 0.6, at), _fine())) - at for at in (1.5, 3.0, 4.5, 6.0)]
    hold("maxima of facing plates at 1.5 to 6 m lie at their ranges, largest error", "7.1",
         max(np.abs(errors)), "m", high=0.05)  # fmt: skip
    loud, quiet = radars()
    wall = scenes.plate(12.0, 4.0, 3.0)
    bare = quiet.but(thesis=quiet.thesis.but(smoothing_bins=1))
    tops = [_maxima(_received(wall, spec)) for spec in (quiet, bare)]
    hold(
        "share of the local maxima of a wall at 3 m that the moving average leaves", "4.4", tops[0] / tops[1], high=0.6
    )
    still = Trajectory.stationary(n=40)
    sigma = float(_received(Scene.empty(), loud, still).samples.std())
    expected = loud.thesis.noise_sigma / np.sqrt(loud.thesis.smoothing_bins)
    hold("white noise after averaging over its expected sigma", "4.3.3", sigma / expected, low=0.9, high=1.1)


def _peak_m(frames: Frames) -> float:
    row = frames.samples[0].astype(float)
    k = int(row.argmax())
    around = slice(k - 2, k + 3)
    return float(np.sum(frames.range_m[around] * row[around]) / row[around].sum())


def _maxima(frames: Frames) -> int:
    row = np.round(frames.samples[0].astype(float), 9)
    inside = row[1:-1]
    return int(np.sum((inside > row[:-2]) & (inside >= row[2:])))


def axis(work: Workspace) -> None:
    """Check R_max: a plate just inside it is received, a plate just outside is not."""
    _, quiet = radars()
    near, far = (float(_received(scenes.plate(2, 2, at), quiet).samples.max()) for at in (9.7, 10.3))
    hold = work.results.add_statement
    hold("a plate of 2 m at 9.7 m, within R_max, is received", "4.3.1", near, low=quiet.thesis.threshold)
    hold("the same at 10.3 m, beyond R_max, is not", "4.3.1", far, high=0.0)


def opening(work: Workspace) -> None:
    """Check what four openings of 65 deg cover together, by the rays and on the map."""
    _, quiet = radars()
    rig = Rig.preset("thesis-4", radar=quiet)
    turn = Trajectory(np.arange(360) * 10**8, np.zeros((360, 3)), rpy_quat(0, 0, np.radians(np.arange(360) + 0.5)))
    post = scenes.plate(0.05, 4.0, 4.0)
    frames = simulate(post, turn, rig, fidelity="thesis")
    seen = np.any([part.samples.max(1) > 0 for part in frames.values()], axis=0)
    hold = work.results.add_statement
    # 0.05 m at 4 m is thinner than the rays' spacing, so some headings within an opening miss it: the outermost count
    spans = [np.ptp(np.flatnonzero(np.roll(part.samples.max(1) > 0, 180 - _middle(part)))) + 1
             for part in frames.values()]  # fmt: skip
    hold("rays: headings between the first and the last at which each sensor receives a post, four sensors", "6.2",
         float(sum(spans)), "deg", low=252, high=262)  # fmt: skip
    hold("rays: share of those headings at which no ray meets the post, 0.05 m wide at 4 m", "7.1",
         1 - float(seen.sum() / sum(spans)), low=0.2, high=0.9)  # fmt: skip
    empty = simulate(Scene.empty(), HERE, rig, fidelity="thesis")
    grid = Grid.covering([[-6, -6, 0], [6, 6, 0]], 0.1, z_m=0.0)
    known = map_occupancy(empty, grid, method="elfes", threshold=1.0)
    y, x = np.meshgrid(grid.y_m, grid.x_m, indexing="ij")
    ring = abs(np.hypot(x, y) - 4.5) < 1.0
    hold("Elfes: part of the circle that four readings without an echo make known", "6.2",
         float(360 * (1 - known.unknown[ring].mean())), "deg", low=252, high=262)  # fmt: skip


def _middle(frames: Frames) -> int:
    """Return the circular mean of the headings that receive [deg]."""
    at = np.flatnonzero(frames.samples.max(1) > 0)
    return round(float(np.degrees(np.angle(np.exp(1j * np.radians(at)).sum())))) % 360


def readings(work: Workspace) -> None:
    """Compare three readings of the same place with f_e, f_o and the four steps, cell by cell."""
    grid = Grid((-1.0, -3.0, 0.0), 0.25, (24, 24))
    path = Trajectory(np.arange(3) * 10**8, np.array([[0, 0, 0], [0, 0.1, 0], [0, 0, 0]]),
                      rpy_quat(0, 0, np.radians([0.0, 35.0, -35.0])))  # fmt: skip
    reach = np.array([3.0, 1.8, 1.5])  # half of the later arcs is where the first reading found nothing
    spec = radars()[1]
    bins = np.round(reach / spec.bin_m).astype(int)
    rows = np.zeros((3, spec.bins), np.float32)
    rows[np.arange(3), bins] = 1.0
    frames = Frames(rows, spec.range_m, path.t_ns, spec, path, unit="thesis")
    got = map_occupancy(frames, grid, method="elfes").percent.astype(float)
    want = expected_percent(grid, path, spec.range_m[bins], spec.thesis.min_range_m)
    work.results.add_statement(
        "Elfes: three readings against f_e, f_o and the four steps, cell by cell (percent)",
        "5.2.2",
        float(abs(got - want).max()),
        high=1.0,
    )
    work.results.add_statement(
        "Elfes: cells that the three readings make more likely occupied than empty",
        "5.2.2",
        float(np.sum(got > 50)),
        "cells",
        low=10,
    )


def expected_percent(grid: Grid, path: Trajectory, reach_m: Floats, near_m: float) -> Floats:
    """Map readings by the formulas of [Elfes1987] with arrays over all cells; -1: unknown."""
    y, x = np.meshgrid(grid.y_m, grid.x_m, indexing="ij")
    empty, occupied = np.zeros(grid.shape), np.zeros(grid.shape)
    yaw = 2 * np.arctan2(path.quat_xyzw[:, 2], path.quat_xyzw[:, 3])
    spread = max(SPREAD_M, grid.step_m)
    for at, heading, reach in zip(path.position, yaw, reach_m, strict=True):
        dx, dy = x - at[0], y - at[1]
        distance = np.hypot(dx, dy)
        angle = np.angle(np.exp(1j * (np.arctan2(dy, dx) - heading))) / np.radians(LOBE_DEG / 2)
        across = np.where(abs(angle) <= 1, 1 - angle**2, 0)
        before = (distance >= near_m) & (distance < reach - spread)
        f_e = np.where(before, (1 - ((distance - near_m) / (reach - spread - near_m)) ** 2) * across, 0)
        empty += f_e - empty * f_e
        f_o = np.where(abs(distance - reach) <= spread, (1 - ((distance - reach) / spread) ** 2) * across, 0)
        f_o *= 1 - empty  # cancelled by cells that are known to be empty
        f_o /= f_o.sum()  # normalised along the arc
        occupied += f_o - occupied * f_o
    percent = np.where(occupied >= empty, 50 + 50 * occupied, 50 - 50 * empty)
    return np.where((occupied == 0) & (empty == 0), -1.0, percent)


def vertex(work: Workspace) -> None:
    """Check the apex of a thin target's hyperbola without noise; near the track it is not a parabola."""
    _, quiet = radars()
    path = Trajectory.line((0, -2, 0), (0, 2, 0), 0.5, 25)
    frames = simulate(scenes.wire(0.005, 3.0, 1.0), path, quiet.but(antenna="isotropic"))
    image = focus(frames, Grid.covering([[0.3, -2, 0], [4.0, 2, 0]], 0.05, z_m=0.0), method="summation")
    found = apex(image, look_deg=0.0)
    work.results.add_statement(
        "a wire passed at 1 m: the apex of the fitted hyperbola lies at it",
        "2.3.1",
        float(np.hypot(found[0] - 1.0, found[1])),
        "m",
        high=0.03,
    )
