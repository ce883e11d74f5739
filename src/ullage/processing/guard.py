"""Limit a wanted velocity so that the drone stops before the obstacles that its radars follow.

A velocity is safe where the drone still stops in time if every later command is zero (`processing.braking`). The
directions in which a track may lie bound the speed at which a velocity closes on it. The closing speed that the present
velocity causes bounds it too. The guard uses obstacle distances and odometry alone.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Bools, Floats, Longs
from ullage.config import GuardSpec
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import quat_matrix, transform
from ullage.processing.bearings import CELLS, LEVEL
from ullage.processing.braking import Approach, safe_shares
from ullage.processing.obstacles import ObstacleSectors

State = Literal["free", "limited", "stop", "back_off"]

_LEAST_SPEED_M_S = 0.1  # below it, a closing speed gives no bearing
_STOPPED_M_S = 0.03
_HALF_CELL_RAD = math.radians(2.5)
_TRACK_M, _STEP_M, _PLACES = 0.1, 0.05, 64  # of the flown track: half width, between its places; most places
_TURNS_RAD = tuple(math.radians(side * turn) for turn in range(0, 90, 15) for side in (1, -1))  # straight on wins a tie


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """Velocity that the guard allows."""

    velocity: Floats  # (3) in the world [m/s]
    state: State
    sensor: str  # whose obstacle or silence decided; "" where none did
    free_m: float  # distance to that obstacle, less hull, margin and uncertainty; NaN where none decided [m]


class Guard:
    """Turn wanted velocities into safe ones.

    Args:
        spec: settings.
        hull_m: from the body's origin to its farthest part [m].

    Raises:
        InputError: the hull is not above zero.
    """

    def __init__(self, spec: GuardSpec, *, hull_m: float) -> None:
        if not (math.isfinite(hull_m) and hull_m > 0):
            raise InputError(f"hull_m is {hull_m}", where="Guard", allowed="> 0")
        self.spec, self._hull_m = spec, hull_m
        self._speed = 0.0  # last limit along the wanted direction
        self._last_ns: int | None = None
        self._held = False  # stopped, until there is clearly more room
        self._commands: deque[tuple[int, Floats]] = deque()  # time and velocity in the world of those that may act
        self._track: deque[Floats] = deque(maxlen=_PLACES)  # latest places (3) of the drone [m]
        self._was: tuple[int, Floats] | None = None  # time and place at the last call

    def limit(self, wanted: ArrayLike, sectors: ObstacleSectors, odometry: Trajectory | None) -> Limit:
        """Return the velocity to fly now.

        Args:
            wanted: velocity (3) in the world [m/s].
            sectors: obstacles, at this time.
            odometry: believed pose and velocity of the body; the last one counts.

        Raises:
            InputError: there is no odometry, or a number is not finite.
        """
        want = np.asarray(wanted, float)
        if want.shape != (3,) or not np.isfinite(want).all():
            raise InputError(f"the wanted velocity is {want.tolist()}", where="Guard", allowed="three finite numbers")
        if odometry is None:
            raise InputError("the guard has no odometry", where="Guard", allowed="believed poses with velocities")
        world_from_level, own = _level(odometry)
        table = self._table(own, sectors, world_from_level)
        limit = self._limit(want, own, sectors, table, world_from_level)
        self._note(sectors.t_ns, odometry)
        if limit.state in ("stop", "back_off") and self._retraces(want, own, sectors, table, odometry):
            speed = min(self.spec.back_off_m_s, float(np.linalg.norm(want)))
            limit = replace(limit, velocity=want / np.linalg.norm(want) * speed, state="back_off")
        self._commands.append((sectors.t_ns, limit.velocity))
        return limit

    def around(self, wanted: ArrayLike, sectors: ObstacleSectors, odometry: Trajectory) -> Floats:
        """Return a wanted velocity (3), or where its limit is below it the level turn of it that gets on best [m/s].

        Progress is the part along the wanted velocity of the safe part of each [FoxEtAl1997].

        Args:
            wanted: velocity (3) in the world [m/s].
            sectors: obstacles, at this time.
            odometry: believed pose and velocity of the body; the last one counts.
        """
        want = np.asarray(wanted, float)
        world_from_level, own = _level(odometry)
        table = self._table(own, sectors, world_from_level)

        def progress(turn_rad: float) -> float:
            turned = _turn(turn_rad) @ want
            share = self._share(world_from_level.T @ turned, own, sectors, table)[0]
            if share < 1 and self._retraces(turned, own, sectors, table, odometry):
                share = max(share, min(self.spec.back_off_m_s / float(np.linalg.norm(want)), 1.0))
            return math.cos(turn_rad) * share

        return want if progress(0.0) >= 1 else np.asarray(_turn(max(_TURNS_RAD, key=progress)) @ want)

    def judge(self, sectors: ObstacleSectors, odometry: Trajectory) -> Limit:
        """Judge the present velocity of a vehicle that another commands: free, or stop where it must brake now.

        Its velocity counts as the command that acts until the stop. Commands of `limit` do not count.

        Args:
            sectors: obstacles, at this time.
            odometry: pose and velocity of the body; the last one counts.
        """
        world_from_level, own = _level(odometry)
        share, k, free_m = self._share(own, own, sectors, self._table(own, sectors, world_from_level))
        sensor = sectors.sensors[k] if k >= 0 else ""
        return Limit(world_from_level @ own * share, "free" if share >= 1 else "stop", sensor, free_m)

    def _note(self, t_ns: int, odometry: Trajectory) -> None:
        """Remember a place of the track, and forget the track where poses move otherwise than their velocity says."""
        here, velocity = np.array(odometry.position[-1]), odometry.rates[0][-1]
        then_ns, then = self._was or (t_ns, here)
        self._was = t_ns, here
        if np.linalg.norm(here - then - velocity * (t_ns - then_ns) * 1e-9) > _TRACK_M:
            self._track.clear()
        if not self._track or np.linalg.norm(here - self._track[-1]) >= _STEP_M:
            self._track.append(here)

    def _retraces(
        self, want: Floats, own: Floats, sectors: ObstacleSectors, table: _Table, odometry: Trajectory
    ) -> bool:
        """Whether a velocity in the world leads back along the own track, where no obstacle at rest can be.

        It does so at the speed of a retreat, unless an obstacle that approaches by itself forbids that.
        """
        size, slow = float(np.linalg.norm(want)), self.spec.back_off_m_s
        if not slow or size < _STOPPED_M_S or not self._track:
            return False
        ahead = odometry.position[-1] + 2 * _TRACK_M * want / size
        if np.linalg.norm(np.array(self._track) - ahead, axis=1).min() > _TRACK_M:
            return False
        level, _ = _level(odometry)
        retreat = level.T @ want * min(slow / size, 1.0)
        moving = table.only(table.approach.own_m_s > table.sigma)
        return _covered(retreat, sectors) and self._share(retreat, own, sectors, moving)[0] >= 1

    def _limit(
        self, want: Floats, own: Floats, sectors: ObstacleSectors, table: _Table, world_from_level: Floats
    ) -> Limit:
        speed = float(np.linalg.norm(want))
        kept = table.nearer_by(self.spec.release_m) if self._held else table
        share, k, free_m = self._share(world_from_level.T @ want, own, sectors, kept)
        now = self._recovered(share * speed, sectors.t_ns)
        self._held = speed > _STOPPED_M_S and share * speed < _STOPPED_M_S
        sensor = sectors.sensors[k] if k >= 0 else ""
        away = self._back_off(own, sectors, table)
        if away is not None:
            return Limit(world_from_level @ away, "back_off", sensor, free_m)
        if speed - now < 1e-6:
            return Limit(want, "free", "", math.nan)
        velocity = want * (now / speed)
        return Limit(velocity, "stop" if self._held else "limited", sensor, free_m)

    def _table(self, own: Floats, sectors: ObstacleSectors, world_from_level: Floats) -> _Table:
        while self._commands and self._end_s(self._commands[0][0], sectors.t_ns) <= 0:
            self._commands.popleft()
        tracks, spec = sectors.tracks, self.spec
        still = np.zeros(len(tracks))
        free = tracks.distance_m - spec.sigmas * tracks.sigma_m - self._hull_m - spec.margin_m
        moving = np.maximum(tracks.closing_speed_m_s - np.linalg.norm(own), 0.0)
        sigma = spec.sigmas * tracks.closing_sigma_m_s
        table = _Table(tracks.sensor, sectors.directions(), tracks.closing_speed_m_s, sigma,
                       Approach(free, still, moving, still[None], still[:0]))  # fmt: skip
        issued = [_closing(world_from_level.T @ velocity, own, table) for _, velocity in self._commands]
        return replace(table, approach=replace(
            table.approach, speed_m_s=_closing(own, own, table),
            issued_m_s=np.array(issued).reshape(len(issued), len(tracks)),
            ends_s=np.array([self._end_s(t_ns, sectors.t_ns) for t_ns, _ in self._commands]),
        ))  # fmt: skip

    def _end_s(self, issued_ns: int, now_ns: int) -> float:
        """Time until when a command may act [s]; one of the future is from before the clock was set back."""
        return (issued_ns - now_ns) * 1e-9 + self.spec.latency_s if issued_ns <= now_ns else 0.0

    def _share(self, want: Floats, own: Floats, sectors: ObstacleSectors, table: _Table) -> tuple[float, int, float]:
        """Share of a wanted velocity in the body that is safe; the sensor that decides and its free distance."""
        if not want.any():
            return 1.0, -1, math.nan
        if not _covered(want, sectors):
            level = math.hypot(want[0], want[1])
            silent = np.flatnonzero(~sectors.valid)
            return min(1.0, self.spec.unseen_m_s / level), int(silent[0]) if len(silent) else -1, math.nan
        closing = _closing(want, own, table)
        shares = safe_shares(table.approach, closing, self.spec)
        if not len(shares) or shares.min() >= 1:
            return 1.0, -1, math.nan
        worst = int(np.argmin(shares))
        return float(shares[worst]), int(table.sensor[worst]), float(table.approach.free_m[worst])

    def _recovered(self, speed: float, t_ns: int) -> float:
        """Lower the limit at once and raise it slowly."""
        step_s = 0.0 if self._last_ns is None else max(t_ns - self._last_ns, 0) * 1e-9
        self._last_ns = t_ns
        self._speed = min(speed, self._speed + self.spec.recovery_m_s2 * step_s)
        return self._speed

    def _back_off(self, own: Floats, sectors: ObstacleSectors, table: _Table) -> Floats | None:
        """Return a velocity in the body away from an obstacle well inside the margin; None: not needed, or no space."""
        if not self.spec.back_off_m_s:
            return None
        level = table.cells & LEVEL
        near = (table.approach.free_m < -self.spec.back_off_share * self.spec.margin_m) & level.any(1)
        share = level[near] / level[near].sum(1, keepdims=True)
        push = -(share @ CELLS).sum(0) * np.array([1.0, 1.0, 0.0])
        size = float(np.linalg.norm(push))
        if size < 0.3:  # none, or opposite ones
            return None
        away = push / size * self.spec.back_off_m_s
        others = table.only(~near)
        return away if _covered(away, sectors) and self._share(away, own, sectors, others)[0] >= 1 else None


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Tracks of working sensors, as the guard uses them."""

    sensor: Longs  # (m)
    cells: Bools  # (m, n) directions in which each may lie
    closing: Floats  # (m) measured [m/s]
    sigma: Floats  # (m) of it, times the factor of the settings [m/s]
    approach: Approach

    def only(self, rows: Bools) -> _Table:
        """Some of them."""
        return _Table(
            self.sensor[rows], self.cells[rows], self.closing[rows], self.sigma[rows], self.approach.only(rows)
        )

    def nearer_by(self, length_m: float) -> _Table:
        """Return the state with less space."""
        return replace(self, approach=replace(self.approach, free_m=self.approach.free_m - length_m))


