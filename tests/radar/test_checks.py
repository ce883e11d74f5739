"""What the physical radar warns of: meshes, places and frames that make echoes doubtful; and folding itself."""

import warnings

import numpy as np
import pytest
import trimesh

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.radar.physical import echoes, path_gain_cw
from ullage.world.scene import Scene

RADAR = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
HERE = ul.Trajectory.stationary()


def box(at=(3.0, 0, 0), *, edge=0.5):
    body = trimesh.creation.box((edge, edge, edge))
    return body.vertices + np.asarray(at), body.faces.copy()


def scene(vertices, faces):
    return Scene.of_mesh(vertices, faces, name="crate", made_of="steel")


def told(world, path=HERE, radar=RADAR):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ul.simulate(world, path, radar)
    return [str(w.message) for w in caught if issubclass(w.category, UllageWarning)]


def test_a_sound_world_is_silent():
    assert told(scene(*box())) == []
    assert told(ul.scenes.plate(0.5, 0.5, 3.0)) == []
    assert told(ul.scenes.room((4, 3, 2), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 1.0})) == []
    assert told(ul.scenes.sphere(0.2, 2.0)) == []


def test_flipped_unclosed_and_doubled_meshes():
    vertices, faces = box()
    turned = faces.copy()
    turned[4] = turned[4][::-1]
    assert any("edges of 'crate' join faces of opposite orientation" in line for line in told(scene(vertices, turned)))
    (line,) = told(scene(vertices, faces[1:]))
    assert "the mesh of 'crate' is not closed: 3 of its edges" in line
    twice = Scene.union([ul.scenes.plate(0.5, 0.5, 3.0), ul.scenes.plate(0.5, 0.5, 3.0, name="again")])
    assert any("2 faces coincide with others" in line for line in told(twice))


def test_a_sensor_inside_a_body_or_close_to_one():
    (line,) = told(scene(*box((0, 0, 0))))
    assert "sensor 'radar' is inside 'crate'" in line
    (line,) = told(ul.scenes.plate(0.5, 0.5, 0.03))
    assert "sensor 'radar' comes within 30 mm of 'plate'" in line
    inward = box((0, 0, 0), edge=3.0)
    assert told(scene(inward[0], inward[1][:, ::-1])) == []  # a room


def test_each_world_is_told_once():
    world = scene(box()[0], box()[1][1:])
    assert len(told(world)) == 1
    assert told(world) == []


def test_a_frame_longer_than_the_fold():
    (line,) = told(ul.scenes.plate(0.5, 0.5, 3.0), radar=RADAR.but(bins=250))
    assert "the frame ends at 12.9 m, echoes fold at 9.87 m" in line
    assert told(ul.scenes.plate(0.5, 0.5, 3.0), radar=RADAR.but(bins=250, prf_div=32)) == []


@pytest.mark.parametrize("beyond", [1, 2])
def test_a_wall_beyond_the_frame_folds_into_it(beyond):
    fold = RADAR.unambiguous_range_m
    place = 3.0 + beyond * fold
    frame = echoes(ul.scenes.plate(60, 60, place), HERE, RADAR)[0]
    peak = int(np.argmax(abs(frame)))
    assert RADAR.range_m[peak] == pytest.approx(3.0, abs=RADAR.bin_m)
    whole = echoes(ul.scenes.plate(60, 60, place), HERE, RADAR.but(bins=700, prf_div=200))[0]
    assert abs(frame).max() == pytest.approx(abs(whole).max(), rel=0.02)
    assert 20 * np.log10(abs(frame).max()) == pytest.approx(
        20 * np.log10(RADAR.wavelength_m / (8 * np.pi * place)), abs=0.6
    )


def test_a_wall_across_both_ranges_counts_once():
    """A long wall beside the radar: its far part is not laid twice."""
    wall = ul.scenes.plate(60, 3, 4.0)
    long = RADAR.but(bins=700, prf_div=200)
    near = echoes(wall, HERE, RADAR)[0]
    assert abs(near - echoes(wall, HERE, long)[0][:188]).max() < 1e-3 * abs(near).max()


@pytest.mark.parametrize(
    ("world", "radar", "words"),
    [
        (ul.scenes.wire(radius_m=5e-5, length_m=1.0, distance_m=2.0), RADAR, "radius of 0.05 mm .*at least 0.1 mm"),
        (ul.scenes.sphere(0.1, 2.0), RADAR.but(bandwidth_hz=2e7, bins=20), "the pulse is 8.53 m wide, the frame only"),
    ],
)
def test_what_the_radar_cannot_do_is_refused(world, radar, words):
    with pytest.raises(InputError, match=words):
        ul.simulate(world, HERE, radar)


@pytest.mark.parametrize("thick_m", [0.0005, 0.0019, 0.003])
def test_a_thin_closed_plate_echoes_once(thick_m):
    body = trimesh.creation.box((thick_m, 0.5, 0.5))
    closed = scene(body.vertices + np.array([3 + thick_m / 2, 0, 0]), body.faces.copy())
    sheet = ul.scenes.plate(width_m=0.5, height_m=0.5, distance_m=3.0, material="steel")
    gain = [20 * np.log10(abs(path_gain_cw(world, HERE, RADAR)[0])) for world in (closed, sheet)]
    assert gain[0] == pytest.approx(gain[1], abs=0.1)
