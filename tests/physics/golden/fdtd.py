"""What the three scripts that make golden numbers share: a run of gprMax 4.0.1, and fields at one frequency from it.

gprMax [Warren2016] solves Maxwell's equations on a Yee grid and shares no line and no idea with ullage. It is
not needed to run the tests: the scripts wrote the .npz files beside them. To write them anew:

    python -m venv fdtd && fdtd/bin/pip install gprMax==4.0.1 && fdtd/bin/python make_plate.py
"""

from __future__ import annotations

import tempfile
from importlib.metadata import version
from pathlib import Path

import gprMax
import h5py
import numpy as np

C0 = 299_792_458.0
VERSION = "4.0.1"
FREQUENCY_HZ = 7.29e9
PML = 10  # cells


def run(name, cell_m, domain_m, seconds, *things):
    """Fields over time: a dict of arrays by (receiver, component), and the time step [s]."""
    if version("gprMax") != VERSION:
        raise SystemExit(f"these numbers belong to gprMax {VERSION}, this is {version('gprMax')}")
    scene = gprMax.Scene()
    steps = [
        gprMax.Title(name=name),
        gprMax.Discretisation(p1=cell_m),
        gprMax.Domain(p1=domain_m),
        gprMax.TimeWindow(time=seconds),
        gprMax.OMPThreads(n=1),
        *things,
    ]
    for thing in steps:
        scene.add(thing)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run.h5"
        gprMax.run(scenes=[scene], n=1, outputfile=out, cpu_precision="single", log_level=40,
                   hide_progress_bars=True, allow_underresolved=True)  # fmt: skip
        with h5py.File(out) as file:
            fields = {}
            for rx in file["rxs"].values():
                who = rx.attrs["Name"]
                who = who.decode() if isinstance(who, bytes) else who
                fields.update({(who, part): np.asarray(rx[part], float) for part in rx})
            return fields, float(file.attrs["dt"])


def spectrum(field, dt, frequencies_hz, after_s=0.0, until_s=np.inf):
    """The field at some frequencies (e^{+jwt}), from a part of the record that begins and ends softly."""
    t = np.arange(len(field)) * dt
    until = min(until_s, t[-1])
    soft = 0.15e-9
    keep = np.clip((t - after_s) / soft, 0, 1) if after_s > 0 else np.ones(len(t))
    keep = keep * np.clip((until - t) / soft, 0, 1)
    gate = np.sin(keep * np.pi / 2) ** 2
    return np.array([np.sum(gate * field * np.exp(-2j * np.pi * f * t)) for f in np.atleast_1d(frequencies_hz)])


def dipole_strength(field, distance_m, frequencies_hz):
    """Far field at 1 m, phase of the path taken out, from the field beside an elementary dipole."""
    k = 2 * np.pi * np.atleast_1d(frequencies_hz) / C0
    x = k * distance_m
    return field * distance_m * np.exp(1j * x) / (1 + 1 / (1j * x) - 1 / x**2)


def path_gain(scattered, strength, frequencies_hz):
    """sqrt(received / transmitted power) between lossless dipoles (gain 1.5) from field and source strength."""
    wave = C0 / np.atleast_1d(frequencies_hz)
    return 1.5 * wave / (4 * np.pi) * scattered / strength
