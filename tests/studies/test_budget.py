"""The on-board budget: the mapping node is measured as a process of its own, and boards scale as published."""

from __future__ import annotations

from pathlib import Path

import pytest

import ullage as ul
from studies.thesis import budget
from studies.thesis.node import NodeCost, measure_node
from ullage.errors import UllageError

COST = NodeCost(flight_s=10.0, frames=680, start_cpu_s=1.0, cpu_s=0.5, import_mb=150.0, peak_mb=200.0, grid_kb=10.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0), 0.5, 10)
    frames = ul.simulate(ul.scenes.plate(1, 1, 2.0), path, ul.RadarSpec.preset("x4m05"), fidelity="thesis")
    file = tmp_path_factory.mktemp("node") / "plate.mcap"
    out = ul.sink(file)
    out.write({"front": frames})
    out.close()
    return file


@pytest.fixture(scope="module")
def coarse(recording: Path) -> NodeCost:
    """The node with cells of 0.1 m, while the process that measures it holds 600 MB."""
    held = bytearray(600_000_000)
    held[::4096] = b"x" * len(held[::4096])
    cost = measure_node(recording, method="elfes", step_m=0.1, reach_m=25.0)
    assert len(held) == 600_000_000
    return cost


def test_the_node_is_measured_in_a_process_of_its_own(coarse: NodeCost) -> None:
    assert coarse.frames == 21
    assert coarse.flight_s == pytest.approx(2.0)
    assert 0 < coarse.cpu_s < coarse.start_cpu_s + 10
    assert 20 < coarse.import_mb <= coarse.peak_mb
    assert coarse.import_mb < 400
    assert coarse.grid_kb > 0


def test_a_node_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(UllageError, match=r"the mapping process failed: .*absent\.mcap"):
        measure_node(tmp_path / "absent.mcap", method="elfes")


def test_boards_scale_with_their_published_scores() -> None:
    slower = budget.loads(COST, budget.BEAGLEBONE, 1.0)
    assert COST.percent == 5.0
    assert slower == pytest.approx((5 * 40_800 / 2497, 5 * 21_400 / 485.4))
    assert budget.loads(COST, budget.BEAGLEBONE, 2.0) == pytest.approx((2 * slower[0], 2 * slower[1]))
    assert max(budget.loads(COST, budget.PI_4, 1.0)) < min(slower)
