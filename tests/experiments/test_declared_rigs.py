"""Scenarios fly the radars that a URDF, an SDF file or a model of the world declares."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.config import make_scenario
from ullage.errors import InputError
from ullage.experiments.simulated import prepare
from ullage.flight.airframe import AIRFRAMES

ROOT = Path(__file__).parents[2]
QUADROTOR = ROOT / "integrations/ros2/ullage_ros/urdf/quadrotor.urdf"
WORLD = """<?xml version="1.0"?><sdf version="1.9" xmlns:ullage="urn:ullage:sdf"><world name="w">
<model name="east"><static>true</static><pose>3 0 1 0 0 0</pose><link name="l"><collision name="c">
<geometry><box><size>0.1 6 2</size></box></geometry></collision></link></model>
<model name="drone"><pose>0 0 1 0 0 0</pose><link name="base"><collision name="c">
<geometry><box><size>0.3 0.3 0.1</size></box></geometry></collision>
<ullage:radar name="nose"><pose>0.2 0 0 0 0 0</pose></ullage:radar></link></model></world></sdf>"""


def scenario(world: str, **sensing):
    flight = {"vehicle": "ideal", "waypoints": [[0, 0, 1], [0.5, 0, 1]]}
    return make_scenario(
        {"name": "s", "world": {"file": world}, "flight": flight, "sensing": {"fidelity": "thesis"} | sensing, "do": []}
    )


@pytest.fixture
def world(tmp_path: Path) -> str:
    path = tmp_path / "w.sdf"
    path.write_text(WORLD)
    return str(path)


def test_the_quadrotors_urdf_carries_the_radars_of_the_preset_and_the_motors_of_the_airframe() -> None:
    scene = ul.load_scene(QUADROTOR)
    rig, preset = scene.rig(), ul.Rig.preset("thesis-4-down")
    assert list(rig.sensors) == list(preset.sensors)
    for name, spec in preset.sensors.items():
        np.testing.assert_allclose(rig.sensors[name].mount.body_from_sensor(), spec.mount.body_from_sensor(), atol=1e-9)
        assert rig.sensors[name].but(mount=spec.mount) == spec
    reach = np.max(np.abs(scene.bounds[:, 0]))
    hector = AIRFRAMES["hector"]
    assert reach == pytest.approx(hector.rotor_position_m[0][0] + hector.rotor_radius_m, abs=1e-3)
    assert preset.sensors["down"].mount.body_from_sensor()[:3, 0] == pytest.approx([0, 0, -1])


def test_a_scenario_flies_the_radars_of_a_urdf(world: str) -> None:
    flown = prepare(scenario(world, rig=str(QUADROTOR), changes={"bins": 96}))
    assert set(flown.rig.sensors) == {"front", "left", "back", "right", "down"}
    assert {spec.bins for spec in flown.rig.sensors.values()} == {96}
    assert set(next(flown.stream())) == set(flown.rig.sensors)


def test_a_scenario_flies_the_radars_of_a_model_of_its_world_without_the_model(world: str) -> None:
    flown = prepare(scenario(world, rig="declared"))
    assert set(flown.rig.sensors) == {"nose"}
    assert not flown.scene.has("drone")
    assert flown.scene.has("east")


def test_a_scenario_cuts_four_radars_from_one_ring_of_rays(world: str) -> None:
    flown = prepare(scenario(world, rig="thesis-ring", changes={"thesis": {"ring_rays": 200}}))
    assert {spec.thesis.ring_rays for spec in flown.rig.sensors.values()} == {200}
    assert len({spec.mount.position_m for spec in flown.rig.sensors.values()}) == 1
    assert set(next(flown.stream())) == {"front", "left", "back", "right"}


def test_a_rig_that_is_none_is_refused(world: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no rig preset 'best'"):
        scenario(world, rig="best")
    bare = tmp_path / "bare.sdf"
    bare.write_text(WORLD.replace("ullage:radar", "other").replace(' xmlns:ullage="urn:ullage:sdf"', ""))
    with pytest.raises(InputError, match="radars declared"):
        prepare(scenario(str(bare), rig="declared"))
    with pytest.raises(InputError, match=r"gone\.urdf"):
        prepare(scenario(world, rig="gone.urdf"))
    with pytest.raises(InputError, match="bin"):
        scenario(world, rig="declared", changes={"bin": 3})
