"""Inputs of strangers that broke ullage: what each gave before, and what it gives now."""

from __future__ import annotations

import runpy
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.ports.registry import read_map

CASES = Path(__file__).parents[2] / "shared" / "data" / "cases"
pytestmark = [
    pytest.mark.skipif(not CASES.is_dir(), reason="needs ../shared/data/cases"),
    pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning"),
]


def high(name: str) -> float:
    """Greatest coordinate of a world [m]."""
    return float(ul.load_scene(CASES / "world" / name, search_path=[CASES / "world/nested_merge"]).bounds.max())


def echo_db(name: str) -> float:
    """The strongest echo of a mesh 3 m ahead of a radar without noise [dB]."""
    scene = ul.load_scene(CASES / "mesh" / f"{name}.obj")
    x, y, z = scene.bounds.mean(axis=0)
    radar = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
    frames = ul.simulate(scene, ul.Trajectory.stationary((x - 3, y, z)), radar)
    return float(20 * np.log10(abs(frames.samples).max()))


def recorded(name: str) -> ul.Frames:
    frames = ul.open(CASES / "recording" / name).frames()
    assert isinstance(frames, ul.Frames)
    return frames


def poses_beside(name: str) -> int:
    """Poses of a track, once a recording lies beside it."""
    shutil.copy(CASES / "recording" / name, "track.txt")
    axis = {"times_s": np.arange(9.0), "ranges_m": 0.05 * np.arange(9), "center_hz": 7e9, "bandwidth_hz": 1e9}
    np.savez("radar.npz", samples=np.ones((9, 9), complex), **axis)
    return len(ul.open(".").trajectory())


def echoes_of(script: str) -> int:
    """Frames with an echo in the bag that a script makes."""
    runpy.run_path(str(CASES / "recording" / script))
    return int((abs(ul.open("over_max").frames().samples) > 0).any(axis=1).sum())


TABLE: dict[str, tuple[str, Callable[[], float], float]] = {
    # input: before; how it is read; what it gives now
    "world/nested_merge": ("a link unknown to relative_to", lambda: high("nested_merge/world.sdf"), 3.5),
    "world/stock_world.sdf": ("model://sun refused", lambda: high("stock_world.sdf"), 50.0),
    "world/stl_bytes_after_the_end.stl": ("no triangles", lambda: high("stl_bytes_after_the_end.stl"), 3.0),
    "world/utm_world.sdf": ("northing refused", lambda: high("utm_world.sdf"), 40.5),
    "map/tiny_yaw.yaml": ("turned", lambda: read_map(CASES / "map/map_yaml/tiny_yaw.yaml").percent.size, 600),
    "map/exponent.yaml": ("text", lambda: read_map(CASES / "map/map_yaml/exponent.yaml").percent.size, 600),
    "recording/motive122": ("refused", lambda: recorded("motive122").believed.position.shape[0], 60),
    "recording/mrm44": ("misread", lambda: recorded("mrm44").believed.position.shape[0], 60),
    "recording/pulson_no_track": ("refused", lambda: len(recorded("pulson_no_track")), 60),
    "recording/track_one_nan.txt": ("refused", lambda: poses_beside("track_one_nan.txt"), 199),
    "recording/range_over_max.py": ("200 of 200", lambda: echoes_of("range_over_max.py"), 0),
    "mesh/plate_double_sided": ("+12.7 dB", lambda: echo_db("plate_double_sided") - echo_db("plate_once"), 0),
    "mesh/plate_two_skins_1mm": ("+6 dB", lambda: echo_db("plate_two_skins_1mm") - echo_db("plate_once"), 0),
    "mesh/column16_split": ("-11.4 dB", lambda: echo_db("column16_split") - echo_db("column16"), 0),
}


@pytest.mark.parametrize("name", TABLE)
def test_what_broke_gives_the_right_value(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _before, read, now = TABLE[name]
    assert read() == pytest.approx(now, abs=0.1)


def test_a_fifth_of_samples_at_the_limit_is_warned_of() -> None:
    with pytest.warns(ul.UllageWarning, match="80 of 80 scans are saturated.*24 % of all samples"):
        recorded("saturated_no_warning.npz")
