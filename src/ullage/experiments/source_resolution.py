"""Resolve what `ullage run SOURCE` and `ullage fly` are given: a scenario, a world, a recording, or a live port."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np

from ullage.arrays import Floats
from ullage.config import FlightSpec, Scenario, Task, is_set_by, make_scenario, run_name, split_source
from ullage.data import Frames, Imu, Trajectory, gathered, sensors_of, strung
from ullage.errors import InputError, NotRecorded, UllageError
from ullage.experiments.catalog import families, find_scenario, scenario_names, suggestion
from ullage.experiments.folder import RunFolder
from ullage.experiments.radar_poses import STILL_S, RadarPoses, covered
from ullage.experiments.run import Run, of_scenario
from ullage.experiments.simulated import Simulated, load_world, prepare, radars_and_world, waypoints_of
from ullage.pipeline import LOGGER, InMemorySource, Sink, check_sink
from ullage.pipeline import sink as open_sink
from ullage.ports import schema as ros
from ullage.ports.arrays import refuse_pickle
from ullage.ports.by_hand import HELP, IMU_TOPIC, Controls, FlyOptions, HandFlownSource, Keyboard
from ullage.ports.conversions import BODY
from ullage.ports.encode import imu_message
from ullage.ports.instruments.group import LiveTarget
from ullage.ports.intake import warn
from ullage.ports.live import LISTED, Address
from ullage.ports.protocol import Passed
from ullage.ports.registry import SOURCES, reads
from ullage.ports.registry import open as open_source
from ullage.ports.tracked import RailSource, read_imu
from ullage.world.library import WORLDS
from ullage.world.load import KINDS
from ullage.world.scene import Scene

if TYPE_CHECKING:
    from ullage.experiments.exploration import Exploration

NOWHERE = RunFolder(Path(os.devnull))
"""Place of a run until its folder is begun; nothing can be written there."""
VEHICLE_M = 0.3  # assumed radius of a real radar's carrier, without a setting [m]


def make_run(
    target: str | LiveTarget,
    *,
    tasks: tuple[Task, ...] | None = None,
    options: Sequence[str] = (),
    out: Path | None = None,
    force: bool = False,
    progress: Callable[[float], None] | None = None,
    log: Callable[[str], None] = LOGGER.info,
    to: Sequence[str] = (),
) -> Run:
    """Get a run ready: read the scenario and fly it, or open the recording.

    Then open the sinks and make a draft folder. All checks come before that.

    Args:
        target: scenario name, scenario.yaml, world by name or file, recording, or live port; or several instruments.
        tasks: what to do with the frames; None: those of the scenario, or all that the recording allows.
        options: `a.b=value` over the scenario.
        out: where run folders are made; None: ./runs.
        force: run again where the folder exists.
        progress: called with the share of the preparation done.
        log: called with lines for the user.
        to: sinks beside the run's own files; see `ullage.sink`.

    Raises:
        InputError: the target, an option or a sink cannot be used, or the run exists.
    """
    if isinstance(target, str):
        check_target(target)
    for sink in to:
        check_sink(sink)
    if isinstance(target, LiveTarget):
        return _begin(_of_live(target, tasks, options, log), to, out)
    path = Path(target)
    address = Address.of(target)
    there = os.path.exists(path)  # false also of a name that no file can have
    if address and address.known and not there:
        return _begin(_of_live(LiveTarget((address,)), tasks, options, log), to, out)
    if (scenario := simulated_scenario(target, tasks=tasks, options=options)) is not None:
        scenario, scene = _with_flight(scenario, target, options, log) if is_world(target) else (scenario, None)
        RunFolder.of(scenario.name, scenario.digest, root=out).check_free(force=force)
        return _begin(of_scenario(NOWHERE, prepare(scenario, scene=scene, progress=progress)), to, out, force=force)
    if there:
        target = str(path.resolve())  # `latest` will point elsewhere before it is read
    return _begin(_of_recording(target, tasks, options, log), to, out, force=force)


def check_target(target: str) -> None:
    """Refuse what names no scenario, world, recording or port, before any work.

    Raises:
        InputError: it names none of them.
    """
    path, there = Path(target), os.path.exists(target)
    live = Address.of(target) is not None and not there
    if target in scenario_names() or is_world(target) or path.suffix in {".yaml", ".yml"} or live:
        return
    file = path if there else Path(target.partition("?")[0])  # options of a file may follow its name
    if os.path.exists(file) and reads(file):
        return
    allowed = (
        f"a scenario ({', '.join(families())}), a scenario.yaml, a world ({', '.join(KINDS)}), "
        f"a recording ({SOURCES}), or a live port ({LISTED})"
    )
    if there:
        refuse_pickle(path)
        raise InputError("no kind of file that is known", where=target, allowed=allowed)
    if path.suffix or path.name != target:
        raise InputError("no such file", where=target, allowed=allowed)
    raise InputError(
        f"no scenario, recording or port {target!r}{suggestion(target, scenario_names())}", allowed=allowed
    )


def is_world(target: str) -> bool:
    """Return whether a target is a world: a file by its suffix, or a shipped one without a scenario of its name."""
    shipped = target in WORLDS and target not in scenario_names()
    return shipped or Path(split_source(target)[0]).suffix.lower() in KINDS


def simulated_scenario(
    target: str, *, tasks: tuple[Task, ...] | None = None, options: Sequence[str] = ()
) -> Scenario | None:
    """Return the scenario to simulate: a shipped one, a YAML file, or the defaults in a world; None: not simulated.

    Args:
        target: what `ullage run` is given.
        tasks: what to do with the frames; None: what the scenario says.
        options: `a.b=value` over the scenario.

    Raises:
        InputError: an option is wrong, or the YAML file cannot be used.
    """
    path = Path(split_source(target)[0])
    if is_world(target):
        name = run_name(path.parent.name if path.stem == "model" else path.stem)
        world = {"file": target} if path.suffix else {"name": target}
        tree: dict[str, Any] = {"name": name, "title": f"Default flight in {name}", "world": world}
        return make_scenario(tree if tasks is None else {**tree, "do": tasks}, options=options)
    if target in scenario_names() or path.suffix in {".yaml", ".yml"}:
        found = find_scenario(target, options=options)
        return found if tasks is None else found.but(do=tasks)
    return None


def _with_flight(
    scenario: Scenario, target: str, options: Sequence[str], log: Callable[[str], None]
) -> tuple[Scenario, Scene]:
    """Plan and report a world's default flight; return its scenario and the world, with the radars it declares."""
    scene = load_world(scenario.world)
    curved = [f"{name} {share:.0%}" for name, share in scene.curved().items() if share >= 0.005]
    if curved:
        more = f" and {len(curved) - 6} more" if len(curved) > 6 else ""
        log(f"facets taken as curved surfaces: {', '.join(curved[:6])}{more}; -o world.smooth=no takes them as flat")
    if len(scene.rigs) == 1 and not is_set_by(options, "sensing.rig"):
        scenario = scenario.but(sensing=scenario.sensing.but(rig="declared"))
    sensing = scenario.sensing
    if not (sensing.changes or sensing.is_declared):  # a world may be large
        longer = next(iter(sensing.radars().sensors.values())).staggered().stagger_div
        scenario = scenario.but(sensing=sensing.but(changes={"stagger_div": longer}))
    if scenario.flight.waypoints:
        return scenario, scene
    points = waypoints_of(scenario.flight, scenario.world, radars_and_world(scenario, scene)[1])
    length = float(np.linalg.norm(np.diff(np.array(points)[:, :3], axis=0), axis=1).sum())
    log(f"default flight in {Path(target).name}: {length:.0f} m in {len(points) - 1} legs from {list(points[0])}")
    log("to change it: -o 'flight.waypoints=[[x, y, z, yaw], ...]'; the run's scenario.yaml holds all settings")
    return scenario.but(flight=scenario.flight.but(waypoints=points)), scene


