"""One sample of a training set: a random world, a flight through it, what four radars receive, and the truth.

Sample k is drawn from the data set's seed and k alone, so it does not depend on earlier samples or on the machine.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import ullage
from ullage.arrays import Floats, Singles
from ullage.config import split_source
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.flight.navigation import navigate
from ullage.processing.truth import in_sight
from ullage.radar.explain import explain
from ullage.radar.simulate import simulate
from ullage.specs import MOST_BOUNCES, NoiseSpec, RadarSpec, Rig
from ullage.world.scene import Scene
from ullage.world.section import section, wire_section
from ullage.worlds import KINDS, TESTING, TUNING, flight, random, rig

FORMAT = 1
SENSORS = ("front", "left", "back", "right")
CELLS, STEP_M = 128, 0.1  # of the patch of truth about the middle of a sample's track
EYES = 16  # places of the track from which free space is seen
SEGMENTS, ECHOES = 512, 16
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
GROUPS = {"tuning": TUNING, "testing": TESTING, "all": KINDS}
SEEDS = 2**31
MOST_NOISE_M, MOST_DRIFT_M = 0.005, 0.05  # of the believed positions: white noise and slow drift
THERMAL = (0.5, 2.0)  # thermal noise of the receivers, besides the measured one


@dataclass(frozen=True, slots=True)
class SampleSpec:
    """Settings of a data set; together with k they determine sample k.

    Raises:
        InputError: a value is not allowed.
    """

    kinds: tuple[str, ...]
    seed: int = 0
    frames: int = 64  # of each radar in a sample
    bounces: tuple[int, ...] = (1,)  # one of these is drawn for each sample
    digests: tuple[str, ...] = ()  # of the kinds that are world files; "" for the others
    version: str = ullage.__version__
    format: int = FORMAT

    def __post_init__(self) -> None:
        if not 2 <= self.frames <= 4096:
            raise InputError(f"{self.frames} frames", where="dataset", allowed="2 to 4096 frames")
        if not self.bounces or not set(self.bounces) <= set(range(1, MOST_BOUNCES + 1)):
            raise InputError(f"bounces are {self.bounces}", where="dataset", allowed=f"1 to {MOST_BOUNCES} bounces")
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}", where="dataset", allowed="a seed of 0 or more")

    @classmethod
    def of(cls, words: Sequence[str], *, seed: int, frames: int, bounces: Sequence[int]) -> SampleSpec:
        """Check a request: kinds, groups of kinds ("tuning", "testing", "all") and world files.

        Raises:
            InputError: a word is none of them, or a value is not allowed.
        """
        kinds: list[str] = []
        for word in words:
            if word not in GROUPS:
                random(word, 0)  # refuses an unknown kind, with the nearest match
            file, arguments = split_source(word)
            kinds += GROUPS.get(word, (word if word in KINDS else f"{Path(file).resolve()}{arguments}",))
        if not kinds:
            raise InputError("no kind of world", where="dataset", allowed=", ".join((*GROUPS, *KINDS)))
        kinds = list(dict.fromkeys(kinds))
        read = {kind: Path(split_source(kind)[0]).read_bytes() for kind in kinds if kind not in KINDS}
        digests = [hashlib.sha256(read[kind]).hexdigest()[:16] if kind in read else "" for kind in kinds]
        return cls(tuple(kinds), seed, frames, tuple(bounces), tuple(digests))

    def kind_of(self, k: int) -> str:
        """The kind of world of sample k; kinds take turns."""
        return self.kinds[k % len(self.kinds)]


class Axes(NamedTuple):
    """Shape and type of one array of a sample."""

    shape: tuple[int, ...]
    names: tuple[str, ...]
    dtype: str
    fill: float


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Random draws of one sample, before any simulation."""

    kind: str
    scene: Scene
    radars: Rig
    flown: Trajectory
    believed: Trajectory
    bounces: int
    noise_seed: int
    row: dict[str, Any]  # of the index


