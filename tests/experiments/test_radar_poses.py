"""A scenario that believes the poses its own radars give."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from ullage.config import make_scenario
from ullage.data import gathered
from ullage.experiments.simulated import prepare

SHORT = {"name": "short", "world": {"name": "ntnu-room"},
         "flight": {"poses": "radar", "waypoints": [[-2.8, -1.9, 1.1], [-2.2, -1.9, 1.1]]}}  # fmt: skip


def test_processors_believe_what_the_radars_show_and_not_the_truth() -> None:
    ready = prepare(make_scenario(SHORT))
    with pytest.warns(ul.UllageWarning, match="simulated from the true flight.*often lost"):
        front = gathered(ready.stream())["front"]
    truth = ready.flown.mounted(front.spec.mount.body_from_sensor()).at(front.t_ns)
    error = np.linalg.norm(front.believed.position - truth.position, axis=1)
    assert 1e-4 < np.sqrt((error**2).mean()) < 0.2


def test_the_guard_does_not_fly_by_them() -> None:
    with pytest.raises(ul.InputError, match="poses navigation"):
        make_scenario(SHORT, options=["flight.guard.on=true"])
