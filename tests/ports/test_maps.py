"""Maps to files and back: map_server, OctoMap, PLY, and what others make of them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from rosbags.highlevel import AnyReader

import ullage as ul
from conftest import some_frames
from ullage.grids import AMBIGUOUS, MappedSurface
from ullage.ports import read_map, write_map
from ullage.ports import schema as ros

tools = pytest.mark.skipif(shutil.which("compare_octrees") is None, reason="octomap-tools are not installed")


def plane(*, z: float = 1.5, seed: int = 0) -> ul.OccupancyMap:
    grid = ul.Grid((-2.0, 0.5, z), 0.05, (30, 47))
    return ul.OccupancyMap(grid, np.random.default_rng(seed).integers(-2, 101, grid.shape).astype(np.int8), "elfes")


def volume(seed: int = 0, *, shape: tuple[int, int, int] = (12, 20, 33), values: int = 101) -> ul.OccupancyMap:
    """Noise, and two blocks of one value that a tree holds in few nodes."""
    grid = ul.Grid((-1.6, -0.8, -0.4), 0.1, shape)
    percent = np.random.default_rng(seed).integers(-2, values, shape).astype(np.int8)
    percent[:4, :8, :16], percent[4:, 8:16] = 5, 95
    return ul.OccupancyMap(grid, percent, "ullage")


def three_states(omap: ul.OccupancyMap) -> np.ndarray:
    return np.where(omap.occupied, 1, np.where(omap.free, 0, -1))


def test_trinary_keeps_the_three_states(tmp_path: Path) -> None:
    want = plane()
    write_map(want, tmp_path / "map.yaml")
    got = read_map(tmp_path / "map.yaml")
    np.testing.assert_array_equal(three_states(got), three_states(want))
    assert got.grid == want.grid
    assert got.method == "elfes"


def test_trinary_is_what_map_server_expects(tmp_path: Path) -> None:
    """Its own law, written out: rows from the top, black occupied, between the thresholds unknown."""
    want = plane()
    write_map(want, tmp_path / "map.pgm")
    about = yaml.safe_load((tmp_path / "map.yaml").read_text())
    pixels = np.asarray(Image.open(tmp_path / about["image"]))
    chance = (255 - pixels[::-1].astype(float)) / 255
    np.testing.assert_array_equal(chance > about["occupied_thresh"], want.occupied)
    np.testing.assert_array_equal(chance < about["free_thresh"], want.free)
    assert (tmp_path / "map.pgm").read_bytes().startswith(b"P5")
    assert about["origin"] == [-2.0, 0.5, 0.0]
    assert about["resolution"] == 0.05
    assert about["negate"] == 0


def test_raw_loses_nothing_but_ambiguity(tmp_path: Path) -> None:
    want = plane(z=float("nan"))
    write_map(want, tmp_path / "map.yaml", mode="raw")
    got = read_map(tmp_path / "map.yaml")
    np.testing.assert_array_equal(got.percent, np.where(want.percent < 0, -1, want.percent))
    assert np.isnan(got.grid.origin_m[2])


def test_scale_keeps_grey_between_the_thresholds(tmp_path: Path) -> None:
    want = plane()
    write_map(want, tmp_path / "map.yaml", mode="scale")
    got = read_map(tmp_path / "map.yaml")
    np.testing.assert_array_equal(got.unknown, want.percent < 0)
    assert (got.percent[want.percent > 65] == 100).all()
    assert (got.percent[(want.percent < 35) & (want.percent >= 0)] == 0).all()
    middle = (want.percent > 36) & (want.percent < 64)
    np.testing.assert_allclose(got.percent[middle], (want.percent[middle] - 35) / 0.3, atol=2.5)


def test_maps_of_others(tmp_path: Path) -> None:
    """As slam_toolbox and gmapping write them: no mode, negate, colours."""
    grey = np.array([[0, 205, 254], [255, 100, 205]], np.uint8)
    Image.fromarray(grey).save(tmp_path / "m.pgm")
    text = "image: m.pgm\nresolution: 0.050000\norigin: [-1.0, 2.5, 0.0]\nnegate: 0\n"
    text += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "m.yaml").write_text(text)
    np.testing.assert_array_equal(read_map(tmp_path / "m.yaml").percent, [[0, -1, -1], [100, -1, 0]])
    (tmp_path / "m.yaml").write_text(text.replace("negate: 0", "negate: 1"))
    np.testing.assert_array_equal(read_map(tmp_path / "m.yaml").percent, [[100, -1, 100], [0, 100, 100]])
    Image.fromarray(np.stack([grey] * 3, axis=-1)).save(tmp_path / "m.png")
    (tmp_path / "m.yaml").write_text(text.replace("pgm", "png"))
    np.testing.assert_array_equal(read_map(tmp_path / "m.yaml").percent, [[0, -1, -1], [100, -1, 0]])


GOOD = {
    "image": "m.pgm",
    "resolution": 0.1,
    "origin": [0, 0, 0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.2,
}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no map"), ("- 1\n", "no map"), (": [", "not YAML"), ("image: [\n", "not YAML"),
        (yaml.dump(GOOD | {"resolution": "wide"}), "resolution is 'wide'"),
        (yaml.dump(GOOD | {"resolution": -1}), "step_m"),
        (yaml.dump(GOOD | {"origin": [0, 0, "x"]}), "origin is "), (yaml.dump(GOOD | {"origin": 3}), "origin is 3"),
        (yaml.dump(GOOD | {"mode": "odd"}), "no mode 'odd'"), (yaml.dump(GOOD | {"free_thresh": 0.9}), "not below"),
        (yaml.dump(GOOD | {"image": "none.pgm"}), "no image"), (yaml.dump(GOOD | {"image": "m.yaml"}), "no image"),
    ],
)  # fmt: skip
def test_bad_maps_are_refused(tmp_path: Path, text: str, words: str) -> None:
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "m.pgm")
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ul.InputError, match=words) as error:
        read_map(tmp_path / "m.yaml")
    assert "\n" not in str(error.value)


GREY = np.kron(np.array([[0, 205, 254], [254, 100, 205], [205, 0, 254]], np.uint8), np.ones((8, 8), np.uint8))
"""What map_server writes, with a grey level of a painter; 8 by 8 pixels each."""


def linear(grey: np.ndarray, gamma: float) -> np.ndarray:
    """Grey levels stored with another gamma than a screen's."""
    return np.rint(255 * (grey / 255) ** (2.2 * gamma)).astype(np.uint8)


