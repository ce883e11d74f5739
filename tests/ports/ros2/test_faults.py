"""A robot whose messages are damaged, late and too many: the run goes on, and what was dropped is reported."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from .network import Network, result_of

pytestmark = pytest.mark.ros2

STEADY, BURST = 200, 3000  # as in harm.py


@pytest.fixture(scope="module")
def run(network: Network) -> tuple[list[dict[str, Any]], int, dict[str, str]]:
    """What came of such a robot: lines of frames and reports, how many it sent, and the last diagnostics."""
    watcher = network.ready("hear.py", "/diagnostics=diagnostic_msgs/msg/DiagnosticArray:stream")
    taker = network.ready("take.py", "ros2:?node=mapper&idle_s=4&patience_s=5")
    harm = network.start("harm.py")
    assert taker.stdout is not None
    lines = []
    for text in taker.stdout:  # a frame from after the burst tells how many of the burst were lost
        lines.append(json.loads(text))
        if (lines[-1].get("at") or [0.0])[0] > 0.001 * (STEADY + BURST):
            break
    sent = result_of(harm, stop=True)
    out, err = taker.communicate(timeout=120)
    assert taker.returncode == 0, err
    lines += [json.loads(line) for line in out.splitlines()]
    status = result_of(watcher, stop=True)["last"]["/diagnostics"]["status"][0]
    return lines, sent, {v["key"]: v["value"] for v in status["values"]}


def test_frames_are_given_or_counted(run: tuple[list[dict[str, Any]], int, dict[str, str]]) -> None:
    lines, sent, _ = run
    given = sum(line.get("n", 0) for line in lines)
    dropped = [line["said"] for line in lines if re.match(r"/radar/front: dropped .* received", line.get("said", ""))]
    assert len(dropped) == 1  # once, at the end
    counts = {
        reason: int(n.replace(",", "")) for n, reason in re.findall(r"([\d,]+) (bad|late|lost|no pose)", dropped[0])
    }
    assert counts["bad"] == 3
    assert counts["late"] == 1
    missing = sent - given - sum(counts.values())
    assert 0 <= missing <= 5  # what the network lost at the very end, after which no number tells of it
    assert given >= 150


def test_no_frame_has_a_frozen_pose(run: tuple[list[dict[str, Any]], int, dict[str, str]]) -> None:
    lines, _, _ = run
    places = [line["at"][0] for line in lines if "n" in line]
    assert min(places) > 0.019
    assert len(set(places)) == len(places)
    said = [line["said"] for line in lines if "said" in line]
    assert any("pose of base_link: dropped 20 bad (position is not finite)" in text for text in said)


def test_diagnostics_hold_the_counts(run: tuple[list[dict[str, Any]], int, dict[str, str]]) -> None:
    _, _, values = run
    assert values["/radar/front: bad"] == "3"
    assert values["pose of base_link: bad"] == "20"
    assert int(values["/radar/front: received"]) > 150
