"""The vehicle on the test bench: the engine and the wrench alone, without controller or mission."""

from __future__ import annotations

import mujoco
import numpy as np

from ullage.flight.airframe import Airframe
from ullage.flight.control import Tables
from ullage.flight.physics import PHYSICS_HZ, body_spec
from ullage.kernels.flight import wrench


def let_go(
    frame: Airframe,
    seconds: float,
    *,
    rotors=0.0,
    asked=None,
    velocity=(0, 0, 0),
    spin=(0, 0, 0),
    wind=(0, 0, 0),
):
    """Pose (n, 7), velocity (n, 6) and rotor speeds (n, r) at every physics step, rotor commands held."""
    tables = Tables.of(frame)
    data = mujoco.MjData(body_spec(frame).compile())
    data.qvel[:] = [*velocity, *spin]
    memory = tables.memory(0.0)
    count = len(tables.rotors)
    memory[3 + count :] = rotors
    memory[3 : 3 + count] = rotors if asked is None else asked
    rows = []
    for _ in range(round(seconds * PHYSICS_HZ)):
        rows.append(np.concatenate([data.qpos, data.qvel, memory[3 + count :]]))
        wrench(data.qpos, data.qvel, memory, tables.plane, tables.rotors, np.array(wind, float), 1 / PHYSICS_HZ,
               data.qfrc_applied)  # fmt: skip
        mujoco.mj_step(data.model, data)
    table = np.asarray(rows)
    return table[:, :7], table[:, 7:13], table[:, 13:]
