"""Draw the moving picture of a drone that stops before a 3 mm wire: docs/pictures/guard_wire.webp.

    python -m studies.tables.guard_picture [--to FILE.webp]

Each picture shows one frame of the closed loop: the side view, the profile of the front radar, and the speeds.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Wedge
from PIL import Image

from studies.tables.guard_flights import HULL, Case, flown, rod
from ullage.experiments.guarded_flight import GuardedFlight
from ullage.files import write_whole

COLORS = {"free": "#2e86ab", "limited": "#e9a820", "stop": "#d1495b", "back_off": "#d1495b"}
WIRE = Case(rod(0.0015, np.array([0.0, 0.0, 0.03]), np.array([0.0, 1.0, 0.0])), 0.8, start_m=3.5)


def side_view(axes: Any, flight: GuardedFlight, row: int) -> None:
    """The drone, the main lobe of its front radar in the colour of the guard's state, and the wire."""
    step, (x, _, z) = flight.steps[row], flight.flown.position[row]
    front = step.sectors.sensors.index("front")
    reach, half = float(step.sectors.distance_m[front]), np.degrees(step.sectors.width_rad[front] / 2)
    color, drawn_m = COLORS[step.limit.state], min(reach, 4.5)
    axes.add_patch(Wedge((x, z), drawn_m, -half, half, color=color, alpha=0.25, linewidth=0))
    axes.add_patch(Ellipse((x, z), 2 * HULL.radius_m, 2 * HULL.half_height_m, color="0.2"))
    axes.plot(0, 0.03, "o", color="k", markersize=4)
    axes.annotate("wire, 3 mm", (0, 0.03), (0.1, 0.45), fontsize=8)
    seen = f"nearest {reach:.2f} m" if np.isfinite(reach) else "nothing found yet"
    axes.set(xlim=(-4.2, 1.2), ylim=(-1.2, 1.2), aspect="equal", xlabel="x [m]", ylabel="z [m]")
    axes.set_title(
        f"t = {step.t_ns * 1e-9:.1f} s   {step.limit.state.replace('_', ' ')}   {seen}", fontsize=9, loc="left"
    )


def profile(axes: Any, flight: GuardedFlight, row: int) -> None:
    """Amplitudes of the front radar, and the distances of its tracks."""
    frames, sectors = flight.frames[row]["front"], flight.steps[row].sectors
    level = 20 * np.log10(np.maximum(np.abs(frames.samples[0]), 1e-9))
    axes.plot(frames.range_m, level, color="0.4", linewidth=0.8)
    mine = sectors.tracks.sensor == sectors.sensors.index("front")
    for distance, outside in zip(sectors.tracks.distance_m[mine], sectors.tracks.outside[mine], strict=True):
        axes.axvline(distance, color="0.7" if outside else "#d1495b", linewidth=1.2)
    axes.set(xlim=(0, 6), ylim=(-115, -35), xlabel="range [m]", ylabel="front radar [dB]")
    axes.set_title("red: tracks; grey: outside the lobe", fontsize=8, loc="left")


def speeds(axes: Any, flight: GuardedFlight, row: int) -> None:
    """Speed wanted, allowed and flown up to now."""
    t_s = flight.flown.t_ns[: row + 1] * 1e-9
    part = flight.steps[: row + 1]
    axes.plot(t_s, [step.wanted[0] for step in part], color="0.7", label="wanted")
    axes.plot(t_s, [step.limit.velocity[0] for step in part], color="#e9a820", label="allowed")
    axes.plot(t_s, flight.flown.rates[0][: row + 1, 0], color="#2e86ab", label="flown")
    axes.set(xlim=(0, flight.flown.t_ns[-1] * 1e-9), ylim=(-0.3, 1.0), xlabel="time [s]", ylabel="speed [m/s]")
    axes.legend(fontsize=7, loc="lower left", ncols=3, frameon=False)


def picture(flight: GuardedFlight, row: int) -> Image.Image:
    """One frame of the moving picture."""
    figure = Figure(figsize=(6.4, 4.6), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplot_mosaic([["side", "side"], ["profile", "speeds"]], height_ratios=[1.15, 1])
    side_view(panels["side"], flight, row)
    profile(panels["profile"], flight, row)
    speeds(panels["speeds"], flight, row)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--to", type=Path, default=Path("docs/pictures/guard_wire.webp"))
    given = parser.parse_args()
    flight, _ = flown(WIRE, seed=1)
    pictures = [picture(flight, row) for row in range(len(flight.steps))]
    data = io.BytesIO()
    period_ms = [100] * (len(pictures) - 1) + [2000]
    pictures[0].save(
        data, "WEBP", save_all=True, append_images=pictures[1:], duration=period_ms, loop=0, quality=60, method=4
    )
    write_whole(given.to, lambda out: out.write(data.getvalue()))
    print(f"{given.to}: {len(pictures)} frames, {len(data.getvalue()) / 1e6:.2f} MB, arrived {flight.arrived}")


if __name__ == "__main__":
    main()
