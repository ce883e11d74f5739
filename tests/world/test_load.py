"""Scenes from files: what is asked for by suffix, and what is refused in one line."""

import numpy as np
import pytest
from putting import put

import ullage as ul
from ullage.errors import InputError, UllageWarning

WORLD = """<?xml version="1.0"?>
<sdf version="1.9" xmlns:ullage="urn:ullage:sdf">
  <world name="w">
    <model name="wall">
      <pose>3 0 1 0 0 0</pose>
      <link name="link">
        <collision name="c">
          <laser_retro>0.7</laser_retro>
          <ullage:material thickness_m="0.15">concrete</ullage:material>
          <geometry><box><size>0.2 4 2</size></box></geometry>
        </collision>
      </link>
    </model>
  </world>
</sdf>
"""


@pytest.fixture
def write(tmp_path):
    return lambda text, name="w.sdf": put(tmp_path / name, text)


def test_a_box_stands_where_it_should_with_its_material(write):
    scene = ul.load_scene(write(WORLD))
    np.testing.assert_allclose(scene.bounds, [[2.9, -2, 0], [3.1, 2, 2]])
    assert scene.name == "w"
    assert [thing.name for thing in scene.objects] == ["wall"]
    stuff = scene.objects[0].material
    assert (stuff.name, stuff.reflection, stuff.thickness_m) == ("concrete", 0.7, 0.15)
    assert len(scene.faces) == 12


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", r"w\.sdf:1: the file is empty"),
        (b"   \n\n", r"w\.sdf:1: the file is empty"),
        (WORLD[:300].encode(), r"w\.sdf:\d+: not XML"),
        (WORLD.encode("utf-16"), r"w\.sdf:1: the file is UTF-16 .*UTF-8"),
        (WORLD.encode("utf-16-le"), r"w\.sdf:1: the file is UTF-16"),
        (b"<sdf>\n\x00\x01\x02", r"w\.sdf:2: the file is binary"),
        (bytes(range(1, 256)), r"w\.sdf:1: not XML"),
        (b"hello", r"w\.sdf:1: not XML"),
        (b"<sdf version='1.9'><world name='a'></model></world></sdf>", r"w\.sdf:1: not XML"),
        (b"<robot name='r'/>", r"root element is <robot> \(allowed: <sdf>\)"),
        (b"<sdf version='0.9'/>", r"SDF version 0\.9 \(allowed: 1\.0 to 1\.12\)"),
        (b"<gazebo version='1.2'/>", r"root element is <gazebo> \(allowed: <sdf>\)"),
        (b"<sdf version='one'/>", "version 'one'"),
        (b"<sdf version='1.9'/>", "holds no world"),
    ],
)
def test_files_that_are_no_sdf_are_refused_in_one_line(write, content, words):
    with pytest.raises(InputError, match=words) as caught:
        ul.load_scene(write(content))
    assert "\n" not in str(caught.value)


BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
MODEL = f"<model name='m'><link name='l'>\n<collision name='c'>{BOX}</collision></link></model>"


@pytest.mark.parametrize("version", ["1.0", "1.2", "1.3", "1.4", "1.9", "1.12"])
def test_every_version_of_sdf_loads(write, version):
    assert len(ul.load_scene(write(f"<sdf version='{version}'>{MODEL}</sdf>")).faces) == 12


@pytest.mark.parametrize(
    "text",
    [
        "<sdf version='1.9'><!-- gz topic -t /x --once ---->{}</sdf>",
        "<!--- a -- b\n-- c --><sdf version='1.9'>{}</sdf>",
        "\n \n<?xml version='1.0'?>\n<sdf version='1.9'>{}</sdf>",
        "<!-- licence -->\n<?xml version='1.0'?>\n<sdf version='1.9'>{}</sdf>",
        "<sdf version='1.9'><plugin name='a&b' filename='x'>a & b &foo; <![CDATA[&&]]></plugin>{}</sdf>",
        "<sdf version='1.9'><plugin name='a<b' filename='x'/>{}</sdf>",
    ],
)
def test_xml_that_gazebo_reads_loads_with_its_line_numbers(write, text):
    assert len(ul.load_scene(write(text.format(MODEL))).faces) == 12
    line = text.count("\n") + 2
    with pytest.raises(InputError, match=rf"w\.sdf:{line}: <size> is 'x'"):
        ul.load_scene(write(text.format(MODEL.replace("1 2 3", "x"))))


