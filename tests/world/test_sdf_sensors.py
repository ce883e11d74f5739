"""Radars that SDF and URDF declare: what is mounted, where, with which settings; what the real parser says of it."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from shipped_worlds import BUILDERS
from ullage.fan import fan_shape, ray_fan
from ullage.geometry import transform

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "integrations" / "gazebo" / "models"
QUADROTOR = MODELS / "ullage_quadrotor" / "model.sdf"

WORLD = """<sdf version="1.9" xmlns:gz="http://gazebosim.org/schema" xmlns:ullage="urn:ullage:sdf"><world name="w">
<model name="drone"><pose>5 6 7 0.1 0.2 0.3</pose>
  <link name="base"><pose>0 0 0.5 0 0 1</pose>
    <collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>
    <sensor name="front" type="custom" {kind}="ullage_radar"><pose>0.1 0 0 0 0.3 0</pose>
      <update_rate>25</update_rate>{inside}</sensor>
    <sensor name="eye" type="camera"/>
  </link></model>{more}</world></sdf>"""


def written(folder, inside="", more="", kind="gz:type"):
    path = folder / "w.sdf"
    path.write_text(WORLD.format(inside=inside, more=more, kind=kind))
    return path


def test_the_thesis_quadrotor_declares_the_thesis_rig():
    rig, preset = ul.load_scene(QUADROTOR).rig(), ul.Rig.preset("thesis-4")
    assert list(rig.sensors) == list(preset.sensors)
    for name, spec in preset.sensors.items():
        np.testing.assert_allclose(rig.sensors[name].mount.body_from_sensor(), spec.mount.body_from_sensor(), atol=1e-9)
        assert rig.sensors[name].but(mount=spec.mount) == spec


@pytest.mark.parametrize("kind", ["gz:type", "ignition:type"])  # one declared as a namespace, one not
def test_a_custom_sensor_is_mounted_in_the_models_frame(tmp_path, kind):
    scene = ul.load_scene(written(tmp_path, kind=kind))
    assert list(scene.rigs) == ["drone"]
    assert list(scene.rig("drone").sensors) == ["front"]
    spec = scene.rig().sensors["front"]
    assert spec.fps == 25
    want = transform([0, 0, 0.5], np.array([0, 0, 1.0])) @ transform([0.1, 0, 0], np.array([0, 0.3, 0]))
    np.testing.assert_allclose(spec.mount.body_from_sensor(), want, atol=1e-9)


def test_settings_of_the_thesis_come_from_a_ray_block(tmp_path):
    block = """<ray><scan><horizontal><samples>58</samples><min_angle>-0.5</min_angle><max_angle>0.5</max_angle>
      </horizontal><vertical><samples>58</samples><min_angle>-0.5</min_angle><max_angle>0.5</max_angle></vertical></scan>
      <range><min>0.3</min><max>12</max></range><noise><type>gaussian</type><stddev>0.01</stddev></noise></ray>"""
    thesis = ul.load_scene(written(tmp_path, block)).rig().sensors["front"].thesis
    assert thesis.fov_deg == pytest.approx(np.degrees(1.0))
    assert (thesis.rays_per_side, thesis.min_range_m, thesis.max_range_m, thesis.noise_sigma) == (58, 0.3, 12, 0.01)


def test_settings_of_ours_are_named_as_in_radar_spec(tmp_path):
    inside = """<ullage:radar><preset>x4m05-8ghz</preset><bins>96</bins><noise>none</noise>
      <antenna><kind>cosine</kind><azimuth_deg>40</azimuth_deg></antenna>
      <thesis><smoothing_bins>5</smoothing_bins></thesis></ullage:radar>"""
    spec = ul.load_scene(written(tmp_path, inside)).rig().sensors["front"]
    want = ul.RadarSpec.preset(
        "x4m05-8ghz", bins=96, noise=None, fps=25, antenna={"kind": "cosine", "azimuth_deg": 40},
        thesis={"smoothing_bins": 5}, mount=spec.mount,
    )  # fmt: skip
    assert spec == want


def test_a_radar_needs_no_sensor_around_it(tmp_path):
    more = """<model name="other"><link name="l"><ullage:radar name="down"><pose>0 0 -0.1 0 1.5707963 0</pose>
      <fps>10</fps></ullage:radar></link></model>"""
    scene = ul.load_scene(written(tmp_path, more=more))
    assert list(scene.rigs) == ["drone", "other"]
    down = scene.rig("other").sensors["down"]
    assert down.fps == 10
    np.testing.assert_allclose(down.mount.body_from_sensor()[:3, 0], [0, 0, -1], atol=1e-6)
    with pytest.raises(ul.InputError, match=r"radars declared on 2 models \(allowed: drone, other\)"):
        scene.rig()
    with pytest.raises(ul.InputError, match=r"no radars declared on 'x' \(allowed: drone, other\)"):
        scene.rig("x")


def test_a_lidar_may_be_a_radar_too(tmp_path):
    more = """<model name="other"><link name="l"><sensor name="lidar" type="gpu_lidar"><pose>1 2 3 0 0 0</pose>
      <lidar><scan><horizontal><samples>9</samples><min_angle>-1</min_angle><max_angle>1</max_angle></horizontal>
      <vertical><samples>9</samples><min_angle>-1</min_angle><max_angle>1</max_angle></vertical></scan></lidar>
      <ullage:radar/></sensor></link></model>"""
    spec = ul.load_scene(written(tmp_path, more=more)).rig("other").sensors["lidar"]
    assert spec.mount.position_m == (1, 2, 3)
    assert spec.thesis.rays_per_side == 9


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ("<ullage:radar><preset>x5</preset></ullage:radar>", r"w.sdf:6: radar 'front': no radar preset 'x5'.*x4m05"),
        ("<ullage:radar><bin>3</bin></ullage:radar>", r"w.sdf:6: radar 'front': bin: no such setting.*prf_div"),
        ("<ullage:radar><bins>three</bins></ullage:radar>", r"w.sdf:6: radar 'front': bins is 'three'"),
        ("<ray><scan><horizontal><samples>9</samples></horizontal><vertical><samples>1</samples></vertical></scan></ray>",
         r"w.sdf:6: a fan of 9 rays over 0 deg and 1 rays"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_its_line(tmp_path, inside, words):
    with pytest.raises(ul.InputError, match=words):
        ul.load_scene(written(tmp_path, inside))


def test_the_scene_without_the_drone_holds_everything_else(tmp_path):
    ball = '<collision name="c"><geometry><sphere><radius>1</radius></sphere></geometry></collision>'
    more = f'<model name="drone2"><link name="l">{ball}</link></model>'
    scene = ul.load_scene(written(tmp_path, more=more))
    bare = scene.without("drone")
    assert [thing.name for thing in bare.objects] == ["drone2"]
    assert len(bare.faces) == np.sum(scene.face_object == scene.object("drone2"))
    np.testing.assert_array_equal(bare.bounds, [[-1, -1, -1], [1, 1, 1]])
    assert scene.without("nobody") is scene


def test_wires_of_a_model_go_with_it():
    scene = ul.Scene.union([ul.scenes.wire(radius_m=0.001, length_m=1, distance_m=2), ul.scenes.plate(
        width_m=1, height_m=1, distance_m=3)])  # fmt: skip
    wire, plate = (thing.name for thing in scene.objects)
    assert len(scene.without(wire).wires) == 0
    left = scene.without(plate)
    assert len(left.faces) == 0
    assert left.objects[left.wires.object_id[0]].name == wire


def test_the_xacro_macro_mounts_a_radar_on_a_urdf_robot(tmp_path):
    robot = tmp_path / "robot.urdf.xacro"
    macro = (ROOT / "integrations" / "gazebo" / "urdf" / "ullage_radar.urdf.xacro").read_text()
    (tmp_path / "ullage_radar.urdf.xacro").write_text(macro)
    robot.write_text("""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
      <xacro:include filename="ullage_radar.urdf.xacro"/><link name="base"/>
      <xacro:ullage_radar name="front" parent="base" xyz="0.1 0 0.2" rpy="0 0 0.5" rays="58" noise="0.01"/></robot>""")
    spec = ul.load_scene(robot, trust_xacro=True).rig("r").sensors["front"]
    assert (spec.fps, spec.thesis.rays_per_side, spec.thesis.noise_sigma) == (17, 58, 0.01)
    want = transform([0.1, 0, 0.2], np.array([0, 0, 0.5]))
    np.testing.assert_allclose(spec.mount.body_from_sensor(), want, atol=1e-9)


def ign_sdf(path):
    if not shutil.which("ign"):
        pytest.skip("ignition-tools is not installed")
    out = subprocess.run(["ign", "sdf", "-k", str(path)], capture_output=True, text=True, check=False)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILDERS)
def test_the_real_checker_accepts_the_shipped_worlds(name):
    path = ROOT / "src" / "ullage" / "worlds" / f"{name}.sdf"
    assert ign_sdf(path).stdout.split() == ["Valid."]


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(MODELS.glob("*/*.sdf")), ids=lambda p: p.parent.name)
def test_the_real_checker_accepts_the_models(path):
    out = ign_sdf(path)
    assert out.stdout.split() == ["Valid."], out.stderr


@pytest.mark.slow
def test_the_real_checker_accepts_declared_radars_and_refuses_what_is_wrong(tmp_path):
    assert "Valid." in ign_sdf(written(tmp_path, "<ullage:radar><bins>96</bins></ullage:radar>")).stdout
    wrong = written(tmp_path, more='<model name="drone"><link name="l"/></model>')
    assert "Valid." not in ign_sdf(wrong).stdout


def rays(sensor, across, up, span=("-3.14159265", "3.14159265"), half="0.5672320", kind="gpu_lidar", inside=""):
    """A ray sensor as SDF and URDF write it."""
    return f"""<sensor name="{sensor}" type="{kind}"><pose>0 0 -0.06 0 0 0</pose><update_rate>17</update_rate>
      <lidar><scan><horizontal><samples>{across}</samples><min_angle>{span[0]}</min_angle>
      <max_angle>{span[1]}</max_angle></horizontal><vertical><samples>{up}</samples><min_angle>-{half}</min_angle>
      <max_angle>{half}</max_angle></vertical></scan></lidar>{inside}</sensor>"""


YAWS = {"front": 0.0, "left": 1.5707963268, "back": 3.1415926536, "right": -1.5707963268}
SECTIONS = "".join(f'<ullage:radar name="{n}"><pose>0 0 0 0 0 {yaw}</pose></ullage:radar>' for n, yaw in YAWS.items())


def robot_with(folder, *sensors, form="sdf"):
    path = folder / f"robot.{form}"
    body = '<collision name="c"><geometry><box><size>.2 .2 .1</size></box></geometry></collision>'
    if form == "urdf":
        text = f"""<robot name="drone" xmlns:ullage="urn:ullage:sdf"><link name="base"><collision><geometry>
          <box size=".2 .2 .1"/></geometry></collision></link>
          <gazebo reference="base">{"".join(sensors)}</gazebo></robot>"""
    else:
        text = f"""<sdf version="1.9" xmlns:ullage="urn:ullage:sdf"><model name="drone"><link name="base">{body}
          {"".join(sensors)}</link></model></sdf>"""
    path.write_text(text)
    return path


@pytest.mark.parametrize("form", ["sdf", "urdf"])
def test_one_ring_of_rays_becomes_four_radars_as_in_the_thesis(tmp_path, form):
    rig = ul.load_scene(robot_with(tmp_path, rays("ring", 162, 30, inside=SECTIONS), form=form)).rig()
    preset = ul.Rig.preset("thesis-ring")
    assert list(rig.sensors) == list(preset.sensors)
    for name, want in preset.sensors.items():
        got = rig.sensors[name]
        np.testing.assert_allclose(got.mount.body_from_sensor(), want.mount.body_from_sensor(), atol=1e-8)
        np.testing.assert_allclose(ray_fan(got.thesis), ray_fan(want.thesis), atol=1e-6)
        assert got.fps == 17


@pytest.mark.parametrize("form", ["sdf", "urdf"])
def test_each_ray_sensor_of_a_robot_without_radars_is_one_with_its_own_fan(tmp_path, form):
    scanners = (
        rays("round", 91, 16, half="0.26"), rays("ahead", 20, 20, ("-0.3", "0.3"), "0.3", "ray"),
        rays("aside", 31, 9, ("0.5", "1.5"), "0.2", "gpu_ray"), rays("flat", 640, 1, half="0"),
    )  # fmt: skip
    scene = ul.load_scene(robot_with(tmp_path, *scanners, form=form))
    assert scene.rigs == {}  # they carry no radars unless somebody asks for these
    sensors = scene.rig().sensors
    assert list(sensors) == ["round", "ahead", "aside"]  # a single row makes no radar
    assert {name: fan_shape(spec.thesis) for name, spec in sensors.items()} == {
        "round": (16, 90), "ahead": (20, 20), "aside": (9, 31)
    }  # fmt: skip
    assert sensors["round"].thesis.fov_deg == 360
    assert sensors["aside"].mount.yaw_deg == pytest.approx(np.degrees(1.0))
    frames = ul.simulate(
        ul.scenes.room(size_m=(6, 4, 3)), ul.Trajectory.stationary(n=2), ul.Rig(sensors=sensors), fidelity="thesis"
    )
    assert set(frames) == set(sensors)


def test_declared_radars_come_before_ray_sensors(tmp_path):
    scanner, radar = rays("round", 91, 16), '<ullage:radar name="nose"/>'
    assert list(ul.load_scene(robot_with(tmp_path, scanner, radar)).rig().sensors) == ["nose"]


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (rays("r", 31, 31, ("-1", "1"), inside=SECTIONS), "several radars in sensor 'r'.*rays over 360 deg"),
        (rays("r", 91, 31, inside='<ullage:radar name="a"/><ullage:radar name="b"><pose>0 0 0 0 1 0</pose>'
         "</ullage:radar>"), "several radars.*turned by its yaw only"),
        (rays("r", 91, 31, inside='<ullage:radar name="a"/><ullage:radar name="b"><thesis><fov_deg>3</fov_deg></thesis>'
         "</ullage:radar>"), "radar 'b'.*fewer than two rays in 3 deg"),
    ],
)  # fmt: skip
def test_a_ring_that_cannot_be_cut_is_refused(tmp_path, sensor, words):
    with pytest.raises(ul.InputError, match=words):
        ul.load_scene(robot_with(tmp_path, sensor))
