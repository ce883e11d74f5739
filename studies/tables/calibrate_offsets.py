"""Plant clock and range offsets in simulated recordings, and count how often `ul.calibrate` finds them.

    python -m studies.tables.calibrate_offsets --count 100 [--first 0] [--kinds flight,...] [--mismatched] [--log FILE]

The scenes are cheap on purpose: point scatterers in a wide beam, diffuse clutter, and a direct path with ring-down.
Noise, phase jitter from frame to frame, and 0.3 mm of noise in the motion capture are added. Levels resemble those of
the PulsON 440 recordings: noise lies 24 to 33 dB under the clutter. Paths are rails, flights with take-off, hover and
landing, lawnmower surveys, arcs and random walks. Track and recording may overlap in part. With --mismatched the track
belongs to another flight, and only a refusal is right.
"""

from __future__ import annotations

import argparse
import csv
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.errors import CalibrationError
from ullage.geometry import C0, rpy_quat

KINDS = ("rail", "flight", "survey", "arc", "wander")
STRENGTHS = ("several", "one", "none")
BINS, STEP_M, CENTER_HZ, BAND_HZ = 200, 0.055, 3.95e9, 1.7e9
RIGHT_S, RIGHT_M = 0.05, 0.05
UNITS = {"clock": "ms", "range": "mm"}


def speed_profile(rng: np.random.Generator, t: np.ndarray, begin: float, end: float, speed: float) -> np.ndarray:
    """Speed over time [m/s]: rest, a ramp, uneven cruise with a chance of a hover, a ramp, rest."""
    ramp = rng.uniform(0.3, 1.2)
    v = np.clip((t - begin) / ramp, 0, 1) * np.clip((end - t) / ramp, 0, 1)
    wobble = sum(
        rng.uniform(0, 0.15) * np.sin(2 * np.pi * rng.uniform(0.1, 0.5) * t + rng.uniform(0, 6)) for _ in range(3)
    )
    v = v * speed * (1 + wobble)
    if rng.random() < 0.5:
        halt = rng.uniform(begin + 1.5, max(end - 2.5, begin + 2))
        v = v * (1 - np.exp(-(((t - halt) / 0.7) ** 4)))
    return np.maximum(v, 0)


def path_of(rng: np.random.Generator, kind: str, duration: float) -> ul.Trajectory:
    """A track [m] at 200 Hz."""
    t = np.arange(0, duration, 0.005)
    begin, end = rng.uniform(3, 0.3 * duration), rng.uniform(0.7 * duration, duration - 3)
    s = (
        np.cumsum(
            speed_profile(rng, t, begin, end, rng.uniform(0.3, 1.0) if kind != "rail" else rng.uniform(0.25, 0.8))
        )
        * 0.005
    )
    moving = np.clip((t - begin) / 0.8, 0, 1) * np.clip((end - t) / 0.8, 0, 1)
    drift = np.stack(
        [
            sum(rng.uniform(0, 0.05) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.15, 0.35, 0.8))
            for _ in range(3)
        ],
        1,
    )
    x, y, z = 0 * s, s, 0 * s + 1.5
    if kind == "survey":
        fold = s % 4.0
        y, x = np.where(fold < 2, fold, 4 - fold), 0.15 * s
    elif kind == "arc":
        radius = rng.uniform(1.5, 4)
        x, y = radius * (np.cos(s / radius) - 1), radius * np.sin(s / radius)
    elif kind == "wander":
        turn = (
            np.cumsum(
                sum(rng.uniform(-0.5, 0.5) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.03, 0.08, 0.2))
            )
            * 0.005
        )
        x, y = np.cumsum(np.gradient(s) * np.sin(turn)), np.cumsum(np.gradient(s) * np.cos(turn))
    place = np.stack([x, y, z], 1)
    if kind == "rail":
        place = place + 0.002 * drift / 0.05
    else:
        place = place + moving[:, None] * drift * [1, 1, 2] + np.stack([0 * t, 0 * t, 0.5 * moving], 1)
    yaw = 0.1 * np.sin(0.4 * t) * (kind != "rail")
    quat = rpy_quat(0.02 * np.sin(t) * moving, 0.03 * np.sin(0.7 * t) * moving, yaw)
    return ul.Trajectory(np.rint(t * 1e9).astype(np.int64), place, quat)


