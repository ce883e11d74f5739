"""The shipped worlds: files as generated, sound geometry, the thesis' arrangement, and paths that keep clear."""

from __future__ import annotations

import itertools
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from lxml import etree

import ullage as ul
from ullage.radar.checks import check
from ullage.world.library import WORLDS, WORLDS_DIR
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.sdf_parse import NAMESPACE
from write_worlds import regenerated

NAMES = list(WORLDS)


@cache
def scene_of(name: str) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return WORLDS[name].scene()


def seen(scene: Scene, origin: list[float], toward: list[float]) -> tuple[str, float]:
    ray = np.array([toward], float) / np.linalg.norm(toward)
    face, distance = Raycaster(scene).hits(np.array([origin], float), ray)
    return scene.objects[scene.face_object[face[0]]].name, float(distance[0])


def extent(scene: Scene, model: str) -> np.ndarray:
    owners = [i for i, thing in enumerate(scene.objects) if thing.name.split("::")[0] == model]
    corners = scene.corners()[np.isin(scene.face_object, owners)].reshape(-1, 3)
    return np.stack([corners.min(0), corners.max(0)])


def track(name: str, step_m: float = 0.1) -> np.ndarray:
    points = np.array(WORLDS[name].path_xyzyaw)[:, :3]
    legs = []
    for a, b in itertools.pairwise(points):
        count = max(2, int(np.linalg.norm(b - a) / step_m) + 1)
        legs.append(np.linspace(a, b, count))
    return np.concatenate(legs)


def clearance(scene: Scene, points: np.ndarray) -> float:
    """Least distance from the points to faces and wires, by the slow and plain way."""
    corners = scene.corners()
    least = np.inf
    for point in points:
        near = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        least = min(least, float(np.linalg.norm(near - point, axis=1).min()))
    for start, end in zip(scene.wires.start, scene.wires.end, strict=True):
        share = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
        least = min(least, float(np.linalg.norm(start + share[:, None] * (end - start) - points, axis=1).min()))
    return least


def test_files_are_what_the_generator_writes():
    made = regenerated()
    there = {str(p.relative_to(WORLDS_DIR)): p for p in WORLDS_DIR.rglob("*.*") if ".py" not in p.suffix}
    there = {name: p for name, p in there.items() if p.is_file()}
    assert set(made) == set(there)
    changed = [name for name, text in made.items() if there[name].read_bytes() != text.encode("ascii")]
    assert changed == []


def test_files_are_small():
    assert sum(p.stat().st_size for p in WORLDS_DIR.rglob("*") if p.is_file()) < 2_000_000


@pytest.mark.parametrize("name", NAMES)
def test_file_is_sdf_1_9_and_names_only_meshes_beside_it(name):
    root = etree.parse(str(WORLDS[name].path)).getroot()
    assert (root.tag, root.get("version")) == ("sdf", "1.7")
    assert root.find("world").get("name") == name
    for uri in root.iter("uri"):
        assert (WORLDS_DIR / uri.text).is_file()
        assert ".." not in Path(uri.text).parts
    shapes = list(root.iter("collision"))
    assert len(shapes) == len(list(root.iter("visual"))) > 0
    for shape in shapes:
        assert shape.find(f"{{{NAMESPACE}}}material") is not None
        assert 0 < float(shape.find("laser_retro").text) <= 1
    models = [model.get("name") for model in root.iter("model")]
    assert len(models) == len(set(models))


@pytest.mark.parametrize("name", ["ntnu-pole", "cargo-hold"])
def test_what_gazebo_shows_is_what_the_radar_meets(name):
    shown, met = ul.load_scene(WORLDS[name].path, geometry="visual"), scene_of(name)
    assert shown.corners() == pytest.approx(met.corners())
    assert [thing.name for thing in shown.objects] == [thing.name for thing in met.objects]


@pytest.mark.parametrize("name", NAMES)
def test_geometry_is_sound(name):
    scene = scene_of(name)
    corners = scene.corners()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert area.min() > 1e-7
    key = np.sort(np.round(corners, 4).view([("", float)] * 3).reshape(-1, 3), axis=1)
    assert len(np.unique(key, axis=0)) == len(key)  # no face lies on another
    assert len({thing.name for thing in scene.objects}) == len(scene.objects)


@pytest.mark.parametrize("name", NAMES)
def test_path_keeps_its_distance(name):
    world = WORLDS[name]
    assert clearance(scene_of(name), track(name)) >= 0.8
    assert world.start == world.path_xyzyaw[0]


def test_clearance_would_notice():
    assert clearance(scene_of("ntnu-plate"), np.array([[-0.4, 0.0, 1.1]])) == pytest.approx(0.3985)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "cargo-hold"])  # its hatch is open
