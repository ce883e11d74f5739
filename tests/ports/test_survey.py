"""Surveyed reflectors beside a recording: read by named columns, refused in one line where they make no sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.ports import RailSource


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    t_s = 0.02 * np.arange(30)
    np.savez(tmp_path / "radar.npz", samples=np.ones((30, 20), complex), times_s=t_s, ranges_m=0.05 * np.arange(20),
             center_hz=7.29e9, bandwidth_hz=1.4e9)  # fmt: skip
    rows = "".join(f"{t},{t},0,1\n" for t in t_s)
    (tmp_path / "track.csv").write_text("t_s,x_m,y_m,z_m\n" + rows)
    return tmp_path


def opened(folder: Path) -> RailSource:
    source = ul.open(folder)
    assert isinstance(source, RailSource)
    return source


@pytest.mark.parametrize(
    "text",
    ["name,x_m,y_m,z_m\ncorner,1,2,3\n,4,5,6\n", "z_m, y_m, x_m\n# a note\n3, 2, 1\n\n6, 5, 4\n",
     "\ufeffx_m,y_m,z_m\r\n1,2,3\r\n4,5,6\r\n"],
)  # fmt: skip
def test_places_are_read_by_their_columns(folder: Path, text: str) -> None:
    (folder / "reflectors.csv").write_text(text)
    source = opened(folder)
    np.testing.assert_array_equal(source.reflectors(), [[1, 2, 3], [4, 5, 6]])
    assert source.survey is not None
    assert source.survey.names == (("corner" if "corner" in text else "1"), "2")


def test_without_the_file_there_is_no_survey(folder: Path) -> None:
    assert opened(folder).survey is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        ("x_m,y_m\n1,2\n", r"reflectors\.csv:1: no column z_m.*allowed: columns x_m, y_m, z_m"),
        ("x,y,z\n1,2,3\n", "no column x_m, y_m, z_m"),
        ("x_m,y_m,z_m,size\n1,2,3,4\n", "unknown column 'size'"),
        ("x_m,y_m,z_m\n", "0 reflectors"),
        ("x_m,y_m,z_m\n1,2,3\n1,two,3\n", r"reflectors\.csv:3: y_m is 'two'"),
        ("x_m,y_m,z_m\n1,2\n", r":2: z_m is ''"),
        ("x_m,y_m,z_m\n1,nan,3\n", "y_m is 'nan'"),
        ("x_m,y_m,z_m\n1e5,2,3\n", "x_m is '1e5'.*within 10000 m"),
        ("x_m,y_m,z_m\n1,2,3\n1,2,3\n", r":3: the place of an earlier line"),
    ],
)
def test_bad_surveys_are_refused_in_one_line(folder: Path, text: str, words: str) -> None:
    (folder / "reflectors.csv").write_text(text)
    with pytest.raises(ul.InputError, match=words) as caught:
        ul.open(folder)
    assert "\n" not in str(caught.value)
