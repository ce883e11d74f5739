"""Gathers what a run's report replays: world, flight, maps over time, image, and explained frames."""

from __future__ import annotations

import numpy as np

from ullage.experiments.run import Run
from ullage.grids import Image
from ullage.pipeline import Outcome
from ullage.radar.explain import explain
from ullage.radar.worker_pool import WorkerPool
from ullage.view.replay import Explained, Parts, write_replay

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
