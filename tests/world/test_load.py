"""Scenes from files: what is asked for by suffix, and what is refused in one line."""

import numpy as np
import pytest

import ullage as ul
from ullage.errors import InputError

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
    def made(text, name="w.sdf"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(text, bytes):
            path.write_bytes(text)
        else:
            path.write_text(text)
        return path

    return made


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
        (b"<sdf version='1.3'/>", r"SDF version 1\.3 \(allowed: 1\.4 to 1\.12\)"),
        (b"<sdf version='one'/>", "version 'one'"),
        (b"<sdf version='1.9'/>", "holds no world"),
    ],
)
def test_files_that_are_no_sdf_are_refused_in_one_line(write, content, words):
    with pytest.raises(InputError, match=words) as caught:
        ul.load_scene(write(content))
    assert "\n" not in str(caught.value)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "huge.sdf"
    with path.open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(InputError, match=r"huge\.sdf: 1024 MiB of XML \(allowed: at most 64 MiB\)"):
        ul.load_scene(path)
    path = path.rename(tmp_path / "huge.stl")
    with pytest.raises(InputError, match=r"huge\.stl: 1024 MiB of mesh"):
        ul.load_scene(path)


def test_what_is_not_there_or_of_no_known_kind_is_refused(tmp_path, write):
    with pytest.raises(InputError, match="no such file"):
        ul.load_scene(tmp_path / "none.sdf")
    with pytest.raises(InputError, match="is a folder"):
        ul.load_scene(tmp_path)
    with pytest.raises(InputError, match=r"unknown kind '\.txt'.*\.sdf \.world \.urdf"):
        ul.load_scene(write("x", "a.txt"))
    with pytest.raises(InputError, match="geometry is 'skin'"):
        ul.load_scene(write(WORLD), geometry="skin")