def with_gamma(gamma: float) -> bytes:
    return round(gamma * 1e5).to_bytes(4, "big")


def saved_as(kind: str, path: Path) -> Path:
    """The picture of `GREY` as one of many programs saves it."""
    from PIL.PngImagePlugin import PngInfo

    grey, wide, chunk = Image.fromarray(GREY), GREY.astype(np.uint16) * 257, PngInfo()
    clear = Image.fromarray(np.where(GREY == 205, 0, 255).astype(np.uint8))
    painted = Image.merge("LA", (Image.fromarray(np.where(GREY == 205, 254, GREY).astype(np.uint8)), clear))
    name = path / f"m.{kind.rsplit(maxsplit=1)[-1]}"
    match kind.rpartition(" ")[0]:
        case "palette":
            grey.convert("RGB").quantize(8).save(name)
        case "clear palette":
            Image.fromarray(np.where(GREY == 205, 7, GREY).astype(np.uint8)).convert("P").save(name, transparency=7)
        case "grey and alpha":
            painted.save(name)
        case "colours and alpha":
            painted.convert("RGBA").save(name)
        case "half clear":
            half = Image.fromarray(np.where(GREY == 205, 128, 255).astype(np.uint8))
            Image.merge("LA", (painted.getchannel("L"), half)).save(name)
        case "16 bits":
            Image.fromarray(wide).save(name)
        case "16 bits by name":
            name.write_bytes(b"P5 24 24 65535\n" + wide.astype(">u2").tobytes())
        case "gamma ignored":
            chunk.add(b"gAMA", with_gamma(1.0))
            grey.save(name, pnginfo=chunk)
        case "gamma heeded":
            chunk.add(b"gAMA", with_gamma(0.3))
            Image.fromarray(linear(GREY, 0.3)).save(name, pnginfo=chunk)
        case "lossy":
            grey.save(name, quality=30)
        case _:
            grey.save(name)
    return name


