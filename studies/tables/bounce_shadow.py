"""How well paths of several bounces are told free or hidden by some points of their Fresnel zones.

    python -m studies.tables.bounce_shadow [frames]

Frames of the cargo hold along its flight, as they are and with one point a path, each against zones of all paths laid
out densely: what differs, in dB of the frame's peak, and what a frame costs.
"""

import sys
import time

import numpy as np

import ullage as ul
from ullage.radar import zones
from ullage.radar.physical import echoes
from ullage.world.library import WORLDS

RADAR = ul.RadarSpec.preset("x4m05", noise=None)


def frames(hold, path, **settings):
    """Echoes with these settings of the zones, and CPU-ms a frame."""
    kept = {name: getattr(zones, name) for name in settings}
    for name, value in settings.items():
        setattr(zones, name, value)
    start = time.process_time()
    out = echoes(hold, path, RADAR, max_bounces=3)
    spent = (time.process_time() - start) / len(path) * 1e3
    for name, value in kept.items():
        setattr(zones, name, value)
    return out, spent


def main(count):
    hold = ul.load_scene(WORLDS["cargo-hold"].path)
    whole = ul.Trajectory.line((-11.5, -7, 4), (11, -7, 4), 0.5, 17)
    path = whole[np.linspace(0, len(whole) - 1, count).astype(int)]
    frames(hold, path[:1])
    dense, _ = frames(hold, path, RAYS=96, CELLS=60, HALVINGS=3, BEST=200, FAINT=0, LAST=6 * np.pi)
    peak = abs(dense).max(1)
    for name, settings in {"one point": {"BEST": 0}, "as they are": {}}.items():
        ours, spent = frames(hold, path, **settings)
        worst = 20 * np.log10(np.maximum(abs(ours - dense).max(1), 1e-30) / peak)
        total = 10 * np.log10((abs(ours - dense) ** 2).sum(1) / (abs(dense) ** 2).sum(1))
        print(f"{name}: worst bin against the frame's peak: median {np.median(worst):.0f} dB, 9 of 10 below "
              f"{np.quantile(worst, 0.9):.0f}, worst {worst.max():.0f}; power of the difference: median "
              f"{np.median(total):.0f} dB, worst {total.max():.0f}; {spent:.1f} CPU-ms a frame")  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
