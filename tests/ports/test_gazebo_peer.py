"""The peer beside Debian's real `ign topic`, beside another of its kind, and before datagrams that lie."""

import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zmq")
pytest.importorskip("google.protobuf")

from ullage.errors import InputError
from ullage.ports.gazebo import wire
from ullage.ports.gazebo.peer import Peer, ProcessLeft, Received, TopicOffered
from ullage.ports.gazebo.wire import gz

POSE = "header {{ stamp {{ sec: {} nsec: 5 }} }} pose {{ name: 'x3' position {{ x: 1.5 }} orientation {{ w: 1 }} }}"


def until(peer, kind, limit_s=60.0, also=lambda event: True):
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        event = peer.wait(0.1)
        if isinstance(event, kind) and also(event):
            return event
    raise TimeoutError(f"no {kind.__name__}")


def test_the_real_tool_publishes_to_us(ign_topic):
    with Peer() as peer:
        peer.subscribe("/world/w/pose/info")
        for second in range(40):  # the tool exits as it sends, so that some of what it says is lost
            process = ign_topic("-t", "/world/w/pose/info", "-m", "ignition.msgs.Pose_V", "-p", POSE.format(second))
            process.wait(60)
            try:
                received = until(peer, Received, 0.5)
            except TimeoutError:
                continue
            break
        assert received.kind == "ignition.msgs.Pose_V"
        poses = gz().Pose_V.FromString(received.data)
        assert (poses.header.stamp.sec, poses.header.stamp.nsec) == (second, 5)
        assert poses.pose[0].name == "x3"
        assert poses.pose[0].position.x == 1.5


def test_the_real_tool_lists_and_echoes_what_we_publish(ign_topic):
    with Peer() as peer:
        peer.advertise("/model/x3/radar/front/range", "ignition.msgs.Double")
        echo = ign_topic("-e", "-t", "/model/x3/radar/front/range", "-n", "2")
        end = time.monotonic() + 60
        while echo.poll() is None and time.monotonic() < end:
            peer.publish("/model/x3/radar/front/range", gz().Double(data=3.25))
            time.sleep(0.05)
        assert echo.communicate()[0].split().count("3.25") == 2
        assert "/model/x3/radar/front/range" in ign_topic("-l").communicate(timeout=60)[0].split()
        shown = ign_topic("-i", "-t", "/model/x3/radar/front/range").communicate(timeout=60)[0]
        assert "ignition.msgs.Double" in shown
        assert "tcp://127.0.0.1:" in shown


def test_two_peers_find_each_other_whoever_comes_first(partition):
    with Peer() as listener:
        listener.subscribe("/clock")
        with Peer() as speaker:
            speaker.advertise("/clock", "gz.msgs.Clock")
            came = until(listener, TopicOffered)
            assert (came.topic, came.kind, came.process) == ("/clock", "gz.msgs.Clock", speaker.uuid)
            with Peer() as late:
                late.subscribe("/clock")
                until(late, TopicOffered)
                end = time.monotonic() + 60
                received = []
                while len(received) < 2 and time.monotonic() < end:
                    speaker.publish("/clock", gz().Clock(sim=gz().Time(sec=7)))
                    received += [e for e in (listener.wait(0.05), late.wait(0.05)) if isinstance(e, Received)]
                assert gz().Clock.FromString(received[-1].data).sim.sec == 7
        assert until(listener, ProcessLeft).process == speaker.uuid


def test_a_speaker_may_leave_while_its_words_wait(partition):
    script = Path(__file__).with_name("leave_gazebo.py")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "left []\n"


def test_what_was_not_advertised_is_not_said(partition):
    with Peer() as peer:
        with pytest.raises(InputError, match="publish: /clock was not advertised"):
            peer.publish("/clock", gz().Clock())
        peer.advertise("/clock", "gz.msgs.Clock")  # it lives on
        with Peer() as listener:
            assert until(listener, TopicOffered).process == peer.uuid


def test_another_partition_is_not_heard(partition):
    with Peer() as one, Peer(partition="elsewhere") as other:
        one.subscribe("/clock")
        other.advertise("/clock", "gz.msgs.Clock")
        for _ in range(20):
            other.publish("/clock", gz().Clock())
            assert one.wait(0.05) is None
        other.close()
        assert one.wait(0.2) is None  # nor is its going told


def offered_by(process, partition, address):
    pub = gz().Publisher(
        topic=wire.full_topic("/clock", partition), address=address, process_uuid=process, node_uuid=process,
        scope=wire.EVERYWHERE, msg_pub=gz().MessagePublisher(msg_type="gz.msgs.Clock"),
    )  # fmt: skip
    return wire.datagram(wire.ADVERTISE, process, pub=pub)


def test_only_the_loopback_is_bound(partition):
    for port in (wire.MESSAGE_PORT, wire.SERVICE_PORT):
        with wire.discovery_socket(port, "127.0.0.1") as sock:
            assert sock.getsockname() == (wire.GROUP, port)
            assert sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF) == struct.unpack("i", b"\x7f\0\0\1")[0]
    with wire.discovery_socket(wire.MESSAGE_PORT, "127.0.0.1") as network, Peer() as peer:
        network.settimeout(60)
        peer.advertise("/clock", "gz.msgs.Clock")
        while (datagram := wire.read_datagram(network.recv(65536))) is None or datagram.process_uuid != peer.uuid or (
            datagram.type != wire.ADVERTISE
        ):  # fmt: skip
            pass
        assert datagram.pub.address.startswith("tcp://127.0.0.1:")
        group = (wire.GROUP, wire.MESSAGE_PORT)
        network.sendto(offered_by("far", peer.partition, "tcp://192.0.2.7:4"), group)  # not on the loopback
        network.sendto(offered_by("near", peer.partition, "tcp://127.0.0.1:4"), group)
        assert until(peer, TopicOffered).process == "near"


def test_an_address_that_is_not_ours_is_refused():
    with pytest.raises(InputError, match=r"host 192\.0\.2\.77.*allowed: an address of this machine"):
        Peer("192.0.2.77")


@given(st.binary(max_size=200))
def test_datagrams_that_lie_are_passed_by(raw):
    for datagram in (raw, struct.pack("<H", len(raw)) + raw):
        found = wire.read_datagram(datagram)
        assert found is None or found.version % 100 == wire.WIRE_VERSION


@pytest.mark.parametrize("topic", ["", "/", "no/slash", "/a b", "/a@b", "/a//b"])
def test_what_is_not_a_topic_is_refused(topic):
    with pytest.raises(InputError, match="is not a topic"):
        wire.full_topic(topic, "p")


def test_names_on_the_wire():
    assert wire.full_topic("/world/w/stats", "host:me") == "@/host:me@/world/w/stats"
    assert wire.short_topic("@/host:me@/world/w/stats") == "/world/w/stats"
