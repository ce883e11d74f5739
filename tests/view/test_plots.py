"""`.plot()` and a notebook's cell: axes with units and sensible limits, pictures that are not empty."""

from __future__ import annotations

import base64
import io
import re
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from PIL import Image as Picture

import ullage as ul
from ullage.errors import InputError, MissingExtra

mpl.use("Agg")
N, BINS = 40, 60


@pytest.fixture(autouse=True)
def _closed():
    yield
    from matplotlib import pyplot

    pyplot.close("all")


def some_frames(n: int = N) -> ul.Frames:
    range_m = np.linspace(0.5, 6.4, BINS)
    samples = 1e-5 + 1e-3 * np.exp(-(((range_m - 3.0) / 0.2) ** 2)) * np.ones((n, 1))
    path = ul.Trajectory.line((-1, 0, 1), (1, 0, 1), 0.5, 10)[: max(n, 1)]
    return ul.Frames(samples.astype(np.complex64), range_m, path.t_ns, ul.RadarSpec.preset("x4m05"), poses=path)


def some_image(dims: int = 2) -> ul.Image:
    shape = (20, 30) if dims == 2 else (4, 20, 30)
    values = np.full(shape, 0.01, np.float32)
    values[..., 5, 20] = 1.0
    return ul.Image(ul.Grid((-1.0, 0.0, 1.0), 0.1, shape), values, None, "backprojection")


def some_map(dims: int = 2) -> ul.OccupancyMap:
    shape = (40, 60) if dims == 2 else (5, 40, 60)
    percent = np.full(shape, -1, np.int8)
    percent[..., 10:30, 20:40] = 0
    percent[..., 10, 20:40] = 100
    return ul.OccupancyMap(ul.Grid((0.0, 0.0, 0.5), 0.1, shape), percent, "ullage")


def some_hits() -> ul.Detections:
    k = np.arange(20)
    return ul.Detections(k, k * 10**8, 2.0 + 0.05 * k, np.ones(20), np.linspace(5, 30, 20), np.full((20, 3), np.nan))


def many_things() -> dict[str, object]:
    return {
        "frames": some_frames(), "one frame": some_frames(1), "image": some_image(), "image volume": some_image(3),
        "map": some_map(), "map volume": some_map(3), "scene": ul.scenes.floor(), "plate": ul.scenes.plate(1, 1, 3.0),
        "wire": ul.scenes.wire(0.001, 1.0), "nothing": ul.Scene.empty("<b>"),
        "hits": some_hits(), "no hits": ul.detect(some_frames(), threshold=10.0), "path": some_frames().poses,
        "still": ul.Trajectory.stationary((1, 2, 3)), "dark": ul.Image(ul.Grid((0, 0, 0), 1, (2, 2)), np.zeros((2, 2))),
    }  # fmt: skip


@pytest.mark.parametrize("name", list(many_things()))
def test_every_plot_names_its_axes_and_units_and_its_cell_shows_it(name):
    thing = many_things()[name]
    axes = thing.plot()
    assert isinstance(axes, Axes)
    for label in (axes.get_xlabel(), axes.get_ylabel()):
        assert re.search(r"\[(m|s|dB)\]", label), label
    assert axes.get_title()
    cell = thing._repr_html_()
    assert "<b>" not in cell
    drawn = Picture.open(io.BytesIO(base64.b64decode(re.search(r"base64,([^\"]+)", cell)[1])))
    assert np.asarray(drawn.convert("L")).std() > 1  # no blank canvas


def test_plots_draw_on_axes_that_are_given():
    from matplotlib.figure import Figure

    given = Figure().subplots()
    assert some_frames().plot(given) is given
    assert some_hits().plot(given) is given
    assert len(given.collections[0].get_offsets()) == 20
    assert given.get_ylim() == (0.5, 6.4)  # as the frames left it


def test_frames_are_drawn_over_their_times_and_ranges_on_a_scale_in_db():
    axes = some_frames().plot()
    left, right, low, high = axes.images[0].get_extent()
    assert (left, right, low, high) == pytest.approx((0.0, 3.9, 0.5, 6.4))
    level = axes.images[0].get_array()
    assert level.shape == (BINS, N)
    assert level.max() == pytest.approx(-60, abs=0.2)
    (line,) = some_frames().plot(frame=-1).lines
    assert np.argmax(line.get_ydata()) == pytest.approx(25, abs=1)


def test_long_recordings_keep_their_highest_amplitudes():
    frames = some_frames(1)
    n = 9001
    samples = np.full((n, BINS), 1e-6, np.complex64)
    samples[4567, 30] = 1.0
    long = ul.Frames(samples, frames.range_m, np.arange(n) * 10**7, frames.spec)
    level = long.plot().images[0].get_array()
    assert level.shape[1] <= 2000
    assert level.max() == pytest.approx(0, abs=1e-3)


def test_maps_and_images_show_the_truth_and_the_flight_and_zoom_on_what_is_known():
    room, path = ul.scenes.room(size_m=(3, 2, 3)).moved((3, 2, 0.5)), some_frames().poses
    axes = some_map().plot(scene=room, path=path)
    assert axes.get_xlim() == pytest.approx((1.55, 4.45), abs=0.06)
    assert len(axes.collections[0].get_segments()) == 8
    assert {text.get_text() for text in axes.get_legend().get_texts()} == {"true walls", "flown"}
    image = some_image().plot(scene=room, path=path, span_db=25)
    assert image.images[0].get_clim() == (-25, 0)
    assert image.get_xlim() == (-1.0, 2.0)


def test_a_volume_from_above_shows_occupied_before_free_and_ambiguous_before_unknown():
    percent = np.full((3, 2, 2), -1, np.int8)
    percent[0, 0, 0], percent[1, 0, 0] = 0, 90
    percent[2, 1, 1] = -2
    axes = ul.OccupancyMap(ul.Grid((0, 0, 0), 1.0, (3, 2, 2)), percent).plot()
    (shown,) = (drawn.get_array() for drawn in axes.images)
    assert shown[0, 0].tolist() == [26, 26, 26, 255]
    assert shown[0, -1, 3] == 0  # unknown
    assert shown[-1, -1].tolist()[:3] == [242, 193, 78]  # ambiguous


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: some_frames().plot(frame=99), "plot: frame is 99 (allowed: 0 to 39)"),
        (lambda: some_map(3).plot(level=5), "plot: level is 5 (allowed: 0 to 4)"),
        (lambda: some_image().plot(span_db=0), "plot: span_db is 0 (allowed: > 0)"),
        (lambda: ul.scenes.plate(1, 1).plot(height_m=float("nan")), "plot: height_m is nan"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(call, words):
    with pytest.raises(InputError, match=re.escape(words)):
        call()


def test_without_matplotlib_a_cell_shows_text_and_a_plot_says_how_to_get_it(monkeypatch):
    for name in ("matplotlib", "matplotlib.pyplot"):
        monkeypatch.setitem(sys.modules, name, None)
    assert some_map()._repr_html_().startswith("<pre>OccupancyMap(")
    with pytest.raises(MissingExtra, match="pip install matplotlib"):
        some_map().plot()


def test_public_modules_list_public_names_only():
    for module in (ul, ul.scenes, ul.figures, ul.metrics, ul.worlds):
        names = dir(module)
        assert names == sorted(names)
        for name in names:
            value = getattr(module, name)
            home = getattr(value, "__module__", module.__name__)
            assert home.startswith("ullage"), f"{module.__name__}.{name} is of {home}"
            assert not name.startswith("_")
