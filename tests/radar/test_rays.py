"""The thesis' ray model: its equations, what an amplitude means, and a plain twin."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ullage as ul
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.fan import drawn_rays, ray_area, ray_fan, ray_spacing_m, rays_for, reaching_max_range, smoothed, window
from ullage.geometry import quat_matrix, rpy_quat
from ullage.ports import schema as ros
from ullage.ports.publisher import Publisher
from ullage.radar.rays import echoes_thesis
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec, Rig, ThesisSpec
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

X4 = RadarSpec.preset("x4m05")
HERE = Trajectory.stationary()


def with_thesis(**changes):
    return X4.but(thesis=ThesisSpec(**changes))


def test_the_printed_ray_counts():
    assert rays_for(65, 0.2, 10) == pytest.approx(57.73, abs=0.005)  # eq. 4.5's result
    assert math.radians(32.5) / math.atan(0.4 / 20) == pytest.approx(28.37, abs=0.01)  # eq. 4.5 as printed
    assert ray_spacing_m(65, 30, 10) == pytest.approx(0.4, abs=0.01)  # "only 0.4 at 10 meters"
    assert ray_spacing_m(65, 30, 5) == pytest.approx(0.2, abs=0.005)
    assert ray_spacing_m(65, 58, 10) <= 0.2 < ray_spacing_m(65, 57, 10)


@pytest.mark.parametrize(("azimuth", "n", "distance"), [(65, 30, 10), (90, 2, 1), (10, 500, 33)])
def test_spacing_and_count_undo_each_other(azimuth, n, distance):
    assert rays_for(azimuth, ray_spacing_m(azimuth, n, distance), distance) == pytest.approx(n, rel=1e-12)


def test_the_fan_is_square_even_and_centred():
    fan = ray_fan(ThesisSpec(rays_per_side=31))
    assert len(fan) == 961
    assert np.linalg.norm(fan, axis=1) == pytest.approx(1)
    assert fan[480] == pytest.approx([1, 0, 0])
    azimuth = np.degrees(np.arctan2(fan[:, 1], fan[:, 0]))
    elevation = np.degrees(np.arcsin(fan[:, 2]))
    for angle in (azimuth, elevation):
        assert angle.min() == pytest.approx(-32.5)
        assert angle.max() == pytest.approx(32.5)
    assert np.unique(azimuth.round(9)).size == 31
    between = np.linalg.norm(fan[480] - fan[481]) * 10
    assert between == pytest.approx(ray_spacing_m(65, 31, 10), rel=1e-3)


def twin(scene, path, spec):
    """Eq. 4.1 and 4.2 ray by ray, in plain Python."""
    caster = Raycaster(scene, wires=True)
    thesis, out = spec.thesis, np.zeros((len(path), spec.bins))
    for f in range(len(path)):
        fan = ray_fan(thesis) @ quat_matrix(path.quat_xyzw[f]).T
        face, distance = caster.hits(path.position[f], fan, t_ns=path.t_ns[f])
        corners = scene.corners(int(path.t_ns[f]))
        for i, v in enumerate(fan):
            if face[i] < 0 or not thesis.min_range_m <= distance[i] <= thesis.max_range_m:
                continue
            a, b, c = corners[face[i]]
            n = np.cross(b - a, c - a)
            theta = math.acos(min(1.0, abs(v @ n) / np.linalg.norm(n)))
            mine = scene.objects[scene.face_object[face[i]]].material.reflection
            k = round((distance[i] - spec.range_start_m) / spec.bin_m)
            if 0 <= k < spec.bins:
                out[f, k] += mine * math.cos(theta) * (distance[i] / thesis.max_range_m) ** 2
    out *= ray_spacing_m(thesis.fov_deg, thesis.rays_per_side, thesis.max_range_m) ** 2
    box = np.ones(thesis.smoothing_bins) / thesis.smoothing_bins
    return np.stack([np.convolve(row, box, "same") for row in out])


def test_agrees_with_the_plain_twin():
    scene = ul.scenes.room(
        size_m=(6, 4, 3), material="concrete", plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}
    )
    t = np.arange(3) * 10**8
    path = Trajectory(t, [[0, 0, 0], [0.1, 0.2, 0], [-1, 0, 0.5]], rpy_quat([0, 0.1, 0], [0, 0, 0.3], [0, 1, 2]))
    got = echoes_thesis(scene, path, X4)
    assert got.dtype == np.float32
    assert np.allclose(got, twin(scene, path, X4), atol=1e-6)
    assert got.max() > 0.1


def test_an_amplitude_is_the_lit_area_whatever_the_rays_and_the_maximum_range():
    scene = ul.scenes.plate(width_m=1.0, height_m=1.0, distance_m=4.0)
    for changes in ({"rays_per_side": 58}, {"rays_per_side": 300}, {"rays_per_side": 300, "max_range_m": 5.0}):
        total = echoes_thesis(scene, HERE, with_thesis(**changes)).sum()
        assert total == pytest.approx(1.0, rel=0.1 if changes["rays_per_side"] < 100 else 0.02)


def test_a_tilted_plate_follows_the_cosine_law_alone():
    facing, tilted = (
        echoes_thesis(
            ul.scenes.plate(width_m=1, height_m=1, distance_m=4, yaw_deg=yaw), HERE, with_thesis(rays_per_side=300)
        ).sum()
        for yaw in (0, 45)
    )
    assert tilted / facing == pytest.approx(0.5, rel=0.03)  # cos 45 deg as many rays meet it, at cos 45 deg each


def test_a_facing_wall_and_a_half_metre_plate_stand_out_at_the_thesis_threshold():
    for distance in (1.0, 2.0, 3.0, 5.0, 8.0):
        wall = echoes_thesis(ul.scenes.plate(width_m=40, height_m=40, distance_m=distance, material="pec"), HERE, X4)
        assert wall.max() > 0.3 * distance
        first = X4.range_m[np.argmax(wall[0] > 0.038)]
        assert distance - 2.1 * X4.bin_m < first < distance + X4.bin_m
    for distance in (1.0, 2.0, 3.0, 4.0, 5.0):
        plate = echoes_thesis(ul.scenes.plate(width_m=0.5, height_m=0.5, distance_m=distance), HERE, X4)
        assert plate.max() > 0.038


def test_one_ray_alone_passes_the_threshold_beyond_8_6_m_only():
    per_bin = ray_area(ThesisSpec()) / X4.thesis.smoothing_bins
    assert per_bin * 0.5**2 == pytest.approx(0.0127, abs=2e-4)  # at 5 m: three rays in three bins make 0.038
    assert math.sqrt(0.038 / per_bin) * 10 == pytest.approx(8.63, abs=0.02)
    for distance, passes in ((5.0, False), (8.4, False), (8.8, True)):
        one = ul.scenes.plate(width_m=0.5 * distance / 29, height_m=0.5 * distance / 29, distance_m=distance)
        turned = Trajectory.stationary(yaw_deg=32.5 / 29)
        up = np.array([0, 0, distance * math.tan(math.radians(32.5 / 29))])
        shifted = Scene(one.vertices + up, one.faces, one.face_object, one.objects)
        hit = echoes_thesis(shifted, turned, X4)
        assert np.count_nonzero(hit) == 3
        assert (hit.max() > 0.038) == passes


@pytest.mark.parametrize("distance", [9.55, 9.7, 9.95])
def test_a_plate_anywhere_up_to_the_maximum_range_is_a_local_maximum(distance):
    plate = ul.scenes.plate(width_m=2.0, height_m=2.0, distance_m=distance)
    frames = ul.simulate(plate, HERE, X4.but(noise=None), fidelity="thesis")
    assert frames.range_m[-1] > X4.thesis.max_range_m
    assert frames.spec.range_m == pytest.approx(frames.range_m)
    found = ul.detect(frames, method="first_peak")
    assert found.range_m == pytest.approx([distance], abs=0.1)
    assert not ul.simulate(ul.scenes.plate(2, 2, 10.2), HERE, X4.but(noise=None), fidelity="thesis").samples.any()


def test_the_axis_is_made_longer_for_rays_only_and_never_shorter():
    plate = ul.scenes.plate(1, 1, 3.0)
    assert ul.simulate(plate, HERE, X4).samples.shape[1] == X4.bins
    assert reaching_max_range(X4.but(bins=400)).bins == 400
    assert reaching_max_range(with_thesis(max_range_m=5.0)).bins == X4.bins


def test_reflection_coefficient_and_distance_limits():
    wall = ul.scenes.plate(width_m=40, height_m=40, distance_m=4, material="pec")
    steel, wood = (
        echoes_thesis(Scene(wall.vertices, wall.faces, wall.face_object, other.objects), HERE, X4)
        for other in (wall, ul.scenes.plate(width_m=1, height_m=1, distance_m=4, material="wood"))
    )
    share = ul.scenes.plate(width_m=1, height_m=1, distance_m=4, material="wood").objects[0].material.reflection
    assert wood == pytest.approx(share * steel, rel=1e-5)
    assert echoes_thesis(wall, HERE, with_thesis(max_range_m=3.9)).max() == 0
    assert echoes_thesis(wall, HERE, with_thesis(min_range_m=6.0)).max() == 0
    assert echoes_thesis(Scene.empty(), HERE, X4).max() == 0


def test_a_wire_met_by_one_ray_looks_like_a_plate():
    """The fault that the thesis names, kept: one ray counts its whole footprint, however thin the thing it meets."""
    wire = ul.scenes.wire(radius_m=0.0005, length_m=2.0, distance_m=5.0)
    fan = ThesisSpec(rays_per_side=31)  # odd: one column looks straight ahead
    seen = echoes_thesis(wire, HERE, X4.but(thesis=fan)).sum()
    column = 2 * math.degrees(math.atan(1 / 5)) / (65 / 30)
    assert seen == pytest.approx(round(column) * ray_area(fan) * 0.25, rel=0.15)


def test_moving_things_stand_where_they_are_at_each_frame():
    plate = ul.scenes.plate(width_m=1, height_m=1, distance_m=2.0)
    t = np.arange(0, 5) * 10**9
    motion = Trajectory(t, np.stack([t * 1e-9, 0 * t, 0 * t], 1), np.tile([0, 0, 0, 1.0], (5, 1)))
    thing = plate.objects[0]
    scene = Scene(plate.vertices, plate.faces, plate.face_object, (type(thing)(thing.name, thing.material, motion),))
    path = Trajectory(t, np.zeros((5, 3)), np.tile([0, 0, 0, 1.0], (5, 1)))
    rows = echoes_thesis(scene, path, X4)
    assert X4.range_m[rows.argmax(1)] == pytest.approx([2, 3, 4, 5, 6], abs=0.12)


def test_the_moving_average_keeps_sum_and_place_even_when_its_width_is_even():
    row = np.zeros((1, 60))
    row[0, 30] = 1.0
    for bins in (1, 2, 3, 4, 5):
        out = smoothed(row, with_thesis(smoothing_bins=bins))[0]
        assert out.sum() == pytest.approx(1)
        assert out @ np.arange(60) == pytest.approx(30)
    rf = RadarSpec(output="rf", bins=1504)
    assert window(rf).sum() == pytest.approx(rf.decimation)  # as wide in metres, and as high, as at baseband
    wall = ul.scenes.plate(width_m=40, height_m=40, distance_m=4)
    high = [echoes_thesis(wall, HERE, s.but(thesis=ThesisSpec(rays_per_side=400))).max() for s in (X4, rf)]
    assert high[1] == pytest.approx(high[0], rel=0.1)


def test_ray_counts_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="n is 1"):
        ray_spacing_m(65, 1, 10)
    with pytest.raises(InputError, match="spacing_m 0"):
        rays_for(65, 0, 10)


def test_the_sections_of_a_ring_are_rays_of_the_ring():
    ring = ThesisSpec(fov_deg=360.0, rays_per_side=161, rays_up=30, elevation_deg=65.0)
    whole = ray_fan(ring).reshape(30, 161, 3)
    step = np.degrees(np.arccos(np.clip(np.sum(whole[15, 1:] * whole[15, :-1], axis=1), -1, 1)))
    assert np.ptp(step) < 1e-6, "even"
    assert np.linalg.norm(whole[15, 0] - whole[15, -1]) > 0.03, "no ray twice"
    assert ray_area(ring) == pytest.approx(ray_area(ThesisSpec()), rel=0.01)
    for spec in Rig.preset("thesis-ring").sensors.values():
        turned = ray_fan(spec.thesis) @ spec.mount.body_from_sensor()[:3, :3].T
        apart = np.linalg.norm(turned[:, None] - whole.reshape(-1, 3)[None], axis=2).min(axis=1)
        assert apart.max() < 1e-9
        across = np.degrees(np.arctan2(*ray_fan(spec.thesis).T[1::-1]))
        assert 30.2 < across.max() <= 32.5 + 1e-9
        assert -32.5 - 1e-9 <= across.min() < -30.2


def test_a_radar_cut_from_a_ring_receives_what_one_with_its_own_fan_does():
    room = ul.scenes.room(size_m=(6, 4, 3))
    own = Rig.preset("thesis-ring", thesis=ThesisSpec(rays_per_side=120, noise_sigma=0.0))
    alone = Rig(sensors={n: s.but(thesis=s.thesis.but(ring_rays=None)) for n, s in own.sensors.items()})
    ring, fans = (simulate(room, HERE, rig, fidelity="thesis") for rig in (own, alone))
    for name, part in ring.items():
        assert part.samples.sum() == pytest.approx(fans[name].samples.sum(), rel=0.03)
        sums = [np.cumsum(one.samples[0]) / one.samples.sum() for one in (part, fans[name])]
        assert np.max(abs(sums[0] - sums[1])) < 0.03


def test_one_radar_may_have_the_whole_ring():
    ring = X4.but(thesis=ThesisSpec(fov_deg=360.0, rays_per_side=160, rays_up=30, elevation_deg=65.0, noise_sigma=0.0))
    room = ul.scenes.room(size_m=(4, 8, 6))  # walls at 2 m ahead and behind, 4 m aside
    path = Trajectory.stationary(n=1)
    whole = echoes_thesis(room, path, ring)[0]
    ahead = echoes_thesis(room, path, X4.but(thesis=ThesisSpec(noise_sigma=0.0)))[0]
    near = np.abs(X4.range_m - 2.0) < 0.1
    assert whole[near].max() == pytest.approx(2 * ahead[near].max(), rel=0.1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fov_deg": 200.0}, "fov_deg 200 needs an elevation_deg below 180"),
        ({"ring_rays": 4}, "ring_rays 4 leaves fewer than two rays in 65 deg"),
    ],
)
def test_fans_that_cannot_be_are_refused(changes, words):
    with pytest.raises(ul.InputError, match=words):
        ThesisSpec(**changes)


@pytest.mark.parametrize(
    "fan", [ThesisSpec(), ThesisSpec(rays_per_side=300), Rig.preset("thesis-ring").sensors["left"].thesis]
)
def test_drawn_rays_are_some_of_the_fan_at_the_maximum_range(fan):
    ends = drawn_rays(X4.but(thesis=fan))
    assert 60 < len(ends) <= 225
    apart, _ = cKDTree(ray_fan(fan)).query(ends / 10)
    assert apart.max() < 1e-9


def test_rays_are_published_once_in_the_frame_of_their_radar_where_asked_for():
    frames = simulate(ul.scenes.room(), Trajectory.stationary(n=3), Rig.preset("thesis-4"), fidelity="thesis")
    assert not [m for m in Publisher().messages(frames) if m.topic.endswith("/rays")]
    publisher = Publisher(rays=True, frame_prefix="d1/")
    drawn = [m for _ in range(2) for m in publisher.messages(frames) if m.topic.endswith("/rays")]
    assert [m.topic for m in drawn] == [f"radar/{name}/rays" for name in ("front", "left", "back", "right")]
    marker = ros.from_bytes(drawn[1].kind, drawn[1].data).markers[0]
    assert (marker.header.frame_id, marker.frame_locked, len(marker.points)) == ("d1/left", True, 450)
