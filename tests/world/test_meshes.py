"""Mesh files of each format, written by other libraries, give the same triangles; broken ones one clear line."""

import warnings

import numpy as np
import pytest
import trimesh

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.world.meshes import load_mesh

FORMATS = ("dae", "glb", "gltf", "obj", "ply", "stl")


@pytest.fixture
def two_parts():
    """A box at the origin and a small one beside it, each named."""
    small = trimesh.creation.box((0.2, 0.4, 0.6)).apply_translation((5, 6, 7))
    return trimesh.Scene({"big": trimesh.creation.box((1, 2, 3)), "small": small})


def save(scene, folder, kind):
    path = folder / f"mesh.{kind}"
    if kind == "gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(scene).items():
            (folder / ("mesh.gltf" if name.endswith("gltf") else name)).write_bytes(data)
    elif kind in ("stl", "ply"):
        scene.to_mesh().export(path)
    elif kind == "dae":
        path.write_bytes(trimesh.exchange.dae.export_collada(list(scene.geometry.values())))
    else:
        scene.export(path)
    return path


@pytest.mark.parametrize("kind", FORMATS)
def test_each_format_gives_the_same_solid(kind, tmp_path, two_parts):
    scene = ul.load_scene(save(two_parts, tmp_path, kind))
    np.testing.assert_allclose(scene.bounds, [[-0.5, -1, -1.5], [5.1, 6.2, 7.3]], atol=1e-6)
    assert trimesh.Trimesh(scene.vertices, scene.faces, process=False).volume == pytest.approx(6.048, abs=1e-5)
    assert len(scene.faces) == 24
    assert scene.objects[0].name == "mesh"
    assert scene.objects[0].material.name == "steel"


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_a_submesh_is_taken_by_name_and_centred(kind, tmp_path, two_parts):
    path = save(two_parts, tmp_path, kind)
    vertices, faces = load_mesh(path, submesh="small")
    np.testing.assert_allclose(
        [vertices[faces].min((0, 1)), vertices[faces].max((0, 1))], [[4.9, 5.8, 6.7], [5.1, 6.2, 7.3]], atol=1e-6
    )
    vertices, faces = load_mesh(path, submesh="small", center=True)
    np.testing.assert_allclose(vertices[faces].max((0, 1)), [0.1, 0.2, 0.3], atol=1e-6)
    with pytest.raises(InputError, match=r"no submesh 'none' \(allowed: .*big.*small"):
        load_mesh(path, submesh="none")


COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
  <library_geometries><geometry id="g" name="tri"><mesh>
    <source id="p"><float_array id="pa" count="12">0 0 0 100 0 0 100 50 0 0 50 0</float_array>
      <technique_common><accessor source="#pa" count="4" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><vcount>4</vcount><p>0 1 2 3</p></polylist>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s">
    <node id="n1" name="door"><translate>0 0 200</translate><instance_geometry url="#g"/></node>
    <node id="n2" name="mirror"><scale>-1 1 1</scale><instance_geometry url="#g"/></node>
  </visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""


def test_collada_units_count_and_its_nodes_name_parts(tmp_path):
    path = tmp_path / "m.dae"
    path.write_text(COLLADA)
    vertices, faces = load_mesh(path, submesh="door")
    np.testing.assert_allclose([vertices.min(0), vertices.max(0)], [[0, 0, 2], [1, 0.5, 2]])
    assert len(faces) == 2
    vertices, faces = load_mesh(path, submesh="mirror")
    a, b, c = vertices[faces[0]]
    assert vertices[:, 0].min() == pytest.approx(-1)
    assert np.cross(b - a, c - a)[2] > 0  # a mirrored plate faces the way it did
    assert len(load_mesh(path)[1]) == 4


def test_degenerate_triangles_are_left_out_with_a_count(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\nf 1 1 3\n")
    with pytest.warns(UllageWarning, match=r"m\.obj: 2 degenerate triangles of 3 left out"):
        _, faces = load_mesh(path)
    assert len(faces) == 1
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="no triangle of the mesh has an area"):
        load_mesh(path)