def _begin(run: Run, to: Sequence[str], out: Path | None, *, force: bool = False) -> Run:
    """Open the sinks of a run and make its draft folder; if one fails, close the others."""
    place = RunFolder.of(run.scenario.name, run.scenario.digest, root=out)
    with ExitStack() as opened:
        if hasattr(run.source, "close"):
            opened.callback(run.source.close)
        place.check_free(force=force)
        live = [target for target in to if ":" in target]  # ports first: they leave nothing on the disk
        run.watched = bool(live)
        if run.watched and isinstance(run.source, Simulated):
            run.source = run.source.watched()
        run.sinks += [_opened(target, opened) for target in live]
        run.place = place.begin(force=force)
        opened.callback(place.discard)
        run.sinks += [_opened(target, opened) for target in to if target not in live]
        opened.pop_all()
    return run


def check_options(options: Sequence[str]) -> None:
    """Refuse a wrong option before a recording is read or a port listened to.

    Raises:
        InputError: an option is no setting, or its value is not allowed.
    """
    make_scenario({"name": "any", "do": ["detect"]}, options=options)


def tasks_of(text: str | None) -> tuple[Task, ...] | None:
    """Parse tasks such as `detect,map`; None if there is no text.

    Raises:
        InputError: there is no such task.
    """
    if text is None:
        return None
    words = tuple(word.strip() for word in text.split(",") if word.strip())
    if unknown := set(words) - set(get_args(Task)):
        raise InputError(f"no task {min(unknown)!r}", where="--do", allowed=", ".join(get_args(Task)))
    return cast("tuple[Task, ...]", words)


