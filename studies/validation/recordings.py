"""Compare recordings with simulations: the same path, flown in a world built from the known facts about the place.

Levels are powers of baseband samples over the noise of one frame, so the units of a recording cancel. A simulated level
depends on `noise.unit_gain`, which is known to about 6 dB (docs/receiver.md).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

from ullage.arrays import Bools, Complexes, Floats
from ullage.data import Frames, Trajectory
from ullage.errors import InputError, UllageWarning
from ullage.geometry import C0
from ullage.grids import Grid, Image
from ullage.processing.baseband import to_baseband
from ullage.processing.calibrate import calibrate
from ullage.processing.metrics_image import image_quality
from ullage.processing.own_echo import own_echo
from ullage.processing.sar import focus
from ullage.processing.scatterers import find_scatterers
from ullage.radar.receiver import receive, unit
from ullage.radar.receiver_fit import Receiver
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec
from ullage.world import scenes
from ullage.world.scene import Scene

EDGE_M = 0.3  # edge of the simulated corner reflectors: that of the real ones is not recorded
ROOM_M = (8.0, 6.0, 3.0)  # size of the simulated room where nothing is known about the real one
BANDS = ((1.0, 3.0), (3.0, 4.5), (4.5, 11.0))
LOBES_M = (0.15, 0.3)  # distances from a reflector at which its response has side lobes
GAP_M = (1.0, 4.5)  # ranges at which recorded rooms are louder than simulated ones
NEAR_M, FLANK_M = 0.15, 0.45  # half widths around an expected range: the echo, and its surroundings
STEP_M = 0.02  # least distance flown between compared frames
MOST_FRAMES = 400
LEAST_MOVING = 48  # frames that separate the instrument's response from the echoes of the place
PEAK_DBI = 5.97  # peak gain of the X4A02, the antenna of presets without a gain
LEAST_COMMON_M = 1.5  # least common interval of range for the comparison of two recordings
TAIL_M = 0.15  # distance behind the peak of the direct path at which the pulse itself has ended


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A recording and the known facts about its place."""

    name: str
    what: str  # description
    raw: Frames  # as recorded, with its pauses: the receiver is fitted to it
    frames: Frames  # with a true range axis and, where there is a track, poses
    scene: Scene
    known: str  # description of the scene
    reflectors: Floats  # (r, 3) world [m]
    targets: Scene | None = None  # these alone, for the point response
    moves: bool = True  # whether the radar itself moves at times
    floor_z_m: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One recording and its simulation; profiles are rms over the frames, in dB over the noise of one frame."""

    case: Recorded
    receiver: Receiver
    range_m: Floats  # (b)
    profiles_db: dict[str, Floats]  # (b) by name: recorded, world, tails, isotropic, receiver
    shares: dict[str, float]  # of the recorded power within GAP_M, by cause
    images: tuple[Image, Image] | None = None
    points: tuple[dict[str, float], dict[str, float]] | None = None  # of the reflector: error and widths [m]
    lobes_db: dict[str, float] | None = None  # of its side lobes over its peak: recorded, simulated, with tails
    behind: tuple[int, int] | None = None  # coherent scatterers behind the antenna, and all

    def level_db(self, name: str, low: float, high: float) -> float:
        """Average the power of a profile within a band of ranges [dB]."""
        part = (self.range_m >= low) & (self.range_m < high)
        power = 10 ** (self.profiles_db[name][part].astype(float) / 10)
        return float(10 * np.log10(power.mean())) if part.any() else float("nan")


def recordings(folder: Path) -> Iterator[Recorded]:
    """Read every available recording, calibrated where it has a track."""
    makers: tuple[Callable[[Path], Recorded | None], ...] = (_rail_a, _flight_a, _rail_b, _outdoors, _x4_2019, _x4_2017)
    for maker in makers:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UllageWarning)
            case = maker(folder)
        if case is not None:
            yield case


def _rail_a(folder: Path) -> Recorded | None:
    return _tracked(folder / "pulson440" / "rail_a", "PulsON 440 on a rail")


def _flight_a(folder: Path) -> Recorded | None:
    return _tracked(folder / "pulson440" / "flight_a", "PulsON 440 in flight")


def _tracked(folder: Path, what: str) -> Recorded | None:
    """Read a folder with a track and surveyed reflectors, which calibrate clock and range."""
    from ullage.ports.registry import open as open_source
    from ullage.ports.tracked import RailSource

    if not folder.is_dir():
        return None
    source = open_source(folder)
    raw = source.frames()
    if not isinstance(source, RailSource) or not isinstance(raw, Frames):
        raise InputError("not one radar with a track", where=folder)
    return _with_track(folder.name, what, raw, source.reflectors(), 0.0)


def _with_track(name: str, what: str, raw: Frames, places: Floats, floor_z_m: float) -> Recorded:
    frames = calibrate(raw, reflectors=places)
    middle = frames.believed.position.mean(0)
    targets = Scene.union([corner_towards(middle, place) for place in places])
    scene = Scene.union([targets, scenes.floor((24.0, 24.0), floor_z_m)])
    count = "a corner reflector" if len(places) == 1 else f"{len(places)} corner reflectors"
    known = f"{count} of {EDGE_M:g} m on a bare concrete floor"
    return Recorded(name, what, raw, frames, scene, known, places, targets, floor_z_m=floor_z_m)


def corner_towards(point: Floats, place: Floats) -> Scene:
    """Place a trihedral of `EDGE_M` at a place (3), open towards a point (3) [m]."""
    away = place - point
    distance = float(np.linalg.norm(away))
    x = away / distance
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    turn = np.stack([x, y, np.cross(x, y)], axis=1)
    corner = scenes.trihedral(EDGE_M, distance)
    return replace(corner, vertices=corner.vertices @ turn.T + point)


def _rail_b(folder: Path) -> Recorded | None:
    """Read the second rail recording, which is stored as decoded arrays in Motive's axes."""
    path = folder / "pulson440" / "rail_b_decoded.npz"
    if not path.exists():
        return None
    with np.load(path, allow_pickle=False) as held:
        kept = {name: held[name] for name in ("scans", "t_radar_s", "t_mocap_s", "pos_m", "quat_xyzw", "range_m",
                                              "reflectors_m")}  # fmt: skip
    swap = np.array([0, 2, 1])
    turned = (kept["quat_xyzw"] * [1, 1, -1, 1])[:, [0, 2, 1, 3]]
    position = (kept["pos_m"] * [1, 1, -1])[:, swap]
    track = Trajectory(np.rint(kept["t_mocap_s"] * 1e9).astype(np.int64), position, turned)
    spec = _pulson(kept["range_m"], 1 / float(np.median(np.diff(kept["t_radar_s"]))))
    t_ns = np.rint(kept["t_radar_s"] * 1e9).astype(np.int64)
    raw = Frames(kept["scans"].astype(float), kept["range_m"], t_ns, spec, track=track, sensor="pulson",
                 unit="normalised")  # fmt: skip
    places = (kept["reflectors_m"] * [1, 1, -1])[:, swap]
    return _with_track("rail_b", "PulsON 440 on a rail, second recording", raw, places, 0.0)