def draw(spec: SampleSpec, k: int) -> Drawn:
    """Draw world, flight, radars, noise and errors of position of sample k.

    Raises:
        InputError: the world leaves no room to fly, or its flight is too short.
    """
    kind, rng = spec.kind_of(k), np.random.default_rng([spec.seed, k])
    world_seed, noise_seed = (int(seed) for seed in rng.integers(SEEDS, size=2))
    scene, path, preset = random(kind, world_seed), flight(kind, world_seed), rig(kind, world_seed)
    if len(path) < spec.frames:
        raise InputError(f"the flight has {len(path)} frames", where=kind, allowed=f"{spec.frames} or more")
    first = int(rng.integers(len(path) - spec.frames + 1))
    noise_m, drift_m = rng.uniform(0, MOST_NOISE_M), rng.uniform(0, MOST_DRIFT_M)
    bounces = int(rng.choice(spec.bounces))
    thermal = float(np.exp(rng.uniform(*np.log(THERMAL))) * NoiseSpec().thermal)
    radars = preset.but(sensors={name: one.but(noise={"thermal": thermal}) for name, one in preset.sensors.items()})
    flown = path[first : first + spec.frames]
    believed = navigate(flown, noise_m=noise_m, drift_m=drift_m, seed=noise_seed)
    antenna = radars.sensors[SENSORS[0]].antenna
    row = {
        "k": k, "kind": Path(kind).name, "world_seed": world_seed, "noise_seed": noise_seed, "first_frame": first,
        "bounces": bounces, "noise_m": noise_m, "drift_m": drift_m, "thermal": thermal,
        "height_m": float(flown.position[:, 2].mean()), "antenna": antenna.kind,
        "azimuth_deg": antenna.azimuth_deg, "elevation_deg": antenna.elevation_deg,
        "objects": [thing.name for thing in scene.objects],
        "materials": [thing.material.name for thing in scene.objects], "version": spec.version, "failed": "",
    }  # fmt: skip
    return Drawn(kind, scene, radars, flown, believed, bounces, noise_seed, row)


