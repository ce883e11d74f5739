"""What somebody else's simulator tells: where the model that carries the radars is, where others are, what happens."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from ullage.data import Frames
from ullage.ports.intake import Counters, checked_pose

Quat = tuple[float, float, float, float]
Pose = tuple[tuple[float, float, float], Quat]
"""Position [m] and attitude xyzw in the world."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """Where the model that carries the radars was seen."""

    t_ns: int
    position: tuple[float, float, float]
    quat_xyzw: Quat


@dataclass(frozen=True, slots=True)
class Others:
    """Where other models were seen at a time; those that are not named stand where they stood."""

    t_ns: int
    poses: Mapping[str, Pose] = field(default_factory=dict)  # by name
    gone: frozenset[str] = frozenset()
    new: frozenset[str] = frozenset()  # what the world did not have when it was told


@dataclass(frozen=True, slots=True)
class Note:
    """Something that a person should know: the server has gone, the model is not there."""

    text: str


class Feed(Protocol):
    """Tells where the model is; others are told of before it, at the same time."""

    def next(self, timeout_s: float) -> Sighting | Others | Note | None:
        """The next thing that came, None if nothing did for so long."""

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Hand frames back; their time less the offset is the simulator's."""

    def close(self) -> None:
        """Let go of the sockets."""


Event_co = TypeVar("Event_co", covariant=True)


class Listening(Protocol[Event_co]):
    """A peer among those around a simulator."""

    counters: Counters

    def wait(self, timeout_s: float) -> Event_co | None:
        """The next thing that happened, None if nothing did for so long."""

    def close(self) -> None:
        """Let go of the sockets."""


class EventFeed(ABC, Generic[Event_co]):
    """A feed made of what a peer hears, each event of which may tell several things or none.

    Args:
        peer: what happens.
    """

    def __init__(self, peer: Listening[Event_co]) -> None:
        self._hearing, self.counters = peer, peer.counters
        self._ready: deque[Any] = deque()

    def next(self, timeout_s: float) -> Any:
        """The next pose or scan, or something to say; None if nothing came for so long."""
        end = time.monotonic() + timeout_s
        while not self._ready:
            event = self._hearing.wait(max(0.0, end - time.monotonic()))
            if event is None:
                return self._silence() if timeout_s else None
            last = self._understood(event)
            if last is not None:
                self._ready.append(last)
        return self._ready.popleft()

    def close(self) -> None:
        """Let go of the sockets."""
        self._hearing.close()

    def _understood(self, event: Any) -> Any:
        """What an event tells; a message that cannot be read is counted, whatever its bytes do to who reads them."""
        try:
            return self._take(event)
        except Exception as error:
            topic = getattr(event, "topic", "")
            if not topic:
                raise
            cause = str(error).partition("\n")[0] or type(error).__name__
            self.counters.drop(topic, "bad", f"cannot be read: {cause}")
            return None

    def _placed(self, topic: str, told: Mapping[str, Any]) -> dict[str, Pose]:
        """The poses of other models by name, less those that are none."""
        out = {}
        for name, one in told.items():
            pose = pose_of(one)
            wrong = checked_pose(*pose)
            if isinstance(wrong, str):
                self.counters.drop(topic, "bad", f"{name}: {wrong}")
            else:
                out[name] = pose
        return out

    @abstractmethod
    def _take(self, event: Any) -> Any:
        """What an event tells last, None where nothing; what it tells before that goes to `_ready`."""

    @abstractmethod
    def _silence(self) -> Note | None:
        """Nothing came for a while."""


def pose_of(told: Any) -> Pose:
    """The pose in a message of either Gazebo; an attitude that is not told is none."""
    at, turn = told.position, told.orientation
    quat = (turn.x, turn.y, turn.z, turn.w)
    return (at.x, at.y, at.z), quat if any(quat) else (0.0, 0.0, 0.0, 1.0)


def stamp_ns(told: Any) -> int:
    """The time in a message of either Gazebo [ns]."""
    return int(told.sec) * 10**9 + int(told.nsec)