def _outdoors(folder: Path) -> Recorded | None:
    """Read a corner reflector outdoors: the first of eleven places with unrecorded distances."""
    path = folder / "pulson440" / "outdoor_corner_reflector_decoded.npz"
    if not path.exists():
        return None
    with np.load(path, allow_pickle=False) as held:
        scans, range_m = held["scans"].astype(float), held["range_m"]
    spec = _pulson(range_m, 46.0)
    t_ns = np.rint(np.arange(scans.shape[0] * scans.shape[1]) / 46.0 * 1e9).astype(np.int64)
    raw = Frames(scans.reshape(len(t_ns), -1), range_m, t_ns, spec, sensor="pulson", unit="normalised")
    near = replace(raw, range_m=range_m - (spec.range_zero_m or 0.0))
    first = near[: scans.shape[1]]
    away = float(first.range_m[np.argmax(np.abs(to_baseband(first).mean(0)))])
    scene = Scene.union([scenes.trihedral(EDGE_M, away), scenes.floor((24.0, 24.0), -1.0)])
    known = f"a corner reflector of {EDGE_M:g} m at {away:.2f} m, where the strongest echo is, on the ground 1 m below"
    return _still("outdoors", "PulsON 440 outdoors on a tripod", (raw, first), scene, known)


def _pulson(range_m: Floats, fps: float) -> RadarSpec:
    return RadarSpec.preset("pulson440", bins=len(range_m), range_start_m=float(range_m[0]), fps=fps)


def _x4_2019(folder: Path) -> Recorded | None:
    return _x4(folder / "x4" / "xethru_datafloat_20190614_141837.dat", "x4-2019", "XeThru X4 of 2019", slice(200, 4900))


