"""URDF and xacro: links where the joints put them, refusals with file and line."""

import numpy as np
import pytest
import trimesh
from putting import put

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.world.sdf import load_sdf

ARM = """<robot name="arm" xmlns:ullage="urn:ullage:sdf">
  <link name="base"><collision><geometry><box size="1 1 0.2"/></geometry></collision></link>
  <link name="upper">
    <ullage:material>concrete</ullage:material>
    <visual><geometry><sphere radius="0.5"/></geometry></visual>
    <collision name="beam"><origin xyz="1 0 0" rpy="0 0 0"/><geometry><box size="2 0.1 0.1"/></geometry></collision>
  </link>
  <link name="rod"><collision><geometry><cylinder radius="0.01" length="1"/></geometry></collision></link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <origin xyz="2 0 0"/><parent link="upper"/><child link="rod"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
  <gazebo reference="upper"><laserRetro>0.4</laserRetro><anything/></gazebo>
</robot>
"""


@pytest.fixture
def write(tmp_path):
    return lambda text, name="r.urdf": put(tmp_path / name, text)


def bounds_of(scene, name):
    corners = scene.corners()[scene.face_object == scene.object(name)].reshape(-1, 3)
    return np.stack([corners.min(0), corners.max(0)])


def test_links_stand_where_the_joints_put_them(write):
    scene = ul.load_scene(write(ARM))
    assert [thing.name for thing in scene.objects] == ["arm::base", "arm::upper", "arm::rod"]
    np.testing.assert_allclose(bounds_of(scene, "arm::upper"), [[-0.05, 0, 0.95], [0.05, 2, 1.05]], atol=1e-9)
    np.testing.assert_allclose([scene.wires.start[0], scene.wires.end[0]], [[0, 2, 0.5], [0, 2, 1.5]], atol=1e-9)
    stuff = scene.objects[1].material
    assert (stuff.name, stuff.reflection) == ("concrete", 0.4)
    assert scene.objects[0].material.name == "steel"


def test_joint_values_move_the_links(write):
    scene = load_sdf(write(ARM), joints={"shoulder": -np.pi / 2, "slide": 0.5})
    np.testing.assert_allclose(bounds_of(scene, "arm::upper"), [[-0.05, -0.05, 1], [0.05, 0.05, 3]], atol=1e-9)
    np.testing.assert_allclose(scene.wires.start[0] + scene.wires.end[0], [0, 0, 2 * 3.5], atol=1e-9)
    with pytest.raises(InputError, match=r"no joint 'elbow' \(allowed: shoulder, slide\)"):
        load_sdf(write(ARM), joints={"elbow": 1.0})


def test_visual_geometry_by_option(write):
    scene = ul.load_scene(write(ARM), geometry="visual")
    np.testing.assert_allclose(scene.bounds, [[-0.5, -0.5, 0.5], [0.5, 0.5, 1.5]], atol=1e-3)


