"""One solution: predict by the inertial unit, associate echoes with surfaces, update.

Every echo that lasts is a surface: a jet of its distance field (`jets`). All stand in one error-state filter
(`inertial`) with the body. Two measurements come of an echo. Its phase turns once in half a wavelength of range, and is
unwrapped by the prediction: it shows how the range changed since the phase was first taken, to a millimetre. Its
range from the pulse is good to centimetres, and recognises surfaces that were out of view.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from pydantic import Field

from ullage.antenna import boresight_pattern
from ullage.arrays import Bools, Floats
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.geometry import GRAVITY_M_S2, matrix_quat, quat_rpy, transform
from ullage.processing import bearings
from ullage.processing.bearings import CELLS, RadarView
from ullage.processing.odometry.echo_list import EchoList, view_of
from ullage.processing.odometry.inertial import Block, Filter
from ullage.processing.odometry.jets import LEVEL, SIZE, UP, Jet, cross
from ullage.processing.range_tracks import Motion, RangeTracker, Track
from ullage.specs import ImuSpec, RadarSpec, Spec


class OdometrySpec(Spec):
    """Settings of the odometry."""

    imu: ImuSpec = ImuSpec()
    phase_sigma_rad: float = Field(0.2, gt=0, le=2, description="of the phase of an echo that stands alone")
    range_sigma_m: float = Field(0.03, gt=0, le=1, description="of the range by the pulse")
    bend_sigma_m: float = Field(0.003, ge=0, le=1, description="by which a surface leaves its jet in a metre of flight")
    bend_sigma_deg: float = Field(1.2, ge=0, le=45, description="by which it turns in that metre")
    bend_sigma_curvature: float = Field(0.1, ge=0, le=10, description="by which its curvature changes in it [1/m]")
    curvature_sigma: float = Field(0.3, ge=0, le=10, description="of new surfaces [1/m]")
    tilt_sigma_deg: float = Field(5.0, gt=0, le=45, description="of upright and of level surfaces")
    start_sigma_m: float = Field(0.01, gt=0, le=100, description="of the first position")
    start_sigma_deg: float = Field(0.2, gt=0, le=180, description="of the first heading")
    gate_sigma: float = Field(3.5, gt=1, le=10, description="how far a measurement may lie from its prediction")
    most_surfaces: int = Field(40, ge=1, le=500)
    lost_m: float = Field(0.5, gt=0, le=100, description="one sigma of the position beyond which it is lost")


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """The body's pose at one time."""

    t_ns: int
    position: Floats  # (3) [m]
    quat_xyzw: Floats  # (4) world_from_body
    velocity: Floats  # (3) world [m/s]
    angular_velocity: Floats  # (3) body [rad/s]
    sigma: Floats  # (4) of x, y, z [m] and yaw [rad]
    covariance: Floats  # (4, 4) of the same
    consistency: float  # mean square of the innovations over their sigmas, 1 where the filter is right; NaN: none
    surfaces: int  # seen in this frame
    lost: str  # why it is not to be trusted; "" where it is


Reading = tuple[int, Floats, Floats]
"""Time [ns], mean turn rate (3) [rad/s] and specific force (3) [m/s^2] until then."""
Received = Mapping[str, tuple[Frames, EchoList, Floats, float]]
"""Of each radar its frame, echoes, levels (b) [dB] and noise [dB]."""


@dataclass(slots=True, eq=False)
class _Radar:
    """What is known of one radar."""

    spec: RadarSpec
    body_from_sensor: Floats  # (4, 4)
    gain_db: Floats  # two-way, over that of the boresight, for each degree off it
    tracker: RangeTracker
    half_lobe_rad: float
    view: RadarView | None = None
    frames: int = 0

    @property
    def wave_m(self) -> float:
        """Range that turns the phase by one radian [m]."""
        return self.spec.wavelength_m / (4 * math.pi)


