"""Run a scenario or a recording: source, stages, sinks, then figures, metrics and report, all in one folder."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ullage.arrays import Floats
from ullage.config import Scenario, scenario_text
from ullage.data import Frames, Metric, Trajectory
from ullage.errors import InputError, UllageError
from ullage.experiments.catalog import LAWS
from ullage.experiments.folder import RunFolder, metric_tree, write_json, write_text
from ullage.experiments.imaging import ImagePlane, image_plane, plane_findings
from ullage.experiments.run import Compared, MapSaver, ObstacleTable, Report, Run, of_scenario, write_map_files
from ullage.experiments.simulated import Simulated, prepare
from ullage.experiments.verdict import inspect, place_of, verdict
from ullage.flow import Stage
from ullage.grids import Grid, Image, OccupancyMap
from ullage.pipeline import LOGGER, DetectStage, ImageStage, MapStage, Outcome, Sink, Source, run
from ullage.processing.empty_map import why_empty
from ullage.processing.metrics import map_quality, worst_moment
from ullage.processing.obstacles import ObstacleStage
from ullage.processing.own_echo import without_own_echo
from ullage.processing.summation import apex
from ullage.processing.truth import NoSurfaceError
from ullage.radar.explain import explain
from ullage.radar.worker_pool import WorkerPool
from ullage.stop_signals import raise_if_stopped
from ullage.view import figures, report_figures
from ullage.view.replay import Explained, Parts, write_replay
from ullage.view.report import write_report
from ullage.world.scene import Scene
from ullage.world.section import section

if TYPE_CHECKING:
    from ullage.experiments.exploration import Exploration

Log = Callable[[str], None]
LIVE_S = 0.2
"""Between two maps or images of a live run: five a second, as the nodes of the thesis [Billdal2018, appendix B]."""
WATCHED_S = 1.0
"""Between two maps or images of any other run."""


def execute(
    job: Run,
    *,
    sinks: Sequence[Sink] = (),
    progress: Callable[[float], None] | None = None,
    on_lag: Callable[[float, int], None] | None = None,
    log: Log = LOGGER.info,
    draw: bool = True,
) -> Report:
    """Run the loop, then write map files, metrics, figures, report and provenance, and put the run in its place.

    A run that is cut short (disk full, source refused, second Ctrl-C) stays in its draft folder, marked as unfinished.

    Args:
        job: what to run.
        sinks: besides the folder's own recording.
        progress: called with the seconds of recording done.
        on_lag: called in a live run with the seconds that map and image are behind, and the frames left out.
        log: called with each step in a few words.
        draw: figures too; without them the report holds numbers only.
    """
    try:
        write_text(job.folder / "scenario.yaml", scenario_text(job.scenario))
        job.place.mark_running()
        outcome = _receive(job, sinks, progress, on_lag, draw=draw and not job.live)
        report = _finish(job, outcome, log if draw else None)
    except BaseException as error:
        _keep_what_came(job, error)
        raise
    folder = job.place.finish(interrupted=outcome.interrupted)
    return replace(report, folder=folder, figures=tuple(folder / "figures" / p.name for p in report.figures))


def _receive(
    job: Run,
    sinks: Sequence[Sink],
    progress: Callable[[float], None] | None,
    on_lag: Callable[[float, int], None] | None,
    *,
    draw: bool,
) -> Outcome:
    """Run the loop; the map so far is saved every minute, and drawn once where figures are wanted."""
    stages = _stages(job)
    wall, cpu = time.perf_counter(), time.process_time()

    def first_picture(omap: OccupancyMap) -> None:
        LOGGER.info("first picture: %s", _draw_map(job, omap))

    keeping: list[Sink] = [MapSaver(job.folder, draw=first_picture if draw else None), job.history]
    if job.obstacles is not None:
        keeping.append(job.obstacles)
    given = [*sinks, *job.sinks, *keeping]
    outcome = run(job.source, stages=stages, sinks=given, progress=progress, on_lag=on_lag)
    if job.live:
        paths = (frames.poses for frames in job.sampled.frames().values())
        job.flown = next((path for path in paths if path is not None), job.flown)
    job.timing |= {"loop_wall_s": time.perf_counter() - wall, "loop_cpu_s": time.process_time() - cpu}
    return outcome


def _finish(job: Run, outcome: Outcome, log: Log | None) -> Report:
    """Write maps, metrics, figures and report; provenance.json comes last but one and marks the run as complete.

    Args:
        job: the run.
        outcome: what the loop gave.
        log: called when figures are drawn; None: none are.
    """
    for item in outcome.results:
        if isinstance(item, OccupancyMap):
            write_map_files(job.folder, item)
    with _beside(job.rival if not outcome.interrupted else None) as answer:
        metrics = _metrics(job, outcome)
        figures = _write_parts(job, outcome, metrics, log)
        compared = answer()
    raise_if_stopped()
    other = {} if compared is None else {
        "compared": {"name": compared.name, "scenario": compared.scenario, "metrics": metric_tree(compared.metrics)}
    }  # fmt: skip
    summary = {"objects": [asdict(one) for one in job.objects], "place": job.map_place, **other}
    write_json(job.folder / "findings.json", summary)
    state = "interrupted" if outcome.interrupted else "complete"
    done = {"state": state, "timing": job.timing, "interrupted": outcome.interrupted}
    write_report(job.folder, origin={**job.place.origin, **done})
    job.place.mark(**done)
    return Report(job.folder, outcome, metrics, figures, tuple(job.objects), compared, tuple(job.findings))


def _write_parts(job: Run, outcome: Outcome, metrics: dict[str, Metric], log: Log | None) -> tuple[Path, ...]:
    """Write verdict and metrics, draw the figures, and keep what the report replays; return the figures."""
    if job.findings:
        write_text(job.folder / "verdict.txt", "\n".join(job.findings) + "\n")
    write_json(job.folder / "metrics.json", metric_tree(metrics))
    if log is None:
        return ()
    log("drawing figures and replay" + (", and flying once more for the comparison" if job.rival else ""))
    figures = _draw(job, outcome)
    keep_replay(job, outcome)
    return figures


@contextmanager
def _beside(rival: Callable[[], Compared] | None) -> Iterator[Callable[[], Compared | None]]:
    """Run the other method on the same flight in a process of its own; give what waits for its scores.

    Unlike a fork, a new process shares no locks with the threads here.
    """
    if rival is None:
        yield lambda: None
        return
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        yield pool.submit(rival).result


def _keep_what_came(job: Run, error: BaseException) -> None:
    """Mark an interrupted run as unfinished, with the reason; remove its folder if it has no frames."""
    if not job.sampled.received:  # nothing is lost
        job.place.discard()
        return
    stopped = isinstance(error, KeyboardInterrupt)
    reason = str(error) if isinstance(error, UllageError) else "ended" if stopped else type(error).__name__
    with suppress(UllageError):  # a full disk: the folder keeps its mark of a run in progress, without a lock
        frames = {"frames": Metric("frames", job.sampled.received)}
        if not (job.folder / "metrics.json").exists():
            write_json(job.folder / "metrics.json", metric_tree(frames))
        job.place.mark(state="unfinished", refused=reason)
    job.place.release()


def _stages(job: Run) -> list[Stage]:
    plan = job.scenario
    own = job.own_echo if plan.remove_own_echo else None
    out: list[Stage] = [job.health, job.range_time, job.sampled, job.quietest]
    if "detect" in job.tasks:
        job.detect = DetectStage(plan.detect.method, plan.detect.threshold, own_echo=own)
        out.append(job.detect)
    if "obstacles" in job.tasks:
        stage = ObstacleStage(stale_s=plan.flight.guard.stale_s)
        out.append(stage if plan.remove_own_echo else replace(stage, own_echo=None))
        job.obstacles = ObstacleTable(job.folder)
    margin, height = plan.map.margin_m, _height(job)

    def plane() -> ImagePlane:
        return image_plane(plan.image, _bounds(job), flight_m=height, marks=job.marks, margin_m=margin)

    if "image" in job.tasks:
        job.plane = plane()
    if "map" in job.tasks:
        grid = Grid.covering(_bounds(job), plan.map.step_m, dims=plan.map.dims, margin_m=margin)
        if job.exploration is not None:  # it may land below the plane of its map
            grid = grid.at_height(height)
        scatterers = plane().grid  # at the heights that an image would show
        plane_m = float(scatterers.origin_m[2]) if scatterers.dims == 2 else None
        every_s = plan.map.every_s or (LIVE_S if job.live else WATCHED_S)
        job.map = MapStage(grid, plan.map.method, plan.detect.threshold, live=job.live, own_echo=own, every_s=every_s,
                           floor_z_m=plan.map.floor_z_m, target_z_m=plane_m,
                           vehicle_radius_m=plan.map.vehicle_radius_m,
                           scatterer_pfa=plan.map.scatterer_pfa, health=job.health)  # fmt: skip
        out.append(job.map)
    if job.plane is not None:
        image_s = plan.image.every_s or (LIVE_S if job.live else WATCHED_S if job.watched else None)
        out.append(ImageStage(job.plane.grid, plan.image.method, plan.image.sensor, own_echo=own, every_s=image_s))
    return out


def _height(job: Run) -> float:
    """Return the median height of the flight, for plans and planes [m]."""
    return 0.0 if job.flown is None else float(np.median(job.flown.position[:, 2]))


def _bounds(job: Run) -> np.ndarray:
    """Return the box of world and flight, or of the part of an unknown world in range of the flight."""
    if job.scene is not None and job.flown is not None:
        boxes = [job.scene.bounds, np.stack([job.flown.position.min(0), job.flown.position.max(0)])]
        return _in_range(job.source, job.flown, np.stack([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]]))
    if job.scene is not None:
        return job.scene.bounds
    if job.flown is None:
        raise InputError("no poses, so nothing can be imaged or mapped", where="--do", allowed="detect")
    reach = job.scenario.map.reach_m
    return np.stack([job.flown.position.min(0) - reach, job.flown.position.max(0) + reach])


def _in_range(source: Source, flown: Trajectory, box: Floats) -> Floats:
    """Return the part of a box in range of a simulated flight's radars: a large world needs no map of the rest."""
    if not isinstance(source, Simulated):
        return box
    reach = max(float(spec.range_m[-1]) for spec in source.rig.sensors.values())
    low, high = flown.position.min(0) - reach, flown.position.max(0) + reach
    return np.stack([np.maximum(box[0], low), np.minimum(box[1], high)])


