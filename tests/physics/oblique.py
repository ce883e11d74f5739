"""Echoes of small conductors at oblique aspects, in the principal planes and off them, beside the method of moments.

`python tests/physics/oblique.py` prints the table of docs/fullwave.md (about a minute).
"""

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent))
import moments
from full_wave import db

import ullage as ul
from ullage.geometry import C0
from ullage.radar.physical import path_gain_cw
from ullage.world.materials import Material
from ullage.world.scene import Scene, SceneObject

F_HZ = 7.29e9
WAVE_M = C0 / F_HZ
FAR_M = 1.0
THETA_DEG = np.arange(0, 80, 5)
AZIMUTH_DEG = (0, 15, 30, 45)
BANDS_DEG = ((0, 25), (30, 45), (50, 60), (65, 75))
FIELDS = ("vertical", "horizontal")
BOX_M = 1.055 * WAVE_M  # between two resonances of the hollow cube, where the integral equation is sure
SHAPES = {"plate 2": (moments.plate, 2 * WAVE_M, 1), "plate 3": (moments.plate, 3 * WAVE_M, 1),
          "rectangle": (moments.plate, WAVE_M * np.array([2.3, 1.4]), 1),
          "box": (moments.box, BOX_M, 1),
          "dihedral 2": (moments.dihedral, 2 * WAVE_M, 2), "dihedral": (moments.dihedral, 3 * WAVE_M, 2)}  # fmt: skip


def views(theta_deg=THETA_DEG, azimuth_deg=AZIMUTH_DEG):
    """Angle off the x axis and azimuth about it (v) [deg]; places (v, 3) [m] and axes (v, 3, 3) of radars."""
    azimuth, theta = (a.ravel() for a in np.meshgrid(azimuth_deg, theta_deg, indexing="ij"))
    t, a = np.radians(theta), np.radians(azimuth)
    away = np.stack([np.cos(t), np.sin(t) * np.cos(a), np.sin(t) * np.sin(a)], 1)
    up = np.array([0, 0, 1.0]) - away * away[:, 2:]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return theta, azimuth, FAR_M * away, np.stack([-away, np.cross(up, -away), up], 2)


def truth(triangles, places, axes):
    """Path gain (2, v) by the method of moments, field upright and level."""
    body = moments.Moments(triangles, F_HZ)
    return np.array([body.path_gain(places, axes[:, :, column]) for column in (2, 1)])


def ours(triangles, places, axes, bounces):
    """The same by the physical radar."""
    vertices, faces = np.unique(np.round(triangles.reshape(-1, 3), 9), axis=0, return_inverse=True)
    pec = SceneObject("body", Material(name="pec", conductor=True, source="ideal conductor"))
    scene = Scene(vertices, faces.reshape(-1, 3), np.zeros(len(triangles), np.int32), (pec,))
    none = np.zeros((len(places), 3))
    path = ul.Trajectory(np.arange(len(places)) * 10**7, places, Rotation.from_matrix(axes).as_quat(), none, none)
    return np.array([
        path_gain_cw(scene, path, ul.RadarSpec.preset("x4m05", noise=None,
                     antenna={"kind": "isotropic", "polarization": field}), F_HZ, max_bounces=bounces)
        for field in FIELDS])  # fmt: skip


def compare(shape, per_wave=8):
    """Angles (v) and both path gains (2, v) of a shape: ours, method of moments."""
    build, size, bounces = SHAPES[shape]
    theta, azimuth, places, axes = views()
    reference = truth(build(size, WAVE_M / per_wave), places, axes)
    return theta, azimuth, ours(build(size, 10 * np.max(size)), places, axes, bounces), reference


def rows(shape, per_wave=8):
    """Per band of angles: median and greatest error [dB], and its greatest part of the strongest echo [dB]."""
    theta, azimuth, own, reference = compare(shape, per_wave)
    error, weak = abs(db(own) - db(reference)), db(own - reference) - db(reference).max()
    for low, high in BANDS_DEG:
        for off in (False, True):
            held = (theta >= low) & (theta <= high) & ((azimuth > 0) == off)
            yield low, high, off, np.median(error[:, held]), error[:, held].max(), weak[:, held].max()


if __name__ == "__main__":
    for name in sys.argv[1:] or SHAPES:
        for low, high, off, median, worst, weak in rows(name, 6 if name.startswith("dihedral") else 8):
            print(f"| {name} | {low} to {high} | {'off' if off else 'in'} | {median:.1f} | {worst:.1f} | {weak:.0f} |")
