"""Which error fells which statement about speed, motion, methods and recordings."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from studies.mutants.spoilt import RECORDINGS, Fleet, Material, Mutant, Patch, Section, emptied, longer
from studies.thesis import (
    budget,
    flights,
    images,
    methods,
    rail,
    rest,
    speeds,
    tables,
    volumes,
)
from studies.thesis.flights import Recordings, Scores
from studies.thesis.node import NodeCost
from studies.thesis.workspace import Workspace
from ullage.data import Frames
from ullage.errors import UllageWarning
from ullage.geometry import C0
from ullage.ports import open as open_source
from ullage.processing.calibrate import calibrate
from ullage.processing.metrics import map_quality
from ullage.processing.occupancy import Mapper, map_occupancy
from ullage.radar.receiver import receive, unit
from ullage.specs import RadarSpec

# --- speed, CPU and memory: what was measured, made worse

Spents = dict[str, tables.Spent]


def spent(_: Fleet) -> Spents:
    """CPU of each stage for ten seconds, as on the page."""
    printed = {"6.1": (0.5, 0.0, 0.6, 0.1), "6.2": (1.0, 0.0, 0.5, 0.3), "6.3": (1.2, 0.0, 0.6, 0.4),
               "6.4": (0.8, 0.0, 0.3, 0.7)}  # fmt: skip
    stages = ("simulation", "amplitudes", "image", "map")
    return {table: tables.Spent(10.0, {s: percent / 10 for s, percent in zip(stages, row, strict=True)})
            for table, row in printed.items()}  # fmt: skip


def slower(times: float) -> Callable[[Spents], Spents]:
    return lambda all_: {table: replace(one, cpu_s={s: times * t for s, t in one.cpu_s.items()})
                         for table, one in all_.items()}  # fmt: skip


def state_tables(work: Workspace, all_: Spents) -> None:
    for table, one in all_.items():
        tables.state(work, table, one)


TABLES = Section("tables 6.1 to 6.4", "tables", state_tables, (
    Mutant("every stage takes a thousand times as long", (
        "the thesis' methods run faster than the thesis' 1 times", "faster than the thesis' 0.5 times",
        "faster than the thesis' 0.4 times", "Elfes' map takes less CPU",
    ), change=slower(1000)),
), spent)  # fmt: skip

Costs = dict[str, NodeCost]


def node_costs(_: Fleet) -> Costs:
    """Rows of the page: CPU of 12 s, peak memory."""
    percent = {"Elfes": (2.0, 220), "ullage": (38.0, 249), "ullage, 1 Hz": (23.0, 248)}
    return {f"NTNU room, {name}": NodeCost(12.0, 816, 0.9, 0.12 * cpu, 161, peak, 15)
            for name, (cpu, peak) in percent.items()}  # fmt: skip


def every(**times: float) -> Callable[[Costs], Costs]:
    return lambda costs: {name: replace(cost, **{key: factor * getattr(cost, key) for key, factor in times.items()})
                          for name, cost in costs.items()}  # fmt: skip


BUDGET = Section("the node on board", "budget", lambda work, costs: budget.state(work, costs, 1.0), (
    Mutant("ullage's mapper at a tenth of its cost", ("needs more than one BeagleBone core",), change=every(cpu_s=0.1)),
    Mutant("three times the CPU", ("fits one BeagleBone core", "fits one core of the reference machine"),
           change=every(cpu_s=3)),
    Mutant("three times the memory", ("the node's peak memory",), change=every(peak_mb=3)),
), node_costs, quick=False)  # fmt: skip


# --- Doppler, speed and frame rate


SPEC = RadarSpec.preset("x4m05")
Series = dict[str, Any]
PARTS: dict[str, Callable[[], Any]] = {
    "loss": lambda: speeds.towards_plate(SPEC, speeds.RADIAL[True]),
    "found": lambda: speeds.towards_wire(SPEC, speeds.RADIAL[True]),
    "image": lambda: speeds.past_wire(SPEC, (0.175, 1.0, 2.0))[0],
    "scores": lambda: speeds.round_room(SPEC, (0.5, 4.0), seed=1, share=1 / 3),
}


def measured(names: tuple[str, ...] = tuple(PARTS), spoil: Callable[[Patch], None] = lambda _: None) -> Series:
    """Series against speed, from three speeds towards a target and a third of the round."""
    with pytest.MonkeyPatch.context() as patch:
        spoil(patch)
        return {name: PARTS[name]() for name in names}


def at_an_instant(patch: Patch) -> None:
    kept = speeds.fly_at
    patch.setattr(speeds, "fly_at", lambda *a, **k: kept(*a, **k, integrate=False))


def one_speed(patch: Patch) -> None:
    kept = speeds.fly_at
    patch.setattr(speeds, "fly_at", lambda *a, speed_m_s, **k: kept(*a, speed_m_s=0.5, **k))


def flown_longer(patch: Patch) -> None:
    kept = speeds.fly_at
    patch.setattr(speeds, "fly_at", lambda *a, **k: {n: longer(0.25)(f) for n, f in kept(*a, **k).items()})


SPEEDS = Section("speed", "speeds", lambda work, series: speeds.state(work, SPEC, **series), (
    Mutant("frames of one instant", ("loss within a frame less the law", "at the blind speed"),
           change=lambda series: series | measured(("loss", "found"), at_an_instant)),
    Mutant("ranges 0.25 m too long", ("frames that detect it at 0.05 m/s",),
           change=lambda series: series | measured(("found",), flown_longer)),
    Mutant("the speed is ignored", ("ambiguous energy", "map by ullage", "map by elfes"),
           change=lambda series: series | measured(("image", "scores"), one_speed)),
), lambda _: measured())  # fmt: skip


# --- every way of mapping: half a flight, and a short hover

SEED = 0
Spoil = Callable[[Recordings], Recordings]
Mapped = tuple[Scores, list[dict[str, float]]]
ROWS = (methods.RAYS, methods.BARE, methods.EXACT, methods.FINE, *methods.WHITE.values(), methods.BARE_WHITE)


def each(change: Callable[[Frames], Frames]) -> Spoil:
    return lambda frames: {name: change(part) for name, part in frames.items()}


def scores_of(rows: tuple[str, ...] = ROWS, spoil: Spoil = lambda frames: frames, *, share: float = 0.5) -> Scores:
    """Part of a flight, mapped by some rows of the table from spoilt frames."""
    scene, kept = flights.judged_room(), (flights.received, flights.level_round)
    grid, scores = flights.plane_of(scene), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flights, "received", lambda *a, **k: spoil(kept[0](*a, **k)))
        patch.setattr(
            flights, "level_round", lambda seed, **k: kept[1](seed, **k)[: int(share * len(kept[1](seed, **k)))]
        )
        for name, frames, options in methods.cases(SEED, scene, grid):
            if name in rows:
                omap = methods.mapped(scene, grid, frames, options)
                scores[name] = [flights.values_of(map_quality(omap, scene, frames), tuple(methods.COLUMNS))]
    return scores


def drift_scores(spoil: Spoil = lambda frames: frames) -> Scores:
    """The row with a slow error of the poses, which is found only where the flight comes back."""
    return scores_of((methods.DRIFT_KNOWN,), spoil, share=1.0)


def white_scores(spoil: Spoil = lambda frames: frames) -> Scores:
    """The rows with 10 mm of error: what phase adds to amplitudes is less than a cell or two of half a flight."""
    return scores_of((methods.WHITE[0.01], methods.BARE_WHITE), spoil, share=1.0)


def hover_of(method: str = "likelihood") -> list[dict[str, float]]:
    """Eight seconds of flight, then four of hovering: after six, hovering completes the wall flown past last."""
    scene = flights.judged_room()
    grid = flights.plane_of(scene)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flights, "HOVER_S", 4.0)
        patch.setattr(methods, "Mapper", lambda grid, **_: Mapper(grid, method=method))
        frames = flights.received(scene, flights.level_round(SEED)[-200:], SEED)
        return [methods.hovered(scene, grid, frames, SEED)]


def state_methods(work: Workspace, mapped: Mapped) -> None:
    methods.state(work, mapped[0])
    methods.state_targets(work, *mapped)


def wrong_sign(part: Frames) -> Frames:
    return replace(part, samples=part.samples.conj())


METHODS = Section("ways of mapping", "methods", state_methods, (
    Mutant("ranges 0.25 m too long", (
        "ullage's F1 over Elfes'", "exact poses: surface free", "F1: ullage, exact poses", "F1: ullage, amplitude only",
        "F1: ullage, 3 mm", "F1: ullage, 10 mm", "error median: ullage, exact", "error p90: ullage, exact",
        "error median: ullage, amplitude", "error p90: ullage, amplitude",
    ), change=lambda mapped: (mapped[0] | scores_of(spoil=each(longer(0.25))), mapped[1])),
    Mutant("a whole flight, ranges 0.25 m too long", ("F1: ullage, the same, drift",),
           change=lambda mapped: (mapped[0] | drift_scores(each(longer(0.25))), mapped[1])),
    Mutant("nothing is received", ("exact poses: known behind",),
           change=lambda mapped: (mapped[0] | scores_of((methods.EXACT,), each(emptied)), mapped[1])),
    Mutant("the phase has the wrong sign", ("F1 with 10 mm of error over",),
           change=lambda mapped: (mapped[0] | scores_of((methods.WHITE[0.01],), each(wrong_sign)), mapped[1])),
    Mutant("Elfes' grid in place of ullage's mapper", ("hover: largest change of F1", "hover: most new false cells"),
           change=lambda mapped: (mapped[0], hover_of("elfes"))),
), lambda _: (scores_of() | drift_scores() | white_scores(), hover_of()))  # fmt: skip


# --- maps in three dimensions: a third of one flight


def one_volume(spoil: Spoil = lambda frames: frames) -> Scores:
    scene = flights.judged_room()
    grid = flights.volume_of(scene)
    scores: Scores = {}
    frames = spoil(flights.received(scene, flights.rising_round(SEED)[:220], SEED))
    for name, recording in volumes.cases(SEED, frames):
        found = map_quality(map_occupancy(recording, grid, method="likelihood"), scene, frames)
        scores[name] = [flights.values_of(found, tuple(volumes.COLUMNS))]
    frames = spoil(flights.received(scene, flights.level_round(SEED)[:220], SEED))
    omap = map_occupancy(frames, grid, method="likelihood")
    row = flights.values_of(map_quality(omap, scene, frames), tuple(volumes.COLUMNS))
    scores[volumes.LEVEL] = [row | volumes.flagged(omap, scene, frames)]
    return scores


VOLUMES = Section("volumes", "volumes", volumes.state, (
    Mutant("ranges 0.25 m too long", ("F1: exact poses", "which a level flight marks"),
           change=lambda _: one_volume(each(longer(0.25)))),
), lambda _: one_volume())  # fmt: skip


# --- images of three poles: one flight


def one_image(_: Material = None) -> Scores:
    scores, sharp = {}, None
    for name, frames, image in images.cases(SEED):
        sharp = sharp or image
        scores[name] = [images.scored(frames, image, sharp)]
    return scores


def received_longer(patch: Patch) -> None:
    kept = images.simulate
    patch.setattr(images, "simulate", lambda *a, **k: longer(0.1)(kept(*a, **k)))


def no_autofocus(patch: Patch) -> None:
    patch.setattr(images, "autofocus", lambda frames, *_, **__: frames)


def no_smoothing(patch: Patch) -> None:
    patch.setattr(images, "_smoothed", lambda frames: frames)


def only_summed(patch: Patch) -> None:
    kept = images.focus
    patch.setattr(images, "focus", lambda frames, grid, **_: kept(frames, grid, method="summation"))


IMAGES = Section("images of poles", "images", lambda work, _: images.state(work, one_image()), (
    Mutant("ranges 0.1 m too long", (
        "nearest pole: back-projection, exact", "nearest pole: back-projection, 3 mm",
        "nearest pole: the same, autofocus", "nearest pole: the same, smoothed over",
        "nearest pole: the same, smoothed, then",
    ), received_longer),
    Mutant("summation for every image", ("width of a pole across",), only_summed),
    Mutant("autofocus does nothing", ("that autofocus removes",), no_autofocus),
    Mutant("poses are not smoothed", ("smoothed poses and autofocus leave",), no_smoothing),
))  # fmt: skip

# --- recordings beside simulations

Rail = tuple[Frames, Frames, np.ndarray]


def real_rail(_: Fleet) -> Rail:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UllageWarning)
        source = open_source(RECORDINGS / "pulson440" / "rail_a")
        real = calibrate(source.frames())[::2]
    place = source.reflectors()[0]
    return real, rail.simulated(real, place), place


def narrow_band(part: Frames) -> Frames:
    """A fifth of the band, by a running mean of the envelope's carrier: every fifth of a pulse is smeared."""
    kernel = np.hanning(41)[1:-1]
    smeared = [np.convolve(abs(row), kernel / kernel.sum(), "same") for row in part.samples]
    tone = np.cos(4 * np.pi * part.spec.center_hz / C0 * part.range_m)
    return replace(part, samples=(np.array(smeared) * tone).astype(np.float32))


