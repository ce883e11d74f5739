"""What each radar of a body receives along a track, by one of the echo models.

Every frame depends on its own pose, velocities, time and number alone, so a track cut anywhere gives the same bits.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from typing import overload

import numpy as np

from ullage import checks
from ullage.data import Frames, Samples, Trajectory, gathered
from ullage.errors import InputError
from ullage.radar.receiving import Fidelity, Receiving
from ullage.radar.warmup import warm_up
from ullage.radar.worker_pool import PAYS_S, WorkerPool, cores
from ullage.specs import RadarSpec, Rig
from ullage.world.scene import Scene

Progress = Callable[[int, int], None]


@overload
def simulate(
    scene: Scene,
    path: Trajectory,
    radar: RadarSpec,
    *,
    fidelity: Fidelity = ...,
    max_bounces: int = ...,
    seed: int = ...,
    believed: Trajectory | None = ...,
    progress: Progress | None = ...,
) -> Frames: ...
@overload
def simulate(
    scene: Scene,
    path: Trajectory,
    radar: Rig,
    *,
    fidelity: Fidelity = ...,
    max_bounces: int = ...,
    seed: int = ...,
    believed: Trajectory | None = ...,
    progress: Progress | None = ...,
) -> dict[str, Frames]: ...
def simulate(
    scene: Scene,
    path: Trajectory,
    radar: RadarSpec | Rig,
    *,
    fidelity: Fidelity = "physical",
    max_bounces: int = 1,
    seed: int = 0,
    believed: Trajectory | None = None,
    progress: Progress | None = None,
) -> Frames | dict[str, Frames]:
    """What the radar receives along a track, one frame per sample of it.

    Args:
        scene: the world.
        path: the body's true trajectory.
        radar: one radar, or several on one body.
        fidelity: "physical" (coherent echoes), "thesis" (the ray model of 2018), or an echo model that another package
            adds.
        max_bounces: 1 to 6 reflections between radar and radar; the ray model knows only one.
        seed: of the noise; the same seed gives the same bits however the track is cut.
        believed: the body's trajectory as navigation has it, at the same times; it becomes `Frames.poses`.
        progress: called with frames done and frames in all, sensors together.

    Returns:
        Frames; for a `Rig` a dict of Frames by sensor name.

    Raises:
        InputError: an argument cannot be used.
    """
    pieces = simulate_stream(scene, path, radar, fidelity=fidelity, max_bounces=max_bounces, seed=seed,
                             believed=believed, progress=progress)  # fmt: skip
    warm_up(fidelity, max_bounces, scene)
    whole = gathered(pieces)
    return whole if isinstance(radar, Rig) else next(iter(whole.values()))


def simulate_stream(
    scene: Scene,
    path: Trajectory,
    radar: RadarSpec | Rig,
    *,
    fidelity: Fidelity = "physical",
    max_bounces: int = 1,
    seed: int = 0,
    believed: Trajectory | None = None,
    chunk: int = 64,
    progress: Progress | None = None,
    first_frame: int = 0,
) -> Iterator[dict[str, Frames]]:
    """As `simulate`, in pieces of at most `chunk` frames, in order; a single radar is called "radar".

    Args:
        scene: the world.
        path: the body's true trajectory.
        radar: one radar, or several on one body.
        fidelity: "physical" or "thesis".
        max_bounces: 1 to 6.
        seed: of the noise.
        believed: the body's trajectory as navigation has it, at the same times.
        chunk: frames per piece; memory follows it, the numbers do not.
        progress: called with frames done and frames in all.
        first_frame: number of the first sample, for a track that continues another.

    Raises:
        InputError: an argument cannot be used.
    """
    _check_track(path, believed, chunk, first_frame)
    work = Receiving(scene, radar, fidelity=fidelity, max_bounces=max_bounces, seed=seed)
    work.model.check(path, work.sensors)
    return _stream(work, path, believed, chunk, progress, first_frame)


def _stream(
    work: Receiving,
    path: Trajectory,
    believed: Trajectory | None,
    chunk: int,
    progress: Progress | None,
    first_frame: int,
) -> Iterator[dict[str, Frames]]:
    """Pieces in order, while the next ones are under way on every core."""
    cuts = pieces_of(len(path), chunk)

    def samples(name: str, cut: slice) -> Samples:
        return work.samples(name, path[cut], first_frame=first_frame + cut.start)

    def piece(found: dict[str, Future[Samples]], cut: slice) -> dict[str, Frames]:
        known = None if believed is None else believed[cut]
        return {name: work.frames(name, job.result(), path[cut], believed=known) for name, job in found.items()}

    ahead = max(2, math.ceil(2 * cores() / len(work.sensors)))
    waiting: deque[tuple[dict[str, Future[Samples]], slice]] = deque()
    pool = WorkerPool(samples)
    done = 0
    try:
        for cut in cuts:
            last = cut is cuts[-1]
            waiting.append(({name: pool.submit(name, cut) for name in work.sensors}, cut))
            if cut is cuts[0] and not last and work.model.forks:
                _fork_where_it_pays(pool, waiting[0][0], len(path) / cut.stop)
            while len(waiting) >= ahead or (waiting and last):
                context = piece(*waiting.popleft())
                done += sum(len(frames) for frames in context.values())
                if progress is not None:
                    progress(done, len(path) * len(work.sensors))
                yield context
    finally:
        pool.close()


LEAD = 16
"""Frames of the first piece: somebody waits for it."""


def pieces_of(count: int, chunk: int) -> list[slice]:
    """Where a track of `count` frames is cut: a short piece first, then pieces of `chunk`."""
    starts = [0, *range(min(LEAD, chunk), count, chunk)][:count]
    return [slice(start, end) for start, end in zip(starts, [*starts[1:], count], strict=False)]


def _fork_where_it_pays(pool: WorkerPool[Samples], first: dict[str, Future[Samples]], pieces: float) -> None:
    """Copies of this process once the first pieces are made: kernels are compiled then, and the scene is ready."""
    began = time.process_time()
    wait(first.values())
    if (time.process_time() - began) * (pieces - 1) > PAYS_S:
        pool.fork()


def _check_track(path: Trajectory, believed: Trajectory | None, chunk: int, first_frame: int) -> None:
    if not isinstance(path, Trajectory):
        raise InputError(f"path is a {type(path).__name__}", where="simulate", allowed="a Trajectory")
    checks.whole("chunk", chunk, "simulate", low=1, high=2**31)
    checks.whole("first_frame", first_frame, "simulate", low=0, high=2**62)
    if believed is not None:
        if not isinstance(believed, Trajectory):
            raise InputError(f"believed is a {type(believed).__name__}", where="simulate", allowed="a Trajectory")
        if not np.array_equal(believed.t_ns, path.t_ns):
            raise InputError("believed is not at the times of path", where="simulate", allowed="believed.at(path.t_ns)")
