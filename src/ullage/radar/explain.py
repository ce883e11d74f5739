"""Where the echoes of a frame come from: objects, bounces, delays, path gains and points, strongest first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.geometry import C0, quat_matrix
from ullage.radar.physical import Laid, bench, lay, view_of
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

_CELL_M = 0.11  # echoes of one object within this much range, about half a pulse, are told as one


@dataclass(frozen=True, slots=True)
class Contribution:
    """One echo, or several that the pulse cannot part."""

    object: str  # what the wave met last
    bounces: int
    delay_s: float  # round trip [s]
    range_m: float  # delay times c / 2 [m]
    path_gain_db: float  # 20 log10 of sqrt(received / transmitted power), antenna included
    point: tuple[float, float, float]  # on that object, in the world [m]
    phase_rad: float  # of the echo at the carrier [rad]
    via: tuple[str, ...] = ()  # objects that mirrored the wave before

    def __str__(self) -> str:
        path = " > ".join((*self.via, self.object))
        x, y, z = self.point
        many = "s" if self.bounces > 1 else " "
        strength = f"{self.path_gain_db:7.1f} dB  {self.range_m:7.3f} m  {self.bounces} bounce{many}"
        return f"{strength}  {path}  at ({x:.2f}, {y:.2f}, {z:.2f})"


def explain(
    scene_or_frames: Scene | Frames,
    path: Trajectory | RadarSpec | int | None = None,
    radar: RadarSpec | None = None,
    i: int = 0,
    *,
    scene: Scene | None = None,
    max_bounces: int | None = None,
    count: int = 10,
    seed: int | None = None,
) -> list[Contribution]:
    """The strongest contributions to one frame, recomputed from the scene.

    `explain(frames, i)` takes frames as `simulate` gave them, or pieces of them; `explain(frames, i, scene=scene)`
    those of a recording, by their true poses where they hold them; `explain(scene, path, radar, i)` the body's path.

    Args:
        scene_or_frames: the world, or frames seen in it.
        path: the body's trajectory; with frames, the frame's number may stand here.
        radar: which radar.
        i: number of the frame.
        scene: the world of frames that were not simulated here.
        max_bounces: 1 to 3; None: as the frames were simulated, else 1.
        count: how many at most.
        seed: of the fine structure of rough surfaces; None: as the frames were simulated, else 0.

    Raises:
        InputError: something needed is missing, or there is no frame `i`.
    """
    made = None
    if isinstance(scene_or_frames, Frames):
        number = path if isinstance(path, int | np.integer) else i
        made = scene_or_frames.simulated
        world, track, spec = _of_frames(scene_or_frames, scene)
    else:
        if not isinstance(path, Trajectory) or radar is None:
            raise InputError("a scene alone cannot be explained", where="explain",
                             allowed="explain(scene, path, radar, i) or explain(frames, i)")  # fmt: skip
        number, world, spec = i, scene_or_frames, radar
        track = path.mounted(radar.mount.body_from_sensor())
    if max_bounces is None:
        max_bounces = 1 if made is None else made.max_bounces
    if seed is None:
        seed = 0 if made is None else made.seed
    if not -len(track) <= number < len(track):
        raise InputError(f"no frame {number}", where="explain", allowed=f"0 to {len(track) - 1}")
    return contributions(world, track[np.array([number % len(track)])], spec, max_bounces=max_bounces, seed=seed)[
        :count
    ]


def _of_frames(frames: Frames, scene: Scene | None) -> tuple[Scene, Trajectory, RadarSpec]:
    track = frames.truth if frames.truth is not None else frames.poses
    if scene is None and frames.simulated is not None:
        scene = frames.simulated.scene
    if scene is None or track is None:
        what = "the scene" if scene is None else "their poses"
        raise InputError(f"frames cannot be explained without {what}", where="explain",
                         allowed="explain(frames, i, scene=scene)")  # fmt: skip
    return scene, track, frames.spec


def contributions(
    scene: Scene, pose: Trajectory, spec: RadarSpec, *, max_bounces: int = 1, seed: int = 0
) -> list[Contribution]:
    """All contributions at the sensor's one pose, strongest first."""
    ready = bench(scene, spec, seed=seed)
    grids = np.zeros((3, ready.places), complex)
    view = view_of(spec, pose.position[0], quat_matrix(pose.quat_xyzw)[0])
    laid = lay(ready, view, ready.world.poses(pose.t_ns)[0], max_bounces, grids)
    return sorted(_told(_merged(laid), scene), key=lambda c: -c.path_gain_db)


def _merged(laid: Iterable[Laid]) -> Laid:
    """Images and rims together, so that one face's echo is told once."""
    parts = list(laid)
    via = [np.full((len(p.echo), 2), -1, np.int64) if p.via is None else p.via for p in parts]
    return Laid(np.concatenate([p.stuffs for p in parts]), np.concatenate([p.points for p in parts]),
                np.concatenate([p.echo for p in parts]), np.concatenate([p.delay_s for p in parts]),
                np.concatenate(via))  # fmt: skip


def _told(part: Laid, scene: Scene) -> list[Contribution]:
    loud = np.flatnonzero(part.echo != 0)
    if not len(loud) or part.via is None:
        return []
    # grow cells from the loudest echo of each object and chain, so that a peak is never split by a cell's border
    key = np.concatenate([part.stuffs[loud, None], part.via[loud]], axis=1)
    _, group = np.unique(key, axis=0, return_inverse=True)
    ranges = part.delay_s[loud] * C0 / 2
    out = []
    for g in range(int(group.max()) + 1):
        mine = np.flatnonzero(group.ravel() == g)
        mine = mine[np.argsort(-abs(part.echo[loud[mine]]), kind="stable")]
        while len(mine):
            near = abs(ranges[mine] - ranges[mine[0]]) <= _CELL_M
            out.append(_one(part, scene, loud[mine[near]]))
            mine = mine[~near]
    return out


def _one(part: Laid, scene: Scene, rows: NDArray[np.int64]) -> Contribution:
    total = complex(part.echo[rows].sum())
    lead = rows[0]
    delay = float(part.delay_s[lead])
    via = () if part.via is None else tuple(scene.objects[k].name for k in part.via[lead] if k >= 0)
    x, y, z = (float(v) for v in part.points[lead])
    level = float(20 * np.log10(max(abs(total), 1e-30)))
    return Contribution(scene.objects[part.stuffs[lead]].name, 1 + len(via), delay, delay * C0 / 2, level, (x, y, z),
                        float(np.angle(total)), via)  # fmt: skip
