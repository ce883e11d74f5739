"""A map hangs little on how far apart its frames are: evidence counts by the metre flown, not by the frame.

The quick tests fly frames 6 to 8 cm apart in test_likelihood.py and test_likelihood_volume.py.
"""

from __future__ import annotations

import pytest

import ullage as ul
from studies.thesis import flights

pytestmark = pytest.mark.slow
SIZE = (6.0, 5.0, 3.0)


@pytest.fixture(scope="module")
def flown() -> tuple[ul.Scene, dict[str, ul.Frames]]:
    """A round through a room, a frame every 2 cm."""
    scene = ul.scenes.room(SIZE)
    path = flights.level_round(3)
    inner = ul.Trajectory(path.t_ns, path.position * [0.7, 0.7, 1.0], path.quat_xyzw)
    return scene, flights.received(scene, inner, 3)


@pytest.mark.parametrize("stride", [1, 3, 5, 10])  # 1.4 to 14 cm
def test_a_room_is_mapped_about_as_well_from_sparse_frames(flown, stride):
    scene, frames = flown
    sparse = {name: part[::stride] for name, part in frames.items()}
    judged_by = {name: part[::5] for name, part in frames.items()}  # the same surface in view for every stride
    found = ul.metrics.map_quality(ul.map_occupancy(sparse, flights.plane_of(scene)), scene, judged_by)
    assert found["f1"].value > 0.85
    assert found["precision"].value > 0.93
    assert found["surface_declared_free"].value < 0.01


def test_a_volume_is_mapped_from_frames_10_cm_apart(flown):
    scene, _ = flown
    path = flights.rising_round(3)
    inner = ul.Trajectory(path.t_ns, path.position * [0.7, 0.7, 1.0], path.quat_xyzw)
    sparse = flights.received(scene, inner[::7], 3)
    found = ul.metrics.map_quality(ul.map_occupancy(sparse, flights.volume_of(scene)), scene, sparse)
    assert found["f1"].value > 0.85  # 0.75 where looks count alike however far apart
    assert found["precision"].value > 0.95
    assert found["surface_declared_free"].value < 0.01
