"""A scripted TCP server in a thread: what it is sent goes to `heard`, and `react` decides what it answers."""

from __future__ import annotations

import math
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from imc_bus import HEIGHT, LAT, LON, VEHICLE, announce, estimated_state, heartbeat, packed, text

from ullage.ports.imc.codec import Packet, Parser, encode, make

EARTH_M = 6_371_000.0


class Peer:
    """Speaks IMC with one client at a time.

    Args:
        react: given each packet and the time, gives bytes to send.
        tick: called 50 times a second, gives bytes to send.
    """

    def __init__(
        self,
        *,
        react: Callable[[Packet, float], bytes] = lambda *_: b"",
        tick: Callable[[float], bytes] = lambda _: b"",
    ) -> None:
        self.heard: list[Packet] = []
        self.clients = 0
        self._react, self._tick = react, tick
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.1)
        self.place = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        self._ending = False
        self._drop = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def drop(self) -> None:
        """Hang up on the client of now."""
        self._drop = True

    def _run(self) -> None:
        while not self._ending:
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            self.clients += 1
            with client, suppress(OSError):
                self._serve(client)

    def _serve(self, client: socket.socket) -> None:
        parser, next_beat = Parser(), 0.0
        while not self._ending and not self._drop:
            now = time.time()
            if now > next_beat:
                next_beat = now + 0.5
                client.sendall(heartbeat(now) + announce(now))
            client.sendall(self._tick(now))
            if select.select([client], [], [], 0.02)[0]:
                data = client.recv(1 << 16)
                if not data:
                    return
                for packet in parser.feed(data):
                    self.heard.append(packet)
                    client.sendall(self._react(packet, now))
        self._drop = False

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *error: object) -> None:
        self._ending = True
        self._thread.join(5)
        self._server.close()


class Follower:
    """A vehicle that follows References, a point that moves at the speed it is told.

    Args:
        refuses: why it does not follow.
        radius_m: it circles a point at this distance, as a vehicle does that cannot stop.
        reports: it sends FollowRefState, as DUNE does.
        argument: what its answers carry.
    """

    def __init__(
        self, *, refuses: bytes = b"", radius_m: float = 0.0, reports: bool = False, argument: bytes = b"\xff\xff"
    ) -> None:
        self.radius_m, self.reports, self.argument = radius_m, reports, argument
        self.starts = 0
        self.reference: Packet | None = None
        self.north = self.east = 0.0
        self.down = 0.0
        self.goal: tuple[float, float, float] | None = None
        self.speed = 0.0
        self.stopped = False
        self._refuses = refuses
        self._last: float | None = None

    def react(self, packet: Packet, now: float) -> bytes:
        if packet.name == "PlanControl" and packet["op"] == 0:
            kind = 2 if self._refuses else 1
            reply = struct.pack("<BBH", kind, 0, packet["request_id"]) + text(packet["plan_id"].encode())
            self.starts += 1
            return packed(559, reply + struct.pack("<H", 0) + self.argument + text(self._refuses), t_s=now)
        if packet.name == "PlanControl":
            self.stopped = True
        if packet.name == "Reference":
            self.reference = packet
            north = (packet["lat"] - LAT) * EARTH_M
            east = (packet["lon"] - LON) * EARTH_M * math.cos(LAT)
            self.goal = (north, east, HEIGHT - packet["z"]["value"])
            self.speed = packet["speed"]["value"]
        return b""

    def tick(self, now: float) -> bytes:
        step = 0.0 if self._last is None else 8 * (now - self._last)  # lives eight times as fast as we do
        self._last = now
        if self.goal is None:
            return estimated_state(now, self.north, self.east, self.down, 0.0)
        gap = [g - h for g, h in zip(self.goal, (self.north, self.east, self.down), strict=True)]
        if self.radius_m:
            self._circle(gap, self.speed * step)
        else:
            share = min(1.0, self.speed * step / max(math.hypot(*gap), 1e-9))
            self.north, self.east, self.down = (
                h + share * g for g, h in zip(gap, (self.north, self.east, self.down), strict=True)
            )
        near = math.hypot(gap[0], gap[1]) < 1.01 * self.radius_m and abs(gap[2]) < 0.5  # on its circle
        told = self._told(now, near=near) if self.reports else b""
        return told + estimated_state(now, self.north, self.east, self.down, 0.0)

    def _circle(self, gap: list[float], way: float) -> None:
        """Towards the point as far as the circle around it, then along that."""
        away = math.hypot(gap[0], gap[1])
        bearing = math.atan2(gap[1], gap[0])
        if away > self.radius_m + way:
            self.north, self.east = self.north + way * math.cos(bearing), self.east + way * math.sin(bearing)
        else:
            on = bearing + math.pi + way / self.radius_m
            self.north = self.north + gap[0] + self.radius_m * math.cos(on)
            self.east = self.east + gap[1] + self.radius_m * math.sin(on)
        self.down += min(1.0, way / max(abs(gap[2]), 1e-9)) * gap[2]

    def _told(self, now: float, *, near: bool) -> bytes:
        state, proximity = (3, 6) if near else (2, 1)
        values = {"control_src": 0x9001, "control_ent": 255, "state": state, "proximity": proximity}
        reference = self.reference.message if self.reference is not None else None
        return encode(Packet(make("FollowRefState", reference=reference, **values), now, VEHICLE, 7))


class Copter(Follower):
    """A multirotor that flies to References in real time, with a lag, and says which plan runs.

    Args:
        start: north, east, down from its reference [m].
        ground_m: how far down the ground is [m].
    """

    def __init__(self, start: tuple[float, float, float], *, ground_m: float = 1.4) -> None:
        super().__init__()
        self.north, self.east, self.down = start
        self.ground_m = ground_m
        self.plan, self.track, self.asked_s = "", [], []
        self._velocity = [0.0, 0.0, 0.0]

    def react(self, packet: Packet, now: float) -> bytes:
        if packet.name == "PlanControl":
            self.plan = packet["plan_id"] if packet["op"] == 0 else ""
        if packet.name == "Reference":
            self.asked_s.append(now)
        return super().react(packet, now)

    def tick(self, now: float) -> bytes:
        step = 0.0 if self._last is None else min(now - self._last, 0.1)
        self._last = now
        place = [self.north, self.east, self.down]
        gap = (
            [0.0] * 3 if self.goal is None or not self.plan else [g - h for g, h in zip(self.goal, place, strict=True)]
        )
        far = max(math.hypot(*gap), 1e-9)
        wanted = [g / far * min(self.speed, 2 * far) for g in gap]
        self._velocity = [v + (w - v) / 0.25 * step for v, w in zip(self._velocity, wanted, strict=True)]
        self.north, self.east, self.down = (p + v * step for p, v in zip(place, self._velocity, strict=True))
        self.down = min(self.down, self.ground_m)
        self.track.append((self.north, self.east, self.down))
        values = {"state": 3 if self.plan else 1, "plan_id": self.plan}
        told = encode(Packet(make("PlanControlState", **values), now, VEHICLE, 7))
        return told + estimated_state(now, self.north, self.east, self.down, 0.0, velocity=tuple(self._velocity))


__all__ = ["VEHICLE", "Copter", "Follower", "Peer"]
