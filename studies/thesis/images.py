"""Compare all imaging methods on three poles and five flights, with one evaluator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from studies.thesis import flights
from studies.thesis.flights import Scores, mean_of
from studies.thesis.map_figures import Panel, draw_panels
from studies.thesis.workspace import Workspace
from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.grids import Grid, Image
from ullage.processing.autofocus import autofocus
from ullage.processing.metrics import image_quality
from ullage.processing.sar import focus
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

POLES = ((2.0, 0.1), (2.6, -0.5), (3.1, 0.6))
GRID = Grid((1.4, -1.0, 0), 0.01, (200, 220))
WHITE_M = 0.003
SEARCH_M = 0.2
COLUMNS = {
    "entropy": "entropy [nat]",
    "peak": "peak against exact [dB]",
    "width_x": "-3 dB width in range [cm]",
    "width_y": "-3 dB width across [cm]",
    "pslr": "highest side lobe across [dB]",
    "islr": "side lobes' power across [dB]",
    "error": "place [cm]",
    "pose": "pose error along sight [mm]",
}
SUMMED, EXACT = "summation (thesis), exact poses", "back-projection, exact poses"
NOISY, FOCUSED = "back-projection, 3 mm white error", "the same, autofocus"
SMOOTH, BOTH = "the same, smoothed over 0.6 m of track", "the same, smoothed, then autofocus"


def cases(seed: int) -> Iterator[tuple[str, Frames, Image]]:
    """Give the rows of the table: name, frames with estimated poses, and their image."""
    scene = Scene.union(
        [Scene.of_wires(np.array([x, y, -1.5]), np.array([x, y, 1.5]), 0.005, name=f"{x}") for x, y in POLES]
    )
    path = Trajectory.line((0, -0.7, 0), (0, 0.7, 0), speed_m_s=0.5, rate_hz=25)
    exact = simulate(scene, path, RadarSpec.preset("x4m05"), seed=seed)
    noise = np.random.default_rng(seed).normal(0, WHITE_M, (len(path), 3))
    noisy = replace(_moved(exact, path.position + noise), truth=path)
    smooth = _smoothed(noisy)
    yield EXACT, exact, focus(exact, GRID)
    yield SUMMED, exact, focus(exact, GRID, method="summation")
    for name, frames in (
        (NOISY, noisy),
        (FOCUSED, autofocus(noisy, GRID, white_m=WHITE_M, drift_m=0)),
        (SMOOTH, smooth),
        (BOTH, autofocus(smooth, GRID, white_m=0.3 * WHITE_M, drift_m=0)),
    ):
        yield name, frames, focus(frames, GRID)


def _moved(frames: Frames, position: Floats) -> Frames:
    path = frames.believed
    return replace(frames, poses=Trajectory(path.t_ns, position, path.quat_xyzw))


def _smoothed(frames: Frames) -> Frames:
    """Smooth poses by a cubic of time over 0.6 m, as the mapper does."""
    from scipy.signal import savgol_filter

    return _moved(frames, savgol_filter(frames.believed.position, 31, 3, axis=0))


def scored(frames: Frames, image: Image, sharp: Image) -> dict[str, float]:
    """Measure widths, side lobes and place of the nearest pole, entropy and peak of the image, and pose errors."""
    got = image_quality(image, target_m=(*POLES[0], 0.0), search_m=SEARCH_M)
    truth = frames.believed if frames.truth is None else frames.truth
    off = (frames.believed.position - truth.position)[:, 0]
    same = image.method == sharp.method
    return {
        "entropy": got["entropy"].value,
        "peak": float(20 * np.log10(image.amplitude.max() / sharp.amplitude.max())) if same else np.nan,
        "width_x": 100 * got["width_x_3db"].value,
        "width_y": 100 * got["width_y_3db"].value,
        "pslr": got["pslr_y"].value,
        "islr": got["islr_y"].value,
        "error": 100 * got["error"].value,
        "pose": float(1e3 * off.std()),
    }


def run(work: Workspace) -> None:
    """Make the table of images and the images of the first flight."""
    scores: Scores = {}
    panels: list[Panel] = []
    seeds = 1 if work.quick else flights.SEEDS
    for seed in range(seeds):
        sharp: Image | None = None
        for name, frames, image in cases(seed):
            work.log(f"flight {seed + 1} of {seeds}, {name}")
            sharp = image if sharp is None else sharp
            scores.setdefault(name, []).append(scored(frames, image, sharp))
            if seed == 0:
                panels.append(Panel(name, image, marks=np.array(POLES)))
    table = flights.rows_of(scores, COLUMNS)
    work.results.add_table("Methods of imaging", ("method", *COLUMNS.values()), table, note=NOTE)
    path, view = work.folder / "poles.png", np.array(GRID.extent_m).reshape(2, 2).T
    draw_panels(path, [panels[:3], panels[3:]], walls=np.zeros((0, 2, 2)), title="Three poles of 1 cm, one flight",
                width_in=4.0, view=view)  # fmt: skip
    work.results.add_figure(path, "", "Images of three poles of 1 cm from one flight; circled: where they stand.")
    state(work, scores)


NOTE = (
    "One X4M05 passes three upright poles of 1 cm at 2 to 3 m. It flies 1.4 m at 0.5 m/s and 25 frames a second, "
    "with the receiver's noise. Cells of 1 cm; the nearest pole is measured. Mean over the flights and its 95 % "
    "interval by Student's t."
)


def state(work: Workspace, scores: Scores) -> None:
    """State place, width and entropy of the images."""

    def gain(key: str, over: str, name: str) -> float:
        return mean_of(scores, over, key) - mean_of(scores, name, key)

    hold = work.results.add_statement
    for name in scores:
        if name != SUMMED:
            hold(f"place of the nearest pole: {name}", "beyond", mean_of(scores, name, "error"), "cm", high=3)
    ratio = mean_of(scores, SUMMED, "width_y") / mean_of(scores, EXACT, "width_y")
    hold("width of a pole across in the thesis' sum, over that by back-projection", "beyond", ratio, low=5)
    hold("share of the entropy added by errors of 3 mm that autofocus removes", "beyond",
         gain("entropy", NOISY, FOCUSED) / gain("entropy", NOISY, EXACT), low=0.3)  # fmt: skip
    hold("share of it that smoothed poses and autofocus leave", "beyond",
         gain("entropy", BOTH, EXACT) / gain("entropy", NOISY, EXACT), high=0.15)  # fmt: skip