def record(run: Run) -> Sink:
    """Open the recording in a run's folder, give sinks world and inertial readings; on failure remove the run's folder.

    Raises:
        InputError: the disk is full or the folder cannot be written.
    """
    with ExitStack() as opened:
        opened.callback(run.place.discard)
        for sink in run.sinks:
            opened.callback(sink.close)
        recording = _opened(str(run.folder / "frames.mcap"), opened)
        for sink in (recording, *run.sinks):
            if run.scene is not None:
                sink.write(run.scene)
        for item in _readings(run):
            for sink in (recording, *(() if run.watched else run.sinks)):  # live ports take no readings of the past
                sink.write(item)
        opened.pop_all()
    return recording


def _readings(run: Run) -> Iterator[Passed]:
    """The readings of a recorded inertial unit from the rest before the frames on, as messages."""
    if run.imu is None or run.flown is None:
        return
    first_ns, last_ns = run.flown.t_ns[[0, -1]]
    begin, end = np.searchsorted(run.imu.t_ns, [max(first_ns - round(STILL_S * 1e9), 0), last_ns])
    imu = run.imu[int(begin) : int(end) + 1]
    for t_ns, turn, force in zip(imu.t_ns.tolist(), imu.angular_velocity, imu.specific_force, strict=True):
        yield Passed(t_ns, IMU_TOPIC, ros.IMU, imu_message(t_ns, None, turn, force, frame_id=BODY))


def _opened(target: str, opened: ExitStack) -> Sink:
    sink = open_sink(target)
    opened.callback(sink.close)
    return sink


