"""Radars on a model of an external simulator: its poses drive the radars, its clock stamps the frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import Field

from ullage.config import Fidelity
from ullage.data import Frames
from ullage.errors import InputError
from ullage.ports.diagnostics import RadarStatus
from ullage.ports.intake import (
    GAP_NS,
    LATE_NS,
    PIECE_S,
    Clock,
    Counters,
    LiveOptions,
    Log,
    Stamped,
    Stream,
    checked_pose,
)
from ullage.ports.live import LiveSource
from ullage.ports.pose_events import DynamicScene, Feed, ModelPose, Notice, OtherModels
from ullage.radar.live import LiveRadars
from ullage.specs import MOST_BOUNCES, Rig
from ullage.world.library import WORLDS
from ullage.world.load import load_scene
from ullage.world.scene import Scene

BEHIND_S = 1.0
"""Report frames that are later than the newest pose by more than this, on the simulator's clock [s]."""


class SensingOptions(LiveOptions):
    """Options of radars that are simulated as a vehicle moves."""

    rig: str = Field("", description="rig preset, or SDF/URDF file of the model; none: as declared, or thesis-4")
    fidelity: Fidelity = "physical"
    max_bounces: int = Field(1, ge=1, le=MOST_BOUNCES)
    seed: int = Field(0, ge=0)
    rate_hz: float | None = Field(None, gt=0, le=10_000, description="frames a second; none: each radar's own")
    duration_s: float | None = Field(None, gt=0, description="ends after this much of the poses' time")

    def radars(self, scene: Scene, rig: Rig) -> LiveRadars:
        """Return these radars in a world, before the first pose."""
        return LiveRadars(
            scene, rig, fidelity=self.fidelity, max_bounces=self.max_bounces, seed=self.seed, rate_hz=self.rate_hz
        )


class RadarOptions(SensingOptions):
    """Options of radars that are simulated along poses from outside."""

    model: str = Field("", description="name of the model that carries the radars; none: the only one that has some")
    world: str = Field("", description="library world or file that the vehicle is in")


class CosimulationOptions(RadarOptions):
    """Options of radars on a model of a simulator."""

    world: str = Field("", description="library world or file that the simulator runs; none: asked of the simulator")
    rays: str = Field(
        "", description="ray or lidar sensors of the model, names with commas or *: frames of their rays, not of ours"
    )
    publish: bool = Field(True, description="give frames back on the simulator's topics")
    host: str = Field("127.0.0.1", description="address of the interface to use")


