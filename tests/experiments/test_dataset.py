"""Training sets: sample k is the same however the set is made, others read it, and nothing is lost to a kill."""

from __future__ import annotations

import fcntl
import json
import re
import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app
from ullage.experiments.dataset import read_index

# imported by the tests that use them: every worker collects this file
LIBRARIES = ("xarray", "zarr", "pyarrow")
pytestmark = pytest.mark.skipif(not all(map(find_spec, LIBRARIES)), reason="needs xarray, zarr and pyarrow")

SMALL = {"frames": 4, "where": 1}


@pytest.fixture(scope="module")
def ten(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten samples, made in one go in this process."""
    return ul.dataset(["room", "polygon"], tmp_path_factory.mktemp("ten") / "ten.zarr", n=10, **SMALL)


def yard() -> str:
    """A world file: four walls and a floor."""
    boxes = {"floor": "0 0 -0.05 8 6 0.1", "north": "0 3 1.5 8 0.1 3", "south": "0 -3 1.5 8 0.1 3",
             "east": "4 0 1.5 0.1 6 3", "west": "-4 0 1.5 0.1 6 3"}  # fmt: skip
    models = ""
    for name, words in boxes.items():
        x, y, z, *size = words.split()
        shape = f"<box><size>{' '.join(size)}</size></box>"
        models += (f'<model name="{name}"><static>true</static><pose>{x} {y} {z} 0 0 0</pose><link name="link">'
                   f'<collision name="c"><geometry>{shape}</geometry></collision></link></model>')  # fmt: skip
    return f'<?xml version="1.0"?><sdf version="1.9"><world name="yard">{models}</world></sdf>'


def arrays(path: Path) -> dict[str, np.ndarray]:
    import zarr

    return {name: one[...] for name, one in zarr.open_group(str(path), mode="r").arrays()}


def same(one: Path, other: Path) -> bool:
    mine, theirs = arrays(one), arrays(other)
    return mine.keys() == theirs.keys() and all(mine[name].tobytes() == theirs[name].tobytes() for name in mine)


def test_a_set_that_is_lengthened_holds_what_one_made_at_once_holds(ten: Path, tmp_path: Path) -> None:
    for n in (3, 9, 5, 10):
        path = ul.dataset(["room", "polygon"], tmp_path / "set.zarr", n=n, **SMALL)
        assert len(read_index(path)) == max(n, 9 if n == 5 else 0)
    assert same(path, ten)
    assert read_index(path) == read_index(ten)


def test_what_is_there_is_not_made_again(ten: Path) -> None:
    before = {file: file.stat().st_mtime_ns for file in ten.rglob("*") if file.is_file()}
    seen: list[tuple[int, int]] = []
    ul.dataset(["room", "polygon"], ten, n=10, **SMALL, progress=lambda done, n, text: seen.append((done, n)))
    assert seen == [(10, 10)]
    assert {file: file.stat().st_mtime_ns for file in ten.rglob("*") if file.is_file()} == before


def test_other_seeds_give_other_samples(ten: Path, tmp_path: Path) -> None:
    path = ul.dataset("room", tmp_path / "set.zarr", n=2, seed=1, **SMALL)
    rows = [*read_index(path), *read_index(ten)]
    assert len({row["world_seed"] for row in rows}) == len({row["noise_seed"] for row in rows}) == 12


def test_xarray_reads_the_set_lazily_with_named_axes(ten: Path) -> None:
    import xarray

    with xarray.open_zarr(ten, chunks=None) as found:
        assert dict(found.sizes) | {"sample": 10, "sensor": 4, "frame": 4, "bin": 188, "y": 128, "x": 128} == dict(
            found.sizes
        )
        assert found["samples"].dims == ("sample", "sensor", "frame", "bin")
        assert found["samples"].dtype == np.complex64
        np.testing.assert_array_equal(found["samples"][7].values, arrays(ten)["samples"][7])
    assert json.loads((ten / "zarr.json").read_text())["consolidated_metadata"]["metadata"].keys() >= {"samples"}


def test_the_index_is_a_parquet_table(ten: Path) -> None:
    from pyarrow.parquet import read_table

    found = read_table(ten / "index").to_pylist()
    assert sorted(row["k"] for row in found) == list(range(10))
    assert {row["kind"] for row in found} == {"room", "polygon"}
    assert all(row["failed"] == "" and row["version"] == ul.__version__ for row in found)


def test_a_sample_can_be_made_again_from_its_row(ten: Path) -> None:
    """The row names everything that was drawn, so that frames without noise follow from it."""
    row, k = read_index(ten)[3], 3
    scene = ul.worlds.random(row["kind"], row["world_seed"])
    first = row["first_frame"]
    flown = ul.worlds.flight(row["kind"], row["world_seed"])[first : first + 4]
    whole = arrays(ten)
    np.testing.assert_array_equal(whole["true_position_m"][k], flown.position)
    frames = ul.simulate(scene, flown, ul.worlds.rig(row["kind"], row["world_seed"]), seed=row["noise_seed"])
    for number, name in enumerate(("front", "left", "back", "right")):
        strong = np.abs(frames[name].samples)
        near = np.abs(whole["samples"][k, number])
        assert np.corrcoef(strong.ravel(), near.ravel())[0, 1] > 0.99


def test_labels_say_where_echoes_come_from(ten: Path) -> None:
    whole = arrays(ten)
    for k, row in enumerate(read_index(ten)):
        objects = whole["echo_object"][k]
        known = objects >= 0
        assert known.any()
        assert objects.max() < len(row["objects"]) == len(row["materials"])
        assert (whole["echo_bounces"][k][known] == 1).all()
        place = whole["true_position_m"][k].mean(0)
        away = np.linalg.norm(whole["echo_point_m"][k][known] - place, axis=1)
        np.testing.assert_allclose(whole["echo_range_m"][k][known], away, atol=0.35)  # sensors lie 0.1 m from the body


def test_truth_holds_surfaces_and_free_space_about_the_track(ten: Path) -> None:
    whole = arrays(ten)
    for k in range(10):
        patch, origin = whole["occupancy"][k], whole["patch_origin_m"][k]
        cell = np.floor((whole["true_position_m"][k, :, :2] - origin) / 0.1).astype(int)
        assert (patch[cell[:, 1], cell[:, 0]] == 1).all()
        ends = whole["surfaces_m"][k].reshape(-1, 2)
        cell = np.floor((ends[np.isfinite(ends).all(1)] - origin) / 0.1).astype(int)
        cell = cell[((cell > 0) & (cell < 127)).all(1)]
        around = [patch[y - 1 : y + 2, x - 1 : x + 2].max() for x, y in cell]
        assert around
        assert min(around) == 2


def test_the_card_describes_every_array(ten: Path) -> None:
    card = ten.with_suffix(".md").read_text()
    listed = set(re.findall(r"^\| `(\w+)`", card, re.M))
    assert listed == set(arrays(ten)) - {"range_m", "body_from_sensor"}
    assert "Licence" in card
    assert "Limits" in card


def test_a_world_file_is_varied_and_its_changes_are_noticed(tmp_path: Path) -> None:
    world = tmp_path / "mine.sdf"
    world.write_text(yard())
    path = ul.dataset(str(world), tmp_path / "set.zarr", n=2, **SMALL)
    one, other = read_index(path)
    assert one["kind"] == "mine.sdf"
    assert (one["objects"], one["materials"]) != (other["objects"], other["materials"])
    world.write_text(world.read_text() + "<!-- changed -->\n")
    with pytest.raises(ul.InputError, match="the data set has digests"):
        ul.dataset(str(world), path, n=3, **SMALL)


def test_a_sample_that_cannot_be_made_is_a_row_with_its_reason(tmp_path: Path) -> None:
    path = ul.dataset("room", tmp_path / "set.zarr", n=2, frames=4096, where=1)
    rows = read_index(path)
    assert [row["k"] for row in rows] == [0, 1]
    assert all("the flight has" in row["failed"] for row in rows)
    assert np.isnan(arrays(path)["true_position_m"]).all()


@pytest.mark.parametrize(
    ("kinds", "changes", "words"),
    [
        ("rom", {}, "no kind of world 'rom'; did you mean 'room'"),
        ("/no/such/world.sdf", {}, "no kind of world"),
        ((), {}, "no kind of world .*tuning, testing, all"),
        ("room", {"n": 0}, "n is 0 .*1 sample or more"),
        ("room", {"n": -1}, "n is -1"),
        ("room", {"frames": 1}, "1 frames .*2 to 4096"),
        ("room", {"bounces": (7,)}, r"bounces are \(7,\) .*1 to 6"),
        ("room", {"bounces": ()}, "bounces are"),
        ("room", {"seed": -1}, "seed is -1"),
    ],
)
def test_what_cannot_be_made_is_one_line_and_leaves_nothing(kinds, changes, words, tmp_path: Path) -> None:
    with pytest.raises(ul.InputError, match=words):
        ul.dataset(kinds, tmp_path / "set.zarr", **({"n": 2, "where": 1} | changes))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ["room", "--n", "0"],
        ["rom", "--n", "1"],
        *(["room", "--n", "1", "--bounces", text] for text in ("x", "0", "1,7")),
    ],
)
def test_the_command_refuses_as_the_function_does(words: list[str], tmp_path: Path) -> None:
    told = CliRunner().invoke(app, ["dataset", *words, "--to", str(tmp_path / "set.zarr"), "--jobs", "1"])
    assert isinstance(told.exception, ul.InputError)


def test_the_command_counts_and_names_what_it_made(tmp_path: Path) -> None:
    words = ["dataset", "room", "--n", "1", "--frames", "4", "--to", str(tmp_path / "set.zarr"), "--jobs", "1"]
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 0, told.output
    assert "1 samples in" in told.output


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seed": 3}, "the data set has seed 0, not 3 .*a new name"),
        ({"frames": 5}, "the data set has frames 4, not 5"),
        ({"bounces": (1, 2)}, r"the data set has bounces \(1,\), not \(1, 2\)"),
    ],
)
def test_a_set_with_other_settings_is_not_added_to(changes, words, ten: Path) -> None:
    with pytest.raises(ul.InputError, match=words):
        ul.dataset(["room", "polygon"], ten, n=12, **(SMALL | changes))


def changed(path: Path, **values: object) -> None:
    """Write other values into the set's own description, as another version of ullage would have."""
    file = path / "zarr.json"
    tree = json.loads(file.read_text())
    about = json.loads(tree["attributes"]["ullage_dataset"])
    tree["attributes"]["ullage_dataset"] = json.dumps(about | values)
    file.write_text(json.dumps(tree))


def test_sets_of_another_version_are_refused_with_both_versions(ten: Path, tmp_path: Path) -> None:
    path = tmp_path / "set.zarr"
    shutil.copytree(ten, path)
    changed(path, version="0.0.9")
    with pytest.raises(ul.InputError, match=rf"the data set has version 0\.0\.9, not {ul.__version__}"):
        ul.dataset(["room", "polygon"], path, n=12, **SMALL)
    changed(path, format=99)
    with pytest.raises(ul.InputError, match=rf"format 99, made by ullage 0\.0\.9 .*ullage {ul.__version__} makes"):
        ul.dataset(["room", "polygon"], path, n=12, **SMALL)


def test_a_folder_or_file_that_is_no_data_set_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "letters").mkdir()
    (tmp_path / "letter").write_text("dear reader")
    import zarr

    zarr.create_group(str(tmp_path / "other.zarr"))
    for name in ("letters", "letter", "other.zarr"):
        with pytest.raises(ul.InputError, match=f"{name}: no ullage data set"):
            ul.dataset("room", tmp_path / name, n=1, **SMALL)
    with pytest.raises(ul.InputError, match="no ullage data set"):
        read_index(tmp_path / "absent")
    assert (tmp_path / "letter").read_text() == "dear reader"


