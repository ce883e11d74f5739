"""Motion of a scripted actor: its waypoints as a Trajectory of the actor's frame in the world."""

from __future__ import annotations

import numpy as np

from ullage.data import Trajectory
from ullage.geometry import matrix_quat
from ullage.world.sdf_parse import Node, read_pose

LOOPED_S = 600.0
"""A looped script repeats until this time [s]."""

_RETURN_S = 1e-3  # a loop whose ends differ jumps back, as it does in Gazebo


def read_motion(actor: Node) -> Trajectory | None:
    """Read the actor's motion from time zero, with delay and loop of its script; None without waypoints.

    Raises:
        InputError: the times of the waypoints do not rise from zero.
    """
    script = actor.child("script")
    points = [] if script is None else [p for t in script.children("trajectory") for p in t.children("waypoint")]
    if script is None or not points:
        return None
    times = np.array([point.number("time") for point in points])
    back = np.flatnonzero(np.diff(times, prepend=-1e-12) <= 0)
    if back.size:
        points[int(back[0])].place.refuse("the time of the waypoint does not rise", allowed="rising from 0")
    poses = np.stack([read_pose(point).matrix for point in points])
    delay = script.number("delay_start", 0.0)
    if delay < 0:
        script.place.refuse(f"delay_start is {delay:g}", allowed="0 s or more")
    if script.flag("loop", default=True) and len(points) > 1:
        times, poses = _looped(times, poses, delay)
    times = times + delay
    if times[0] > 0:
        times, poses = np.concatenate([[0.0], times]), np.concatenate([poses[:1], poses])
    return Trajectory(np.rint(times * 1e9).astype(np.int64), poses[:, :3, 3], matrix_quat(poses[:, :3, :3]))


def _looped(times: np.ndarray, poses: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
    period = times[-1] + _RETURN_S + delay
    rounds = min(int(np.ceil(LOOPED_S / period)), 20_000 // len(times) + 1)
    shift = np.arange(max(rounds, 1)) * period
    return (shift[:, None] + times).reshape(-1), np.tile(poses, (len(shift), 1, 1))