def _metrics(job: Run, outcome: Outcome) -> dict[str, Metric]:
    """Return the scores of a run by name; add the sentences that belong to them to the run's findings."""
    frames, maps = job.sampled.frames(), [item for item in outcome.results if isinstance(item, OccupancyMap)]
    out = [
        Metric("frames", outcome.frames),
        Metric("duration", outcome.duration_s, "s"),
        Metric("detections", job.detect.found),
        Metric("real_time_factor", outcome.duration_s / max(job.timing["loop_wall_s"], 1e-9)),
    ]
    if len(frames) == 1:
        out += [one for item in outcome.results if isinstance(item, Image) for one in _place(item)]
    if job.plane is not None and job.plane.grid.dims == 2:
        out.append(Metric("image_z", float(job.plane.grid.origin_m[2]), "m"))
    if own := [one for one in job.own_echo.found.values() if one.energy_share]:
        out.append(Metric("own_echo_share", 100 * max(one.energy_share for one in own), "%"))
        out.append(Metric("own_echo_extent", max(one.extent_m for one in own), "m"))
    if job.odometry is not None:
        lines, scores = job.odometry.report()
        job.findings += lines
        out += scores
    if (part := next((part for part in frames.values() if part.calibration is not None), None)) is not None:
        places = job.map.scatterers if job.map is not None else []
        lines, scores = verdict(part, maps[-1] if maps else None, places, job.marks, settled=job.settled)
        job.findings += lines
        out += scores
    if outcome.live is not None:
        job.findings += outcome.live.lines()
        out.append(Metric("left_out", outcome.live.left_out))
        out.append(Metric("most_behind", outcome.live.most_behind_s, "s"))
        if outcome.live.obstacles:
            out.append(Metric("obstacle_p99", 1e3 * outcome.live.obstacle_p99_s, "ms"))
    job.findings += _why_empty(job, maps)
    if faults := job.health.lines():
        job.findings += [f"{fault}. Its frames of that time are not in the map." for fault in faults]
        out.append(Metric("faults", sum(one.times for one in job.health.faults())))
    if job.obstacles is not None:
        job.findings += job.obstacles.lines()
        out += job.obstacles.metrics()
    if job.exploration is not None and job.scene is not None:
        from ullage.experiments.exploration_report import judge

        history = [*_over_flight(job, maps[-1].grid), (job.exploration.flown.duration_s, maps[-1])] if maps else []
        judged = judge(job.exploration, history, job.scene, frames)
        job.findings += judged.lines
        out += judged.metrics
    if job.scene is not None and maps:
        out += _against_truth(job, job.scene, maps[-1], frames)
    return {one.name: one for one in out}


