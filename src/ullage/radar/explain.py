"""Where the echoes of a frame come from: objects, bounces, delays, path gains and points, strongest first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ullage import checks
from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.data import Frames, Samples, Trajectory
from ullage.errors import InputError
from ullage.geometry import C0, quat_matrix
from ullage.radar.context import RadarContext, RadarFrame, frames_at, radar_contexts
from ullage.radar.echo_set import EchoSet
from ullage.radar.own_body import with_body
from ullage.radar.physical import accumulate, passive, radio
from ullage.specs import MOST_BOUNCES, RadarSpec
from ullage.world.scene import Scene
from ullage.world.smoothing import linked

Made = list[tuple[RadarFrame, list[EchoSet]]]  # echoes of each pair of patterns

_CELL_M = 0.11  # echoes of one object within this much range, about half a pulse, are reported as one
_APART_M = 0.5  # but not where nothing of the object lies between, over more than this and than a face fills of a cell
_IN_STEP = 1 / 8  # waves by the same objects in other orders that differ by no more of a period are reported as one


@dataclass(frozen=True, slots=True)
class Contribution:
    """One echo, or several that the pulse cannot part."""

    object: str  # what sent the wave back; of several flat faces the last one, or the smaller one
    bounces: int
    delay_s: float  # round trip [s]
    range_m: float  # delay times c / 2 [m]
    path_gain_db: float  # 20 log10 of sqrt(received / transmitted power), antenna included; less beyond a frame's ends
    point: tuple[float, float, float]  # on that object, in the world [m]
    phase_rad: float  # of the echo at the carrier, as it lies in the frame [rad]
    via: tuple[str, ...] = ()  # objects that mirrored the wave before
    after: tuple[str, ...] = ()  # objects that mirrored it on the way back
    seen_m: float = 0.0  # range at which it lies in the frame: `range_m`, less what the pulse interval takes off [m]
    samples: Samples = field(default_factory=lambda: np.zeros(0, np.complex64), compare=False, repr=False)
    """(b) what it adds to the frame, noise aside, in units of sqrt(received / transmitted power)."""

    @property
    def path(self) -> tuple[str, ...]:
        """All objects that the wave meets, in that order."""
        return (*self.via, self.object, *self.after)

    def __repr__(self) -> str:
        bounces = "1 bounce" if self.bounces == 1 else f"{self.bounces} bounces"
        return f"Contribution({self.object!r}, {bounces}, {self.range_m:.2f} m, {self.path_gain_db:.1f} dB)"

    def __str__(self) -> str:
        x, y, z = self.point
        many = "s" if self.bounces > 1 else " "
        strength = f"{self.path_gain_db:7.1f} dB  {self.range_m:7.3f} m  {self.bounces} bounce{many}"
        folded = f", folded to {self.seen_m:.3f} m" if abs(self.seen_m - self.range_m) > 1e-6 else ""
        return f"{strength}  {' > '.join(self.path)}  at ({x:.2f}, {y:.2f}, {z:.2f}){folded}"


def explain(
    scene_or_frames: Scene | Frames,
    path: Trajectory | RadarSpec | int | None = None,
    radar: RadarSpec | None = None,
    i: int = 0,
    *,
    scene: Scene | None = None,
    max_bounces: int | None = None,
    count: int | None = 10,
    seed: int | None = None,
) -> list[Contribution]:
    """The strongest contributions to one frame, recomputed from the scene.

    `explain(frames, i)` takes frames as `simulate` gave them, or pieces of them; `explain(frames, i, scene=scene)`
    those of a recording, by their true poses where they hold them; `explain(scene, path, radar, i)` the body's path.
    Of a radar with an `integration_s` they are those at the frame's stamp.

    Args:
        scene_or_frames: the world, or frames seen in it.
        path: the body's trajectory; with frames, the frame's number may stand here.
        radar: which radar.
        i: number of the frame.
        scene: the world of frames that were not simulated here.
        max_bounces: 1 to 6; None: as the frames were simulated, else 1.
        count: how many at most; None: all, whose samples add up to the frame as it is without noise and leakage.
        seed: of the fine structure of rough surfaces; None: as the frames were simulated, else 0.

    Raises:
        InputError: something needed is missing or of another type, a number is out of bounds, or there is no frame `i`.
    """
    made = None
    if isinstance(scene_or_frames, Frames):
        number = i if path is None else checks.whole("i", path, "explain", low=-(2**63))
        made = scene_or_frames.simulated
        world, track, spec = _of_frames(scene_or_frames, scene)
    else:
        if not isinstance(scene_or_frames, Scene | Frames) or not isinstance(path, Trajectory) or radar is None:
            raise InputError("a scene alone cannot be explained", where="explain",
                             allowed="explain(scene, path, radar, i) or explain(frames, i)")  # fmt: skip
        if not isinstance(radar, RadarSpec):
            raise InputError(f"radar is a {type(radar).__name__}", where="explain", allowed="a RadarSpec, one of a Rig")
        number, world, spec = i, scene_or_frames, radar
        track = path.mounted(radar.mount.body_from_sensor())
    if max_bounces is None:
        max_bounces = 1 if made is None else made.max_bounces
    if seed is None:
        seed = 0 if made is None else made.seed
    checks.whole("max_bounces", max_bounces, "explain", low=1, high=MOST_BOUNCES)
    checks.whole("seed", seed, "explain", low=0)
    if count is not None:
        checks.whole("count", count, "explain", low=0)
    if not -len(track) <= checks.whole("i", number, "explain", low=-(2**63)) < len(track):
        raise InputError(f"no frame {number}", where="explain", allowed=f"0 to {len(track) - 1}")
    pose = track[np.array([number % len(track)])]
    return contributions(world, pose, spec, max_bounces=max_bounces, seed=seed, count=count)


def _of_frames(frames: Frames, scene: Scene | None) -> tuple[Scene, Trajectory, RadarSpec]:
    track = frames.truth if frames.truth is not None else frames.poses
    if scene is None and frames.simulated is not None:
        scene = with_body(frames.simulated.scene, frames.simulated.body)
    if scene is not None and not isinstance(scene, Scene):
        raise InputError(f"scene is a {type(scene).__name__}", where="explain", allowed="a Scene")
    if scene is None or track is None:
        what = "the scene" if scene is None else "their poses"
        raise InputError(f"frames cannot be explained without {what}", where="explain",
                         allowed="explain(frames, i, scene=scene)")  # fmt: skip
    return scene, track, frames.spec


def contributions(
    scene: Scene,
    pose: Trajectory,
    spec: RadarSpec,
    *,
    max_bounces: int = 1,
    seed: int = 0,
    count: int | None = None,
) -> list[Contribution]:
    """List the contributions at the sensor's one pose, strongest first: all of them, or the first `count`."""
    contexts, turn = radar_contexts(scene, spec, seed=seed), quat_matrix(pose.quat_xyzw)[0]
    poses, made, total = contexts[0].poses(pose)[0], [], np.zeros(spec.bins, complex)
    for frame in frames_at(contexts, pose.position[0], turn, poses, max_bounces):
        made.append((frame, accumulate(frame)))
        frame.add_range_bins(total)
    rows = _rows([replace(part, echo=part.echo * frame.context.carrier) for frame, echoes in made for part in echoes])
    found = _alike(spec, list(_clusters(rows)))
    strongest = sorted(found, key=lambda c: -np.abs(c.total) * _landing(contexts[0], c)[2])[:count]
    return [_contribution(made, scene, rows, one, passive(total)) for one in strongest]


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """All echoes of a frame that are not 0."""

    at: Longs  # (n) number among all echoes
    echo: Complexes  # (n)
    delay_s: Floats  # (n)
    points: Floats  # (n, 3) [m]
    chains: Longs  # (n, d) objects in the order in which the wave meets them, -1 for none
    scatterers: Longs  # (n) which of the chain sent the wave back
    rays: Bools  # (n) mirror points
    whole: Bools  # (n) echoes that mean something without those of the same face


