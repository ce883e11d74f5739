"""A matplotlib window with the amplitudes of each radar's newest frame (`--to window:`), without ROS and rerun."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ullage.data import Frames, sensors_of
from ullage.errors import InputError
from ullage.flow import Sink

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BACKENDS = ("QtAgg", "TkAgg", "GTK4Agg", "GTK3Agg", "WxAgg", "MacOSX")
EVERY_S = 0.1
"""Least time between two drawings, by wall-clock time [s]."""
FLOOR = 1e-9


class WindowSink(Sink):
    """Draws amplitude over range of each radar's newest frame, at most ten times a second.

    Args:
        figure: to draw into; None: a new window.

    Raises:
        InputError: there is no display.
    """

    main_thread = True
    """Window systems want to be drawn to from the main thread."""

    def __init__(self, figure: Figure | None = None) -> None:
        self._own = figure is None
        self.figure = figure or _window()
        self._lines: dict[str, Any] = {}
        self._drawn_s = -EVERY_S

    def write(self, item: Any) -> None:
        """Draw frames; other items are ignored."""
        if not isinstance(item, Frames | Mapping):
            return
        now = time.monotonic()
        if now - self._drawn_s < EVERY_S:
            return
        self._drawn_s = now
        for part in sensors_of(item):
            self._show(part)
        self.figure.canvas.draw_idle()
        self.figure.canvas.flush_events()

    def _show(self, part: Frames) -> None:
        amplitude = np.asarray(part.amplitude[-1], float)
        if part.unit == "path_gain":
            amplitude = 20 * np.log10(np.maximum(amplitude, FLOOR))
        if part.sensor not in self._lines:
            axes = self.figure.axes[0] if self.figure.axes else self.figure.subplots()
            axes.set(xlabel="range [m]", ylabel="path gain [dB]" if part.unit == "path_gain" else part.unit)
            (self._lines[part.sensor],) = axes.plot([], [], label=part.sensor, linewidth=1)
            axes.legend(loc="upper right")
        line = self._lines[part.sensor]
        line.set_data(part.range_m, amplitude)
        line.axes.relim()
        line.axes.autoscale_view()

    def close(self) -> None:
        """Close the window."""
        if self._own:
            import matplotlib.pyplot as plt

            plt.close(self.figure)


def check_display() -> None:
    """Check that a window can be opened.

    Raises:
        InputError: there is no display, or no toolkit for windows.
    """
    import matplotlib.pyplot as plt

    for backend in BACKENDS:
        try:
            plt.switch_backend(backend)
        except Exception:  # a toolkit that is missing or finds no display can raise any error
            continue
        return
    raise InputError(
        "no window can be opened",
        where="window:",
        allowed="a display, and Qt, Tk, GTK or wx for Python; or viewer:FILE.rrd",
    )


def _window() -> Figure:
    import matplotlib.pyplot as plt

    check_display()
    figure = plt.figure("ullage", layout="constrained")
    figure.show()
    return figure
