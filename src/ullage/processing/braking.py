"""The braking law: the commands after which a delayed vehicle still stops within a free distance.

The vehicle follows a commanded speed u with a delay of at most t, a first-order lag of at most tau, and a deceleration
of at least a. The delay may change from command to command. It counts from an echo until the command of the next echo
acts, so it holds one frame period. Delays, lags and decelerations within these limits obey

    v' <= max((e - v) / tau, -a) where v > e,      e(s) = greatest command issued in s - t .. s

The comparison lemma for scalar differential equations [Khalil2002, lemma 3.4] bounds the speed by the solution with
equality. That solution starts at v, rises to e at once, and needs the distance D(v) to come to rest under e = 0:

    D(v) = v tau for v <= a tau,      v^2 / (2 a) + a tau^2 / 2 above

A command is safe if the bound comes to rest within the free distance while every later command is zero. If command k
was safe, zero is safe at frame k + 1: it is what the test of command k assumed. So the vehicle stops in time for any
sequence of safe commands, whatever the phase of frames and obstacle (induction over frames).
A law from the distance alone, such as v t + v^2 / (2 a) = d [PX4Collision], assumes a constant speed before the stop.
A vehicle that tracks this falling limit overshoots: with a delay alone unless t is above e = 2.72 times the delay, with
a lag alone unless t is above four times the lag, since d' = -d / t is then no longer critically damped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Bools, Floats, Longs
from ullage.config import GuardSpec

_SPLIT, _ROUNDS = 8, 3  # a share is found to 1 / 8^3


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """How a vehicle moves towards m obstacles, and the n commands that may still act on it."""

    free_m: Floats  # (m) distance left after hull and margin [m]
    speed_m_s: Floats  # (m) at which it closes on each now [m/s]
    own_m_s: Floats  # (m) at which an obstacle itself approaches: braked for as if it were the vehicle's [m/s]
    issued_m_s: Floats  # (n, m) closing speeds of the commands, oldest first [m/s]
    ends_s: Floats  # (n) time from now until when each may act, rising [s]

    def only(self, rows: Bools | Longs) -> Approach:
        """Some of the obstacles."""
        return Approach(
            self.free_m[rows], self.speed_m_s[rows], self.own_m_s[rows], self.issued_m_s[:, rows], self.ends_s
        )


def distance_to_rest(speed_m_s: ArrayLike, spec: GuardSpec) -> Floats:
    """Distance D(v) in which the vehicle comes to rest once a command of zero acts [m].

    Args:
        speed_m_s: speeds (...) [m/s].
        spec: lag and deceleration.
    """
    speed = np.maximum(np.asarray(speed_m_s, float), 0.0)
    braking, lag = spec.braking_m_s2, spec.lag_s
    fast = speed**2 / (2 * braking) + braking * lag**2 / 2
    return np.asarray(np.where(speed > braking * lag, fast, speed * lag))


def stopping_distance(speed_m_s: ArrayLike, spec: GuardSpec) -> Floats:
    """Distance v t + D(v) from the echo at a constant speed to rest [m].

    Args:
        speed_m_s: speeds (...) [m/s].
        spec: latency, lag and deceleration.
    """
    speed = np.maximum(np.asarray(speed_m_s, float), 0.0)
    return np.asarray(speed * spec.latency_s + distance_to_rest(speed, spec))


def predicted_stop(speed_m_s: Floats, commands_m_s: Floats, ends_s: Floats, spec: GuardSpec) -> Floats:
    """Greatest distance to rest of a vehicle whose issued commands act as long as they can, with zero after them [m].

    Args:
        speed_m_s: speeds now (...) [m/s].
        commands_m_s: speeds asked for (n, ...), oldest first [m/s].
        ends_s: time from now until when each of them may act (n), rising [s].
        spec: lag and deceleration.
    """
    greatest = np.maximum.accumulate(np.maximum(commands_m_s, 0.0)[::-1])[::-1]
    speed, run, before = np.maximum(speed_m_s, 0.0), np.zeros(np.shape(speed_m_s)), 0.0
    for target, end in zip(greatest, ends_s.tolist(), strict=True):
        speed, more = _decayed(np.maximum(speed, target), target, end - before, spec)
        run, before = run + more, end
    return np.asarray(run + distance_to_rest(speed, spec))


def safe_shares(approach: Approach, closing_m_s: Floats, spec: GuardSpec) -> Floats:
    """Greatest share (m), 0 to 1, of a wanted velocity after which the vehicle still stops before each obstacle.

    Args:
        approach: the motion towards m obstacles.
        closing_m_s: speeds (m) at which the wanted velocity closes on each [m/s].
        spec: latency, lag and deceleration.
    """
    out = np.where(closing_m_s > 0, 0.0, 1.0)
    rows = np.flatnonzero(closing_m_s > 0)
    if len(rows):
        whole = _stops(np.ones((1, len(rows))), approach.only(rows), closing_m_s[rows], spec)[0]
        out[rows[whole]] = 1.0
        rows = rows[~whole]
    near, step = approach.only(rows), 1.0
    for _ in range(_ROUNDS if len(rows) else 0):
        step /= _SPLIT
        trial = out[rows] + step * np.arange(1, _SPLIT)[:, None]
        safe = _stops(trial, near, closing_m_s[rows], spec)
        out[rows] += step * np.logical_and.accumulate(safe).sum(0)
    return out


def _stops(shares: Floats, near: Approach, closing: Floats, spec: GuardSpec) -> Bools:
    """Whether the vehicle stops in time after shares (s, m) of a velocity that closes at some speeds (m)."""
    new = shares * closing + near.own_m_s
    issued = np.broadcast_to((near.issued_m_s + near.own_m_s)[:, None], (len(near.ends_s), *new.shape))
    speed = np.broadcast_to(near.speed_m_s + near.own_m_s, new.shape)
    commands, ends = np.concatenate([issued, new[None]]), np.append(near.ends_s, spec.latency_s)
    return np.asarray(predicted_stop(speed, commands, ends, spec) <= near.free_m)


def _decayed(speed: Floats, target: Floats, time_s: float, spec: GuardSpec) -> tuple[Floats, Floats]:
    """Speed after a time at which it falls to a target, and the distance run: at first by the deceleration alone."""
    braking, lag = spec.braking_m_s2, max(spec.lag_s, 1e-9)
    excess = speed - target
    first_s = np.clip((excess - braking * lag) / braking, 0.0, time_s)
    left = excess - braking * first_s
    share = np.exp(-(time_s - first_s) / lag)
    run = target * time_s + (excess - braking * first_s / 2) * first_s + left * lag * (1 - share)
    return np.asarray(target + left * share), np.asarray(run)