@dataclass(frozen=True, slots=True, eq=False)
class _Cluster:
    """Echoes that are reported as one."""

    rows: Longs  # (k)
    shares: Floats  # (k) of each
    total: complex
    point: Floats  # (3) [m]
    delay_s: float
    chain: tuple[int, ...]  # objects in the order in which the wave meets them
    scatterer: int  # which of them holds the point
    ray: bool  # whether a mirror point stands for it
    whole: bool  # more than what the rims of faces add


def _rows(echoes: list[EchoSet]) -> _Rows:
    """Gather mirror points and edges, so that one face's echo is reported once."""
    chains, scatterers = [], []
    for part in echoes:
        many = np.arange(len(part.echo))
        via = np.full((len(many), MOST_BOUNCES - 1), -1)
        if part.via is not None:
            via[:, : part.via.shape[1]] = part.via
        before = (via >= 0).sum(1) if part.before is None else part.before
        place = np.arange(MOST_BOUNCES)
        chain = np.take_along_axis(via, np.minimum(place - (place > before[:, None]), MOST_BOUNCES - 2), 1)
        chain[many, before] = part.object_ids
        chains.append(chain)
        scatterers.append(before)
    echo = np.concatenate([part.echo for part in echoes] or [np.zeros(0, complex)])
    at = np.flatnonzero(echo)
    if not len(at):
        none = np.zeros(0, np.int64)
        return _Rows(none, echo, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 1), np.int64), none, none > 0, none > 0)

    def picked(rows: list[NDArray[Any]]) -> NDArray[Any]:
        return np.asarray(np.concatenate(rows)[at])

    flags = [(p.rays, np.zeros(len(p.echo), bool), np.ones(len(p.echo), bool)) for p in echoes]
    return _Rows(at, echo[at], picked([p.delay_s for p in echoes]), picked([p.places for p in echoes]), picked(chains),
                 picked(scatterers), picked([no if rays is None else rays for rays, no, _ in flags]),
                 picked([yes if rays is None else rays for rays, _, yes in flags]))  # fmt: skip


