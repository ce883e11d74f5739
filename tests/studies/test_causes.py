"""The experiments on causes: single changes change what they say and nothing else; kernels and levels are the same."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from studies.thesis import cpu_causes, image_causes, targets
from studies.thesis.targets import strafe
from studies.thesis.variants import with_ray_settings, without_models
from ullage.grids import Grid, Image
from ullage.kernels.elfes import insert_reading
from ullage.processing.elfes import ElfesMapper
from ullage.specs import Rig
from ullage.world.library import WORLDS
from ullage.world.scene import Scene

GRID = Grid((-1.0, -2.0, 0.0), 0.2, (20, 30))
RADAR = ul.RadarSpec.preset("x4m05")


def readings(scene: Scene) -> ul.Frames:
    return ul.simulate(scene, ul.Trajectory.stationary(n=3), RADAR, fidelity="thesis", seed=1)


def test_the_interpreted_kernel_makes_the_same_map():
    frames = readings(ul.scenes.plate(2, 2, 3.0))
    maps = []
    for kernel in (insert_reading, cpu_causes.interpreted(insert_reading)):
        mapper = ElfesMapper(GRID, kernel=kernel)
        mapper.update(frames)
        maps.append(mapper.map())
    assert (maps[0].percent == maps[1].percent).all()
    assert (maps[0].percent > 50).any()


def test_a_reading_without_an_echo_traverses_more_cells():
    near, none = (
        cpu_causes.reading_cost({"front": readings(s)}, GRID) for s in (ul.scenes.plate(2, 2, 2.0), Scene.empty())
    )
    assert none[1] > 1.5 * near[1]
    assert near[0] > 0


def test_a_change_removes_its_models_and_no_other():
    scene = WORLDS["ntnu-plate"].scene()
    bare = without_models(scene, "floor", "ceiling")
    assert {thing.name for thing in scene.objects} - {thing.name for thing in bare.objects} == {"floor", "ceiling"}


def test_every_radar_of_a_rig_gets_the_other_rays():
    rig = with_ray_settings(Rig.preset("thesis-4"), rays_per_side=58, noise_sigma=0.0)
    assert {(one.thesis.rays_per_side, one.thesis.noise_sigma) for one in rig.sensors.values()} == {(58, 0.0)}
    assert rig.sensors.keys() == Rig.preset("thesis-4").sensors.keys()


def test_the_level_of_a_target_is_that_of_its_own_cells():
    grid = Grid((0.0, 0.0, 0.0), 0.1, (20, 20))
    amplitude = np.full(grid.shape, 1e-3, np.float32)
    amplitude[10, 10], amplitude[2, 2], amplitude[10, 14] = 0.1, 1.0, 0.5
    image = Image(grid, amplitude, None, "summation")
    assert targets.level_db(image, np.array([1.05, 1.05])) == pytest.approx(-20.0, abs=1e-4)
    assert targets.level_db(image, np.array([0.25, 0.25])) == 0.0


def test_an_image_shows_the_target_at_its_place():
    path = strafe("ntnu-pole", step_m=0.1)
    frames = ul.simulate(ul.scenes.wire(0.05, 2.0, 1.0), path, RADAR.but(noise=None, antenna="isotropic"))
    image = targets.strafe_image(frames, method="backprojection")
    assert np.hypot(*(image.peak_m[:2] - [1.0, 0.0])) < 0.1


@pytest.mark.parametrize(("world", "ahead_m"), [("ntnu-plate", 0.0), ("ntnu-pole", 0.0)])
def test_a_target_stands_ahead_of_the_middle_of_its_track(world, ahead_m):
    place = targets.target_place(world)
    (x, *_), _ = WORLDS[world].path_xyzyaw
    assert place[0] > x + 1.0
    assert place[1] == pytest.approx(ahead_m, abs=0.05)


def test_wire_changes_take_away_what_they_name():
    scene = WORLDS["ntnu-wire"].scene()
    found = dict(image_causes.wire_changes(scene))
    assert len(found[image_causes.NO_WIRE].wires) == len(scene.wires) - 1
    assert len(found[image_causes.NO_PIPE].faces) < len(scene.faces)
    assert max(found["a wire of radius 5 cm"].wires.radius_m) == 0.05
    assert len(found["tilted by 30 deg across the track"].wires) == len(scene.wires)


def test_thesis_changes_change_one_thing_each():
    flight = image_causes.strafe_of("ntnu-plate")
    found = dict(image_causes.thesis_changes(flight))
    assert found[image_causes.AS_FLOWN] == flight
    assert not found[image_causes.NO_WALL].scene.has("wall_east")
    assert np.allclose(found["0.4 m higher"].path.position - flight.path.position, [0, 0, 0.4])
    assert found["no moving average"].spec.thesis.smoothing_bins == 1
    assert len(found["a fifth of the frames"].path) == -(-len(flight.path) // 5)
