"""What can be opened and written to, and what is said of the rest."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import ullage as ul
from conftest import some_frames
from ullage.errors import InputError
from ullage.ports import Sink, Source


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none.mcap", "no such file or folder.*mcap.*live: ros2:"), ("x4:/dev/nothing", "no such device.*an X4 module"),
        ("x4:a?b", "cannot read the options 'b'"), ("x4:a?b=1&b=2", "option 'b' comes twice"),
    ],
)  # fmt: skip
def test_what_cannot_be_opened_is_one_line(name: str, words: str) -> None:
    with pytest.raises(ul.InputError, match=words) as error:
        ul.open(name)
    assert "\n" not in str(error.value)


def test_other_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ul.InputError, match="no recording in this folder"):
        ul.open(tmp_path)
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(ul.InputError, match="not a recording"):
        ul.open(tmp_path / "a.txt")
    for target in (tmp_path / "a.txt", "nothing:"):
        with pytest.raises(ul.InputError, match="not something to write to"):
            ul.sink(target)


@pytest.mark.parametrize("target", ["", None, 5])
@pytest.mark.parametrize("use", [ul.open, ul.sink])
def test_what_names_nothing_is_refused(use: Callable[[Any], Any], target: Any) -> None:
    with pytest.raises(ul.InputError, match="names nothing"):
        use(target)


@pytest.mark.parametrize("suffix", [".mcap", ".zarr"])
def test_pieces_have_a_whole_number_of_frames(tmp_path: Path, suffix: str) -> None:
    with ul.sink(tmp_path / f"a{suffix}") as sink:
        sink.write(some_frames(3))
    source = ul.open(tmp_path / f"a{suffix}")
    for chunk in (0, 1.5):
        with pytest.raises(ul.InputError, match=f"chunk is {chunk}"):
            next(source.stream(chunk))
    with pytest.raises(ul.InputError, match=r"no sensor 'x' \(allowed: front"):
        source.frames("x")


def test_options_that_do_not_apply_are_refused(tmp_path: Path) -> None:
    with ul.sink(tmp_path / "a.mcap") as sink:
        sink.write(some_frames(3))
    with pytest.raises(ul.InputError, match=r"no option 'fps'"):
        ul.open(tmp_path / "a.mcap", fps=3)


def test_every_folder_with_one_recording_opens(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    for path in (tmp_path / "run", tmp_path / "bag" / "bag_0.mcap"):
        with ul.sink(path) as sink:
            sink.write(some_frames(9))
        source = ul.open(path if path.is_dir() else path.parent)
        assert isinstance(source, Source)
        assert isinstance(sink, Sink)
        assert len(source.frames()) == 9


def test_only_what_is_read_is_looked_through(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    os.mkfifo(tmp_path / "deep" / "pipe")
    with pytest.raises(ul.InputError, match="no recording in this folder"):
        ul.open(tmp_path)
    (tmp_path / "metadata.yaml").touch()
    with pytest.raises(ul.InputError, match="is a pipe"):
        ul.open(tmp_path)


@pytest.mark.parametrize("name", ["x.mcap", "x", "x.zarr", "x.lsf", "x.yaml"])
def test_no_sink_makes_the_folder_of_a_mistyped_path(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"no folder .*nodir(/deep)? \(allowed: a folder that exists\)"):
        ul.sink(tmp_path / "nodir/deep" / name) if name == "x" else ul.sink(tmp_path / "nodir" / name)
    assert not (tmp_path / "nodir").exists()
