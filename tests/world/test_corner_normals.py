"""Normals at corners: read where a mesh file has some, kept by scenes, and used where the facets agree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import ullage as ul
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.world.scene import Scene

DAE = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<source id="n"><float_array id="na" count="6">0 0 -2 0 -1 0</float_array><technique_common>
<accessor source="#na" count="2" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="2"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="1"/>
<p>0 0 2 0 1 0 0 1 1 1 3 1</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><scale>1 1 -2</scale><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, 0.5)


@pytest.mark.parametrize("kind", ["glb", "obj", "ply"])
def test_a_file_with_normals_gives_them_to_its_corners(tmp_path, ball, kind):
    path = tmp_path / f"ball.{kind}"
    named = {"vertex_normal": True} if kind == "ply" else {"include_normals": True}
    path.write_bytes(_bytes(ball.export(file_type=kind, **named)))
    scene = ul.load_scene(path)
    assert scene.corner_normals.shape == (len(scene.faces), 3, 3)
    assert np.allclose(scene.corner_normals, scene.corners() / 0.5, atol=2e-2)


@pytest.mark.parametrize("kind", ["glb", "obj", "stl"])
def test_a_file_without_normals_gives_none(tmp_path, ball, kind):
    path = tmp_path / f"ball.{kind}"
    path.write_bytes(_bytes(ball.export(file_type=kind, **({} if kind == "stl" else {"include_normals": False}))))
    assert ul.load_scene(path).corner_normals is None


def test_normals_of_a_collada_file_turn_with_its_nodes(tmp_path: Path):
    path = tmp_path / "two.dae"
    path.write_text(DAE)
    scene = ul.load_scene(path)  # mirrored: below is above, faces are turned round
    corners = scene.corners()
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    assert np.allclose(scene.corner_normals, cross[:, None])
    assert np.allclose(cross[np.lexsort(cross.T)], [[0, -1, 0], [0, 0, 1]])


def test_scenes_keep_normals_with_their_faces():
    plain = ul.scenes.plate(width_m=1, height_m=1, distance_m=2)
    normals = np.zeros((len(plain.faces), 3, 3))
    normals[:, :, 0] = -1
    told = replace(plain, corner_normals=normals)
    both = Scene.union([plain, told])
    assert np.array_equal(both.corner_normals, np.concatenate([np.zeros_like(normals), normals]))
    assert Scene.union([plain, plain]).corner_normals is None
    left = replace(both, objects=tuple(replace(o, name=f"{n}::link") for o, n in zip(both.objects, "ab", strict=True)))
    assert np.array_equal(left.without("a").corner_normals, normals)


def test_normals_of_what_is_driven_are_in_its_own_frame():
    plain = ul.scenes.plate(width_m=1, height_m=1, distance_m=2)
    normals = np.zeros((len(plain.faces), 3, 3))
    normals[:, :, 0] = -1
    quarter = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # world_from_model
    world = replace(plain, corner_normals=normals, models={plain.objects[0].name: quarter})
    moved = world.driven(plain.objects[0].name, Trajectory.stationary(n=2))
    assert np.allclose(moved.corner_normals, [0, 1, 0])
    assert np.allclose(world.moved((1, 2, 3), yaw_deg=90).corner_normals, [0, -1, 0])


def test_normals_of_another_shape_are_refused():
    plain = ul.scenes.plate(width_m=1, height_m=1, distance_m=2)
    with pytest.raises(InputError, match="corner normals of shape"):
        replace(plain, corner_normals=np.zeros((1, 3, 3)))


def _bytes(data: str | bytes) -> bytes:
    return data.encode() if isinstance(data, str) else data
