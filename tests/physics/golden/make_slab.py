"""Golden numbers of an endless plasterboard in two dimensions, by gprMax 4.0.1: about a minute on one core.

A line source 150 mm above a board of 7.5 mm, receivers above and below it at several offsets, in both polarisations:
TE (field along the line) and TM (magnetic line source). Each field is divided by the free field at the same length of
path, from the strength of the line source measured in a run without the board.
"""

from pathlib import Path

import gprMax
import numpy as np
from fdtd import C0, FREQUENCY_HZ, PML, VERSION, run, spectrum
from scipy.special import hankel2

CELL = 0.00125
THICK = 6  # cells
HEIGHT = 120  # cells between the board's face and source and receivers, above and below
ANGLES = np.array([0, 15, 30, 45, 60])
AIR = 24
BOARD = {"er": 2.73, "se": 0.0549}
OFFSETS = np.round(2 * HEIGHT * np.tan(np.radians(ANGLES))).astype(int)  # cells along the board


EDGE = PML + AIR
SECONDS = (2 * HEIGHT + THICK) * CELL / np.cos(np.radians(ANGLES.max())) / C0 + 1.0e-9


def fields_of(pol, *, board):
    """Spectra at the receivers above and below (2, angles), with or without the board."""
    face = EDGE + HEIGHT + THICK
    level = {"above": face + HEIGHT, "below": EDGE}
    endless = float("inf")

    def at(x, y):
        return (x * CELL, y * CELL, endless)

    part, send, mode = ("Ez", gprMax.HertzianDipole, "TM") if pol == "TE" else ("Hz", gprMax.MagneticDipole, "TE")
    size = (EDGE + OFFSETS.max() + EDGE, level["above"] + EDGE)
    held = [gprMax.Material(er=BOARD["er"], se=BOARD["se"], mr=1, sm=0, id="board"),
            gprMax.Box(p1=(0, (face - THICK) * CELL, -endless), p2=at(size[0], face), material_id="board")]  # fmt: skip
    fields, dt = run("board " + pol, (CELL,) * 3, at(*size), SECONDS, gprMax.DomainMode(mode), *(held if board else ()),
                     gprMax.Waveform(wave_type="ricker", amp=1.0, freq=FREQUENCY_HZ, id="w"),
                     send(polarisation="z", p1=at(EDGE, level["above"]), waveform_id="w"),
                     *(gprMax.Rx(p1=at(EDGE + x, y), id=f"{side}{x}", outputs=[part])
                       for side, y in level.items() for x in OFFSETS))  # fmt: skip
    return np.array([[spectrum(fields[f"{side}{x}", part], dt, FREQUENCY_HZ)[0] for x in OFFSETS] for side in level])


def measure(pol):
    """Field thrown back and field let through, over the free field at the same length of path (angles) each."""
    free, both = fields_of(pol, board=False), fields_of(pol, board=True)
    # paths: mirrored in the face; straight on without the board, which is then as long as without it
    mirrored, straight = np.hypot(OFFSETS, 2 * HEIGHT), np.hypot(OFFSETS, 2 * HEIGHT + THICK)
    ratio = hankel2(0, 2 * np.pi * FREQUENCY_HZ / C0 * CELL * mirrored)
    ratio /= hankel2(0, 2 * np.pi * FREQUENCY_HZ / C0 * CELL * straight)
    return (both[0] - free[0]) / (free[1] * ratio), both[1] / free[1]


def main():
    back, through = zip(*(measure(pol) for pol in ("TE", "TM")), strict=True)
    for pol, r, t in zip(("TE", "TM"), back, through, strict=True):
        print(pol, np.round(abs(r), 4), np.round(abs(t), 4))
    np.savez(Path(__file__).with_name("slab.npz"), version=VERSION, frequency_hz=FREQUENCY_HZ, pol=["TE", "TM"],
             reflected=np.array(back), passed=np.array(through), offset_m=OFFSETS * CELL, height_m=HEIGHT * CELL,
             thickness_m=THICK * CELL, material=[BOARD["er"], BOARD["se"]])  # fmt: skip


if __name__ == "__main__":
    main()