_UNWRAPPED = 99  # misfits of a phase that the prediction can no longer unwrap
_UNPROVEN, _LEARN = 9.0, 0.1  # excess of a new surface, and the pace at which it is learned
_WORST = 25.0  # excess from which a surface is forgotten: it is none


@dataclass(slots=True, eq=False)
class _Arc:
    """A phase that is followed without a gap."""

    block: Block
    phase: float  # that the range of the jet at its start had, extended to range 0 [rad]
    seen_ns: int
    beside_m: float  # range by the pulse less that of the jet, in the last frame
    chance: float  # that its echo is the surface's
    misfits: int = 0

    @property
    def sure(self) -> bool:
        """Whether the echo is the surface's by the odds that an association needs."""
        return self.chance * math.exp(-_ODDS) > 1 - self.chance

    def weigh(self, misfit: float, sigma: float, turn_m: float, share: float) -> None:
        """Update the chance by a phase [BarShalomEtAl2001].

        The phase of an echo that is not the surface's is uniform over a turn. An echo may become another's.

        Args:
            misfit: measured less predicted range [m].
            sigma: of the misfit, if the echo is the surface's [m].
            turn_m: range that turns the phase once [m].
            share: by which the errors of this phase are independent of the last one's.
        """
        ratio = turn_m * math.exp(-0.5 * (misfit / sigma) ** 2) / (sigma * math.sqrt(math.tau))
        still = self.chance + share * _SWAPPED * (1 - 2 * self.chance)
        right = still * max(ratio, 1e-9) ** share
        self.chance = right / (right + 1 - still)


@dataclass(slots=True, eq=False)
class _Surface:
    block: Block
    seen_ns: int
    arcs: dict[str, _Arc] = field(default_factory=dict)
    ranged: dict[str, Floats] = field(default_factory=dict)  # where its range by the pulse last counted
    seen: int = 0
    excess: float = _UNPROVEN  # mean square of its misfits over those of an ideal surface
    beside: float = 1.0  # the same of its ranges by the pulse
    proven: bool = False  # until then it learns from the poses, and they do not learn from it


@dataclass(slots=True, eq=False)
class _Pair:
    """A surface and the echo that one radar has of it."""

    surface: _Surface
    name: str
    radar: _Radar
    index: int  # of the echo
    range_m: float  # predicted
    rows: Floats  # (10) indices of the state
    slopes: Floats  # (10) of the range by them
    sigma_m: float  # of the prediction

    @property
    def followed(self) -> bool:
        """Whether its phase is followed, so that the next echo lies where the last one points."""
        return self.name in self.surface.arcs

    def expected(self, spec: OdometrySpec) -> tuple[float, float]:
        """Range [m] and its sigma [m] at which the pulse is expected."""
        if self.followed:
            return self.range_m + self.surface.arcs[self.name].beside_m, _FOLLOWED_M
        return self.range_m, math.hypot(self.sigma_m, spec.range_sigma_m)


_FOLLOWED_M = 0.015  # sigma of the change of a pulse's range from one frame to the next, over the predicted one
_SWAPPED = 0.02  # chance that the echo that is followed becomes another's, or the surface's again
_ODDS = 3.0  # half the log-likelihood ratio by which an echo must fit one surface better than any other
_APART_M = 0.2  # echoes nearer to each other than this spoil each other
_RANGE_EVERY_M = 0.1  # errors of ranges by the pulse are independent so far apart
_PHASE_EVERY_M = 0.03  # errors of phases by other echoes are independent so far apart
_FAINT_DB = 15.0  # two-way gain under the boresight's below which a radar is not asked about a surface
_PROVEN_SEEN, _PROVEN = 20, 2.0  # sightings, and excess, from which a surface moves the pose
_ENOUGH = 2  # proven surfaces in view; with fewer, the others move it too
_SPOILT, _MOST_CURVATURE = 0.5, 3.0
_SPREAD_DEG = 8.0  # of a direction by levels from which an echo makes no surface
_DIRECTION_DEG = 4.0  # error that the directions by levels have in common
_SURE = 0.93  # length of the mean direction of a new surface
_LEAVE_M = 1.0  # a jet is anchored anew after so much flight
_FORGET_NS, _ARC_NS = 2_000_000_000, 400_000_000
_RECENT = 40  # frames over which innovations are judged


