"""All sections."""

from __future__ import annotations

from matrix_bounds import BOUNDS
from matrix_flights import BASELINE, FLIGHTS
from matrix_measured import MEASURED

SECTIONS = (*FLIGHTS, *MEASURED, *BOUNDS)
__all__ = ["BASELINE", "SECTIONS"]
