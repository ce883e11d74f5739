"""Draw the figures of the validation page: results and references over angle, frequency, radius and size."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from studies.validation import oracles
from studies.validation.rows import db, gain, gain_via, radar
from ullage.data import Trajectory
from ullage.geometry import C0
from ullage.radar.explain import explain
from ullage.radar.physical import echoes
from ullage.world import scenes


def draw(folder: Path) -> list[tuple[str, str]]:
    """Draw every figure into a folder; return titles and file names."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    figures: tuple[tuple[str, str, Callable[[Any], None]], ...] = (
        ("A 0.5 m plate at 3 m turned away from the radar", "plate_tilt.png", _tilt),
        ("A conducting sphere of 0.1 m against Mie's series, over frequency", "sphere_mie.png", _sphere),
        ("Wires at 3 m against the Bessel series, over radius", "wire_bessel.png", _wire),
        ("A 0.3 m dihedral at 5 m turned about its fold", "dihedral.png", _dihedral),
        (
            "A 0.3 m trihedral at 5 m turned about the vertical; dotted: closed form on axis",
            "trihedral.png",
            _trihedral,
        ),
        (
            "Corner of floor and wall of a round tank of 2 m radius and 48 strips, along x at y = 0.2 m",
            "tank.png",
            _tank,
        ),
        ("Fresnel zones of a growing plate at 3 m", "growing_plate.png", _growing),
        ("Echogram of a concrete room with a plate, up to three bounces", "room.png", _room),
    )
    for title, name, fill in figures:
        figure = Figure(figsize=(7.5, 4.2), layout="constrained")
        axes = figure.add_subplot()
        fill(axes)
        axes.set_title(title, fontsize=10)
        axes.grid(alpha=0.3)
        axes.set_ylabel("path gain [dB]")
        figure.savefig(folder / name, dpi=110)
    return [(title, name) for title, name, _ in figures]


def _both(axes: Any, x: Any, ours: list[float], reference: list[float], name: str, label: str) -> None:
    axes.plot(x, reference, color="0.6", lw=3, label=name)
    axes.plot(x, ours, color="C0", lw=1.2, label="ullage")
    axes.set_xlabel(label)
    axes.legend()


def _tilt(axes: Any) -> None:
    x = np.linspace(0, 60, 121)
    turned = [scenes.plate(0.5, 0.5, 3.0, yaw_deg=t) for t in x]
    ours = [db(gain(plate, edges=False)) for plate in turned]
    want = [db(oracles.dense_plate(0.5, 3.0, 7.29e9, t)) for t in x]
    _both(axes, x, ours, want, "dense Kirchhoff integral", "turn [deg]")
    axes.lines[-1].set_label("ullage without edges")
    for name, colour in (("vertical", "C2"), ("horizontal", "C1")):
        edged = [db(gain(plate, spec=radar(name))) for plate in turned]
        axes.plot(x, edged, colour, lw=1.2, label=f"ullage, {name} field")
    cosine = ours[0] + 20 * np.log10(np.cos(np.radians(x)))
    axes.plot(x, cosine, "C3--", lw=1, label="cosine law of the ray model")
    axes.legend(fontsize=8)


def _sphere(axes: Any) -> None:
    x = np.linspace(6.2e9, 8.4e9, 45)
    ball, r, a = scenes.sphere(0.1, 8.0), 8.0, 0.1
    want = [db(C0 / f * np.sqrt(oracles.mie_width(a, f)) / (4 * np.pi) ** 1.5 / r / np.sqrt(r * (r - a))
               * np.sqrt(r / (r - a)) ** 2 * np.sqrt((r - a) / r)) for f in x]  # fmt: skip
    _both(axes, x / 1e9, [db(gain(ball, hz=f)) for f in x], want, "Mie", "frequency [GHz]")