class Solution:
    """The poses of one error-state filter, by some of the radars.

    Args:
        start: its first pose counts; None: the origin, heading along x.
        spec: settings.
    """

    def __init__(self, start: Trajectory | None, spec: OdometrySpec) -> None:
        self.spec = spec
        self._start = start
        self._filter: Filter | None = None
        self._radars: dict[str, _Radar] = {}
        self._surfaces: list[_Surface] = []
        self._now_ns, self._rate, self._step_m = 0, np.zeros(3), 0.0
        self._recent: deque[tuple[float, int]] = deque(maxlen=_RECENT)  # squares and number of innovations

    def step(
        self, t_ns: int, readings: Iterable[Reading], heights: Iterable[tuple[float, float]], received: Received
    ) -> PoseEstimate:
        """Predict, associate, update, publish.

        Args:
            t_ns: time of the frames [ns].
            readings: inertial ones since the last step, and the one that spans `t_ns`.
            heights: heights [m] and their sigmas [m] since the last step.
            received: what each radar received.
        """
        state = self._predicted(t_ns, list(readings), heights)
        echoes = {name: self._looked(name, *one, t_ns) for name, one in received.items()}
        pairs = [pair for name, found in echoes.items() for pair in self._associated(state, name, found)]
        self._update(state, pairs, echoes, t_ns)
        self._follow(state, pairs, echoes, t_ns)
        for name, found in echoes.items():
            mine = {pair.index for pair in pairs if pair.name == name}
            self._learn(state, name, found, mine, t_ns)
        self._tidy(state, t_ns)
        return self._published(state, t_ns, len({id(pair.surface) for pair in pairs}))

    # predict

    def _predicted(self, t_ns: int, readings: list[Reading], heights: Iterable[tuple[float, float]]) -> Filter:
        state = self._filter or self._begun(t_ns, readings)
        self._filter = state
        before = state.position
        for until, rate, force in readings:
            end = min(until, t_ns)
            if end > self._now_ns:
                state.predict((end - self._now_ns) * 1e-9, rate, force)
                self._now_ns, self._rate = end, rate - state.gyro_bias
        state.settle()
        self._step_m = step_m = float(np.linalg.norm(state.position - before))
        bend, turn = self.spec.bend_sigma_m**2, math.radians(self.spec.bend_sigma_deg) ** 2
        for surface in self._surfaces:
            for arc in surface.arcs.values():
                state.covariance[arc.block.at, arc.block.at] += bend * step_m
            at = surface.block.at
            if surface.arcs:  # its foot moves on, to where the surface may be another
                state.covariance[at + 1, at + 1] += turn * step_m
                state.covariance[at + 3, at + 3] += self.spec.bend_sigma_curvature**2 * step_m
        for height, sigma in heights:
            row = np.zeros((1, len(state.covariance)))
            row[0, 5] = 1.0
            state.correct(row, np.array([height - state.position[2]]), np.array([sigma**2]))
        return state

    def _begun(self, t_ns: int, readings: list[Reading]) -> Filter:
        """The state at the first frame: the body rested while readings came before it."""
        spec = self.spec
        still = [one for one in readings if one[0] <= t_ns]
        if not still:
            raise InputError(
                "no inertial reading at or before the first frame", where="odometry", allowed="add_imu first"
            )
        rest_s = (still[-1][0] - still[0][0]) * 1e-9 if len(still) > 1 else 0.0
        rested = rest_s >= 0.5
        force = np.mean([one[2] for one in still], axis=0)
        yaw, place, speed = 0.0, np.zeros(3), np.zeros(3)
        if self._start is not None:
            yaw, place = float(quat_rpy(self._start.quat_xyzw[0])[2]), self._start.position[0]
            speed = speed if rested else self._start.rates[0][0]
        up = force / np.linalg.norm(force)
        turn = transform(rpy_rad=(math.atan2(up[1], up[2]), -math.asin(float(np.clip(up[0], -1, 1))), yaw))[:3, :3]
        gyro, accel = spec.imu.bias
        tilt = accel / GRAVITY_M_S2 + (0.0 if rested else 0.05)
        sigma = np.repeat([tilt, spec.start_sigma_m, 0.02 if rested else 0.2, gyro, accel], 3)
        sigma[2] = math.radians(spec.start_sigma_deg)
        out = Filter(turn, place, speed, np.diag(sigma**2), spec.imu)
        if rested:
            out.gyro_bias = np.mean([one[1] for one in still], axis=0)
            out.covariance[9:12, 9:12] = np.eye(3) * (spec.imu.gyro_noise**2 / rest_s + 1e-12)
            # the tilt comes of the force, so the errors of both are one
            level = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) @ turn / GRAVITY_M_S2
            p, bias = out.covariance, accel**2 * np.eye(3)
            p[:2, :2] = (level @ bias @ level.T)[:2, :2] + np.eye(2) * 1e-8
            p[:2, 12:15], p[12:15, :2] = (level @ bias)[:2], (bias @ level.T)[:, :2]
        self._now_ns = t_ns
        return out

    # associate

    def _looked(self, name: str, part: Frames, found: EchoList, level: Floats, noise: float, t_ns: int) -> EchoList:
        radar = self._radars.setdefault(name, _radar(part.spec))
        turn = self._level_turn()
        off = np.degrees(np.arccos(np.clip(CELLS @ (turn @ radar.body_from_sensor[:3, 0]), -1, 1)))
        gain = np.interp(off, np.arange(181), radar.gain_db)
        radar.view = view_of(part, gain, turn @ radar.body_from_sensor[:3, 3], level, noise, t_ns * 1e-9)
        return found

    def _level_turn(self) -> Floats:
        """The body's roll and pitch as a rotation (3, 3)."""
        state = self._filter
        return np.eye(3) if state is None else transform(rpy_rad=(0, 0, -_yaw(state.turn)))[:3, :3] @ state.turn

    def _associated(self, state: Filter, name: str, found: EchoList) -> list[_Pair]:
        """The pairs of surfaces and echoes of one radar of which each is the other's only candidate."""
        radar = self._radars[name]
        arm = state.turn @ radar.body_from_sensor[:3, 3]
        axis = state.turn @ radar.body_from_sensor[:3, 0]
        asked = [_predict_echo(state, surface, name, radar, arm, axis) for surface in self._surfaces]
        open_ = [pair for pair in asked if pair is not None]
        free, pairs = np.ones(len(found.range_m), bool), list[_Pair]()
        for followed in (True, False):
            rest = [pair for pair in open_ if pair.followed == followed]
            for pair in _claimed(rest, found.range_m, free, self.spec):
                free[pair.index] = False
                pairs.append(pair)
        return pairs

    # update

    def _update(self, state: Filter, pairs: list[_Pair], echoes: Mapping[str, EchoList], t_ns: int) -> None:
        rows, misfits, noises = list[Floats](), list[float](), list[float]()
        whose = list[tuple[_Surface, bool, bool]]()  # surface, its association is sure, by phase
        squares, count = 0.0, 0
        for pair in pairs:
            for row, misfit, noise, arc in self._measured(state, pair, echoes[pair.name], t_ns):
                used = np.flatnonzero(row)
                var = float(row[used] @ state.covariance[np.ix_(used, used)] @ row[used])
                score = misfit**2 / (var + noise)
                squares, count = squares + min(score, 25.0), count + 1
                good = score < self.spec.gate_sigma**2
                if arc is not None:
                    arc.misfits = 0 if good else arc.misfits + 1
                followed = pair.surface.arcs.get(pair.name)
                sure = followed is not None and followed.sure
                if good and (sure or arc is not None or not pair.surface.proven):
                    rows.append(row)
                    misfits.append(misfit)
                    noises.append(noise)
                    whose.append((pair.surface, sure, arc is not None))
        self._recent.append((squares, count))
        if rows:
            enough = len({id(one) for one, _, _ in whose if one.proven}) >= _ENOUGH
            share = np.ones((len(state.covariance), len(rows)))
            for column, (surface, sure, phased) in enumerate(whose):
                surface.proven |= surface.seen > _PROVEN_SEEN and surface.excess < _PROVEN
                moves = sure if surface.proven else phased and not enough
                if not moves:
                    share[:, column] = 0.0
                    if not surface.proven:
                        share[surface.block.rows, column] = 1.0
                    share[[arc.block.at for arc in surface.arcs.values()], column] = 1.0
            state.correct(np.array(rows), np.array(misfits), np.array(noises), share)

    def _measured(
        self, state: Filter, pair: _Pair, found: EchoList, t_ns: int
    ) -> Iterable[tuple[Floats, float, float, _Arc | None]]:
        """Row of slopes, misfit [m], variance and arc of each measurement that an echo gives."""
        surface, k = pair.surface, pair.index
        row = np.zeros(len(state.covariance))
        row[pair.rows] = pair.slopes
        arc, extra = surface.arcs.get(pair.name), self._bent(state, pair)
        if arc is not None and t_ns - arc.seen_ns <= _ARC_NS and found.spoilt[k] < _SPOILT:
            phased = row.copy()
            phased[arc.block.at] = 1.0
            used = np.append(pair.rows, arc.block.at)
            sigma = math.sqrt(max(phased[used] @ state.covariance[np.ix_(used, used)] @ phased[used], 0.0) + extra)
            wave = pair.radar.wave_m
            if sigma < wave * math.pi / 2:  # a quarter turn
                turn = arc.phase - found.phase[k] - (pair.range_m + arc.block.offset_m) / wave
                misfit = wave * math.remainder(turn, math.tau)
                noise = (wave * math.hypot(self.spec.phase_sigma_rad, float(found.spoilt[k]))) ** 2
                share = min(1.0, self._step_m / _PHASE_EVERY_M)
                surface.excess += _LEARN * share * (misfit**2 / (sigma**2 + noise) - surface.excess)
                noise *= max(surface.excess, 1.0)
                arc.weigh(misfit, math.sqrt(sigma**2 + noise), wave * math.tau, share)
                if math.sqrt(noise) < wave * math.pi / 2:
                    yield phased, misfit, noise / max(share, 0.03) + extra, arc
            else:
                arc.misfits = _UNWRAPPED
        last = surface.ranged.get(pair.name)
        alone = np.abs(np.delete(found.range_m, k) - found.range_m[k]).min(initial=np.inf) > _APART_M
        if alone and (last is None or np.linalg.norm(state.position - last) > _RANGE_EVERY_M):
            surface.ranged[pair.name] = state.position.copy()
            misfit, noise = float(found.range_m[k] - pair.range_m), self.spec.range_sigma_m**2 + extra
            surface.beside += _LEARN * (misfit**2 / (pair.sigma_m**2 + noise) - surface.beside)
            yield row, misfit, noise * max(surface.beside, 1.0), None

    def _bent(self, state: Filter, pair: _Pair) -> float:
        """Variance [m^2] that the first order in the errors of a direction leaves out."""
        jet, at = pair.surface.block.jet, pair.surface.block.at
        if jet is None:
            return 0.0
        along = float(jet.unit @ (state.position - jet.anchor))
        return 0.5 * (along * float(state.covariance[at + 1, at + 1] + state.covariance[at + 2, at + 2])) ** 2

    # follow phases and learn surfaces

    def _follow(self, state: Filter, pairs: list[_Pair], echoes: Mapping[str, EchoList], t_ns: int) -> None:
        """Keep the arcs that go on, and begin those that do not at the corrected state."""
        for pair in pairs:
            surface, found, k = pair.surface, echoes[pair.name], pair.index
            surface.seen_ns, surface.seen = t_ns, surface.seen + 1
            arc = surface.arcs.get(pair.name)
            if found.spoilt[k] >= _SPOILT:
                continue
            if arc is not None and t_ns - arc.seen_ns <= _ARC_NS and arc.misfits < 3:
                arc.seen_ns, arc.beside_m = t_ns, float(found.range_m[k] - pair.range_m)
                continue
            chance = 1 / (1 + math.exp(-_ODDS / 2))
            if arc is not None:
                state.remove([surface.arcs.pop(pair.name).block])
                if arc.misfits == _UNWRAPPED and t_ns - arc.seen_ns <= _ARC_NS:
                    chance = arc.chance
            self._begin_arc(state, pair, found, t_ns, chance)

    def _begin_arc(self, state: Filter, pair: _Pair, found: EchoList, t_ns: int, chance: float) -> None:
        radar = pair.radar
        arm, axis = state.turn @ radar.body_from_sensor[:3, 3], state.turn @ radar.body_from_sensor[:3, 0]
        fresh = _predict_echo(state, pair.surface, pair.name, radar, arm, axis)
        if fresh is None:
            return
        row = np.zeros((1, len(state.covariance)))
        row[0, fresh.rows] = -fresh.slopes
        noise = np.array([[(radar.wave_m * self.spec.phase_sigma_rad) ** 2]])
        block = state.append(Block(), row, noise)
        phase = float(found.phase[pair.index] + fresh.range_m / radar.wave_m)
        beside_m = float(found.range_m[pair.index] - fresh.range_m)
        pair.surface.arcs[pair.name] = _Arc(block, phase, t_ns, beside_m, chance)

    def _learn(self, state: Filter, name: str, found: EchoList, taken: set[int], t_ns: int) -> None:
        """Follow the echoes that no surface explains, and make surfaces of those whose direction is known."""
        radar = self._radars[name]
        free = np.array([k for k in range(len(found.range_m)) if k not in taken], int)
        pose = state.turn @ radar.body_from_sensor[:3, :3]
        place = state.position + state.turn @ radar.body_from_sensor[:3, 3]
        motion = Motion(state.velocity, pose[:, 0], radar.half_lobe_rad)
        sigma = np.full(len(free), self.spec.range_sigma_m)
        noise = radar.view.noise_db if radar.view else 0.0
        tracks = radar.tracker.step(t_ns, found.range_m[free], sigma, found.level_db[free] - noise, motion)
        for track in radar.tracker.tracks:
            if track.seen_ns == t_ns:
                k = free[int(np.argmin(np.abs(found.range_m[free] - track.measured_m)))]
                track.sums.add(place, t_ns * 1e-9, track.measured_m, float(found.level_db[k]))
        radar.frames += 1
        fresh = [track for track in tracks if track.seen_ns == t_ns]
        if fresh and radar.frames % 4 == 0 and len(self._surfaces) < self.spec.most_surfaces:
            self._born(state, name, fresh, t_ns)

    def _born(self, state: Filter, name: str, tracks: list[Track], t_ns: int) -> None:
        names = list(self._radars)
        views = [self._radars[one].view for one in names]
        yaw = _yaw(state.turn)
        echoes = bearings.Echoes(
            [names.index(name)] * len(tracks), np.array([track.measured_m for track in tracks]),
            np.array([track.rate_m_s for track in tracks]),
            [bearings.PathSums(level_db=track.sums.level_db) for track in tracks],  # levels alone
            np.zeros((len(tracks), 3)),
        )  # fmt: skip
        chance = bearings.posterior(echoes, views, yaw)
        slope = np.degrees(np.arcsin(CELLS[:, 2]))
        upright = np.exp(-0.5 * (slope / (2 * self.spec.tilt_sigma_deg)) ** 2)
        chance = chance * np.where(np.abs(slope) > 80, 1.0, upright)
        known = chance.sum(1)
        radar = self._radars[name]
        for track, one, kept in zip(tracks, chance / known[:, None], known, strict=True):
            mean = one @ CELLS
            size = float(np.linalg.norm(mean))
            if size < _SURE or kept < 0.6:
                continue
            turned = transform(rpy_rad=(0, 0, yaw))[:3, :3]
            mean = mean * (LEVEL if abs(mean[2]) < 0.5 * size else UP)  # upright or level
            unit, cells = turned @ (mean / np.linalg.norm(mean)), CELLS @ turned.T
            place = state.position + state.turn @ radar.body_from_sensor[:3, 3]
            if self._known(state, unit, place, track.measured_m):
                continue
            jet = Jet(place, track.measured_m, unit, 0.0)
            spread = (cells @ jet.across.T).T @ ((cells @ jet.across.T) * one[:, None])
            if spread[0, 0] > math.radians(_SPREAD_DEG) ** 2:
                continue
            self._append(state, name, jet, spread, t_ns)
            track.confirmed, track.score, track.history = False, -1e9, 0

    def _known(self, state: Filter, unit: Floats, place: Floats, range_m: float) -> bool:
        """Whether a surface already lies there, so that the echo is a doubtful one of it."""
        for surface in self._surfaces:
            if surface.block.jet is not None:
                at, slope, _ = surface.block.jet.seen_from(place)
                if abs(at - range_m) < _APART_M and -float(slope @ unit) > 0.9:
                    return True
        return False

    def _append(self, state: Filter, name: str, jet: Jet, spread: Floats, t_ns: int) -> None:
        arm = jet.anchor - state.position
        slopes, across = np.zeros((SIZE, len(state.covariance))), jet.across
        slopes[0, :3], slopes[0, 3:6] = cross(arm) @ jet.unit, jet.unit
        slopes[1, :3], slopes[2, :3] = cross(jet.unit) @ across[0], cross(jet.unit) @ across[1]
        noise = np.zeros((SIZE, SIZE))
        noise[0, 0], noise[3, 3] = self.spec.range_sigma_m**2, self.spec.curvature_sigma**2
        if abs(jet.unit[2]) > 0.5:
            noise[1:3, 1:3], noise[3, 3] = math.radians(2.0) ** 2 * np.eye(2), 0.05**2
        else:
            noise[1, 1] = 2 * spread[0, 0] + math.radians(_DIRECTION_DEG) ** 2
        surface = _Surface(state.append(Block(jet), slopes, noise), t_ns)
        surface.ranged[name] = state.position.copy()
        self._surfaces.append(surface)

    def _tidy(self, state: Filter, t_ns: int) -> None:
        """Forget surfaces that fit no more or were never sure, and arcs that ended; anchor jets anew."""
        gone, kept = list[Block](), list[_Surface]()
        for surface in self._surfaces:
            young = surface.seen < 10 and t_ns - surface.seen_ns > _FORGET_NS
            doubtful = surface.seen > 30 and surface.excess > _UNPROVEN
            if (
                young
                or doubtful
                or surface.excess > _WORST
                or surface.beside > _WORST / 4
                or not _possible(surface.block.jet)
            ):
                gone += [surface.block, *(arc.block for arc in surface.arcs.values())]
                continue
            for name in [name for name, arc in surface.arcs.items() if t_ns - arc.seen_ns > _ARC_NS]:
                gone.append(surface.arcs.pop(name).block)
            kept.append(surface)
        self._surfaces = kept
        state.remove(gone)
        if len(kept) >= self.spec.most_surfaces:
            oldest = min(kept, key=lambda one: one.seen_ns)
            if t_ns - oldest.seen_ns > _FORGET_NS:
                kept.remove(oldest)
                state.remove([oldest.block, *(arc.block for arc in oldest.arcs.values())])
        for surface in kept:
            jet = surface.block.jet
            if jet is not None and surface.seen_ns == t_ns and np.linalg.norm(state.position - jet.anchor) > _LEAVE_M:
                state.anchor(surface.block)

    # publish

    def _published(self, state: Filter, t_ns: int, surfaces: int) -> PoseEstimate:
        pick = [3, 4, 5, 2]
        covariance = state.covariance[np.ix_(pick, pick)]
        count = sum(one[1] for one in self._recent)
        consistency = sum(one[0] for one in self._recent) / count if count else math.nan
        return PoseEstimate(
            t_ns, state.position.copy(), matrix_quat(state.turn[None])[0], state.velocity.copy(), self._rate.copy(),
            np.sqrt(np.diag(covariance)), covariance, consistency, surfaces, "",
        )  # fmt: skip


