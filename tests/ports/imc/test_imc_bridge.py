"""From the bus through the pipeline to ROS messages and back: frames stay what they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imc_peer import Peer
from waiting import until

import ullage as ul
from conftest import assert_same, some_frames
from ullage.ports.imc.assemble import FrameAssembler, Track
from ullage.ports.imc.codec import Packet, make
from ullage.ports.imc.frames import exact
from ullage.ports.imc.frames import settings as settings_message


def told(folder: Path, frames: dict[str, ul.Frames]) -> bytes:
    folder.mkdir()
    with ul.sink(folder / "Data.lsf", distance="off") as sink:
        sink.write(frames)
    return (folder / "Data.lsf").read_bytes()


@pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
def test_frames_go_from_imc_to_ros_messages_and_back_without_losing_a_bit(tmp_path: Path) -> None:
    frames = {name: some_frames(seed=k, sensor=name) for k, name in enumerate(("front", "left"))}
    pieces = [told(tmp_path / "a", frames)]
    place = tmp_path / "ros.mcap"  # the same messages as on ROS topics
    with Peer(tick=lambda _: pieces.pop() if pieces else b"") as peer:
        with ul.open(f"imc:{peer.place}?reconnect=false") as source:
            kept = []
            for piece in source.stream():
                kept.append(piece)
                if sum(len(part) for each in kept for part in each.values()) == 80:
                    break
        ul.run(_Given(kept), sinks=[ul.sink(place)])
    there = ul.open(place).frames()
    for name, part in frames.items():
        assert_same(there[name], part)

    with Peer() as peer, ul.sink(f"imc:{peer.place}?pace=0&truth=true&distance=off&profile=false") as sink:
        for piece in ul.open(place).stream():
            sink.write(piece)
        until(lambda: sum(p.name == "DevDataBinary" for p in peer.heard) >= 82)
        heard = list(peer.heard)
    gather = FrameAssembler(Track())
    for packet in heard:
        gather.take(packet)
    back = gather.give(final=True)
    for name, part in frames.items():
        assert_same(back[name], part)


class _Given:
    def __init__(self, pieces: list[dict[str, ul.Frames]]) -> None:
        self._pieces = pieces

    def stream(self):
        return iter(self._pieces)


def bytes_of_frames() -> list[bytes]:
    frames = some_frames(3)
    return [settings_message(frames)["value"], *(message["value"] for message in exact(frames, 0, truth=True))]


GOOD = bytes_of_frames()


@pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
@settings(max_examples=80, deadline=None)
@given(st.integers(0, len(GOOD) - 1), st.integers(0, 4000), st.binary(min_size=1, max_size=8), st.booleans())
def test_damaged_frames_of_a_stranger_do_no_harm(which: int, at: int, new: bytes, cut: bool) -> None:
    gather = FrameAssembler(Track())
    hurt = list(GOOD)
    at %= len(hurt[which])
    hurt[which] = hurt[which][:at] + (b"" if cut else new + hurt[which][at + len(new) :])
    for value in hurt:
        gather.take(Packet(make("DevDataBinary", value=value), 1.7e9, 5, 10))
    gather.give(final=True)
    for value in GOOD:  # from somebody else: the damage is not theirs
        gather.take(Packet(make("DevDataBinary", value=value), 1.7e9, 6, 10))
    (after,) = gather.give(final=True).values()
    np.testing.assert_array_equal(after.samples, some_frames(3).samples[: len(after)])
    assert len(after) >= 1


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_senseless_numbers_of_a_stranger_do_no_harm(data: st.DataObject) -> None:
    track = Track()
    gather = FrameAssembler(track)
    numbers = st.floats(width=32)
    for name in data.draw(st.lists(st.sampled_from(["EstimatedState", "Distance", "SonarData"]), max_size=8)):
        blank = make(name).values
        fields = {k: data.draw(numbers) for k, v in blank.items() if isinstance(v, float)}
        if name == "Distance":
            fields["location"] = (make("DeviceState", x=data.draw(numbers), phi=data.draw(numbers)),)
        if name == "SonarData":
            fields |= {"bits_per_point": data.draw(st.sampled_from([0, 8, 12, 16, 255])), "max_range": 5}
            fields["data"] = data.draw(st.binary(max_size=64))
        packet = Packet(make(name, **fields), data.draw(st.floats(width=64)), 5, 10)
        if packet.t_s == packet.t_s:
            track.take(packet)
            gather.take(packet)
    got = gather.give(final=True)
    assert all(np.isfinite(frames.range_m).all() for frames in got.values())
