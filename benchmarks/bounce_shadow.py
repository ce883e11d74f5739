"""How much it matters that a path of several bounces is held to be free or hidden by one point of its last face.

    python benchmarks/bounce_shadow.py [frames]

Frames of the cargo hold along its flight, as they are and as the mean over 13 points of each path's Fresnel zone
on that face: what differs, in dB of the frame's peak.
"""

import sys

import numpy as np

import ullage as ul
from ullage.kernels import rims
from ullage.radar import multipath
from ullage.radar.flats import _ZONE
from ullage.radar.physical import echoes
from ullage.world.library import WORLDS

RADAR = ul.RadarSpec.preset("x4m05", noise=None)
plain, clear = multipath._through, multipath.clear


def watch(offset):
    """Have paths held free or hidden by a point off the usual one, where that too lies on the lit part of the face."""
    seen = {}

    def through(flats, view, beams, lit):
        path = plain(flats, view, beams, lit)
        way = np.linalg.norm(np.diff(path, axis=1), axis=2).sum(1)
        moved = lit + np.sqrt(RADAR.wavelength_m * way / 4)[:, None] * (offset @ flats.across[beams.ends_on])
        within = np.empty(len(moved), np.bool_)
        starts, ends = (np.ascontiguousarray(beams.edges[:, k]) for k in range(2))
        rims.inside(moved, np.arange(len(moved)), flats.normals[beams.ends_on], beams.first, starts, ends, within)
        seen["path"] = plain(flats, view, beams, np.where(within[:, None], moved, lit))
        return path

    multipath._through = through
    multipath.clear = lambda parts, path, wanted: clear(parts, seen["path"], wanted)


def main(count):
    hold = ul.load_scene(WORLDS["cargo-hold"].path)
    whole = ul.Trajectory.line((-11.5, -7, 4), (11, -7, 4), 0.5, 17)
    path = whole[np.linspace(0, len(whole) - 1, count).astype(int)]
    zone = []
    for offset in _ZONE:
        watch(offset)
        zone.append(echoes(hold, path, RADAR, max_bounces=3))
    one, mean = zone[0], np.mean(zone, axis=0)
    peak = abs(one).max(1)
    worst = 20 * np.log10(np.maximum(abs(mean - one).max(1), 1e-30) / peak)
    total = 10 * np.log10((abs(mean - one) ** 2).sum(1) / (abs(one) ** 2).sum(1))
    print(f"worst bin against the frame's peak: median {np.median(worst):.0f} dB, 9 of 10 below "
          f"{np.quantile(worst, 0.9):.0f}, worst {worst.max():.0f}")  # fmt: skip
    print(f"power of the difference against the frame's: median {np.median(total):.0f} dB, worst {total.max():.0f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
