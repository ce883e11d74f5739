"""The `ullage` command: verbs and how they show themselves; the work is elsewhere."""

from __future__ import annotations

import json
import logging
import os
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ullage.errors import DamageWarning, InputError, UllageError, one_line

if TYPE_CHECKING:
    from types import ModuleType

    from ullage.config import Scenario, Task
    from ullage.experiments.run import Report, Run
    from ullage.experiments.sweep import Sweep
    from ullage.view.pilot_view import PilotView

app = typer.Typer(
    name="ullage",
    help="Simulate what ultra-wideband radars on a drone receive in tanks, holds and halls; turn echoes into maps.",
    no_args_is_help=True,
    rich_markup_mode=None,  # plain help comes twice as fast
    pretty_exceptions_enable=False,
)

Options = Annotated[
    list[str] | None, typer.Option("-o", "--option", help="Change a setting: -o map.step_m=0.2", metavar="KEY=VALUE")
]
Poses = Annotated[
    str | None, typer.Option("--poses", help="navigation, or radar for odometry; short for -o flight.poses=")
]
MAP_SCORES = ("f1", "precision", "recall", "recall_in_view", "flyable_found", "flyable_false")
ANYWHERE = ("--debug", "--quiet", "--verbose")
"""Options of the command itself that may stand behind a verb too."""
NEWEST = 3
"""Runs that the overview names."""
Do = Annotated[str | None, typer.Option("--do", help="What to make of the frames: detect,image,map,obstacles")]
To = Annotated[list[str] | None, typer.Option("--to", help="Also write there: a file or live port", metavar="SINK")]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for runs", metavar="DIR")]
LawOption = Annotated[
    str | None,
    typer.Option("--law", help="Law of a shipped scenario's echoes: thesis or physical", metavar="LAW"),
]
RunName = Annotated[str, typer.Argument(help="Run folder, its name, or latest.")]
ByHand = Annotated[bool, typer.Option("--by-hand", help="A shipped scenario as flown by hand.")]


def _trust(wanted: bool) -> None:
    if wanted:
        os.environ["ULLAGE_TRUST_XACRO"] = "1"  # for this process and its workers


Trust = Annotated[bool, typer.Option("--trust-xacro", callback=_trust, help="Expand .xacro, which may run code.")]
Xacro = Annotated[
    list[str] | None, typer.Option("--xacro", help="An argument of a .xacro world", metavar="NAME:=VALUE")
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", min=1, help="How many at a time; default: the cores, or 1 without ullage[scale]."),
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", help="A Dask cluster that stands already.", metavar="tcp://HOST:PORT")
]


def with_arguments(source: str, given: list[str]) -> str:
    """Add arguments of xacro to a source: `robot.xacro?name:=value`.

    Raises:
        InputError: the source is no .xacro file.
    """
    from ullage.config import split_source

    file, before = split_source(source)
    if given and not file.lower().endswith(".xacro"):
        allowed = "a .xacro file; in a scenario, world.file: robot.xacro?NAME:=VALUE"
        raise InputError(f"--xacro with {source!r}", where="--xacro", allowed=allowed)
    return f"{file}?{'&'.join([*filter(None, [before[1:]]), *given])}" if given else source


def local_workers(jobs: int | None) -> int | None:
    """Worker processes: as many as asked for, else one for each core (None) with Dask, or this process (1) without."""
    return jobs or (None if find_spec("distributed") else 1)


def where_to_run(jobs: int | None, scheduler: str | None) -> int | str | None:
    """A scheduler's address, or the number of worker processes here."""
    if scheduler and jobs:
        raise InputError("a cluster has its own workers", where="--jobs", allowed="--jobs or --scheduler")
    return scheduler or local_workers(jobs)


def study(name: str) -> ModuleType:
    """Import a module of `studies`, which lies beside the package in the source tree and is not installed with it.

    It is looked for in the checkout of an editable install, then in the current folder.

    Raises:
        InputError: neither is a source tree of ullage.
    """
    from importlib import import_module
    from importlib.metadata import metadata

    import ullage

    for root in (Path(ullage.__file__).parents[2], Path.cwd()):
        if (root / "studies/__init__.py").is_file() and (root / "src/ullage/__init__.py").is_file():
            if str(root) not in sys.path:
                sys.path.append(str(root))
            return import_module(f"studies.{name}")
    urls = dict(line.split(", ") for line in metadata("ullage").get_all("Project-URL", []))
    raise InputError("the studies are not installed with ullage: they are in its source tree", where="studies/",
                     allowed=f"a checkout of {urls.get('Repository')} as the current folder")  # fmt: skip


