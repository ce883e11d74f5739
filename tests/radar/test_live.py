"""Radars along poses that arrive one by one: the same frames as along the whole track, however the poses come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import ullage as ul
from ullage.data import joined
from ullage.world.moving import LiveMotion

ROOM = ul.scenes.room(size_m=(6, 4, 3))
RIG = ul.Rig.preset("thesis-4")


def track(seconds: float = 2.0, rate_hz: float = 50.0) -> ul.Trajectory:
    path = ul.Trajectory.line((-1, 0, 0), (-1 + 0.5 * seconds, 0, 0), 0.5, rate_hz)
    yaw = np.linspace(0, 0.7, len(path))
    zero = np.zeros_like(yaw)
    return ul.Trajectory(path.t_ns, path.position, np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], 1))


def listen(path: ul.Trajectory, cuts: list[int], radar: ul.RadarSpec | ul.Rig = RIG, **options: float) -> ul.Frames:
    live = ul.LiveRadars(ROOM, radar, fidelity="thesis", seed=5, **options)
    pieces = np.split(np.arange(len(path)), cuts)
    parts = [live.advance(path.t_ns[rows], path.position[rows], path.quat_xyzw[rows]) for rows in pieces]
    live.close()
    name = next(iter(live.sensors))
    return joined([part[name] for part in parts if name in part])


def test_frames_do_not_depend_on_how_the_poses_were_bunched() -> None:
    path = track()
    whole = listen(path, [])
    for cuts in (list(range(1, len(path))), [3, 4, 50]):
        parts = listen(path, cuts)
        assert np.array_equal(parts.t_ns, whole.t_ns)
        assert np.array_equal(parts.samples, whole.samples)


def test_frames_are_those_of_simulate_where_poses_and_frames_fall_together() -> None:
    path = track(rate_hz=17.0)
    live = listen(path, [5, 6, 20])
    flown = ul.simulate(ROOM, path, RIG, fidelity="thesis", seed=5)["front"]
    assert len(live) == len(path)
    assert np.array_equal(live.t_ns, flown.t_ns)
    assert np.allclose(live.samples, flown.samples, atol=1e-6)


def test_frames_that_are_summed_do_not_depend_on_how_poses_and_objects_were_bunched() -> None:
    spec = ul.RadarSpec.preset("x4m05", noise=None, integration_s=0.05)
    path = ul.Trajectory.line((-1, 0, 0), (-0.7, 0, 0), 0.5, 50.0)
    plate = ul.scenes.plate(1, 1, 2.0)

    def flown(cuts: list[int]) -> ul.Frames:
        motion = LiveMotion((0, 0, 0), (0, 0, 0, 1))
        scene = replace(plate, objects=(replace(plate.objects[0], motion=motion),))
        live, found = ul.LiveRadars(scene, spec), []
        for rows in np.split(np.arange(len(path)), cuts):
            for k in rows:
                motion.see(int(path.t_ns[k]), (0.1 * np.sin(k), 0, 0), (0, 0, 0, 1))
            found.append(live.advance(path.t_ns[rows], path.position[rows], path.quat_xyzw[rows]))
        live.close()
        return joined([part["radar"] for part in found if part])

    whole = flown([])
    assert whole.t_ns[-1] <= path.t_ns[-1] - 25e6 < whole.t_ns[-1] + 1e9 / spec.fps
    for cuts in (list(range(1, len(path))), [2, 3, 11]):
        parts = flown(cuts)
        assert np.array_equal(parts.t_ns, whole.t_ns)
        assert np.array_equal(parts.samples, whole.samples)
    instant = ul.simulate(plate, path, spec.but(integration_s=0))
    assert abs(whole.samples).max() < 0.9 * abs(instant.samples).max()


def test_a_pose_between_two_lies_on_the_line_and_the_arc() -> None:
    path = track(rate_hz=10.0)
    live = listen(path, [4], RIG.sensors["front"].but(mount=ul.MountSpec()), rate_hz=40.0)
    known: NDArray[np.float64] = np.stack([np.interp(live.t_ns, path.t_ns, path.position[:, k]) for k in range(3)], 1)
    assert live.poses is not None
    assert np.allclose(live.poses.position, known, atol=1e-9)
    yaw = 2 * np.arctan2(live.poses.quat_xyzw[:, 2], live.poses.quat_xyzw[:, 3])
    assert np.allclose(yaw, np.interp(live.t_ns, path.t_ns, np.linspace(0, 0.7, len(path))), atol=1e-9)
    assert np.allclose(np.diff(live.t_ns), 25e6)


def test_a_clock_that_jumps_back_is_refused_until_reset() -> None:
    live = ul.LiveRadars(ROOM, RIG, fidelity="thesis")
    assert set(live.advance(10**9, (0, 0, 0), (0, 0, 0, 1))) == set(RIG.sensors)
    with pytest.raises(ul.InputError, match=r"clock of the poses does not rise.*reset"):
        live.advance(10**9 - 1, (0, 0, 0), (0, 0, 0, 1))
    live.reset()
    assert len(live.advance(5, (0, 0, 0), (0, 0, 0, 1))["front"]) == 1


@pytest.mark.parametrize(("options", "words"), [({"rate_hz": 0}, "rate_hz is 0"), ({"max_bounces": 7}, "max_bounces")])
def test_settings_out_of_bounds_are_refused(options: dict[str, float], words: str) -> None:
    with pytest.raises(ul.InputError, match=words):
        ul.LiveRadars(ROOM, RIG, **options)  # type: ignore[arg-type]
