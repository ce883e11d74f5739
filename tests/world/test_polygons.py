"""Concave faces of mesh files: they cover their own ground and no more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ullage as ul

FLOOR = [(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4)]  # an L of 12 m^2
DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="1"/></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="18">{places}</float_array>
<technique_common><accessor source="#a" count="6" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><vcount>6</vcount><p>{order}</p></polylist>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def obj(order: list[int], *, negative: bool = False, comment: str = "") -> str:
    """The floor as one face of an OBJ file, with a wall of two triangles behind it."""
    face = " ".join(f"{k - 6 if negative else k + 1}" for k in order)
    wall = "v 0 0 0\nv 0 4 0\nv 0 4 3\nf -1 -2 -3\n"
    return comment + "".join(f"v {x} {y} 0\n" for x, y in FLOOR) + f"f {face}\n" + wall


def dae(order: list[int]) -> str:
    return DAE.format(places=" ".join(f"{x} {y} 0" for x, y in FLOOR), order=" ".join(map(str, order)))


def floor_of(scene: ul.Scene) -> np.ndarray:
    corners = scene.corners()
    return corners[(corners[:, :, 2] == 0).all(1)]


@pytest.mark.parametrize("start", range(6))
@pytest.mark.parametrize("back", [False, True], ids=["up", "down"])
@pytest.mark.parametrize("kind", ["obj", "obj-negative", "dae"])
def test_a_concave_floor_covers_its_own_ground(tmp_path: Path, kind: str, start: int, back: bool) -> None:
    order = [(start + k) % 6 for k in range(6)]
    order = order[::-1] if back else order
    file = tmp_path / f"floor.{kind[:3]}"
    file.write_text(dae(order) if kind == "dae" else obj(order, negative=kind == "obj-negative"))
    floor = floor_of(ul.load_scene(file))
    twice = np.cross(floor[:, 1] - floor[:, 0], floor[:, 2] - floor[:, 0])
    assert len(floor) == 4
    np.testing.assert_allclose(np.abs(twice).sum() / 2, 12.0)
    np.testing.assert_allclose(twice[:, 2].sum() / 2, -12.0 if back else 12.0)
    middle = floor.mean(axis=1)
    assert not ((middle[:, 0] > 2) & (middle[:, 1] > 2)).any()


def test_convex_faces_stay_as_the_file_has_them(tmp_path: Path) -> None:
    from ullage.world.polygons import plain_obj

    text = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 .5 0\nf 1/1/1 2/2/1 3/3/1 4/4/1 5/5/1\n"
    assert plain_obj(text) == text


def test_numbers_below_zero_count_back_from_the_face(tmp_path: Path) -> None:
    square = "v {x} 0 0\nv {x} 1 0\nv {x} 1 1\nv {x} 0 1\nvn 1 0 0\nf -4//-1 -3//-1 -2//-1 -1//-1\n"
    (tmp_path / "two.obj").write_text("".join(square.format(x=x) for x in (3, 5)))
    corners = ul.load_scene(tmp_path / "two.obj").corners()
    np.testing.assert_array_equal(sorted(corners[:, :, 0].tolist()), [[3] * 3, [3] * 3, [5] * 3, [5] * 3])


@pytest.mark.parametrize("face", ["f 1 2 3 9", "f 1 2 3 x", "f 0 1 2 3", "f -5 -4 -3"])
def test_faces_of_missing_corners_are_refused_in_one_line(tmp_path: Path, face: str) -> None:
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n{face}\n")
    with pytest.raises(ul.InputError, match=r"the mesh cannot be read") as caught:
        ul.load_scene(tmp_path / "a.obj")
    assert "\n" not in str(caught.value)