def scatterers(rng: np.random.Generator, path: ul.Trajectory, strength: str) -> tuple[np.ndarray, np.ndarray]:
    """Places (k, 3) [m] and complex amplitudes (k) of clutter and of strong reflectors, ahead of the radar."""
    low, high = path.position.min(0), path.position.max(0)
    count = 350
    clutter = np.stack(
        [
            rng.uniform(high[0] + 0.8, high[0] + 8, count),
            rng.uniform(low[1] - 4, high[1] + 4, count),
            rng.uniform(0, 3, count),
        ],
        1,
    )
    level = rng.normal(size=count) + 1j * rng.normal(size=count)
    number = {"several": 4, "one": 1, "none": 0}[strength]
    strong = np.stack(
        [
            rng.uniform(high[0] + 1.5, high[0] + 5, number),
            rng.uniform(low[1], high[1] + 0.5, number),
            rng.uniform(0, 2, number),
        ],
        1,
    )
    loud = rng.uniform(8, 20, number) * np.exp(2j * np.pi * rng.random(number))
    return np.concatenate([clutter, strong]), np.concatenate([level, loud])


def recording(seed: int, kind: str, strength: str) -> tuple[ul.Frames, float, float]:
    """Frames with a track, and what calibration must find: clock [s] and range offset [m]."""
    rng = np.random.default_rng([seed, 440])
    whole = path_of(rng, kind, rng.uniform(20, 30))  # of which motion capture misses up to 3 s at both ends
    edge = (rng.uniform(0, 3), whole.duration_s - rng.uniform(0, 3))
    inside = (whole.t_ns >= edge[0] * 1e9) & (whole.t_ns <= edge[1] * 1e9)
    track = ul.Trajectory(whole.t_ns[inside], whole.position[inside], whole.quat_xyzw[inside])
    length = rng.uniform(9, 16)
    start = rng.uniform(0, whole.duration_s - length - 0.1)
    when = start + np.arange(round(length / 0.0215)) * 0.0215 * (1 + 50e-6)
    held = whole.at(np.rint(when * 1e9).astype(np.int64))
    zero = rng.normal(0.45, 0.02)
    echoes = _received(rng, held, *scatterers(rng, track, strength))
    profile = echoes + _ringing(rng)[None] * (1 + 0.002 * rng.normal(size=(len(when), 1)))
    sigma = np.sqrt(np.mean(np.abs(echoes) ** 2)) * 10 ** (-rng.uniform(24, 33) / 20)
    profile = profile + sigma * (rng.normal(size=profile.shape) + 1j * rng.normal(size=profile.shape)) / np.sqrt(2)
    profile = profile * np.exp(1j * rng.normal(0, 0.002, (len(when), 1)))
    noisy = track.position + rng.normal(0, 3e-4, track.position.shape)
    clock = np.rint((when - when[0]) * 1e3).astype(np.int64) * 1_000_000  # milliseconds, as the radar counts
    base = rng.uniform(-15, 15)
    shifted = ul.Trajectory(track.t_ns + round((base - start) * 1e9), noisy, track.quat_xyzw)
    spec = ul.RadarSpec.preset("pulson440", output="baseband", decimation=6, bins=BINS, noise=None)
    frames = ul.Frames(
        1e4 * profile, 0.6 + STEP_M * np.arange(BINS) + zero, clock, spec, track=shifted, unit="normalised"
    )
    return frames, base, -zero


