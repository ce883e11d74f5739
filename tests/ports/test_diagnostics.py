"""CPU and memory of this process, as `/diagnostics` gives them."""

from __future__ import annotations

import subprocess
import sys

from ullage.ports.diagnostics import RadarStatus, Status
from ullage.ports.intake import Counters
from ullage.ports.schema import DIAGNOSTICS, typestore


def values_of(passed):
    told = typestore().deserialize_cdr(passed.data, DIAGNOSTICS).status[0].values
    return {pair.key: pair.value for pair in told}


def test_cpu_is_the_share_of_the_time_since_the_last_report():
    wall, spent = iter((0.0, 2.0, 3.0)), iter((10.0, 11.0, 13.0))
    status = Status("run", now=lambda: next(wall), cpu=lambda: next(spent))
    for percent in ("50", "200"):  # of two cores
        assert status.is_due()
        assert values_of(status.told(0, 0, "", []))["CPU [% of a core]"] == percent


GROWTH = """import numpy as np
from ullage.ports.diagnostics import resident_bytes
before = resident_bytes()
held = np.ones(50_000_000, np.uint8)
print(resident_bytes() - before)"""


def test_memory_grows_by_what_is_allocated():
    """In a process of its own: one that has run other tests may give memory back meanwhile."""
    said = subprocess.run([sys.executable, "-c", GROWTH], check=True, capture_output=True, text=True)
    assert 40e6 < float(said.stdout) < 90e6


def test_the_status_of_simulated_radars_tells_both():
    passed = RadarStatus("radars", late_s=1.0).message(0, Counters())
    assert passed is not None
    found = {key: float(value) for key, value in values_of(passed).items() if key.startswith(("CPU", "memory"))}
    assert set(found) == {"CPU [% of a core]", "memory [MB]"}
    assert found["memory [MB]"] > 20