EXACT = ["plain pgm", "plain png", "plain bmp", "plain tif", "palette png", "palette gif", "clear palette png",
         "grey and alpha png", "colours and alpha png", "half clear png", "16 bits png", "16 bits tif",
         "16 bits by name pgm"]  # fmt: skip


@pytest.mark.parametrize("kind", [*EXACT, "gamma ignored png", "gamma heeded png", "lossy jpg"])
@pytest.mark.parametrize("free_thresh", [0.196, 0.25])
def test_no_kind_of_image_makes_unknown_cells_free(tmp_path: Path, kind: str, free_thresh: float) -> None:
    about = GOOD | {"image": saved_as(kind, tmp_path).name, "free_thresh": free_thresh}
    (tmp_path / "m.yaml").write_text(yaml.dump(about))
    got, want = read_map(tmp_path / "m.yaml").percent[::-1], np.select([GREY == 0, GREY == 254], [100, 0], -1)
    assert not ((got == 0) & (want != 0)).any()
    assert (got[want == 100] == 100).mean() > 0.9
    assert (got[want == 0] == 0).mean() > 0.9
    if kind in EXACT:
        np.testing.assert_array_equal(got, want)


def test_percent_of_8_bits_in_16_are_not_read_as_free(tmp_path: Path) -> None:
    Image.fromarray(np.array([[0, 50, 100, 255]], np.uint16)).save(tmp_path / "m.png")
    (tmp_path / "m.yaml").write_text(yaml.dump(GOOD | {"image": "m.png", "mode": "raw"}))
    assert read_map(tmp_path / "m.yaml").percent.tolist() == [[0, -1, -1, -1]]


@pytest.mark.parametrize("image", [np.full((2, 2), 0.5, np.float32), np.full((2, 2), 2**24, np.int32)])
def test_pixels_of_unknown_scale_are_refused(tmp_path: Path, image: np.ndarray) -> None:
    Image.fromarray(image).save(tmp_path / "m.tif")
    (tmp_path / "m.yaml").write_text(yaml.dump(GOOD | {"image": "m.tif"}))
    with pytest.raises(ul.InputError, match=r"no image: .*pixels of"):
        read_map(tmp_path / "m.yaml")


def turned(folder: Path, yaw: float) -> ul.OccupancyMap:
    """A room of 60 by 40 cells with walls of one cell, unknown outside, read with its origin turned."""
    grey = np.full((60, 80), 205, np.uint8)
    grey[10:50, 10:70], grey[11:49, 11:69] = 0, 254
    Image.fromarray(grey).save(folder / "m.pgm")
    (folder / "m.yaml").write_text(yaml.dump(GOOD | {"origin": [1.0, -2.0, yaw]}))
    return read_map(folder / "m.yaml")


def test_a_map_turned_by_right_angles_keeps_every_cell(tmp_path: Path) -> None:
    straight = turned(tmp_path, 0.0)
    for quarter in range(-3, 4):
        got = turned(tmp_path, quarter * np.pi / 2)
        np.testing.assert_array_equal(got.percent, np.rot90(straight.percent, -quarter))  # rows from low y
    np.testing.assert_array_equal(turned(tmp_path, 1e-9).percent, straight.percent)


@settings(deadline=None, max_examples=10)
@given(yaw=st.floats(-4, 4))
def test_a_turned_map_is_turned_and_its_walls_stay_closed(tmp_path_factory: pytest.TempPathFactory, yaw: float) -> None:
    from scipy.ndimage import label

    folder = tmp_path_factory.mktemp("turned")
    straight, got = turned(folder, 0.0), turned(folder, yaw)
    cells = np.argwhere(straight.free | straight.occupied)[:, ::-1]
    places = np.array([1.0, -2.0]) + 0.1 * (cells + 0.5) @ np.array(
        [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]
    )
    rows, inside = got.grid.index(places)
    assert inside.all()
    occupied = straight.occupied[cells[:, 1], cells[:, 0]]
    assert got.occupied[tuple(rows.T)][occupied].all()
    assert got.free.sum() == pytest.approx(straight.free.sum(), rel=0.1)
    open_space, _ = label(~got.occupied)
    assert not set(open_space[got.free]) & set(open_space[got.unknown])