def _wire(axes: Any) -> None:
    x = np.geomspace(5e-4, 0.05, 40)
    for tm, polarization, style in ((True, "vertical", "-"), (False, "horizontal", "--")):
        name = "TM" if tm else "TE"
        want = [db(oracles.wire_gain(a, 3.0, 7.29e9, tm=tm)) for a in x]
        ours = [db(gain(scenes.wire(a, 30.0, 3.0), spec=radar(polarization))) for a in x]
        axes.plot(x * 1e3, want, style, color="0.6", lw=3, label=f"Bessel series, {name}")
        axes.plot(x * 1e3, ours, style, color="C0", lw=1.2, label=f"ullage, {name}")
    axes.set_xscale("log")
    axes.set_xlabel("radius [mm]")
    axes.legend()


def _dihedral(axes: Any) -> None:
    x = np.linspace(-15, 15, 61)
    want = [db(oracles.dense_dihedral(0.3, 5.0, 7.29e9, t)) for t in x]
    ours = []
    for t in x:
        scene = scenes.dihedral(0.3, 5.0, yaw_deg=float(t))
        ours.append(db(gain(scene, bounces=2) - gain(scene)))
    _both(axes, x, ours, want, "dense integral", "turn [deg]")


def _trihedral(axes: Any) -> None:
    x = np.linspace(-30, 30, 61)
    wave = radar().wavelength_m
    ours = [db(gain(scenes.trihedral(0.3, 5.0, yaw_deg=float(t)), bounces=3)) for t in x]
    axis = db(wave * np.sqrt(4 * np.pi * 0.3**4 / 3 / wave**2) / (4 * np.pi) ** 1.5 / 25)
    axes.axhline(axis, color="0.6", ls=":", lw=2)
    axes.plot(x, ours, color="C0", lw=1.2)
    axes.set_xlabel("turn [deg]")


def _tank(axes: Any) -> None:
    scene, spec = scenes.tank(2.0, 1.2, "pec", strips=48), radar("horizontal")
    track = Trajectory.line((0.6, 0.2, 0.5), (1.0, 0.2, 0.5), 0.5, 60)
    double, triple = ([gain_via(scene, track[i : i + 1], spec, "wall", via) for i in range(len(track))]
                      for via in (("floor",), ("floor", "floor")))  # fmt: skip
    want = [oracles.dense_tank(48, 2.0, 1.2, at, spec.center_hz) for at in track.position]
    x = track.position[:, 0]
    _both(axes, x, [db(v) for v in double], [db(v[0]) for v in want], "dense integral", "x [m]")
    axes.plot(x, [db(v[1]) for v in want], color="0.6", lw=3)
    axes.plot(x, [db(v) for v in triple], color="C1", lw=1.2, label="ullage, over the floor there and back")
    axes.legend()


def _growing(axes: Any) -> None:
    x = np.linspace(0.05, 2.0, 118)
    ours = [db(gain(scenes.plate(s, s, 3.0))) for s in x]
    want = [db(oracles.dense_plate(s, 3.0, 7.29e9)) for s in x]
    _both(axes, x, ours, want, "dense Kirchhoff integral", "edge [m]")
    axes.axhline(db(radar().wavelength_m / (8 * np.pi * 3)), color="C3", ls="--", lw=1, label="endless plane")
    axes.legend()


def _room(axes: Any) -> None:
    scene = scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    at = Trajectory.stationary((0.1, 0.35, 0.2))
    spec = radar().but(antenna={"kind": "x4a02"})
    for bounces, colour in ((3, "C1"), (1, "C0")):
        frame = echoes(scene, at, spec, max_bounces=bounces)[0]
        level = 20 * np.log10(np.maximum(abs(frame), 1e-8))
        axes.plot(spec.range_m, level, color=colour, lw=1, label=f"{bounces} bounce{'s' * (bounces > 1)}")
    for k, c in enumerate(explain(scene, at, spec, max_bounces=3, count=9)):
        names = " > ".join((*c.via, c.object)).replace("wall_", "")
        axes.annotate(names, (c.range_m, c.path_gain_db), xytext=(4, 6 + 9 * (k % 3)), textcoords="offset points",
                      fontsize=6, arrowprops={"arrowstyle": "-", "lw": 0.4})  # fmt: skip
    axes.set_ylim(-125, -40)
    axes.set_xlabel("range [m]")
    axes.legend(loc="upper right")
