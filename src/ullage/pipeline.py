"""Main loop: a source gives frames in chunks, stages process them, and sinks take all results.

Simulated, recorded and live frames come through here alike, piece by piece, so memory stays flat however long it runs.
"""

from __future__ import annotations

import logging
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ullage import flow
from ullage.config import DetectMethod, ImageMethod, MapMethod
from ullage.data import Detections, Frames, Recording, joined, sensors_of
from ullage.errors import InputError, UllageWarning, need, shown
from ullage.flow import Due, Stage
from ullage.grids import Grid, Image, OccupancyMap
from ullage.stop_signals import StopFlag

if TYPE_CHECKING:
    from ullage.live_run import LiveStatistics
    from ullage.ports.intake import Covered
    from ullage.processing.health import HealthMonitor
    from ullage.processing.image_sum import ImageSum
    from ullage.processing.own_echo import OwnEchoFilter
    from ullage.processing.scatterers import Scatterer

Chunk = dict[str, Frames]
LOGGER = logging.getLogger("ullage")
VIEWER = "viewer:"
HELD_FRAMES = 2048  # of a sensor, collected for an image


def _own_echo_filter() -> OwnEchoFilter:
    from ullage.processing.own_echo import OwnEchoFilter

    return OwnEchoFilter()


def _health_monitor() -> HealthMonitor:
    from ullage.processing.health import HealthMonitor

    return HealthMonitor()


def _covered(times: NDArray[np.int64]) -> Covered:
    """Counts the time that frames cover; a gap is longer than two seconds and than four frames of a slow radar."""
    from ullage.ports.intake import GAP_NS, Covered

    period_ns = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    return Covered(max(GAP_NS, round(4 * period_ns)))


class Source(Protocol):
    """Anything that measures."""

    def stream(self) -> Iterator[Chunk]:
        """Pieces in order of time, each a dict of Frames by sensor name."""


class Sink(Protocol):
    """Receiver of frames and results: a recording, map files, a viewer, a live port."""

    def write(self, item: Any) -> None:
        """Take one item; what a sink has no place for, it passes over."""

    def close(self) -> None:
        """End, with everything written."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Results of a run."""

    frames: int  # of all sensors
    duration_s: float  # covered by the frames, by their own clock, without gaps as where a clock stepped
    interrupted: bool  # by Ctrl-C; everything up to then is written
    results: tuple[Any, ...]  # what the stages gave at the end
    live: LiveStatistics | None = None  # how well a live run kept up


@dataclass(slots=True)
class _Count:
    frames: int = 0
    covered: Covered | None = None

    def add(self, chunk: Chunk) -> None:
        self.frames += sum(map(len, chunk.values()))
        if chunk:
            times = np.unique(np.concatenate([part.t_ns for part in chunk.values()]))
            self.covered = self.covered or _covered(times)
            self.covered.take(times)

    @property
    def duration_s(self) -> float:
        return 0.0 if self.covered is None else self.covered.total_s


def sink(target: str | Path, **options: Any) -> flow.Sink:
    """Open a sink for frames and results: a viewer, a recording or a map file, by the kind of name.

    Args:
        target: `viewer:` for a window, `viewer:web` for a page that browsers open, `viewer:FILE.rrd` to look at it
            later, `viewer:rerun+http://HOST:9876/proxy` for a viewer that runs elsewhere; `window:` for the amplitudes
            in matplotlib; a `.mcap` recording, a folder for one, a `.zarr` store, or a map file:
            `.yaml` or `.pgm` (map_server), `.bt` or `.ot` (OctoMap), `.ply`.
        **options: of that kind: viewers take rays, pages port, files of a viewer, recordings and stores overwrite,
            map_server takes mode.

    Raises:
        InputError: it is of no known kind, or cannot be written or shown.
    """
    from ullage.ports import registry

    if str(target) == "window:":
        from ullage.view.window import WindowSink

        return WindowSink(**options)
    if not str(target).startswith(VIEWER):
        return registry.sink(target, **options)
    from ullage.view.viewer import ViewerSink

    place, options = _viewer(target, options)
    return ViewerSink(place, **options)


