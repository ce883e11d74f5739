"""What autofocus wins back of an image that white errors of the poses have blurred: five seeds, mean and 95 % interval.

Three upright poles of 1 cm before one X4M05 that passes 1.4 m at 0.5 m/s and 25 frames a second, with the receiver's
noise; a free-space image on the plane of the flight, cells of 1 cm.

python benchmarks/autofocus_table.py [--seeds 5] [--white 0.003] [--figure docs/pictures/autofocus.png]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from mapping_table import print_table

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.grids import Image
from ullage.processing.autofocus import autofocus
from ullage.world.scene import Scene

POLES = ((2.0, 0.1), (2.6, -0.5), (3.1, 0.6))
GRID = ul.Grid((1.4, -1.0, 0), 0.01, (200, 220))
COLUMNS = {
    "entropy": "entropy [nat]",
    "peak": "peak against exact [dB]",
    "width": "-3 dB width across [cm]",
    "pslr": "highest side lobe across [dB]",
    "error": "place [cm]",
    "pose": "pose error along sight [mm]",
}


def scored(frames: Frames, image: Image, sharp: Image) -> dict[str, float]:
    """Width, side lobe and place of the nearest pole; entropy and peak of the image; error of the poses."""
    got = ul.metrics.image_quality(image, target_m=(*POLES[0], 0.0), search_m=0.2)
    truth = frames.believed if frames.truth is None else frames.truth
    off = (frames.believed.position - truth.position)[:, 0]
    return {
        "entropy": got["entropy"].value,
        "peak": float(20 * np.log10(image.amplitude.max() / sharp.amplitude.max())),
        "width": 100 * got["width_y_3db"].value,
        "pslr": got["pslr_y"].value,
        "error": 100 * got["error"].value,
        "pose": float(1e3 * off.std()),
    }


def moved(frames: Frames, position: np.ndarray) -> Frames:
    path = frames.believed
    return replace(frames, poses=Trajectory(path.t_ns, position, path.quat_xyzw))


def smoothed(frames: Frames) -> Frames:
    """Poses on a cubic of time over 0.6 m, as the mapper takes them."""
    from scipy.signal import savgol_filter

    return moved(frames, savgol_filter(frames.believed.position, 31, 3, axis=0))


def cases(seed: int, white_m: float):
    scene = Scene.union([Scene.of_wires((x, y, -1.5), (x, y, 1.5), 0.005, name=f"{x}") for x, y in POLES])
    path = Trajectory.line((0, -0.7, 0), (0, 0.7, 0), speed_m_s=0.5, rate_hz=25)
    exact = ul.simulate(scene, path, ul.RadarSpec.preset("x4m05"), seed=seed)
    noise = np.random.default_rng(seed).normal(0, white_m, (len(path), 3))
    noisy = replace(moved(exact, path.position + noise), truth=path)
    yield "exact poses", exact
    yield f"{1e3 * white_m:.0f} mm white error", noisy
    yield "the same, autofocus", autofocus(noisy, GRID, white_m=white_m, drift_m=0)
    yield "the same, smoothed over 0.6 m of track", smoothed(noisy)
    yield "the same, smoothed, then autofocus", autofocus(smoothed(noisy), GRID, white_m=0.3 * white_m, drift_m=0)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--white", type=float, default=0.003, help="sigma of each pose's error [m]")
    parser.add_argument("--figure")
    options = parser.parse_args()
    scores: dict[str, list[dict[str, float]]] = {}
    for seed in range(options.seeds):
        images = {}
        for name, frames in cases(seed, options.white):
            images[name] = ul.focus(frames, GRID)
            sharp = images["exact poses"]
            scores.setdefault(name, []).append(scored(frames, images[name], sharp))
        if options.figure and seed == 0:
            draw(images, options.figure)
    print_table("poses", COLUMNS, scores)


def draw(images: dict[str, Image], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    top = max(image.amplitude.max() for image in images.values())
    figure, axes = plt.subplots(1, len(images), figsize=(3.1 * len(images), 3.4), sharey=True, layout="constrained")
    for ax, (name, image) in zip(axes, images.items(), strict=True):
        level = 20 * np.log10(np.maximum(image.amplitude, 1e-4 * top) / top)
        shown = ax.imshow(level, origin="lower", extent=image.grid.extent_m, vmin=-30, vmax=0)
        ax.plot(*np.array(POLES).T, "r+", ms=5)
        ax.set_title(name.replace("the same, ", ""), fontsize=9)
        ax.set_xlabel("x [m]")
    axes[0].set_ylabel("y [m]")
    figure.colorbar(shown, ax=axes, label="level [dB]")
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