def _of_recording(
    target: str,
    tasks: tuple[Task, ...] | None,
    options: Sequence[str],
    log: Callable[[str], None],
) -> Run:
    check_options(options)
    source: Any = open_source(target)
    first = _first_placed(source)
    if not first:
        raise InputError("no frames", where=target)
    rail = source if isinstance(source, RailSource) else None
    survey = None if rail is None else rail.survey
    known = {} if rail is None else {"floor_z_m": rail.floor_z_m, "vehicle_radius_m": VEHICLE_M}
    tree: dict[str, Any] = {} if rail is None else {"map": known}
    settings = make_scenario(tree | {"name": "any", "do": ["detect"]}, options=options)
    imu = _recorded_imu(source, settings.flight)
    if imu is not None:
        tree["flight"] = {"imu_file": imu[1]}
    if any(part.track is not None for part in first.values()):
        log("finding clock and range offsets")
        places = None if survey is None else survey.places
        parts = [_calibrated(part, log, settings.map.floor_z_m, places) for part in sensors_of(source.frames())]
        source = InMemorySource({part.sensor: part for part in parts})
        first = next(source.stream())
    placed = all(part.poses is not None for part in first.values())
    odometry = None
    if settings.flight.poses == "radar":
        if imu is not None:
            source = InMemorySource(covered(gathered(source.stream()), *imu))
        odometry = _odometry(source, settings, target, imu)
        source = InMemorySource(gathered(odometry.placed(source.stream())))
        first = next(source.stream())
    if tasks is None:
        phase = all(part.ray_model is None for part in first.values())
        tasks = ("detect", "image", "map") if placed and phase else ("detect", "map") if placed else ("detect",)
    tree |= {"name": run_name(Path(target.rstrip("/").replace(":", "_")).stem), "do": tasks}
    tree["title"] = f"Recording {Path(target).name}"
    scenario = make_scenario(tree, options=options)
    flown = _track(source) if placed else None
    marks = None if rail is None else rail.reflectors()
    return Run(NOWHERE, scenario, source, flown=flown, marks=marks, settled=survey is not None, tasks=scenario.do,
               odometry=odometry, imu=None if imu is None else imu[0])  # fmt: skip


def _first_placed(source: Any) -> dict[str, Frames]:
    """Return the first piece in which all frames have poses; else the first of all."""
    first: dict[str, Frames] = {}
    for piece in source.stream():
        if piece and all(part.poses is not None or part.track is not None for part in piece.values()):
            return dict(piece)
        first = first or piece
    return first


def _recorded_imu(source: Any, flight: FlightSpec) -> tuple[Imu, str] | None:
    """Return the readings of the inertial unit and their file: the one that is set, else the recording's own, if any.

    Raises:
        InputError: the file that is set holds none, or one that does cannot be used.
    """
    if flight.imu_file:
        named = flight.imu_file != "simulated"
        return (read_imu(flight.imu_file, topic=flight.imu_topic), flight.imu_file) if named else None
    for path in getattr(source, "imu_files", ()):
        try:
            return read_imu(path, topic=flight.imu_topic), str(path)
        except NotRecorded:
            continue
        except UllageError as error:
            if flight.poses == "radar":
                raise
            warn(f"{error}; the run leaves the inertial unit out")
    return None


def _odometry(source: Any, scenario: Scenario, target: str, imu: tuple[Imu, str] | None) -> RadarPoses:
    """Get odometry ready, with altimeter, and inertial unit unless it was recorded, from the track of a recording.

    Raises:
        InputError: there is no track, or the frames have no phase.
    """
    part = next(iter(next(source.stream()).values()))
    if part.ray_model is not None or not (np.iscomplexobj(part.samples) or part.spec.output == "rf"):
        raise InputError("frames without phase give no poses", where=target, allowed="flight.poses navigation")
    track = part.track if part.track is not None else _track(source) if part.poses is not None else None
    if track is None or len(track) < 2:
        raise InputError("a recording without a track, of which to take start and heights", where=target,
                         allowed="a track beside it, or flight.poses navigation")  # fmt: skip
    body = track.mounted(np.linalg.inv(part.spec.mount.body_from_sensor()))
    return RadarPoses(body, seed=scenario.seed, source="recorded track", captured=True, unit=scenario.flight.imu,
                      imu=imu)  # fmt: skip


