"""Draws docs/pictures/fullwave.png from the golden numbers: `python tests/physics/golden/draw.py`."""

# ruff: noqa: E402 - the comparison lies one folder up

import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from full_wave import db, dipole, golden, ours_plate, ours_slab, ours_wire
from fullwave_figure import draw_fullwave


def main():
    with tempfile.TemporaryDirectory() as folder:
        radars = {"soft": dipole(folder, "v"), "hard": dipole(folder, "h")}
        g, middle = golden("plate"), 2
        ours = np.array([ours_plate(g, i, radars[str(g["pol"][i])])[middle] for i in range(len(g["kind"]))])
        plate = {}
        for pol in ("soft", "hard"):
            mine = g["pol"] == pol
            plate[f"field {'along' if pol == 'soft' else 'across'} axis"] = (
                g["tilt_deg"][mine], db(g["path_gain"][mine, middle]), db(ours[mine]))  # fmt: skip
        g = golden("wire")
        wire = {str(n): (g["frequency_hz"] / 1e9, db(g["path_gain"][i]),
                         db(ours_wire(g, i, radars["soft" if g["pol"][i] == "z" else "hard"])))
                for i, n in enumerate(g["name"][:3])}  # fmt: skip
    g = golden("slab")
    ours, angle = ours_slab(g), np.degrees(np.arctan(g["offset_m"] / 2 / g["height_m"]))
    board = {f"{pol} {name}": (angle, abs(g[name][i]), abs(ours[i, side]))
             for i, pol in enumerate(g["pol"]) for side, name in enumerate(("reflected", "passed"))}  # fmt: skip
    draw_fullwave(HERE.parents[2] / "docs/pictures/fullwave.png", {
        "plate, 3 wavelengths square": ("tilt [deg]", "path gain at 7.29 GHz [dB]", plate),
        "rod of 4 mm, wire of 0.2 mm": ("frequency [GHz]", "path gain [dB]", wire),
        "plasterboard of 7.5 mm, endless": ("incidence [deg]", "amplitude over free path", board),
    })  # fmt: skip


if __name__ == "__main__":
    main()