def main(words: list[str] | None = None) -> None:
    """Run the command; what ullage refuses is one line and exit 2, unless --debug asks for the traceback.

    Args:
        words: the command line behind the command's name; None: that of this process.

    Raises:
        SystemExit: the command is over; its code is 0, or 2 for what was refused.
    """
    from ullage.stop_signals import stop_as_ctrl_c

    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", "1"
    )  # matrices are small: a second thread costs 8 % of a short run's CPU time
    words = sys.argv[1:] if words is None else words
    debug = "--debug" in words
    level = logging.WARNING if "--quiet" in words else logging.DEBUG if "--verbose" in words else logging.INFO
    sys.argv = [word for word in sys.argv if word not in ANYWHERE]
    warned = _quiet_warnings()
    try:
        with stop_as_ctrl_c(), _logged(level):
            app([word for word in words if word not in ANYWHERE], standalone_mode=True)
    except SystemExit as done:
        if isinstance(getattr(done.__context__, "__cause__", None), KeyboardInterrupt):  # typer took it
            typer.echo("ullage: interrupted", err=True)
        if not done.code and any(issubclass(category, DamageWarning) for category in warned.values()):
            sys.exit(2)
        raise
    except KeyboardInterrupt:  # out of foreign code, by another name
        typer.echo("ullage: interrupted", err=True)
        sys.exit(130)
    except UllageError as error:
        if debug:
            raise
        typer.echo(f"ullage: {error}", err=True)
        sys.exit(error.exit_code)
    except BrokenPipeError:  # the reader, say `head`, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, MemoryError) as error:  # a full disk, also under the output; no memory
        if debug:
            raise
        typer.echo(f"ullage: {one_line(str(error)) or 'not enough memory'}", err=True)
        sys.exit(2)


class _Terminal(logging.Handler):
    """Shows log records as lines of the terminal: progress on stdout, warnings on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Show one record."""
        from ullage.view.progress import answer

        text = record.getMessage()
        if record.levelno >= logging.WARNING:
            typer.echo(f"ullage: {text}", err=True)
        elif record.levelno < logging.INFO:
            answer(text, mark=f"{record.relativeCreated / 1000:7.2f} s  ", style="dim")
        else:
            answer(text, mark=getattr(record, "mark", ""), style=getattr(record, "style", ""))


@contextmanager
def _logged(level: int) -> Iterator[None]:
    """Show what the logger `ullage` takes, from this level on."""
    logger, handler = logging.getLogger("ullage"), _Terminal()
    before, passes_on = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(level)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        logger.propagate = passes_on


def _quiet_warnings() -> dict[str, type[Warning]]:
    """Show each warning as one line, once; give those shown so far."""
    shown: dict[str, type[Warning]] = {}

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        kind = "warning" if category.__module__.startswith("ullage") else category.__name__
        if str(message) not in shown:
            typer.echo(f"{kind}: {message}", err=True)
        shown[str(message)] = category

    warnings.showwarning = show
    return shown


def _version(wanted: bool) -> None:
    if wanted:
        from ullage import __version__

        typer.echo(f"ullage {__version__}")
        raise typer.Exit


@app.callback()
def top(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show answers, warnings and errors only.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Show each step, with its time.")] = False,
) -> None:
    """Options of the command itself."""


@app.command()
def run(
    source: Annotated[
        list[str],
        typer.Argument(
            help="Scenario name, scenario.yaml, world file, recording, or live port; or several instruments."
        ),
    ],
    do: Do = None,
    to: To = None,
    option: Options = None,
    poses: Annotated[
        str | None,
        typer.Option(
            "--poses", help="navigation, or radar for odometry; of instruments: a live port, as mavlink:PLACE"
        ),
    ] = None,
    law: LawOption = None,
    by_hand: ByHand = False,
    compare: Annotated[
        str | None,
        typer.Option("--compare", help="Fly a shipped scenario once more by this law and compare", metavar="LAW"),
    ] = None,
    out: Out = None,
    force: Annotated[bool, typer.Option("--force", help="Run again where the run exists.")] = False,
    open_report: Annotated[bool, typer.Option("--open", help="Open the report in a browser.")] = False,
    trust_xacro: Trust = False,
    xacro: Xacro = None,
) -> None:
    """Simulate, record, replay or convert.

    Take frames from SOURCE and make maps, images and detections of them.
    """
    first = with_arguments(source[0], xacro or [])
    repair(first)
    from ullage.experiments.catalog import rival_scenario, variant_name
    from ullage.experiments.runner import fly_again
    from ullage.experiments.source_resolution import check_target, make_run, tasks_of
    from ullage.pipeline import check_sink
    from ullage.ports.instruments.group import LiveTarget
    from ullage.view.progress import log, progress_bar

    port = poses if poses is not None and ":" in poses else ""
    together = LiveTarget.of(source, port)
    tasks, options, sinks = tasks_of(do), [*_posed(None if port else poses), *(option or [])], to or []
    first = variant_name(first, law=law, by_hand=by_hand)
    check_target(first)
    for target in sinks:
        check_sink(target)
    rival = rival_scenario(first, compare, options=options) if compare is not None else None
    warm_up(first, options, tasks, rival=rival)
    with progress_bar("getting ready", total=1.0) as bar:
        job = make_run(
            together or first, tasks=tasks, options=options, out=out, force=force, progress=bar, log=log, to=sinks
        )
    if rival is not None and compare is not None:
        job.rival = partial(fly_again, rival, compare)
    total = job.flown.duration_s if job.flown is not None and not job.live else None
    _carry_out(job, "receiving and mapping", total, open_report=open_report)


