"""Mutants of the experiments: flights that are flown once, and ways to spoil them or the methods.

Each section flies or measures once, then states its results for the sound method and for every mutant. A mutant is
either a patch of the method or changed material. It names the statements that must fall by a part of their text.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ullage.processing.elfes
import ullage.processing.summation
import ullage.radar.models
import ullage.radar.rays
import ullage.radar.receiver
from studies.thesis.maps import sampled_frames
from studies.thesis.workspace import Flown, Workspace
from ullage.data import Frames, Metric
from ullage.fan import ray_fan, reaching_max_range
from ullage.processing.detect import detect
from ullage.processing.metrics import map_quality
from ullage.processing.occupancy import map_occupancy

Patch = pytest.MonkeyPatch
Change = Callable[[Frames], Frames]
Material = Any


RECORDINGS = Path("../shared/data")


def quiet_workspace(folder: Path, *, quick: bool = True) -> Workspace:
    """An experiment's work that prints nothing."""
    return Workspace(folder, quick, lambda _: None, RECORDINGS)


@dataclass
class Fleet:
    """Scenarios by name, each flown at most once."""

    folder: Path
    flown: dict[tuple[str, ...], Flown] = field(default_factory=dict)

    def __call__(self, name: str, *options: str) -> Flown:
        key = (name, *options)
        if key not in self.flown:
            self.flown[key] = quiet_workspace(self.folder).fly(name, ["do=[detect, map]", *options])
        return self.flown[key]


@dataclass(frozen=True)
class Mutant:
    """One error: a patch of the method (`patch`), or other material (`change`), and the statements that fall."""

    name: str
    fells: tuple[str, ...]
    patch: Callable[[Patch], None] = lambda _: None
    change: Callable[[Material], Material] = lambda material: material


@dataclass(frozen=True)
class Section:
    """Statements that are stated together."""

    name: str
    experiment: str
    state: Callable[[Workspace, Material], None]
    mutants: tuple[Mutant, ...]
    material: Callable[[Fleet], Material] = lambda _: None
    quick: bool = True  # the small form of the experiment is stated
    reads: tuple[str, ...] = ()  # recordings


def again(flown: Flown, change: Change = lambda part: part, *, method: Any = None) -> Flown:
    """The same flight with changed frames, or by another method: mapped and scored anew."""
    assert flown.omap is not None
    frames = {name: change(part) for name, part in flown.frames.items()}
    omap = map_occupancy(frames, flown.omap.grid, method=method or flown.simulated.scenario.map.method)
    metrics = map_quality(omap, flown.scene, sampled_frames(flown))
    hits = sum(len(detect(part).frame) for part in frames.values())
    return replace(flown, frames=frames, omap=omap, metrics=metrics | {"detections": Metric("detections", hits)})


def part_of(flown: Flown, piece: slice) -> Flown:
    """Some frames of a flight."""
    return replace(flown, frames={name: part[piece] for name, part in flown.frames.items()})


def longer(metres: float) -> Change:
    """Every range too long."""

    def change(part: Frames) -> Frames:
        count = round(metres / part.spec.bin_m)
        samples = np.roll(part.samples, count, axis=1)
        samples[:, :count] = 0
        return replace(part, samples=samples)

    return change


def emptied(part: Frames) -> Frames:
    """Nothing is received."""
    return replace(part, samples=np.zeros_like(part.samples))


def louder(factor: float) -> Change:
    """As if the threshold were so much lower."""
    return lambda part: replace(part, samples=factor * part.samples)


def accumulate_as(*, cosine: float = 1.0, spread: float = 2.0, coefficient: bool = True) -> Callable[..., None]:
    """Eq. 4.2 with other exponents of its terms."""

    def accumulate(hits, reflection, ranges, out):
        face, distance, cos = hits
        ok = (face >= 0) & (distance >= ranges.near_m) & (distance <= ranges.far_m)
        bins = np.floor((np.where(ok, distance, 0) - ranges.start_m) / ranges.bin_m + 0.5).astype(int)
        ok &= (bins >= 0) & (bins < out.shape[1])
        rows = np.nonzero(ok)[0]
        i_m = reflection[face[ok]] if coefficient else 1.0
        np.add.at(out, (rows, bins[ok]), i_m * cos[ok] ** cosine * (distance[ok] / ranges.far_m) ** spread)

    return accumulate


