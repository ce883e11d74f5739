"""Every server of ullage listens on loopback only, unless another address is asked for."""

from __future__ import annotations

import operator
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from ipaddress import IPv4Address, IPv6Address
from pathlib import Path
from typing import Any

import pytest

import ullage as ul
from ullage.experiments.cluster import each_done
from ullage.ports.instruments.simulated import SimulatedMrm

pytestmark = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="sockets are listed in /proc on Linux")
CLOSED_TO_OTHERS = "0A"  # state LISTEN of a TCP socket
WORLD = "world=ntnu-room&fidelity=thesis&rig=single"


def family() -> list[int]:
    """This process and those that it started."""
    parents = {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(place.parent.name)] = int(place.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    out = [os.getpid()]
    for one in out:
        out += [child for child, parent in parents.items() if parent == one]
    return out


def inodes(pids: list[int]) -> set[str]:
    """Sockets of some processes."""
    found = set()
    for pid in pids:
        for handle in Path(f"/proc/{pid}/fd").glob("*"):
            try:
                link = os.readlink(handle)
            except OSError:
                continue
            if link.startswith("socket:["):
                found.add(link[8:-1])
    return found


def address(text: str) -> IPv4Address | IPv6Address:
    """An address as /proc/net writes it: words of 32 bits in the order of this machine."""
    raw = b"".join(bytes.fromhex(text[k : k + 8])[::-1] for k in range(0, len(text), 8))
    return IPv4Address(raw) if len(raw) == 4 else IPv6Address(raw)


def bound() -> dict[int, str]:
    """Local port to address of all sockets of this process and its children that take what comes."""
    ours, out = inodes(family()), {}
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        table = Path("/proc/net", kind)
        for line in table.read_text().splitlines()[1:] if table.exists() else ():
            words = line.split()
            if words[9] in ours and (kind.startswith("udp") or words[3] == CLOSED_TO_OTHERS):
                host, port = words[1].split(":")
                out[int(port, 16)] = str(address(host))
    return out


def free_ports() -> int:
    """A port that is free, and so is the next one."""
    while True:
        with socket.socket() as one, socket.socket() as two:
            one.bind(("127.0.0.1", 0))
            try:
                two.bind(("127.0.0.1", one.getsockname()[1] + 1))
            except (OSError, OverflowError):
                continue
            if 1024 <= (port := int(one.getsockname()[1])) <= 65534:
                return port


@contextmanager
def page(**options: Any) -> Iterator[None]:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    with closing(ul.sink("viewer:web", port=free_ports(), **options)):
        yield


@contextmanager
def opened(target: str) -> Iterator[None]:
    with closing(ul.open(target)):
        yield


@contextmanager
def autopilot() -> Iterator[None]:
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    with closing(ul.sink(f"mavlink:udp://127.0.0.1:{free_ports()}")):
        yield


@contextmanager
def instrument() -> Iterator[None]:
    with closing(SimulatedMrm()) as radar, opened(f"mrm:{radar.address}?duration_s=1"):
        yield


@contextmanager
def gazebo(kind: str) -> Iterator[None]:
    pytest.importorskip("zmq", reason="pyzmq is not installed")
    with closing(ul.sink(kind)):
        yield


STARTED: dict[str, Callable[[], Any]] = {
    "viewer": page,
    "imc over UDP": lambda: opened(f"imc:?{WORLD}&port=0"),
    "imc over TCP": lambda: opened(f"imc:tcp://127.0.0.1:{free_ports()}?{WORLD}"),
    "imc, sending": lambda: closing(ul.sink("imc:?port=0")),
    "mavlink": autopilot,
    "mavlink, receiving": lambda: opened(f"mavlink:udpin://127.0.0.1:{free_ports()}?{WORLD}"),
    "a PulsON radar, and a simulated one": instrument,
    "gazebo": lambda: gazebo("gazebo:"),
    "gazebo classic": lambda: gazebo("gazebo-classic:"),
}


@pytest.mark.parametrize("name", STARTED)
def test_a_server_listens_on_loopback_or_on_a_group_only(name: str) -> None:
    before = bound()
    with STARTED[name]():
        new = {port: host for port, host in bound().items() if before.get(port) != host}
    at = {IPv4Address(host) for host in new.values()}
    assert all(host.is_loopback or host.is_multicast for host in at), new
    assert new or name == "imc over TCP"  # a client


def test_a_page_is_served_on_another_address_where_that_is_asked_for() -> None:
    before = bound()
    with page(host="0.0.0.0"):
        new = {port: host for port, host in bound().items() if before.get(port) != host}
    assert "0.0.0.0" in new.values()


@pytest.mark.slow
def test_a_local_cluster_listens_on_loopback_only() -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    before, new = bound(), dict[int, str]()
    with closing(each_done(operator.is_, [1, 2], where=2)) as results:
        for _ in results:
            new |= {port: host for port, host in bound().items() if before.get(port) != host}
    assert len(new) > 2
    assert all(IPv4Address(host).is_loopback for host in new.values()), new