def faded(part: Frames) -> Frames:
    """A gain that falls by 40 dB from one end of the track to the other."""
    gain = np.logspace(0, -2, len(part))[:, None]
    return replace(part, samples=(part.samples * gain).astype(part.samples.dtype))


def noisy(part: Frames) -> Frames:
    level = 0.3 * abs(part.samples).max()
    noise = np.random.default_rng(0).normal(0, level, part.samples.shape)
    return replace(part, samples=(part.samples + noise).astype(part.samples.dtype))


def middle_fifth(part: Frames) -> Frames:
    """Frames outside the middle fifth of the track are lost."""
    there = abs(np.arange(len(part)) / len(part) - 0.5)[:, None] < 0.1
    return replace(part, samples=np.where(there, part.samples, 0).astype(part.samples.dtype))


RAIL = Section("a real rail", "rail", lambda work, material: rail.compare(work, *material), (
    Mutant("the reflector is sought 1 m to the side", ("waveform of the reflector's echo", "frame by frame"),
           change=lambda m: (m[0], m[1], m[2] + [0.7, 0.7, 0.0])),
    Mutant("ranges 0.2 m too long", ("the recorded echo lies beyond",),
           change=lambda m: (longer(0.2)(m[0]), m[1], m[2])),
    Mutant("a gain that falls along the track", ("peak amplitudes along the track",),
           change=lambda m: (faded(m[0]), m[1], m[2])),
    Mutant("a fifth of the band", ("width of the point response in range",),
           change=lambda m: (narrow_band(m[0]), m[1], m[2])),
    Mutant("the middle fifth of the track", ("width of the point response across",),
           change=lambda m: (middle_fifth(m[0]), m[1], m[2])),
    Mutant("the simulation in place of the recording", ("recorded clutter",), change=lambda m: (m[1], m[1], m[2])),
    Mutant("noise in the simulation", ("simulated clutter",), change=lambda m: (m[0], noisy(m[1]), m[2])),
), real_rail, reads=rail.READS)  # fmt: skip