def _radar(spec: RadarSpec) -> _Radar:
    pattern = boresight_pattern(spec.antenna)
    gain = 2 * (pattern.gain_dbi(np.radians(np.arange(181.0))) - pattern.peak_dbi)
    tracker = RangeTracker(blind_m=spec.own_echo_m, span_m=spec.bins * spec.bin_m)
    return _Radar(spec, spec.mount.body_from_sensor(), gain, tracker, pattern.main_lobe_rad)


def _predict_echo(
    state: Filter, surface: _Surface, name: str, radar: _Radar, arm: Floats, axis: Floats
) -> _Pair | None:
    """What a radar should receive of a surface; None where its antenna does not look there."""
    jet = surface.block.jet
    if jet is None:
        return None
    range_m, slope, by_jet = jet.seen_from(state.position + arm)
    off = math.degrees(math.acos(float(np.clip(-(slope @ axis), -1, 1))))
    if range_m < radar.spec.own_echo_m or np.interp(off, np.arange(181), radar.gain_db) < -_FAINT_DB:
        return None
    rows = np.array([0, 1, 2, 3, 4, 5, *range(surface.block.at, surface.block.at + SIZE)])
    slopes = np.concatenate([cross(arm) @ slope, slope, by_jet])
    var = float(slopes @ state.covariance[np.ix_(rows, rows)] @ slopes)
    return _Pair(surface, name, radar, -1, range_m, rows, slopes, math.sqrt(max(var, 0.0)))


def _claimed(pairs: list[_Pair], range_m: Floats, free: Bools, spec: OdometrySpec) -> list[_Pair]:
    """The pairs of which echo and surface fit each other clearly better than any third."""
    if not pairs or not free.any():
        return []
    expected = np.array([pair.expected(spec) for pair in pairs])
    score = ((range_m[None] - expected[:, :1]) / expected[:, 1:]) ** 2 + 2 * np.log(expected[:, 1:])
    inside = (np.abs(range_m[None] - expected[:, :1]) < spec.gate_sigma * expected[:, 1:]) & free
    score = np.where(inside, score, np.inf)
    out = list[_Pair]()
    for i, pair in enumerate(pairs):
        k = int(np.argmin(score[i]))
        others = min(np.delete(score[i], k).min(initial=np.inf), np.delete(score[:, k], i).min(initial=np.inf))
        if score[i, k] + _ODDS < others:
            pair.index = k
            out.append(pair)
    return out


def _possible(jet: Jet | None) -> bool:
    """Whether the centre of curvature, a caustic, keeps away from the sensor."""
    return jet is not None and abs(jet.curvature) < _MOST_CURVATURE


def _yaw(turn: Floats) -> float:
    return math.atan2(turn[1, 0], turn[0, 0])