def test_a_damaged_index_is_named(ten: Path, tmp_path: Path) -> None:
    path = tmp_path / "set.zarr"
    shutil.copytree(ten, path)
    (path / "index" / "000000008.parquet").write_bytes(b"PAR1 no more")
    with pytest.raises(ul.InputError, match=r"000000008\.parquet: cannot read.*delete it to make it again"):
        ul.dataset(["room", "polygon"], path, n=10, **SMALL)
    (path / "index" / "000000008.parquet").unlink()
    assert same(ul.dataset(["room", "polygon"], path, n=10, **SMALL), ten)


def test_a_second_writer_is_refused(ten: Path) -> None:
    with ten.with_name(f".{ten.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(ul.InputError, match=r"ten\.zarr: another process writes to it .*one writer at a time"):
            ul.dataset(["room", "polygon"], ten, n=12, **SMALL)
    assert len(read_index(ten)) == 10


@pytest.mark.parametrize("page", ["datasets.md", "sweeps.md"])
def test_the_blocks_of_the_docs_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (Path(__file__).parents[2] / "docs" / page).read_text(encoding="utf-8")
    if page == "sweeps.md":
        (tmp_path / "sweep").mkdir()
        lines = ("run,map.step_m,navigation.noise_m,seed,f1,failed", "a,0.1,0,7,0.5,", "b,0.1,0,8,,world: no such wall")
        (tmp_path / "sweep" / "sweep.csv").write_text("\n".join(lines))
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    assert blocks
    for block in blocks:
        exec(compile(block, page, "exec"), names)
