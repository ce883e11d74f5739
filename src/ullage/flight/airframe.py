"""Multirotors by name: mass, rotors, drag and controller gains, each value with its source.

The Hector quadrotor is that of TU Darmstadt [MeyerEtAl2012]: the values stand in its published parameter files
[HectorQuadrotor], the rotor lag and the top speed follow from its published motor equation (a test derives both).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import GRAVITY_M_S2
from ullage.specs import Spec, Vector


class Gains(Spec):
    """Gains of the geometric tracking controller [LeeEtAl2010], with its integral term [GoodarziEtAl2013].

    Attitude gains are per unit inertia, so they are squared frequencies and rates, not torques.
    """

    position_s2: float = Field(5.0, ge=0, le=100, description="1/s^2")
    velocity_s: float = Field(4.0, ge=0, le=100, description="1/s")
    integral_s3: float = Field(1.0, ge=0, le=100, description="1/s^3; carries wind")
    attitude_s2: float = Field(120.0, gt=0, le=1e4, description="roll and pitch, 1/s^2")
    rate_s: float = Field(20.0, gt=0, le=1e3, description="roll and pitch, 1/s")
    yaw_s2: float = Field(9.0, gt=0, le=1e4, description="1/s^2")
    yaw_rate_s: float = Field(5.0, gt=0, le=1e3, description="1/s")
    rotor: float = Field(4.0, ge=0, le=20, description="feedback of rotor speed in the speed controller")
    error_m: float = Field(0.6, gt=0, le=100, description="position error beyond which the pull grows no further")
    tilt_deg: float = Field(35.0, gt=0, lt=80, description="steepest lean asked for")


class Airframe(Spec):
    """A multirotor as a rigid body with rotors that thrust along body z and answer with a first-order lag."""

    name: str
    mass_kg: float = Field(gt=0, le=1000)
    inertia_kg_m2: Vector = Field(description="about body x, y, z through the centre of mass")
    rotor_position_m: tuple[Vector, ...] = Field(min_length=4, max_length=16)
    rotor_spin: tuple[int, ...] = Field(description="+1 where the rotor's drag turns the body to the left, -1 right")
    rotor_radius_m: float = Field(gt=0, le=5)
    rotor_inertia_kg_m2: float = Field(0.0, ge=0, le=1)
    rotor_time_s: float = Field(gt=0, le=1, description="time constant of a change of speed")
    rotor_max_rad_s: float = Field(gt=0, le=1e5)
    thrust_n_s2: float = Field(gt=0, description="thrust over rotor speed squared, N s^2")
    inflow_n_s2_m: float = Field(
        0.0, le=0, description="thrust over rotor speed times climb, N s^2/m; below zero: climbing costs thrust"
    )
    torque_m: float = Field(0.0, ge=0, description="torque about the rotor's axis over thrust")
    torque_nm_s: float = Field(0.0, description="torque over rotor speed (fitted friction, may be below zero)")
    drag_n_s2_m2: Vector = Field((0.0, 0.0, 0.0), description="force over airspeed squared")
    drag_nm_s2: Vector = Field((0.0, 0.0, 0.0), description="torque over angular rate squared")
    core_m: Vector = Field((0.12, 0.12, 0.11), description="edges of the box that stands for the hull in contacts")
    gains: Gains = Gains()
    source: str = ""

    @field_validator("inertia_kg_m2")
    @classmethod
    def _solid(cls, value: Vector) -> Vector:
        if min(value) <= 0 or 2 * max(value) > sum(value) * (1 + 1e-9):
            raise ValueError("each must be above zero and none above the sum of the other two")
        return value

    @field_validator("rotor_spin")
    @classmethod
    def _signs(cls, value: tuple[int, ...], info: Any) -> tuple[int, ...]:
        if len(value) != len(info.data.get("rotor_position_m", value)) or any(s not in (-1, 1) for s in value):
            raise ValueError("one of +1, -1 for each rotor")
        return value

    @property
    def weight_n(self) -> float:
        """Weight [N]."""
        return self.mass_kg * GRAVITY_M_S2

    @property
    def hover_rad_s(self) -> float:
        """Rotor speed at which thrust equals weight in still air [rad/s]."""
        return math.sqrt(self.weight_n / len(self.rotor_spin) / self.thrust_n_s2)

    @property
    def skin_m(self) -> float:
        """Outer layer of the vehicle that contacts may sink into [m]."""
        return min(0.02, 0.25 * min(self.core_m), 0.5 * self.rotor_radius_m)

    @property
    def rotor_half_height_m(self) -> float:
        """Half the height of a rotor with its motor, as contacts see it [m]."""
        return 1.05 * self.skin_m

    @property
    def half_height_m(self) -> float:
        """From the centre to the highest or lowest part, at a lean of ten degrees [m]."""
        rise = max(abs(place[2]) for place in self.rotor_position_m) + self.rotor_half_height_m
        return max(rise, self.core_m[2] / 2) + 0.17 * self.radius_m

    @property
    def radius_m(self) -> float:
        """From the centre to the farthest blade tip or corner of the hull [m]."""
        tips = max(math.hypot(math.hypot(x, y) + self.rotor_radius_m, z) for x, y, z in self.rotor_position_m)
        return max(tips, math.hypot(*self.core_m) / 2)

    def mixer(self) -> Floats:
        """Thrust of each rotor (r, 4) per unit of total thrust [N] and torque about body x, y, z [N m].

        Raises:
            InputError: the rotors cannot turn the body about every axis.
        """
        place = np.asarray(self.rotor_position_m)
        slope = self.torque_m + self.torque_nm_s / (2 * self.thrust_n_s2 * self.hover_rad_s)
        effect = np.stack([np.ones(len(place)), place[:, 1], -place[:, 0], slope * np.asarray(self.rotor_spin)])
        if np.linalg.matrix_rank(effect, tol=1e-9) < 4:
            raise InputError("these rotors cannot turn the body about every axis", where=f"vehicle {self.name}")
        return np.asarray(np.linalg.pinv(effect))


_ARM = 0.275  # [m], l_m of the published propulsion parameters
_RISE = 0.03  # [m], propeller plane above the centre of mass, z_m there

AIRFRAMES: dict[str, Airframe] = {
    "hector": Airframe(
        name="hector",
        mass_kg=1.477,
        inertia_kg_m2=(0.01152, 0.01152, 0.0218),
        rotor_position_m=((_ARM, 0, _RISE), (0, -_ARM, _RISE), (-_ARM, 0, _RISE), (0, _ARM, _RISE)),
        rotor_spin=(1, -1, 1, -1),
        rotor_radius_m=0.1269,
        rotor_inertia_kg_m2=2.573048063300000e-5,
        rotor_time_s=0.0750,
        rotor_max_rad_s=788.8,
        thrust_n_s2=1.538190483976698e-5,
        inflow_n_s2_m=-2.5224e-4,
        torque_m=0.015336864714397,
        torque_nm_s=-7.011631909766668e-5,
        drag_n_s2_m2=(0.08, 0.08, 0.08),
        drag_nm_s2=(0.074156208, 0.074156208, 0.050643264),
        source="MeyerEtAl2012; HectorQuadrotor: quadrotor_base.urdf.xacro, robbe_2827-34_epp1045.yaml, "
        "quadrotor_aerodynamics.yaml (drag of the 2012 files), parameter_QK_propulsion.m",
    )
}


def airframe(vehicle: str | Airframe) -> Airframe:
    """Return a vehicle by name; an `Airframe` passes through.

    Raises:
        InputError: the name is unknown.
    """
    if isinstance(vehicle, Airframe):
        return vehicle
    if vehicle not in AIRFRAMES:
        raise InputError(f"no vehicle {vehicle!r}", where="vehicle", allowed=", ".join(AIRFRAMES))
    return AIRFRAMES[vehicle]
