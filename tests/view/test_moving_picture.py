"""The moving picture of a run: how many pictures, what moves in them, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ullage as ul
from ullage.view.moving_picture import main, moving_picture
from ullage.view.replay import Parts, write_replay


def near(picture: Image.Image, color: tuple[int, int, int], within: int) -> np.ndarray:
    """Rows and columns of the pixels near a colour."""
    flat = np.asarray(picture.convert("RGB")).astype(int)
    return np.argwhere(abs(flat - color).max(axis=2) <= within)


def pictures(file: Path) -> list[Image.Image]:
    out = []
    with Image.open(file) as moving:
        for number in range(moving.n_frames):
            moving.seek(number)
            out.append(moving.convert("RGB"))
    return out


def test_the_drone_moves_and_the_map_grows(parts: Parts, tmp_path: Path) -> None:
    write_replay(tmp_path, parts)
    file = moving_picture(tmp_path, tmp_path / "room.webp", frames=4, width_px=480, quality=90)
    shown = pictures(file)
    assert len(shown) == 4
    drone = [near(one, (225, 40, 90), 45) for one in shown]
    assert all(len(spots) > 10 for spots in drone)
    assert np.median(drone[0][:, 0]) - np.median(drone[-1][:, 0]) > 10  # it flies to the north, away from the eye
    walls = [len(near(one, (210, 150, 10), 50)) for one in shown]
    assert walls[-1] > walls[0] + 20
    assert not list(tmp_path.glob(".*"))


def test_a_picture_that_cannot_be_written_is_refused(parts: Parts, tmp_path: Path) -> None:
    write_replay(tmp_path, parts)
    with pytest.raises(ul.InputError, match="nowhere"):
        moving_picture(tmp_path, tmp_path / "nowhere" / "end.webp", frames=1, width_px=120)


def test_a_run_without_a_replay_has_no_picture(tmp_path: Path) -> None:
    with pytest.raises(ul.InputError, match=r"cannot read: .*newer run"):
        moving_picture(tmp_path, tmp_path / "x.webp")


def test_the_command_refuses_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert main([str(tmp_path)]) == 2
    usage, refused = capsys.readouterr().err.splitlines()
    assert usage.startswith("usage: ")
    assert refused.startswith("ullage: ")
    assert str(tmp_path) in refused