def _received(rng: np.random.Generator, path: ul.Trajectory, places: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Echoes (n, bins) with spreading loss and a cosine beam along +x, made in the frequency domain."""
    frequency = np.fft.fftfreq(256, STEP_M * 2 / C0)
    pulse = np.exp(-((frequency / (BAND_HZ / 2)) ** 2) * np.log(10) / 2) / 16
    ray = places[None] - path.position[:, None]
    distance = np.linalg.norm(ray, axis=2)
    gain = level * np.clip(ray[..., 0] / distance, 0, 1) ** 2 / distance**1.5
    gain = gain * np.exp(-4j * np.pi * CENTER_HZ / C0 * distance)
    out = np.empty((len(path), BINS), complex)
    for n in range(len(path)):
        delay = np.exp(-4j * np.pi / C0 * frequency[:, None] * (distance[n] - 0.6))
        out[n] = np.fft.ifft(pulse * (delay @ gain[n]))[:BINS] * 256
    return out


def _ringing(rng: np.random.Generator) -> np.ndarray:
    """The radar's own echo: direct path, ring-down, echoes of the body."""
    r = STEP_M * np.arange(BINS)
    own = 30 * np.exp(-r / 0.25) * np.exp(2j * np.pi * rng.random(BINS))
    own += 3 * np.exp(-r / 1.5) * (rng.normal(size=BINS) + 1j * rng.normal(size=BINS))
    return own


FIELDS = ("seed", "kind", "strength", "verdict", "clock_error", "clock_sigma", "range_error", "range_sigma")  # [s], [m]


def scored(seed: int, kind: str, strength: str, given: argparse.Namespace) -> list[str | float]:
    """One recording's row of FIELDS: errors of the offsets and their sigmas, NaN where calibration refuses."""
    frames, clock_s, range_m = recording(seed, kind, strength)
    if given.mismatched:
        frames = replace(frames, track=recording(seed + 1000, kind, strength)[0].track)
    if given.unknown_zero:
        frames = replace(frames, spec=frames.spec.but(range_zero_m=None))
    try:
        found = ul.calibrate(frames, lever_arm_sigma_m=given.lever_sigma).calibration
    except CalibrationError as error:
        print(f"{seed:4d} {kind:7s} {strength:8s} refused: {error}", flush=True)
        return [seed, kind, strength, "refused", *4 * [np.nan]]
    clock, range_ = found.t_offset_s - clock_s, found.range_offset_m - range_m
    right = not given.mismatched and abs(clock) < RIGHT_S and abs(range_) < RIGHT_M
    verdict = "right" if right else "WRONG"
    print(
        f"{seed:4d} {kind:7s} {strength:8s} {verdict} "
        f"clock {1e3 * clock:+9.1f} ms (sigma {1e3 * found.t_sigma_s:.1f}), "
        f"range {1e3 * range_:+7.1f} mm (sigma {1e3 * found.range_sigma_m:.1f}), P {found.probability:.3f}",
        flush=True,
    )
    return [seed, kind, strength, verdict, clock, found.t_sigma_s, range_, found.range_sigma_m]


def table(rows: list[dict[str, str]]) -> str:
    """Verdicts, whether the sigmas of the recordings that are right are true, and confident errors, by kind of path."""
    scores = " | ".join(f"{name} rms [{unit}] | over sigma | within 2 sigma" for name, unit in UNITS.items())
    lines = [f"| path | recordings | right | refused | wrong | {scores} |", "|---" * 11 + "|"]
    for kind in [*sorted({row["kind"] for row in rows}), "all"]:
        part = [row for row in rows if kind in (row["kind"], "all")]
        count = {verdict: sum(row["verdict"] == verdict for row in part) for verdict in ("right", "refused", "WRONG")}
        cells = [kind, str(len(part)), *(str(number) for number in count.values())]
        for name in UNITS:
            value = np.array([[float(row[f"{name}_{field}"]) for field in ("error", "sigma")] for row in part])
            value = value[[row["verdict"] == "right" for row in part]]
            cells += truth(*value.T) if len(value) else 3 * [""]
        lines.append("| " + " | ".join(cells) + " |")
    confident = [row["seed"] for row in rows if row["verdict"] == "WRONG" and _far(row)]
    return "\n".join([*lines, f"wrong by more than three sigma: {len(confident)} {' '.join(confident)}"])


def truth(error: np.ndarray, sigma: np.ndarray) -> list[str]:
    """Rms error times 1000, over the rms sigma (1: the sigma is true), and the share within two sigma (95 %)."""
    rms = np.sqrt((error**2).mean())
    ratio, near = rms / np.sqrt((sigma**2).mean()), (np.abs(error) < 2 * sigma).mean()
    return [f"{1e3 * rms:.1f}", f"{ratio:.2f}", f"{100 * near:.0f} %"]


def _far(row: dict[str, str]) -> bool:
    return any(abs(float(row[f"{name}_error"])) > 3 * float(row[f"{name}_sigma"]) for name in ("clock", "range"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--mismatched", action="store_true")
    parser.add_argument("--unknown-zero", action="store_true", help="no prior of the range: echoes alone decide")
    parser.add_argument("--lever-sigma", type=float, default=0.05, help="lever_arm_sigma_m of ul.calibrate")
    parser.add_argument("--log", type=Path, help="CSV file of rows: goes on where it ended; --count 0: print it")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    kinds = given.kinds.split(",")
    rows = []
    done = {row["seed"] for row in csv.DictReader(given.log.open())} if given.log and given.log.exists() else set()
    for seed in range(given.first, given.first + given.count):
        if str(seed) in done:
            continue
        kind, strength = kinds[seed % len(kinds)], STRENGTHS[(seed // len(kinds)) % 3]
        values = scored(seed, kind, strength, given)
        rows.append({name: str(value) for name, value in zip(FIELDS, values, strict=True)})
        if given.log is not None:
            _append(given.log, rows[-1])
    if given.log is not None and given.log.exists():
        rows = list(csv.DictReader(given.log.open()))
    print(table(rows))


def _append(log: Path, row: dict[str, str]) -> None:
    new = not log.exists()
    with log.open("a", newline="") as file:
        writer = csv.DictWriter(file, FIELDS)
        if new:
            writer.writeheader()
        writer.writerow(row)


if __name__ == "__main__":
    main()
