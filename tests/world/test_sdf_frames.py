"""Poses: against plain matrix products on random trees, and against the real SDF parser."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sdf_corpus import CORPUS, poses_of, shape, shapes_of, write_corpus

from ullage.errors import InputError, UllageWarning
from ullage.world.library import WORLDS
from ullage.world.sdf_geometry import Rod

SHIPPED = {name: Path(world.path) for name, world in WORLDS.items()}


def ask(program, path, models=""):
    out = subprocess.run(
        [program, path, models] if models else [program, path], capture_output=True, text=True, check=False
    )
    poses = {}
    for line in out.stdout.splitlines():
        name, numbers, _ = line.split("\t")
        values = np.array(numbers.split(), float)
        poses[name] = np.eye(4)
        poses[name][:3, 3] = values[:3]
        poses[name][:3, :3] = Rotation.from_quat(values[3:]).as_matrix()
    return poses, out


def assert_same(ours, theirs):
    assert set(ours) == set(theirs)
    for name, pose in theirs.items():
        np.testing.assert_allclose(ours[name], pose, atol=1e-9, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("name", CORPUS)
def test_the_real_parser_agrees_on_poses(name, oracle, tmp_path):
    path, models = write_corpus(tmp_path, name)
    theirs, out = ask(oracle, path, models)
    assert out.returncode == 0, out.stderr
    assert len(theirs) >= 2
    assert_same(poses_of(path, [models]), theirs)


def extent_of(said, file):
    """How far a shape that the real parser tells of reaches along x, y and z."""
    kind, *words = said.split()
    v = np.array(words[:5] if kind == "plane" else words[:3], float)
    if kind == "mesh":
        return np.abs(v) * np.ptp(trimesh.load(file).vertices, axis=0)
    if kind == "plane":
        return np.array([*v[3:], 0]) if v[2] else None
    around = {"cylinder": [2, 2, 0], "capsule": [2, 2, 2], "sphere": [2, 2, 2]}
    if kind not in around:
        return v * {"box": 1, "ellipsoid": 2}[kind]
    return v[0] * np.array(around[kind]) + np.array([0, 0, v[1] if len(v) > 1 else 0])


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CORPUS, *SHIPPED])
def test_the_real_parser_agrees_on_shapes(name, oracle, tmp_path):
    """Kind, sizes, scale and file of each collision's shape, as the mesh that was made of it shows them."""
    path, models = write_corpus(tmp_path, name) if name in CORPUS else (SHIPPED[name], SHIPPED[name].parent)
    words = subprocess.run([oracle, path, models], capture_output=True, text=True, check=True).stdout.splitlines()
    theirs = {line.split("\t")[0]: line.split("\t")[2] for line in words}
    ours = shapes_of(path, [models])
    assert set(ours) == set(theirs)
    for key, said in theirs.items():
        made, file = ours[key]
        assert (file is not None) == said.startswith("mesh"), key
        if file is not None:
            assert str(file).endswith(said.split()[-1].split("://")[-1]), key
        reach = [2 * made.radius_m] * 2 + [made.length_m] if isinstance(made, Rod) else np.ptp(made[0], axis=0)
        want = extent_of(said, file)
        if want is not None:
            np.testing.assert_allclose(reach, want, rtol=2e-3, atol=1e-6, err_msg=f"{key}: {said}")


