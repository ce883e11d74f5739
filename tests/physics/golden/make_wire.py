"""Golden numbers of a rod and a thin wire in both polarisations, by gprMax 4.0.1: about two minutes on one core.

An upright rod of 4 mm radius (ka = 0.61), four cells across its radius, 124 mm long and 120 mm away, and a wire of
0.2 mm by the solver's own thin-wire model, 150 mm long and 200 mm away; a dipole along or across sends and receives.
"""

# ruff: noqa: RUF005 - arrays are added here, not joined

from pathlib import Path

import gprMax
import numpy as np
from fdtd import C0, FREQUENCY_HZ, PML, VERSION, dipole_strength, path_gain, run, spectrum

FREQUENCIES = FREQUENCY_HZ * np.array([0.9, 0.95, 1.0, 1.05, 1.1])
SCENES = {  # cell, range, length, radius [m], field
    "rod": (0.001, 0.120, 0.124, 0.004, "z"),
    "rod across": (0.001, 0.120, 0.124, 0.004, "y"),
    "wire": (0.0025, 0.200, 0.150, 0.0002, "z"),
    "wire across": (0.0025, 0.200, 0.150, 0.0002, "y"),
}


def measure(cell, range_m, length, radius, pol):
    air = PML + 12
    n, half, fat = round(range_m / cell), round(length / cell / 2), int(np.ceil(radius / cell))
    centre = np.array([air + fat, air + fat, air + half])
    source, beside = centre + [n, 0, 0], centre + [n - n // 3, 0, 0]
    size = np.array([source[0] + air, 2 * centre[1], 2 * centre[2]]) + 1

    def at(c):
        return tuple(float(v) * cell for v in c)

    ends = at(centre - [0, 0, half]), at(centre + [0, 0, half])
    thing = (gprMax.ThinWire(p1=ends[0], p2=ends[1], radius=radius) if radius < cell / 2 else
             gprMax.Cylinder(p1=ends[0], p2=ends[1], r=radius, material_id="pec"))  # fmt: skip
    # long enough for waves that run along the wire and back
    seconds = (2 * np.hypot(range_m, length / 2) + 2 * length) / C0 + 0.5e-9
    part = "E" + pol
    fields, dt = run("wire", (cell,) * 3, at(size), seconds, thing,
                     gprMax.Waveform(wave_type="ricker", amp=1.0, freq=FREQUENCY_HZ, id="w"),
                     gprMax.HertzianDipole(polarisation=pol, p1=at(source), waveform_id="w"),
                     gprMax.Rx(p1=at(source), id="here", outputs=[part]),
                     gprMax.Rx(p1=at(beside), id="near", outputs=[part]))  # fmt: skip
    apart = (source - beside)[0] * cell
    direct = spectrum(fields["near", part], dt, FREQUENCIES, until_s=(2 * range_m - apart) / C0)
    back = spectrum(fields["here", part], dt, FREQUENCIES, after_s=2 * (range_m - radius) / C0 - 0.15e-9)
    return path_gain(back, dipole_strength(direct, apart, FREQUENCIES), FREQUENCIES)


def main():
    gains = []
    for name, scene in SCENES.items():
        gains.append(measure(*scene))
        print(name, np.round(20 * np.log10(abs(gains[-1])), 2), flush=True)
    _, range_m, length, radius, pol = zip(*SCENES.values(), strict=True)
    np.savez(Path(__file__).with_name("wire.npz"), version=VERSION, frequency_hz=FREQUENCIES, name=list(SCENES),
             path_gain=np.array(gains), distance_m=range_m, length_m=length, radius_m=radius, pol=pol)  # fmt: skip


if __name__ == "__main__":
    main()
