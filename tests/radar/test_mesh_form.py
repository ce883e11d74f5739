"""The echo of a mesh depends on its surface: not on how it is cut, wound, ordered, doubled or turned into a file."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.world import shapes
from ullage.world.solids import bar, block, join, limb, loft, moved, prism

Mesh = tuple[np.ndarray, np.ndarray]
SPEC = ul.RadarSpec.preset("x4m05", noise=None)
ALONG_Y = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))


def of(mesh: trimesh.Trimesh) -> Mesh:
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)


def wheels(radius: float, wide: float, sides: int, xs: tuple[float, ...], y: float) -> list[Mesh]:
    one = of(trimesh.creation.cylinder(radius, wide, sections=sides, transform=ALONG_Y))
    return [moved(one, (x, side * y, radius)) for x in xs for side in (-1, 1)]


def robot() -> Mesh:
    arm = limb([(0.3, 0, 0.4), (0.5, 0, 0.6), (0.7, 0.1, 0.55)], [0.04, 0.03, 0.02], sides=12)
    head = moved(shapes.sphere(0.12, edge_m=0.06), (0, 0, 1.0))
    body = [block((-0.3, -0.2, 0.2), (0.3, 0.2, 0.5)), bar((0, 0, 0.5), (0, 0, 0.9), 0.05), head, arm]
    return join(*body, *wheels(0.1, 0.08, 20, (-0.2, 0.2), 0.25))


def wheel() -> Mesh:
    turns = [(np.cos(a), np.sin(a)) for a in 2 * np.pi * np.arange(5) / 5]
    spokes = [bar((0.05 * c, 0.05 * s, 0), (0.37 * c, 0.37 * s, 0), 0.01, sides=6) for c, s in turns]
    tyre = of(trimesh.creation.torus(0.4, 0.05, major_sections=32, minor_sections=12))
    return join(tyre, of(trimesh.creation.cylinder(0.06, 0.12, sections=16)), *spokes)


def car() -> Mesh:
    angle = 2 * np.pi * np.arange(16) / 16
    y, z = (np.sign(c) * abs(c) ** 0.5 for c in (np.cos(angle), np.sin(angle)))
    rings = [(-1, 0.5, 0.25, 0.5), (-0.9, 0.6, 0.2, 0.7), (-0.2, 0.55, 0.18, 1.1), (0.4, 0.55, 0.18, 1.12),
             (0.7, 0.62, 0.18, 0.8), (1.0, 0.5, 0.25, 0.6)]  # fmt: skip
    body = [np.c_[np.full(16, x), w * y, (low + top) / 2 + (top - low) / 2 * z] for x, w, low, top in rings]
    return join(loft(np.array(body)), *wheels(0.2, 0.12, 18, (-0.6, 0.6), 0.6))


def hall() -> Mesh:
    vertices, faces = shapes.box((6, 5, 3))
    pillars = [block((x - 0.15, y - 0.15, -1.5), (x + 0.15, y + 0.15, 1.5)) for x in (-1.5, 1.5) for y in (-1, 1.2)]
    return join((vertices, faces[:, ::-1]), *pillars, block((-3, -1, -1.5), (-2, 0, -0.7)))


def crane() -> Mesh:
    up, feet = np.array([0, 0, 1.0]), [np.array(p, float) for p in ((0, 0, 0), (0.3, 0, 0), (0.3, 0.3, 0), (0, 0.3, 0))]
    out = [prism([(-0.2, 2.0), (1.5, 2.0), (1.5, 2.05), (-0.2, 2.2)], 0.3)]
    for low in np.arange(4) * 0.5:
        for foot, after in zip(feet, feet[1:] + feet[:1], strict=True):
            a, b, c = foot + up * low, foot + up * (low + 0.5), after + up * (low + 0.5)
            out += [bar(a, b, 0.02, sides=4), bar(a, c, 0.012, sides=4), bar(b, c, 0.012, sides=4)]
    return join(*out)


def hull() -> Mesh:
    rings = []
    for x in np.linspace(-1.5, 1.5, 13):
        beam, depth = 0.6 * (1 - (x / 1.6) ** 4) ** 0.5 + 0.02, 0.5 * (1 - (x / 1.7) ** 2) + 0.05
        frame = [(x, y * beam, -depth * (1 - abs(y) ** 3)) for y in np.linspace(-1, 1, 13)]
        rings.append([*frame, (x, 0.98 * beam, 0.15), (x, -0.98 * beam, 0.15)])
    return loft(np.array(rings))


def plate_with_holes() -> Mesh:
    from shapely import Point, box

    cut = box(-0.6, -0.4, 0.6, 0.4) - Point(0.3, 0).buffer(0.15, 8) - box(-0.4, -0.2, -0.1, 0.2)
    vertices, faces = of(trimesh.creation.extrude_polygon(cut, 0.02))
    return vertices[:, [2, 0, 1]], faces


def beam() -> Mesh:
    half = [(0.1, -0.15), (0.1, -0.13), (0.01, -0.13), (0.01, 0.13), (0.1, 0.13), (0.1, 0.15)]
    return prism(half + [(-x, z) for x, z in half[::-1]], 1.2)


def flange() -> Mesh:  # the ring round the pipe touches it at circles that only a cut mesh has
    pipe = of(trimesh.creation.annulus(0.1, 0.12, 0.6, sections=24))
    return join(of(trimesh.creation.annulus(0.12, 0.25, 0.03, sections=24)), moved(pipe, (0, 0, 0.3)))


def vessel() -> Mesh:
    return shapes.capsule(0.4, 0.9, segment_m=0.12)


def terrain() -> Mesh:
    return shapes.terrain(0.15 * np.random.default_rng(3).random((9, 9)), (2.0, 2.0))


def ladder() -> Mesh:
    rungs = [bar((0, -0.2, z), (0, 0.2, z), 0.012, sides=8) for z in np.linspace(-0.8, 0.8, 6)]
    return join(*[bar((0, y, -1), (0, y, 1), 0.02, sides=8) for y in (-0.2, 0.2)], *rungs)


def bend() -> Mesh:
    turn = np.linspace(0, np.pi / 2, 9)
    line = np.c_[0.5 * np.cos(turn), 0.5 * np.sin(turn), 0 * turn]
    return limb([(0.5, -0.6, 0), *line, (-0.6, 0.5, 0)], [0.08] * 11, sides=16)


KINDS: tuple[Callable[[], Mesh], ...] = (
    robot, wheel, car, hall, crane, hull, plate_with_holes, beam, flange, vessel, terrain, ladder, bend,
)  # fmt: skip


def cut_in_four(mesh: Mesh) -> Mesh:
    """The mesh with each triangle cut in four, vertices and faces shuffled, and half of the faces wound round."""
    vertices, faces = trimesh.remesh.subdivide(*mesh)
    rng = np.random.default_rng(7)
    order = rng.permutation(len(vertices))
    faces = np.argsort(order)[faces][rng.permutation(len(faces))]
    back = rng.random(len(faces)) < 0.5
    faces[back] = faces[back][:, ::-1]
    return vertices[order], faces


def loaded(mesh: Mesh, file: Path, **options: object) -> ul.Scene:
    trimesh.Trimesh(*mesh, process=False).export(file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UllageWarning)
        return ul.load_scene(file, **options)  # type: ignore[arg-type]


def echo(scene: ul.Scene, *, inside: bool = False, bounces: int = 2) -> np.ndarray:
    start = np.array([0.13, 0.07, 0.04] if inside else [-2.5, 0.1, 0.3])
    path = ul.Trajectory.line(tuple(start), tuple(start + np.array([0.02, 0.3, 0.05])), 0.5, 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UllageWarning)
        return ul.simulate(scene, path, SPEC, max_bounces=bounces).samples


def change_db(a: np.ndarray, b: np.ndarray) -> float:
    """The greatest change of a sample, over the peak of its frame."""
    return float(20 * np.log10((abs(a - b).max(1) / abs(a).max(1)).max() + 1e-12))


@pytest.mark.parametrize("make", KINDS, ids=lambda make: make.__name__)
def test_cut_shuffled_and_reversed_meshes_echo_alike(tmp_path: Path, make: Callable[[], Mesh]) -> None:
    """Also in a file without common corners (STL) as in one with them (PLY)."""
    mesh, inside = make(), make is hall
    whole = echo(loaded(mesh, tmp_path / "whole.stl"), inside=inside)
    cut = echo(loaded(cut_in_four(mesh), tmp_path / "cut.ply"), inside=inside)
    back = echo(loaded((mesh[0], mesh[1][::-1, ::-1]), tmp_path / "back.ply"), inside=inside)
    assert change_db(whole, cut) < -30
    assert change_db(whole, back) < -30


SHEET = "v 2 -0.1 -0.1\nv 2 0.1 -0.1\nv 2 0.1 0.1\nv 2 -0.1 0.1\nf 1 2 3\nf 1 3 4\n"
SHEETS = {
    "both sides": SHEET + "f 3 2 1\nf 4 3 1\n",
    "both sides, cut otherwise": SHEET + "f 4 2 1\nf 4 3 2\n",
    "two skins": SHEET + SHEET.replace("v 2 ", "v 2.001 ").replace("f 1 2 3\nf 1 3 4", "f 7 6 5\nf 8 7 5"),
    "reversed in part": SHEET.replace("f 1 3 4", "f 4 3 1"),
}


@pytest.mark.parametrize("name", SHEETS)
@pytest.mark.parametrize("yaw_deg", [0, 25, 180, 200])
def test_a_sheet_is_a_sheet_however_it_was_modelled(tmp_path: Path, name: str, yaw_deg: float) -> None:
    levels = []
    for text in (SHEET, SHEETS[name]):
        (tmp_path / "sheet.obj").write_text(text)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UllageWarning)
            scene = ul.load_scene(tmp_path / "sheet.obj").moved(yaw_deg=yaw_deg, about=(2, 0, 0))
        frames = ul.simulate(scene, ul.Trajectory.stationary(position_m=(0, 0, 0), n=1), SPEC)
        levels.append(20 * np.log10(abs(frames.samples).max()))
    assert levels[0] == pytest.approx(levels[1], abs=0.3)


def test_objects_say_whether_their_facets_stand_for_a_curve(tmp_path: Path) -> None:
    file = tmp_path / "drum.stl"
    drum = loaded(of(trimesh.creation.cylinder(0.25, 1.5, sections=16)), file)
    assert 0.5 < drum.curved()["drum"] < 1
    assert drum.smoothed("no").curved() == {"drum": 0.0}
    assert loaded(of(trimesh.creation.cylinder(0.25, 1.5, sections=7)), file).curved() == {"drum": 0.0}
    assert ul.load_scene(file, smooth="yes").curved()["drum"] > 0.5
    (tmp_path / "drum.sdf").write_text(
        '<sdf version="1.9" xmlns:ullage="urn:ullage:sdf"><model name="m"><link name="l">'
        "<collision name='c'><geometry><mesh><uri>drum.stl</uri></mesh></geometry>"
        "<ullage:smooth>yes</ullage:smooth></collision></link></model></sdf>"
    )
    scene = ul.load_scene(tmp_path / "drum.sdf")
    assert [thing.smooth for thing in scene.objects] == ["yes"]
    assert scene.curved()["m"] > 0.5
    (tmp_path / "drum.sdf").write_text((tmp_path / "drum.sdf").read_text().replace(">yes<", ">perhaps<"))
    with pytest.raises(InputError, match=r"drum\.sdf.*<ullage:smooth> is 'perhaps'"):
        ul.load_scene(tmp_path / "drum.sdf")
    with pytest.raises(InputError, match="auto, yes, no"):
        drum.smoothed("perhaps")  # type: ignore[arg-type]


def test_units_are_guessed_aloud_or_given(tmp_path: Path) -> None:
    file = tmp_path / "camera.stl"
    camera = of(trimesh.creation.box((130, 40, 60)))
    trimesh.Trimesh(*camera).export(file)
    with pytest.warns(UllageWarning, match=r"camera\.stl: 130 units long: taken in millimetres; give scale=1"):
        scene = ul.load_scene(file)
    assert np.ptp(scene.bounds, axis=0) == pytest.approx([0.13, 0.04, 0.06])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.ptp(ul.load_scene(file, scale=1).bounds, axis=0) == pytest.approx([130, 40, 60])
        assert np.ptp(ul.load_scene(file, scale=0.01).bounds, axis=0) == pytest.approx([1.3, 0.4, 0.6])
    with pytest.raises(InputError, match=r"scale is -1"):
        ul.load_scene(file, scale=-1)


def test_repairs_are_told_in_one_line(tmp_path: Path) -> None:
    vertices, faces = of(trimesh.creation.box((1, 1, 1)))
    faces = np.concatenate([faces, faces[:1, ::-1], [[0, 0, 1]]])
    faces[3] = faces[3][::-1]
    file = tmp_path / "box.ply"
    trimesh.Trimesh(vertices, faces, process=False).export(file)
    told = r"1 degenerate triangle of 14 left out; 1 coincident triangle of 14 left out; 1 of 14 triangles turned"
    with pytest.warns(UllageWarning, match=told):
        scene = ul.load_scene(file)
    a, b, c = (scene.vertices[scene.faces[:, k]] for k in range(3))
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6 == pytest.approx(1)


def test_a_room_that_faces_inward_stays_so(tmp_path: Path) -> None:
    scene = loaded(hall(), tmp_path / "hall.ply")
    a, b, c = (scene.vertices[scene.faces[:, k]] for k in range(3))
    pillars = 4 * 0.3 * 0.3 * 3 + 0.8
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6 == pytest.approx(pillars - 90)
