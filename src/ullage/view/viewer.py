"""A sink that shows data in the rerun viewer, live, or saves them to a file."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs, Singles
from ullage.data import Detections, Frames, Recording, Trajectory, sensors_of
from ullage.errors import InputError, UllageWarning, need
from ullage.flow import Sink
from ullage.grids import Grid, Image, OccupancyMap
from ullage.view import viewer_plots as plots
from ullage.view import viewer_scene as scene_view
from ullage.view.map_picture import map_picture
from ullage.view.viewer_output import ViewerOutput
from ullage.view.viewer_scene import TIMELINE, beam_arcs, body_of, entity, log_poses, rgba, time_column
from ullage.world.scene import Scene

RATE_HZ = 30.0  # largest number of frames per second and radar
PROFILE_HZ = 5.0  # rate of the bar charts of profiles
PICTURE_HZ = 2.0  # rate of the range-time pictures
MAP_S = 1.0  # least time between two maps
PATH_S = 0.2  # time between two points of the flown path
MAX_BOXES = 50_000  # largest number of boxes for a volume's cells; more cells become points
BLENDED = 0.999  # rerun blends pictures with their background only at an opacity below 1
FREE_ALPHA = 140  # opacity of free cells: the floor stays visible
SURFACE_LIFT_M = 0.03  # of the lines of surfaces over the map
SURFACE_COLORS = {"plane": "#1a73e6", "cylinder": "#8c40d9", "edge": "#e6334d", "lying": "#1aa6a6", "slope": "#737373"}
IMAGE_DB = 30.0  # dynamic range of radar images below their peak


class ViewerSink(Sink):
    """Shows worlds, flight, echoes, detections, maps and images, live or in a file.

    Args:
        target: empty for a new viewer window, `web` for a page that any browser of this machine can open, a `.rrd`
            file to write, or the address of a running viewer.
        **options: `overwrite` replaces an existing file; `rays` draws the rays of each radar's ray model, at most 225
        of
            them; `port` is the page's port (9090); the data use the next port.

    Attributes:
        address: address of the page, empty if none is served. The page is served until this process ends.

    Raises:
        MissingExtra: rerun is not installed.
        InputError: there is no display, no such viewer or option, a port is taken, or the file cannot be written.
    """

    def __init__(self, target: str | Path = "", **options: Any) -> None:
        self._rr = need("rerun", extra="view")
        self._output = ViewerOutput.of(str(target), options)
        self.target, self.live = self._output.place, self._output.live
        self._rec = self._rr.RecordingStream("ullage")
        for log_columns in (self._rec.set_log_time_enabled, self._rec.set_log_tick_enabled):
            log_columns(False)  # one time line: that of the frames
        self.address = self._output.open(self._rr, self._rec)
        self._closed = False
        self._sensors: dict[str, _Shown] = {}
        self._bounds: Floats | None = None
        self._arranged: tuple[Any, ...] = ()
        self._now_ns = 0
        self._height_m = 0.0
        self._top_db = -np.inf
        self._body_last: tuple[int, Floats] | None = None
        self._map_given: tuple[float, float] = (-np.inf, -np.inf)  # recording's and wall clock [s]
        self._map_waiting: OccupancyMap | None = None
        self._rec.log("world", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def write(self, item: Any) -> None:
        """Show one item; items without a picture are ignored.

        Raises:
            InputError: the sink is closed.
        """
        if self._closed:
            raise InputError("closed already", where=f"viewer:{self.target}")
        if isinstance(item, Frames | Mapping | list | tuple):
            self._frames(item)
        elif isinstance(item, Detections):
            self._detections(item)
        elif isinstance(item, OccupancyMap):
            self._map(item)
        elif isinstance(item, Image):
            self._image(item)
        elif isinstance(item, Scene):
            scene_view.log_scene(self._rec, item)
            self._bounds = item.bounds
            self._arrange()
        elif isinstance(item, Trajectory):
            thin = self._rr.Radius.ui_points(0.7)
            strip = self._rr.LineStrips3D([item.position], colors=rgba("#8d99ae", 120), radii=thin)
            self._rec.log("world/trajectory", strip, static=True)

    def close(self) -> None:
        """Show pending data and end the file or the connection; a page is served until the process ends."""
        if self._closed:
            return
        self._closed = True
        if self._map_waiting is not None:
            self._show_map(self._map_waiting)
        for shown in self._sensors.values():
            self._picture(shown)
        try:
            self._rec.flush(timeout_sec=10.0)
        except Exception as error:  # rerun raises kinds of its own; a window closed early must not end a run
            warnings.warn(f"viewer:{self.target}: not everything was shown: {error}", UllageWarning, stacklevel=2)
        finally:
            if not self.address:
                self._rec.disconnect()

    def _frames(self, chunk: Recording) -> None:
        parts = sensors_of(chunk)
        for index, part in enumerate(parts):
            if part.sensor not in self._sensors:
                self._begin(part)
            self._now_ns = max(self._now_ns, int(part.t_ns[-1]))
            if index == 0:
                self._body(part)
            self._profiles(self._sensors[part.sensor], part)
        self._arrange()

    def _begin(self, part: Frames) -> None:
        shown = _Shown(part, scene_view.sensor_color(len(self._sensors)))
        self._sensors[part.sensor] = shown
        rr, name, color = self._rr, shown.name, rgba(shown.color)
        plots.log_axes(self._rec, f"profiles/{name}/range_time", shown.picture)
        for path in ("nearest", "strongest"):
            self._rec.log(f"{path}/{name}", rr.SeriesLines(colors=color, names=name, widths=1.5), static=True)
        if part.poses is not None:
            scene_view.log_drone(self._rec)
            scene_view.log_beam(self._rec, f"world/radars/{name}", part.spec, shown.color)
            if self._output.rays:
                scene_view.log_rays(self._rec, f"world/radars/{name}", part.spec, shown.color)
            arc = rr.LineStrips3D.from_fields(colors=color, radii=rr.Radius.ui_points(1.5))
            self._rec.log(f"world/echoes/{name}/arcs", arc, static=True)
            trail = rr.Points3D.from_fields(colors=rgba(shown.color, 200), radii=rr.Radius.ui_points(1.6))
            self._rec.log(f"world/echoes/{name}/trail", trail, static=True)

    def _body(self, part: Frames) -> None:
        """Show the drone and its path, from the poses of the first radar."""
        body = body_of(part)
        if body is None:
            return
        self._height_m = float(np.median(body.position[:, 2]))
        log_poses(self._rec, "world/drone", body[spread(body.t_ns, RATE_HZ)])
        path = body[spread(body.t_ns, 1 / PATH_S)]
        spots, times = path.position, path.t_ns
        if self._body_last is not None:
            spots = np.vstack([self._body_last[1], spots])
            times = np.concatenate([[self._body_last[0]], times])
        self._body_last = int(times[-1]), spots[-1]
        if len(spots) > 1:
            strips = np.stack([spots[:-1], spots[1:]], axis=1).astype(np.float32)
            columns = self._rr.LineStrips3D.columns(strips=strips)
            self._rec.send_columns("world/flown", indexes=[time_column(times[1:])], columns=columns)
        style = self._rr.LineStrips3D.from_fields(colors=rgba(scene_view.PATH), radii=self._rr.Radius.ui_points(1.8))
        self._rec.log("world/flown", style, static=True)

    def _profiles(self, shown: _Shown, part: Frames) -> None:
        level = (20 * np.log10(np.maximum(part.amplitude, 1e-12))).astype(np.float32)
        self._top_db = max(self._top_db, 5 * float(np.ceil(level.max() / 5)))
        shown.picture.add(part.t_ns, level)
        keep = spread(part.t_ns, RATE_HZ)
        if self.live:
            given = shown.allowed(len(keep))
            keep = keep[(np.arange(1, given + 1) * len(keep)) // given - 1]  # evenly, with the newest
        shown.chunk = part[keep]
        column, name = time_column(part.t_ns[keep]), shown.name
        if part.poses is not None:
            log_poses(self._rec, f"world/radars/{name}", part.poses[keep])
            self._set_time(int(part.t_ns[0]))
            for path in ("arcs", "trail"):
                self._rec.log(f"world/echoes/{name}/{path}", self._rr.Clear(recursive=False))
        peaks = self._rr.Scalars.columns(scalars=level[keep].max(axis=1).astype(float))
        self._rec.send_columns(f"strongest/{name}", indexes=[column], columns=peaks)
        for row in keep[spread(part.t_ns[keep], PROFILE_HZ)]:
            self._set_time(int(part.t_ns[row]))
            values = np.maximum(level[row] - (self._top_db - plots.SPAN_DB), 0).astype(np.float16)
            bars = self._rr.BarChart(values, abscissa=part.range_m.astype(np.float32), color=rgba(shown.color))
            self._rec.log(f"profiles/{name}/now", bars)
        if self._now_ns - shown.pictured_ns >= 1e9 / PICTURE_HZ:
            self._picture(shown)

    def _picture(self, shown: _Shown) -> None:
        shown.pictured_ns = self._now_ns
        self._set_time(self._now_ns)
        file = self._rr.EncodedImage(contents=shown.picture.png(self._top_db), media_type="image/png")
        self._rec.log(f"profiles/{shown.name}/range_time", file)

    def _detections(self, hits: Detections) -> None:
        shown = self._sensors.get(hits.sensor)
        if shown is None:
            return
        kept = np.flatnonzero(np.isin(hits.t_ns, shown.chunk.t_ns))
        if not len(kept):
            return
        times, count = np.unique(hits.t_ns[kept], return_counts=True)
        first = np.concatenate([[0], np.cumsum(count)[:-1]])
        order = kept[np.argsort(hits.t_ns[kept], kind="stable")]
        nearest = np.minimum.reduceat(hits.range_m[order], first)
        scalars = self._rr.Scalars.columns(scalars=nearest)
        self._rec.send_columns(f"nearest/{shown.name}", indexes=[time_column(times)], columns=scalars)
        if shown.chunk.poses is not None:
            self._arcs(shown, hits, order)

    def _arcs(self, shown: _Shown, hits: Detections, order: Longs) -> None:
        """Show each echo as the arc of its possible places, and a point at its bearing, or ahead."""
        chunk, rr, path = shown.chunk, self._rr, f"world/echoes/{shown.name}"
        row = np.searchsorted(chunk.t_ns, hits.t_ns[order])
        opening_deg = scene_view.beam_deg(chunk.spec)[0]
        strips, ahead = beam_arcs(chunk.believed.world_from_body[row], hits.range_m[order], opening_deg)
        known = np.asarray(np.isfinite(hits.point[order]).all(axis=1))
        spots = np.where(known[:, None], hits.point[order], ahead).astype(np.float32)
        count = np.bincount(row, minlength=len(chunk))
        index = [time_column(chunk.t_ns)]
        flat = rr.LineStrips3D.columns(strips=strips.astype(np.float32))
        self._rec.send_columns(f"{path}/arcs", indexes=index, columns=flat.partition(lengths=count))
        points = rr.Points3D.columns(positions=spots)
        self._rec.send_columns(f"{path}/trail", indexes=index, columns=points.partition(lengths=count))

    def _map(self, omap: OccupancyMap) -> None:
        now, wall = self._now_ns * 1e-9, time.monotonic()
        soon = now - self._map_given[0] < MAP_S or (self.live and wall - self._map_given[1] < MAP_S / 2)
        self._map_waiting = omap if soon else None
        if not soon:
            self._map_given = now, wall
            self._show_map(omap)

    def _show_map(self, omap: OccupancyMap) -> None:
        self._set_time(self._now_ns)
        self._surfaces(omap)
        if omap.grid.dims == 2:
            self._plane("world/map", omap.grid, map_picture(omap, free_alpha=FREE_ALPHA), lift_m=0.0)
            return
        rr, cells = self._rr, np.argwhere(omap.occupied)
        centers = _centers(omap.grid, cells)
        gray = (235 - 2 * omap.percent[omap.occupied].astype(int)).astype(np.uint8)
        colors = np.stack([gray, gray, np.full_like(gray, 80)], axis=1)
        half = omap.grid.step_m / 2
        if len(cells) <= MAX_BOXES:
            shape = rr.Boxes3D(centers=centers, half_sizes=[[half] * 3], colors=colors, fill_mode="solid")
        else:
            shape = rr.Points3D(centers, colors=colors, radii=half)
        self._rec.log("world/map", shape)

    def _surfaces(self, omap: OccupancyMap) -> None:
        """Show the surfaces of a map as lines, coloured by kind."""
        height = 0.0
        if omap.grid.dims == 2:
            height = float(omap.grid.at_height(self._height_m).origin_m[2]) + SURFACE_LIFT_M
        for kind, color in SURFACE_COLORS.items():
            mine = [one for one in omap.surfaces if one.kind == kind and (one.on_map or kind == "slope")]
            lines = [one.lines(1.5 * omap.grid.step_m, height) for one in mine]
            strips = np.concatenate(lines).astype(np.float32) if lines else np.zeros((0, 2, 3), np.float32)
            shown = self._rr.LineStrips3D(strips, colors=rgba(color), radii=self._rr.Radius.ui_points(1.5))
            if omap.surfaces:
                self._rec.log(f"world/surfaces/{kind}", shown)

    def _image(self, image: Image) -> None:
        self._set_time(self._now_ns)
        level = 20 * np.log10(np.maximum(image.amplitude, 1e-30) / max(float(image.amplitude.max()), 1e-30))
        share = np.clip(1 + level / IMAGE_DB, 0, 1)
        if image.grid.dims == 2:
            self._plane("world/image", image.grid, plots.image_colors(share), lift_m=0.02)
            return
        cells = np.argwhere(share > 0.5)
        colors = plots.image_colors(share[share > 0.5])
        points = self._rr.Points3D(_centers(image.grid, cells), colors=colors, radii=image.grid.step_m / 2)
        self._rec.log("world/image", points)

    def _plane(self, path: str, grid: Grid, colors: NDArray[np.uint8], *, lift_m: float) -> None:
        """Send a picture of a grid, RGBA (rows, columns, 4), cropped to its visible part."""
        some = np.argwhere(colors[..., 3] > 0)
        if not len(some):
            return
        step_m = grid.step_m * grid.shape[-1] / colors.shape[1]  # of a pixel
        (j, i), (top, right) = some.min(axis=0), some.max(axis=0) + 1
        part = np.ascontiguousarray(colors[j:top, i:right][::-1])  # the first row is the highest y
        form = self._rr.components.ImageFormat(
            width=right - i, height=top - j, color_model="RGBA", channel_datatype="U8"
        )
        x, y, z = grid.at_height(self._height_m).origin_m
        corner = [x + i * step_m, y + j * step_m, z + lift_m]
        plane = self._rr.GridMap(
            data=part.tobytes(), format=form, cell_size=step_m, translation=corner, opacity=BLENDED
        )
        self._rec.log(path, plane)

    def _set_time(self, t_ns: int) -> None:
        if scene_view.is_date(t_ns):
            self._rec.set_time(TIMELINE, timestamp=np.datetime64(t_ns, "ns"))
        else:
            self._rec.set_time(TIMELINE, duration=np.timedelta64(t_ns, "ns"))

    def _arrange(self) -> None:
        """Update the layout of the windows when there are new data to show."""
        parts = [shown.chunk for shown in self._sensors.values()]
        placed = self._bounds is not None or any(part.poses is not None for part in parts)
        state = (tuple(self._sensors), placed, self._bounds is None)
        if not parts or state == self._arranged:
            return
        self._arranged = state
        names = [shown.name for shown in self._sensors.values()]
        blueprint = plots.layout(
            names,
            bounds=self._bounds,
            label=plots.UNIT_LABELS[parts[0].unit],
            placed=placed,
            trails=["world/flown", *(f"world/echoes/{name}/trail" for name in names)],
            profile_floor=f"{self._top_db - plots.SPAN_DB:g}",
        )
        self._rec.send_blueprint(blueprint, make_active=True, make_default=True)


class _Shown:
    """State of one radar: its newest frames, its range-time picture, and the rate at which it was shown."""

    def __init__(self, part: Frames, color: str) -> None:
        self.name, self.color = entity(part.sensor), color
        self.chunk = part
        self.picture = plots.RangeTime(part.range_m)
        self.pictured_ns = -(2**62)
        self._wall_s, self._credit = time.monotonic(), RATE_HZ

    def allowed(self, wanted: int) -> int:
        """Return the number of available frames to show now, limited by wall-clock time; at least one."""
        wall = time.monotonic()
        self._credit = min(RATE_HZ, self._credit + RATE_HZ * (wall - self._wall_s))
        self._wall_s = wall
        given = max(1, min(wanted, int(self._credit)))
        self._credit -= given
        return given


def spread(t_ns: Longs, rate_hz: float) -> Longs:
    """Select rows of increasing times at no more than this rate [Hz], including the last one."""
    slot = np.ceil((t_ns - t_ns[-1]) * rate_hz * 1e-9 - 1e-6)
    return np.flatnonzero(np.append(slot[1:] != slot[:-1], True))


def _centers(grid: Grid, cells: Longs) -> Singles:
    axes = (grid.x_m[cells[:, 2]], grid.y_m[cells[:, 1]], grid.z_m[cells[:, 0]])
    return np.stack(axes, axis=1).astype(np.float32)
