"""Golden numbers of a plate and a slab in three dimensions, by gprMax 4.0.1: about six minutes on one core.

A conducting plate of 3 x 3 wavelengths, 7.3 wavelengths away, seen by an elementary dipole that sends and receives.
Plate and slab lie along the grid and the dipole goes round them, so no surface is a staircase. The field that
comes back to the source is separated from the outgoing one by time.
"soft": field along the plate's axis of tilt; "hard": across.
"""

# ruff: noqa: RUF005 - arrays are added here, not joined

import sys
from pathlib import Path

import gprMax
import numpy as np
from fdtd import FREQUENCY_HZ, PML, VERSION, dipole_strength, path_gain, run, spectrum

CELL = 0.0025
HALF = 25  # cells from the plate's centre to its edge
RANGE_M = 0.3
BESIDE = 36  # cells from the dipole to the receiver that measures its strength
AIR = 10  # cells between anything and the absorber
FREQUENCIES = FREQUENCY_HZ * np.array([0.9, 0.95, 1.0, 1.05, 1.1])
SLAB = {"er": 2.73, "se": 0.0549, "thick": 3}  # plasterboard of 7.5 mm at 7.29 GHz


def place(tilt_deg):
    """Grid places of the plate's centre and the dipole, and the domain's size [cells]."""
    tilt = np.radians(tilt_deg)
    dx, dy = (round(RANGE_M / CELL * f) for f in (np.cos(tilt), np.sin(tilt)))
    edge = PML + AIR
    plate = np.array([edge + 6, edge + HALF, edge + HALF])
    source = plate + [dx, dy, 0]
    size = np.array([source[0] + edge, max(plate[1] + HALF, source[1]) + edge, plate[2] + HALF + edge])
    return plate, source, size + 1


def at(cells):
    return tuple(float(c) * CELL for c in cells)


def sources(source, beside, tilt, pol):
    """Dipole and receivers. In the plane of tilt it is four dipoles whose mean lies on the grid point."""
    x, y = np.array([1, 0, 0]), np.array([0, 1, 0])
    waves = [gprMax.Waveform(wave_type="ricker", amp=a, freq=FREQUENCY_HZ, id=n)
             for n, a in (("wz", 1.0), ("wx", -np.sin(tilt) / 2), ("wy", np.cos(tilt) / 2))]  # fmt: skip
    spots = [(n, at(p)) for who, c in (("here", source), ("near", beside))
             for n, p in ((who, c), (who + "-x", c - x), (who + "-y", c - y))]  # fmt: skip
    listen = [gprMax.Rx(p1=p, id=n, outputs=["Ex", "Ey", "Ez"]) for n, p in spots]
    if pol == "soft":
        return [waves[0], gprMax.HertzianDipole(polarisation="z", p1=at(source), waveform_id="wz"), *listen]
    send = [gprMax.HertzianDipole(polarisation=c, p1=at(p), waveform_id="w" + c)
            for c, d in (("x", x), ("y", y)) for p in (source, source - d)
            if c == "y" or abs(np.sin(tilt)) > 0]  # fmt: skip
    return [*(waves[1:] if abs(np.sin(tilt)) > 0 else waves[2:]), *send, *listen]


def felt(fields, who, tilt, pol):
    """The field along the dipole."""
    if pol == "soft":
        return fields[who, "Ez"]
    ex = (fields[who, "Ex"] + fields[who + "-x", "Ex"]) / 2
    ey = (fields[who, "Ey"] + fields[who + "-y", "Ey"]) / 2
    return -np.sin(tilt) * ex + np.cos(tilt) * ey


def body(kind, plate):
    low, high = plate - [0, HALF, HALF], plate + [0, HALF, HALF]
    if kind == "pec":
        return [gprMax.Plate(p1=at(low), p2=at(high), material_id="pec")]
    if kind == "slab":
        board = gprMax.Material(er=SLAB["er"], se=SLAB["se"], mr=1, sm=0, id="board")
        return [board, gprMax.Box(p1=at(low - [SLAB["thick"], 0, 0]), p2=at(high), material_id="board")]
    return []


def measure(kind, tilt_deg, pol):
    """Path gain at FREQUENCIES, and the true range and tilt on the grid."""
    plate, source, size = place(tilt_deg)
    gap = (plate - source) * CELL
    distance, tilt = np.linalg.norm(gap), np.arctan2(-gap[1], -gap[0])
    # the strength is measured on the way to the plate, broadside to the dipole, before anything comes back
    beside = source + np.round((plate - source) / np.linalg.norm(plate - source) * BESIDE).astype(int)
    apart = np.linalg.norm(beside - source) * CELL
    seconds = (2 * distance + 0.28) / 299792458.0 + 0.35e-9
    fields, dt = run(f"{kind} {tilt_deg} {pol}", (CELL,) * 3, at(size), seconds,
                     *body(kind, plate), *sources(source, beside, tilt, pol))  # fmt: skip
    gate = 2 * (distance - 0.10) / 299792458.0
    direct = spectrum(felt(fields, "near", tilt, pol), dt, FREQUENCIES, until_s=apart / 299792458.0 + 0.75e-9)
    back = spectrum(felt(fields, "here", tilt, pol), dt, FREQUENCIES, after_s=gate)
    return path_gain(back, dipole_strength(direct, apart, FREQUENCIES), FREQUENCIES), distance, np.degrees(tilt)


PLATE = [("pec", t, p) for t in (0, 10, 25, 45) for p in ("soft", "hard") if (t, p) != (0, "hard")]
BOARD = [("slab", 0, "soft"), ("slab", 10, "soft"), ("none", 0, "soft")]


def main(name, scenes):
    rows = []
    for scene in scenes:
        rows.append((*scene, *measure(*scene)))
        print(*scene, np.round(20 * np.log10(abs(rows[-1][3])), 2), *rows[-1][4:], flush=True)
    kind, _, pol, gain, distance, tilt = zip(*rows, strict=True)
    np.savez(Path(__file__).with_name(name), version=VERSION, frequency_hz=FREQUENCIES, kind=kind, pol=pol,
             path_gain=np.array(gain), distance_m=distance, tilt_deg=tilt, edge_m=2 * HALF * CELL,
             cell_m=CELL, slab=[SLAB["er"], SLAB["se"], SLAB["thick"] * CELL])  # fmt: skip


if __name__ == "__main__":
    for name, scenes in (("plate.npz", PLATE), ("board.npz", BOARD)):
        if name in sys.argv[1:] or len(sys.argv) < 2:
            main(name, scenes)
