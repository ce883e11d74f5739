"""The link over loopback UDP and over a pseudo terminal, with an autopilot of pymavlink alone on the other side."""

from __future__ import annotations

import os
import pty
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_autopilot import Autopilot, free_port
from pymavlink.dialects.v20 import common as mav
from waiting import until

import ullage as ul
from ullage.ports.mavlink.link import Link, leave, open_link
from ullage.ports.mavlink.options import LinkOptions, SinkOptions, place_of

Opened = Callable[..., Link]


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def link_to(said: list[str]) -> Iterator[Opened]:
    links: list[Link] = []

    def opened(place: str, **options: Any) -> Link:
        links.append(open_link(place, LinkOptions(**options), role="sink", log=said.append))
        return links[-1]

    yield opened
    for link in links:
        leave(link, "sink")


def test_heartbeats_come_once_a_second_from_an_obstacle_avoidance_companion_of_the_vehicle(link_to: Opened) -> None:
    with Autopilot(system=7) as autopilot:
        opened = time.monotonic()
        link = link_to(f"udp://127.0.0.1:{autopilot.port}")
        link.wait_heartbeat(10)
        first = len(autopilot.of("HEARTBEAT"))
        beats = autopilot.await_("HEARTBEAT", first + 3)[first:]
        for beat in beats:
            assert beat.type == mav.MAV_TYPE_ONBOARD_CONTROLLER
            assert beat.autopilot == mav.MAV_AUTOPILOT_INVALID
            assert (beat.get_srcSystem(), beat.get_srcComponent()) == (7, mav.MAV_COMP_ID_OBSTACLE_AVOIDANCE)
            assert beat.system_status == mav.MAV_STATE_STANDBY
        times = autopilot.times("HEARTBEAT")
        assert times[-1] - opened > len(times) - 1.02  # a busy machine may delay them, but none comes early


def test_our_ids_can_be_chosen(link_to: Opened) -> None:
    with Autopilot(system=7) as autopilot:
        link_to(f"udp://127.0.0.1:{autopilot.port}", system_id=42, component_id=191)
        beat = autopilot.await_("HEARTBEAT")[0]
        assert (beat.get_srcSystem(), beat.get_srcComponent()) == (42, 191)


def test_timesync_works_both_ways(link_to: Opened) -> None:
    boot_ns = -int(1e12)
    with Autopilot(boot_ns=boot_ns) as autopilot:
        link = link_to(f"udp://127.0.0.1:{autopilot.port}")
        until(lambda: link.clock.known)

        def off_ns() -> float:
            now = time.time_ns()
            mono, boot = time.monotonic_ns() - (time.time_ns() - now), link.boot_ns(now)
            assert boot is not None
            back = link.local_ns(boot)
            assert back is not None
            assert abs(back - now) < 1e6
            return abs(boot - autopilot.clock_ns(mono))

        until(lambda: off_ns() < 20e6)  # the longer, the more exchanges with short round trips
        until(lambda: np.min(np.abs(np.array([*autopilot.offsets, 0]) + boot_ns)) < 20e6)


def test_a_step_of_the_clock_is_asked_about_at_once(link_to: Opened, said: list[str]) -> None:
    """Poses wait until it is known again: it must not take several of the slow questions, of one a heartbeat."""
    with Autopilot() as autopilot:
        link = link_to(f"udp://127.0.0.1:{autopilot.port}")
        until(lambda: link.clock.known)
        autopilot.restart(10**9)
        before = len(autopilot.of("HEARTBEAT"))
        until(lambda: any("jumped +1 s" in line for line in said) and link.clock.known)
        assert len(autopilot.of("HEARTBEAT")) - before <= 2


def test_answers_to_the_questions_of_others_are_not_used(link_to: Opened) -> None:
    with Autopilot(timesync=False) as autopilot:
        link = link_to(f"udp://127.0.0.1:{autopilot.port}")
        link.wait_heartbeat(10)
        for k in range(10):
            autopilot.send(mav.MAVLink_timesync_message(10**9 + k, 5 + k))
        until(lambda: link.counters.received("TIMESYNC") > 10)
        assert not link.clock.known


