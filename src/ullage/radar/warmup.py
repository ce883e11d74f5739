"""Compiles the kernels that a radar needs, once after installation, on worlds of a few triangles.

Numba compiles one function at a time in a process, so half of the work is done in a process of its own beside this
one. While either compiles, the garbage of a compiler is not swept: there is little, and looking for it takes a tenth
of the time.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import IO, TYPE_CHECKING, Literal

import numpy as np

from ullage import kernels
from ullage.data import Trajectory
from ullage.radar import warmup_curved
from ullage.radar.worker_pool import cores
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

if TYPE_CHECKING:
    from ullage.radar.context import AntennaPair, RadarContext
    from ullage.radar.facets import PlanarPatches

Log = Callable[[str], None]

NEEDED: Mapping[str, tuple[str, ...]] = {
    "thesis": ("rays",),
    "physical": ("pulse", "edges", "outlines", "rays", "receiver"),
    "rough": ("diffuse_scatterers",),
    "bounces": ("beams", "bounces"),
    "shapes": ("facets", "wires"),
    "paths": ("paths", "lit"),
    "curved": ("impulses",),
    "fermat": ("fermat",),
    "chains": ("chains",),
    "conductors": ("lines", "edge_diffraction", "edge_places", "double_edge_diffraction", "corner_diffraction"),
}
"""Kernel modules behind each part of a radar."""


@dataclass(frozen=True, slots=True)
class Job:
    """Something small to run, that compiles some kernels."""

    name: str
    part: str
    seconds: float  # CPU time it takes, about
    run: Callable[[], None]
    needs: tuple[str, ...] = ()  # jobs whose kernels it runs too: it waits for them, in this process


def radar_parts(fidelity: str, max_bounces: int = 3, scene: Scene | None = None) -> tuple[str, ...]:
    """The parts of `NEEDED` behind a radar, in a world where that is known."""
    if fidelity != "physical":
        return (fidelity,)
    many = max_bounces > 1
    there = {"rough": True, "bounces": many, "shapes": True, "conductors": True, "paths": many, "curved": True,
             "fermat": many, "chains": many}  # fmt: skip
    if scene is not None:
        from ullage.radar.prepared import prepare

        made = prepare(scene)
        planar = made.still.planar
        there["rough"] = any(material.roughness_m > 0 for material in made.materials)
        there["shapes"] = bool(len(made.still.corners) or made.moving.any() or len(scene.wires))
        led = planar.smooth.any() or len(made.still.corners) or made.moving.any() or len(scene.wires)
        there["paths"] &= bool(led and (~planar.smooth).any())
        there["fermat"] = many and len(made.quadrics) > (0 if max_bounces > 2 else 1)
        there["curved"] = there["fermat"] or any(len(wall.strips) for wall in made.quadrics)
        there["chains"] = many and any(wall.holds(body) for wall in made.quadrics for body in made.quadrics)
        there["conductors"] = bool(len(made.edges.edges) or made.moving.any())
    return (fidelity, *(part for part, needed in there.items() if needed))


_DONE: set[str] = set()  # parts that this process has seen to


@contextmanager
def warming_up(fidelity: str) -> Iterator[Callable[[int, Scene], None]]:
    """Gives what compiles all that a radar needs, told greatest bounces and world; Python beside starts meanwhile."""
    work = Compiling(module=__name__)
    if fidelity == "physical" and "physical" not in _DONE and not _compiled("physical"):
        work.open()
    try:
        yield lambda max_bounces, scene: warm_up(fidelity, max_bounces, scene, work=work)
    finally:
        work.close()


def warm_up(fidelity: str, max_bounces: int, scene: Scene, *, work: Compiling | None = None) -> None:
    """Compiles what a radar needs in a world, in two processes, where there is much to compile and both have a core.

    Args:
        fidelity: of the radar.
        max_bounces: 1 to 3.
        scene: the world.
        work: one whose other process may have started.
    """
    parts = set(radar_parts(fidelity, max_bounces, scene)) - _DONE
    _DONE.update(parts)
    wanted = [job for job in JOBS if job.part in parts and not _compiled(job.part)]
    if sum(job.seconds for job in wanted) > _WORTH_S and cores() > 1 and all(shared(wanted)):
        work = work or Compiling(module=__name__)
        work.now = wanted
        work.wait()


_WORTH_S = 10.0  # less is compiled as it is met [s]


def _compiled(part: str) -> bool:
    return all(kernels.compiled(stem) for stem in NEEDED[part])


@contextmanager
def unswept() -> Iterator[None]:
    """While it lasts, no garbage is collected, unless somebody else has seen to that."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@dataclass(slots=True)
