"""The figure is drawn from any normalised baseband, and refuses what it cannot read."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import ullage as ul
from studies.receiver_figure import draw_receiver
from ullage.errors import InputError
from ullage.radar.receiver import unit


def at_rest(n=60):
    spec = ul.RadarSpec.preset("x4m05", iterations=4, pulses_per_step=1)
    frames = ul.simulate(ul.Scene.empty(), ul.Trajectory.stationary(n=n), spec, seed=4)
    return replace(frames, samples=frames.samples * np.float32(unit(spec)), unit="normalised")


def test_it_draws_six_panels_with_something_in_them(tmp_path):
    where = tmp_path / "deep" / "receiver.png"
    draw_receiver(at_rest(), where)
    picture = np.asarray(Image.open(where).convert("RGB")).astype(int)
    assert picture.shape[1] > 1000
    blue, red = (abs(picture - np.array(c)).sum(2) < 40 for c in ((34, 87, 122), (209, 73, 91)))
    rows, columns = (np.array_split(np.arange(k), parts) for k, parts in zip(picture.shape[:2], (2, 3), strict=True))
    for ys in rows:
        for xs in columns:
            assert blue[np.ix_(ys, xs)].sum() > 50
            assert red[np.ix_(ys, xs)].sum() > 50


@pytest.mark.parametrize("change", [{"unit": "path_gain"}, {"samples": np.zeros((60, 188), np.float32)}])
def test_other_frames_are_refused(tmp_path, change):
    with pytest.raises(InputError, match="not 50 frames of normalised baseband"):
        draw_receiver(replace(at_rest(), **change), tmp_path / "x.png")