def _turn(angle_rad: float) -> Floats:
    """Return the rotation (3, 3) about the vertical."""
    return transform(rpy_rad=(0.0, 0.0, angle_rad))[:3, :3]


def _level(odometry: Trajectory) -> tuple[Floats, Floats]:
    """Return the rotation (3, 3) from a level frame turned with the body, and the body's velocity (3) in it."""
    forward = quat_matrix(odometry.quat_xyzw[-1])[:, 0]
    world_from_level = transform(rpy_rad=(0.0, 0.0, math.atan2(forward[1], forward[0])))[:3, :3]
    return world_from_level, world_from_level.T @ odometry.rates[0][-1]


def _covered(want: Floats, sectors: ObstacleSectors) -> bool:
    """Return whether a working radar has a velocity's horizontal part in its main lobe; true for a vertical one."""
    if math.hypot(want[0], want[1]) < 1e-3:
        return True
    return bool((sectors.covers(math.atan2(want[1], want[0])) & sectors.valid).any())


def _closing(want: Floats, own: Floats, table: _Table) -> Floats:
    """Greatest speed (m) at which a velocity, in the frame of the cells, can close on each track.

    Two bounds hold for an object at rest at bearing u, and the smaller one counts. The cells in which it may lie bound
    want . u by the one nearest to the velocity. The present velocity v closes at c = v . u, which gives the part of
    want along v; the part across it closes at its full size at most.
    """
    size, speed = float(np.linalg.norm(want)), float(np.linalg.norm(own))
    cosine = np.where(table.cells, CELLS @ want / max(size, 1e-12), -1.0).max(1, initial=-1.0)
    off = np.maximum(np.arccos(np.clip(cosine, -1, 1)) - _HALF_CELL_RAD, 0.0)
    ahead = np.maximum(size * np.cos(off), 0.0)
    if speed < _LEAST_SPEED_M_S:
        return np.asarray(ahead)
    along = float(want @ own) / speed
    across = math.sqrt(max(size**2 - along**2, 0.0))
    edge = table.closing + math.copysign(1.0, along) * table.sigma
    motion = along * np.clip(edge / speed, -1, 1) + across
    return np.asarray(np.clip(motion, 0.0, ahead))