def _against_truth(job: Run, scene: Scene, omap: OccupancyMap, frames: dict[str, Frames]) -> list[Metric]:
    """Compare the last map with the world; note what it shows of each object."""
    try:
        scores = map_quality(omap, scene, frames) | worst_moment(_over_flight(job, omap.grid), scene, frames)
        job.objects, job.unmapped = inspect(omap, scene, frames)
        job.map_place = place_of(omap, scene, frames)
    except NoSurfaceError as error:  # a flight above all walls is a flight all the same
        job.findings.append(f"The map has no scores: {error}.")
        return []
    return list(scores.values())


def _why_empty(job: Run, maps: Sequence[OccupancyMap]) -> list[str]:
    """Return why the last map has no occupied cell, by the frames that are kept; nothing where it has some."""
    if not maps or maps[-1].occupied.any():
        return []
    received = job.sampled.frames()
    cleaned = without_own_echo(received) if job.scenario.remove_own_echo else received
    return [f"No cell of the map is occupied: {why_empty(received, cleaned, maps[-1].grid)}."]


def _over_flight(job: Run, grid: Grid) -> list[tuple[float, OccupancyMap]]:
    """Return the kept maps on a grid with the time since the first frame [s]."""
    start = min(int(part.t_ns[0]) for part in job.sampled.frames().values()) * 1e-9
    return [(at - start, omap) for at, omap in job.history.maps() if omap.grid.shape == grid.shape]


