"""Error-state filter over attitude, position, velocity, biases and whatever is appended to them.

The attitude error turns the world. Radar and inertial unit never show a shift of the world or its turn about the
vertical. An extended filter that linearises about changing estimates believes to learn them [BarrauBonnabel2015]. So
after each correction the covariance is expressed anew, such that these four directions stay what they were.
"""

from __future__ import annotations

import math

import numpy as np

from ullage.arrays import Floats
from ullage.geometry import GRAVITY_M_S2
from ullage.processing.odometry.jets import UP, Jet, cross
from ullage.specs import ImuSpec

BODY = 15  # attitude, position, velocity, bias of turn rate, bias of specific force
_TURN, _PLACE, _SPEED, _GYRO, _ACCEL = (slice(k, k + 3) for k in range(0, BODY, 3))


def turned_by(v: Floats) -> Floats:
    """The rotation (3, 3) of a rotation vector."""
    angle = math.sqrt(float(v @ v))
    k = cross(v)
    if angle < 1e-9:
        return np.eye(3) + k
    return np.asarray(np.eye(3) + math.sin(angle) / angle * k + (1 - math.cos(angle)) / angle**2 * (k @ k))


class Block:
    """Numbers appended to the state: a jet, or the offset of a phase; `at` is its first row."""

    def __init__(self, jet: Jet | None = None) -> None:
        self.at, self.jet, self.offset_m = 0, jet, 0.0

    @property
    def rows(self) -> slice:
        """Rows of it in the state."""
        return slice(self.at, self.at + (1 if self.jet is None else 4))


class Filter:
    """The state and its covariance.

    Args:
        turn: world_from_body (3, 3).
        position: (3) [m].
        velocity: (3) [m/s].
        covariance: (15, 15).
        spec: of the inertial unit.
    """

    def __init__(self, turn: Floats, position: Floats, velocity: Floats, covariance: Floats, spec: ImuSpec) -> None:
        self.turn, self.position, self.velocity = turn, position.copy(), velocity.copy()
        self.gyro_bias, self.accel_bias = np.zeros(3), np.zeros(3)
        self.covariance, self.blocks = covariance, list[Block]()
        walk = spec.walk
        self._density = np.repeat([spec.gyro_noise**2, 0.0, spec.accel_noise**2, walk[0] ** 2, walk[1] ** 2], 3)
        self._flow, self._noise = np.eye(BODY), np.zeros((BODY, BODY))

    def predict(self, dt: float, rate: Floats, force: Floats) -> None:
        """Move on by one reading: mean turn rate (3) and specific force (3) of the body over a time [s]."""
        rate = rate - self.gyro_bias
        middle = self.turn @ turned_by(rate * (dt / 2))
        push = middle @ (force - self.accel_bias)
        change = push - GRAVITY_M_S2 * UP
        self.position = self.position + self.velocity * dt + change * (dt * dt / 2)
        self.velocity = self.velocity + change * dt
        self.turn = self.turn @ turned_by(rate * dt)
        step = np.eye(BODY)
        step[_TURN, _GYRO], step[_PLACE, _SPEED] = -dt * middle, dt * np.eye(3)
        step[_SPEED, _TURN], step[_SPEED, _ACCEL] = -dt * cross(push), -dt * middle
        step[_PLACE, _TURN], step[_PLACE, _ACCEL] = step[_SPEED, _TURN] * (dt / 2), step[_SPEED, _ACCEL] * (dt / 2)
        self._flow = step @ self._flow
        self._noise = step @ self._noise @ step.T
        self._noise.flat[:: BODY + 1] += self._density * dt

    def settle(self) -> None:
        """Bring the covariance to the present."""
        body, rest = slice(0, BODY), slice(BODY, None)
        p = self.covariance
        p[body, body] = self._flow @ p[body, body] @ self._flow.T + self._noise
        p[body, rest] = self._flow @ p[body, rest]
        p[rest, body] = p[body, rest].T
        self._flow, self._noise = np.eye(BODY), np.zeros((BODY, BODY))

    def append(self, block: Block, slopes: Floats, noise: Floats) -> Block:
        """Append numbers (k) whose error is slopes (k, n) times that of the state, and noise (k, k)."""
        across = slopes @ self.covariance
        block.at = len(self.covariance)
        self.covariance = np.block([[self.covariance, across.T], [across, across @ slopes.T + noise]])
        self.blocks.append(block)
        return block

    def remove(self, gone: list[Block]) -> None:
        """Forget some blocks."""
        if not gone:
            return
        keep = np.ones(len(self.covariance), bool)
        for block in gone:
            keep[block.rows] = False
        new = np.cumsum(keep) - 1
        self.blocks = [block for block in self.blocks if keep[block.at]]
        for block in self.blocks:
            block.at = int(new[block.at])
        self.covariance = self.covariance[np.ix_(keep, keep)]

    def anchor(self, block: Block) -> None:
        """Express the jet of a block about the present position."""
        if block.jet is None:
            return
        block.jet, slopes = block.jet.anchored(self.position.copy())
        self.covariance[block.rows] = slopes @ self.covariance[block.rows]
        self.covariance[:, block.rows] = self.covariance[:, block.rows] @ slopes.T

    def correct(self, slopes: Floats, misfit: Floats, noise: Floats, share: Floats | float = 1.0) -> None:
        """Take measurements.

        Args:
            slopes: of the measurements by the state (m, n).
            misfit: measured less predicted (m).
            noise: variances (m).
            share: of the gain (n, m) that counts; where it is 0, a measurement leaves a number of the state alone.
        """
        across = self.covariance @ slopes.T
        gain = np.linalg.solve(slopes @ across + np.diag(noise), across.T).T * share
        before = self._gauge()
        self._move(gain @ misfit)
        kept = np.eye(len(self.covariance)) - gain @ slopes
        p = kept @ self.covariance @ kept.T + (gain * noise) @ gain.T
        self.covariance = self._regauged(p, before, self._gauge())

    def _move(self, step: Floats) -> None:
        self.turn = turned_by(step[_TURN]) @ self.turn
        self.position = self.position + step[_PLACE]
        self.velocity = self.velocity + step[_SPEED]
        self.gyro_bias, self.accel_bias = self.gyro_bias + step[_GYRO], self.accel_bias + step[_ACCEL]
        for block in self.blocks:
            if block.jet is None:
                block.offset_m += float(step[block.at])
            else:
                block.jet = block.jet.moved(step[block.rows])

    def _gauge(self) -> Floats:
        """Error (n, 4) that a shift of the world and its turn about the vertical make."""
        out = np.zeros((len(self.covariance), 4))
        out[2, 3] = 1.0
        out[_PLACE, :3] = np.eye(3)
        out[_PLACE, 3], out[_SPEED, 3] = cross(UP) @ self.position, cross(UP) @ self.velocity
        for block in self.blocks:
            if block.jet is not None:
                out[block.rows] = block.jet.gauge()
        return out

    def _regauged(self, p: Floats, before: Floats, after: Floats) -> Floats:
        pick = np.zeros((4, len(p)))
        pick[:3, _PLACE], pick[:3, 2], pick[3, 2] = np.eye(3), -before[_PLACE, 3], 1.0
        change = after - before
        across = p @ pick.T
        p = p + change @ across.T + across @ change.T + change @ (pick @ across) @ change.T
        return np.asarray((p + p.T) / 2)