class Begun:
    """A live source, closed at its end; where its first piece is waited for, that is given first, then the rest."""

    def __init__(self, source: Any, *, wait: bool) -> None:
        self._source, self._rest = source, source.stream()
        self.first: dict[str, Frames] = next(self._rest, {}) if wait else {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def stream(self) -> Iterator[dict[str, Frames]]:
        """Every piece, once."""
        try:
            if self.first:
                yield self.first
            yield from self._rest
        finally:
            self._source.close()


def _of_live(
    target: LiveTarget,
    tasks: tuple[Task, ...] | None,
    options: Sequence[str],
    log: Callable[[str], None],
) -> Run:
    """Wait for the first frames, which show the radars and the place of the map.

    Where nothing is to be made of frames, none are waited for: a port may have only messages to pass on.
    """
    check_options(options)
    rig = make_scenario({"name": "any"}, options=options).sensing.rig if is_set_by(options, "sensing.rig") else ""
    source: Any = target.open(rig)
    log(
        f"{'passing on what comes from' if tasks == () else 'waiting for the first frames from'} {target} (Ctrl-C ends)"
    )

    def plan(usual: tuple[Task, ...]) -> Scenario:
        tree: dict[str, Any] = {"name": _of_now(target.kind), "do": usual, "title": f"Live from {target}"}
        return make_scenario(tree, options=options)

    return _begun(source, str(target), tasks, plan)


def _of_now(kind: str) -> str:
    """Return the name of a run without one."""
    return f"{kind}-{datetime.now(UTC):%Y%m%d-%H%M%S}"


def _begun(
    source: Any, place: str, tasks: tuple[Task, ...] | None, plan: Callable[[tuple[Task, ...]], Scenario]
) -> Run:
    """Make the run of a live source after its first frames have come.

    Args:
        source: closed here where it gives nothing.
        place: for messages.
        tasks: what to do with the frames; none: nothing, and no frames are waited for; None: what they allow.
        plan: returns the scenario for the tasks.
    """
    try:
        if plan(()).flight.poses == "radar":
            raise InputError("live frames keep their poses", where=place, allowed="flight.poses navigation")
        wait = tasks != ()
        begun = Begun(source, wait=wait)
        if wait and not begun.first:
            raise InputError("no frames came", where=place)
        flown = next((part.poses for part in begun.first.values() if part.poses is not None), None)
        if flown is None and (path := getattr(source, "trajectory", None)) is not None:
            flown = path()  # the first frames may be from before the first pose
        usual: tuple[Task, ...] = ("detect",) if flown is None else ("detect", "map")
        scenario = plan(usual if tasks is None else tasks)
    except BaseException:
        source.close()
        raise
    scene = getattr(source, "scene", None)
    return Run(NOWHERE, scenario, begun, scene, flown=flown, tasks=scenario.do, live=True)


def flight_scenario(
    target: str, *, tasks: tuple[Task, ...] | None = None, options: Sequence[str] = (), kind: str = "fly"
) -> Scenario:
    """Return the scenario of a flight by hand: one by name or file, or the defaults in a world.

    Args:
        target: world name, world file, scenario name, or scenario.yaml; a scenario goes before a world of its name.
        tasks: what to do with the frames; None: detect and map, or what the scenario says.
        options: `a.b=value` over the scenario.
        kind: "fly" or "explore", for name, title and messages.

    Raises:
        InputError: there is no such world or scenario, or an option is wrong.
    """
    path = Path(split_source(target)[0])
    name = _of_now(f"{kind}-{run_name(path.stem)[:30]}")
    title = f"{'By hand in' if kind == 'fly' else 'Exploring'} {path.stem}"
    if target in scenario_names() or path.suffix in {".yaml", ".yml"}:
        found = find_scenario(target, options=options)
        return found.but(name=name, title=title, do=found.do if tasks is None else tasks, expect={})
    if target not in WORLDS and not path.suffix:
        allowed = f"a scenario ({', '.join(families())}), a world ({', '.join(WORLDS)}), or a file of either"
        near = suggestion(target, [*scenario_names(), *WORLDS])
        raise InputError(f"no scenario or world {target!r}{near}", where=kind, allowed=allowed)
    world = {"name": target} if target in WORLDS else {"file": target}
    tree = {"name": name, "title": title, "world": world, "do": ("detect", "map") if tasks is None else tasks}
    return make_scenario(tree, options=options)


def make_flight(
    scenario: Scenario, *, by: str = "keys", duration_s: float | None = None,
    out: Path | None = None, log: Callable[[str], None] = LOGGER.info, to: Sequence[str] = (),
) -> Run:  # fmt: skip
    """Get a flight by hand ready: the vehicle hovers at the scenario's first waypoint and waits for commands.

    Args:
        scenario: its world, radars, vehicle, and what to make of the frames.
        by: keys, or a port that takes commands, as ros2:.
        duration_s: ends after so long [s]; None: with Ctrl-C.
        out: where run folders are made; None: ./runs.
        log: called with what a person should know.
        to: sinks beside the run's own files.

    Raises:
        InputError: the world, the start, a sink, or the source of commands cannot be used.
    """
    for sink in to:
        check_sink(sink)
    sensing, vehicle = scenario.sensing, scenario.flight.vehicle
    rig, scene = radars_and_world(scenario)
    start = tuple(float(value) for value in waypoints_of(scenario.flight, scenario.world, scene)[0])
    chosen = FlyOptions(
        vehicle="hector" if vehicle == "ideal" else vehicle, fidelity=sensing.fidelity,
        max_bounces=sensing.max_bounces, seed=scenario.seed, rate_hz=sensing.rate_hz, duration_s=duration_s,
    )  # fmt: skip
    controls = _controls(by, scenario, log)
    try:
        source = HandFlownSource(scene, rig, chosen, controls, start=start, log=log)
        job = _begun(source, f"fly {scenario.name}", scenario.do, lambda _: scenario)
        return _begin(job, to, out)
    except BaseException:
        controls.close()
        raise


def make_exploration(
    flight: Exploration, *, out: Path | None = None, to: Sequence[str] = (), log: Callable[[str], None] = LOGGER.info
) -> Run:
    """Get an exploring flight ready: its sinks are open, and its draft folder is made.

    Args:
        flight: that has not begun; see `ullage.experiments.exploration.prepare`.
        out: where run folders are made; None: ./runs.
        to: sinks beside the run's own files.
        log: called with what a person should know.

    Raises:
        InputError: a sink or the folder cannot be used.
    """
    for sink in to:
        check_sink(sink)
    scenario, scene = flight.loop.scenario, flight.loop.scene
    run = Run(NOWHERE, scenario, flight, scene, flown=flight.first, tasks=scenario.do, live=True, exploration=flight)
    run.sinks.append(flight.maps)
    x, y, z = flight.start[:3]
    log(f"exploring from ({x:.1f}, {y:.1f}, {z:.1f}) m for {flight.pilot.time_s:g} s; Ctrl-C ends the flight in order")
    return _begin(run, to, out)


def _controls(by: str, scenario: Scenario, log: Callable[[str], None]) -> Controls:
    """Source of commands."""
    if by == "keys":
        keyboard = Keyboard(speed_m_s=scenario.flight.speed_m_s)
        log(HELP)
        return keyboard
    address = Address.of(by)
    if address is None or address.part("controls") is None:
        raise InputError(f"no commands come from {by!r}", where="--by", allowed="keys, ros2:NAMESPACE?key=value")
    controls: Controls = address.open("controls")
    return controls


def _calibrated(part: Frames, report: Callable[[str], None], floor_z_m: float | None, places: Floats | None) -> Frames:
    """Calibrate clock and zero range of one sensor against the track, by surveyed reflectors where there are any."""
    from ullage.processing.calibrate import calibrate

    out = calibrate(part, reflectors=places, floor_z_m=floor_z_m, progress=_every_tenth(report))
    if (found := out.calibration) is not None:
        report(
            f"{out.sensor}: clock {found.t_offset_s:+.4f} s (sigma {found.t_sigma_s:.4f}), "
            f"range {found.range_offset_m:+.4f} m (sigma {found.range_sigma_m:.4f}), "
            f"probability {found.probability:.3f}, from {found.method}"
        )
    return out


def _every_tenth(log: Callable[[str], None]) -> Callable[[float], None]:
    """Reports a share of the work at every tenth."""
    last = 0

    def report(done: float) -> None:
        nonlocal last
        if int(10 * done) > last:
            last = int(10 * done)
            log(f"finding clock and range offsets: {100 * done:.0f} %")

    return report


def _track(source: Any) -> Trajectory | None:
    """The poses of the first sensor, all of them."""
    first = next(iter(source.stream()))
    name = next(iter(first))
    paths = [path for chunk in source.stream() if name in chunk and (path := chunk[name].poses) is not None]
    return strung(paths) if paths else None