def test_meshes_come_from_packages_on_the_search_path(write, tmp_path, monkeypatch):
    folder = tmp_path / "elsewhere" / "pkg" / "meshes"
    folder.mkdir(parents=True)
    trimesh.creation.box((1, 2, 3)).export(folder / "b.stl")
    path = write(
        '<robot name="r"><link name="l"><collision><geometry>\n'
        '<mesh filename="package://pkg/meshes/b.stl" scale="2 1 1"/></geometry></collision></link></robot>'
    )
    scene = ul.load_scene(path, search_path=[tmp_path / "elsewhere"])
    np.testing.assert_allclose(scene.bounds, [[-1, -1, -1.5], [1, 1, 1.5]])
    with pytest.raises(
        InputError, match=r"r\.urdf:2: 'package://pkg/meshes/b\.stl' is not found \(allowed: a file under"
    ):
        ul.load_scene(path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere"))
    assert len(ul.load_scene(path).faces) == 12


def test_xacro_is_expanded_with_its_includes(write, tmp_path):
    write(
        '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="size" value="0.5"/></robot>', "p/s.xacro"
    )
    path = write(
        '<robot name="x" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="$(find p)/s.xacro"/>'
        '<xacro:macro name="cube" params="name x"><link name="${name}"><collision><origin xyz="${x} 0 0"/>'
        '<geometry><box size="${size} ${2*size} 1"/></geometry></collision></link></xacro:macro>'
        '<xacro:cube name="a" x="3"/></robot>',
        "w/r.urdf.xacro",
    )
    scene = ul.load_scene(path, search_path=[tmp_path], trust_xacro=True)
    np.testing.assert_allclose(scene.bounds, [[2.75, -0.5, -0.5], [3.25, 0.5, 0.5]])
    with pytest.raises(InputError, match=r"r\.urdf\.xacro: xacro fails: 'package://p' is not found"):
        ul.load_scene(path, trust_xacro=True)


@pytest.mark.parametrize(
    ("include", "words"),
    [
        ("../out.xacro", "reaches out of the search path"),
        ("none.xacro", "xacro fails: .*No such file"),
        ("r.xacro", "xacro fails"),
    ],
)
def test_xacro_includes_that_cannot_be_are_refused(write, include, words):
    write("<robot/>", "out.xacro")
    text = f'<robot name="x" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="{include}"/></robot>'
    with pytest.raises(InputError, match=words) as caught:
        ul.load_scene(write(text, "w/r.xacro"), trust_xacro=True)
    assert "\n" not in str(caught.value)


LINK = '<link name="{}"><collision><geometry><box size="1 1 1"/></geometry></collision></link>'
JOINT = '<joint name="{}" type="fixed"><parent link="{}"/><child link="{}"/></joint>'


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("", "the robot has no links"),
        (LINK.format("a") + "\n" + LINK.format("a"), r"r\.urdf:2: a second link 'a'"),
        (
            LINK.format("a") + "\n" + JOINT.format("j", "a", "b"),
            r"r\.urdf:2: joint 'j' names no link 'b' \(allowed: a\)",
        ),
        (
            LINK.format("a") + LINK.format("b") + JOINT.format("j", "a", "b") + JOINT.format("k", "b", "a"),
            "the joints go in a circle: a -> b -> a",
        ),
        (
            "".join(map(LINK.format, "abc")) + JOINT.format("j", "a", "c") + JOINT.format("k", "b", "c"),
            "'c' is the child of two joints",
        ),
        ('<link name="a"><collision>\n<geometry><box size="1 0 1"/></geometry></collision></link>',
         r"r\.urdf:2: <size> of <box> is '1 0 1' \(allowed: above zero\)"),
        ('<link name="a"><collision><geometry><box/></geometry></collision></link>', "<box> has no <size>"),
        ('<link name="a"><collision><origin xyz="0 nan 0"/><geometry><box size="1 1 1"/></geometry></collision></link>',
         "is not finite: '0 nan 0'"),
        ('<link name="a"><collision><origin xyz="0 0"/><geometry><box size="1 1 1"/></geometry></collision></link>',
         "holds 2 numbers"),
        ('<link name="a"><collision/></link>', "<collision> has no <geometry>"),
        ('<link name="a"><collision><geometry><mesh filename="../../x.stl"/></geometry></collision></link>',
         r"'\.\./\.\./x\.stl' (is not found|reaches out)"),
    ],
)  # fmt: skip
def test_impossible_robots_are_refused(write, body, words):
    with pytest.raises(InputError, match=words) as caught:
        ul.load_scene(write(f'<robot name="r">{body}</robot>'))
    assert "\n" not in str(caught.value)


def test_what_is_unknown_is_warned_about(write):
    text = f'<robot name="r">{LINK.format("a")}\n<wing/><gazebo><wheel/></gazebo></robot>'
    with pytest.warns(UllageWarning, match=r"r\.urdf:2: <wing> is not a URDF element") as caught:
        ul.load_scene(write(text))
    assert len(caught) == 1