def test_bytes_that_are_not_utf8_do_not_stop_a_file(write):
    text = f"<sdf version='1.9'><!-- Caf\xe9 -->{MODEL}</sdf>".encode("latin-1")
    assert len(ul.load_scene(write(text)).faces) == 12


def test_ampersands_reach_names_as_they_are_written(write):
    text = f"<sdf version='1.9'>{MODEL}</sdf>".replace("name='m'", "name='a&b &lt;c&#62; &foo;'")
    assert ul.load_scene(write(text)).objects[0].name == "a&b <c> &foo;"


@pytest.mark.parametrize("inside", ["<light name='sun' type='directional'/>", "<world name='w'/>"])
def test_a_file_that_holds_nothing_to_be_met_is_an_empty_scene(write, inside):
    assert len(ul.load_scene(write(f"<sdf version='1.9'>{inside}</sdf>")).faces) == 0


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "huge.sdf"
    with path.open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(InputError, match=r"huge\.sdf: 1024 MiB of XML \(allowed: at most 64 MiB\)"):
        ul.load_scene(path)
    path = path.rename(tmp_path / "huge.stl")
    with pytest.raises(InputError, match=r"huge\.stl: 1024 MiB of mesh"):
        ul.load_scene(path)


FAR = MODEL.replace("<link", "<pose>569000.25 7034000.75 40 0 0 0</pose><link")


def test_a_world_far_away_gets_an_origin_and_says_which(write):
    path = write(f"<sdf version='1.9'>{FAR}</sdf>")
    with pytest.warns(UllageWarning, match=r"origin_m = \[569000, 7034000, 0\]"):
        found = ul.load_scene(path)
    np.testing.assert_allclose(found.bounds.mean(0), [0.25, 0.75, 40], atol=1e-8)
    np.testing.assert_allclose(found.models["m"][:3, 3], [0.25, 0.75, 40], atol=1e-8)


@pytest.mark.parametrize("origin", [(0, 0, 0), (1, -2.5, 3), (569000.25, 7034000.75, 40)])
def test_an_origin_shifts_every_kind_of_world_and_nothing_else(write, origin):
    """Positions less the origin: of models, meshes and joints; shapes stay bit-equal in size."""
    near = write(f"<sdf version='1.9'>{FAR.replace('569000.25 7034000.75 40', ' '.join(map(str, origin)))}</sdf>")
    triangle = "".join(f"v {x + origin[0]} {y + origin[1]} {origin[2]}\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    mesh = write(triangle + "f 1 2 3\n", "m.obj")
    for path, low in ((near, (-0.5, -1, -1.5)), (mesh, (0, 0, 0)))[: 1 if max(origin) > 1e5 else 2]:
        np.testing.assert_allclose(ul.load_scene(path, origin_m=origin).bounds[0], low, atol=1e-8)


def test_an_origin_that_is_none_or_leaves_the_world_out_of_reach(write):
    path = write(f"<sdf version='1.9'>{FAR}</sdf>")
    with pytest.raises(InputError, match=r"w\.sdf: the world reaches 7\.03e\+06 m from its origin"):
        ul.load_scene(path, origin_m=(0, 0, 0))
    for origin in ((1, 2), (0, 0, float("nan")), "here"):
        with pytest.raises(InputError, match="origin_m is "):
            ul.load_scene(path, origin_m=origin)
    both = write(f"<sdf version='1.9'><world name='w'>{FAR}{MODEL.replace(chr(39) + 'm', chr(39) + 'n')}</world></sdf>")
    with pytest.warns(UllageWarning), pytest.raises(InputError, match="from its origin"):
        ul.load_scene(both)


@pytest.mark.parametrize("name", ["concrete", "Concrete", "itu_concrete", "ITU_CONCRETE", " itu-concrete "])
def test_materials_go_by_other_ways_of_writing_them(write, name):
    scene = ul.load_scene(write(WORLD.replace(">concrete<", f">{name}<")))
    assert scene.objects[0].material.name == "concrete"


def test_what_is_not_there_or_of_no_known_kind_is_refused(tmp_path, write):
    with pytest.raises(InputError, match="no such file"):
        ul.load_scene(tmp_path / "none.sdf")
    with pytest.raises(InputError, match="is a folder"):
        ul.load_scene(tmp_path)
    with pytest.raises(InputError, match=r"unknown kind '\.txt'.*\.sdf \.world \.urdf"):
        ul.load_scene(write("x", "a.txt"))
    with pytest.raises(InputError, match="geometry is 'skin'"):
        ul.load_scene(write(WORLD), geometry="skin")