@app.command()
def fly(
    target: Annotated[str, typer.Argument(help="World name or file, scenario name or scenario.yaml.")],
    by: Annotated[str, typer.Option("--by", help="keys, or ros2:NAMESPACE for cmd_vel, set-points and joy.")] = "keys",
    do: Do = None,
    to: To = None,
    option: Options = None,
    law: LawOption = None,
    duration_s: Annotated[float | None, typer.Option("--duration-s", min=0.1, help="End after so long.")] = None,
    out: Out = None,
    trust_xacro: Trust = False,
    xacro: Xacro = None,
) -> None:
    """Fly by hand while the map grows.

    The radars of a simulated multirotor measure on the way. Ctrl-C ends the flight.
    """
    target = with_arguments(target, xacro or [])
    from ullage.experiments.catalog import variant_name
    from ullage.experiments.source_resolution import flight_scenario, make_flight, tasks_of
    from ullage.experiments.warmup import parts_of
    from ullage.view.pilot_view import PilotView
    from ullage.view.progress import console, log

    scenario = flight_scenario(variant_name(target, law=law), tasks=tasks_of(do), options=option or [])
    compile_parts({*parts_of(scenario), "hector"})
    job = make_flight(scenario, by=by, duration_s=duration_s, out=out, log=log, to=to or [])
    seen = PilotView(columns=min(console.width, 80), rows=max(min(console.height - 8, 20), 1))
    _carry_out(job, "flying", duration_s, above=seen)


@app.command()
def explore(
    world: Annotated[str, typer.Argument(help="World name or file, scenario name or scenario.yaml.")],
    time_s: Annotated[float, typer.Option("--time", min=1.0, help="Flight time with the way home.", metavar="S")] = 120,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of noise and gusts.")] = None,
    height_m: Annotated[
        float | None, typer.Option("--height", help="Of the flight; default: the first waypoint's.", metavar="M")
    ] = None,
    to: To = None,
    option: Options = None,
    poses: Poses = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            "--vehicle",
            help="Aircraft that hovers: mavlink:, imc:, ros2: or gazebo:; default: simulated.",
            metavar="PORT",
        ),
    ] = None,
    out: Out = None,
    trust_xacro: Trust = False,
    xacro: Xacro = None,
) -> None:
    """Let a drone map a world by its own decisions.

    It flies where its map could learn most, with the guard on, and comes home in time.
    Ctrl-C ends the flight, and everything up to then is written. An aircraft then hovers.
    """
    world = with_arguments(world, xacro or [])
    from ullage.experiments.exploration import prepare
    from ullage.experiments.explore import exploring
    from ullage.experiments.source_resolution import flight_scenario, make_exploration
    from ullage.experiments.warmup import parts_of
    from ullage.view.progress import log

    options = [*_posed(poses), *(option or []), *([f"seed={seed}"] if seed is not None else [])]
    scenario = exploring(flight_scenario(world, options=options, kind="explore"), options)
    compile_parts(parts_of(scenario))
    flight = prepare(scenario, time_s=time_s, height_m=height_m, vehicle=vehicle, log=log)
    _carry_out(make_exploration(flight, out=out, log=log, to=to or []), "exploring", time_s)


def _posed(poses: str | None) -> list[str]:
    return [] if poses is None else [f"flight.poses={poses}"]


def repair(source: str) -> bool:
    """Finish a recording that a kill left unfinished; whether there was one."""
    from ullage.ports.bag import repair_bag
    from ullage.view.progress import log

    if done := repair_bag(source):
        log(done)
    return bool(done)