def _x4_2017(folder: Path) -> Recorded | None:
    return _x4(folder / "x4" / "xethru_baseband_iq_20170913_150437.dat", "x4-2017", "X4M300 of 2017", slice(0, 150))


def _x4(path: Path, name: str, what: str, still: slice) -> Recorded | None:
    from ullage.ports.registry import open as open_source

    if not path.exists():
        return None
    raw = open_source(path).frames()
    if not isinstance(raw, Frames):
        raise InputError("not one radar", where=path)
    known = "a concrete room of {:g} m x {:g} m x {:g} m, since nothing is known of the real one".format(*ROOM_M)
    out = _still(name, what, (raw, raw[still][::16]), _room(), known)
    return replace(out, moves=name == "x4-2019")


def _room() -> Scene:
    """Make a room with the radar 1.5 m in front of one wall and half a metre off the middle."""
    room = scenes.room(ROOM_M)
    return replace(room, vertices=room.vertices + np.array([2.5, 0.5, 0.0]))


def _still(name: str, what: str, frames: tuple[Frames, Frames], scene: Scene, known: str) -> Recorded:
    """Describe a radar at rest at the origin of an unsurveyed place: the whole recording, and a part at rest."""
    raw, part = frames
    poses = Trajectory(part.t_ns, np.zeros((len(part), 3)), np.tile([0.0, 0, 0, 1], (len(part), 1)))
    return Recorded(name, what, raw, replace(part, poses=poses), scene, known, np.zeros((0, 3)))


def compare(case: Recorded) -> Comparison:
    """Fit the receiver, fly the same path in the known world, and measure both in the same way.

    Profiles: `recorded`; `world`, the simulated echoes alone; `tails`, each of these followed by the tail of the
    instrument's direct path; `isotropic`, the world with an isotropic antenna; `receiver`, the world received by the
    fitted receiver. Tails and isotropic antenna are upper bounds.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UllageWarning)
        receiver = Receiver.fit(case.raw)
    real = _thinned(case.frames)
    spec = receiver.radar.but(bins=len(real.range_m), range_start_m=float(real.range_m[0]))
    noise = _rest_noise(case.raw, receiver)
    path = real.believed[_once(real)]
    world = _flown(case.scene, path, spec)
    few = path[:: max(1, len(path) // 50)]
    peak_dbi = PEAK_DBI if spec.antenna.gain_dbi is None else spec.antenna.gain_dbi
    everywhere = spec.but(antenna={"kind": "isotropic", "gain_dbi": peak_dbi})
    received = replace(world, samples=receive(world.samples / unit(spec), spec, seed=1) * unit(spec))
    profiles = {
        "recorded": _power(real), "world": _power(world), "tails": _power(_with_tails(world, spec)),
        "isotropic": _power(_flown(case.scene, few, everywhere)), "receiver": _power(received),
    }  # fmt: skip
    over_noise = {name: 10 * np.log10(np.maximum(one / noise**2, 1e-6)) for name, one in profiles.items()}
    behind = None if case.frames.calibration is None else count_behind(case.frames)
    shares = _shares(case, receiver, real)
    images, points, lobes = _imaged(case, real, spec)
    return Comparison(case, receiver, real.range_m, over_noise, shares, images, points, lobes, behind)


def _flown(scene: Scene, path: Trajectory, spec: RadarSpec) -> Frames:
    """Simulate the echoes of a world along a path, without noise, in the recording's units."""
    clean = simulate(scene, path, spec.but(noise=None), max_bounces=3)
    return replace(clean, samples=clean.samples * unit(spec), unit="normalised")


def _with_tails(world: Frames, spec: RadarSpec) -> Frames:
    """Append to each echo the tail of the instrument's direct path."""
    own = None if spec.noise is None else spec.noise.direct_path
    if own is None:
        return world
    response = np.array(own.in_phase) + 1j * np.array(own.quadrature)
    first = int(np.argmax(np.abs(response)))
    delay = np.arange(len(response) - first) * own.step_m
    if delay[-1] <= 2 * TAIL_M:
        return world
    apart = np.arange(0, delay[-1], world.spec.bin_m)
    tail = np.interp(apart, delay, response[first:].real) + 1j * np.interp(apart, delay, response[first:].imag)
    tail = np.where(apart > TAIL_M, tail, 0) / response[first]
    values = to_baseband(world)
    spread = fftconvolve(values, tail[None], axes=1)[:, : values.shape[1]]
    baseband = world.spec.but(output="baseband", decimation=1) if world.spec.output == "rf" else world.spec
    return replace(world, samples=(values + spread).astype(np.complex64), spec=baseband)


