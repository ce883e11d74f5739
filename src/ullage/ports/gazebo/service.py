"""Calls to services of Gazebo Transport: the request goes to the server, the answer comes to a socket of ours."""

from __future__ import annotations

import contextlib
import queue
from dataclasses import dataclass
from typing import Any

from ullage.ports.gazebo import wire

Answer = queue.SimpleQueue[bytes | None]


@dataclass(slots=True)
class _Call:
    topic: str
    kinds: tuple[str, str]
    data: bytes
    answer: Answer
    sent: bool = False


class Requests:
    """The pending calls; only the thread of a `Peer` uses them.

    Args:
        zmq: the library.
        context: of its sockets.
        host: address that receives answers.
        node: id of the calling node.
    """

    def __init__(self, zmq: Any, context: Any, host: str, node: str) -> None:
        self._zmq, self._node, self._name = zmq, node, wire.new_uuid()
        self.answers = context.socket(zmq.ROUTER)
        self.answers.setsockopt_string(zmq.IDENTITY, self._name)
        self._address = f"tcp://{host}:{self.answers.bind_to_random_port(f'tcp://{host}')}"
        self._ask = context.socket(zmq.ROUTER)
        self._ask.setsockopt(zmq.ROUTER_MANDATORY, 1)
        self._ask.setsockopt(zmq.LINGER, 0)
        self._known: dict[str, Any] = {}
        self._connected: set[str] = set()
        self._calls: dict[str, _Call] = {}

    @property
    def topics(self) -> set[str]:
        """Topics of the calls that are not sent yet."""
        return {call.topic for call in self._calls.values() if not call.sent}

    def ask(self, topic: str, kinds: tuple[str, str], data: bytes, answer: Answer) -> None:
        """Begin a call; it is sent once a server of the service is found."""
        self._calls = {key: call for key, call in self._calls.items() if call.topic != topic}
        self._calls[wire.new_uuid()] = _Call(topic, kinds, data, answer)

    def found(self, pub: Any) -> None:
        """Send the calls of a service that a peer offers."""
        for key, call in self._calls.items():
            if call.topic == pub.topic and not call.sent:
                self._send(key, call, pub)

    def _send(self, key: str, call: _Call, pub: Any) -> None:
        if pub.address not in self._connected:
            try:
                self._ask.connect(pub.address)
            except self._zmq.ZMQError:  # no such address: another may offer the service too
                return
            self._connected.add(pub.address)
        words = [pub.srv_pub.socket_id, call.topic, self._address, self._name, self._node, key]
        parts = [word.encode() for word in words] + [call.data, *(kind.encode() for kind in call.kinds)]
        with contextlib.suppress(self._zmq.ZMQError):  # not connected yet: the next ADVERTISE finds it so
            self._ask.send_multipart(parts, self._zmq.NOBLOCK)
            call.sent = True

    def receive(self) -> None:
        """Deliver the answers that came."""
        while True:
            try:
                parts = self.answers.recv_multipart(self._zmq.NOBLOCK)
            except self._zmq.Again:
                return
            if len(parts) < 6:
                continue
            call = self._calls.pop(parts[3].decode(errors="replace"), None)
            if call is not None:
                call.answer.put(parts[4] if parts[5] == b"1" else None)
