"""Range-time pictures with axes for the viewer, and the layout of its windows."""

from __future__ import annotations

import io
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs, Singles
from ullage.errors import need
from ullage.view.viewer_scene import TIMELINE, rgba

WINDOW_S = 20.0  # duration of the range-time picture
COLUMNS = 240
ROWS = 200  # largest number of rows; longer profiles keep the strongest of neighbouring bins
SPAN_DB = 60.0  # dynamic range of the pictures below the strongest echo
EMPTY = 255  # colour index of places without data
TRAIL_S = 15.0  # time for which the points of echoes stay visible
UNIT_LABELS = {"path_gain": "path gain", "normalised": "sensor's own units", "thesis": "thesis' units"}
"""Labels of the levels of a profile."""


class RangeTime:
    """The last seconds of one radar's profiles as a picture: time to the right, range upwards."""

    def __init__(self, range_m: Floats) -> None:
        self.range_m = range_m
        self._group = math.ceil(len(range_m) / ROWS)
        self.rows = math.ceil(len(range_m) / self._group)
        self._levels = np.full((self.rows, COLUMNS), np.nan, np.float32)
        self._last: int | None = None

    def add(self, t_ns: Longs, level_db: Singles) -> None:
        """Take profiles (n, b) [dB]."""
        pad = self.rows * self._group - level_db.shape[1]
        level = np.pad(level_db, ((0, 0), (0, pad)), constant_values=-np.inf)
        level = level.reshape(len(level_db), self.rows, self._group).max(axis=2)
        step = round(WINDOW_S * 1e9 / COLUMNS)
        for column, profile in zip((t_ns // step).tolist(), level, strict=True):
            ahead = column - self._last if self._last is not None else COLUMNS
            if ahead > 0:
                self._levels = np.roll(self._levels, -min(ahead, COLUMNS), axis=1)
                # a radar slower than the columns repeats its last profile, up to half a second
                fill = profile[:, None] if 1 < ahead <= COLUMNS * 0.5 / WINDOW_S else np.nan
                self._levels[:, -min(ahead, COLUMNS) :] = fill
                self._last = column
            self._levels[:, -1] = np.fmax(self._levels[:, -1], profile)

    def png(self, top_db: float) -> bytes:
        """Encode the picture as PNG, with colours from `top_db` down to the floor [dB]."""
        from PIL import Image

        share = (self._levels[::-1] - (top_db - SPAN_DB)) / SPAN_DB
        index = np.nan_to_num(np.clip(share, 0, 1) * 127, nan=EMPTY).astype(np.uint8) & ~np.uint8(1)
        index[np.isnan(share)] = EMPTY
        picture = Image.fromarray(index)
        picture.putpalette(_palette())
        out = io.BytesIO()
        picture.save(out, "png")
        return out.getvalue()


@lru_cache(maxsize=1)
def _palette() -> bytes:
    from matplotlib import colormaps

    colors = (colormaps["inferno"](np.linspace(0, 1, 128))[:, :3] * 255).astype(np.uint8)
    table = np.full((256, 3), 40, np.uint8)
    table[:128] = colors
    return table.tobytes()


def log_axes(rec: Any, path: str, picture: RangeTime) -> None:
    """Log grid lines and labels of a range-time picture: metres upwards, seconds before now."""
    rr = need("rerun", extra="view")
    near, far = float(picture.range_m[0]), float(picture.range_m[-1])
    tick = next(s for s in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000) if (far - near) / s <= 6)
    metres = np.arange(math.ceil(near / tick) * tick, far, tick)
    y = picture.rows * (1 - (metres - near) / (far - near))
    seconds = np.arange(5 - WINDOW_S, 0, 5)
    x = COLUMNS * (1 + seconds / WINDOW_S)
    lines = [[[0, v], [COLUMNS, v]] for v in y] + [[[u, 0], [u, picture.rows]] for u in x]
    grid = rr.LineStrips2D(lines, colors=rgba("#5c677d"), radii=rr.Radius.ui_points(0.4), draw_order=10)
    rec.log(f"{path}/grid", grid, static=True)
    # the viewer draws labels 13 units below their points, at the size of the layout
    spots = [[-14, v - 13] for v in y] + [[u, picture.rows + 12] for u in [*x, COLUMNS]]
    names = [f"{m:g} m" for m in metres] + [f"{s:g} s" for s in seconds] + ["now"]
    marks = rr.Points2D(spots, labels=names, show_labels=True, colors=rgba("#aab4c3"), radii=0.01, draw_order=11)
    rec.log(f"{path}/ticks", marks, static=True)


def layout(
    sensors: list[str], *, bounds: Floats | None, label: str, placed: bool, trails: list[str], profile_floor: str
) -> Any:
    """Arrange the world at the left; range-time pictures, profiles and nearest echoes at the right.

    Args:
        sensors: entity names of the radars.
        bounds: (2, 3) of the world [m], to place the eye; None: the viewer chooses.
        label: label of the levels.
        placed: whether there are poses, and so a world to show.
        trails: entities that stay visible for some time.
        profile_floor: level at the bottom of the profile bars.
    """
    rrb = need("rerun.blueprint", extra="view")
    bounds_2d = rrb.VisualBounds2D(x_range=[-34, COLUMNS + 20], y_range=[-8, ROWS + 24])
    waterfalls = [
        rrb.Spatial2DView(
            origin=f"profiles/{name}/range_time", name=f"{name}: range over time", visual_bounds=bounds_2d
        )
        for name in sensors
    ]
    bars = [
        rrb.BarChartView(origin=f"profiles/{name}/now", name=f"{name}: profile, dB over {profile_floor}, by range [m]")
        for name in sensors
    ]
    columns = 1 if len(sensors) < 2 else 2
    tabs = rrb.Tabs(
        rrb.Grid(*waterfalls, grid_columns=columns, name=f"Range-time, {label}, {SPAN_DB:g} dB"),
        rrb.Grid(*bars, grid_columns=columns, name="Profiles now"),
    )
    peaks = rrb.TimeSeriesView(origin="strongest", name=f"Strongest echo: {label} [dB]")
    near = rrb.TimeSeriesView(origin="nearest", name="Nearest echo [m]")
    side = rrb.Vertical(tabs, rrb.Tabs(near, peaks), row_shares=[3, 1])
    panels = [rrb.SelectionPanel(state="collapsed"), rrb.BlueprintPanel(state="collapsed")]
    time = rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following")
    if not placed:
        return rrb.Blueprint(side, *panels, time)
    world = rrb.Spatial3DView(
        origin="world",
        name="World",
        background=[24, 28, 34],
        line_grid=False,
        eye_controls=_eye(rrb, bounds),
        overrides=_trails(rrb, trails),
    )
    return rrb.Blueprint(rrb.Horizontal(world, side, column_shares=[3, 2]), *panels, time)


def _eye(rrb: Any, bounds: Floats | None) -> Any:
    if bounds is None or not np.ptp(bounds, axis=0).any():
        return None
    middle, size = bounds.mean(axis=0), np.ptp(bounds, axis=0)
    away = 0.85 * max(float(np.linalg.norm(size[:2])), 1.0)
    direction = np.array([-0.45, -0.6, 0.85])
    return rrb.EyeControls3D(
        position=middle + away * direction, look_target=middle - [0, 0, 0.2 * size[2]], eye_up=(0, 0, 1)
    )


def _trails(rrb: Any, trails: list[str]) -> dict[str, Any]:
    """Keep the flown path visible for the whole run, and points of echoes for `TRAIL_S`."""
    now = rrb.TimeRangeBoundary.cursor_relative(seconds=0)
    out = {}
    for path in trails:
        whole = path.endswith("flown")
        start = rrb.TimeRangeBoundary.infinite() if whole else rrb.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S)
        out[path] = rrb.VisibleTimeRanges(timeline=TIMELINE, start=start, end=now)
    return out


def image_colors(share: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert values 0 to 1 to RGBA (..., 4); weak values are transparent, so that the floor stays visible."""
    from matplotlib import colormaps

    out = (colormaps["inferno"](share) * 255).astype(np.uint8)
    out[..., 3] = (240 * np.clip(share, 0, 1)).astype(np.uint8)
    return np.asarray(out)