class Compiling:
    """Jobs under way: those of now in this process and the one beside it, those of later in that one.

    Args:
        now: what must be compiled before anything else begins.
        later: what may be compiled while other things go on.
        module: what Python runs beside this process; it takes names of jobs, and tells each that is done.
        log: called with what is being compiled, and about how long all of it still takes.
    """

    now: Sequence[Job] = ()
    later: Sequence[Job] = ()
    module: str = ""
    log: Log | None = None
    _beside: subprocess.Popen[str] | None = field(default=None, init=False)
    _open: list[str] = field(default_factory=list, init=False)  # not yet done beside
    _mine: list[Job] = field(default_factory=list, init=False)  # not yet done in this process
    _worked: tuple[float, float] = field(
        default=(0.0, 0.0), init=False
    )  # what jobs done in this process took, and what they were to take [s]

    def open(self) -> None:
        """Start the process beside, where it has a core: it gets ready and then waits to be told what to do."""
        if self._beside is not None or cores() < 2:
            return
        try:  # a group of its own: Ctrl-C is for this process, which ends the other
            self._beside = subprocess.Popen([sys.executable, "-m", self.module], stdin=subprocess.PIPE,
                                            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                                            start_new_session=True)  # fmt: skip
        except OSError:  # no Python to start: each kernel is compiled when it is met
            return

    def wait(self) -> None:
        """Compile until all jobs of now are done."""
        mine, others = shared(self.now)
        if cores() < 2:
            mine, others = [*mine, *others], []
        elif others or self.later:
            self._start([job.name for job in (*others, *self.later)])
        self._mine = mine
        try:
            with unswept():
                for job in tuple(mine):
                    self._await([other for other in others if other.name in job.needs])
                    self._say([job.name, *self._open[:1]])
                    self._run(job)
                    self._mine.remove(job)
            self._await(others)
        except BaseException:
            self.close()
            raise

    def wait_later(self) -> None:
        """Compile until the jobs of later are done too."""
        try:
            self._await(self.later)
        finally:
            self.later = ()
            self.close()

    def close(self) -> None:
        """Let nothing go on beside."""
        self._open.clear()
        if self._beside is None:
            return
        if self._beside.poll() is None:
            self._beside.terminate()
            self._beside.wait()
        for pipe in (self._beside.stdin, self._beside.stdout):
            if pipe is not None:
                pipe.close()

    def _start(self, names: list[str]) -> None:
        self.open()
        if self._beside is None or self._beside.stdin is None:
            return
        with suppress(BrokenPipeError), self._beside.stdin as told:  # where it has died, all is done here
            told.write("".join(f"{name}\n" for name in names))
        self._open[:] = names

    def _await(self, jobs: Sequence[Job]) -> None:
        """Listen until these jobs are done beside; those it left undone are done here."""
        told: IO[str] | None = self._beside.stdout if self._beside is not None else None
        while told is not None and any(job.name in self._open for job in jobs):
            self._say(self._open[:1])
            line = told.readline()
            if not line:
                break
            if line.strip() in self._open:
                self._open.remove(line.strip())
        for job in jobs:
            if self._beside is None or job.name in self._open:
                self._say([job.name])
                with unswept():
                    self._run(job)

    def _run(self, job: Job) -> None:
        """Do a job in this process, and learn from it how fast this machine compiles."""
        start = time.perf_counter()
        job.run()
        took, planned = self._worked
        self._worked = took + time.perf_counter() - start, planned + job.seconds

    @property
    def left_s(self) -> float:
        """Estimate the time until all is compiled, from what was compiled so far [s]."""
        took, planned = self._worked
        beside = {job.name: job.seconds for job in (*self.now, *self.later)}
        most = max(sum(job.seconds for job in self._mine), sum(beside.get(name, 0.0) for name in self._open))
        return most * (took / planned if planned else 1.0)

    def _say(self, names: list[str]) -> None:
        if self.log is not None and names:
            left = self.left_s
            self.log(", ".join(names) + (f", about {left:.0f} s left" if left >= 1 else ""))