def test_numbers_and_truth_as_others_write_them(tmp_path: Path) -> None:
    Image.fromarray(np.array([[0, 205, 254]], np.uint8)).save(tmp_path / "m.pgm")
    text = (
        "image: m.pgm\nresolution: 5e-2\norigin: [-1e1, .5E0, 0.0]\n"
        "negate: {}\noccupied_thresh: 65e-2\nfree_thresh: 0.2\n"
    )
    for negate, percent in (
        ("no", [100, -1, 0]),
        ("false", [100, -1, 0]),
        ("yes", [0, 100, 100]),
        ("1", [0, 100, 100]),
    ):
        (tmp_path / "m.yaml").write_text(text.format(negate))
        got = read_map(tmp_path / "m.yaml")
        assert (got.grid.step_m, got.grid.origin_m[:2]) == (0.05, (-10.0, 0.5))
        assert got.percent.tolist() == [percent]


def test_volumes_and_odd_suffixes_are_refused(tmp_path: Path) -> None:
    for omap, name, options, words in (
        (volume(), "a.yaml", {}, "planes only"), (volume(), "a.xyz", {}, r"not a map file.*\.bt"),
        (plane(), "a.yaml", {"colour": "red"}, r"no option 'colour'.*mode"),
        (plane(), "a.yaml", {"mode": "odd"}, "no mode 'odd'"), (volume(), "nowhere/a.bt", {}, "cannot write"),
    ):  # fmt: skip
        with pytest.raises(ul.InputError, match=words):
            write_map(omap, tmp_path / name, **options)
    for name, words in (("a.xyz", "not a map file"), ("a.bt", "cannot read")):
        with pytest.raises(ul.InputError, match=words):
            read_map(tmp_path / name)


def on_grid(got: ul.OccupancyMap, grid: ul.Grid) -> np.ndarray:
    """What was read, laid over another grid of the same step."""
    out = np.full(grid.shape, -1)
    shift = np.rint((np.array(got.grid.origin_m) - np.array(grid.origin_m)) / grid.step_m).astype(int)[::-1]
    where = tuple(slice(s, s + n) for s, n in zip(shift, got.grid.shape, strict=True))
    out[where] = got.percent
    return out


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 99), shape=st.tuples(*[st.integers(1, 18)] * 3), values=st.sampled_from([0, 3, 101]))
def test_octomap_files_come_back(
    tmp_path_factory: pytest.TempPathFactory, seed: int, shape: tuple[int, int, int], values: int
) -> None:
    folder, want = tmp_path_factory.mktemp("oct"), volume(seed, shape=shape, values=values)
    if (want.percent >= 0).any():
        write_map(want, folder / "a.ot")
        known = np.where(want.percent < 0, -1, want.percent)
        np.testing.assert_array_equal(on_grid(read_map(folder / "a.ot"), want.grid), known)
    if (want.occupied | want.free).any():
        write_map(want, folder / "a.bt")
        states = np.where(want.occupied, 100, np.where(want.free, 0, -1))
        np.testing.assert_array_equal(on_grid(read_map(folder / "a.bt"), want.grid), states)


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_pyoctomap_reads_the_same_cells(tmp_path: Path, suffix: str) -> None:
    pyoctomap = pytest.importorskip("pyoctomap")
    want = volume()
    path = tmp_path / f"a{suffix}"
    write_map(want, path)
    tree = pyoctomap.OcTree(0.1)
    if suffix == ".bt":
        assert tree.readBinary(str(path))
    else:
        tree = tree.read(str(path))
    states = three_states(want)
    for cell in np.random.default_rng(1).integers(0, want.grid.shape, (400, 3)):
        z, y, x = cell
        at = [want.grid.x_m[x], want.grid.y_m[y], want.grid.z_m[z]]
        node = tree.search(at)
        if suffix == ".ot":
            percent = want.percent[z, y, x]
            assert (node is None) == (percent < 0)
            if node is not None:
                assert round(100 * node.getOccupancy()) == percent
        else:
            assert (node is None) == (states[z, y, x] < 0)
            if node is not None:
                assert tree.isNodeOccupied(node) == (states[z, y, x] == 1)


