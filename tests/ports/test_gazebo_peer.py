"""The peers beside Debian's real `ign topic`, a small gzserver and others of their kind, and before bytes that lie."""

import asyncio
import contextlib
import functools
import select
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zmq")
pytest.importorskip("google.protobuf")

from waiting import until as eventually

from ullage.errors import InputError
from ullage.ports.gazebo import transport as wire
from ullage.ports.gazebo.classic import ClassicPeer, framed, master_of, messages, packet
from ullage.ports.gazebo.messages import classic, gz
from ullage.ports.gazebo.peer import Connected, Disconnected, ProcessLeft, Received, TopicOffered, Unresponsive
from ullage.ports.gazebo.transport import TransportPeer

POSE = "header {{ stamp {{ sec: {} nsec: 5 }} }} pose {{ name: 'x3' position {{ x: 1.5 }} orientation {{ w: 1 }} }}"


def until(peer, kind, limit_s=60.0, also=lambda event: True):
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        event = peer.wait(0.1)
        if isinstance(event, kind) and also(event):
            return event
    raise TimeoutError(f"no {kind.__name__}")


both = pytest.mark.parametrize(
    "open_peer", [TransportPeer, functools.partial(ClassicPeer, ("127.0.0.1", 1))], ids=["transport", "classic"]
)


def test_the_real_tool_publishes_to_us(ign_topic):
    with TransportPeer() as peer:
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
    with TransportPeer() as peer:
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
    with TransportPeer() as listener:
        listener.subscribe("/clock")
        with TransportPeer() as speaker:
            speaker.advertise("/clock", "gz.msgs.Clock")
            came = until(listener, TopicOffered)
            assert (came.topic, came.kind, came.process) == ("/clock", "gz.msgs.Clock", speaker.uuid)
            with TransportPeer() as late:
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


@both
def test_what_was_not_advertised_is_not_said(open_peer, partition):
    with open_peer() as peer:
        with pytest.raises(InputError, match="publish: /clock was not advertised"):
            peer.publish("/clock", gz().Clock())
        peer.advertise("/clock", "gz.msgs.Clock")
        peer.publish("/clock", gz().Clock())


def test_another_partition_is_not_heard(partition):
    with TransportPeer() as one, TransportPeer(partition="elsewhere") as other:
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
    with wire.discovery_socket(wire.MESSAGE_PORT, "127.0.0.1") as network, TransportPeer() as peer:
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


@both
def test_an_interface_that_is_not_ours_is_refused(open_peer):
    with pytest.raises(InputError, match=r"host 192\.0\.2\.77.*allowed: an address of this machine"):
        open_peer(host="192.0.2.77")


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


async def cut(pieces):
    """The messages in a stream that comes in pieces."""
    reader, found = asyncio.StreamReader(), []

    async def read():
        async for one in messages(reader):
            found.append(one)  # noqa: PERF401 (what came before the end counts)

    task = asyncio.create_task(read())
    for piece in pieces:
        reader.feed_data(piece)
        await asyncio.sleep(0)
    reader.feed_eof()
    with contextlib.suppress(asyncio.IncompleteReadError):
        await task
    return found


@given(st.lists(st.binary(max_size=40), max_size=6), st.integers(1, 30))
def test_messages_come_out_whole_however_they_are_cut(sent, step):
    raw = b"".join(framed(data) for data in sent)
    assert asyncio.run(cut([raw[start : start + step] for start in range(0, len(raw), step)])) == sent


def test_the_length_is_eight_hexadecimal_digits():
    assert framed(b"x" * 300)[:8] == b"0000012C"


@pytest.mark.parametrize("raw", [b"GET / HTTP/1.1", b"-0000001x", b"FFFFFFFFx"])
def test_what_is_no_length_is_refused(raw):
    with pytest.raises(ValueError):  # noqa: PT011
        asyncio.run(cut([raw]))


def told(sock):
    """Give the messages that come on a socket."""
    file = sock.makefile("rb")
    while len(head := file.read(8)) == 8:
        yield file.read(int(head, 16))


@pytest.mark.parametrize(
    ("text", "want"),
    [
        ("", ("127.0.0.1", 11345)),
        ("box:1234", ("box", 1234)),
        ("http://10.0.0.1:11346", ("10.0.0.1", 11346)),
        ("box", ("box", 11345)),
    ],
)
def test_addresses_of_a_master(text, want, monkeypatch):
    monkeypatch.delenv("GAZEBO_MASTER_URI", raising=False)
    assert master_of(text) == want


def test_an_address_that_is_none_is_refused():
    with pytest.raises(InputError, match="'box:door' is not an address"):
        master_of("box:door")