Still = tuple[np.ndarray, np.ndarray, RadarSpec]


def at_rest(_: Fleet) -> Still:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UllageWarning)
        still = open_source(RECORDINGS / rest.READS[0]).frames()[rest.STILL][::4]
    spec = RadarSpec.preset("x4m05", iterations=4, pulses_per_step=1, bins=still.samples.shape[1])
    ours = receive(np.zeros(still.samples.shape, np.complex64), spec, seed=1).astype(np.complex128) * unit(spec)
    return still.samples.astype(np.complex128), ours, spec


def state_rest(work: Workspace, still: Still) -> None:
    rest.state(work, [rest.measure(rows, still[2]) for rows in still[:2]])


def simulated_as(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Still], Still]:
    return lambda still: (still[0], change(still[1]), still[2])


def white(rows: np.ndarray) -> np.ndarray:
    """The same mean and power, but noise that differs from bin to bin."""
    rng, mean = np.random.default_rng(0), rows.mean(0)
    parts = rng.normal(0, np.sqrt(0.5) * (rows - mean).std(), (2, *rows.shape))
    return np.asarray(mean + parts[0] + 1j * parts[1])


def shaken(rows: np.ndarray) -> np.ndarray:
    return rows * np.exp(1j * np.random.default_rng(0).normal(0, 0.05, (len(rows), 1)))


REST = Section("an X4 at rest", "rest", state_rest, (
    Mutant("everything half as strong again", ("noise: simulated over recorded",),
           change=simulated_as(lambda rows: 1.5 * rows)),
    Mutant("no direct path", ("direct path over noise",), change=simulated_as(lambda rows: rows - rows.mean(0))),
    Mutant("white noise", ("lag 1", "lag 2", "spectrum at the band's edges"), change=simulated_as(white)),
    Mutant("50 mrad of common phase", ("phase common to a frame",), change=simulated_as(shaken)),
), at_rest, reads=rest.READS)  # fmt: skip

MEASURED = (TABLES, BUDGET, SPEEDS, METHODS, VOLUMES, IMAGES, RAIL, REST)