def test_trees_of_pyoctomap_are_read(tmp_path: Path) -> None:
    pyoctomap = pytest.importorskip("pyoctomap")
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    tree = pyoctomap.OcTree(0.1)
    tree.updateNodes(points, True)
    tree.updateInnerOccupancy()
    assert tree.write(str(tmp_path / "a.ot"))
    assert tree.writeBinary(str(tmp_path / "a.bt"))
    for name in ("a.ot", "a.bt"):
        got = read_map(tmp_path / name)
        cells, inside = got.grid.index(points)
        assert inside.all()
        assert got.occupied[tuple(cells.T)].all()
        assert got.occupied.sum() == len(np.unique(cells, axis=0))


@tools
def test_octomap_tools_agree(tmp_path: Path) -> None:
    """Debian's tools count our nodes, convert our trees and find no difference."""
    want = volume()
    write_map(want, tmp_path / "a.ot")
    write_map(want, tmp_path / "a.bt")
    run = lambda *words: subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)  # noqa: E731
    said = run("bt2vrml", "a.bt")
    assert f"Finished writing {int(want.occupied.sum())} voxels" in said.stderr + said.stdout or voxels(tmp_path, want)
    said = run("convert_octree", "a.bt", "b.ot")
    assert "ERROR" not in said.stderr + said.stdout
    np.testing.assert_array_equal(three_states(read_map(tmp_path / "b.ot")), three_states(read_map(tmp_path / "a.bt")))
    said = run("convert_octree", "a.ot", "c.ot")
    assert "ERROR" not in said.stderr + said.stdout
    said = run("compare_octrees", "a.ot", "c.ot")
    assert "KLD: 0" in said.stderr + said.stdout


def voxels(folder: Path, want: ul.OccupancyMap) -> bool:
    """Whether the boxes in the VRML file fill the occupied volume; pruned leaves are one box."""
    import re

    sizes = re.findall(r"size ([\d.]+)", (folder / "a.bt.wrl").read_text())
    return round(sum(float(s) ** 3 for s in sizes) / 1e-3) == int(want.occupied.sum())


def test_trees_are_pruned(tmp_path: Path) -> None:
    grid = ul.Grid((0.0, 0.0, 0.0), 0.1, (64, 64, 64))
    write_map(ul.OccupancyMap(grid, np.zeros(grid.shape, np.int8)), tmp_path / "a.bt")
    assert (tmp_path / "a.bt").stat().st_size < 200
    got = read_map(tmp_path / "a.bt")
    assert got.grid.shape == (64, 64, 64)
    assert (got.percent == 0).all()


def test_planes_become_one_layer(tmp_path: Path) -> None:
    want = plane(z=1.5)
    write_map(want, tmp_path / "a.ot")
    got = read_map(tmp_path / "a.ot")
    assert got.grid.shape[0] == 1
    assert got.grid.origin_m[2] == pytest.approx(1.5)


