"""The arrays that the flight kernel reads: the airframe, the gains of its controller, and the wind.

The controller is the geometric one on SE(3) [LeeEtAl2010] with an integral term [GoodarziEtAl2013] and the feedforward
of turn rate from jerk [MellingerKumar2011]; its loop is in kernels/flight.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats
from ullage.flight.airframe import Airframe
from ullage.flight.wander import philox
from ullage.geometry import GRAVITY_M_S2
from ullage.kernels.flight import Vehicle


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """An airframe as arrays, in the order in which the kernel reads them."""

    plane: Floats  # (18)
    gains: Floats  # (10)
    mixer: Floats  # (r, 4)
    rotors: Floats  # (r, 4): x, y, z [m], spin

    @classmethod
    def of(cls, frame: Airframe) -> Tables:
        """Return the tables of an airframe."""
        g = frame.gains
        plane = [
            frame.mass_kg, *frame.inertia_kg_m2, frame.rotor_inertia_kg_m2, frame.rotor_time_s, frame.rotor_max_rad_s,
            frame.thrust_n_s2, frame.inflow_n_s2_m, frame.torque_m, frame.torque_nm_s,
            *frame.drag_n_s2_m2, *frame.drag_nm_s2, GRAVITY_M_S2,
        ]  # fmt: skip
        gains = [
            g.position_s2, g.velocity_s, g.integral_s3, g.attitude_s2, g.rate_s, g.yaw_s2, g.yaw_rate_s, g.rotor,
            g.error_m, math.tan(math.radians(g.tilt_deg)),
        ]  # fmt: skip
        spin = np.asarray(frame.rotor_spin, float)[:, None]
        rotors = np.hstack([np.asarray(frame.rotor_position_m, float), spin])
        return cls(np.asarray(plane, float), np.asarray(gains, float), np.ascontiguousarray(frame.mixer()), rotors)

    def memory(self, speed_rad_s: float) -> Floats:
        """Return the kernel's memory (3 + 2 r): no integral, every rotor commanded and turning at one speed."""
        return np.concatenate([np.zeros(3), np.full(2 * len(self.rotors), speed_rad_s)])

    def vehicle(self, qpos: Floats, qvel: Floats, memory: Floats) -> Vehicle:
        """Return what the controller's kernel works on, for a body in this state."""
        return Vehicle(qpos, qvel, memory, self.plane, self.gains, self.mixer)


def air(wind_m_s: Floats, gust_m_s: float, *, count: int, rate_hz: float, seed: int) -> Floats:
    """Wind over time (count, 3) [m/s]: the mean, and gusts as a first-order Gauss-Markov process [BeardMcLain2012].

    Args:
        wind_m_s: mean (3) [m/s].
        gust_m_s: rms of the gusts along x and y [m/s]; half of it along z.
        count: samples.
        rate_hz: samples per second [Hz].
        seed: which gusts.
    """
    out = np.tile(wind_m_s, (count, 1))
    if gust_m_s > 0:
        from scipy.signal import lfilter  # a third of a second, for gusts only

        keep = math.exp(-1.0 / (2.0 * rate_hz))  # two seconds: eddies of a metre or two at walking-pace wind
        white = philox(seed, 1).standard_normal((count, 3))
        white[0] /= math.sqrt(1 - keep**2)
        shaped = lfilter([math.sqrt(1 - keep**2)], [1.0, -keep], white, axis=0)
        out += shaped * (gust_m_s * np.array([1.0, 1.0, 0.5]))
    return np.ascontiguousarray(out)