def shared(jobs: Sequence[Job]) -> tuple[list[Job], list[Job]]:
    """Two shares that end at about the same time, each in the order of `jobs`; what needs others is in the first."""
    free = [job for job in jobs if not job.needs]
    spent = [sum(job.seconds for job in jobs if job.needs), _START_S]
    shares: tuple[list[Job], list[Job]] = ([job for job in jobs if job.needs], [])
    for job in sorted(free, key=lambda job: -job.seconds):
        less = int(spent[1] < spent[0])
        shares[less].append(job)
        spent[less] += job.seconds
    one, other = ([job for job in jobs if job in share] for share in shares)
    return one, other


def estimated_s(jobs: Sequence[Job]) -> float:
    """Estimate how long jobs take on this machine's cores [s]."""
    shares = shared(jobs) if cores() > 1 else (jobs, ())
    return max(sum(job.seconds for job in share) for share in shares)


_START_S = 1.0  # what the other process takes to start, about [s]


def beside(jobs: Sequence[Job]) -> None:
    """What the process beside does: the jobs whose names it is told line by line, each told back when done."""
    from ullage.radar import physical  # noqa: F401  while nothing is asked yet

    with unswept():
        for line in sys.stdin:
            next(job for job in jobs if job.name == line.strip()).run()
            print(line.strip(), flush=True)


def _frames(scene: Scene, *, fidelity: Literal["physical", "thesis"] = "physical", max_bounces: int = 1) -> None:
    from ullage.radar.receiving import Receiving

    track = Trajectory.line((0, -0.1, 0), (0, 0.1, 0), 0.5, 17)
    work = Receiving(scene, RadarSpec.preset("x4m05"), fidelity=fidelity, max_bounces=max_bounces, seed=0)
    work.model.check(track, work.sensors)
    work.samples("radar", track)


def _thesis() -> None:
    from ullage.world import scenes

    _frames(scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0), fidelity="thesis")


def _walls(*, roughness_m: float = 0.0, max_bounces: int = 1) -> None:
    _frames(_room(roughness_m), max_bounces=max_bounces)


def _room(roughness_m: float = 0.0) -> Scene:
    from ullage.world import scenes

    room = scenes.room((2, 2, 2))
    walls = tuple(replace(wall, material=wall.material.but(roughness_m=roughness_m)) for wall in room.objects)
    return replace(room, objects=walls)


def _bench(scene: Scene) -> tuple[RadarContext, AntennaPair, PlanarPatches]:
    from ullage.radar.context import antenna_pair, radar_context

    spec = RadarSpec.preset("x4m05")
    context = radar_context(scene, spec)
    return context, antenna_pair(spec, np.zeros(3), np.eye(3)), context.world.still.planar


def _outlines() -> None:
    from ullage.radar.planar import outlines

    context, antennas, planar = _bench(_room())
    outlines(context, planar, antennas, np.arange(len(planar)), np.full(len(planar), 9.0))


def _echoes() -> None:
    from ullage.kernels.edges import Outline
    from ullage.radar.context import transmission_to
    from ullage.radar.planar import Shading, accumulate_parted, face_outlines
    from ullage.radar.shadows import MirrorPoints, echo_shares
    from ullage.radar.visibility import OpaqueView

    context, antennas, planar = _bench(_room())
    shading = Shading(lambda at, _: transmission_to(context, context.world.parts(), antennas, at))
    accumulate_parted(context, planar, np.arange(len(planar)), Outline.none(len(planar)), np.full(len(planar), 9.0),
                      shading, context.lit(antennas, planar), np.zeros((3, context.places), complex))  # fmt: skip
    row = np.append(planar.normals[0] * planar.offsets[0], np.ones(6))[None]  # as if hidden: all about it is a border
    hidden = MirrorPoints(row, np.zeros(1, np.int64), np.zeros(1, np.bool_))
    casters = [part.casters(context.transmissive.thin)[0] for part in context.world.parts()]
    echo_shares(hidden, face_outlines(planar), planar.across, 0.04, OpaqueView(casters, np.zeros(3)))


def _beams() -> None:
    from ullage.radar.multipath import apparent_sizes, beams_of

    context, antennas, planar = _bench(_room())
    beams_of(context, planar, antennas, 3, apparent_sizes(context, planar, antennas))


