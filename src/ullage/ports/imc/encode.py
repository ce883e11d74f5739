"""Encode frames and paths as IMC messages in order of time, for a bus or a log."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.errors import UllageWarning
from ullage.geometry import invert
from ullage.ports.geodetic import Geodetic
from ullage.ports.imc import radars
from ullage.ports.imc.codec import Message, make
from ullage.ports.imc.geodetic import poses_along, state_of
from ullage.ports.imc.link import Entity
from ullage.ports.imc.options import MessageOptions
from ullage.ports.protocol import Item

BODY = 1
FIRST_RADAR = 10
SETTINGS_EVERY_NS = 5_000_000_000
NOT_SIMULATED = ("vx", "vy", "vz", "depth", "alt")


class TimedMessage(NamedTuple):
    """A message with its time and entity."""

    t_ns: int
    entity: int
    message: Message


class MessageEncoder:
    """Encode frames and paths as messages.

    Args:
        options: select the messages.
        origin: geodetic place of the world's origin.
        enter: called with each radar that becomes an entity.
    """

    def __init__(self, options: MessageOptions, origin: Geodetic, enter: Callable[[Entity], None]) -> None:
        self._options, self._origin, self._enter = options, origin, enter
        self._labels = options.entity_labels()
        self._entity: dict[str, int] = {}
        self._count: dict[str, int] = {}
        self._settled: dict[str, int] = {}
        self._reported: set[str] = set()

    def messages(self, item: Item) -> list[TimedMessage]:
        """Return the messages of frames, of a chunk of frames, or of the body's path; other items give none."""
        if isinstance(item, Frames):
            item = {item.sensor: item}
        if isinstance(item, Mapping):
            found = [one for name, frames in item.items() for one in self._of(name, frames)]
            return sorted(found, key=lambda one: one.t_ns)
        if isinstance(item, Trajectory) and self._options.state and not self._entity:
            return self._states(item, "EstimatedState")
        return []  # the frames have already given the poses

    def _of(self, name: str, frames: Frames) -> list[TimedMessage]:
        entity = self._entity.get(name)
        if entity is None:
            entity = self._entity[name] = FIRST_RADAR + len(self._entity)
            self._enter(Entity(entity, self._labels.get(name, name), "ullage.radar"))
        o, out = self._options, []
        if o.state and entity == FIRST_RADAR:
            out += self._of_body(frames)
        if o.exact:
            out += self._exact(name, entity, frames)
        if o.profile:
            out += self._each(entity, frames, radars.profiles(frames))
        if o.distance != "off":
            out += self._each(entity, frames, radars.distances(frames))
        return out

    def _each(self, entity: int, frames: Frames, messages: list[Message]) -> list[TimedMessage]:
        return [TimedMessage(t, entity, m) for t, m in zip(frames.t_ns.tolist(), messages, strict=True)]

    def _exact(self, name: str, entity: int, frames: Frames) -> list[TimedMessage]:
        start = self._count.get(name, 0)
        self._count[name] = start + len(frames)
        messages = radars.exact(frames, start, truth=self._options.truth)
        if not messages:
            if name not in self._reported:
                self._reported.add(name)
                warnings.warn(
                    f"{name}: a frame is too long for a packet of IMC; only profiles go", UllageWarning, stacklevel=5
                )
            return []
        out = self._each(entity, frames, messages)
        first = int(frames.t_ns[0])
        if first - self._settled.get(name, -(2**62)) >= SETTINGS_EVERY_NS:  # for peers that join later
            self._settled[name] = first
            out.insert(0, TimedMessage(first, entity, radars.settings(frames)))
        return out

    def _of_body(self, frames: Frames) -> list[TimedMessage]:
        body_from_sensor = frames.spec.mount.body_from_sensor()
        out = []
        if frames.poses is not None:
            out += self._states(_body(frames.poses, body_from_sensor), "EstimatedState")
        if frames.truth is not None and self._options.truth:
            out += self._states(_body(frames.truth, body_from_sensor), "SimulatedState")
        return out

    def _states(self, path: Trajectory, kind: str) -> list[TimedMessage]:
        out = []
        for pose in poses_along(path):
            fields: dict[str, Any] = state_of(pose, self._origin)
            if kind == "SimulatedState":
                fields = {key: value for key, value in fields.items() if key not in NOT_SIMULATED}
            out.append(TimedMessage(pose.t_ns, BODY, make(kind, **fields)))
        return out


def _body(sensor: Trajectory, body_from_sensor: Floats) -> Trajectory:
    return sensor.mounted(invert(body_from_sensor))
