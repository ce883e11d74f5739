"""One step of a multirotor: geometric control, rotor lag, and the wrench on the body.

Quaternions here are wxyz, as the physics engine keeps them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ullage.kernels.loops import inner, loop

MASS, IX, IY, IZ, SPIN_J, TAU, TOP, C0, C1, KT, KM, DX, DY, DZ, MX, MY, MZ, G = range(18)
KP, KV, KI, KR, KW, KRZ, KWZ, KROT, REACH, LEAN = range(10)


class Vehicle(NamedTuple):
    """A multirotor in flight; the layout of `plane` and `gains` is that of flight/control.py."""

    qpos: np.ndarray  # (7) position [m], world_from_body quaternion wxyz
    qvel: np.ndarray  # (6) velocity [m/s] in the world, body rates [rad/s]
    memory: np.ndarray  # (3 + 2 r) integral of the position error [m s], commanded and actual rotor speeds [rad/s]
    plane: np.ndarray  # (18) mass, inertia, rotors, drag, gravity: the constants above, in SI units
    gains: np.ndarray  # (10) of the controller, and its limits
    mixer: np.ndarray  # (r, 4) thrust of each rotor for a unit of thrust and of torque about x, y, z


@loop()
def rotation(q: np.ndarray) -> tuple[float, ...]:
    """Return the rotation matrix (row by row, 9 numbers) of the unit quaternion wxyz at the end of a pose (7)."""
    w, x, y, z = q[3], q[4], q[5], q[6]
    return (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip


@inner()
def lift(vehicle: Vehicle, track: np.ndarray, row: int, dt: float) -> tuple[float, float, float]:
    """Return the acceleration to apply [m/s^2], gravity included, within the tilt limit; update the integral."""
    qpos, qvel, memory, plane, gains, _ = vehicle
    out = np.empty(3)
    for k in range(3):
        gap = min(max(track[row, k] - qpos[k], -gains[REACH]), gains[REACH])
        pull = 0.0
        if gains[KI] > 0:
            most = 0.5 * plane[G] / gains[KI]
            memory[k] = min(max(memory[k] + gap * dt, -most), most)
            pull = gains[KI] * memory[k]
        out[k] = track[row, 6 + k] + gains[KP] * gap + gains[KV] * (track[row, 3 + k] - qvel[k]) + pull
    x, y, z = out[0], out[1], max(out[2] + plane[G], 0.2 * plane[G])
    side, most_side = math.hypot(x, y), gains[LEAN] * z
    if side > most_side:
        x, y = x * most_side / side, y * most_side / side
    return x, y, z


@inner()
def demand(vehicle: Vehicle, track: np.ndarray, row: int, dt: float) -> tuple[float, float, float, float]:
    """Return total thrust [N] and torque about x, y, z [N m] of the geometric tracking controller."""
    qpos, qvel, _, plane, gains, _ = vehicle
    fx, fy, fz = lift(vehicle, track, row, dt)
    size = math.sqrt(fx * fx + fy * fy + fz * fz)
    b3x, b3y, b3z = fx / size, fy / size, fz / size
    cos, sin = math.cos(track[row, 12]), math.sin(track[row, 12])
    b2x, b2y, b2z = -b3z * sin, b3z * cos, b3x * sin - b3y * cos
    norm = math.sqrt(b2x * b2x + b2y * b2y + b2z * b2z)
    b2x, b2y, b2z = b2x / norm, b2y / norm, b2z / norm
    b1x, b1y, b1z = b2y * b3z - b2z * b3y, b2z * b3x - b2x * b3z, b2x * b3y - b2y * b3x
    jx, jy, jz = track[row, 9], track[row, 10], track[row, 11]
    wx, wy = -(jx * b2x + jy * b2y + jz * b2z) / size, (jx * b1x + jy * b1y + jz * b1z) / size
    wz = track[row, 13] * b3z
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(qpos)
    # m is desired_from_body
    m00, m01, m02 = (
        b1x * r00 + b1y * r10 + b1z * r20,
        b1x * r01 + b1y * r11 + b1z * r21,
        b1x * r02 + b1y * r12 + b1z * r22,
    )
    m10, m11, m12 = (
        b2x * r00 + b2y * r10 + b2z * r20,
        b2x * r01 + b2y * r11 + b2z * r21,
        b2x * r02 + b2y * r12 + b2z * r22,
    )
    m20, m21, m22 = (
        b3x * r00 + b3y * r10 + b3z * r20,
        b3x * r01 + b3y * r11 + b3z * r21,
        b3x * r02 + b3y * r12 + b3z * r22,
    )
    p, q, r = qvel[3], qvel[4], qvel[5]
    slip_x = p - (m00 * wx + m10 * wy + m20 * wz)
    slip_y = q - (m01 * wx + m11 * wy + m21 * wz)
    slip_z = r - (m02 * wx + m12 * wy + m22 * wz)
    ix, iy, iz = plane[IX], plane[IY], plane[IZ]
    return (
        plane[MASS] * (fx * r02 + fy * r12 + fz * r22),
        -ix * (gains[KR] * 0.5 * (m21 - m12) + gains[KW] * slip_x) + (iz - iy) * q * r,
        -iy * (gains[KR] * 0.5 * (m02 - m20) + gains[KW] * slip_y) + (ix - iz) * p * r,
        -iz * (gains[KRZ] * 0.5 * (m10 - m01) + gains[KWZ] * slip_z) + (iy - ix) * p * q,
    )


@loop()
def share(thrust: float, tx: float, ty: float, tz: float, mixer: np.ndarray, most: float, out: np.ndarray) -> None:
    """Write the thrust of each rotor [N], within 0..most, for a thrust and torque; yaw is reduced first."""
    keep = 1.0
    for i in range(len(mixer)):
        out[i] = min(max(mixer[i, 0] * thrust + mixer[i, 1] * tx + mixer[i, 2] * ty, 0.0), most)
        twist = mixer[i, 3] * tz
        room = most - out[i] if twist > 0 else out[i]
        if abs(twist) > room:
            keep = min(keep, room / abs(twist))
    for i in range(len(mixer)):
        out[i] = min(max(out[i] + keep * mixer[i, 3] * tz, 0.0), most)


@loop()
def command(vehicle: Vehicle, track: np.ndarray, row: int, dt: float) -> None:
    """Set the commanded rotor speeds in the vehicle's memory from its state and a row of the track.

    A row of `track` (n, 14) is position, velocity, acceleration, jerk (12) [SI units], yaw [rad], yaw rate [rad/s].
    """
    _, _, memory, plane, gains, mixer = vehicle
    n = len(mixer)
    thrust = np.empty(n)
    force, tx, ty, tz = demand(vehicle, track, row, dt)
    share(force, tx, ty, tz, mixer, plane[C0] * plane[TOP] ** 2, thrust)
    for i in range(n):
        speed = math.sqrt(thrust[i] / plane[C0])
        speed += gains[KROT] * (speed - memory[3 + n + i])
        memory[3 + i] = min(max(speed, 0.0), plane[TOP])


@loop()
def control(vehicle: Vehicle, track: np.ndarray, row: int, dt: float, log: np.ndarray) -> None:
    """Write pose, velocity and actual rotor speeds to a row of `log` (n, 13 + r) after a `command`."""
    command(vehicle, track, row, dt)
    for k in range(7):
        log[row, k] = vehicle.qpos[k]
    for k in range(6):
        log[row, 7 + k] = vehicle.qvel[k]
    n = len(vehicle.mixer)
    for k in range(n):
        log[row, 13 + k] = vehicle.memory[3 + n + k]


@loop()
def wrench(
    qpos: np.ndarray, qvel: np.ndarray, memory: np.ndarray, plane: np.ndarray, rotors: np.ndarray, wind: np.ndarray,
    dt: float, out: np.ndarray,
) -> None:  # fmt: skip
    """Move the rotors on by one physics step, and write force and torque on the body at mid-step.

    Runs at every physics step; plain arrays reach compiled code faster than a named tuple does.

    Args:
        qpos, qvel, memory, plane: as in `Vehicle`; the actual rotor speeds are updated.
        rotors: (r, 4) x, y, z [m] in the body, direction of spin.
        wind: (3) [m/s] in the world.
        dt: time of the step [s].
        out: (6) gets force [N] in the world and torque [N m] about the body's axes.
    """
    n = len(rotors)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(qpos)
    p, q, r = qvel[3], qvel[4], qvel[5]
    ax, ay, az = qvel[0] - wind[0], qvel[1] - wind[1], qvel[2] - wind[2]
    u = r00 * ax + r10 * ay + r20 * az
    v = r01 * ax + r11 * ay + r21 * az
    w = r02 * ax + r12 * ay + r22 * az
    fast = math.sqrt(u * u + v * v + w * w)
    turning = math.sqrt(p * p + q * q + r * r)
    fx, fy, fz = -plane[DX] * fast * u, -plane[DY] * fast * v, -plane[DZ] * fast * w
    tx, ty, tz = -plane[MX] * turning * p, -plane[MY] * turning * q, -plane[MZ] * turning * r
    half = math.exp(-0.5 * dt / plane[TAU])
    for i in range(n):
        asked, speed = memory[3 + i], memory[3 + n + i]
        middle = asked + (speed - asked) * half
        memory[3 + n + i] = asked + (speed - asked) * half * half
        x, y, spin = rotors[i, 0], rotors[i, 1], rotors[i, 3]
        climb = w + p * y - q * x
        thrust = (plane[C0] * middle + plane[C1] * climb) * middle
        drag = max(plane[KT] * thrust + plane[KM] * middle, 0.0)
        fz += thrust
        tx += y * thrust + spin * plane[SPIN_J] * middle * q
        ty += -x * thrust - spin * plane[SPIN_J] * middle * p
        tz += spin * (drag + plane[SPIN_J] * (asked - middle) / plane[TAU])
    # The force belongs to the attitude half a step on: without this the thrust would trail the body by dt / 2.
    h = 0.5 * dt
    gx, gy, gz = fx + h * (q * fz - r * fy), fy + h * (r * fx - p * fz), fz + h * (p * fy - q * fx)
    out[0] = r00 * gx + r01 * gy + r02 * gz
    out[1] = r10 * gx + r11 * gy + r12 * gz
    out[2] = r20 * gx + r21 * gy + r22 * gz
    out[3], out[4], out[5] = tx, ty, tz
