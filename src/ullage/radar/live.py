"""Radars on something that moves as we watch: poses come in as they come, frames come out as they fall due."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage import checks
from ullage.arrays import Floats, Longs
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.radar.receiving import Fidelity, Receiving
from ullage.radar.warmup import warm_up
from ullage.radar.worker_pool import cores
from ullage.specs import RadarSpec, Rig
from ullage.world.moving import Poses, between
from ullage.world.scene import Scene


class LiveRadars:
    """Simulates radars along poses that arrive one by one or in bunches.

    Frame k of a radar is due at k / fps after the first pose, by the poses' own clock; its pose lies between the two
    that came before and after it. So the frames do not depend on how the poses were bunched. A radar with an
    `integration_s` gives a frame once half of that has passed since its stamp.

    Args:
        scene: the world.
        radar: one radar (called "radar"), or several on one body.
        fidelity: "physical" or "thesis".
        max_bounces: 1 to 6.
        seed: of the noise.
        rate_hz: frames a second of every radar; None: each radar's own fps.

    Raises:
        InputError: an argument cannot be used.
    """

    def __init__(
        self,
        scene: Scene,
        radar: RadarSpec | Rig,
        *,
        fidelity: Fidelity = "physical",
        max_bounces: int = 1,
        seed: int = 0,
        rate_hz: float | None = None,
    ) -> None:
        limits = "above 0, at most 10000"
        if rate_hz is not None and checks.number("rate_hz", rate_hz, "LiveRadars", above=0, allowed=limits) > 10_000:
            raise InputError(f"rate_hz is {rate_hz}", where="LiveRadars", allowed=limits)
        warm_up(fidelity, max_bounces, scene)  # a kernel that is compiled in flight makes frames late by seconds
        self._work = Receiving(scene, radar, fidelity=fidelity, max_bounces=max_bounces, seed=seed)
        self.sensors = self._work.sensors
        self._rate_hz = {name: rate_hz or spec.fps for name, spec in self.sensors.items()}
        self._pool = ThreadPoolExecutor(cores())
        self.reset()

    def look_at(self, scene: Scene) -> None:
        """See another world from the next frame on; clock and noise go on."""
        old = self._work
        rig = Rig(sensors=self.sensors, body=old.body)
        self._work = Receiving(scene, rig, fidelity=old.fidelity, max_bounces=old.max_bounces, seed=old.seed)

    def reset(self) -> None:
        """Begin anew, as after a clock that jumped: the next pose is the first."""
        self._first_ns: int | None = None
        self._known: Poses | None = None  # from the last one on that frames not yet given may need
        self._given = dict.fromkeys(self.sensors, 0)

    def skip(self, t_ns: int) -> int:
        """Leave out the frames that are due before the next pose, where they would come too late.

        Args:
            t_ns: time of the next pose [ns].

        Returns:
            Number of frames of all radars.
        """
        left_out = 0
        for name in self.sensors if self._first_ns is not None else ():
            count = len(self._due(name, t_ns - 1))
            self._given[name] += count
            left_out += count
        self._known = None
        return left_out

    def advance(self, t_ns: ArrayLike, position: ArrayLike, quat_xyzw: ArrayLike) -> dict[str, Frames]:
        """Take the body's next poses and give the frames that have fallen due, none of a radar where none has.

        Args:
            t_ns: time or times (n), later than every one before [ns].
            position: of the body (3) or (n, 3), world ENU [m].
            quat_xyzw: world_from_body (4) or (n, 4).

        Raises:
            InputError: the clock does not rise (`reset` first), or a pose is no pose; nothing of it is taken in then.
        """
        poses = self._with_known(*_checked(t_ns, position, quat_xyzw))
        jobs, bodies = {}, dict[bytes, Trajectory]()
        for name, spec in self.sensors.items():
            first = self._given[name]
            due = self._due(name, int(poses[0][-1]) - round(spec.integration_s * 5e8))
            if len(due):
                self._given[name] = first + len(due)
                body = bodies.get(due.tobytes()) or between(poses, due)  # radars of one rate share it
                bodies[due.tobytes()] = body
                jobs[name] = self._pool.submit(self._work.samples, name, body, first_frame=first), body
        oldest = min(self._stamp(name, self._given[name]) for name in self.sensors)
        kept = max(int(np.searchsorted(poses[0], oldest, side="right")) - 1, 0)
        self._known = poses[0][kept:], poses[1][kept:], poses[2][kept:]
        return {name: self._work.frames(name, job.result(), body) for name, (job, body) in jobs.items()}

    def close(self) -> None:
        """Let go of the threads."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _with_known(self, t_ns: Longs, position: Floats, quat: Floats) -> Poses:
        poses = (t_ns, position, quat)
        if self._known is not None:
            before = self._known
            poses = tuple(np.concatenate(pair) for pair in zip(before, poses, strict=True))  # type: ignore[assignment]
        if np.any(np.diff(poses[0]) <= 0):
            raise InputError("the clock of the poses does not rise", where="advance", allowed="reset() after a jump")
        if self._first_ns is None:
            self._first_ns = int(t_ns[0])
        return poses

    def _due(self, name: str, now_ns: int) -> NDArray[np.int64]:
        """Return the stamps of the frames not yet given that are no later than a time [ns]."""
        elapsed_s = (now_ns - self._stamp(name, 0)) * 1e-9
        count = int(elapsed_s * self._rate_hz[name]) + 2  # one too many at most; cut by the clock below
        number = np.arange(self._given[name], max(count, self._given[name]), dtype=np.int64)
        times = self._stamp(name, number)
        return np.asarray(times[times <= now_ns], np.int64)

    def _stamp(self, name: str, number: Any) -> Any:
        """Return the time of a radar's frame of a number, or of some (n) [ns]."""
        return (self._first_ns or 0) + np.rint(number * (1e9 / self._rate_hz[name])).astype(np.int64)


def _checked(t_ns: ArrayLike, position: ArrayLike, quat_xyzw: ArrayLike) -> tuple[Longs, Floats, Floats]:
    """One pose or several as arrays, their quaternions of unit length.

    Raises:
        InputError: shapes differ, or a pose is not finite.
    """
    times = np.atleast_1d(checks.times_ns("t_ns", t_ns))
    place = np.atleast_2d(checks.array("position", position))
    quat = np.atleast_2d(checks.array("quat_xyzw", quat_xyzw))
    shapes = times.shape, place.shape, quat.shape
    count = times.size
    if count == 0 or shapes != ((count,), (count, 3), (count, 4)):
        raise InputError(f"poses of shapes {', '.join(map(str, shapes))}", where="advance",
                         allowed="times (n), positions (n, 3) and quaternions (n, 4), n >= 1")  # fmt: skip
    norm = np.linalg.norm(quat, axis=1, keepdims=True)
    if not np.isfinite(place).all() or not (np.isfinite(norm) & (norm > 0)).all():
        raise InputError("a pose is not finite, or its quaternion is zero", where="advance", allowed="finite poses")
    return times, place, quat if (abs(norm - 1) < 1e-12).all() else quat / norm
