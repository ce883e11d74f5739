"""The amplitude window: draws the newest frame of each radar, and refuses without a display."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import ullage as ul
from ullage.cli import main
from ullage.view.window import WindowSink


def test_the_newest_profile_of_each_radar_is_drawn() -> None:
    room, path = ul.scenes.room(size_m=(6, 4, 3)), ul.Trajectory.stationary(n=3)
    frames = ul.simulate(room, path, ul.Rig.preset("thesis-4"), fidelity="thesis", seed=1)
    assert isinstance(frames, dict)
    figure = Figure()
    FigureCanvasAgg(figure)
    with WindowSink(figure) as window:
        window.write(frames)
        window.write(room)
    lines = {line.get_label(): line for line in figure.axes[0].lines}
    assert set(lines) == set(frames)
    for name, part in frames.items():
        assert np.array_equal(lines[name].get_xdata(), part.range_m)
        assert np.allclose(lines[name].get_ydata(), part.amplitude[-1])


def test_without_a_display_it_is_refused_in_one_line(monkeypatch, capsys, tmp_path) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SystemExit) as end:
        main(["run", "ntnu-wire", "--to", "window:", "--out", str(tmp_path)])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert "window:: no window can be opened (allowed: a display" in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
