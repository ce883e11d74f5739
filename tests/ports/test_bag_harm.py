"""Recordings that were killed, cut, damaged, or found the disk full: what arrived is read, and the rest is said."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import textwrap
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader, AnyReaderError
from test_bag import record

import ullage as ul
from conftest import assert_same, some_frames
from ullage.ports import Sink
from ullage.ports.bag import McapSink, repair_bag

WRITER = """
    import sys, time, numpy as np
    sys.path.insert(0, {here!r})
    from conftest import some_frames
    import ullage as ul
    from dataclasses import replace
    sink = ul.sink({path!r})
    frames = some_frames(4000)
    frames = replace(frames, t_ns=frames.t_ns[0] + np.arange(4000) * 40_000_000, poses=None, truth=None)
    for i, part in enumerate(frames.chunks(5)):
        sink.write(part)
        print(i * 5 + len(part), flush=True)
        time.sleep(0.001)
"""


def writing(path: Path) -> tuple[subprocess.Popen[str], int]:
    """A process that records, and how many frames it had handed over when it was looked at."""
    code = textwrap.dedent(WRITER.format(here=str(Path(__file__).parent), path=str(path)))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) >= 300:
            return process, int(line)
    raise AssertionError("the writer ended too soon")


def test_killed_recording_is_readable_to_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "run" / "frames.mcap"
    path.parent.mkdir()
    process, handed = writing(path)
    process.send_signal(signal.SIGKILL)
    process.wait()
    with pytest.warns(ul.UllageWarning, match="never finished"):
        got = ul.open(path.parent).frames()
    assert isinstance(got, ul.Frames)
    assert len(got) >= handed - 25  # a second is 25 frames
    np.testing.assert_array_equal(got.samples, some_frames(4000).samples[: len(got)])
    index = -1
    with open(path, "rb") as file:
        records = iter(StreamReader(file).records)
        with suppress(EndOfFile):
            while True:
                found = next(records)
                if isinstance(found, Message) and len(found.data) > 400:
                    index += 1
    assert index + 1 >= len(got)


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_a_killed_bag_gets_its_index_and_its_metadata_back(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    process, _ = writing(folder / "frames.mcap")
    assert repair_bag(folder) == ""  # its writer lives
    assert not (folder / "metadata.yaml").exists()
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = ul.open(folder).frames()
    with pytest.raises((AnyReaderError, FileNotFoundError)):
        AnyReader([folder])
    said = repair_bag(folder)
    assert "has its index and metadata.yaml now" in said
    assert "\n" not in said
    with AnyReader([folder]) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages())
        assert reader.message_count > 2 * len(before)
        assert {c.topic for c in reader.connections} >= {"/radar/front/frame", "/clock", "/tf_static"}
    with (folder / "frames.mcap").open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary() is not None
    assert_same(ul.open(folder).frames(), before)
    assert repair_bag(folder) == ""
    (folder / "metadata.yaml").unlink()
    bits = (folder / "frames.mcap").read_bytes()
    assert "it has metadata.yaml now" in repair_bag(folder / "frames.mcap")
    assert (folder / "frames.mcap").read_bytes() == bits
    assert sorted(file.name for file in folder.iterdir()) == ["frames.mcap", "metadata.yaml"]


class Interrupted(dict[str, ul.Frames]):
    """Somebody presses Ctrl-C as these frames are read."""

    def values(self) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return super().values()

    def items(self) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return super().items()


@pytest.mark.usefixtures("heeded_signals")
def test_interrupt_leaves_a_finished_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    frames = some_frames(20)
    before = signal.getsignal(signal.SIGINT)
    sink = McapSink(path)
    with pytest.raises(KeyboardInterrupt), sink:
        sink.write(Interrupted({"front": frames}))
    assert_same(ul.open(path).frames(), frames)
    assert signal.getsignal(signal.SIGINT) is before


def write_all(sink: Sink, frames: ul.Frames) -> None:
    for part in frames.chunks(10):
        sink.write(part)


def test_full_disk_is_one_line_and_keeps_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    frames = some_frames(2000)
    frames = replace(frames, t_ns=frames.t_ns[0] + np.arange(2000) * 40_000_000, poses=None, truth=None)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    sink = ul.sink(path)
    resource.setrlimit(resource.RLIMIT_FSIZE, (140_000, limit[1]))
    try:
        with pytest.raises(ul.InputError, match=r"a\.mcap: cannot write: File too large; readable up to") as error:
            write_all(sink, frames)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert "\n" not in str(error.value)
    sink.close()
    with pytest.raises(ul.InputError, match="recording is closed"):
        sink.write(frames)
    with pytest.warns(ul.UllageWarning, match="never finished"):
        got = ul.open(path).frames()
    assert len(got) >= 250
    assert path.stat().st_size < 140_000  # what did not arrive whole is taken off
    np.testing.assert_array_equal(got.samples, frames.samples[: len(got)])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record(tmp_path_factory.mktemp("whole") / "a.mcap", some_frames(60)).read_bytes()


@settings(deadline=None, max_examples=120)
@given(data=st.data(), cut=st.booleans())
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_cut_or_damaged_anywhere(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, cut: bool
) -> None:
    at, junk = data.draw(st.integers(0, len(whole))), data.draw(st.binary(min_size=1, max_size=20))
    path = tmp_path_factory.mktemp("harm") / "a.mcap"
    path.write_bytes(whole[:at] if cut else whole[:at] + junk + whole[at + len(junk) :])
    assert right_or_refused(path)


def right_or_refused(path: Path) -> bool:
    """Whether what is read is right, and what is not read is said in one line."""
    want = some_frames(60)
    try:
        got = ul.open(path).frames()
    except ul.InputError as error:
        return "\n" not in str(error)
    rows = np.searchsorted(want.t_ns, got.t_ns)
    return bool(np.array_equal(got.samples, want.samples[rows]))


def test_damaged_chunk_costs_only_itself(whole: bytes, tmp_path: Path) -> None:
    damaged = bytearray(whole)
    index = make_reader(BytesIO(whole)).get_summary().chunk_indexes[1]  # type: ignore[union-attr]
    damaged[index.chunk_start_offset + index.chunk_length // 2] ^= 0xFF
    path = tmp_path / "a.mcap"
    path.write_bytes(damaged)
    with pytest.warns(ul.UllageWarning, match="damaged"):
        got = ul.open(path).frames()
    assert 20 < len(got) < 60
