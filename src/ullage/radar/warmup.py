"""Compiles the kernels that a radar needs, once after installation: each part by a tiny job that runs all of it.

Numba compiles one function at a time in a process, so a process beside this one does half of the jobs.
"""

from __future__ import annotations

import gc
import logging
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from threading import Thread
from typing import Literal

from ullage.data import Trajectory
from ullage.kernels.loops import compiled, mark_compiled
from ullage.radar.worker_pool import cores
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

Log = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Job:
    """Something small to run, that compiles all kernels of a part."""

    part: str
    run: Callable[[], None]


def warm_up(fidelity: str, max_bounces: int, scene: Scene) -> None:
    """Compile what a radar needs in a world, and log that; do nothing where it is compiled.

    Args:
        fidelity: of the radar.
        max_bounces: 1 to 6.
        scene: the world.
    """
    if compiled(radar_parts(fidelity, max_bounces)):
        return
    parts = radar_parts(fidelity, max_bounces, scene)
    if jobs := [job for job in JOBS if job.part in parts and not compiled([job.part])]:
        logging.getLogger("ullage").warning("compiling kernels (once after installation)")
        run_jobs(jobs, module=__name__)


def radar_parts(fidelity: str, max_bounces: int = 3, scene: Scene | None = None) -> tuple[str, ...]:
    """The parts of `JOBS` behind a radar, in a world where that is known."""
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


def run_jobs(jobs: Iterable[Job], *, module: str, log: Log | None = None) -> None:
    """Do the jobs of parts that are not compiled yet: this process from the first, one beside it from the last.

    Args:
        jobs: those first whose kernels others run too.
        module: what Python runs beside this process; it calls `do_named_jobs`.
        log: called with each part that this process compiles, and the number of parts that wait.
    """
    left = deque(job for job in jobs if not compiled([job.part]))
    beside = Thread(target=_hand_out, args=(left, module), daemon=True)
    if cores() > 1 and len(left) > 1:
        beside.start()
    try:
        while left or beside.is_alive():
            if not left:
                beside.join()  # what it could not do is left then
                continue
            job = left.popleft()
            if log is not None:
                log(f"kernels for {job.part}, {len(left)} parts to come")
            _compile(job)
    finally:
        left.clear()


def _compile(job: Job) -> None:
    """Do a job without garbage collection, which takes a sixth of the time that Numba compiles."""
    collects = gc.isenabled()
    gc.disable()
    try:
        job.run()
    finally:
        if collects:
            gc.enable()
    mark_compiled(job.part)


def _hand_out(left: deque[Job], module: str) -> None:
    """Hand a process of its own one job after the other, from the last; one that it does not do goes back."""
    command = [sys.executable, "-m", module]
    # a group of its own: Ctrl-C is for this process, and the other ends with its input
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                          bufsize=1, start_new_session=True) as process:  # fmt: skip
        orders, answers = process.stdin, process.stdout
        while orders and answers:
            try:
                job = left.pop()
            except IndexError:
                return
            try:
                orders.write(f"{job.part}\n")
                done = answers.readline().strip() == job.part
            except OSError:
                done = False
            if not done:
                left.append(job)
                return


def do_named_jobs(jobs: Sequence[Job]) -> None:
    """Do the jobs of the parts that come line by line on the standard input; print each part when it is done."""
    for line in sys.stdin:
        job = next(job for job in jobs if job.part == line.strip())
        _compile(job)
        print(job.part, flush=True)


def _receive(scene: Scene, *, fidelity: Literal["physical", "thesis"] = "physical", max_bounces: int = 1) -> None:
    from ullage.radar.receiving import Receiving

    track = Trajectory.line((0, -0.1, 0), (0, 0.1, 0), 0.5, 17)
    work = Receiving(scene, RadarSpec.preset("x4m05"), fidelity=fidelity, max_bounces=max_bounces, seed=0)
    work.model.check(track, work.sensors)
    work.samples("radar", track)


def _room(*others: Scene, roughness_m: float = 0.0) -> Scene:
    """A small room with a plate that hides a part of a wall, and other things."""
    from ullage.world import scenes

    room = scenes.room((3, 2, 2), plate={"width_m": 0.4, "height_m": 0.4, "distance_m": 0.8})
    walls = tuple(replace(wall, material=wall.material.but(roughness_m=roughness_m)) for wall in room.objects)
    return Scene.union([replace(room, objects=walls), *others])


def _thesis() -> None:
    _receive(_room(), fidelity="thesis")


def _walls(*, roughness_m: float = 0.0, max_bounces: int = 1) -> None:
    _receive(_room(roughness_m=roughness_m), max_bounces=max_bounces)


def _paths() -> None:
    from ullage.world import scenes

    _receive(_room(scenes.wire(radius_m=0.001, length_m=0.3, distance_m=0.7)), max_bounces=3)
    _receive(_room(scenes.sphere(0.2, 0.7)), max_bounces=2)


def _fermat() -> None:
    from ullage.world import scenes

    _receive(Scene.union([scenes.sphere(0.2, 0.8), scenes.cylinder(0.1, 0.5, 1.3)]), max_bounces=3)


def _tank(*others: Scene, max_bounces: int = 1) -> None:
    from ullage.world import scenes

    tank = scenes.tank(2.0, 1.0, "concrete", strips=30)
    _receive(Scene.union([replace(tank, vertices=tank.vertices - [0, 0, 0.5]), *others]), max_bounces=max_bounces)


def _chains() -> None:
    from ullage.world import scenes

    _tank(scenes.sphere(0.3, 1.0), max_bounces=2)


def _shapes() -> None:
    from ullage.world import scenes

    _receive(scenes.sphere(0.2, 2.0))
    _receive(scenes.wire(radius_m=0.001, length_m=0.5, distance_m=2.0))


def _conductors() -> None:
    from ullage.world import scenes

    _receive(scenes.plate(width_m=0.5, height_m=0.5, distance_m=2.0, material="pec"))


JOBS = (
    Job("physical", _walls),
    Job("rough", partial(_walls, roughness_m=1e-3)),
    Job("bounces", partial(_walls, max_bounces=3)),
    Job("paths", _paths),
    Job("chains", _chains),
    Job("fermat", _fermat),
    Job("curved", _tank),
    Job("shapes", _shapes),
    Job("conductors", _conductors),
    Job("thesis", _thesis),
)

if __name__ == "__main__":
    do_named_jobs(JOBS)