def term(**changes: Any) -> Callable[[Patch], None]:
    return lambda patch: patch.setattr(ullage.radar.rays, "accumulate", accumulate_as(**changes))


def ranges_too_long(patch: Patch) -> None:
    kept = ullage.radar.models.echoes_thesis

    def later(scene, path, spec, **options):
        return np.roll(kept(scene, path, spec, **options), round(0.25 / spec.bin_m), axis=1)

    patch.setattr(ullage.radar.models, "echoes_thesis", later)


def rays_as(**changes: Any) -> Callable[[Patch], None]:
    """Another fan of rays, not told to the mapper."""
    return lambda patch: patch.setattr(ullage.radar.rays, "ray_fan", lambda spec: ray_fan(spec.but(**changes)))


def lobe(degrees: float) -> Callable[[Patch], None]:
    """Elfes' mapper with another lobe."""

    def spoil(patch: Patch) -> None:
        kept = ullage.processing.elfes.ElfesMapper.__init__
        patch.setattr(ullage.processing.elfes.ElfesMapper, "__init__",
                      lambda self, *a, **k: kept(self, *a, **k | {"lobe_deg": degrees}))  # fmt: skip

    return spoil


def no_average(patch: Patch) -> None:
    for module in (ullage.radar.rays, ullage.radar.receiver):
        patch.setattr(module, "smoothed", lambda rows, spec: rows.copy())


def no_noise(patch: Patch) -> None:
    patch.setattr(ullage.radar.models, "receive_thesis", lambda clean, spec, **_: clean)


def short_axis(patch: Patch) -> None:
    patch.setattr(ullage.radar.models, "reaching_max_range", lambda spec: spec)


def no_max_range(patch: Patch) -> None:
    kept = ullage.radar.rays.accumulate
    patch.setattr(ullage.radar.rays, "accumulate",
                  lambda hits, i_m, ranges, out: kept(hits, i_m, ranges._replace(far_m=11.0), out))  # fmt: skip
    patch.setattr(
        ullage.radar.models,
        "reaching_max_range",
        lambda spec: reaching_max_range(spec.but(thesis=spec.thesis.but(max_range_m=11.0))),
    )


def elfes_as(
    *, cancel: bool = True, normalise: bool = True, flat: bool = False, arc: bool = True
) -> Callable[[Patch], None]:
    """Elfes' update with a density or a step changed."""

    def insert(empty, occupied, cells, reading, lobe, box):
        (x0, y0, step), (x, y, yaw, near, reach, echo), (half, spread) = cells, reading, lobe
        box[:] = 0, empty.shape[0], 0, empty.shape[1]
        dx = x0 + (np.arange(empty.shape[1]) + 0.5)[None] * step - x
        dy = y0 + (np.arange(empty.shape[0]) + 0.5)[:, None] * step - y
        d, angle = np.hypot(dx, dy), np.angle(np.exp(1j * (np.arctan2(dy, dx) - yaw))) / half
        across = np.where(abs(angle) <= 1, 1.0 if flat else 1 - angle**2, 0)
        clear = reach - spread if echo else reach
        part = np.where((d >= near) & (d < clear), 1 - ((d - near) / (clear - near)) ** 2, 0) * across
        empty += part - empty * part
        if echo and arc:
            f_o = np.where(abs(d - reach) <= spread, 1 - ((d - reach) / spread) ** 2, 0) * across
            f_o = f_o * (1 - empty) if cancel else f_o
            f_o = f_o / max(f_o.sum(), 1e-12) if normalise else f_o
            occupied += f_o - occupied * f_o

    return lambda patch: patch.setattr(ullage.processing.elfes, "insert_reading", insert)


def parabola(patch: Patch) -> None:
    def fitted(across, along):
        a, b, c = np.polyfit(across, along, 2)
        return ((-b / (2 * a), c - b * b / (4 * a)), 1.0)

    patch.setattr(ullage.processing.summation, "_hyperbola", fitted)


def far_apex(patch: Patch) -> None:
    kept = ullage.processing.summation._place
    patch.setattr(ullage.processing.summation, "_place", lambda i, t, at: kept(i, t, (at[0], at[1] + 5)))