def test_small_and_slender_triangles_stay(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text("v 0 0 0\nv 1e-4 0 0\nv 0 1e-4 0\nv 10 0 0\nv 10 0.001 0\nf 1 2 3\nf 1 4 5\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(load_mesh(path)[1]) == 2


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("m.stl", b"", "m.stl: the file is empty"),
        ("m.stl", b"solid x\nendsolid x\n", r"m\.stl: the mesh"),
        ("m.stl", bytes(range(200)), r"m\.stl: the mesh"),
        ("m.glb", b"glTF garbage that is long enough to be read", r"m\.glb: the mesh cannot be read"),
        ("m.gltf", b"{}", r"m\.gltf: the mesh"),
        ("m.dae", b"<COLLADA", r"m\.dae: the mesh cannot be read"),
        ("m.dae", b"PK\x03\x04", r"m\.dae: not COLLADA"),
        ("m.dae", b'<!DOCTYPE x [<!ENTITY a "b">]><COLLADA/>', r"m\.dae: declares XML entities"),
        ("m.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", r"m\.ply: the mesh"),
        ("m.obj", b"v 0 0 0\nv nan 1 0\nv 0 1 0\nf 1 2 3\n", "not finite|cannot be read"),
        ("m.obj", b"v 0 0 0\nv 0 1 0\n", r"m\.obj: the mesh"),
        ("m.obj", b"v 0 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 9\n", r"m\.obj: (a triangle of )?the mesh"),
    ],
)
def test_broken_meshes_are_refused_in_one_line(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        load_mesh(path)
    assert "\n" not in str(caught.value)


def test_a_truncated_mesh_of_each_format_is_refused_or_warned_about(tmp_path, two_parts):
    for kind in ("glb", "gltf", "ply", "stl", "dae"):
        path = save(two_parts, tmp_path, kind)
        raw = path.read_bytes()
        path.write_bytes(raw[: len(raw) // 2])
        with pytest.raises(InputError, match="mesh"):
            load_mesh(path)


def test_a_gltf_that_reaches_for_other_folders_is_refused(tmp_path, two_parts):
    folder = tmp_path / "inner"
    folder.mkdir()
    path = save(two_parts, folder, "gltf")
    text = path.read_text()
    name = next(p.name for p in folder.iterdir() if p.suffix == ".bin")
    (tmp_path / name).write_bytes((folder / name).read_bytes())
    path.write_text(text.replace(f'"{name}"', f'"../{name}"'))
    with pytest.raises(InputError, match="reaches out of its folder"):
        load_mesh(path)


@pytest.mark.parametrize("header", [b"any".ljust(80), b"solid any".ljust(80)])
def test_bytes_after_the_last_facet_of_an_stl_are_left_out_with_a_warning(tmp_path, header):
    whole = header + trimesh.creation.box((1, 2, 3)).export(file_type="stl")[80:]
    path = tmp_path / "b.stl"
    path.write_bytes(whole)
    want = load_mesh(path)
    path.write_bytes(whole + b"attributes")
    with pytest.warns(UllageWarning, match=r"b\.stl: 10 bytes after the last facet are left out"):
        found = load_mesh(path)
    np.testing.assert_array_equal(found[0], want[0])
    np.testing.assert_array_equal(found[1], want[1])


@pytest.mark.parametrize("header", [b"any".ljust(80), b"solid any".ljust(80)])
@pytest.mark.parametrize("cut", [1, 25, 50, 590])
def test_a_binary_stl_that_is_cut_is_refused(tmp_path, header, cut):
    path = tmp_path / "b.stl"
    path.write_bytes((header + trimesh.creation.box((1, 2, 3)).export(file_type="stl")[80:])[:-cut])
    with pytest.raises(InputError, match=r"b\.stl: the mesh"):
        load_mesh(path)
