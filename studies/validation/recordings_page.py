"""Write the page that compares recordings with simulations, and check its bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from studies.validation.recordings import BANDS, GAP_M, LOBES_M, Comparison, compare, compare_ring_downs, recordings
from studies.validation.recordings_figure import draw_recorded
from studies.validation.rows import Row
from ullage.files import write_whole
from ullage.pipeline import LOGGER

SHARES = {
    "instrument": "stays constant while the radar moves: direct path, ring-down and constant echoes of the place",
    "changes": "changes while the radar rests",
    "floor": "excess of power at the range of the floor over neighbouring ranges",
    "reflectors": "excess of power at the ranges of the surveyed reflectors, likewise",
}
OWN_ECHO_DB = 4.0  # accepted difference of the level where the fitted receiver's own echo makes most of it
UNIT_GAIN_DB = 6.0  # to which a simulated level is known: a part of a place may not be louder than all of it
LEVELS = ("recorded", "world", "tails", "isotropic", "receiver")


def write_recordings_page(
    folder: str | Path, out_dir: str | Path, *, report: Callable[[str], None] = LOGGER.info
) -> list[Row]:
    """Compare every recording with a simulation of it; write `validation_recordings.md` and its pictures.

    Args:
        folder: contains `pulson440` and `x4`; absent recordings are skipped.
        out_dir: folder of the page.
        report: called with the name of each recording.

    Returns:
        The bounded quantities: recorded as the reference, simulated as ours.
    """
    found, out = [], Path(out_dir)
    for case in recordings(Path(folder)):
        report(f"simulating {case.what}")
        one = compare(case)
        found.append(one)
        (out / "pictures" / "validation").mkdir(parents=True, exist_ok=True)
        place = case.reflectors[0] if len(case.reflectors) else None
        draw_recorded(out / "pictures" / "validation" / f"{case.name}.png", one.range_m, one.profiles_db,
                      title=case.what, images=one.images, place=place)  # fmt: skip
    if not found:
        return []
    rows = [row for one in found for row in bounded(one)]
    for sentence in (text for one in found for text in unexplained(one)):
        report(sentence)
    page = _page(found, rows)
    out.mkdir(parents=True, exist_ok=True)
    write_whole(out / "validation_recordings.md", lambda file: file.write(page.encode()))
    return rows


def bounded(one: Comparison) -> Iterator[Row]:
    """Compare quantities of a simulation and its recording that must agree."""
    name, misfit = one.case.what, one.receiver.misfit
    yield Row(f"{name}: noise", 0.0, float(misfit["noise"].value), 0.5)
    yield Row(
        f"{name}: noise of neighbouring bins, correlation", 0.0, float(misfit["correlation_lag_1"].value), 0.05, ""
    )
    if one.points is not None:
        for low, high, recorded, simulated in levels(one):
            what = f"{name}: level from {low:g} to {high:g} m"
            if (low, high) == BANDS[0]:
                yield Row(what, recorded, simulated, OWN_ECHO_DB)
            else:
                yield Row(f"{what}, simulated above recorded", 0.0, max(simulated - recorded, 0.0), UNIT_GAIN_DB)
        real, ours = one.points
        yield Row(f"{name}: focused reflector to its survey", 0.0, real["error"], 0.15, "m")
        yield Row(f"{name}: simulated reflector to its survey", 0.0, ours["error"], 0.02, "m")
        for axis in "xy":
            key = f"width_{axis}_6db"
            yield Row(f"{name}: -6 dB width along {axis}", real[key], ours[key], 0.1, "m")


def levels(one: Comparison) -> Iterator[tuple[float, float, float, float]]:
    """Give the bands of range [m] that a recording has, with the recorded and the simulated level [dB]."""
    for low, high in BANDS:
        recorded, simulated = (one.level_db(which, low, high) for which in ("recorded", "receiver"))
        if np.isfinite(recorded):
            yield low, high, recorded, simulated


def unexplained(one: Comparison) -> Iterator[str]:
    """Say how many dB of a recorded level the simulation lacks, for each band without a bound on the difference."""
    for low, high, recorded, simulated in levels(one):
        if one.points is None or (low, high) != BANDS[0]:
            yield (f"{one.case.what}: {recorded - max(simulated, 0.0):.1f} dB of {recorded:.1f} dB from {low:g} to "
                   f"{high:g} m are not explained")  # fmt: skip


def _page(found: list[Comparison], rows: list[Row]) -> str:
    lines = [
        "# Simulations and recordings compared", "",
        "Made by `ullage validate --recordings DIR`. It flies the path of each recording in a world built from the",
        "known facts about the place, and measures both in the same way. `ul.Receiver.fit` fits the receiver to the",
        "recording.", "",
        "Levels are mean powers at baseband, in dB over the noise of one frame. A simulated level depends on",
        "`noise.unit_gain`, which is known to [about 6 dB](receiver.md#from-path-gain-to-the-sensors-units).", "",
        "| recording | known facts about the place |", "|---|---|",
        *(f"| {one.case.what} | {one.case.known} |" for one in found), "",
        "## Level over range", "",
        "| recording | range | recorded | known world | with the fitted receiver | not explained | bound |",
        "|---|---|---|---|---|---|---|",
        *(line for one in found for line in _bands(one)), "",
        f"From {BANDS[0][0]:g} to {BANDS[0][1]:g} m over surveyed reflectors the fitted receiver's own echo makes most",
        f"of the power, and levels agree within {OWN_ECHO_DB:g} dB. Farther away reflectors and a floor are known.",
        f"Such a part may not be louder than the place, but for the {UNIT_GAIN_DB:g} dB of `noise.unit_gain`. Nothing",
        "is known of the other places, so their levels have no bound.", "",
        "## Side lobes", "",
        f"Strongest amplitude {LOBES_M[0]:g} to {LOBES_M[1]:g} m from the first reflector in its image, over its peak",
        "[dB]. With tails each simulated echo is followed by the tail of the instrument's direct path.", "",
        "| recording | recorded | simulated | with tails |", "|---|---|---|---|",
        *(_lobes(one) for one in found if one.lobes_db), "",
        f"## From {GAP_M[0]:g} to {GAP_M[1]:g} m", "",
        *_causes(found), "",
        "## Bounds", "",
        "The recording is the reference. Noise and correlation are simulated minus recorded.", "",
        "| quantity | recorded | simulated | bound | holds |", "|---|---|---|---|---|",
        *(_bound(row) for row in rows),
    ]  # fmt: skip
    for one in found:
        lines += ["", f"![{one.case.what}](pictures/validation/{one.case.name}.png)", "",
                  f"{one.case.what}: {one.case.known}"]  # fmt: skip
    return "\n".join(lines) + "\n"


def _bands(one: Comparison) -> Iterator[str]:
    for low, high, recorded, simulated in levels(one):
        near = f"within {OWN_ECHO_DB:g} dB" if (low, high) == BANDS[0] else f"at most {UNIT_GAIN_DB:g} dB louder"
        cells = (one.case.what, f"{low:g} to {high:g} m", f"{recorded:.1f}", _db(one.level_db("world", low, high)),
                 _db(simulated), f"{recorded - max(simulated, 0.0):.1f}",
                 "none" if one.points is None else near)  # fmt: skip
        yield f"| {' | '.join(cells)} |"


def _lobes(one: Comparison) -> str:
    values = " | ".join(f"{value:.1f}" for value in (one.lobes_db or {}).values())
    return f"| {one.case.what} | {values} |"


def _db(level: float) -> str:
    return "none" if level < -30 else f"{level:.1f}"


def _causes(found: list[Comparison]) -> list[str]:
    """Format levels of the simulation with one cause added at a time, and shares of the recorded power."""
    lines = [
        "Columns two to six are levels [dB]. `tails` gives every simulated echo the tail that the direct path of the",
        "instrument has. `isotropic` gives the antenna the same gain in all directions, behind it too. Both are upper",
        "bounds. Shares are of the recorded power. A dash means that this recording cannot separate the cause.", "",
        "| recording | recorded | known world | tails | isotropic | fitted receiver | "
        + " | ".join(SHARES) + " | coherent scatterers behind the antenna |",
        "|---" * (7 + len(SHARES)) + "|",
    ]  # fmt: skip
    for one in found:
        levels = [one.level_db(name, *GAP_M) for name in LEVELS]
        if not np.isfinite(levels[0]):
            continue
        shares = [_share(one.shares.get(name)) for name in SHARES]
        cells = [
            one.case.what,
            *(_db(level) for level in levels),
            *shares,
            "-" if one.behind is None else "{} of {}".format(*one.behind),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", *(f"- `{name}`: {meaning}." for name, meaning in SHARES.items())]
    for pair in compare_ring_downs(found):
        lines.append(
            f"- The constant responses in `{pair.names[0]}` and `{pair.names[1]}` have a coherence of "
            f"{pair.coherence:.2f} from {pair.band_m[0]:.1f} to {pair.band_m[1]:.1f} m. They share the ring-down, not "
            "the echoes of the place."
        )
    return lines


def _share(value: float | None) -> str:
    return "-" if value is None else "under 1 %" if value < 0.01 else f"{100 * value:.0f} %"


def _bound(row: Row) -> str:
    numbers = " | ".join(f"{value:.3g} {row.unit}".strip() for value in (row.reference, row.ours, row.bound))
    return f"| {row.oracle} | {numbers} | {'yes' if row.passed else '**no**'} |"