def _viewer(target: str | Path, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return place and options of `viewer:PLACE?key=value`."""
    from ullage.ports.live import Address

    address = Address.of(target, **options)
    return ("", options) if address is None else (address.place, address.options)


def check_sink(target: str | Path) -> None:
    """Check what can be checked of a sink without opening it: its kind, its library, and that its file can be written.

    Raises:
        InputError: it is of no known kind, its file is there already, or its folder cannot be written.
        MissingExtra: its library is not installed.
    """
    from ullage.ports import registry

    if str(target) == "window:":
        from ullage.view.window import check_display

        check_display()
        return
    if not str(target).startswith(VIEWER):
        registry.check_sink(target)
        return
    from ullage.view.viewer_output import ViewerOutput

    need("rerun", extra="view")
    output = ViewerOutput.of(*_viewer(target, {}))
    output.check()
    if not (output.live or output.overwrite):
        registry.check_new(Path(output.place))


def run(
    source: Source | Recording,
    *,
    stages: Sequence[Stage] = (),
    sinks: Sequence[Sink] = (),
    progress: Callable[[float], None] | None = None,
    on_lag: Callable[[float, int], None] | None = None,
) -> Outcome:
    """Take frames from a source until it ends or Ctrl-C; give every piece and result to every sink.

    A live port is received in a thread of its own, obstacles are found there, and each sink has its own thread, so
    that none waits for a map; what cannot keep up leaves out the oldest frames (`ullage.live_run`).

    Args:
        source: gives the frames; or frames in memory, of one sensor or a dict of several.
        stages: process every chunk in turn; their results go to the sinks.
        sinks: take frames and results; closed at the end in every case.
        progress: called with the seconds of recording done so far, after each piece.
        on_lag: called in a live run with the seconds that map and image are behind, and the frames left out so far.

    Returns:
        Counts, and what the stages gave when they finished.

    Raises:
        InputError: the source gives no frames, or a stage or sink is none.
    """
    given = InMemorySource(source) if isinstance(source, Frames | Mapping | list | tuple) else source
    stream = getattr(given, "stream", None)
    if stream is None:
        raise InputError(f"the source is a {type(source).__name__}", where="run", allowed="ul.open(...), or Frames")
    _check_parts("stage", stages, ("update", "finish"))
    _check_parts("sink", sinks, ("write", "close"))
    count, interrupted = _Count(), False
    try:
        if getattr(given, "passing", None) is not None:
            from ullage.live_run import LiveLoop

            loop = LiveLoop(given, stages, sinks, count)
            results = loop.run(progress, on_lag)
            return Outcome(count.frames, count.duration_s, loop.interrupted, results, loop.statistics())
        try:
            # a live source waits for its peer without end, so there Ctrl-C raises
            with nullcontext(StopFlag()) if hasattr(given, "close") else StopFlag() as stop:
                for chunk in stream():
                    if chunk:
                        count.add(chunk)
                        LOGGER.debug("%d frames of %s, %.2f s so far", sum(map(len, chunk.values())), ", ".join(chunk),
                                     count.duration_s)  # fmt: skip
                        _give(chunk, sinks)
                        for item in (item for stage in stages for item in stage.update(chunk)):
                            _give(item, sinks)
                    if progress is not None:
                        progress(count.duration_s)
                    if interrupted := stop.requested:
                        break
        except KeyboardInterrupt:
            interrupted = True
        results = tuple(item for stage in stages for item in stage.finish())
        for item in results:
            _give(item, sinks)
    finally:
        with ExitStack() as closing:  # one that fails does not leave the others open
            for sink in reversed(sinks):
                closing.callback(sink.close)
    return Outcome(count.frames, count.duration_s, interrupted, results)


def _check_parts(kind: str, parts: Sequence[Any], methods: tuple[str, str]) -> None:
    """Refuse a stage or sink that is none."""
    for part in parts:
        if not all(callable(getattr(part, method, None)) for method in methods):
            raise InputError(f"a {kind} is {shown(part)}", where="run", allowed=f"objects with {' and '.join(methods)}")


def _placed(chunk: Chunk) -> Chunk:
    """Return the frames that have poses: a live source of poses may pause."""
    lacking = any(part.poses is None for part in chunk.values())
    return {name: part for name, part in chunk.items() if part.poses is not None} if lacking else chunk


def _give(item: Any, sinks: Sequence[Sink]) -> None:
    for sink in sinks:
        sink.write(item)


@dataclass(frozen=True, slots=True)
class InMemorySource:
    """Frames already in memory, as a source."""

    recording: Recording
    size: int = 256

    def stream(self) -> Iterator[Chunk]:
        """Give pieces in order of time."""
        parts = sensors_of(self.recording)
        for start in range(0, max(len(p) for p in parts), self.size):
            yield {p.sensor: p[start : start + self.size] for p in parts if start < len(p)}


@dataclass(slots=True)
class DetectStage(Stage):
    """Detections, piece by piece."""

    method: DetectMethod | None = "first_peak"  # None: the first peak of the thesis' echoes, else all peaks
    threshold: float | None = None
    own_echo: OwnEchoFilter | None = field(default_factory=_own_echo_filter)  # None: the radar's own echo stays
    found: int = 0
    _seen: dict[str, int] = field(default_factory=dict)

    def update(self, chunk: Chunk) -> Iterable[Detections]:
        """Detections of each sensor, `frame` counted from the start of the recording."""
        from ullage.processing.detect import detect

        if self.own_echo is not None:
            chunk = self.own_echo.clean(chunk)
        for name, part in chunk.items():
            method = self.method or ("first_peak" if part.ray_model else "peaks")
            hits = detect(part, method=method, threshold=self.threshold, remove_own_echo=False)
            before = self._seen.get(name, 0)
            self._seen[name] = before + len(part)
            self.found += len(hits)
            if len(hits):
                yield replace(hits, frame=hits.frame + before)


@dataclass(slots=True)
class MapStage:
    """An occupancy map that grows with each piece, given whole every so often and at the end.

    The last map of frames that `ul.calibrate` put on a track also holds the scatterers that stay coherent along it.

    A flight that leaves the grid is refused, unless the map is live: then the grid could not be chosen for
    it, and what is seen from outside is left out until it is back. Frames that a radar did not receive are left out.
    """

    grid: Grid
    method: MapMethod = "ullage"
    threshold: float | None = None
    every_s: float = 1.0
    live: bool = False
    own_echo: OwnEchoFilter | None = field(default_factory=_own_echo_filter)  # None: the radar's own echo stays
    floor_z_m: float | None = None  # height of a level floor, whose echoes are left out of a plane [m]
    target_z_m: float | None = None  # height of scatterers where the track is straight; None: that of the track [m]
    vehicle_radius_m: float | None = None  # of the ball about the antenna that the vehicle fills; None: 0.25 m
    scatterer_pfa: float = 0.01  # probability that clutter alone gives a coherent scatterer
    scatterers: list[Scatterer] = field(default_factory=list)  # of calibrated frames, once finished
    _calibrated: dict[str, list[Frames]] = field(default_factory=dict)
    health: HealthMonitor = field(default_factory=_health_monitor)
    _away: bool = False
    _mapper: Any = None
    _due: Due | None = None

    def __post_init__(self) -> None:
        self.grid.check_memory(3, "the map")  # whole, as it is shown and written, with what makes it

    def update(self, chunk: Chunk) -> Iterable[OccupancyMap]:
        """Return the map so far, once per `every_s` of recording."""
        from ullage.processing.occupancy import COHERENT, Mapper

        # the first frames show the place of the vehicle, even if none is sound
        sound = _placed(self.health.sound(chunk))
        chunk = _placed(chunk)
        if not chunk or (not sound and self._mapper is not None):
            return
        chunk = sound or chunk
        if self.own_echo is not None:
            chunk = self.own_echo.clean(chunk)
        if self.live and not (chunk := self._inside(chunk)):
            return
        if self._mapper is None:
            # the other mappers have their own level for every profile
            own = {"floor_z_m": self.floor_z_m, "vehicle_radius_m": self.vehicle_radius_m}
            options = {"elfes": {"threshold": self.threshold}}.get(self.method, own if self.method in COHERENT else {})
            known = {name: value for name, value in options.items() if value is not None}
            self._mapper = Mapper(self.grid, method=self.method, **known)
        self._mapper.update(chunk)
        for name, part in chunk.items():
            if part.calibration is not None and self.method in COHERENT:
                self._calibrated.setdefault(name, []).append(part)
        now = max(int(p.t_ns[-1]) for p in chunk.values())
        self._due = self._due or Due(self.every_s)
        if self._due.reached(now):
            yield self._mapper.map()

    def _inside(self, chunk: Chunk) -> Chunk:
        """What was seen from within the grid; that something is left out is said once for each time that it begins."""
        inside = {name: self.grid.index(part.believed.position)[1] for name, part in chunk.items()}
        if all(row.all() for row in inside.values()):
            self._away = False
            return chunk
        if not self._away:
            left, right, bottom, top = self.grid.extent_m
            text = (
                f"the flight has left the map (x {left:.1f}..{right:.1f}, y {bottom:.1f}..{top:.1f} m); what is seen "
            )
            warnings.warn(text + "from outside is left out (a larger reach_m holds more)", UllageWarning, stacklevel=2)
        self._away = True
        return {name: chunk[name][row] for name, row in inside.items() if row.any()}

    def finish(self) -> Iterable[OccupancyMap]:
        """Return the final map."""
        if self._mapper is None:
            return ()
        self._mapper.finish()
        from ullage.processing.scatterers import find_scatterers, with_scatterers

        omap = self._mapper.map()
        for parts in self._calibrated.values():
            whole = joined(parts)
            found = find_scatterers(whole, z_m=self.target_z_m, pfa=self.scatterer_pfa)
            omap = with_scatterers(omap, found)
            self.scatterers += found
        return (omap,)


@dataclass(slots=True)
class ImageStage:
    """A SAR image that grows with each piece; its memory is the grid's, however long the flight.

    Frames wait until there are `held_frames` of a sensor, so that its own echo is estimated from a long part of the
    track. With `every_s` the image so far is given as well, once per so much of the recording. It has the frames that
    wait without the own echo as known by then. No piece sums more than four times its own frames. The final image is
    the same.
    """

    grid: Grid
    method: ImageMethod = "backprojection"
    sensor: str = ""  # one sensor; none: all
    own_echo: OwnEchoFilter | None = field(default_factory=_own_echo_filter)  # None: the radar's own echo stays
    every_s: float | None = None  # None: at the end only
    held_frames: int = HELD_FRAMES  # of a sensor that wait, so that its own echo is estimated from a long part
    _held: dict[str, list[Frames]] = field(default_factory=dict)
    _sum: ImageSum | None = None
    _early: ImageSum | None = None  # with the frames that wait
    _early_echo: OwnEchoFilter = field(default_factory=_own_echo_filter)
    _backlog: dict[str, deque[Frames]] = field(default_factory=dict)  # released, and not summed yet
    _since: dict[str, ImageSum] = field(default_factory=dict)  # frames after those of the backlog
    _due: Due | None = None

    def update(self, chunk: Chunk) -> Iterable[Image]:
        """Adds this piece; the image so far, where one is due."""
        chunk = {name: part for name, part in _placed(chunk).items() if self.sensor in ("", name)}
        if self.every_s is not None and self.own_echo is not None:
            self._add_early(chunk)
        for name, part in chunk.items():
            if self.own_echo is None:
                self._exact().add(name, part)
                continue
            self._work_off(name, 2 * len(part))
            held = self._held.setdefault(name, [])
            held.append(part)
            if sum(map(len, held)) >= self.held_frames:
                self._release(name)
        if self.every_s is None or not chunk:
            return ()
        self._due = self._due or Due(self.every_s)
        if not self._due.reached(max(int(part.t_ns[-1]) for part in chunk.values())):
            return ()
        image = (self._early or self._exact()).image()
        return () if image is None else (image,)

    def _empty(self) -> ImageSum:
        from ullage.processing.image_sum import ImageSum

        return ImageSum(self.grid, self.method)

    def _exact(self) -> ImageSum:
        """The sum that becomes the final image."""
        self._sum = self._sum or self._empty()
        return self._sum

    def _add_early(self, chunk: Chunk) -> None:
        """Add a piece to the image so far, without the own echo as known by now."""
        early = self._early = self._early or self._empty()
        for name, part in self._early_echo.clean(chunk).items():
            early.add(name, part)
            if name in self._since:
                self._since[name].add(name, part)

    def _release(self, name: str) -> None:
        """Take the own echo from the frames that waited. Where images are given in flight, later pieces sum them."""
        self._work_off(name)
        if self.own_echo is None or not (held := self._held.pop(name, [])):
            return
        for part in held:
            self.own_echo.learn({name: part})
        self._backlog[name] = deque(self.own_echo.removed_from({name: part})[name] for part in held)
        if self._early is None:
            self._work_off(name)
            return
        since = self._since[name] = self._empty()
        since.begin(name, held[-1].believed.position[-1])

    def _work_off(self, name: str, count: int | None = None) -> None:
        """Sum released frames of a sensor, about `count` of them (None: all), so that no piece takes much longer."""
        backlog, done = self._backlog.get(name), 0
        if backlog is None:
            return
        while backlog and (count is None or done < count):
            part = backlog.popleft()
            self._exact().add(name, part)
            done += len(part)
        if not backlog:
            del self._backlog[name]
            if self._early is not None:
                self._early.take_over(name, self._exact())
                self._early.merge(name, self._since.pop(name))

    def finish(self) -> Iterable[Image]:
        """Return the image."""
        for name in list(self._held):
            self._release(name)
        for name in list(self._backlog):
            self._work_off(name)
        image = self._exact().image()
        return () if image is None else (image,)
