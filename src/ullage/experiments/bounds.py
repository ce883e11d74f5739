"""Compare a run's metrics with the bounds that its scenario sets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ullage.config import Bound, read_scenario
from ullage.experiments.folder import read_json


@dataclass(frozen=True, slots=True)
class Verdict:
    """Metric with its bound."""

    name: str
    value: float | None
    bound: Bound

    @property
    def inside(self) -> bool:
        """Whether the metric is known and within its bound."""
        if self.value is None:
            return False
        low, high = self.bound.min, self.bound.max
        return (low is None or self.value >= low) and (high is None or self.value <= high)

    @property
    def text(self) -> str:
        """Metric, value and bound in one line."""
        low, high = self.bound.min, self.bound.max
        limits = " and ".join(
            s for s in ("" if low is None else f">= {low:g}", "" if high is None else f"<= {high:g}") if s
        )
        value = "unknown" if self.value is None else f"{self.value:.4g}"
        return f"{self.name} {value}, wanted {limits or 'known'}"


def verdicts(folder: Path) -> list[Verdict]:
    """Compare every bound of the run's scenario with its metric.

    Raises:
        InputError: the run lacks its scenario or metrics.
    """
    expect = read_scenario(folder / "scenario.yaml").expect
    metrics = read_json(folder / "metrics.json")
    return [Verdict(name, (metrics.get(name) or {}).get("value"), bound) for name, bound in expect.items()]
