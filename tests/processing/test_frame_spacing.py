"""A map hangs little on how far apart its frames are: evidence counts by the metre flown, not by the frame."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from studies.thesis import flights
from ullage.grids import Grid
from ullage.processing.blocks import Blocks
from ullage.processing.mapper_bows import own_share
from ullage.processing.mapper_echoes import Echo
from ullage.processing.mapper_looks import LOOK_SHARE, STEP_M, Listener, dense_looks, look_share

SIZE = (6.0, 5.0, 3.0)


@pytest.fixture(scope="module")
def flown() -> tuple[ul.Scene, dict[str, ul.Frames]]:
    """A round through a room, a frame every 2 cm."""
    scene = ul.scenes.room(SIZE)
    path = flights.level_round(3)
    inner = ul.Trajectory(path.t_ns, path.position * [0.7, 0.7, 1.0], path.quat_xyzw)
    return scene, flights.received(scene, inner, 3)


SLOW = [pytest.param(stride, marks=pytest.mark.slow) for stride in (3, 7, 10)]


@pytest.mark.parametrize("stride", [1, 5, *SLOW])  # 1.4 to 14 cm
def test_a_room_is_mapped_about_as_well_from_sparse_frames(flown, stride):
    scene, frames = flown
    sparse = {name: part[::stride] for name, part in frames.items()}
    judged_by = {name: part[::5] for name, part in frames.items()}  # the same surface in view for every stride
    found = ul.metrics.map_quality(ul.map_occupancy(sparse, flights.plane_of(scene), method="rules"), scene, judged_by)
    assert found["f1"].value > 0.85
    assert found["precision"].value > 0.93
    assert found["surface_declared_free"].value < 0.01


def test_a_volume_is_mapped_from_frames_10_cm_apart(flown):
    scene, _ = flown
    path = flights.rising_round(3)
    inner = ul.Trajectory(path.t_ns, path.position * [0.7, 0.7, 1.0], path.quat_xyzw)
    sparse = flights.received(scene, inner[::7], 3)
    found = ul.metrics.map_quality(ul.map_occupancy(sparse, flights.volume_of(scene), method="rules"), scene, sparse)
    assert found["f1"].value > 0.85  # 0.75 where looks count alike however far apart
    assert found["precision"].value > 0.95
    assert found["surface_declared_free"].value < 0.01


def test_a_look_far_from_the_one_before_stands_for_several():
    assert [dense_looks(step) for step in (0.0, 0.05, 0.06, 0.0605)] == [1.0] * 4
    assert dense_looks(0.12) == 2.0
    assert dense_looks(1.0) == 2.5
    echoes = [Echo(j, np.zeros(3), np.ones(3), 3.0, 0.0, 1e-3, 0.02, 0.9, looks=2.0) for j in range(5)]
    assert own_share(0.4, echoes) == pytest.approx(0.8)
    assert own_share(0.8, echoes) == 1.0


def test_looks_say_as_much_for_each_metre_until_they_share_nothing():
    assert look_share(STEP_M) == pytest.approx(LOOK_SHARE)
    assert look_share(0.05) / 0.05 == pytest.approx(look_share(0.1) / 0.1)
    assert look_share(0.0) == look_share(STEP_M)  # turned, not moved
    assert look_share(1.0) == 1.0


@pytest.mark.parametrize("spacing", [0.02, 0.1, 0.16])
def test_a_bearing_is_had_from_frames_however_sparse(spacing):
    wall = ul.scenes.plate(6, 3, 3.0)
    n = round(2.0 / spacing)
    path = ul.Trajectory.line((0, -1, 0), (0, 1, 0), 0.5, 0.5 * n / 2.0)
    frames = ul.simulate(wall, path, ul.RadarSpec.preset("x4m05"), seed=1)
    listener = Listener(float(frames.range_m[0]), frames.spec.bin_m, frames.spec.wavelength_m)
    looks = [*listener.hear(frames), *listener.flush()][3:-3]
    best = [look.echoes[np.argmax(look.echoes[:, 5])] for look in looks]
    assert all(look.track.any() for look in looks)
    assert np.allclose([echo[2] for echo in best], 0.0, atol=0.05)  # the foot lies square to the track
    assert np.all(np.array([echo[3] for echo in best]) < 0.1)


def test_a_strip_says_as_much_wherever_its_looks_fall_in_the_cells():
    said = []
    for shift in (0.0, 0.025, 0.05):
        blocks = Blocks(Grid((-1.0, -1.0, 0.0), 0.1, (20, 20)))
        for x in np.arange(-0.8, 0.81, 0.1) + shift:
            blocks.lay(np.array([x, 0.05, 0.0]), np.array([0.0, 1.0, 0.0]), (0.035, 0.14, 2.0))
        pools = blocks.pools
        said.append(int(pools.hits[pools.slots[0, 0, 0]].max()))
    assert max(said) - min(said) <= 2