def _place(image: Image) -> list[Metric]:
    """Return the place of the brightest target in one radar's image: the apex of a summation, else the peak."""
    name, point = ("apex", apex(image)) if image.method == "summation" else ("peak", image.peak_m)
    return [Metric(f"{name}_{axis}", float(value), "m") for axis, value in zip("xy", point, strict=False)]


def _draw(job: Run, outcome: Outcome) -> tuple[Path, ...]:
    folder, out = job.folder / "figures", []
    frames, walls = job.sampled.frames(), _walls(job.scene, _height(job))
    if pictures := job.range_time.pictures():
        title, unit = f"{job.title}: echoes over time", job.range_time.unit
        out.append(figures.range_time_figure(folder / "range_time.png", pictures, unit=unit, title=title))
    if frames:
        index = min(map(len, frames.values())) // 2
        out.append(_snapshot(folder / "snapshot.png", list(frames.values()), index, job))
        if job.scene is not None and not job.live and job.scenario.sensing.fidelity == "physical":
            out.append(_explained(folder / "explain.png", *next(iter(frames.items())), index, job))
    if job.scene is None and (still := job.quietest.frames()):
        out.append(report_figures.rest_figure(folder / "rest.png", still, title=job.title))
    if found := {name: one.calibration for name, one in frames.items() if one.calibration is not None}:
        out.append(report_figures.calibration_figure(folder / "calibration.png", found, title=job.title))
    for item in outcome.results:
        if isinstance(item, OccupancyMap):
            out.append(_draw_map(job, item))
            if job.exploration is not None:
                out.append(_draw_exploration(job, job.exploration, item))
        elif isinstance(item, Image):
            about: Any = {"walls": walls, "flown": job.flown, "marks": job.marks}
            notes = _image_notes(job, item, frames)
            out.append(figures.image_figure(folder / "image.png", item, title=job.title, notes=notes, **about))
    if any(one.energy_share for one in job.own_echo.found.values()):
        title = f"{job.title}: own echo"
        out.append(report_figures.own_echo_figure(folder / "own_echo.png", job.own_echo.found, title=title))
    return tuple(out)


def _draw_map(job: Run, omap: OccupancyMap) -> Path:
    walls = _walls(job.scene, _height(job))
    return figures.map_figure(job.folder / "figures" / "map.png", omap, title=job.title, walls=walls, flown=job.flown,
                      marks=job.marks)  # fmt: skip