def warm_up(
    source: str, options: list[str], tasks: tuple[Task, ...] | None = None, *, rival: Scenario | None = None
) -> None:
    """Compile what a run of SOURCE and of its rival needs, if this is its first time."""
    from ullage.experiments.simulated import load_world
    from ullage.experiments.source_resolution import simulated_scenario
    from ullage.experiments.warmup import compiled, parts_of
    from ullage.ports.live import Address

    if Address.of(source):  # its radars compile theirs when they know the world
        compile_parts(("obstacles", "likelihood", "backprojection"))
    elif scenario := simulated_scenario(source, tasks=tasks, options=options):
        more = () if rival is None else parts_of(rival)
        if not compiled((*parts_of(scenario), *more)):  # not all that any world may need
            compile_parts((*parts_of(scenario, load_world(scenario.world)), *more))


def compile_parts(parts: Iterable[str] | None = None) -> None:
    """Compile the kernels of these parts, or of all, and show what is being compiled."""
    from ullage.experiments.warmup import compile_kernels, compiled
    from ullage.view.progress import console, log

    if not compiled(parts):
        log("compiling kernels (once after installation)")
        with console.status("compiling") as line:
            compile_kernels(parts, log=lambda what: line.update(f"compiling {what}"))


def _carry_out(
    job: Run, title: str, total_s: float | None, *, above: PilotView | None = None, open_report: bool = False
) -> None:
    """Carry out a run with a progress bar, tell what it gave, and serve the page of a viewer until Ctrl-C.

    Args:
        job: what to do.
        title: of the bar.
        total_s: length of the flight, where it is known [s].
        above: what is shown above the bar on a terminal.
        open_report: in a browser, too.
    """
    from ullage.experiments.runner import execute
    from ullage.experiments.source_resolution import record
    from ullage.view.progress import open_page, progress_bar, shows_bars
    from ullage.view.viewer_output import keep_serving

    sinks = [record(job), *([above] if above is not None and shows_bars() else [])]
    lines = None if above is None else above.lines
    with progress_bar(title, total=total_s, unit="s of flight", above=lines) as bar:
        if job.exploration is not None:
            job.exploration.report_progress = bar.retitle
        report = execute(job, sinks=sinks, progress=bar, on_lag=bar.on_lag, log=bar.log)
    _print_summary(report)
    if open_report:
        open_page(report.folder / "report.html")
    if not report.outcome.interrupted:
        keep_serving(job.sinks)


def _print_summary(report: Report) -> None:
    """Print the outcome, the scores and the report page of a run."""
    from ullage.experiments.folder import RunFolder
    from ullage.experiments.verdict import found_line
    from ullage.view.progress import log, log_report

    outcome = report.outcome
    if outcome.interrupted:
        rest = outcome.live.left_out_s if outcome.live is not None else 0.0
        what = f"all but {rest:.1f} s" if rest else "everything"
        log(f": {what} received by then is written", mark="interrupted", style="yellow")
    if (kept := RunFolder(report.folder).final) != report.folder:
        log(f"the complete run in {kept} stays; this one is in {report.folder}")
    factor = report.metrics["real_time_factor"].value
    log(f"{outcome.frames} frames of {outcome.duration_s:.0f} s, {factor:.1f} times real time")
    if scores := [f"{key} {report.metrics[key].value:.3f}" for key in MAP_SCORES if key in report.metrics]:
        log(f"map: {', '.join(scores)}")
    for sentence in report.findings:
        log(sentence)
    log_report(report.folder / "report.html")
    if report.objects:
        log(found_line(report.objects, report.metrics))
    if report.compared is not None:
        log(report.compared.line)


@app.command("list")
def list_(
    what: Annotated[
        str, typer.Argument(help="scenarios, worlds or runs in full; left out: an overview.", metavar="[WHAT]")
    ] = "",
    out: Out = None,
) -> None:
    """List scenarios, worlds, radars and runs."""
    from ullage.experiments.catalog import families, suggestion
    from ullage.experiments.folder import RUNS
    from ullage.specs import RadarSpec, Rig
    from ullage.view.progress import answer
    from ullage.world.library import WORLDS

    match what:
        case "scenarios":
            _list_scenarios()
        case "worlds":
            _list_worlds()
        case "runs":
            _list_runs(out or RUNS)
        case "":
            _list_families()
            rigs = f"Radars: {', '.join(RadarSpec.names())}\nRigs: {', '.join(Rig.presets)}"
            more = ", ".join(name for name in WORLDS if name not in families())
            answer(f"\nWorlds: {more}, and one for each scenario: ullage list worlds\n{rigs}")
            _list_runs(out or RUNS, most=NEWEST)
        case _:
            tables = ("scenarios", "worlds", "runs")
            raise InputError(f"nothing to list: {what!r}{suggestion(what, tables)}", allowed=", ".join(tables))


