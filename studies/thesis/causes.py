"""Find causes of results that differ from the thesis' (7.1 to 7.3) by controlled experiments, one change each."""

from __future__ import annotations

from studies.thesis import cpu_causes, image_causes, map_causes
from studies.thesis.workspace import Workspace


def run(work: Workspace) -> None:
    """Run the experiments on image brightness, wire, flight by hand, east wall, cluttered room and CPU of a reading."""
    image_causes.run(work)
    map_causes.run(work)
    cpu_causes.run(work)
