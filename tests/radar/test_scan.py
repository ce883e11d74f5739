"""The thesis' processing of somebody else's rays, held against that of our own on the same surfaces."""

from types import SimpleNamespace

import numpy as np
import pytest

import ullage as ul
from ullage.fan import fan_shape, ray_fan
from ullage.geometry import quat_matrix
from ullage.ports.scanning import scan_of, spec_of
from ullage.radar.rays import echoes_thesis
from ullage.radar.scan import echoes_of_scans, facing
from ullage.world.raycast import Raycaster

SPEC = ul.RadarSpec.preset("x4m05", thesis={"rays_per_side": 41})
FAN = ray_fan(SPEC.thesis).reshape(41, 41, 3)


def scanned(scene, path):
    """What a lidar with the fan would give: ranges and coefficients (up, across)."""
    rays = Raycaster(scene, wires=True)
    turned = FAN.reshape(-1, 3) @ quat_matrix(path.quat_xyzw)[0].T
    face, distance, cosine = rays.trace(np.repeat(path.position, len(turned), 0), turned)
    strength = np.array([thing.material.reflection for thing in scene.objects])[rays.owner]
    met = face >= 0
    ranges = np.where(met, distance, np.inf).reshape(41, 41)
    return ranges, np.where(met, strength[face], 0.0).reshape(41, 41), np.where(met, cosine, np.nan).reshape(41, 41)


@pytest.mark.parametrize("tilt", [0.0, 0.4, 0.9])
def test_on_a_plane_every_angle_is_exact(tilt):
    normal = np.array([np.cos(tilt), np.sin(tilt), 0.0])
    distance = 3.0 / (FAN @ normal)
    seen = np.where(distance > 0, distance, np.nan)
    met = np.isfinite(seen)
    np.testing.assert_allclose(facing(seen, FAN)[met], (FAN @ normal)[met], rtol=1e-9)


def test_at_the_edge_of_a_plate_the_angle_is_the_plates():
    scene = ul.scenes.plate(width_m=1.0, height_m=1.0, distance_m=3.0, yaw_deg=30)
    behind = ul.scenes.plate(width_m=9.0, height_m=9.0, distance_m=6.0)
    ranges, _, cosine = scanned(ul.Scene.union([scene, behind]), ul.Trajectory.stationary())
    found = facing(np.where(np.isfinite(ranges), ranges, np.nan), FAN)
    good = np.isfinite(ranges)
    assert np.mean(np.abs(found - cosine)[good] < 1e-6) > 0.99  # corners alone have no neighbour of their own


def test_a_ray_that_stands_alone_counts_as_facing():
    alone = np.full((41, 41), np.nan)
    alone[20, 20] = 2.0
    assert facing(alone, FAN)[20, 20] == 1.0


def test_profiles_are_those_of_our_own_rays():
    scene = ul.Scene.union([ul.scenes.plate(width_m=2, height_m=2, distance_m=3, yaw_deg=20, material="concrete"),
                            ul.scenes.sphere(radius_m=0.3, distance_m=1.5)])  # fmt: skip
    path = ul.Trajectory.stationary((0, 0.1, 0.05), yaw_deg=5)
    ranges, strength, _ = scanned(scene, path)
    ours = echoes_thesis(scene, path, SPEC)
    theirs = echoes_of_scans(ranges[None], strength[None], SPEC)
    assert np.abs(theirs - ours).max() < 0.05 * ours.max()
    assert theirs.sum() == pytest.approx(ours.sum(), rel=0.02)


def test_nothing_met_gives_nothing():
    assert not echoes_of_scans(np.full((2, 41, 41), np.inf), np.ones((2, 41, 41)), SPEC).any()


def test_a_scan_of_another_fan_is_refused():
    with pytest.raises(ul.InputError, match=r"scans of \(1, 30, 30\) ranges.*allowed: \(n, 41, 41\)"):
        echoes_of_scans(np.ones((1, 30, 30)), np.ones((1, 30, 30)), SPEC)


class Told:
    """A `LaserScan` as either Gazebo sends it."""

    def __init__(self, ranges, across_rad, up_rad):
        self.vertical_count, self.count = ranges.shape
        self.ranges, self.intensities = ranges.ravel(), np.ones(ranges.size)
        (self.angle_min, self.angle_max), (self.vertical_angle_min, self.vertical_angle_max) = across_rad, up_rad
        self.range_min, self.range_max = 0.1, 10.0


def told_of(spec, path, room, across_rad, up_rad, again=0):
    """What a ray sensor with the fan of a radar says of a room; `again` rays of each row come twice."""
    rays = ray_fan(spec.thesis) @ quat_matrix(path.quat_xyzw)[0].T
    found = Raycaster(room).distances(path.position[0], rays).reshape(fan_shape(spec.thesis))
    return Told(np.concatenate([found, found[:, :again]], axis=1), across_rad, up_rad)


@pytest.mark.parametrize("wide_deg", [100.0, 360.0])
def test_scans_wider_than_high_and_full_circles_become_frames(wide_deg):
    spec = ul.RadarSpec.preset(
        "x4m05", thesis={"rays_per_side": 80, "fov_deg": wide_deg, "rays_up": 21, "elevation_deg": 40.0}
    )
    room, path = ul.scenes.room(size_m=(6, 4, 3)), ul.Trajectory.stationary(position_m=(0.5, 0, 0), n=1)
    half = np.radians([wide_deg / 2, 20.0])
    told = told_of(spec, path, room, (-half[0], half[0]), (-half[1], half[1]), again=int(wide_deg == 360))
    scan = scan_of(told, SimpleNamespace(sec=0, nsec=0), ((0.5, 0, 0), (0, 0, 0, 1)))
    got = spec_of(scan, spec)
    np.testing.assert_allclose(ray_fan(got.thesis), ray_fan(spec.thesis), atol=1e-9)
    want = echoes_thesis(room, path, got)
    made = echoes_of_scans(scan.range_m[None], np.ones((1, *scan.range_m.shape)), got)
    assert made.sum() == pytest.approx(want.sum() / room.objects[0].material.reflection, rel=0.05)


def test_a_scan_of_one_row_makes_no_radar():
    told = Told(np.ones((1, 90)), (-1, 1), (0, 0))
    with pytest.raises(ul.InputError, match=r"90 rays across and 1 up.*two or more"):
        spec_of(scan_of(told, SimpleNamespace(sec=0, nsec=0), ((0, 0, 0), (0, 0, 0, 1))), SPEC)