def _list_families() -> None:
    """Print each family of scenarios on one line."""
    from ullage.experiments.catalog import families, find_scenario
    from ullage.view.progress import answer, console

    answer("Scenarios: ullage run NAME")
    width = 3 + max(map(len, families()))
    for family, variants in families().items():
        mark = "*" if any(one.by_hand for one in variants) else ""
        line = f" {family + mark:<{width}}{find_scenario(family).title}"
        answer(line if len(line) <= console.width else f"{line[: console.width - 3]}...")
    answer(" --law physical: physical echoes. *: --by-hand too. ullage list scenarios: all")


def _list_scenarios() -> None:
    """Print every shipped scenario: its family and options, its own name, and its title."""
    from ullage.experiments.catalog import Variant, find_scenario, scenario_names

    named = ((name, Variant.of(name).words) for name in sorted(scenario_names(), key=Variant.of))
    rows = ((words, name if name != words else "", find_scenario(name).title) for name, words in named)
    _print_table(("scenario", "other name", "what it does"), rows)


def _list_worlds() -> None:
    """Print the shipped worlds."""
    from ullage.world.library import WORLDS

    rows = ((world.name, world.title) for world in WORLDS.values())
    _print_table(("world", "what it is"), rows, title="Worlds: -o world.name=NAME")


def _list_runs(root: Path, *, most: int | None = None) -> None:
    """Print the runs of a folder, or only the newest."""
    from rich.markup import escape

    from ullage.experiments.folder import RunFolder
    from ullage.view.progress import answer

    runs = RunFolder.all_in(root)
    newest = sorted(runs, key=lambda run: (run.path / "provenance.json").stat().st_mtime, reverse=True)
    shown = [run for run in runs if run in newest[:most]]
    if not shown:
        return
    rows = ((escape(str(run.path)), run.describe()) for run in shown)
    _print_table(("run", "state"), rows, title="\nRuns: ullage show RUN")
    if len(shown) < len(runs):
        answer(f"and {len(runs) - len(shown)} more: ullage list runs")


@app.command()
def show(
    run: RunName = "latest",
    png: Annotated[bool, typer.Option("--png", help="Print only the path of its main picture.")] = False,
) -> None:
    """Show what a run gave."""
    from rich.markup import escape
    from rich.table import Table

    from ullage.experiments.folder import RunFolder, read_json
    from ullage.view.progress import answer, console

    found = RunFolder.find(run)
    folder = found.path
    if png:
        from ullage.view.report import main_picture

        typer.echo(main_picture(folder))
        return
    if (state := found.state) != "complete":
        answer(f": {folder}", mark=found.describe(), style="yellow")
    table = Table("metric", "value", "unit", box=None, title=escape(str(folder)), title_justify="left")
    lacking = state in {"running", "unfinished"} and not (folder / "metrics.json").exists()
    for name, metric in () if lacking else read_json(folder / "metrics.json").items():
        value = metric["value"]
        table.add_row(name, "unknown" if value is None else f"{value:.4g}", metric["unit"])
    console.print(table)
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and not p.name.startswith(".")):
        answer(f"  {path.relative_to(folder)}  {path.stat().st_size:,} bytes")


@app.command()
def measure(run: RunName = "latest") -> None:
    """Check a run against its bounds.

    The scenario has them. Exit 1 when one is broken.
    """
    from ullage.experiments.folder import RunFolder, verdicts
    from ullage.view.progress import answer

    found = RunFolder.find(run)
    if not found.finished:
        raise InputError(f"this run is {found.describe()}", where=found.path, allowed="a run that ended")
    rows = verdicts(found.path)
    for row in rows:
        answer(f" {row.text}", mark="ok  " if row.inside else "OUT ", style="" if row.inside else "red")
    if not rows:
        answer("this scenario sets no bounds")
    if not all(row.inside for row in rows):
        raise typer.Exit(1)


@app.command()
def report(
    run: RunName = "latest",
    open_report: Annotated[bool, typer.Option("--open", help="Open it in a browser.")] = False,
    html: Annotated[
        bool, typer.Option("--html/--no-html", help="Write report.html: one file that needs no other, to send.")
    ] = True,
    rrd: Annotated[bool, typer.Option("--rrd", help="Also write report.rrd, for the rerun viewer.")] = False,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Also write foxglove.json, a layout for the recording.")
    ] = False,
) -> None:
    """Write a run's report anew."""
    from ullage.experiments.exports import write_foxglove, write_rrd
    from ullage.experiments.folder import RunFolder
    from ullage.view.progress import open_page
    from ullage.view.report import write_report

    folder = RunFolder.find(run).path
    page = write_report(folder) if html else folder / "report.html"
    if html:
        typer.echo(page)
    if rrd:
        typer.echo(write_rrd(folder))
    if foxglove:
        typer.echo(write_foxglove(folder))
    if open_report:
        open_page(page)