def _once(frames: Frames) -> slice:
    """Select all frames of a moving radar, or one frame of a radar at rest."""
    still = float(np.ptp(frames.believed.position, axis=0).max()) < STEP_M
    return slice(0, 1) if still else slice(None)


def _thinned(frames: Frames) -> Frames:
    """Select at most MOST_FRAMES frames, at least STEP_M apart unless the radar is at rest."""
    step = np.linalg.norm(np.diff(frames.believed.position, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    if along[-1] < STEP_M:
        return frames[:: max(1, -(-len(frames) // MOST_FRAMES))]
    apart = max(STEP_M, along[-1] / MOST_FRAMES)
    return frames[np.unique(np.floor(along / apart), return_index=True)[1]]


def _rest_noise(raw: Frames, receiver: Receiver) -> float:
    """Estimate the sigma of a frame's complex baseband noise from successive frames at rest, at far ranges."""
    still = to_baseband(raw[np.flatnonzero(receiver.still)])
    return float(np.sqrt(np.mean(np.abs(np.diff(still[:, -still.shape[1] // 4 :], axis=0)) ** 2) / 2))


def _power(frames: Frames) -> Floats:
    """Average the power of every bin (b) at baseband."""
    return np.asarray(np.mean(np.abs(to_baseband(frames)) ** 2, axis=0), float)


def _shares(case: Recorded, found: Receiver, real: Frames) -> dict[str, float]:
    """Estimate the shares of the recorded power within GAP_M by cause, as far as this recording separates them.

    `instrument`: the response that stays constant while the radar moves, less the expected remainder of the mean over
    few places. `changes`: changes while the radar rests, after removal of each frame's phase and gain. `floor` and
    `reflectors`: the excess of power around their expected ranges, without the radar's own echo.
    """
    values, part = to_baseband(case.raw), (case.frames.range_m >= GAP_M[0]) & (case.frames.range_m < GAP_M[1])
    if not part.any():
        return {}
    noise = _rest_noise(case.raw, found) ** 2
    out: dict[str, float] = {}
    if case.moves and np.count_nonzero(found.moving) >= LEAST_MOVING:
        moving = values[found.moving][:, part]
        whole = float(np.mean(np.abs(moving) ** 2)) - noise
        pieces = np.array([piece.mean(0) for piece in np.array_split(moving, len(moving) // 16)])
        chance = float(np.mean(pieces.var(0))) / len(pieces)
        out["instrument"] = max(float(np.mean(np.abs(moving.mean(0)) ** 2)) - chance, 0.0) / whole
    rest = values[_longest(found.still)]
    mean = rest.mean(0)
    rest = (rest / ((rest @ mean.conj()) / np.vdot(mean, mean))[:, None])[:, part]
    out["changes"] = max(float(np.mean(rest.var(0))) - noise, 0.0) / float(np.mean(np.abs(rest) ** 2) - noise)
    if case.frames.calibration is not None:
        out |= _expected(case, real, part, noise)
    return out


def count_behind(frames: Frames) -> tuple[int, int] | None:
    """Count coherent scatterers behind the antenna, and all; None where the track is too straight to separate sides.

    Args:
        frames: calibrated, with the radar's own echo.
    """
    clean = own_echo(frames).removed_from(frames)
    places = find_scatterers(clean, everywhere=True)
    if not places or not places[0].height_known:
        return None
    return sum(not one.in_front for one in places), len(places)


def _longest(chosen: Bools) -> slice:
    """Return the longest run of chosen frames: the radar may rest at several places."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]])))
    runs = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    return slice(*max(runs, key=lambda run: run[1] - run[0]))


def _expected(case: Recorded, real: Frames, part: Bools, noise: float) -> dict[str, float]:
    """Estimate the shares of the floor and of the reflectors from the excess of power at their expected ranges."""
    power = np.abs(to_baseband(own_echo(real).removed_from(real))) ** 2
    whole = float(np.sum(np.mean(np.abs(to_baseband(real)) ** 2, axis=0)[part] - noise))
    place = real.believed.position
    away = {} if case.floor_z_m is None else {"floor": [place[:, 2] - case.floor_z_m]}
    if len(case.reflectors):
        away["reflectors"] = [np.linalg.norm(place - one, axis=1) for one in case.reflectors]
    out = {}
    for name, ranges in away.items():
        excess = 0.0
        for at in ranges:
            off = np.abs(real.range_m[None] - at[:, None])
            near, flank = (off < NEAR_M) & part, (off >= NEAR_M) & (off < FLANK_M) & part
            if near.any() and flank.any():
                excess += (power[near].mean() - power[flank].mean()) * near.sum() / len(power)
        out[name] = max(excess, 0.0) / whole
    return out


def _imaged(
    case: Recorded, real: Frames, spec: RadarSpec
) -> tuple[tuple[Image, Image] | None, tuple[dict[str, float], dict[str, float]] | None, dict[str, float] | None]:
    """Focus images of the first reflector, and measure its position error, widths and side lobes in them."""
    if case.targets is None:
        return None, None, None
    ours = _flown(case.targets, real.believed, spec)
    place = case.reflectors[0]
    grid = Grid.covering(np.stack([place - 0.8, place + 0.8]), 0.02, z_m=float(place[2]))
    clean = own_echo(real).removed_from(real)
    images = focus(clean, grid), focus(ours, grid)
    wanted = ("error", "width_x_6db", "width_y_6db")
    found = [image_quality(image, target_m=place, search_m=0.4) for image in images]
    shown = {"recorded": images[0], "simulated": images[1], "tails": focus(_with_tails(ours, spec), grid)}
    lobes = {name: lobe_db(image, place) for name, image in shown.items()}
    return images, tuple({name: one[name].value for name in wanted} for one in found), lobes  # type: ignore[return-value]


def lobe_db(image: Image, place: Floats) -> float:
    """Return the strongest amplitude `LOBES_M` from the peak near a place (3), over that peak [dB]."""
    x, y = image.grid.x_m[None], image.grid.y_m[:, None]
    near = np.where(np.hypot(x - place[0], y - place[1]) < 0.4, image.amplitude, 0)
    row, column = np.unravel_index(int(np.argmax(near)), near.shape)
    away = np.hypot(x - image.grid.x_m[column], y - image.grid.y_m[row])
    lobe = image.amplitude[(away >= LOBES_M[0]) & (away <= LOBES_M[1])].max()
    return float(20 * np.log10(lobe / image.amplitude[row, column]))


@dataclass(frozen=True, slots=True)
class RingDownMatch:
    """Coherence of the constant responses in two recordings by the same kind of radar."""

    names: tuple[str, str]
    band_m: tuple[float, float]
    coherence: float  # 1: the same response


def compare_ring_downs(all_of_them: list[Comparison]) -> list[RingDownMatch]:
    """Compare the responses that stay constant while the radar moves, between recordings by one kind of radar.

    Each is the ring-down plus constant echoes of the place. Only the ring-down is common. If both parts have the same
    strength in both recordings, the coherence is the share of the ring-down.
    """
    moved = [one for one in all_of_them if "instrument" in one.shares]
    out = []
    for one, other in combinations(moved, 2):
        axes = one.case.frames.range_m, other.case.frames.range_m
        low = max(GAP_M[0], *(float(axis[0]) for axis in axes))
        spec = one.case.raw.spec
        if spec.name != other.case.raw.spec.name or GAP_M[1] - low < LEAST_COMMON_M:
            continue
        at = np.arange(low, GAP_M[1], spec.bin_m)
        a, b = (
            np.interp(at, axis, values.real) + 1j * np.interp(at, axis, values.imag)
            for axis, values in zip(axes, (_constant_response(one), _constant_response(other)), strict=True)
        )
        norm = float(np.sqrt(np.vdot(a, a).real * np.vdot(b, b).real))
        names = one.case.name, other.case.name
        out.append(RingDownMatch(names, (low, GAP_M[1]), abs(_best_product(a, b, at, spec)) / norm))
    return out


def _constant_response(one: Comparison) -> Complexes:
    return np.asarray(to_baseband(one.case.raw)[one.receiver.moving].mean(0), complex)


def _best_product(a: Complexes, b: Complexes, at: Floats, spec: RadarSpec) -> complex:
    """Maximise the inner product of two responses over small range shifts: the axes are known to centimetres only."""
    shifts = np.linspace(-0.06, 0.06, 61)
    turn = 4j * np.pi * spec.center_hz / C0
    moved = [np.interp(at + s, at, b.real) + 1j * np.interp(at + s, at, b.imag) for s in shifts]
    products = [np.vdot(a, one * np.exp(turn * s)) for s, one in zip(shifts, moved, strict=True)]
    return complex(products[int(np.argmax(np.abs(products)))])