def _clusters(rows: _Rows) -> Iterator[_Cluster]:
    """What each chain of objects returns, by range and, where nothing of the object lies between, by place.

    Cells grow from the loudest echo on, so that a peak is never split. One fades into the next as cos^2: an
    integral that is cut off returns echoes from the cut [BornWolf1999], one that fades over many waves next to none.
    """
    _, group = np.unique(np.column_stack([rows.chains, rows.scatterers]), axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    for mine in np.split(order, np.cumsum(np.bincount(group.ravel()))[:-1]) if len(order) else ():
        ranges = rows.delay_s[mine] * C0 / 2
        centres, ranks = _centres(ranges, np.abs(rows.echo[mine]))
        for k, centre in enumerate(centres):
            share = np.ones(len(mine))
            for side in (k - 1, k + 1):
                if 0 <= side < len(centres):
                    share *= _fading(ranges, centre, centres[side], bool(ranks[k] < ranks[side]))
            held = np.flatnonzero(share > 0)
            wide = np.sqrt(2 * abs(centre) * _CELL_M + _CELL_M**2)  # as far as a facing face fills a cell
            for part in _places(rows.points[mine[held]], max(1.1 * wide, _APART_M)):
                yield _one(rows, mine[held[part]], share[held[part]])


def _centres(ranges: Floats, loud: Floats) -> tuple[Floats, Longs]:
    """Ranges at least a cell apart, sorted, and ranks: loudest first, until each range lies within a cell of one."""
    left, out = np.argsort(-loud, kind="stable"), []
    while len(left):
        out.append(ranges[left[0]])
        left = left[abs(ranges[left] - out[-1]) > _CELL_M]
    order = np.argsort(out)
    return np.asarray(out)[order], order


def _fading(ranges: Floats, centre: float, other: float, louder: bool) -> Floats:
    """Share (n) of a cell of what lies at ranges (n) between its centre and its neighbour's [m].

    The louder of both keeps all of the nearer half: what the pulse joins to an echo is not parted from it.
    """
    place = (ranges - centre) / (other - centre)
    if abs(other - centre) >= 2 * _CELL_M:  # nothing lies in between
        return np.asarray(place < 0.5, float)
    fade = np.clip(2 * place - 1 if louder else 2 * place, 0, 1)
    return np.asarray(np.cos(np.pi / 2 * fade) ** 2)


def _places(points: Floats, apart_m: float) -> list[Longs]:
    """Points (n, 3) [m] that hang together, none farther from the next than so much."""
    if (np.ptp(points, axis=0) ** 2).sum() <= apart_m**2:
        return [np.arange(len(points))]
    cells = np.floor(points * (8 / apart_m)).astype(np.int64)
    cells -= cells.min(axis=0)
    shape = cells.max(axis=0) + 1
    keys, box = np.unique(np.ravel_multi_index(cells.T, shape), return_inverse=True)  # thin out what lies dense
    boxes = np.column_stack(np.unravel_index(keys, shape))
    near = cKDTree(boxes).query_pairs(8, output_type="ndarray")
    mine = linked(near[:, 0], near[:, 1], len(boxes))[box]
    return np.split(np.argsort(mine, kind="stable"), np.cumsum(np.bincount(mine))[:-1])


def _one(rows: _Rows, mine: Longs, shares: Floats) -> _Cluster:
    """Join some echoes; the mirror point stands for all if it is strong enough.

    Otherwise the echo at their common delay, -d(phase) / d(omega), stands for them.
    """
    echo = rows.echo[mine] * shares
    total, delays, loud = complex(echo.sum()), rows.delay_s[mine], abs(echo)
    ray = np.where(rows.rays[mine], loud, 0.0)
    lead = int(ray.argmax())
    delay, mirrored = float(delays[lead]), bool(ray[lead] >= max(0.3 * abs(total), 1e-300))
    if not mirrored:
        strong = np.flatnonzero(loud >= 0.1 * loud.max())
        delay = float(((echo * delays).sum() * total.conjugate()).real) / max(abs(total) ** 2, 1e-300)
        delay = min(max(delay, float(delays[strong].min())), float(delays[strong].max()))
        lead = int(strong[abs(delays[strong] - delay).argmin()])
    row = mine[lead]
    whole = bool((loud * rows.whole[mine]).max() > 0.3 * abs(total))
    return _Cluster(mine, shares, total, rows.points[row], delay, tuple(int(k) for k in rows.chains[row] if k >= 0),
                    int(rows.scatterers[row]), mirrored, whole)  # fmt: skip


def _alike(spec: RadarSpec, found: list[_Cluster]) -> list[_Cluster]:
    """Join clusters that met the same objects in another order, where their delays do not differ.

    Between faces at right angles all orders have the same length, whatever the antennas' distance: mirror images in
    them commute. Between others with antennas d apart, two orders differ by 2 d . n at most; where that is more than
    an eighth of a wave, they are two echoes with phases of their own. Where an order has no mirror path, its rims are
    what the other one's lack, and belong to it.
    """
    period = 1 / spec.center_hz
    groups: dict[tuple[int, ...], list[_Cluster]] = {}
    for one in sorted(found, key=lambda c: -abs(c.total)):
        known = groups.setdefault(tuple(sorted(one.chain)), [])
        for k, other in enumerate(known):
            same = one.chain == other.chain
            most = _IN_STEP * period if one.whole and other.whole and not same else 2 * _CELL_M / C0
            if abs(one.delay_s - other.delay_s) < most and not (same and one.scatterer == other.scatterer):
                known[k] = _joined(other, one)
                break
        else:
            known.append(one)
    return [one for known in groups.values() for one in known]


def _joined(one: _Cluster, other: _Cluster) -> _Cluster:
    """Join two clusters: that with a mirror path stands for both, of equals that whose point lies on the last face."""

    def rank(c: _Cluster) -> tuple[bool, bool, float]:
        return c.ray, c.scatterer == len(c.chain) - 1 and abs(c.total) > 0.5 * loudest, abs(c.total)

    loudest = max(abs(one.total), abs(other.total))
    one, other = sorted((one, other), key=rank, reverse=True)
    return replace(one, rows=np.concatenate([one.rows, other.rows]), total=one.total + other.total,
                   shares=np.concatenate([one.shares, other.shares]))  # fmt: skip


def _landing(context: RadarContext, one: _Cluster) -> tuple[float, float, float]:
    """Delay [s] at which a cluster lies in the frame, its phase there, and what of it still reaches a bin."""
    spec, fold = context.spec, context.fold_s
    start, end = 2 * spec.range_start_m / C0, 2 * (spec.range_start_m + (spec.bins - 1) * spec.bin_m) / C0
    echoes = 2 * context.first_m / C0
    echoes += (one.delay_s - echoes) % fold  # where the kernels put it first, with this phase
    later = start + (one.delay_s - start) % fold
    at = later if later - end <= start - (later - fold) else later - fold
    phase = np.angle(one.total) - context.pulse.omega * (at - echoes)
    taps = abs(context.pulse.taps[1])
    beyond = round(max(start - at, at - end, 0.0) / context.pulse.step_s)
    left = taps[len(taps) // 2 + beyond] / taps.max() if beyond <= len(taps) // 2 else 0.0
    return at, float(np.angle(np.exp(1j * phase))), float(left) if beyond else 1.0


def _contribution(made: Made, scene: Scene, rows: _Rows, one: _Cluster, whole: float) -> Contribution:
    """Describe a cluster, whose samples keep the share `whole` of its echoes."""
    names, here = [scene.objects[k].name for k in one.chain], one.scatterer
    at, phase, left = _landing(made[0][0].context, one)
    x, y, z = (float(v) for v in one.point)
    level = float(20 * np.log10(max(abs(one.total) * left * whole, 1e-30)))
    return Contribution(names[here], len(names), one.delay_s, one.delay_s * C0 / 2, level, (x, y, z), phase,
                        tuple(names[:here]), tuple(names[here + 1 :]), at * C0 / 2,
                        _samples(made, rows, one, whole))  # fmt: skip


def _samples(made: Made, rows: _Rows, one: _Cluster, whole: float) -> Samples:
    """Compute what a cluster adds to a frame (b), from its echoes alone."""
    spec, first = made[0][0].context.spec, 0
    shares, out = np.zeros(sum(len(p.echo) for _, e in made for p in e), complex), np.zeros(spec.bins, complex)
    np.add.at(shares, rows.at[one.rows], one.shares)
    for frame, echoes in made:
        alone = replace(frame, grids=np.zeros_like(frame.grids))
        for part in echoes:
            mine = shares[first : first + len(part.echo)]
            first += len(part.echo)
            if mine.any():
                part.again(mine, alone.grids)
        alone.add_range_bins(out)
    out *= whole
    return radio(out[None], spec)[0] if spec.output == "rf" else out.astype(np.complex64)
