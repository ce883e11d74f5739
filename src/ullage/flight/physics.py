"""The vehicle in MuJoCo: free in the air, or among the triangles and wires within its reach.

Far from everything the engine holds the vehicle alone. When its distance to a surface runs out, a model with the nearby
triangles (one rigid `flex` per body, so concave meshes keep their shape) and wires
(capsules) takes over; the state goes on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.data import even_times
from ullage.flight.airframe import Airframe
from ullage.flight.obstacles import Body
from ullage.geometry import GRAVITY_M_S2, matrix_quat

PHYSICS_HZ = 500
CONTROL_EVERY = 2  # physics steps per control step
CONTROL_HZ = PHYSICS_HZ / CONTROL_EVERY

_STIFF = [0.005, 1.0]  # contact's time constant [s] and damping ratio
_SLACK = 0.25  # [m] length of flight on one set of nearby triangles
_ALERT = 0.10  # [m] beyond the vehicle's radius, where contact is looked for


@dataclass(slots=True)
class Touch:
    """The vehicle against one object, from first contact to last."""

    step: int  # control step of the first contact
    last: int  # control step of the last
    point: tuple[float, float, float]  # [m] world
    owner: int  # object
    speed: float  # [m/s] of the vehicle at first contact


def body_spec(frame: Airframe) -> Any:
    """The engine's description of the vehicle: one rigid body, a hull and a disc for each rotor.

    Against a triangle without thickness the engine finds no sure direction once something is in it. So the world wears
    the vehicle's skin: its shapes are drawn that much smaller, and triangles and wires are that much thicker.
    """
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep = 1 / PHYSICS_HZ
    spec.option.gravity = [0, 0, -GRAVITY_M_S2]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    body = spec.worldbody.add_body(name=frame.name)
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.inertia = frame.mass_kg, frame.inertia_kg_m2
    solid = {"friction": [0.4, 0.005, 0.0001], "solref": _STIFF}
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[edge / 2 - frame.skin_m for edge in frame.core_m], **solid)
    for place in frame.rotor_position_m:
        disc = [frame.rotor_radius_m - frame.skin_m, frame.rotor_half_height_m - frame.skin_m, 0]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=disc, pos=place, **solid)
    return spec


class CollisionModel:
    """Keep the physics engine's model matched to the bodies near the vehicle.

    Args:
        frame: the vehicle.
        parts: bodies that the vehicle can hit.
        count: control steps of the flight, for the poses of moving bodies.
    """

    def __init__(self, frame: Airframe, parts: list[Body], count: int) -> None:
        import mujoco

        self._engine, self._frame, self._parts = mujoco, frame, parts
        self._free = mujoco.MjData(body_spec(frame).compile())
        self.data = self._free
        self.near = False
        self.touches: list[Touch] = []
        self._open: dict[int, Touch] = {}
        self._poses = [_poses(part, count) for part in parts]
        # Where the distance to each part was last measured, and how far the vehicle may move from there [m].
        full = [k for k, part in enumerate(parts) if len(part.corners) + len(part.wires)]
        self._clearance = dict.fromkeys(full, (0.0, 0.0, 0.0, -1.0))
        self._before = [0.0, 0.0, 0.0]
        self._flexes: list[tuple[int, Longs]] = []  # part, and its triangles
        self._wires: dict[int, tuple[int, int]] = {}  # of each capsule: part, and wire past its triangles
        self._mocap: list[tuple[int, int]] = []

    @property
    def model(self) -> Any:
        """The engine's present model."""
        return self.data.model

    def update(self, row: int) -> bool:
        """Update the model for a control step; return whether the model was replaced."""
        x, y, z = self.data.qpos[:3].tolist()
        if self.near:
            self._before = self.data.qvel[:3].tolist()
        stale = False
        for k, (ax, ay, az, slack) in self._clearance.items():
            if self._parts[k].motion is None:
                dx, dy, dz = x - ax, y - ay, z - az
            else:
                here = self._local(k, np.array([x, y, z]), row)
                dx, dy, dz = here[0] - ax, here[1] - ay, here[2] - az
            stale = stale or not dx * dx + dy * dy + dz * dz <= slack * abs(slack)
        if stale:
            self._survey(np.array([x, y, z]), row)
        for k, body in self._mocap:
            rotation, place = self._poses[k][0][row], self._poses[k][1][row]
            self.data.mocap_pos[body] = place
            self.data.mocap_quat[body] = matrix_quat(rotation)[[3, 0, 1, 2]]
        return stale

    def _local(self, k: int, position: Floats, row: int) -> Floats:
        if self._parts[k].motion is None:
            return position
        rotation, place = self._poses[k][0][row], self._poses[k][1][row]
        return np.asarray(rotation.T @ (position - place))

    def _survey(self, position: Floats, row: int) -> None:
        alert = self._frame.radius_m + _ALERT
        chosen: list[tuple[int, Longs]] = []
        for k in self._clearance:
            here = self._local(k, position, row)
            index, gap, _ = self._parts[k].gaps(here, alert + _SLACK)
            close = index[gap < alert + _SLACK]
            slack = _SLACK
            if len(close):
                chosen.append((k, close))
            else:
                slack = max(float(gap.min()) - alert, _SLACK)
            self._clearance[k] = (*here.tolist(), slack)
        self._exchange(chosen)

    def _exchange(self, chosen: list[tuple[int, Longs]]) -> None:
        old = self.data
        self.near = bool(chosen)
        self._mocap, self._flexes, self._wires = [], [], {}
        self.data = self._engine.MjData(self._build(chosen)) if chosen else self._free
        if self.data is not old:
            self.data.time = old.time
            self.data.qpos[:], self.data.qvel[:] = old.qpos, old.qvel
            self.data.qacc_warmstart[:] = old.qacc_warmstart

    def _build(self, chosen: list[tuple[int, Longs]]) -> Any:
        spec = body_spec(self._frame)
        strung: dict[str, tuple[int, int]] = {}
        for k, close in chosen:
            part = self._parts[k]
            home = spec.worldbody
            if part.motion is not None:
                home = spec.worldbody.add_body(name=f"part{k}", mocap=True)
                self._mocap.append((k, len(self._mocap)))
            faces = close[close < len(part.corners)]
            if len(faces):
                flex = spec.add_flex(name=f"part{k}", dim=2, radius=self._frame.skin_m, selfcollide=0)
                flex.solref = _STIFF
                flex.vertbody = [home.name]
                flex.vert = part.corners[faces].ravel().tolist()
                flex.elem = list(range(3 * len(faces)))
                self._flexes.append((k, faces))
            for wire in close[close >= len(part.corners)] - len(part.corners):
                name = f"wire{k}.{wire}"
                strung[name] = (k, int(wire) + len(part.corners))
                radius = float(part.wire_radius[wire]) + self._frame.skin_m
                capsule = self._engine.mjtGeom.mjGEOM_CAPSULE
                ends = part.wires[wire].ravel()
                home.add_geom(name=name, type=capsule, fromto=ends, size=[radius, 0, 0], solref=_STIFF)
        model = spec.compile()
        self._wires = {model.geom(name).id: place for name, place in strung.items()}
        return model

    def record_contacts(self, row: int) -> None:
        """Record the contacts of the last step."""
        for contact in self.data.contact:
            k, index = self._hit(contact)
            owner = self._parts[k].owner_of(index)
            known = self._open.get(owner)
            if known is None or row - known.last > CONTROL_HZ / 4:  # a bounce within a quarter second is one contact
                touch = Touch(row, row, self._surface(k, index, contact.pos, row), owner, math.hypot(*self._before))
                self._open[owner] = touch
                self.touches.append(touch)
            else:
                known.last = row

    def _hit(self, contact: Any) -> tuple[int, int]:
        """Part, and triangle or wire in it (counted past the triangles), of a contact."""
        for flex, element in zip(contact.flex, contact.elem, strict=True):
            if flex >= 0:
                k, faces = self._flexes[flex]
                return k, int(faces[element])
        return next(self._wires[int(geom)] for geom in contact.geom if int(geom) in self._wires)

    def _surface(self, k: int, index: int, point: Floats, row: int) -> tuple[float, float, float]:
        """Return the point of a triangle or wire nearest to a contact, which lies in the skin around it [m] world."""
        part = self._parts[k]
        near, _, spots = part.gaps(self._local(k, np.array(point), row), 4 * self._frame.skin_m)
        spot = spots[np.flatnonzero(near == index)[0]]
        if part.motion is not None:
            spot = self._poses[k][0][row] @ spot + self._poses[k][1][row]
        x, y, z = (float(v) for v in spot)
        return x, y, z


def _poses(part: Body, count: int) -> tuple[Floats, Floats]:
    """Rotation (n, 3, 3) and place (n, 3) of a moving body at every control step."""
    if part.motion is None:
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    times = np.clip(even_times(CONTROL_HZ, count=count), part.motion.t_ns[0], part.motion.t_ns[-1])
    known, row = np.unique(times, return_inverse=True)
    pose = part.motion.at(known).world_from_body[row]
    return pose[:, :3, :3], pose[:, :3, 3]
