"""Definitions of the metrics of a run, in groups in the order of a report."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

GROUPS: dict[str, dict[str, str]] = json.loads(
    Path(__file__).with_name("web").joinpath("metric_words.json").read_text(encoding="utf-8")
)
"""Definition of each metric by its group; a name without its last part, as `accuracy` of `accuracy_p90`, counts too."""
OTHER = "Other"
FOUND = "Small objects"
_PARTS = {"median": "Median. ", "mean": "Mean. ", "p90": "90th percentile. ", "x": "Along x. ", "y": "Along y. "}


def meaning(name: str) -> tuple[str, str]:
    """Give the group of a metric and its definition, which is empty for an unknown one."""
    if name.startswith("found:"):
        return FOUND, "1 if an occupied cell lies within 0.15 m of this object, which is smaller than 0.6 m."
    stem, _, part = name.rpartition("_")
    for group, words in GROUPS.items():
        if name in words:
            return group, words[name]
        if part in _PARTS and stem in words:
            return group, _PARTS[part] + words[stem]
    return OTHER, ""


def grouped(names: Iterable[str]) -> dict[str, list[str]]:
    """Sort metrics into groups, both in the order in which they are defined."""
    order = [*GROUPS, FOUND, OTHER]
    ranks = {name: k for k, name in enumerate(name for words in GROUPS.values() for name in words)}

    def rank(name: str) -> tuple[int, int, str]:
        known = name if name in ranks else name.rpartition("_")[0]
        return order.index(meaning(name)[0]), ranks.get(known, len(ranks)), name

    out: dict[str, list[str]] = {}
    for name in sorted(names, key=rank):
        out.setdefault(meaning(name)[0], []).append(name)
    return out
