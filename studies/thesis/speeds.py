"""Measure the effect of speed and frame rate on frames, SAR images, wire detection and maps (thesis 7.1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studies.thesis import flights
from studies.thesis.motion import blind_speed_m_s, fly_at, loss_db
from studies.thesis.workspace import Workspace
from ullage.arrays import Floats
from ullage.config import MapMethod
from ullage.data import Frames, Trajectory
from ullage.grids import Grid, Image
from ullage.processing.detect import detect
from ullage.processing.metrics import image_quality, map_quality
from ullage.processing.occupancy import map_occupancy
from ullage.processing.sar import focus
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec, Rig
from ullage.view.figures import drawing
from ullage.world import scenes
from ullage.world.scene import Scene

RADIAL = {
    False: (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.37, 0.45, 0.5, 0.55, 0.65, 0.74, 0.9, 1.0),
    True: (0.05, 0.25, 0.37),
}
SIDEWAYS = {False: (0.1, 0.175, 0.25, 0.32, 0.5, 0.75, 1.0, 1.5, 2.0), True: (0.175, 0.5, 1.0, 2.0)}
ROUNDS = {False: (0.5, 1.0, 2.0, 4.0), True: (0.5, 4.0)}
"""Speeds of the flights towards a target, past one, and round a room [m/s]; True: of the small run."""
TARGET = (2.5, 0.0)
GRID = Grid((1.6, -1.2, 0), 0.02, (120, 90))
NEAR_M = 0.3
WIRE_M = 6.0
METHODS: dict[str, MapMethod] = {"ullage": "likelihood", "elfes": "elfes"}


@dataclass(frozen=True, slots=True)
class Measured:
    """Quantity against speed, with its law."""

    speed_m_s: Floats
    value: Floats


def run(work: Workspace) -> None:
    """Measure all four quantities, compare them with their laws, and draw them."""
    spec = RadarSpec.preset("x4m05")
    work.log("flying towards a plate and a wire")
    radial = RADIAL[work.quick]
    loss, found = towards_plate(spec, radial), towards_wire(spec, radial)
    work.log("flying past a wire")
    image, width = past_wire(spec, SIDEWAYS[work.quick])
    work.log("flying round a room")
    share = 1 / 3 if work.quick else 1.0
    scores = round_room(spec, ROUNDS[work.quick], seed=1, instantaneous=not work.quick, share=share)
    state(work, spec, loss, found, image, scores)
    tabulate(work, spec, found, (image, width), scores)
    path = work.folder / "speeds.png"
    draw(path, spec, loss, found, image, scores)
    work.results.add_figure(
        path, "", "What speed does at the X4M05's 17 frames/s: loss within a frame, ambiguous energy of a SAR image, "
        "detection of a wire, score of a map. Lines: theory.",
    )  # fmt: skip


def _single(spec: RadarSpec) -> Rig:
    return Rig(sensors={"front": spec})


def towards_plate(spec: RadarSpec, speeds: tuple[float, ...]) -> Measured:
    """Return the peak of a plate's echo relative to that at rest [dB], without noise."""
    quiet, scene = spec.but(noise=None), scenes.plate(0.5, 0.5, 4.0)
    path = Trajectory.line((0, 0, 0), (0.5, 0, 0), speed_m_s=0.5, rate_hz=50)
    levels = []
    for speed in speeds:
        frames = fly_at(scene, path, _single(quiet), speed_m_s=speed, path_speed_m_s=0.5)["front"]
        still = simulate(scene, frames.believed, quiet)
        levels.append(float(np.median(abs(frames.samples).max(1) / abs(still.samples).max(1))))
    return Measured(np.array(speeds), 20 * np.log10(levels))


def towards_wire(spec: RadarSpec, speeds: tuple[float, ...]) -> Measured:
    """Return the share of frames in which CFAR detects a wire ahead within 0.2 m of its range."""
    scene = Scene.of_wires(np.array([WIRE_M, 0, -1.5]), np.array([WIRE_M, 0, 1.5]), 0.002, name="wire")
    path = Trajectory.line((0, 0, 0), (3, 0, 0), speed_m_s=0.5, rate_hz=50)
    shares = []
    for speed in speeds:
        part = path if speed > 0.2 else path[100:200]
        frames = fly_at(scene, part, _single(spec), speed_m_s=speed, path_speed_m_s=0.5, seed=3)["front"]
        hits = detect(frames, method="cfar", remove_own_echo=False)
        true = WIRE_M - frames.believed.position[:, 0]
        near = abs(hits.range_m - true[hits.frame]) < 0.2
        shares.append(len(np.unique(hits.frame[near])) / len(frames))
    return Measured(np.array(speeds), np.array(shares))