def sample(spec: SampleSpec, k: int) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Make sample k: its arrays by name, and its row of the index.

    Raises:
        InputError: the world that was drawn leaves no room to fly, or its flight is too short.
    """
    drawn = draw(spec, k)
    scene, flown = drawn.scene, drawn.flown
    frames = simulate(
        scene, flown, drawn.radars, max_bounces=drawn.bounces, seed=drawn.noise_seed, believed=drawn.believed
    )
    origin = np.round(flown.position[:, :2].mean(0) / STEP_M) * STEP_M - CELLS * STEP_M / 2
    height = drawn.row["height_m"]
    arrays = {
        "samples": np.stack([frames[name].samples for name in SENSORS]).astype(np.complex64),
        **_track("true", flown),
        **_track("believed", drawn.believed),
        "t_ns": flown.t_ns - flown.t_ns[0],
        "occupancy": _patch(scene, frames, origin, height),
        "patch_origin_m": origin,
        "surfaces_m": _segments(scene, origin, height),
        **_echoes(spec, scene, frames, drawn.bounces),
    }
    return arrays, drawn.row


def _track(name: str, path: Trajectory) -> dict[str, NDArray[Any]]:
    return {f"{name}_position_m": path.position, f"{name}_quat_xyzw": path.quat_xyzw}


def _patch(scene: Scene, frames: dict[str, Frames], origin: Floats, height: float) -> NDArray[np.uint8]:
    """Truth about the track (y, x): occupied where a surface crosses, free where it is seen from the track."""
    centres = origin + (np.arange(CELLS)[:, None] + 0.5) * STEP_M
    x, y = np.meshgrid(centres[:, 0], centres[:, 1])
    places = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
    out = np.full(CELLS * CELLS, UNKNOWN, np.uint8)
    out[in_sight(scene, frames[SENSORS[0]], places, eyes=EYES)] = FREE
    lines = section(scene, height)
    counts = np.maximum(np.ceil(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) / (STEP_M / 4)), 1).astype(int)
    which = np.repeat(np.arange(len(lines)), counts)
    share = (np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / np.repeat(counts, counts)
    points = lines[which, 0] + share[:, None] * (lines[which, 1] - lines[which, 0])
    points = np.concatenate([points, wire_section(scene, height)])
    cell = np.floor((points - origin) / STEP_M).astype(int)
    cell = cell[((cell >= 0) & (cell < CELLS)).all(1)]
    out[cell[:, 1] * CELLS + cell[:, 0]] = OCCUPIED
    return out.reshape(CELLS, CELLS)


def _segments(scene: Scene, origin: Floats, height: float) -> Singles:
    """Lines (SEGMENTS, 2, 2) in which surfaces cross the height near the patch, the longest first, then NaN [m]."""
    lines = section(scene, height)
    low, high = lines.min(1), lines.max(1)
    near = lines[((low <= origin + CELLS * STEP_M) & (high >= origin)).all(1)]
    order = np.argsort(-np.linalg.norm(near[:, 1] - near[:, 0], axis=1), kind="stable")[:SEGMENTS]
    out = np.full((SEGMENTS, 2, 2), np.nan, np.float32)
    out[: len(order)] = near[order]
    return out


def _echoes(spec: SampleSpec, scene: Scene, frames: dict[str, Frames], bounces: int) -> dict[str, NDArray[Any]]:
    """The strongest echoes of each radar's middle frame; object -1 and NaN where there are fewer."""
    axes = {name: one for name, one in layout(spec).items() if name.startswith("echo_")}
    out: dict[str, NDArray[Any]] = {name: np.full(one.shape, one.fill, one.dtype) for name, one in axes.items()}
    number = {thing.name: i for i, thing in enumerate(scene.objects)}
    for row, name in enumerate(SENSORS):
        part = frames[name]
        for column, one in enumerate(explain(part, len(part) // 2, max_bounces=bounces, count=ECHOES)):
            at = row, column
            out["echo_object"][at] = number.get(one.object, -1)
            out["echo_bounces"][at] = one.bounces
            out["echo_range_m"][at] = one.range_m
            out["echo_gain_db"][at] = one.path_gain_db
            out["echo_point_m"][at] = one.point
    return out


def layout(spec: SampleSpec) -> dict[str, Axes]:
    """Return shape and type of each array of a sample."""
    bins, f, s, nan = len(RadarSpec.preset("x4m05").range_m), spec.frames, len(SENSORS), float("nan")
    track = {
        f"{name}_{what}": Axes((f, n), ("frame", axis), "f8", nan)
        for name in ("true", "believed")
        for what, n, axis in (("position_m", 3, "xyz"), ("quat_xyzw", 4, "xyzw"))
    }
    return {
        "samples": Axes((s, f, bins), ("sensor", "frame", "bin"), "c8", 0),
        **track,
        "t_ns": Axes((f,), ("frame",), "i8", 0),
        "occupancy": Axes((CELLS, CELLS), ("y", "x"), "u1", UNKNOWN),
        "patch_origin_m": Axes((2,), ("xy",), "f8", nan),
        "surfaces_m": Axes((SEGMENTS, 2, 2), ("segment", "end", "xy"), "f4", nan),
        "echo_object": Axes((s, ECHOES), ("sensor", "echo"), "i4", -1),
        "echo_bounces": Axes((s, ECHOES), ("sensor", "echo"), "i1", 0),
        "echo_range_m": Axes((s, ECHOES), ("sensor", "echo"), "f4", nan),
        "echo_gain_db": Axes((s, ECHOES), ("sensor", "echo"), "f4", nan),
        "echo_point_m": Axes((s, ECHOES, 3), ("sensor", "echo", "xyz"), "f4", nan),
    }


def coordinates() -> dict[str, tuple[NDArray[Any], tuple[str, ...]]]:
    """Arrays that all samples share, with the names of their axes."""
    mounts = [rig("room", 0).sensors[name].mount.body_from_sensor() for name in SENSORS]
    return {
        "range_m": (RadarSpec.preset("x4m05").range_m, ("bin",)),
        "body_from_sensor": (np.stack(mounts), ("sensor", "row", "column")),
    }


CONTENT = {
    "samples": "baseband samples, in units of sqrt(received / transmitted power)",
    "true_position_m": "true position of the body, world",
    "true_quat_xyzw": "true attitude, world from body",
    "believed_position_m": "position as navigation has it",
    "believed_quat_xyzw": "attitude as navigation has it",
    "t_ns": "time from the first frame",
    "occupancy": f"truth: {UNKNOWN} out of sight, {FREE} free, {OCCUPIED} surface; cells of {STEP_M} m",
    "patch_origin_m": "lower corner of the first cell of `occupancy`, world",
    "surfaces_m": "ends of the lines in which surfaces cross the height, world; NaN after the last",
    "echo_object": "object of each of the strongest echoes of the middle frame: its number in `objects`; -1: none",
    "echo_bounces": "reflections of that echo",
    "echo_range_m": "its range",
    "echo_gain_db": "its path gain",
    "echo_point_m": "where it was reflected last, world",
}