def _paths() -> None:
    """The kernels of `multipath` beyond beams and rims, on no paths at all."""
    from ullage.kernels import bounces
    from ullage.kernels.edges import Outline

    context, antennas, planar = _bench(_room())
    long, row, tips = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 9))
    points, paths, chains = np.zeros((0, 3)), np.zeros((0, 5, 3)), np.zeros((0, 2), np.int64)
    bounces.middles(np.zeros(1, np.int32), np.zeros((0, 2, 3)), points)
    beams = bounces.ImagePaths(points, points, chains)
    bounces.legs(beams, planar.normals, planar.offsets, antennas.origins, long, points, paths)
    bounces.stretches(paths, row, points, points, long)
    bounces.cover(paths, chains, planar.normals, planar.widths, context.spec.wavelength_m, np.zeros(3), row)
    bounces.stand_ins(points, Outline.none(0), tips, long, row, row > 0, points)
    bounces.reflect(
        paths, chains, long, context.mirrors(planar), bounces.Orientations(antennas.frames, antennas.fields), row + 0j,
        bounces.Orientations(np.zeros((0, 2, 3, 3)), np.zeros((0, 2, 3))),
        bounces.ReflectScratch(np.zeros((3, 3)), np.zeros(3, complex)),
    )  # fmt: skip


def _paths_over_faces() -> None:
    """The kernels of paths over flat faces, to no points, wires and facets at all."""
    from ullage.kernels import lit, paths
    from ullage.kernels.edges import Outline
    from ullage.radar import curves
    from ullage.radar.multipath import apparent_sizes
    from ullage.radar.paths import flat_faces, paths_of, reached

    context, antennas, planar = _bench(_room())
    still, none, long, both = context.world.still, np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros((0, 2), complex)
    led = paths_of(context, planar, antennas, 3, apparent_sizes(context, planar, antennas))
    known = reached([], planar, led, long, none)
    mirrors = context.mirrors(planar)
    pairs = paths.Weighed(known.stops, known.rows, long, long, np.zeros(0, np.int32))
    waves = np.zeros((2, 3), complex)
    paths.weigh(pairs, led.faces, antennas.fields, mirrors, paths.FieldScratch(np.zeros((3, 3)), waves),
                both[:, 0].copy())  # fmt: skip
    met = paths.WireMeetings(long, long, both, np.zeros(0))
    scratch = paths.FieldScratch(np.zeros((5, 4, 3)), waves)
    paths.meet_wires(np.zeros((2, 0, 3)), led.over_mirrors, 9.0, antennas.fields, mirrors, flat_faces(planar), met,
                     scratch)  # fmt: skip
    curves.met(context, planar, still.flat_backs, led, long, 1.0)
    curves.outlines_heard(context, Outline.none(0), np.zeros(0), 1.0)
    lit.pair_up(curves.lit_by(context, still, led), np.zeros(0, np.int32), long, long)


def _shapes() -> None:
    from ullage.world import scenes

    _frames(scenes.sphere(0.2, 2.0))
    _frames(scenes.wire(radius_m=0.001, length_m=0.5, distance_m=2.0))


def _conductors() -> None:
    from ullage.radar.edge_diffraction import accumulate_edges
    from ullage.world import scenes

    context, antennas, _ = _bench(scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0, material="pec"))
    accumulate_edges(context, context.world.parts(), antennas, None, np.zeros((3, context.places), complex))


JOBS: tuple[Job, ...] = (
    Job("rays", "thesis", 1, _thesis),
    Job("outlines of faces", "physical", 3, _outlines),
    Job("beams", "bounces", 2.2, _beams),
    Job("edges of conductors", "conductors", 8.3, _conductors),
    Job("echoes of faces", "physical", 2.4, _echoes),
    Job("curved faces and wires", "shapes", 4.9, _shapes),
    Job("paths of bounces", "bounces", 2.4, _paths),
    Job("paths over faces", "paths", 6.5, _paths_over_faces),
    Job("echoes of curved surfaces", "curved", 0.9, warmup_curved.echoes),
    Job("paths over round bodies", "fermat", 3.8, warmup_curved.fermat),
    Job("paths over a tank's wall", "chains", 3.2, warmup_curved.chains),
    Job("frames", "physical", 0.2, _walls, ("outlines of faces", "echoes of faces")),
    Job("rough faces", "rough", 0.7, partial(_walls, roughness_m=1e-3), ("outlines of faces", "echoes of faces")),
    Job("bounces", "bounces", 2.2, partial(_walls, max_bounces=2),
        ("outlines of faces", "echoes of faces", "beams", "paths of bounces")),
)  # fmt: skip

if __name__ == "__main__":
    beside(JOBS)