def test_other_systems_and_components_are_ignored_and_counted(link_to: Opened, said: list[str]) -> None:
    with Autopilot(system=1) as autopilot:
        link = link_to(f"udp://127.0.0.1:{autopilot.port}")
        link.listens = True
        link.wait_heartbeat(10)
        pose = mav.MAVLink_local_position_ned_message(1, 0, 0, 0, 0, 0, 0)
        autopilot.send(pose, system=2)
        autopilot.send(pose, component=197)
        autopilot.send(mav.MAVLink_heartbeat_message(2, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3), system=2)
        autopilot.send(mav.MAVLink_heartbeat_message(6, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3), system=255)
        autopilot.send(pose)
        heard = until(lambda: link.wait(0.1))
        assert (heard.message.get_srcSystem(), heard.message.get_srcComponent()) == (1, 1)
        assert link.wait(0.2) is None
        lines = link.counters.lines()
        assert any(line.startswith("LOCAL_POSITION_NED: dropped 2 bad (of system 2, not 1;") for line in lines)
        assert any(line.startswith("HEARTBEAT: dropped 1 bad (of system 2, component 1") for line in lines)
        assert any("autopilot PX4, system 1" in line for line in said)


def test_a_vehicle_that_is_not_there_is_named_with_those_that_are(link_to: Opened) -> None:
    with Autopilot(system=3) as autopilot:
        link = link_to(f"udp://127.0.0.1:{autopilot.port}", vehicle=9)
        until(lambda: link.counters.dropped(topic="HEARTBEAT"))
        with pytest.raises(ul.InputError, match=r"no HEARTBEAT of system 9 within 0.1 s; HEARTBEAT of system 3 came"):
            link.wait_heartbeat(0.1)


