"""A turn on the spot: loudness against heading tells bearings, and nothing else does."""

import numpy as np
import pytest

import ullage as ul
from ullage.antenna import boresight_pattern
from ullage.data import Trajectory
from ullage.geometry import rpy_quat
from ullage.processing.mapper_looks import Heard, Look
from ullage.processing.mapper_turns import Turns, bearing_of, bearings

PATTERN = boresight_pattern(ul.AntennaSpec())
HEADINGS = np.radians(np.arange(0, 360, 4.0))


def look(at, heading, echoes, t_ns=0):
    axes = np.array(
        [[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]], dtype=float
    )
    rows = np.zeros((len(echoes), 6))
    rows[:, [0, 5]] = np.reshape(echoes, (-1, 2))
    heard = Heard(t_ns, np.array([*at, 0.0]), axes, len(rows), np.zeros(16), np.zeros(16), np.zeros(50, bool), None)
    return Look(heard, np.zeros(3), rows, np.zeros((len(rows), 5)))


def lobe(off):
    off = (off + np.pi) % (2 * np.pi) - np.pi
    return 1 / PATTERN.two_way_loss(np.cos(off))


def turn(arm_m=0.0, *, bearing, range_m=3.0, level=lobe, noise=0.0):
    """Looks all round from the end of an arm that turns with the sensor, at a reflector far off in one direction."""
    rng, way = np.random.default_rng(1), np.array([np.cos(bearing), np.sin(bearing)])
    turns, out, stretch = Turns(), [], None
    for k, heading in enumerate(HEADINGS):
        at = arm_m * np.array([np.cos(heading), np.sin(heading)])
        loud = level(heading - bearing) * np.exp(noise * rng.normal())
        reach = range_m - at @ way
        out.append(look(at, heading, [(reach, loud / reach)] if loud > 0.02 else [], k))
        stretch = turns.hear("front", out[-1])
    return out, stretch


def told(arm_m=0.0, **how):
    """Bearings [rad] that looks of a turn tell of their echoes."""
    looks, stretch = turn(arm_m, **how)
    assert stretch.turned
    out = []
    for one, heading in zip(looks, HEADINGS, strict=True):
        seen, (cosine, _, trust) = bearings(one, stretch, PATTERN)
        assert not seen.track.any() or abs(seen.track @ one.heard.axes[:, 0]) < 1e-9
        out += (heading + np.arcsin(cosine[trust > 0])).tolist()
    return (np.array(out) + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("bearing_deg", [17.0, 101.3])
@pytest.mark.parametrize("arm_m", [0.0, 0.1])
def test_the_lobe_tells_the_bearing_of_what_keeps_its_range(bearing_deg, arm_m):
    found = np.degrees(told(arm_m, bearing=np.radians(bearing_deg), noise=0.1))
    assert len(found) > 12
    assert abs(found - bearing_deg).max() < 4
    assert abs(np.median(found) - bearing_deg) < 2


def test_what_is_as_loud_on_all_headings_has_no_bearing():
    assert not len(told(bearing=1.0, level=lambda off: 0.0 * off + 1.0, noise=0.1))


def test_what_fades_but_is_heard_behind_too_has_no_bearing():
    """Floor and ceiling at one distance: their sum has a dip here and there, which is no lobe."""
    dips = lambda off: 1.0 - 0.9 * (abs(abs((off + np.pi) % (2 * np.pi) - np.pi) - 0.9) < 0.25)  # noqa: E731
    assert not len(told(bearing=1.0, level=dips))


def test_range_about_an_arm_must_agree_with_the_loudness():
    """From the end of a turning arm a reflector at one bearing cannot be loud at another."""
    looks, _ = turn(0.1, bearing=0.5)
    at = np.array([one.heard.position[:2] for one in looks])
    ranges = np.array([[one.echoes[0, 0] if len(one.echoes) else np.inf] for one in looks])
    turned = np.where(np.isfinite(ranges), np.log(lobe(HEADINGS - 1.3))[:, None], np.inf)
    heading = HEADINGS[18]
    reach = 3.0 - at[18] @ [np.cos(0.5), np.sin(0.5)]
    assert bearing_of(reach, at[18], heading, (at, HEADINGS, ranges, turned), PATTERN) is None


def test_a_corner_of_the_way_is_no_turn_on_the_spot():
    turns = Turns()
    for heading in np.radians(np.arange(0, 91, 4.0)):
        corner = turns.hear("front", look((0.3 * np.sin(heading), 0.3 * np.cos(heading)), heading, []))
    assert not corner.turned
    for k in range(5):
        corner = turns.hear("front", look((0.3 + 0.05 * (k + 1), 0.0), heading, []))
    assert not corner.turned
    assert len(corner.looks) == 1


def test_one_radar_that_turns_on_the_spot_maps_walls_and_no_rings():
    scene = ul.scenes.room((6.0, 4.0, 3.0), material="concrete")
    n = 240
    t_ns = np.rint(np.arange(n) * 6e7).astype(np.int64)
    spin = rpy_quat(np.zeros(n), np.zeros(n), 2 * np.pi * np.arange(n) / n)
    frames = ul.simulate(scene, Trajectory(t_ns, np.tile([-1.0, 0.3, 0.0], (n, 1)), spin), ul.RadarSpec.preset("x4m05"))
    omap = ul.map_occupancy(frames, ul.Grid.covering(scene.bounds, 0.1), method="rules")
    score = {name: metric.value for name, metric in ul.metrics.map_quality(omap, scene, frames).items()}
    assert score["precision"] > 0.8
    assert score["recall"] > 0.4
    assert score["surface_declared_free"] < 0.01