def past_wire(spec: RadarSpec, speeds: tuple[float, ...]) -> tuple[Measured, Measured]:
    """Fly past a wire; return the image's energy away from it over the total [dB], and its -3 dB width [m]."""
    scene = Scene.of_wires(np.array([*TARGET, -1.5]), np.array([*TARGET, 1.5]), 0.005, name="wire")
    path = Trajectory.line((0, -1.2, 0), (0, 1.2, 0), speed_m_s=0.5, rate_hz=50)
    off, width = [], []
    for speed in speeds:
        frames = fly_at(scene, path, _single(spec.but(noise=None)), speed_m_s=speed, path_speed_m_s=0.5)["front"]
        image = focus(frames, GRID)
        off.append(ambiguous_db(image))
        width.append(image_quality(image, target_m=(*TARGET, 0.0), search_m=NEAR_M)["width_y_3db"].value)
    return Measured(np.array(speeds), np.array(off)), Measured(np.array(speeds), np.array(width))


def ambiguous_db(image: Image) -> float:
    """Return the energy farther than `NEAR_M` from the target relative to the total [dB]."""
    power = np.asarray(image.amplitude, float) ** 2
    x, y = image.grid.x_m, image.grid.y_m
    away = np.hypot(x[None, :] - TARGET[0], y[:, None] - TARGET[1]) > NEAR_M
    return float(10 * np.log10(power[away].sum() / power.sum()))


def round_room(
    spec: RadarSpec, speeds: tuple[float, ...], *, seed: int, instantaneous: bool = True, share: float = 1.0
) -> dict[str, Measured]:
    """Return the F1 of maps of the common test room, by name of the row, also of frames that integrate no motion.

    Only a share of the round is flown, if one is given. Every map is scored against the surface in view from the first
    speed's frames, so that a fast flight is scored on everything that a slow one sees.
    """
    scene, path, rig = flights.judged_room(), flights.level_round(seed), Rig.preset("thesis-4", radar=spec)
    path = path[: round(share * len(path))]
    grid = flights.plane_of(scene)
    scores: dict[str, list[float]] = {}
    slowest: dict[str, Frames] = {}
    for speed in speeds:
        for integrate, suffix in ((True, ""), (False, ", instantaneous frames"))[: 1 + instantaneous]:
            frames = fly_at(
                scene, path, rig, speed_m_s=speed, path_speed_m_s=0.5, seed=seed, integrate=integrate
            )  # fmt: skip
            slowest = slowest or frames
            for name, method in METHODS.items():
                omap = map_occupancy(frames, grid, method=method)
                found = map_quality(omap, scene, slowest)["f1"].value
                scores.setdefault(name + suffix, []).append(found)
    return {name: Measured(np.array(speeds), np.array(row)) for name, row in scores.items()}


def spacing(spec: RadarSpec, speed_m_s: Floats | float) -> Floats:
    """Return the distance between frames in wavelengths."""
    return np.asarray(speed_m_s, float) / spec.fps / spec.wavelength_m


def widest(spec: RadarSpec) -> float:
    """Return the largest unambiguous spacing in the -3 dB beam, in wavelengths: 1 / (4 sin(half beam))."""
    return float(1 / (4 * np.sin(np.radians(spec.antenna.azimuth_deg / 2))))


def state(
    work: Workspace, spec: RadarSpec, loss: Measured, found: Measured, image: Measured, scores: dict[str, Measured]
) -> None:
    """Compare each measurement with its law."""
    hold = work.results.add_statement
    law = loss_db(loss.speed_m_s, spec)
    clear = law > -20
    hold("a plate ahead: loss within a frame less the law, largest", "7.1",
         float(abs(loss.value - law)[clear].max()), "dB", high=1.0)  # fmt: skip
    blind = int(np.argmin(abs(loss.speed_m_s - blind_speed_m_s(spec))))
    hold("a plate ahead at the blind speed: loss", "7.1", loss.value[blind], "dB", high=-20)
    hold("a wire ahead: frames that detect it at 0.05 m/s (share)", "7.1", found.value[0], "", low=0.9)
    hold(
        "a wire ahead: frames that detect it at the blind speed (share)",
        "7.1",
        found.value[blind],
        "",
        high=0.5 * found.value[0],
    )
    fine = image.value[spacing(spec, image.speed_m_s) <= 0.26].max()
    coarse = image.value[spacing(spec, image.speed_m_s) >= 1.4].min()
    hold("a wire's SAR image: ambiguous energy, spacing over 1.4 wavelengths against lambda/4", "7.1",
         float(coarse - fine), "dB", low=6)  # fmt: skip
    for method in METHODS:
        hold(f"map by {method}: F1 at the highest speed less that at 0.5 m/s", "7.1",
             float(scores[method].value[-1] - scores[method].value[0]), "", high=-0.2)  # fmt: skip


