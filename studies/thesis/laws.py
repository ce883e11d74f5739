"""Compare the ray model of 2018 and the physical model on the thesis' four targets [Billdal2018].

A drone strafes past a facing steel plate, the plate turned by 45 degrees, a square pole and a wire, with one radar to
the front. The ray law hardly depends on tilt and thickness, and ends at the last wall. The physical law does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studies.thesis.targets import TAIL_M, TARGETS, decibel, radars, strafe
from studies.thesis.variants import alone
from ullage.arrays import Floats
from ullage.data import Frames
from ullage.radar.simulate import simulate
from ullage.view.figures import drawing
from ullage.world.library import WORLDS

COLORS = {"thesis": "#d1495b", "physical": "#22577a"}
NAMES = {"thesis": "ray model of 2018", "physical": "physical"}
WALL_M = 6.2  # from the track to the wall behind the targets


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Echoes of one target under both laws."""

    world: str
    title: str
    across_m: Floats  # (n) the track [m]
    thesis: Frames  # with its noise
    physical: Frames  # with its noise and up to `max_bounces` reflections
    steel: dict[str, Floats]  # peak amplitude (n) of the steel alone, without noise, by law
    summed: Floats  # amplitude (n) of the steel alone summed over range, ray law
    tail: dict[str, float]  # rms amplitude beyond TAIL_M without noise, by law