@app.command()
def config(
    scenario: Annotated[str, typer.Argument(help="Scenario name or file.")] = "cargo-hold",
    option: Options = None,
    law: LawOption = None,
    by_hand: ByHand = False,
    schema: Annotated[bool, typer.Option("--schema", help="The JSON schema of scenario files instead.")] = False,
) -> None:
    """Print a scenario as commented YAML.

    Save it, change it, and run it.
    """
    from ullage.config import scenario_schema, scenario_text
    from ullage.experiments.catalog import find_scenario, variant_name

    if schema:
        typer.echo(json.dumps(scenario_schema(), indent=2))
    else:
        name = variant_name(scenario, law=law, by_hand=by_hand)
        typer.echo(scenario_text(find_scenario(name, options=option or [])), nl=False)


@app.command()
def calibrate(
    source: Annotated[str, typer.Argument(help="Recording with a track; with --plan also the file of a track.")] = "",
    plan: Annotated[
        bool, typer.Option("--plan", help="Predict the sigmas of a flight; without SOURCE, of one made for it.")
    ] = False,
    reflectors: Annotated[
        Path | None, typer.Option("--reflectors", help="Surveyed places: x_m, y_m, z_m.", metavar="CSV")
    ] = None,
    radar: Annotated[str, typer.Option("--radar", help="--plan with a file of a track: which radar.")] = "pulson440",
) -> None:
    """Find a recording's clock and range offsets.

    Or plan a flight that determines them. Exit 1 when the recording does not decide. No map is made.
    """
    from ullage.experiments import calibration_flight as flights
    from ullage.view.progress import answer, console

    if plan:
        flight = flights.planned(source, reflectors=reflectors, radar=radar)
        places = ", ".join("({:.1f}, {:.1f}, {:.1f})".format(*place) for place in flight.places)
        answer(f"{flight.what}: {sum(leg.duration_s for leg in flight.legs):.0f} s, radar {flight.spec.name}")
        answer(f"{len(flight.places)} reflectors{'' if reflectors or not source else ', assumed'}, at {places} m")
        if legs := flight.leg_rows():
            _print_table(("leg", "lasts", "why", "one sigma without it"), legs)
        _print_table(("one sigma of", "wanted", "places surveyed", "places unknown"), flight.rows())
        for sentence in flight.verdicts():
            answer(sentence)
        answer("Lower bounds, for echoes of 20 dB at 3 m, levels within 2 dB, and a track within 1 mm.")
        return
    if not source:
        raise InputError("no recording", where="calibrate", allowed="a recording with a track, or --plan")
    with console.status("calibrating"):
        found = flights.found_in(source, reflectors)
    for name, one in found.items():
        _print_table((name, "estimate", "one sigma"), flights.offset_rows(one))
        answer(f"from {one.method}; probability {one.probability:.3f}")
        if one.message:
            answer(one.message)


def _print_table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]], *, title: str | None = None) -> None:
    """Print rows of words, which rich reads as markup."""
    from rich.table import Table

    from ullage.view.progress import console

    table = Table(*header, box=None, title=title, title_justify="left")
    for row in rows:
        table.add_row(*row)
    console.print(table)


@app.command()
def validate(
    out: Annotated[Path, typer.Option("--out", help="Folder for the page and its pictures.", metavar="DIR")] = Path(
        "validation"
    ),
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="Compare with the real recordings here instead.", metavar="DIR")
    ] = None,
) -> None:
    """Check the physical radar against theory.

    Or against recordings. Exit 1 when a bound is broken.
    """
    from ullage.view.progress import answer, console

    validation = study("validation.validate")
    if recordings is not None:
        rows = validation.against_recordings(recordings, out, report=answer)
    else:
        with console.status("computing every oracle (about half a minute)"):
            rows = validation.validate(out)
    for row in rows:
        text = f" {row.oracle}: {row.ours:.3f} {row.unit}, wanted {row.reference:.3f}"
        answer(text, mark="ok  " if row.passed else "OUT ", style="" if row.passed else "red")
    answer(f"{sum(row.passed for row in rows)} of {len(rows)} within bounds; page in {out}")
    if not all(row.passed for row in rows):
        raise typer.Exit(1)


