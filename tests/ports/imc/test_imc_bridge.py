"""From the bus through the pipeline to ROS messages and back: frames stay what they are."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from conftest import assert_same, some_frames
from imc_peer import Peer

import ullage as ul
from ullage.ports.imc.gather import Gatherer, Track


def told(folder: Path, frames: dict[str, ul.Frames]) -> bytes:
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
        end = time.monotonic() + 10
        while sum(p.name == "DevDataBinary" for p in peer.heard) < 82 and time.monotonic() < end:
            time.sleep(0.02)
        heard = list(peer.heard)
    gather = Gatherer(Track())
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