class Server:
    """A master that knows one world, and itself publishes the clock on the same port."""

    def __init__(self, port=0, deaf=0, mute=False, offers=None):
        self.deaf, self.mute = deaf, mute  # how many of the first to come are never read, and whether told anything
        self.offers = offers  # port of the clock; none: the same
        self.door = socket.create_server(("127.0.0.1", port))
        self.port = self.door.getsockname()[1]
        self.received, self.lines = [], []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        try:
            while True:
                sock, _ = self.door.accept()
                self.lines.append(sock)
                threading.Thread(target=self._talk, args=(sock,), daemon=True).start()
        except OSError:
            return

    def _talk(self, sock):
        deaf = len(self.lines) <= self.deaf
        if deaf and self.mute:
            return
        try:
            sock.sendall(packet("version_init", classic().GzString(data="gazebo 11.1.0")))
            sock.sendall(packet("topic_namepaces_init", classic().GzString_V(data=["w", "/gazebo"])))
            sock.sendall(packet("publishers_init", classic().Publishers()))
        except OSError:  # the test is over
            return
        if deaf:
            return
        for data in told(sock):
            message = classic().Packet.FromString(data)
            self.received.append(message)
            if message.type == "request":
                assert classic().Request.FromString(message.serialized_data).request == "get_topic_namespaces"
                sock.sendall(packet("get_topic_namespaces_response", classic().GzString_V(data=["w"])))
            if message.type == "subscribe":
                want = classic().Subscribe.FromString(message.serialized_data)
                port = self.offers or self.port
                offer = classic().Publish(topic=want.topic, msg_type=want.msg_type, host="127.0.0.1", port=port)
                sock.sendall(packet("publisher_subscribe", offer))

    def hears(self, *kinds):
        """Wait for messages of these kinds."""
        eventually(lambda: set(kinds) <= {message.type for message in list(self.received)})

    def close(self):
        self.door.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        for sock in [self.door, *self.lines]:
            sock.close()


def test_a_peer_joins_publishers_and_serves_readers():
    server = Server()
    with ClassicPeer(("127.0.0.1", server.port)) as peer:
        assert until(peer, Connected).worlds == ("w", "/gazebo")
        peer.advertise("/gazebo/w/x/range", "gazebo.msgs.GzString")
        with socket.create_connection(("127.0.0.1", peer.port)) as reader:
            want = classic().Subscribe(
                topic="/gazebo/w/x/range", host="127.0.0.1", port=1, msg_type="gazebo.msgs.GzString"
            )
            reader.sendall(packet("sub", want))
            reader.settimeout(60)
            while not select.select([reader], [], [], 0.05)[0]:  # until its request has come
                peer.publish("/gazebo/w/x/range", classic().GzString(data="3.25"))
            assert classic().GzString.FromString(next(told(reader))).data == "3.25"
    server.hears("advertise")
    server.close()


def test_a_server_that_went_is_found_again_and_told_anew():
    server = Server()
    with ClassicPeer(("127.0.0.1", server.port)) as peer:
        until(peer, Connected)
        peer.subscribe("/gazebo/w/world_stats", "gazebo.msgs.WorldStatistics")
        peer.advertise("/gazebo/w/x", "gazebo.msgs.GzString")
        time.sleep(0.2)
        port = server.port
        for sock in server.lines:
            sock.shutdown(socket.SHUT_RDWR)
        server.close()
        until(peer, Disconnected)
        for _ in range(20):
            try:
                server = Server(port)
                break
            except OSError:
                time.sleep(0.2)
        until(peer, Connected)
        server.hears("subscribe", "advertise")
        server.close()


@pytest.mark.parametrize("mute", [False, True])
def test_a_master_that_accepts_and_never_reads_is_joined_anew(mute):
    server = Server(deaf=2, mute=mute)
    with ClassicPeer(("127.0.0.1", server.port), ask_s=0.1, answer_s=0.4) as peer:
        peer.subscribe("/gazebo/w/world_stats", "gazebo.msgs.WorldStatistics")
        peer.advertise("/gazebo/w/x", "gazebo.msgs.GzString")
        until(peer, Unresponsive)
        until(peer, Unresponsive)
        until(peer, Connected)
        server.hears("subscribe", "advertise")
        time.sleep(1.0)
        assert len(server.lines) == 4  # two that were never read, one that is, and one to the publisher
    server.close()


def test_a_publisher_that_cannot_be_joined_at_once_is_tried_again():
    with socket.socket() as publisher:
        publisher.bind(("127.0.0.1", 0))  # nobody listens there yet: joining it is refused
        publisher.settimeout(60)
        server = Server(offers=publisher.getsockname()[1])
        with ClassicPeer(("127.0.0.1", server.port), ask_s=0.1) as peer:
            peer.subscribe("/gazebo/w/world_stats", "gazebo.msgs.WorldStatistics")
            eventually(lambda: asked_twice_since_offered(server))
            publisher.listen()
            joined, _ = publisher.accept()
            with joined:
                joined.settimeout(60)
                assert classic().Packet.FromString(next(told(joined))).type == "sub"
        server.close()


def asked_twice_since_offered(server):
    """Whether the peer has tried again: it does so each time it asks the master."""
    kinds = [message.type for message in list(server.received)]
    return "subscribe" in kinds and kinds[kinds.index("subscribe") :].count("request") >= 2


def test_somebody_who_speaks_nonsense_is_let_go():
    with ClassicPeer(("127.0.0.1", 1)) as peer, socket.create_connection(("127.0.0.1", peer.port)) as line:
        line.sendall(b"GET / HTTP/1.1\r\n\r\n")
        line.settimeout(60)
        assert line.recv(10) == b""
        assert not isinstance(peer.wait(0.0), Received)