@app.command()
def reproduce(
    quick: Annotated[bool, typer.Option("--quick", help="Small: three to four CPU-minutes.")] = False,
    only: Annotated[list[str] | None, typer.Option("--only", help="Just this experiment", metavar="NAME")] = None,
    force: Annotated[bool, typer.Option("--force", help="Do again what is done.")] = False,
    out: Annotated[Path, typer.Option("--out", help="Folder of the results.", metavar="DIR")] = Path("reproduction"),
    recordings: Annotated[
        Path, typer.Option("--recordings", help="Folder of the real recordings.", metavar="DIR")
    ] = Path("../shared/data"),
    jobs: Jobs = None,
) -> None:
    """Run the experiments of the thesis.

    Each is run both ways. Exit 1 when a bound is broken. Run again to go on after Ctrl-C.
    """
    from ullage.view.progress import answer, log_report, progress_bar

    run_all = study("thesis.reproduce").reproduce
    chosen = study("thesis.plan").wanted(quick, only or [])
    compile_parts()
    if quick and not only:
        answer(f": {', '.join(e.name for e in study('thesis.plan').EXPERIMENTS if not e.quick)}", mark="left out")
    with progress_bar("reproducing", total=float(len(chosen))) as bar:
        done = run_all(
            out, chosen, recordings=recordings, quick=quick, fresh=force, jobs=local_workers(jobs),
            report_progress=bar.at,
        )  # fmt: skip
    for line in done.broken:
        answer(f"  {line}", mark="OUT", style="red")
    holding, total = done.counts
    answer(f"{holding} of {total} statements and bounds hold; {len(done.chapters)} of {len(chosen)} experiments")
    log_report(done.report)
    if done.interrupted:
        answer(": run the same command again to go on", mark="interrupted", style="yellow")
        raise typer.Exit(130)
    if done.broken:
        raise typer.Exit(1)


