"""Draw the posterior of a calibration: over all clock offsets, and the candidates in clock and range."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ullage.data import Calibration
from ullage.view.figures import drawing


def calibration_figure(path: Path, found: Mapping[str, Calibration], *, title: str = "") -> Path:
    """Draw log density over the clock offset, and every candidate with its probability and the standard deviations.

    Args:
        path: where to write.
        found: calibration of each sensor by name.
        title: above both panels.
    """
    with drawing(path, size_in=(9.5, 3.8), columns=2) as (figure, (clock, both)):
        for name, one in found.items():
            color = None
            if one.clock_posterior:
                offset, log_density = np.array(one.clock_posterior).T
                (line,) = clock.plot(offset, log_density, linewidth=1.0, label=name)
                color = line.get_color()
            clock.axvline(one.t_offset_s, color=color, linestyle=":", linewidth=1.0)
            for t_s, range_m, probability in one.modes[1:]:
                both.plot(1e3 * (t_s - one.t_offset_s), range_m, "x", color=color, label=f"{100 * probability:.1f} %")
            both.errorbar(
                0, one.range_offset_m, xerr=1e3 * one.t_sigma_s, yerr=one.range_sigma_m, fmt="o",
                color=color, capsize=3,
                label=f"{name}: {one.t_offset_s:+.3f} s, {one.range_offset_m:+.3f} m, {100 * one.probability:.1f} %",
            )  # fmt: skip
        clock.set(xlabel="clock offset [s]", ylabel="log posterior density, from motion", ylim=(-52, 3))
        clock.set_title("echoes predicted from the track's motion", fontsize=9)
        both.set(xlabel="clock offset from the one applied [ms]", ylabel="range offset [m]")
        both.set_title("candidates, with one standard deviation", fontsize=9)
        for axes in (clock, both):
            axes.grid(alpha=0.3)
            if axes.get_legend_handles_labels()[0]:
                axes.legend(fontsize=7)
        figure.suptitle(f"{title}: calibration of the radar's clock and range", fontsize=10)
    return path
