"""Draw the part of each radar's signal removed as its own echo, for a report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ullage.processing.own_echo import OwnEcho
from ullage.view.figures import drawing


def own_echo_figure(path: Path, found: Mapping[str, OwnEcho], *, title: str = "") -> Path:
    """Draw mean power received, own echo removed and power that remains over range, one panel a radar.

    Args:
        path: where to write.
        found: the estimates by sensor name.
        title: above all.
    """
    shown = {name: one for name, one in found.items() if one.energy_share}
    width = 3.1 * max(len(shown), 2) + 0.9
    with drawing(path, size_in=(width, 4.0), columns=max(len(shown), 1)) as (figure, axes):
        for panel, (name, one) in zip(np.atleast_1d(axes), shown.items(), strict=False):
            panel.plot(one.range_m, one.received_db, color="0.5", linewidth=1.0, label="received")
            removed = one.level_db > one.received_db.min() - 20
            panel.plot(one.range_m, np.where(removed, one.level_db, np.nan), color="#d1495b", linewidth=1.2,
                       label="own echo, removed")  # fmt: skip
            panel.plot(one.range_m, one.remaining_db, color="#2e86ab", linewidth=1.0, label="remains")
            panel.axvspan(one.range_m[0], one.extent_m, color="0.93", zorder=0)
            panel.set(xlabel="range [m]", title=name)
            panel.text(0.98, 0.98, _summary(one), transform=panel.transAxes, ha="right", va="top", fontsize=7)
            panel.grid(alpha=0.3)
        first = np.atleast_1d(axes)[0]
        first.set_ylabel("power [dB], in the frames' unit")
        figure.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8,
                      frameon=False)  # fmt: skip
        figure.suptitle(title, fontsize=10)
    return path


def _summary(one: OwnEcho) -> str:
    place = "track unknown" if not one.places else f"{one.places} places, ambiguity {one.ambiguity:.2f}"
    return f"{100 * one.energy_share:.0f} % of the energy, up to {one.extent_m:.2f} m\n{place}"
