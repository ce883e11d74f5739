"""Causes of the results that differ from the thesis' (7.1 to 7.3): controlled experiments, one change at a time."""

from __future__ import annotations

from ullage.thesis import causes_cpu, causes_images, causes_maps
from ullage.thesis.bench import Bench


def run(bench: Bench) -> None:
    """Image brightness, wire, flight by hand, east wall, cluttered room, CPU of a reading."""
    causes_images.run(bench)
    causes_maps.run(bench)
    causes_cpu.run(bench)