def test_world_is_shut(name):
    rng = np.random.default_rng(5)
    rays = rng.normal(size=(20_000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    start = np.array(WORLDS[name].start[:3])
    _, distance = Raycaster(scene_of(name)).hits(np.broadcast_to(start, rays.shape), rays)
    assert np.isfinite(distance).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_radar_finds_no_fault_with_the_meshes(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(scene_of(name), ul.Trajectory.stationary(WORLDS[name].start[:3]), {})


def test_openings_are_gaps_with_their_own_stuff_set_back():
    scene = scene_of("ntnu-room")
    assert seen(scene, [-2.6, 0, 1], [0, -1, 0]) == ("door", pytest.approx(3.12))
    assert seen(scene, [-2.2, 0, 1.5], [0, 1, 0]) == ("window_1", pytest.approx(3.12))
    assert seen(scene, [-1.2, 0, 1.5], [0, 1, 0]) == ("wall_north", pytest.approx(3.0))
    made_of = {thing.name: thing.material for thing in scene.objects}
    assert made_of["door"].name == "wood"
    assert made_of["door"].thickness_m == pytest.approx(0.04)
    assert made_of["window_1"].name == "glass"
    assert made_of["window_1"].thickness_m == pytest.approx(0.006)


def test_targets_stand_in_the_middle():
    assert seen(scene_of("ntnu-plate"), [-2.2, 0, 1.1], [1, 0, 0]) == ("steel_plate::plate", pytest.approx(2.1985))
    assert seen(scene_of("ntnu-pole"), [-2.2, 0, 1.1], [1, 0, 0]) == ("steel_pole::pole", pytest.approx(2.17))
    assert seen(scene_of("ntnu-pole"), [-2.2, 0, 0.3], [1, 0, 0]) == ("steel_pole::box", pytest.approx(2.01))
    wire = scene_of("ntnu-wire")
    mine = wire.wires.object_id == wire.object("steel_wire::wire")
    assert wire.wires.radius_m[mine] == pytest.approx(0.002)
    assert wire.wires.start[mine][0, :2] == pytest.approx([-0.004, 0])
    assert seen(wire, [-2.2, 0, 1.1], [1, 0, 0]) == ("steel_wire::half_pipe", pytest.approx(2.2))
    turned = scene_of("ntnu-plate45")
    corners = turned.corners()[turned.face_object == turned.object("steel_plate::plate")].reshape(-1, 3)
    assert np.ptp(corners[:, 0]) == pytest.approx(0.7092, abs=1e-3)


def test_strafe_passes_the_target_sideways():
    for name in ("ntnu-plate", "ntnu-plate45", "ntnu-pole", "ntnu-wire"):
        a, b = (np.array(point) for point in WORLDS[name].path_xyzyaw)
        assert a[0] == b[0] < 0
        assert a[1] < 0 < b[1]
        assert a[3] == b[3] == 0


def test_cluttered_room_is_arranged_as_in_the_thesis():
    scene = scene_of("cluttered-room")
    middle = {name: extent(scene, name).mean(0) for name in ("postbox", "stop_sign", "person", "car", "dumpster")}
    assert middle["postbox"][0] < -4
    assert middle["postbox"][1] > 3
    assert middle["stop_sign"][0] > 4
    assert middle["stop_sign"][1] < -3
    x, y, _, yaw = WORLDS["cluttered-room"].path_xyzyaw[-1]
    ahead = np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw))])
    left = np.array([-ahead[1], ahead[0]])
    toward = middle["person"][:2] - [x, y]
    assert toward @ left > 1.5
    assert abs(toward @ ahead) < 0.3
    for name in (*middle, "robot", "control_panel"):
        low, high = extent(scene, name)
        assert (low >= [-6, -5, -1e-6]).all()
        assert (high <= [6, 5, 4]).all()
        assert low[2] == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "size_m"),
    [
        ("car", (3.9, 1.6, 1.4)),
        ("postbox", (0.6, 0.5, 1.1)),
        ("stop_sign", (0.4, 0.4, 2.5)),
        ("person", (0.2, 0.5, 1.7)),
        ("robot", (0.9, 0.9, 1.8)),
        ("control_panel", (0.7, 1.5, 1.5)),
        ("dumpster", (1.3, 1.3, 1.3)),
    ],
)
def test_things_have_the_size_of_life(name, size_m):
    size = np.ptp(extent(scene_of("cluttered-room"), name), axis=0)
    assert (size >= size_m).all()
    assert (size <= np.array(size_m) * 1.25 + 0.9).all()


def test_worlds_have_python_names():
    assert len(ul.scenes.cargo_hold().faces) == len(scene_of("cargo-hold").faces)
    assert ul.scenes.ntnu_plate45().bounds == pytest.approx(scene_of("ntnu-plate45").bounds)


def test_two_worlds_cannot_fight_over_a_mesh():
    import shipped_worlds

    def other() -> list[shipped_worlds.Model]:
        return [shipped_worlds.Model("floor", shipped_worlds.ntnu_room()[1].solids)]

    with pytest.raises(ul.UllageError, match=r"ntnu-plate wants another meshes/ntnu/floor\.obj"):
        regenerated(shipped_worlds.BUILDERS | {"ntnu-plate": other})