def test_a_twin_with_our_ids_is_reported(link_to: Opened, said: list[str]) -> None:
    with Autopilot(system=1) as autopilot:
        link_to(f"udp://127.0.0.1:{autopilot.port}").wait_heartbeat(10)
        autopilot.await_("HEARTBEAT", 2)
        beat = mav.MAVLink_heartbeat_message(18, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        autopilot.send(beat, component=196)
        until(lambda: any("another program uses system 1, component 196" in line for line in said))


def test_damaged_bytes_and_other_dialects_are_counted_and_the_rest_goes_on(link_to: Opened) -> None:
    rng = np.random.default_rng(1)
    with Autopilot() as autopilot:
        link = link_to(f"udp://127.0.0.1:{autopilot.port}")
        link.listens = True
        link.wait_heartbeat(10)
        good = mav.MAVLink_local_position_ned_message(1, 0, 0, 0, 0, 0, 0).pack(mav.MAVLink(None, 1, 1))
        wrong = bytearray(good)
        wrong[-1] ^= 0x55
        unknown = bytearray(good)
        unknown[7:10] = (60_000).to_bytes(3, "little")
        before = link.counters.dropped("bad")
        for data in (bytes(wrong), bytes(unknown), rng.bytes(300), b"", good[:-5]):
            autopilot.raw(data)
        until(lambda: link.counters.dropped("bad") >= before + 3)
        for _ in range(20):  # a cut packet may take the next ones with it
            autopilot.raw(bytes(good))
        assert until(lambda: link.wait(0.1)).topic == "LOCAL_POSITION_NED"
        causes = " ".join(link.counters.lines())
        assert "wrong checksum, or a message of another dialect" in causes
        assert "message 60000 is not of this dialect" in causes


def test_an_autopilot_that_falls_silent_is_reported_and_so_is_its_return(link_to: Opened, said: list[str]) -> None:
    with Autopilot() as autopilot:
        link_to(f"udp://127.0.0.1:{autopilot.port}", heartbeat_s=1.0).wait_heartbeat(10)
        autopilot.silent = True
        until(lambda: any("no HEARTBEAT of system 1 for 1 s" in line for line in said))
        autopilot.silent = False
        until(lambda: any("HEARTBEAT of system 1 is back" in line for line in said))


def test_a_listening_port_answers_those_who_send(link_to: Opened) -> None:
    port = free_port()
    link = link_to(f"udpin://127.0.0.1:{port}")
    with Autopilot(system=5, to=port) as autopilot:
        link.wait_heartbeat(10)
        assert autopilot.await_("HEARTBEAT")[0].get_srcComponent() == 196


def test_a_serial_line_carries_the_same(link_to: Opened, said: list[str]) -> None:
    ours, device = pty.openpty()
    link = link_to(f"serial://{os.ttyname(device)}", baud=115200)
    parser, maker = mav.MAVLink(None), mav.MAVLink(None, 4, 1)
    parser.robust_parsing = True
    beat = mav.MAVLink_heartbeat_message(2, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
    os.write(ours, b"noise" + bytes(beat.pack(maker)))
    link.wait_heartbeat(10)
    found: list[Any] = []

    def came() -> bool:
        found.extend(parser.parse_buffer(os.read(ours, 4096)) or [])
        return any(one.get_type() == "HEARTBEAT" and one.get_srcSystem() == 4 for one in found)

    until(came)
    os.close(device)
    os.close(ours)
    until(lambda: any("is lost" in line for line in said))


def test_a_tcp_connection_carries_the_same_and_is_made_again(link_to: Opened, said: list[str]) -> None:
    beat = mav.MAVLink_heartbeat_message(2, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = link_to(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        for begun in range(2):
            there, _ = server.accept()
            there.sendall(b"noise" + bytes(beat.pack(mav.MAVLink(None, 4, 1))))
            until(lambda begun=begun: link.counters.received("HEARTBEAT") > begun)
            parser, found = mav.MAVLink(None), list[Any]()
            while not any(one.get_type() == "HEARTBEAT" and one.get_srcSystem() == 4 for one in found):
                found += parser.parse_buffer(there.recv(4096)) or []
            there.close()
        until(lambda: sum("is lost" in line for line in said) == 2)
        assert any("is back" in line for line in said)


def test_a_message_that_the_autopilot_denies_is_asked_for_once(
    link_to: Opened, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """ArduPilot has no ODOMETRY (331) and tells its pilot so at each request."""
    monkeypatch.setattr("ullage.ports.mavlink.link.REQUEST_S", 0.2)
    with Autopilot(denies={331}) as autopilot:
        link_to(f"udp://127.0.0.1:{autopilot.port}").request_hz = 50.0

        def asked() -> list[int]:
            return [round(one.param1) for one in autopilot.of("COMMAND_LONG")]

        until(lambda: asked().count(32) >= 4)  # no poses come: the others are asked for again
        assert asked().count(331) == 1
        assert any(line.endswith("does not set the rate of ODOMETRY (DENIED)") for line in said)


def test_a_source_and_a_sink_of_one_place_share_the_link() -> None:
    with Autopilot() as autopilot:
        place = f"udp://127.0.0.1:{autopilot.port}"
        one = open_link(place, LinkOptions(), role="source", log=print)
        two = open_link(place, SinkOptions(), role="sink", log=print)
        assert one is two
        leave(one, "source")
        seen = len(autopilot.await_("HEARTBEAT"))
        autopilot.await_("HEARTBEAT", seen + 1)  # the sink goes on
        leave(two, "sink")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("udp://127.0.0.1:0", "port '0' .*1 to 65535"),
        ("udp://127.0.0.1:70000", "port '70000' .*1 to 65535"),
        ("udp://127.0.0.1", "is not a place .*udp://HOST:PORT"),
        ("sctp://127.0.0.1:5760", "is not a place .*serial:///dev/NAME"),
        ("", "is not a place"),
    ],
)
def test_places_that_are_none_are_refused(text: str, words: str) -> None:
    with pytest.raises(ul.InputError, match=words):
        place_of(text)


def test_a_port_in_use_a_wrong_host_and_a_missing_device_are_one_line(link_to: Opened) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(ul.InputError, match=f"cannot listen on 127.0.0.1 port {port}: Address already in use"):
            link_to(f"udpin://127.0.0.1:{port}")
        with pytest.raises(ul.InputError, match=f"cannot listen on 127.0.0.1 port {port}: .*a free port"):
            link_to("udp://127.0.0.1:14550", port=port)
    for place, words in {
        "udp://no.such.host.invalid:14550": r"no such host 'no\.such\.host\.invalid'",
        "tcp://127.0.0.1:9": r"cannot connect to 127.0.0.1 port 9: Connection refused .*that listens",
        "serial:///dev/ttyNOPE9": r"no such serial device .*a device as /dev/ttyACM0",
    }.items():
        with pytest.raises(ul.InputError, match=words):
            link_to(place)