def test_cells_off_octomaps_lattice_are_said(tmp_path: Path) -> None:
    omap = ul.OccupancyMap(ul.Grid((0.03, 0.0, 0.0), 0.1, (2, 2, 2)), np.full((2, 2, 2), 90, np.int8))
    with pytest.warns(ul.UllageWarning, match=r"shifted by 0\.03 m"):
        write_map(omap, tmp_path / "a.bt")
    far = ul.OccupancyMap(ul.Grid((9e9, 0.0, 0.0), 0.1, (2, 2, 2)), np.full((2, 2, 2), 90, np.int8))
    with pytest.raises(ul.InputError, match="outside OctoMap's world"):
        write_map(far, tmp_path / "a.bt")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not an OctoMap"), (b"P5 hello\ndata\n", "not an OctoMap"),
        (b"# Octomap OcTree file\nid ColorOcTree\nsize 1\nres 0.1\ndata\n", "holds a ColorOcTree"),
        (b"# Octomap OcTree file\nid OcTree\nsize 0\nres 0.1\ndata\n", "empty tree"),
        (b"# Octomap OcTree file\nid OcTree\nsize 9\nres 0.1\ndata\n\0\0", "cut or damaged"),
        (b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n\x02\0", "too many for an array"),
    ],
)  # fmt: skip
def test_bad_trees_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "a.bt").write_bytes(content)
    with pytest.raises(ul.InputError, match=words):
        read_map(tmp_path / "a.bt")


def test_ply_opens_in_trimesh_and_comes_back(tmp_path: Path) -> None:
    import trimesh

    for want in (volume(), plane(), plane(z=float("nan"))):
        write_map(want, tmp_path / "a.ply")
        cloud = trimesh.load(tmp_path / "a.ply")
        assert len(cloud.vertices) == want.occupied.sum()
        got = read_map(tmp_path / "a.ply")
        np.testing.assert_array_equal(got.occupied, want.occupied)
        np.testing.assert_array_equal(got.grid.origin_m, want.grid.origin_m)


def test_ply_normals(tmp_path: Path) -> None:
    want = volume()
    normals = np.random.default_rng(0).normal(size=(int(want.occupied.sum()), 3))
    write_map(want, tmp_path / "a.ply", normals=normals)
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert b"property float nx" in head
    table = np.frombuffer(body, [("p", "<f4", 3), ("n", "<f4", 3), ("o", "u1")])
    np.testing.assert_allclose(table["n"], normals, rtol=1e-6)
    with pytest.raises(ul.InputError, match=r"normals have shape \(1, 3\)"):
        write_map(want, tmp_path / "a.ply", normals=normals[:1])


def test_ply_of_others_needs_a_step(tmp_path: Path) -> None:
    import trimesh

    trimesh.PointCloud([[0.01, 0.02, 0.03], [0.95, 0.5, 0.5]]).export(tmp_path / "a.ply")
    with pytest.raises(ul.InputError, match="how large its cells are"):
        read_map(tmp_path / "a.ply")
    got = read_map(tmp_path / "a.ply", step_m=0.1)
    assert got.occupied.sum() == 2
    (tmp_path / "a.ply").write_bytes(b"ply\nformat odd\nend_header\n")
    with pytest.raises(ul.InputError, match="no PLY"):
        read_map(tmp_path / "a.ply")


def test_map_sinks_keep_the_last_map(tmp_path: Path) -> None:
    with ul.sink(tmp_path / "a.yaml") as sink:
        sink.write(plane(seed=1))
        sink.write(plane(seed=2))
    np.testing.assert_array_equal(three_states(read_map(tmp_path / "a.yaml")), three_states(plane(seed=2)))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.pgm", "a.yaml"]  # nothing temporary stays


def recorded(path: Path, topic: str) -> list[Any]:
    """Messages of a topic of a recording."""
    with AnyReader([path], default_typestore=ros.typestore()) as reader:
        return [reader.deserialize(data, one.msgtype) for one, _, data in reader.messages() if one.topic == topic]