def tabulate(
    work: Workspace, spec: RadarSpec, found: Measured, images: tuple[Measured, Measured], scores: dict[str, Measured]
) -> None:
    """Tabulate the numbers for the page."""
    image, width = images
    past = [
        (f"{v:g}", f"{spacing(spec, v):.2f}", f"{e:.1f}", f"{100 * w:.1f}")
        for v, e, w in zip(image.speed_m_s, image.value, width.value, strict=True)
    ]
    work.results.add_table(
        "SAR image of a wire, flown past",
        ("speed [m/s]", "frame spacing / wavelength", "ambiguous energy [dB]", "-3 dB width across [cm]"), past,
        note=f"17 frames/s. A spacing of 1/4 is unambiguous in every direction, {widest(spec):.2f} within the beam.",
    )  # fmt: skip
    ahead = [
        (f"{v:g}", f"{loss_db(v, spec):.1f}", f"{s:.2f}") for v, s in zip(found.speed_m_s, found.value, strict=True)
    ]
    work.results.add_table(
        "A wire ahead, 6 to 3 m away", ("speed [m/s]", "loss by the law [dB]", "frames that detect it"), ahead,
        note=f"One frame integrates {1e3 * spec.sweeps_s:.1f} ms; blind at {blind_speed_m_s(spec):.3f} m/s.",
    )  # fmt: skip
    rounds = [
        (f"{v:g}", f"{spacing(spec, v):.2f}", *(f"{scores[m].value[k]:.3f}" for m in scores))
        for k, v in enumerate(next(iter(scores.values())).speed_m_s)
    ]
    head = ("speed [m/s]", "frame spacing / wavelength", *(f"F1, {method}" for method in scores))
    work.results.add_table("Maps of a room, four radars, physical frames", head, rounds)


def draw(
    path: Path, spec: RadarSpec, loss: Measured, found: Measured, image: Measured, scores: dict[str, Measured]
) -> None:
    """Draw four panels with measured points and lines of theory."""
    fine = np.linspace(0.01, 1.05, 400)
    with drawing(path, size_in=(13.0, 3.4), columns=4) as (_, axes):
        axes[0].plot(fine, loss_db(fine, spec), color="tab:gray", label="sinc law")
        axes[0].plot(loss.speed_m_s, loss.value, "o", ms=4, label="plate, simulated")
        axes[0].set(ylim=(-45, 2), xlabel="radial speed [m/s]", ylabel="echo against rest [dB]", title="One frame")
        axes[0].legend(fontsize=8)
        axes[1].plot(spacing(spec, image.speed_m_s), image.value, "o-", ms=4)
        for at, name, style in ((0.25, "λ/4", "--"), (widest(spec), "λ/(4 sin ½beam)", ":")):
            axes[1].axvline(at, color="tab:gray", ls=style, label=name)
        axes[1].legend(fontsize=8, loc="lower right")
        axes[1].set(xlabel="frame spacing / wavelength", ylabel="ambiguous energy [dB]", title="SAR image of a wire")
        axes[2].plot(found.speed_m_s, found.value, "o-", ms=4)
        axes[2].axvline(blind_speed_m_s(spec), color="tab:gray", ls="--", label="blind speed λ/(2T)")
        axes[2].set(xlabel="radial speed [m/s]", ylabel="frames that detect it", ylim=(0, 1.05), title="Wire ahead")
        axes[2].legend(fontsize=8, loc="lower left", bbox_to_anchor=(0, 0.05))
        for method, row in scores.items():
            axes[3].plot(np.log2(row.speed_m_s), row.value, "o-" if "," not in method else "s:", ms=4, label=method)
        speeds = next(iter(scores.values())).speed_m_s
        axes[3].set(xlabel="speed [m/s]", ylabel="F1", ylim=(0, 1), title="Map of a room", xticks=np.log2(speeds),
                    xticklabels=[f"{v:g}" for v in speeds])  # fmt: skip
        axes[3].legend(fontsize=7, loc="lower left")
