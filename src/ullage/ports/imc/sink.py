"""Frames given to the bus, so that DUNE's tasks and Neptus see each radar like any other sensor."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Self

from ullage.data import Floats, Frames, Trajectory
from ullage.errors import UllageWarning
from ullage.geometry import invert
from ullage.ports.imc import radars
from ullage.ports.imc.codec import Message, make
from ullage.ports.imc.link import Entity, Identity, Link
from ullage.ports.imc.options import SinkOptions
from ullage.ports.imc.places import Pose, poses_along, state_of
from ullage.ports.imc.reach import open_link
from ullage.ports.imc.source import warn
from ullage.ports.protocol import Item

FIRST_RADAR = 10
SETTINGS_EVERY_S = 5.0
EPOCH_S = 1e9  # earlier than 2001: a clock that began with the flight


class ImcSink:
    """Speaks on an IMC bus.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: what to give.
        say: told of waiting and of peers that go.

    Raises:
        InputError: the place cannot be used.
    """

    def __init__(self, place: str, options: SinkOptions, *, say: Callable[[str], None] = warn) -> None:
        self._options, self._labels = options, options.entity_labels()
        self._origin = options.home()
        me = Identity(
            options.system_id, options.name, entities=[Entity(1, options.name, "ullage")], lat_rad=self._origin.lat_rad,
            lon_rad=self._origin.lon_rad, height_m=self._origin.height_m,
        )  # fmt: skip
        self._link: Link = open_link(place, options, me, say=say)
        self._entity: dict[str, int] = {}
        self._count: dict[str, int] = {}
        self._told: set[str] = set()
        self._settled: dict[str, float] = {}
        self._start: tuple[float, float] | None = None  # wall clock and stream clock of the first frame [s]
        self._epoch_s = 0.0  # added to times that do not count from 1970 [s]

    def write(self, item: Item) -> None:
        """Give frames and chunks of them; everything else passes by."""
        if isinstance(item, Frames):
            self._give({item.sensor: item})
        elif isinstance(item, Mapping):
            self._give(item)
        elif isinstance(item, Trajectory) and self._options.state != "off":
            self._paced((p.t_ns, 1, self._state(p)) for p in poses_along(item))

    def _give(self, chunk: Mapping[str, Frames]) -> None:
        notes = [note for name, frames in chunk.items() for note in self._notes(name, frames)]
        notes.sort(key=lambda note: note[0])
        self._paced(iter(notes))

    def _notes(self, name: str, frames: Frames) -> Iterator[tuple[int, int, Message]]:
        """Messages of one sensor with their times and its entity."""
        entity = self._entity.get(name) or self._enter(name)
        start = self._count.get(name, 0)
        self._count[name] = start + len(frames)
        t_ns = frames.t_ns.tolist()
        o = self._options
        if o.exact:
            notes = radars.exact(frames, start, truth=o.truth)
            if not notes and name not in self._told:
                self._told.add(name)
                warnings.warn(
                    f"{name}: a frame is too long for a packet of IMC; only profiles go", UllageWarning, stacklevel=4
                )
            if notes and time.monotonic() - self._settled.get(name, -1e9) > SETTINGS_EVERY_S:
                self._settled[name] = time.monotonic()
                yield t_ns[0] - 1, entity, radars.settings(frames)
            yield from zip(t_ns, [entity] * len(t_ns), notes, strict=bool(notes))
        if o.profile:
            yield from zip(t_ns, [entity] * len(t_ns), radars.profiles(frames), strict=True)
        if o.distance != "off":
            yield from zip(t_ns, [entity] * len(t_ns), radars.distances(frames), strict=True)
        if o.state != "off" and frames.poses is not None and entity == FIRST_RADAR:
            body = frames.poses.mounted(_inverse(frames))
            yield from ((p.t_ns, 1, self._state(p)) for p in poses_along(body))

    def _enter(self, name: str) -> int:
        """A new radar becomes an entity of ours."""
        number = FIRST_RADAR + len(self._entity)
        self._entity[name] = number
        self._link.enter(Entity(number, self._labels.get(name, name), "ullage.radar"))
        return number

    def _state(self, pose: Pose) -> Message:
        fields: dict[str, Any] = state_of(pose, self._origin)
        if self._options.state == "SimulatedState":
            fields = {key: value for key, value in fields.items() if key not in ("vx", "vy", "vz", "depth", "alt")}
        return make(self._options.state, **fields)

    def _paced(self, notes: Iterator[tuple[int, int, Message]]) -> None:
        """Send each when its time has come: stream time runs `pace` times as fast as the wall's."""
        pace = self._options.pace
        for t_ns, entity, message in notes:
            t_s = t_ns * 1e-9
            if self._start is None:
                self._start = (time.monotonic(), t_s)
                self._epoch_s = 0.0 if t_s > EPOCH_S else time.time() - t_s
            if pace > 0:
                due = self._start[0] + (t_s - self._start[1]) / pace
                if (wait := due - time.monotonic()) > 0:
                    time.sleep(min(wait, 60.0))
            self._link.send(message, entity=entity, t_s=self._epoch_s + t_s)

    def close(self) -> None:
        """Send what is queued, if the peer takes it, and let go of the sockets."""
        self._link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _inverse(frames: Frames) -> Floats:
    return invert(frames.spec.mount.body_from_sensor())