def matching(rays: str, names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Find the sensors that `rays` names.

    Args:
        rays: names with commas between them; `*` and `?` stand for any characters.
        names: of the sensors that exist.

    Returns:
        The sensors, in the order of `rays`, each once; and the words of `rays` that match none.
    """
    words, there = [word.strip() for word in rays.split(",") if word.strip()], list(names)
    found = {word: [name for name in there if fnmatchcase(name, word)] for word in words}
    return list(dict.fromkeys(name for word in words for name in found[word])), [w for w in words if not found[w]]


class UnboundedSource(LiveSource):
    """A live source that ends by the clock of its frames alone.

    Args:
        duration_s: how long to receive, by the clock of the frames [s]; None: until the peer ends.
        log: takes lines for the user; None: they become warnings.
        lag_s: what is later than this is left out [s]; None: nothing is.
    """

    def __init__(self, duration_s: float | None, log: Log | None, *, lag_s: float | None = None) -> None:
        super().__init__(log=log, lag_s=lag_s)
        self._duration_s = duration_s

    def _without_end(self) -> str:
        return "duration_s=SECONDS" if self._duration_s is None else ""

    def _join(self, join: Callable[[], Feed], topic: str) -> None:
        """Connect to a feed, count with its counters, and track the time of a topic."""
        self._feed = join()
        self.counters = getattr(self._feed, "counters", None) or Counters()
        self.counters.log = self._log
        self._clock, self._streams = Clock(self.counters), list[Stream[Any]]()
        self._intake = self._new_stream(topic)

    def _new_stream(self, topic: str) -> Stream[Any]:
        """Track the time of one more topic on the same clock."""
        self._streams.append(self._clock.stream(topic))
        return self._streams[-1]

    def _over(self) -> bool:
        elapsed_ns = max(stream.elapsed_ns for stream in self._streams)
        return self._duration_s is not None and elapsed_ns >= self._duration_s * 1e9

    def _finish(self) -> None:
        for stream in self._streams:
            stream.finish()


class CosimulationSource(UnboundedSource):
    """Frames of radars on a model of a simulator, simulated as its poses come.

    Frames depend only on the poses and times of the model and of the world's other models. If the simulator's clock
    steps, for example on a reset, the radars begin a new track. The clock of the frames goes on, so that time rises in
    every recording (`intake`). Nothing is computed for the time between two tracks.

    Args:
        join: connects and returns the feed of poses; called when the radars are ready.
        scene: the world without the model.
        rig: the radars on the model.
        options: options of the radars.
        log: takes lines for the user; None: they become warnings.
    """

    name = "radars"
    """Of the status on `/diagnostics`."""
    rest_s = PIECE_S
    """Poses that may stay unused when the stream is stopped [s]."""

    def __init__(
        self, join: Callable[[], Feed], scene: Scene, rig: Rig, options: SensingOptions, *, log: Log | None = None
    ) -> None:
        super().__init__(options.duration_s, log, lag_s=options.lag_s)
        self.scene, self.rig = scene, rig
        self._status = RadarStatus(self.name, late_s=BEHIND_S)
        self._publish = isinstance(options, CosimulationOptions) and options.publish
        self._radars = options.radars(scene, rig)
        self._fastest_hz = options.rate_hz or max(spec.fps for spec in rig.sensors.values())
        self._frame_ns = round(max(spec.integration_s for spec in rig.sensors.values()) * 1e9)
        self._scene = DynamicScene(scene)
        self._waiting: deque[Stamped[ModelPose] | OtherModels] = deque()
        self._early: deque[OtherModels] = deque(maxlen=100)  # beyond a step of the clock that no pose confirms yet
        self._newest_ns: int | None = None  # of the simulator's clock
        self._offset_ns = 0  # added to the simulator's clock
        self._done_ns = -1  # frames exist up to this time
        self._gap = False  # the last poses were left out
        middle = np.tile(scene.bounds.mean(0), (2, 1))
        frame_ns = round(1e9 / self._fastest_hz) + self._frame_ns  # a second frame: it may have another pulse interval
        self.trial = self._radars.advance([0, frame_ns], middle, np.tile((0.0, 0.0, 0.0, 1.0), (2, 1)))
        """Frames of before the first pose: making and using them loads and compiles while nobody waits."""
        self._radars.reset()
        self._join(join, getattr(options, "model", self.name) or "poses")

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""
        return tuple(self.rig.sensors)

    def _step(self, chunk: int, *, stopping: bool) -> Iterator[dict[str, Frames]]:
        poses = self._bunch(chunk)
        self._ended = stopping and not poses
        if not poses or (not stopping and self._left_out(poses)):
            return
        found = self._radars.advance(
            [pose.t_ns for pose in poses],
            [pose.item.position for pose in poses],
            [pose.item.quat_xyzw for pose in poses],
        )
        self._done_ns = poses[-1].t_ns
        self._scene.forget(self._done_ns - self._frame_ns)
        self._log_if_behind()
        self._report_status(found)
        if found:
            if self._publish:
                self._feed.give(found, self._offset_ns)
            yield found
        self._ended = stopping and self.behind_s < self.rest_s

    def _left_out(self, poses: list[Stamped[ModelPose]]) -> bool:
        """Whether frames of these poses would come later than the limit allows; the next ones leave a gap then."""
        if self._limit_s and self._delay_s(poses[-1].t_ns) > self._limit_s:
            self._gap = True
            return True
        if self._gap:
            self._gap = False
            count = self._radars.skip(poses[0].t_ns)
            self.counters.drop("frames", "lost", f"more than {self._limit_s:g} s late", count=count)
        return False

    def _release(self) -> None:
        self._feed.close()
        self._radars.close()

    def _bunch(self, chunk: int) -> list[Stamped[ModelPose]]:
        """Return the waiting poses of at most one chunk; an empty list if none came for a while."""
        poses: list[Stamped[ModelPose]] = []
        length_ns = int(min(max(chunk - 1, 1) / self._fastest_hz, PIECE_S) * 1e9)
        while not poses or poses[-1].t_ns - poses[0].t_ns < length_ns:
            found = self._next(0.0 if poses else 0.5)
            if found is None:
                break
            if isinstance(found, OtherModels):
                if poses and self._scene.changed_by(found):  # earlier poses belong to the scene before this change
                    self._waiting.appendleft(found)
                    break
                self._update_scene(found)
                continue
            if found.starts and poses:  # first the poses before the step
                self._waiting.appendleft(found)
                break
            if found.starts:
                self._begin(found)
            self._newest_ns = found.stamp_ns
            self._scene.stand_until(found.t_ns)
            poses.append(found)
        return poses

    def _next(self, timeout_s: float) -> Stamped[ModelPose] | OtherModels | None:
        """Return the next valid pose or change of other models, or None if none came within the timeout."""
        while not self._waiting:
            found = self._feed.next(timeout_s)
            if found is None:
                return None
            if isinstance(found, Notice):
                self._log_throttled(found.text)
            elif isinstance(found, OtherModels):
                return found
            elif found.t_ns != self._intake.last_ns:  # the same time means a paused simulator
                self._waiting += self._stamped(found)
        return self._waiting.popleft()

    def _stamped(self, found: ModelPose) -> list[Stamped[ModelPose]]:
        pose = checked_pose(found.position, found.quat_xyzw)
        if isinstance(pose, str):
            self.counters.drop(self._intake.topic, "bad", pose)
            return []
        return self._intake.take(found.t_ns, found)

    def _update_scene(self, others: OtherModels) -> None:
        if self._newest_ns is not None and not self._newest_ns - LATE_NS <= others.t_ns <= self._newest_ns + GAP_NS:
            self._early.append(others)
            return
        if self._scene.changed_by(others):
            for text in self._scene.change(others):
                self._log(text)
            self._radars.look_at(self._scene.scene)
        self._scene.see(others, self._offset_ns)

    def _begin(self, found: Stamped[ModelPose]) -> None:
        """Begin a track; the first frame of the radars is due at its first pose."""
        self._offset_ns = found.t_ns - found.stamp_ns
        if not found.track:
            return
        self._radars.reset()
        self._newest_ns = found.stamp_ns
        early, self._early = self._early, deque(maxlen=100)
        for others in early:
            self._update_scene(others)

    @property
    def behind_s(self) -> float:
        """Delay of the frames made so far behind the newest pose [s]."""
        return self._delay_s(self._done_ns)

    def _delay_s(self, done_ns: int) -> float:
        """Return the delay of frames up to a time behind the newest pose [s].

        Poses that wait unread count by this machine's clock, the others by the simulator's.
        """
        newest, waits_s = getattr(self._feed, "newest_ns", 0), getattr(self._feed, "behind_s", 0.0)
        return max((newest + self._offset_ns - done_ns) * 1e-9 if newest else 0.0, waits_s)

    def _report_status(self, found: dict[str, Frames]) -> None:
        """Count the frames for `/diagnostics`; the feed publishes the status if it can."""
        self._status.add(found, self.behind_s)
        status = self._status.message(self._done_ns, self.counters, contacts=self._contacts())
        if status is not None:
            publish = getattr(self._feed, "pass_on", None)
            if publish is None:
                self.passing.give(lambda: [status])
            else:
                publish(status)

    def _contacts(self) -> int:
        """Return how often the vehicle has touched something."""
        return 0

    def _log_if_behind(self) -> None:
        if (behind_s := self.behind_s) > BEHIND_S:
            most_s = self._limit_s
            limit = f"frames later than {most_s:g} s are left out" if most_s else "every frame is still made"
            self._log_throttled(
                f"cannot keep up: {behind_s:.1f} s behind the simulator, which goes on; {limit} "
                "(fidelity=thesis, fewer radars or a lower rate_hz cost less)",
                kind="behind",
            )


def world_of(name: str, *, where: str) -> Scene:
    """Return the scene of a library world or of a world file.

    Raises:
        InputError: there is no such world or file.
    """
    if name in WORLDS:
        return WORLDS[name].scene()
    if not Path(name).suffix:
        raise InputError(f"no world {name!r}", where=where, allowed=f"a world file, or {', '.join(WORLDS)}")
    return load_scene(name, origin_m=(0.0, 0.0, 0.0))  # the peer's poses count from the file's own origin


def rig_of(name: str, scene: Scene | None, model: str, *, where: str) -> Rig:
    """Return the radars of a model: a preset, or as a file or the world, if there is one, declares them, or thesis-4.

    Raises:
        InputError: there is no such preset or file, or the file declares none.
    """
    if not name:
        return (scene and scene.rigs.get(model)) or Rig.preset("thesis-4")
    if name in Rig.presets:
        return Rig.preset(name)
    if not Path(name).suffix:
        raise InputError(f"no rig {name!r}", where=where, allowed=f"{', '.join(Rig.presets)}, or an SDF or URDF file")
    return load_scene(name).rig(model)


def world_and_rig(world: str, options: SensingOptions, *, where: str) -> tuple[Scene, Rig]:
    """Return a world without the model that carries radars, and those radars: the model named, or the first with some.

    Raises:
        InputError: there is no such world, rig or file.
    """
    scene = world_of(world, where=where)
    model = getattr(options, "model", "") or next(iter(scene.rigs), "")
    rig = rig_of(options.rig, scene, model, where=where)
    return scene.without(model) if model in scene.rigs else scene, rig


OptionsT = TypeVar("OptionsT", bound=CosimulationOptions)


def resolved(options: OptionsT, where: str, world: Scene | None = None) -> tuple[OptionsT, Scene, Rig]:
    """Return the options with the model set, the world without the model, and the radars on the model.

    Args:
        options: as given.
        where: for messages.
        world: as the simulator reports it; None: the world that the options name.

    Raises:
        InputError: the world or the model is missing or not valid.
    """
    if world is None:
        if not options.world:
            raise InputError("no world", where=where, allowed="world=NAME or world=FILE")
        world = world_of(options.world, where=where)
    model = options.model or (next(iter(world.rigs)) if len(world.rigs) == 1 else "")
    if not model:
        raise InputError("no model", where=where, allowed=", ".join(f"model={m}" for m in world.rigs) or "model=NAME")
    return options.but(model=model), world.without(model), rig_of(options.rig, world, model, where=where)