def plain(x, y, z, roll, pitch, yaw):
    """A pose by the textbook: Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rz @ ry @ rx, (x, y, z)
    return out


def rounded(limit):
    return st.floats(-limit, limit).map(lambda value: round(value, 9))


numbers = st.tuples(*[rounded(5)] * 3, *[rounded(3)] * 3)


@st.composite
def random_worlds(draw):
    """A world of frames and models in random order, each relative to some other; and its poses by plain products."""
    count = draw(st.integers(1, 12))
    truth, lines = {"world": np.eye(4)}, []
    for index in range(count):
        parent = draw(st.sampled_from(sorted(truth)))
        values = draw(numbers)
        name = f"f{index}"
        truth[name] = truth[parent] @ plain(*values)
        pose = " ".join(map(repr, values))
        kind = draw(st.sampled_from(["frame", "attached", "model"]))
        if kind == "frame":
            lines.append(f'<frame name="{name}"><pose relative_to="{parent}">{pose}</pose></frame>')
        elif kind == "attached":
            lines.append(f'<frame name="{name}" attached_to="{parent}"><pose>{pose}</pose></frame>')
        else:
            link = draw(numbers)
            text = " ".join(map(repr, link))
            placed = draw(st.booleans())
            lines.append(
                f'<model name="{name}"{" placement_frame=" + chr(34) + "l" + chr(34) if placed else ""}>'
                f'<pose relative_to="{parent}">{pose}</pose>'
                f'<link name="l"><pose>{text}</pose>{shape("c")}</link></model>'
            )
            if placed:
                truth[name] = truth[name] @ np.linalg.inv(plain(*link))
            truth[f"{name}::l"] = truth[name] @ plain(*link)
    lines = draw(st.permutations(lines))
    text = '<sdf version="1.9"><world name="w">' + "".join(lines) + "</world></sdf>"
    return text, {f"{name}::c": pose for name, pose in truth.items() if name.endswith("::l")}


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(random_worlds())
def test_random_pose_trees_are_products_of_matrices(tmp_path, world):
    path = tmp_path / "w.sdf"
    path.write_text(world[0])
    if world[1]:
        assert_same(poses_of(path), world[1])


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(random_worlds())
def test_the_real_parser_agrees_on_random_pose_trees(oracle, tmp_path, world):
    path = tmp_path / "w.sdf"
    path.write_text(world[0])
    theirs, out = ask(oracle, path)
    if world[1]:
        assert out.returncode == 0, out.stderr
        assert_same(poses_of(path), theirs)


def test_a_long_chain_of_frames_is_no_trouble(tmp_path):
    path = tmp_path / "w.sdf"
    frames = "".join(
        f'<frame name="f{i}"><pose relative_to="{"world" if i == 0 else f"f{i - 1}"}">0.01 0 0 0 0 0</pose></frame>'
        for i in range(2_000)  # twice as deep as Python calls functions
    )
    model = f'<model name="m"><pose relative_to="f1999"/><link name="l">{shape("c")}</link></model>'
    path.write_text(f'<sdf version="1.9"><world name="w">{frames}{model}</world></sdf>')
    assert poses_of(path)["m::l::c"][0, 3] == pytest.approx(20)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            '<frame name="a"><pose relative_to="b"/></frame><frame name="b"><pose relative_to="a"/></frame>'
            '<model name="m"><pose relative_to="a"/><link name="l">{c}</link></model>',
            r"w\.sdf:1: the poses go in a circle: a -> b -> a",
        ),
        (
            '<frame name="a" attached_to="b"/><frame name="b" attached_to="a"/>',
            r"w\.sdf:1: the (frames are attached|poses go) in a circle: a -> b -> a",
        ),
        (
            '<model name="m"><pose relative_to="m"/><link name="l">{c}</link></model>',
            r"the poses go in a circle: m -> m",
        ),
        (
            '\n\n<model name="m"><pose relative_to="nowhere"/><link name="l">{c}</link></model>',
            r"w\.sdf:3: no frame 'nowhere' in 'w' \(allowed: world, m\)",
        ),
        (
            '<model name="m"><link name="l"><pose relative_to="world"/>{c}</link></model>',
            r"no frame 'world' in 'm' \(allowed: __model__, l\)",
        ),
        ('<frame name="a" attached_to="b"/>', "no frame 'b'"),
        ('<model name="m" placement_frame="x"><link name="l">{c}</link></model>', "no frame 'x' in 'm'"),
        ('<model name="m"><pose>0 0 nan 0 0 0</pose></model>', r"<pose> is not finite: '0 0 nan 0 0 0'"),
        ('<model name="m"><pose>0 0 inf 0 0 0</pose></model>', "<pose> is not finite"),
        ('<model name="m"><pose>0 0 1e9 0 0 0</pose></model>', "<pose> is absurdly large"),
        ('<model name="m"><pose>0 0 0</pose></model>', r"<pose> holds 3 numbers \(allowed: 6 finite numbers\)"),
        ('<model name="m"><pose>0 0 0 a b c</pose></model>', "<pose> is '0 0 0 a b c'"),
        ('<model name="m"><pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose></model>', "has no length"),
        ('<model name="m"><pose rotation_format="axis">0 0 0 0 0 0</pose></model>', "rotation_format 'axis'"),
        ('<model name="m"><pose degrees="maybe">0 0 0 0 0 0</pose></model>', "'maybe'"),
        ("<model><link name='l'/></model>", "<model> has no name"),
    ],
)
def test_impossible_frames_are_refused(tmp_path, body, words):
    path = tmp_path / "w.sdf"
    path.write_text('<sdf version="1.9"><world name="w">' + body.replace("{c}", shape("c")) + "</world></sdf>")
    with pytest.raises(InputError, match=words):
        poses_of(path)


def test_a_name_used_twice_is_warned_about_and_both_are_kept(tmp_path):
    path = tmp_path / "w.sdf"
    one = f'<model name="m"><link name="l">{shape("c")}</link></model>'
    path.write_text(f'<sdf version="1.9"><world name="w">{one}{one}</world></sdf>')
    with pytest.warns(UllageWarning, match=r"w\.sdf:1: the name 'm' is used twice in 'w'"):
        assert set(poses_of(path)) == {"m::l::c", "m_1::l::c"}
