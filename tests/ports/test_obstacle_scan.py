"""Obstacle distances by sector as a LaserScan of the body."""

from __future__ import annotations

import numpy as np

import ullage as ul
from ullage.ports.publisher import Publisher
from ullage.ports.schema import from_bytes
from ullage.processing.obstacles import ObstacleStage


def test_a_scan_holds_the_wall_ahead_and_nothing_where_no_radar_points() -> None:
    scene = ul.scenes.plate(width_m=2, height_m=2, distance_m=2.5, material="concrete")
    path = ul.Trajectory.line((0, 0, 0), (0.3, 0, 0), speed_m_s=0.3, rate_hz=20)
    frames = ul.simulate(scene, path, ul.RadarSpec.preset("x4m05"), seed=1)
    assert isinstance(frames, ul.Frames)
    publisher = Publisher()
    publisher.messages(frames)
    last = list(ObstacleStage().update({frames.sensor: frames}))[-1]
    (message,) = publisher.messages(last)
    scan = from_bytes(message.kind, message.data)
    assert (message.topic, message.t_ns, scan.header.frame_id) == ("obstacles", last.t_ns, "base_link")
    assert len(scan.ranges) == 72
    assert abs(scan.angle_min + 36 * scan.angle_increment) < 1e-6  # forward
    assert abs(scan.ranges[36] - 2.2) < 0.1
    assert np.isnan(scan.ranges[0])  # behind