def test_viewers_get_the_known_cells_of_a_plane_map_and_no_unknown_ones(tmp_path: Path) -> None:
    grid = ul.Grid((10.0, 20.0, 1.5), 0.5, (2, 5))
    percent = np.array([[0, 0, -1, 0, 90], [-1, AMBIGUOUS, AMBIGUOUS, -1, -1]], np.int8)
    with ul.sink(tmp_path / "map.mcap") as sink:
        sink.write(some_frames(2))
        sink.write(ul.OccupancyMap(grid, percent))
    drawn = recorded(tmp_path / "map.mcap", "/map/plane")
    free, ambiguous, occupied = drawn[-1].markers
    assert [one.ns for one in drawn[-1].markers] == ["free", "ambiguous", "occupied"]
    corners = np.array([(p.x, p.y, p.z) for p in free.points]).reshape(-1, 6, 3)
    assert corners[:, :, :2].min(axis=1).tolist() == [[10.0, 20.0], [11.5, 20.0]]  # a rectangle for each run of cells
    assert corners[:, :, :2].max(axis=1).tolist() == [[11.0, 20.5], [12.0, 20.5]]
    assert {p.z for p in free.points + ambiguous.points + occupied.points} == {1.5}
    assert len(ambiguous.points) == 6
    assert [(p.x, p.y) for p in occupied.points] == [(12.25, 20.25)]
    assert occupied.scale.x == pytest.approx(2 * grid.step_m)  # two cells wide
    assert occupied.color.a == 1
    assert max(free.color.a, ambiguous.color.a) < 0.3


def a_surface(kind: str, x: float, *, on_map: bool = True) -> MappedSurface:
    """Three specular points of an upright wall that faces -x."""
    points, normals = np.array([[x, 0.0], [x, 0.1], [x, 0.2]]), np.tile([-1.0, 0.0], (3, 1))
    return MappedSurface(kind, np.zeros(2), np.array([x, 0.0, 0.0, 1.0]), np.eye(4), 40.0, 3, on_map, points, normals)


def test_viewers_get_the_surfaces_of_a_plane_map_as_lines_along_them(tmp_path: Path) -> None:
    grid = ul.Grid((0.0, 0.0, 1.5), 0.1, (4, 40))
    surfaces = a_surface("plane", 2.0), a_surface("edge", 3.0, on_map=False), a_surface("slope", 3.5, on_map=False)
    with ul.sink(tmp_path / "map.mcap") as sink:
        sink.write(some_frames(2))
        sink.write(ul.OccupancyMap(grid, np.zeros(grid.shape, np.int8), surfaces=surfaces))
    drawn = recorded(tmp_path / "map.mcap", "/map/surfaces")
    before, *shown = drawn[-1].markers
    assert before.action == 3  # deletes the surfaces of the last message
    assert [(one.ns, one.id) for one in shown] == [("plane", 0), ("slope", 2)]  # the edge is not on the map
    ends = np.array([(p.x, p.y, p.z) for p in shown[0].points]).reshape(3, 2, 3)
    np.testing.assert_allclose(ends[..., 0], 2.0)
    np.testing.assert_allclose(ends.mean(axis=1)[:, 1], [0.0, 0.1, 0.2], atol=1e-9)
    assert set(ends[..., 2].ravel()) == {1.5}


def test_surfaces_of_a_volume_are_two_lines_at_each_point(tmp_path: Path) -> None:
    grid = ul.Grid((0.0, 0.0, 0.0), 0.1, (20, 20, 20))
    points, normals = np.array([[0.5, 0.5, 2.0], [0.9, 0.5, 2.0]]), np.tile([0.0, 0.0, -1.0], (2, 1))
    ceiling = MappedSurface(
        "plane", np.zeros(3), np.array([2.0, 0, 0, 1.0, 0]), np.eye(5), 40.0, 2, True, points, normals
    )  # fmt: skip
    with ul.sink(tmp_path / "map.mcap") as sink:
        sink.write(some_frames(2))
        sink.write(ul.OccupancyMap(grid, np.zeros(grid.shape, np.int8), surfaces=(ceiling,)))
    drawn, *_ = recorded(tmp_path / "map.mcap", "/map/surfaces")
    _, shown = drawn.markers
    ends = np.array([(p.x, p.y, p.z) for p in shown.points]).reshape(4, 2, 3)
    np.testing.assert_allclose(ends[..., 2], 2.0)
    np.testing.assert_allclose(ends.mean(axis=1), np.tile(points, (2, 1)), atol=1e-9)
    along = ends[:, 1] - ends[:, 0]
    np.testing.assert_allclose(np.sum(along[:2] * along[2:], axis=1), 0.0, atol=1e-9)