def compare(world: str, *, step_m: float = 0.05, max_bounces: int = 3, seed: int = 7) -> Row:
    """Evaluate both laws along the track past one target.

    Args:
        world: one of TARGETS.
        step_m: distance between frames [m].
        max_bounces: reflections the physical law follows.
        seed: of the noise.
    """
    name, title = TARGETS[world]
    scene, path = WORLDS[world].scene(), strafe(world, step_m=step_m)
    steel, tail = alone(scene, name), {}
    loud, quiet = radars()
    rays = abs(simulate(steel, path, quiet, fidelity="thesis").samples).astype(float)
    waves = abs(simulate(steel, path, quiet, fidelity="physical").samples).astype(float)
    few = path[:: max(1, len(path) // 8)]
    for law, bounces in (("thesis", 1), ("physical", max_bounces)):
        still = simulate(scene, few, quiet, fidelity=law, max_bounces=bounces)
        tail[law] = float(np.sqrt(np.mean(abs(still.samples[:, still.range_m > TAIL_M]) ** 2)))
    return Row(world, title, path.position[:, 1].copy(),
               simulate(scene, path, loud, fidelity="thesis", seed=seed),
               simulate(scene, path, loud, fidelity="physical", max_bounces=max_bounces, seed=seed),
               {"thesis": rays.max(1), "physical": waves.max(1)}, rays.sum(1), tail)  # fmt: skip


def under_plate_db(rows: list[Row]) -> dict[tuple[str, str], Floats]:
    """Return each steel target's amplitude relative to the facing plate's peak (n) [dB], by world and law."""
    plate = rows[0].steel
    return {(row.world, law): decibel(row.steel[law] / plate[law].max()) for row in rows for law in plate}


def numbers(rows: list[Row]) -> dict[str, float]:
    """Return the statements of the figure as numbers.

    Returns:
        For each world and law "<world> <law> opposite": the level with the target straight ahead, and
        "... best": the strongest along the track, both over the facing plate's strongest [dB];
        "... thesis summed opposite": the same of the ray law's amplitude summed over range; "... missed": the
        share of frames without any echo of the steel; and "tail <law>": rms
        beyond the last wall over the facing plate's strongest echo [dB], world of the first row.
    """
    out = {}
    for (world, law), level in under_plate_db(rows).items():
        row = next(row for row in rows if row.world == world)
        out[f"{world} {law} opposite"] = float(level[np.argmin(abs(row.across_m))])
        out[f"{world} {law} best"] = float(level.max())
    for row in rows:
        summed = decibel(row.summed / rows[0].summed.max())
        out[f"{row.world} thesis summed opposite"] = float(summed[np.argmin(abs(row.across_m))])
        for law in row.steel:
            out[f"{row.world} {law} missed"] = float(np.mean(row.steel[law] == 0))
    for law, value in rows[0].tail.items():
        out[f"tail {law}"] = float(decibel(value / rows[0].steel[law].max()))
    return out


def laws_figure(out: Path, *, step_m: float = 0.05, max_bounces: int = 3) -> dict[str, float]:
    """Draw the four targets under both laws; return the numbers written in the figure.

    Args:
        out: .png, .svg or .pdf.
        step_m: distance between frames [m].
        max_bounces: reflections the physical law follows.
    """
    rows = [compare(world, step_m=step_m, max_bounces=max_bounces) for world in TARGETS]
    found = numbers(rows)
    draw_laws(out, rows, found)
    return found


def draw_laws(out: Path, rows: list[Row], found: dict[str, float]) -> None:
    """Draw rows of `compare` with the numbers of `numbers`: targets down, ray law, physical law and levels across."""
    with drawing(out, size_in=(13.5, 3.0 * len(rows)), columns=1) as (figure, first):
        first.remove()
        panels = figure.subplots(len(rows), 3, squeeze=False, width_ratios=(1, 1, 1.15))
        figure.suptitle("One radar strafes past four targets in a concrete room: the ray model of 2018 and physics")
        for row, axes in zip(rows, panels, strict=True):
            _thesis(figure, axes[0], row)
            _physical(figure, axes[1], row)
            _levels(axes[2], row, rows, found)
        for axes, title in zip(
            panels[0], ("ray model: amplitude", "physical: path gain", "the steel alone, over the facing plate's best"),
            strict=True,
        ):  # fmt: skip
            axes.set_title(title, fontsize=11)
        for axes in panels[-1]:
            axes.set_xlabel("along the track [m]")


def _extent(row: Row) -> Any:
    axis = row.thesis.range_m
    return (row.across_m[0], row.across_m[-1], axis[0], axis[-1])


def _marks(axes: Any, row: Row) -> None:
    reach = np.hypot(2.2, row.across_m)
    axes.plot(row.across_m, reach, ":", color="w", lw=1)
    axes.axhline(WALL_M, color="w", lw=0.8, ls="--", alpha=0.7)
    axes.text(-1.85, WALL_M + 0.1, "wall behind", color="w", fontsize=7)
    axes.text(0, 2.0, "target", color="w", fontsize=7, ha="center", va="top")
    axes.set_ylim(0, row.thesis.range_m[-1])


def _thesis(figure: Any, axes: Any, row: Row) -> None:
    drawn = axes.imshow(abs(row.thesis.samples).T, origin="lower", aspect="auto", extent=_extent(row), vmin=0, vmax=0.4,
                        cmap="magma", interpolation="nearest")  # fmt: skip
    _marks(axes, row)
    axes.set_ylabel(f"{row.title}\nrange [m]")
    axes.text(1.85, 9.2, "nothing behind the room", color="w", fontsize=7, ha="right", va="top")
    figure.colorbar(drawn, ax=axes, pad=0.02)


def _physical(figure: Any, axes: Any, row: Row) -> None:
    level = 20 * np.log10(np.maximum(abs(row.physical.samples), 1e-12))
    drawn = axes.imshow(level.T, origin="lower", aspect="auto", extent=_extent(row), vmin=-115, vmax=-50, cmap="magma",
                        interpolation="nearest")  # fmt: skip
    _marks(axes, row)
    axes.text(1.85, 9.2, "tail of multiple reflections", color="w", fontsize=7, ha="right", va="top")
    figure.colorbar(drawn, ax=axes, pad=0.02, label="dB")


def _levels(axes: Any, row: Row, rows: list[Row], found: dict[str, float]) -> None:
    for law in ("thesis", "physical"):
        with np.errstate(divide="ignore"):
            level = 20 * np.log10(row.steel[law] / rows[0].steel[law].max())
        level = np.where(np.isfinite(level), level, np.nan)
        style = ".-" if law == "thesis" else "-"
        axes.plot(row.across_m, level, style, ms=4, lw=1.4, color=COLORS[law], label=NAMES[law])
    axes.set_ylim(-62, 4)
    axes.set_xlim(row.across_m[0], row.across_m[-1])
    axes.grid(alpha=0.3)
    axes.set_ylabel("dB")
    axes.text(0.02, 0.04, _words(row, found), transform=axes.transAxes, fontsize=8, va="bottom", family="monospace",
              bbox={"facecolor": "w", "alpha": 0.8, "edgecolor": "none", "pad": 2})  # fmt: skip
    if row is rows[-1]:
        axes.legend(fontsize=8, frameon=False, loc="upper right")


def _words(row: Row, found: dict[str, float]) -> str:
    missed = found[f"{row.world} thesis missed"]
    lines = []
    for law in ("thesis", "physical"):
        level = found[f"{row.world} {law} opposite"]
        seen = f"{level:+.1f} dB" if level > -200 else "no ray meets it"
        lines.append(f"{NAMES[law]}: opposite {seen}, best {found[f'{row.world} {law} best']:+.1f} dB")
    if row.world == "ntnu-plate45":
        lines.append(f"ray model summed over range: {found['ntnu-plate45 thesis summed opposite']:+.1f} dB")
    if missed > 0:
        lines.append(f"no ray in {100 * missed:.0f} % of the frames")
    if row.world == "ntnu-plate":
        lines.append(f"rms beyond 8.4 m: physical {found['tail physical']:+.0f} dB, ray model 0")
    return "\n".join(lines)