@app.command()
def sweep(
    scenario: Annotated[str, typer.Argument(help="Scenario name or scenario.yaml.")],
    over: Annotated[
        list[str] | None, typer.Option("--over", help="A setting and its values", metavar="KEY=V1,V2")
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Runs of each combination.")] = 1,
    metric: Annotated[list[str] | None, typer.Option("--metric", help="To show, of those measured.")] = None,
    option: Options = None,
    law: LawOption = None,
    by_hand: ByHand = False,
    out: Annotated[Path, typer.Option("--out", help="Folder of the runs and of sweep.csv.", metavar="DIR")] = Path(
        "sweep"
    ),
    force: Annotated[bool, typer.Option("--force", help="Run again what is there.")] = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    trust_xacro: Trust = False,
) -> None:
    """Run a scenario with many settings.

    Run every combination of some settings and write a table. Run again to go on after Ctrl-C.
    """
    from ullage.experiments import sweep as sweeps
    from ullage.experiments.catalog import variant_name
    from ullage.view.progress import answer, log, progress_bar

    scenario = variant_name(scenario, law=law, by_hand=by_hand)
    axes = dict(sweeps.axis_of(text) for text in over or [])
    where = where_to_run(jobs, scheduler)
    points = sweeps.plan(scenario, axes, seeds=seeds, options=option or [], out=out)
    warm_up(scenario, list(points[0].options))
    with progress_bar(f"{len(points)} runs", total=float(len(points)), unit="runs", rated=True) as bar:
        done = sweeps.sweep(points, out=out, where=where, report_progress=bar.at, again=force)
    for name, why in done.failed.items():
        answer(f"  {name}: {why}", mark="FAIL", style="red")
    if done.done:
        usual = ["f1", "precision", "recall", "detections"]
        _tabulate(done, metric or [name for name in usual if name in done.done[0].metrics])
    log(f"{len(done.done)} of {len(points)} runs; table: {done.table}")
    if done.interrupted:
        log(": run the same command again to go on", mark="interrupted", style="yellow")
        raise typer.Exit(130)
    if done.failed:
        raise typer.Exit(2)


@app.command()
def dataset(
    kinds: Annotated[list[str], typer.Argument(help="Kinds of random worlds, tuning, testing, all, or world files.")],
    n: Annotated[int, typer.Option("--n", help="Samples in all.")],
    to: Annotated[Path, typer.Option("--to", help="The data set.", metavar="DIR.zarr")],
    seed: Annotated[int, typer.Option("--seed", help="Of worlds, flights and noise.")] = 0,
    frames: Annotated[int, typer.Option("--frames", help="Of each radar in a sample.")] = 64,
    bounces: Annotated[str, typer.Option("--bounces", help="Reflections; one of these is drawn for a sample.")] = "1",
    jobs: Jobs = None,
    scheduler: Scheduler = None,
) -> None:
    """Make a training set of random flights.

    Worlds and flights are random. Run again to go on after Ctrl-C, or with a larger --n.
    """
    from ullage.experiments import dataset as sets
    from ullage.radar.warmup import radar_parts
    from ullage.specs import MOST_BOUNCES
    from ullage.view.progress import answer, log, progress_bar

    if not all(word in map(str, range(1, MOST_BOUNCES + 1)) for word in bounces.split(",")):
        allowed = f"1 to {MOST_BOUNCES}, with commas between"
        raise InputError(f"cannot read {bounces!r}", where="--bounces", allowed=allowed)
    drawn, where = [int(word) for word in bounces.split(",")], where_to_run(jobs, scheduler)
    parts = radar_parts("physical", max(drawn))
    compile_parts(parts)
    try:
        with progress_bar(f"{n} samples", total=float(n), unit="samples", rated=True) as bar:
            made = sets.dataset(
                kinds, to, n=n, seed=seed, frames=frames, bounces=drawn, where=where,
                progress=lambda done, _, text: bar.at(done, text),
            )  # fmt: skip
    except KeyboardInterrupt:
        log(": run the same command again to go on", mark="interrupted", style="yellow")
        raise typer.Exit(130) from None
    rows = sets.read_index(made)
    failed = [row["failed"] for row in rows if row["failed"]]
    log(f"{len(rows)} samples in {to}, described in {to.with_suffix('.md')}")
    if failed:
        answer(f"{len(failed)} samples are empty; the first: {failed[0]}", mark="FAIL ", style="red")


def _tabulate(done: Sweep, metrics: list[str]) -> None:
    found = {name: done.summary(name) for name in metrics}
    rows = []
    for settings in dict.fromkeys(point.settings for point in done.done):
        cells = [found[name].get(settings, (0, float("nan"), 0.0)) for name in metrics]
        values = (f"{mean:.4g} ± {spread:.2g}" if count > 1 else f"{mean:.4g}" for count, mean, spread in cells)
        rows.append((*(value for _, value in settings), str(max(count for count, _, _ in cells)), *values))
    _print_table((*(key for key, _ in done.points[0].settings), "seeds", *metrics), rows)


@app.command(hidden=True)
def device(
    kind: Annotated[str, typer.Argument(help="x4, mrm or acconeer.")],
    pty: Annotated[bool, typer.Option("--pty", help="x4: on a pseudo terminal, which is its only place.")] = False,
    port: Annotated[
        int | None, typer.Option("--port", help="mrm, acconeer: on this computer; 0: a free one; none: its own.", min=0)
    ] = None,
    faults: Annotated[str, typer.Option("--faults", help="loss, duplicate, late, garbage, with commas.")] = "",
) -> None:
    """Simulate a radar instrument, until Ctrl-C.

    It answers its protocol, for a try of x4:, mrm: and acconeer: without hardware.
    """
    from ullage.ports.instruments import acconeer, mrm
    from ullage.ports.instruments.simulated import Simulated, SimulatedA121, SimulatedMrm, SimulatedX4, faults_of

    given = faults_of(faults)
    if kind == "x4":
        simulated: Simulated = SimulatedX4(given)
    elif kind == "mrm" and not pty:
        simulated = SimulatedMrm(mrm.PORT if port is None else port, given)
    elif kind == "acconeer" and not pty:
        simulated = SimulatedA121(acconeer.PORT if port is None else port, given)
    else:
        raise InputError(f"no instrument {kind!r}{' --pty' * pty}", where="device", allowed="x4 --pty, mrm, acconeer")
    typer.echo(f"a simulated instrument, no hardware: ullage run {kind}:{simulated.address}")
    try:
        simulated.wait()
    except KeyboardInterrupt:
        typer.echo(f"{simulated.sent} frames sent")
    finally:
        simulated.close()


@app.command()
def doctor(
    bag: Annotated[str, typer.Argument(help="Recording to repair: a run's or rosbag2 folder that a kill left.")] = "",
) -> None:
    """Check this installation, or repair a BAG.

    Check libraries, kernels, worlds and disk. Exit 1 when something is wrong.
    """
    from ullage.experiments.doctor import checks
    from ullage.view.progress import answer

    if bag:
        if not Path(bag).exists():
            raise InputError("no such file or folder", where=bag, allowed="a recording, or its folder")
        if not repair(bag):
            answer(f"{bag}: nothing to repair")
        return
    sound = True
    for check in checks():
        sound &= check.sound or check.optional
        style = "green" if check.sound else "yellow" if check.optional else "red"
        mark = {"green": "ok  ", "yellow": "none", "red": "BAD "}[style]
        answer(f" {check.name}: {check.found}", mark=mark, style=style)
    if not sound:
        raise typer.Exit(1)
