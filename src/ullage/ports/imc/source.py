"""A vehicle on the bus as a source of frames: radars simulated along its way, or those it carries."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Self

from ullage.data import Frames, Trajectory, joined
from ullage.errors import InputError, UllageWarning
from ullage.grids import OccupancyMap
from ullage.ports.imc.gather import Gatherer, Track
from ullage.ports.imc.link import Entity, Identity, Link
from ullage.ports.imc.options import SourceOptions, scene_path
from ullage.ports.imc.places import Pose
from ullage.ports.imc.reach import open_link
from ullage.ports.protocol import one_or_all
from ullage.world.scene import Scene


def warn(text: str) -> None:
    """Say it as a warning."""
    warnings.warn(text, UllageWarning, stacklevel=3)


class ImcSource:
    """Listens to an IMC bus.

    With a world, radars are simulated along the vehicle's poses; without, the frames on the bus are taken.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: what to take.
        say: told of waiting, of peers that go, of clocks that jump.

    Raises:
        InputError: the place or the world cannot be used.
    """

    def __init__(self, place: str, options: SourceOptions, *, say: Callable[[str], None] = warn) -> None:
        self._options, self._say = options, say
        self.scene: Scene | None = None
        self.home: Trajectory | None = None
        self._radars: Any = None
        if options.world:
            from ullage.radar.live import LiveRadars
            from ullage.world.load import load_scene

            self.scene = load_scene(scene_path(options.world))
            self._radars = LiveRadars(
                self.scene, options.radars(), fidelity=options.fidelity, max_bounces=options.max_bounces,
                seed=options.seed, rate_hz=options.rate_hz,
            )  # fmt: skip
        self._track = Track(state=options.state, origin=options.place(), vehicle=options.vehicle, say=say)
        self._gather = Gatherer(self._track)
        me = Identity(options.system_id, options.name, entities=[Entity(1, options.name, "ullage")])
        self._link: Link = open_link(place, options, me, say=say)
        self._seen: list[str] = list(self._radars.sensors) if self._radars else []
        self._behind = False

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars known so far."""
        return tuple(self._seen)

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Frames with poses as they arrive, until the peer ends, the asked duration is over, or Ctrl-C."""
        limit = self._options.duration_s
        first_ns: int | None = None
        for ready in self._arriving():
            out = ready
            if limit is not None and ready:
                start = min(int(f.t_ns[0]) for f in ready.values())
                first_ns = start if first_ns is None else first_ns
                out = {
                    k: f[f.t_ns <= first_ns + limit * 1e9]
                    for k, f in ready.items()
                    if f.t_ns[0] <= first_ns + limit * 1e9
                }
            self._seen += [name for name in out if name not in self._seen]
            yield from pieces(out, chunk)
            if out != ready and len(out) < len(ready):
                return
            if any(len(out[k]) < len(ready[k]) for k in out):
                return

    def _arriving(self) -> Iterator[dict[str, Frames]]:
        told = 0.0
        started = time.monotonic()
        while True:
            packets = self._link.receive(0.25)
            poses: list[Pose] = []
            for packet in packets:
                jumps = self._track.jumps
                pose = self._track.take(packet)
                if self._track.jumps > jumps and self._radars is not None:
                    self._radars.reset()
                    poses.clear()
                if pose is not None:
                    poses.append(pose)
                if self._radars is None:
                    self._gather.take(packet)
            if self._radars is not None and poses:
                yield self._simulated(poses)
            elif self._radars is None and packets:
                yield self._gather.give()
            now = time.monotonic()
            if not self._track.poses and now - max(told, started) > 5.0:
                told = now
                what = f"{self._options.state} of " + (self._options.vehicle or "any vehicle")
                self._say(f"waiting for {what}")
            if self._link.finished and not packets:
                if self._radars is None:
                    yield self._gather.give(final=True)
                return

    def _simulated(self, poses: list[Pose]) -> dict[str, Frames]:
        began = time.monotonic()
        out: dict[str, Frames] = self._radars.advance(
            [p.t_ns for p in poses], [p.position for p in poses], [p.quat_xyzw for p in poses]
        )
        took, span = time.monotonic() - began, (poses[-1].t_ns - poses[0].t_ns) * 1e-9
        if span > 3.0 and took > span and not self._behind:
            self._behind = True
            self._say("the radars take longer than the flight; give rate_hz= or fidelity=thesis to keep up")
        return out

    def frames(self, sensor: str | None = None) -> Frames | dict[str, Frames]:
        """Everything until the peer ends or `duration_s` is over.

        Raises:
            InputError: no frames came, or none of this sensor.
        """
        parts: dict[str, list[Frames]] = {}
        for piece in self.stream():
            for name, part in piece.items():
                parts.setdefault(name, []).append(part)
        if not parts:
            raise InputError("no frames came", where="imc")
        return one_or_all({name: joined(part) for name, part in parts.items()}, sensor)

    def trajectory(self) -> Trajectory | None:
        """The vehicle's way, as far as it is remembered."""
        return self._track.path()

    def map(self) -> OccupancyMap | None:
        """None: nobody sends maps."""
        return None

    def close(self) -> None:
        """Let go of sockets and threads."""
        self._link.close()
        if self._radars is not None:
            self._radars.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def pieces(frames: dict[str, Frames], chunk: int) -> Iterator[dict[str, Frames]]:
    """The frames in pieces of at most `chunk` of each sensor."""
    start = 0
    while part := {name: f[start : start + chunk] for name, f in frames.items() if len(f) > start}:
        yield part
        start += chunk
