"""Radars simulated along the poses of an autopilot on the other side of loopback UDP."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_autopilot import Autopilot, local_poses
from pymavlink.dialects.v20 import common as mav

import ullage as ul
from ullage.ports.mavlink.source import open_source

SDF = """<?xml version="1.0"?><sdf version="1.9"><world name="wall">
<model name="wall"><static>true</static><pose>3 0 1 0 0 0</pose><link name="l"><collision name="c"><geometry>
<box><size>0.1 6 4</size></box></geometry></collision></link></model></world></sdf>"""


@pytest.fixture
def world(tmp_path: Path) -> str:
    path = tmp_path / "wall.sdf"
    path.write_text(SDF)
    return str(path)


def east(t_s: float) -> tuple[float, float, float]:
    """A slow flight towards the wall, 1 m up: north, east, down."""
    return (0.0, 0.3 * math.sin(t_s), -1.0)


def frames_of(autopilot: Autopilot, world: str, said: list[str], **options: Any) -> Iterator[dict[str, ul.Frames]]:
    place = f"udp://127.0.0.1:{autopilot.port}"
    values = {"world": world, "rig": "single", "rate_hz": 20, "duration_s": 1.0, **options}
    with open_source(place, values, log=said.append) as source:
        yield from source.stream()


@pytest.mark.parametrize(("kind", "timesync"), [("local", True), ("local", False), ("odometry", False)])
def test_frames_come_along_the_autopilots_poses(world: str, kind: str, timesync: bool) -> None:
    """At times of this machine; without TIMESYNC at those of the autopilot, by which places are exact."""

    def odometry(t_s: float) -> list[Any]:
        half = math.radians(45)
        q = [math.cos(half), 0, 0, math.sin(half)]
        return [mav.MAVLink_odometry_message(
            round(t_s * 1e6), 1, 12, *east(t_s), q, 0, 0, 0, 0, 0, 0, [0.0] * 21, [0.0] * 21, 0, 0, 100
        )]  # fmt: skip

    poses = local_poses(east, math.radians(90)) if kind == "local" else odometry
    boot_ns = -time.monotonic_ns() + 1000 * 10**9
    said: list[str] = []
    with Autopilot(poses=poses, boot_ns=boot_ns, timesync=timesync) as autopilot:
        parts = [chunk["front"] for chunk in frames_of(autopilot, world, said)]
        asked = {m.param1 for m in autopilot.of("COMMAND_LONG")}
    t_ns = np.concatenate([part.t_ns for part in parts])
    x = np.concatenate([part.believed.position[:, 0] for part in parts])
    assert abs(time.time_ns() - t_ns[-1]) < 60e9 if timesync else 1000e9 < t_ns[-1] < 1100e9
    np.testing.assert_allclose(np.diff(t_ns), 5e7, atol=2)
    assert asked == {30, 31, 32, 331}  # each message that gives poses was asked for, by SET_MESSAGE_INTERVAL
    assert any("does not answer TIMESYNC" in line for line in said) == (not timesync)
    if not timesync:  # by the autopilot's clock the vehicle was there: 20 ms of poses at 0.3 m/s are 6 mm
        np.testing.assert_allclose(x, 0.3 * np.sin(t_ns * 1e-9), atol=0.012)
    far = parts[-1].range_m > 1.0  # beyond the direct path between the antennas
    echo = parts[-1].range_m[far][np.argmax(np.abs(parts[-1].samples[-1][far]))]
    assert echo == pytest.approx(2.95 - x[-1], abs=0.15)


@pytest.mark.parametrize("stagger", [True, False])
def test_the_pulse_interval_alternates_unless_it_must_not(world: str, stagger: bool) -> None:
    with Autopilot(poses=local_poses(east), timesync=False) as autopilot:
        place = f"udp://127.0.0.1:{autopilot.port}"
        with open_source(place, {"world": world, "rig": "thesis-4", "stagger": stagger}, log=lambda _: None) as source:
            found = {spec.stagger_div for spec in source.rig.sensors.values()}
    assert found == ({17} if stagger else {None})


def test_an_autopilot_that_stops_ends_the_track_and_frames_wait_for_it(world: str) -> None:
    said: list[str] = []
    with Autopilot(poses=local_poses(east)) as autopilot:
        stream = frames_of(autopilot, world, said, duration_s=1.5, heartbeat_s=1.0)
        before = [next(stream)["front"] for _ in range(2)]
        autopilot.silent = True
        time.sleep(2.6)
        autopilot.silent = False
        times = np.concatenate([part.t_ns for part in [*before, *(chunk["front"] for chunk in stream)]])
    steps = np.diff(times) * 1e-9
    assert np.sort(steps)[-1] > 2.0  # nothing was made up for the time without poses
    assert np.sort(steps)[-2] < 0.06
    assert any("no HEARTBEAT of system 1 for 1 s; its poses end here" in line for line in said)


def test_an_autopilot_that_starts_again_begins_a_new_track(world: str) -> None:
    said: list[str] = []
    with Autopilot(poses=local_poses(east), boot_ns=-time.monotonic_ns() + 900 * 10**9) as autopilot:
        stream = frames_of(autopilot, world, said, duration_s=1.5)
        parts = [next(stream)["front"] for _ in range(2)]
        autopilot.restart(-time.monotonic_ns())
        parts += [chunk["front"] for chunk in stream]
    times = np.concatenate([part.t_ns for part in parts])
    assert (np.diff(times) > 0).all()
    assert abs(time.time_ns() - times[-1]) < 60e9
    assert any("the autopilot's clock went back: it was started again" in line for line in said)


def test_no_heartbeat_is_an_error_in_one_line(world: str) -> None:
    options = {"world": world, "rig": "single", "wait_s": 0.5}
    with (
        open_source("udp://127.0.0.1:9", options, log=[].append) as source,
        pytest.raises(ul.InputError, match=r"no HEARTBEAT of an autopilot within 0.5 s"),
    ):
        next(source.stream())


def test_a_missing_world_is_an_error_in_one_line() -> None:
    with pytest.raises(ul.InputError, match=r"mavlink:udp://127.0.0.1:9: no world \(allowed: world=NAME"):
        open_source("udp://127.0.0.1:9", {})