def _draw_exploration(job: Run, flight: Exploration, omap: OccupancyMap) -> Path:
    pilot = flight.pilot
    goals = [(one.t_s, one.leg.kind, one.leg.goal) for one in pilot.decisions]
    upcoming = None if pilot.upcoming is None else pilot.upcoming.goal
    return report_figures.exploration_figure(
        job.folder / "figures" / "explore.png", omap, flight.flown, goals, title=job.title,
        walls=_walls(job.scene, _height(job)), upcoming=upcoming,
    )  # fmt: skip


def _image_notes(job: Run, image: Image, frames: Mapping[str, Frames]) -> list[str]:
    """Return the notes under an image: its plane, and what the track shows about heights."""
    seen = {name: part for name, part in frames.items() if job.scenario.image.sensor in ("", name)}
    plane = "" if job.plane is None else job.plane.text
    return [note for note in (plane, plane_findings(image, seen, marks=job.marks)) if note]


def _snapshot(path: Path, frames: list[Frames], index: int, job: Run) -> Path:
    plan = job.scenario.detect
    threshold = plan.threshold or (rays.threshold if (rays := frames[0].ray_model) else None)
    t_s = float(frames[0].t_ns[index]) * 1e-9
    return figures.snapshot_figure(
        path, frames, index, threshold=threshold, title=f"{job.title}: one profile at {t_s:.1f} s"
    )


def _explained(path: Path, name: str, frames: Frames, index: int, job: Run) -> Path:
    """Return the origins of the echoes of one frame."""
    found = explain(frames, index, scene=job.scene, max_bounces=job.scenario.sensing.max_bounces,
                    seed=job.scenario.seed)  # fmt: skip
    height = float(frames.poses.position[index, 2]) if frames.poses is not None else _height(job)
    title = f"{job.title}: frame {job.sampled.number(name, index)} of {name}, explained"
    return report_figures.explain_figure(path, frames, index, found, walls=_walls(job.scene, height), title=title)


def _walls(scene: Scene | None, height_m: float) -> Any:
    return None if scene is None else section(scene, height_m)


def fly_again(rival: Scenario, law: str) -> Compared:
    """Run a scenario for its scores alone; nothing is kept on the disk."""
    with tempfile.TemporaryDirectory(prefix="ullage-") as folder:
        report = execute(of_scenario(RunFolder(Path(folder)), prepare(rival)), log=lambda _: None, draw=False)
    return Compared(LAWS[law], rival.name, report.metrics)


EXPLAINED = 12
"""Instants of a run at which every radar's frame is explained, evenly over the flight."""
ECHOES = 8
"""Echoes of each explained frame."""


def keep_replay(job: Run, outcome: Outcome) -> None:
    """Write what the report replays into the run's folder, where the radars' poses are known.

    Raises:
        InputError: the disk is full.
    """
    frames = {name: part for name, part in job.sampled.frames().items() if part.poses is not None}
    if not frames:
        return
    images = [item for item in outcome.results if isinstance(item, Image)]
    states = {one.name: one.state for one in job.objects}
    explained = [] if outcome.interrupted else explained_frames(job)  # a user who ends a run does not want to wait
    parts = Parts(job.title, frames, job.scene, job.history.maps(), images[-1] if images else None, explained,
                  states, job.unmapped)  # fmt: skip
    write_replay(job.folder, parts)


def explained_frames(job: Run) -> list[Explained]:
    """Explain the frames of all radars at some instants of a simulated flight with physical echoes."""
    sensing = job.scenario.sensing
    if job.scene is None or job.live or sensing.fidelity != "physical":
        return []
    frames = job.sampled.frames()

    def one(name: str, index: int) -> Explained:
        found = explain(frames[name], index, scene=job.scene, max_bounces=sensing.max_bounces, count=ECHOES,
                        seed=job.scenario.seed)  # fmt: skip
        return Explained(name, int(frames[name].t_ns[index]), found)

    wanted = [(name, int(index)) for name, part in frames.items()
              for index in np.unique(np.linspace(0, len(part) - 1, EXPLAINED).round())]  # fmt: skip
    pool = WorkerPool(one)
    try:
        pool.fork()
        return [done.result() for done in [pool.submit(*each) for each in wanted]]
    finally:
        pool.close()
