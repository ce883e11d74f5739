"""Poses and scans of a model that a Gazebo runs; `transport_source` and `classic_source` read its messages."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from typing import Any

from ullage.data import Frames
from ullage.ports.cosimulation import CosimulationOptions
from ullage.ports.gazebo.peer import Peer
from ullage.ports.gazebo.topics import RadarTopics
from ullage.ports.pose_events import EventFeed, ModelPose, Notice, pose_of


class Feed(EventFeed):
    """Poses of one model and of other models from a Gazebo, or scans of its rays, and notices about the server.

    Args:
        peer: the connection to Gazebo.
        options: name the model and its sensors.
        world: Gazebo's name of the world; empty: the first that is found.
        others: names of the world's other models.
        patience_s: after how long a silence that is reported [s].
    """

    server: str
    """What the user calls it."""

    def __init__(
        self, peer: Peer, options: CosimulationOptions, world: str, others: frozenset[str], *, patience_s: float
    ) -> None:
        super().__init__(peer, patience_s=patience_s)
        self._peer, self.world, self.newest_ns = peer, world, 0
        self._model, self._rays = options.model, options.rays
        self._others = frozenset() if options.rays else others - {options.model}  # rays meet them without our help
        self._known = self._paused = False  # the model was there; the server is paused
        self._scans: dict[str, str] = {}  # name of the ray sensor by its topic
        self._topics: RadarTopics | None = None

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Publish frames."""
        if self._topics is None:
            self._topics = self._radar_topics()
        for frames in chunk.values():
            self._topics.write(frames, offset_ns)

    @abstractmethod
    def _radar_topics(self) -> RadarTopics:
        """Return the topics of the model's radars."""

    def _seen(self, t_ns: int, pose: Any) -> ModelPose:
        self.newest_ns, self._known = t_ns, True
        return ModelPose(t_ns, *pose_of(pose))

    def _new_models(self, names: Iterable[str]) -> frozenset[str]:
        return frozenset(names) - self._others - {self._model}

    def _pause(self, stats: Any) -> Notice | None:
        """Report that the server is paused or goes on."""
        if stats.paused == self._paused:
            return None
        self._paused = bool(stats.paused)
        return Notice(f"{self.server} {'is paused' if self._paused else 'goes on'}")

    def _model_gone(self) -> Notice:
        return Notice(f"the model {self._model!r} has gone from {self.server}; waiting for it to come back")

    def _server_gone(self) -> Notice:
        return Notice(f"{self.server} has gone; waiting for it to come back (Ctrl-C ends)")
