"""The engine's side of the comparison with golden full-wave numbers."""

from pathlib import Path

import numpy as np
from scipy.special import hankel2

import ullage as ul
from ullage.geometry import C0
from ullage.radar.penetration import slab
from ullage.radar.physical import path_gain_cw
from ullage.world.materials import Material
from ullage.world.scene import Scene, SceneObject

GOLDEN = Path(__file__).parent / "golden"


def golden(name):
    with np.load(GOLDEN / f"{name}.npz") as file:
        return {key: file[key] for key in file.files}


def db(value):
    return 20 * np.log10(abs(np.asarray(value)))


def dipole(folder, pol):
    """The radar with the pattern of an elementary dipole along z ("v") or y ("h")."""
    path = Path(folder) / f"dipole_{pol}.csv"
    azimuth, elevation = (a.ravel() for a in np.meshgrid(np.arange(-180, 181, 3.0), np.arange(-90, 91, 3.0)))
    a, e = np.radians(azimuth), np.radians(elevation)
    along = np.sin(e) if pol == "v" else np.cos(e) * np.sin(a)
    dbi = 10 * np.log10(1.5 * np.maximum(1 - along**2, 1e-6))
    rows = [f"{x:g},{y:g},{z:.5f}" for x, y, z in zip(azimuth, elevation, dbi, strict=True)]
    path.write_text("azimuth_deg,elevation_deg,gain_dbi\n" + "\n".join(rows) + "\n")
    field = {"v": "vertical", "h": "horizontal"}[pol]
    return ul.RadarSpec.preset("x4m05", noise=None,
                               antenna={"kind": "table", "file": str(path), "polarization": field})  # fmt: skip


def spectrum_of(scene, radar, frequencies):
    return np.array([path_gain_cw(scene, ul.Trajectory.stationary(), radar, float(f))[0] for f in frequencies])


def ours_plate(g, i, radar):
    size = float(g["edge_m"])
    scene = ul.scenes.plate(size, size, float(g["distance_m"][i]), yaw_deg=float(g["tilt_deg"][i]))
    if g["kind"][i] == "slab":
        er, se, thick = (float(v) for v in g["slab"])
        board = Material(name="board", a=er, c=se, thickness_m=thick, valid_ghz=(1, 20), source="golden")
        scene = Scene(scene.vertices, scene.faces, scene.face_object, (SceneObject("board", board),))
    return spectrum_of(scene, radar, g["frequency_hz"])


def ours_wire(g, i, radar):
    scene = ul.scenes.wire(float(g["radius_m"][i]), float(g["length_m"][i]), float(g["distance_m"][i]))
    return spectrum_of(scene, radar, g["frequency_hz"])


def ours_slab(g):
    """Reflected and passed (2, 2, angles) by ullage's slab, summed over the plane waves of a line source."""
    f, height, thick = float(g["frequency_hz"]), float(g["height_m"]), float(g["thickness_m"])
    er, se = g["material"]
    eps = complex(er, -se / (2 * np.pi * f * 8.8541878128e-12))
    k, x = 2 * np.pi * f / C0, g["offset_m"][:, None]
    angle = (np.arange(40000) + 0.5) / 40000 * np.pi - np.pi / 2
    te, tm, through_te, through_tm = slab(eps, thick, f, np.cos(angle))
    down, straight = 2 * height, 2 * height + thick
    wave = np.exp(-1j * k * (down * np.cos(angle) + x * np.sin(angle))) / 40000
    far = np.exp(-1j * k * (straight * np.cos(angle) + x * np.sin(angle))) / 40000
    mirrored, free = hankel2(0, k * np.hypot(x[:, 0], down)), hankel2(0, k * np.hypot(x[:, 0], straight))
    out = []
    for back, through in ((te, through_te), (-tm, through_tm)):
        grazing = -1.0  # both reach -1 at grazing; that part is the mirror image's field
        out.append([(wave @ (back - grazing)) / mirrored + grazing, (far @ through) / free])
    return np.array(out)
