"""Measure CPU time and memory of the mapping node, in a separate process, while it maps a recording.

Run as `python -m studies.thesis.node RECORDING OPTIONS`, with the options of `radar_mapping` as JSON. One
line of JSON goes to stdout.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ullage.errors import UllageError


@dataclass(frozen=True, slots=True)
class NodeCost:
    """CPU time and memory of the mapping node for one recording."""

    flight_s: float
    frames: int
    start_cpu_s: float  # imports, and the first piece with its compiled kernels
    cpu_s: float  # everything after the first piece
    import_mb: float  # peak resident memory after the imports
    peak_mb: float  # and at the end
    grid_kb: float  # of the map itself

    @property
    def percent(self) -> float:
        """CPU at real time after the start [% of one core]."""
        return 100 * self.cpu_s / self.flight_s


def measure_node(recording: Path, **options: Any) -> NodeCost:
    """Map a recording in a separate process.

    Args:
        recording: file with frames and poses.
        **options: of `radar_mapping`, such as `method` or `step_m`.

    Raises:
        UllageError: the process failed; its last line says why.
    """
    command = [sys.executable, "-m", __name__, str(recording), json.dumps(options)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200)
    if done.returncode:
        raise UllageError(f"the mapping process failed: {done.stderr.strip().splitlines()[-1:] or ['no message']}")
    return NodeCost(**json.loads(done.stdout.splitlines()[-1]))


def peak_mb() -> float:
    """Peak resident memory of this process [MB].

    Linux keeps the parent's peak in `ru_maxrss` of a new process, so /proc is read where it exists.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        line = next(row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
        return int(line.split()[1]) * 1024 / 1e6
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # bytes where there is no /proc


def batches(parts: dict[str, Any], every_s: float) -> Iterator[dict[str, Any]]:
    """Yield the frames of all sensors in pieces of equal duration."""
    import numpy as np

    start = min(int(part.t_ns[0]) for part in parts.values())
    end = max(int(part.t_ns[-1]) for part in parts.values())
    edges = np.arange(start, end + int(every_s * 1e9) + 1, int(every_s * 1e9))
    for low, high in itertools.pairwise(edges):
        inside = {name: slice(*np.searchsorted(part.t_ns, (low, high))) for name, part in parts.items()}
        piece = {name: part[inside[name]] for name, part in parts.items() if inside[name].start < inside[name].stop}
        if piece:
            yield piece


def map_recording(recording: Path, options: dict[str, Any]) -> NodeCost:
    """Run the stages of `radar_mapping` over a recording in this process."""
    from ullage.data import Frames
    from ullage.experiments.ros2_nodes import MappingOptions, mapping_stages
    from ullage.ports.registry import open as open_source

    imported = peak_mb()
    begun = time.process_time()
    found = open_source(recording).frames()
    parts = {"radar": found} if isinstance(found, Frames) else dict(found)
    reading = time.process_time() - begun  # the node receives its frames and reads no file
    settings = MappingOptions.model_validate(options)
    pieces = list(batches(parts, settings.batch_s))
    stages = mapping_stages(pieces[0], settings)
    grid_kb, started = 0.0, 0.0
    for index, piece in enumerate(pieces):
        for stage in stages:
            for item in stage.update(piece):
                grid_kb = getattr(item, "nbytes", 0) / 1e3 or grid_kb
        if index == 0:
            started = time.process_time()
    cpu = time.process_time() - started
    flight = sum(part.t_ns[-1] - part.t_ns[0] for part in parts.values()) / len(parts) / 1e9
    return NodeCost(
        flight_s=float(flight), frames=sum(len(part) for part in parts.values()), start_cpu_s=started - reading,
        cpu_s=cpu, import_mb=imported, peak_mb=peak_mb(), grid_kb=grid_kb,
    )  # fmt: skip


if __name__ == "__main__":
    from dataclasses import asdict

    file, settings = sys.argv[1:]
    print(json.dumps(asdict(map_recording(Path(file), json.loads(settings)))))
