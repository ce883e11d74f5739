"""Health of the radars: which frames were received, since when one is faulty, and no alarm where nothing is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.errors import UllageWarning
from ullage.processing.health import HealthMonitor
from ullage.processing.obstacles import ObstacleStage

RATE_HZ = 17.0
RIG = ul.Rig.preset("thesis-4")
ROOM = ul.scenes.room(size_m=(6, 4, 3), material="concrete")
PATH = Trajectory.line((-1.5, 0, 0), (1.5, 0.3, 0), 0.5, RATE_HZ)
BROKEN = 50
"""First frame of a fault."""


@pytest.fixture(scope="module")
def frames() -> dict[str, Frames]:
    return ul.simulate(ROOM, PATH, RIG, seed=1)


def noise_only(part: Frames) -> np.ndarray:
    rng, level = np.random.default_rng(0), np.median(np.abs(part.samples)) / 1.18
    return level * (rng.normal(size=part.samples.shape) + 1j * rng.normal(size=part.samples.shape))


FAULTS: dict[str, Callable[[Frames], np.ndarray]] = {
    "stuck": lambda part: np.repeat(part.samples[BROKEN - 1 : BROKEN], len(part), 0),
    "deaf": noise_only,
    "without a signal": lambda part: np.zeros_like(part.samples),
    "its direct path is gone": lambda part: np.where(part.range_m < 0.5, noise_only(part), part.samples),
    "saturated": lambda part: 5e-4 * part.samples / np.maximum(np.abs(part.samples), 5e-4),
}


def broken(part: Frames, cause: str, until: int | None = None) -> Frames:
    rows = slice(BROKEN, until)
    samples = part.samples.copy()
    samples[rows] = FAULTS[cause](part)[rows]
    return replace(part, samples=samples.astype(np.complex64))


def lines(frames: dict[str, Frames], size: int = 1) -> list[str]:
    monitor = HealthMonitor()
    for start in range(0, max(map(len, frames.values())), size):
        monitor.judge({name: part[start : start + size] for name, part in frames.items() if start < len(part)})
    return monitor.lines()


@pytest.mark.parametrize("cause", FAULTS)
def test_a_fault_is_found_within_a_second_and_ends_with_the_next_sound_frame(
    frames: dict[str, Frames], cause: str
) -> None:
    part, monitor, found = broken(frames["left"], cause, 80), HealthMonitor(), []
    for row in range(len(part)):
        monitor.judge({"left": part[row : row + 1]})
        found.append(monitor.fault("left", int(part.t_ns[row])))
    assert set(found[BROKEN + round(RATE_HZ) : 80]) == {cause}
    assert set(found[:BROKEN] + found[80:]) == {""}
    assert monitor.lines() == [f"left: {cause} from {BROKEN / RATE_HZ:.1f} s to {80 / RATE_HZ:.1f} s"]


@pytest.mark.parametrize("cause", FAULTS)
def test_the_pieces_do_not_matter(frames: dict[str, Frames], cause: str) -> None:
    some = frames | {"left": broken(frames["left"], cause)}
    assert lines(some) == lines(some, 7) == lines(some, 1000) != []


def test_frames_that_end_or_pause_are_missing(frames: dict[str, Frames]) -> None:
    pause = np.r_[:30, 60 : len(PATH)]
    assert lines(frames | {"left": frames["left"][:30]}, 1000) == ["left: no frames came from 1.7 s"]
    assert lines(frames | {"left": frames["left"][pause]}, 1000) == ["left: no frames came from 1.7 s to 3.5 s"]


def test_a_fault_that_comes_again_is_one_line_however_often(frames: dict[str, Frames]) -> None:
    paused = np.flatnonzero(np.arange(len(PATH)) % 30 < 10)
    assert lines(frames | {"left": frames["left"][paused]}, 7) == [
        "left: no frames came 3 times from 0.5 s to 5.3 s, 3.7 s in all"
    ]


def test_a_short_disturbance_is_no_fault_but_not_sound(frames: dict[str, Frames]) -> None:
    part, monitor = broken(frames["left"], "deaf", BROKEN + 5), HealthMonitor()
    assert np.flatnonzero(~monitor.judge({"left": part})["left"]).tolist() == list(range(BROKEN, BROKEN + 5))
    assert monitor.lines() == []


@pytest.mark.parametrize("noise", [True, False])
@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
@pytest.mark.parametrize("where", ["room", "hover", "empty"])
def test_sound_radars_raise_no_alarm(noise: bool, fidelity: str, where: str) -> None:
    rig = RIG if noise else ul.Rig.preset("thesis-4", noise=None)
    scene = ul.scenes.plate(width_m=1, height_m=1, distance_m=400) if where == "empty" else ROOM
    path = Trajectory.stationary(n=60) if where == "hover" else PATH[:60]
    assert lines(ul.simulate(scene, path, rig, seed=2, fidelity=fidelity), 20) == []


def test_slow_radars_raise_no_alarm(frames: dict[str, Frames]) -> None:
    assert lines({name: part[::25] for name, part in frames.items()}) == []


def test_a_map_leaves_out_what_was_not_received(frames: dict[str, Frames]) -> None:
    grid, some = ul.Grid.covering(ROOM.bounds, 0.2, margin_m=0.5), {name: part[:40] for name, part in frames.items()}
    without = ul.map_occupancy({name: part for name, part in some.items() if name != "left"}, grid)
    dead = replace(some["left"], samples=noise_only(some["left"]).astype(np.complex64))
    with pytest.warns(UllageWarning, match=r"left: deaf from 0\.0 s.*left out"):
        omap = ul.map_occupancy(some | {"left": dead}, grid)
    np.testing.assert_array_equal(omap.percent, without.percent)


def test_obstacles_say_why_a_radar_is_not_valid(frames: dict[str, Frames]) -> None:
    stage = ObstacleStage()
    last = list(stage.update(frames | {"left": broken(frames["left"], "deaf")}))[-1]
    assert dict(zip(last.sensors, last.fault, strict=True)) == {"front": "", "left": "deaf", "back": "", "right": ""}
    assert np.isnan(last.distance_m[last.sensors.index("left")])


RECORDED = Path(__file__).parents[3] / "shared" / "data"


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@pytest.mark.parametrize(
    "place", ["pulson440/rail_a", "pulson440/flight_a", "x4/xethru_baseband_iq_20170913_150437.dat"]
)
def test_real_recordings_raise_no_alarm(place: str) -> None:
    if not (RECORDED / place).exists():
        pytest.skip("the recordings are not here")
    part = ul.open(RECORDED / place).frames()
    assert lines({"radar": part}, 64) == []
