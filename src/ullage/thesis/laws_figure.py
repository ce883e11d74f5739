"""The figure of `laws`: targets down, ray law, physical law and both levels across."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ullage.thesis.laws import Row

COLORS = {"thesis": "#d1495b", "physical": "#22577a"}
NAMES = {"thesis": "ray model of 2018", "physical": "physical"}
WALL_M = 6.2  # from the track to the wall behind the targets


def draw_laws(out: Path, rows: list[Row], found: dict[str, float]) -> None:
    """Draws rows of `laws.compare` with the numbers of `laws.numbers`."""
    from ullage.view.figures import drawing

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
