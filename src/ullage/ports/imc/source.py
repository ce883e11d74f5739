"""A vehicle on the bus as a source of frames: radars simulated along its path, or radars that it carries.

Its poses alone place the frames of radars that another port gives.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.flight.missions import Waypoints
from ullage.ports.cosimulation import rig_of, world_of
from ullage.ports.drone import Drone, DroneOptions, Guided, Limits
from ullage.ports.imc.assemble import FrameAssembler, Track
from ullage.ports.imc.backseat import Backseat
from ullage.ports.imc.broker import passed
from ullage.ports.imc.codec import Packet
from ullage.ports.imc.helm import Helm, Simulated, Vehicle
from ullage.ports.imc.link import Link, Role, leave, open_link
from ullage.ports.imc.options import PoseOptions, SourceOptions
from ullage.ports.imc.wires import own_identity
from ullage.ports.intake import PATIENCE_S, PIECE_S, Covered, Inbox, Log, Once, warn
from ullage.ports.live import Address, LiveSource, point_of
from ullage.ports.ned import TRONDHEIM
from ullage.ports.pose_events import BodyState
from ullage.ports.protocol import pieces
from ullage.radar.live import LiveRadars


class ImcSource(LiveSource):
    """Receive frames from an IMC bus.

    With a world, the source simulates radars along the vehicle's poses. Without one, it takes the frames on the bus.
    With a mission, it leads the vehicle along the waypoints. With `fly`, it is the vehicle.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: select what is received.
        log: takes lines for the user.

    Raises:
        InputError: the place or the world is not valid.
    """

    where = "imc"
    settings = SourceOptions

    def __init__(self, place: str, options: SourceOptions, *, log: Log = warn) -> None:
        super().__init__(log=log, lag_s=options.lag_s)
        self._options = options
        self._radars: LiveRadars | None = None
        self._seen: list[str] = []
        self._once, self._begun_s = Once(log), time.monotonic()
        self._limit_s, self._lost = options.lag, 0
        points, start = options.waypoints(), point_of(options.start, "start", where=self.where, yaw=True)
        self._flown = Covered()
        if options.world:
            self._build()
        vehicle = self._vehicle(start) if options.fly else None
        self._role: Role = "vehicle" if vehicle is not None else "source"
        self._link: Link = open_link(place, options, own_identity(options), role=self._role, log=log)
        self.counters = self._link.counters
        self.counters.log = log
        self._track = Track(self.counters, state=options.state, origin=options.place(), vehicle=options.vehicle)
        self._assembler = FrameAssembler(self._track, log)
        self._flight = self._take_off(vehicle) if vehicle is not None else None
        self._inbox: Inbox[Any] = self._link.events if self._flight is None else self._flight.inbox
        self._backseat = self._lead_vehicle(points) if points else None

    def _build(self) -> None:
        options = self._options
        self.scene = world_of(options.world, where=self.where)
        self._radars = options.radars(self.scene, rig_of(options.rig, self.scene, "", where=self.where))
        self._seen = list(self._radars.sensors)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars known so far."""
        return tuple(self._seen)

    def _pieces(self, ready: dict[str, Frames], chunk: int) -> Iterator[dict[str, Frames]]:
        self._seen += [name for name in ready if name not in self._seen]
        return pieces(ready, chunk)

    def _over(self) -> bool:
        """Whether the duration is over, by the clock of the poses."""
        limit = self._options.duration_s
        return limit is not None and self._flown.total_s > limit

    def _vehicle(self, start: tuple[float, ...]) -> Vehicle:
        """Open our own multirotor or an external drone."""
        o = self._options
        address = Address.of(o.fly)
        if address is None:
            return Simulated(o.fly, scene=self.scene, start=start, rate_hz=o.state_hz, pace=o.pace, log=self._log)
        made: Any = address.part("drone")
        if made is None or not issubclass(made.settings, DroneOptions):
            raise InputError(f"no drone at {o.fly!r}", where="fly", allowed="a vehicle, ros2:NAMESPACE, gazebo:MODEL")
        if o.takes not in made.takes:
            raise InputError(made.refusal, where=o.fly, allowed=f"takes={made.takes[0]}")
        drone: Drone = made(address.place, o)
        return Guided(drone, o.takes, Limits(level_m_s=o.limit_m_s), log=self._log)

    def _take_off(self, vehicle: Vehicle) -> Helm:
        home = self._track.origin = self._options.place() or TRONDHEIM
        return Helm(vehicle, self._link, home, self._options, log=self._log, take=self._relay, passing=self.passing)

    def _lead_vehicle(self, points: list[tuple[float, ...]]) -> Backseat:
        o = self._options
        mission = Waypoints(np.array(points), speed_m_s=o.speed_m_s)
        return Backseat(self._link, mission, z=o.z, near_m=o.near_m, log=self._log)

    def _step(self, chunk: int, *, stopping: bool) -> Iterator[dict[str, Frames]]:
        tracks, received = self._tracks()
        for ready in self._made(tracks, received):
            yield from self._pieces(ready, chunk)
        if not self._track.poses and time.monotonic() - self._begun_s > PATIENCE_S:
            what = f"{self._options.state} of " + (self._options.vehicle or "any vehicle")
            flown = "the drone's odometry" if self._link.connected else "a controller"
            self._log_throttled(f"waiting for {what if self._flight is None else flown}", kind="waiting")
        finished = self._backseat is not None and self._backseat.finished
        no_more = (self._link.finished or stopping) and not len(self._link.events)
        self._ended = finished or self._over() or (no_more and (stopping or not received))
        if self._ended and self._radars is None:
            yield from self._pieces(self._assembler.give(final=True), chunk)

    def _finish(self) -> None:
        self._track.finish()

    def _made(self, tracks: list[list[BodyState]], received: bool) -> Iterator[dict[str, Frames]]:
        """Give the frames that are ready: simulated along the poses, or received."""
        if self._radars is None:
            if received:
                yield self._assembler.give()
            return
        for number, poses in enumerate(tracks):
            if number:
                self._radars.reset()
            if poses:
                self._skip_lost(poses[0].t_ns)
                yield self._simulated(self._radars, poses)

    def _tracks(self) -> tuple[list[list[BodyState]], bool]:
        """Return the vehicle's next poses, one list for each track, and whether any message came."""
        if self._flight is not None:
            flown = self._flight.poses(0.25)
            self._track.poses.extend(flown)
            self._flown.take([pose.t_ns for pose in flown])
            return [flown], bool(flown)
        tracks: list[list[BodyState]] = [[]]
        received = False
        for packet in self._link.arriving(0.25):
            received = True
            for found in self._track.take(packet):
                if found.starts and found.track:
                    tracks.append([])
                tracks[-1].append(found.item)
                self._flown.take(found.t_ns)
            self._pass_on(packet)
            poses = tracks[-1]
            if self._radars is not None and poses and (poses[-1].t_ns - poses[0].t_ns) * 1e-9 >= PIECE_S:
                break  # frames of a longer piece would be late by as long as they take
        track, backseat = self._track, self._backseat
        if backseat is not None and track.poses and track.followed is not None and track.origin is not None:
            backseat.lead(track.followed, track.poses[-1], track.origin)
        return tracks, received

    def _pass_on(self, packet: Packet) -> None:
        """Give a packet to the relay, the frame assembler and the backseat."""
        self._relay(packet)
        if self._radars is None:
            self._assembler.take(packet)
        if self._backseat is not None:
            self._backseat.take(packet)

    def _relay(self, packet: Packet) -> None:
        """Pass a packet on, as it came."""
        if self._options.relay and packet.src != self._options.system_id:
            known = self._track.poses
            at_ns = known[-1].t_ns if known else time.time_ns()
            self.passing.give(partial(passed, packet, at_ns, typed=self._options.typed))

    def _skip_lost(self, t_ns: int) -> None:
        """Leave out the frames along poses that were dropped because they waited too long."""
        if self._radars is not None and (lost := self._inbox.lost) > self._lost:
            self._lost = lost
            count = self._radars.skip(t_ns)
            self.counters.drop("frames", "lost", f"more than {self._limit_s:g} s late", count=count)

    def _simulated(self, radars: LiveRadars, poses: list[BodyState]) -> dict[str, Frames]:
        began = time.monotonic()
        out = radars.advance([p.t_ns for p in poses], [p.position for p in poses], [p.quat_xyzw for p in poses])
        took, span = time.monotonic() - began, (poses[-1].t_ns - poses[0].t_ns) * 1e-9
        if span > 3.0 and took > span:
            self._once("the radars take longer than the flight; give rate_hz= or fidelity=thesis to keep up")
        return out

    def trajectory(self) -> Trajectory | None:
        """Return the vehicle's path, as far as it is kept."""
        return self._track.path()

    def _release(self) -> None:
        if self._backseat is not None:
            self._backseat.release()
        if self._flight is not None:
            self._flight.close()
        leave(self._link, self._role)
        if self._radars is not None:
            self._radars.close()


class PoseFeed:
    """Feed of a vehicle's poses.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: name the vehicle and the origin of the world.

    Raises:
        InputError: the place cannot be opened.
    """

    settings = PoseOptions

    def __init__(self, place: str, options: PoseOptions) -> None:
        self._link = open_link(place, options, own_identity(options), role="source", log=warn)
        self._track = Track(
            self._link.counters, state=options.state, origin=options.place(), vehicle=options.vehicle, keep=1
        )
        self._ready: deque[BodyState] = deque()

    def next(self, timeout_s: float) -> BodyState | None:
        """Return the next pose, or None if none came within the timeout.

        Raises:
            InputError: the bus is gone.
        """
        if not self._ready:
            for packet in self._link.arriving(timeout_s):
                self._ready += [found.item for found in self._track.take(packet)]
        if not self._ready:
            if self._link.finished:
                raise InputError("the bus is gone", where="imc")
            return None
        return self._ready.popleft()

    def close(self) -> None:
        """Let go of the link, unless a sink still uses it."""
        leave(self._link, "source")
