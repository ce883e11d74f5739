"""The bounds of shipped scenarios: a sound mapper is inside them, one that is ruined is not."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest

from ullage.data import Frames, Trajectory
from ullage.experiments.catalog import find_scenario
from ullage.experiments.folder import RunFolder, verdicts
from ullage.experiments.run import of_scenario
from ullage.experiments.runner import execute
from ullage.experiments.simulated import Simulated, prepare


def too_long(frames, step_m):
    """Every echo 0.25 m farther off, or a cell where that is more: half a cell off shows on no map."""
    return replace(frames, range_m=frames.range_m + max(0.25, step_m))


def shifted(frames, step_m):
    """Poses, and with them the map, 0.3 m aside."""
    path = frames.believed
    moved = Trajectory(path.t_ns, path.position + np.array([0.3, 0.0, 0.0]), path.quat_xyzw)
    return replace(frames, poses=moved, truth=path)


def sound(frames, step_m):
    """As the radars received them."""
    return frames


def deaf(frames, step_m):
    """Noise alone."""
    return replace(frames, samples=np.zeros_like(frames.samples))


@dataclass
class Ruined:
    simulated: Simulated
    pieces: list[dict[str, Frames]]
    ruin: object

    def stream(self):
        for piece in self.pieces:
            yield {name: self.ruin(part, self.simulated.scenario.map.step_m) for name, part in piece.items()}


@lru_cache(maxsize=1)
def received(name):
    """A scenario, and what its radars receive: simulated once for all that is done to it."""
    scenario = find_scenario(name)
    judged = {"do": ("detect", "map"), "map": scenario.map.model_copy(update={"every_s": 3600.0})}  # no bound asks more
    simulated = prepare(scenario.model_copy(update=judged))
    return simulated, list(simulated.stream())


def outside(name, folder, ruin):
    """Bounds of a scenario that its run is outside of."""
    simulated, pieces = received(name)
    job = of_scenario(RunFolder(folder), simulated)
    job.source = Ruined(simulated, pieces, ruin)
    execute(job, draw=False, log=lambda text: None)
    return [one.text for one in verdicts(folder) if not one.inside]


QUICK = ["ntnu-mapping"]
SLOW = ["ntnu-mapping-5cm", "ntnu-mapping-50cm", "ntnu-mapping-20cm", "cluttered-room", "cargo-hold",
        "ntnu-mapping-physical", "cluttered-room-physical", "cargo-hold-physical"]  # fmt: skip


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("ruin", [sound, too_long, shifted, deaf])
@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_a_ruined_mapper_is_out_of_bounds_and_a_sound_one_within(name, ruin, tmp_path):
    found = outside(name, tmp_path, ruin)
    assert bool(found) == (ruin is not sound), found
