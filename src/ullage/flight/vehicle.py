"""Flies a mission with a multirotor in MuJoCo [TodorovEtAl2012] and returns where it truly went."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.data import Trajectory, even_times
from ullage.flight.airframe import GRAVITY_M_S2, Airframe, airframe
from ullage.flight.control import Tables, air
from ullage.flight.missions import Waypoints
from ullage.flight.reference import Reference, plan
from ullage.world.scene import Scene

Floats = NDArray[np.float64]

PHYSICS_HZ = 500
CONTROL_EVERY = 2  # physics steps per control step
CONTROL_HZ = PHYSICS_HZ / CONTROL_EVERY


def fly(
    waypoints: Waypoints | ArrayLike,
    vehicle: str | Airframe = "hector",
    *,
    scene: Scene | None = None,
    wind_m_s: Sequence[float] = (0.0, 0.0, 0.0),
    gust_m_s: float = 0.0,
    rate_hz: float = 25.0,
    seed: int = 0,
    start: ArrayLike | None = None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Flies waypoints with a real multirotor: rigid body, rotor lag, drag, wind, a tracking controller.

    Returns:
        The true path of the body, with true velocities and body rates, at `rate_hz`, from time zero.

    Raises:
        InputError: a value is out of bounds.
    """
    mission = waypoints if isinstance(waypoints, Waypoints) else Waypoints(np.asarray(waypoints))
    frame = airframe(vehicle)
    reference = plan(mission, rate_hz=CONTROL_HZ)
    wind = air(np.asarray(wind_m_s, float), gust_m_s, count=len(reference.track), rate_hz=CONTROL_HZ, seed=seed)
    log = _run(frame, reference, wind, progress)
    return _trajectory(log, rate_hz)


def _model(frame: Airframe) -> Any:
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep = 1 / PHYSICS_HZ
    spec.option.gravity = [0, 0, -GRAVITY_M_S2]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    body = spec.worldbody.add_body(name=frame.name)
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.inertia = frame.mass_kg, frame.inertia_kg_m2
    return spec.compile()


def _run(frame: Airframe, reference: Reference, wind: Floats, progress: Callable[[float], None] | None) -> Floats:
    import mujoco

    from ullage.kernels.flight import advance

    tables = Tables.of(frame)
    model = _model(frame)
    data = mujoco.MjData(model)
    first = reference.track[0]
    data.qpos[:] = [*first[:3], math.cos(first[12] / 2), 0, 0, math.sin(first[12] / 2)]
    memory = tables.memory(frame.hover_rad_s)
    steps = (len(reference.track) - 1) * CONTROL_EVERY + 1
    log = np.zeros((len(reference.track), 13 + len(tables.rotors)))
    qpos, qvel, force, dt = data.qpos, data.qvel, data.qfrc_applied, 1 / PHYSICS_HZ
    for step in range(steps):
        advance(
            step, CONTROL_EVERY, qpos, qvel, memory, tables.plane, tables.gains, tables.mixer, tables.rotors,
            reference.track, wind, log, dt, force,
        )  # fmt: skip
        mujoco.mj_step(model, data)
        if progress is not None and step % PHYSICS_HZ == 0:
            progress(step / steps)
    if progress is not None:
        progress(1.0)
    return log


def _trajectory(log: Floats, rate_hz: float) -> Trajectory:
    quat = log[:, [4, 5, 6, 3]]
    t_ns = even_times(CONTROL_HZ, count=len(log))
    whole = Trajectory(t_ns, log[:, :3], quat, log[:, 7:10], log[:, 10:13])
    return whole.resampled(rate_hz)
