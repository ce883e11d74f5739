"""Hostile and damaged input: one line that names the file, within 10 s and 1 GB, and nothing of a file is executed."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ullage as ul
from ullage import ports
from ullage.cli import main
from ullage.errors import DamageWarning, one_line, shown
from ullage.experiments.catalog import find_scenario
from ullage.untrusted import load_yaml, reading, regular_size

HERE = Path(__file__).parent
BROKEN = HERE.parents[1] / "shared" / "data" / "broken"
sys.path.insert(0, str(HERE / "fuzz"))
import readers as fuzzed  # noqa: E402  # the inputs of the fuzzer

HARMLESS = {
    "OverflowError@grids.py:115.m.ply",  # a sound map with one point far outside its grid: a warning
    # all twelve frames are sound; what is damaged is a topic that neither frames nor a map need
    "AnyReaderError@ports_ros2_bags.py:142.b1.bag",
    "CorruptError@ports_ros2_bags.py:137.bagdb.db3",
    "SerdeError@ports_messages.py:124.b1.bag",
    "SerdeError@ports_messages.py:124.bagdb.db3",
}


def read_all(files: list[tuple[str, Path]], tmp_path: Path) -> list[dict[str, Any]]:
    """What a process of its own says of each file, given its reader."""
    done = subprocess.run(
        [sys.executable, str(HERE / "broken.py"), str(tmp_path)], text=True, timeout=200, check=True, cwd=tmp_path,
        input="\n".join(f"{reader}\t{file}" for reader, file in files), capture_output=True,
    )  # fmt: skip
    return [json.loads(line) for line in done.stdout.splitlines()]


def assert_refused(found: dict[str, Any], *, named: bool = True) -> None:
    assert not found["trouble"], found["trouble"]
    assert found["said"], f"{found['file']} is taken"
    assert found["said"].isprintable()
    assert len(found["said"]) < 2000
    if named:
        assert Path(found["file"]).name in found["said"]
    assert found["mb"] < 1000
    assert found["s"] < 10


KINDS = ["map", "octo", "mcapmsg", "bag", "motive", "cli", "sdf", "urdf", "xacro", "scenario"]


def kept_files(kind: str) -> list[Path]:
    return sorted(path for path in (BROKEN / kind).iterdir() if path.is_file())


@pytest.fixture(scope="module")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What one process says of all inputs that once broke a reader."""
    if not BROKEN.is_dir():
        pytest.skip("the inputs that once broke readers are not at hand")
    return read_all([(kind, file) for kind in KINDS for file in kept_files(kind)], tmp_path_factory.mktemp("kept"))


@pytest.mark.parametrize("kind", KINDS)
def test_every_kept_file_that_broke_a_reader_is_refused_in_one_line(kind: str, refusals: list[dict[str, Any]]) -> None:
    found = [one for one in refusals if one["kind"] == kind]
    assert [one["file"] for one in found] == [str(file) for file in kept_files(kind)] != []
    for one in found:
        if Path(one["file"]).name not in HARMLESS:
            assert_refused(one, named=kind != "cli")
        assert not one["trouble"], one["trouble"]


LOOSE = {
    "bomb.yaml": "aliases counted in full", "cyc.yaml": "holds itself", "date1.yaml": "seed is '2001-99-99'",
    "date2.yaml": "seed is '2001-01-01'", "deep.yaml": "nested more than", "nul.yaml": "control characters",
    "rce.yaml": "--trust-xacro", "rce.xacro": "--trust-xacro", "env.xacro": "--trust-xacro",
    "load_yaml.xacro": "--trust-xacro",
}  # fmt: skip


@pytest.mark.parametrize("name", LOOSE)
def test_the_command_refuses_each_loose_file_with_exit_2(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not BROKEN.is_dir():
        pytest.skip("the inputs that once broke readers are not at hand")
    monkeypatch.chdir(tmp_path)
    words = [str(BROKEN / name)]
    if name.endswith(".xacro"):
        (tmp_path / "s.yaml").write_text("flight: {waypoints: [[0, 0, 1], [1, 0, 1]]}")
        words = ["s.yaml", "-o", f"world.file={BROKEN / name}"]
    with pytest.raises(SystemExit, match="2"):
        main(["run", *words])
    said = capsys.readouterr().err
    assert LOOSE[name] in said.strip().splitlines()[-1]
    assert "Traceback" not in said
    assert not list(tmp_path.rglob("xacro_ran_a_command"))


BOMB = "a: &a [x,x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 10)}]\n" for a, b in zip("abcdefg", "bcdefgh", strict=True)
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, r"s\.yaml:5: more than 100000 values"), ("seed: &a [*a]", r"s\.yaml:1: \*a holds itself"),
        ("title: x\nseed: 2001-99-99", r"s\.yaml:2: seed is '2001-99-99'"),
        ("seed: 2001-01-01", "seed is '2001-01-01'"),
        ("seed: " + "[" * 5000, "nested more than 50 deep"),
        ("seed: " + "[" * 60 + "]" * 60, "nested more than 50 deep"),
        ("title: a\nseed: 1\0", r"s\.yaml:2: not YAML: control characters"), ("seed: \x1b[31m", "control characters"),
        ("seed: " + "1" * 5000, r"s\.yaml:1: an integer of 5000 digits"),
        ("seed: 0x" + "1" * 5000, "an integer of 5002"),
        ("seed: !!python/object/apply:os.system [touch ran]", "the tag 'tag:yaml.org,2002:python"),
        ("seed: !!binary aGk=", "the tag"), ("{" * 3, "not YAML"), ("a: [1, 2", "not YAML"), ("- 1", "not a scenario"),
        ("sensing: {changes: {self: 1}}", "no such setting"), ("sensing: {changes: {name: 100}}", "name is 100"),
        ("? [a, b]\n: 1", "not YAML"), ("x: " + "y" * 1_000_001, "are too many"), ("seed: 0b_", "seed is|not YAML"),
    ],
)  # fmt: skip
def test_hostile_yaml_is_refused_in_one_line(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(ul.InputError, match=words) as caught:
        find_scenario(str(tmp_path / "s.yaml"))
    assert str(caught.value).isprintable()
    assert "s.yaml" in str(caught.value)


def test_aliases_dates_and_long_numbers_within_bounds_are_taken() -> None:
    tree = load_yaml("a: &a [1, 2]\nb: [*a, *a]\nc: 2001-01-01\nd: " + "7" * 60, where="text")
    assert tree == {"a": [1, 2], "b": [[1, 2], [1, 2]], "c": "2001-01-01", "d": int("7" * 60)}


@pytest.mark.parametrize(
    "option",
    [
        "map.step_m=" + "1" * 5000,
        "sensing.changes={bins: 0x" + "1" * 5000 + "}",
        "seed=!!set {}",
        "expect.min={0: null}",  # a name that is no text
    ],
)
def test_hostile_options_are_refused_in_one_line(option: str) -> None:
    with pytest.raises(ul.InputError, match="-o") as caught:
        find_scenario("cargo-hold", options=[option])
    assert len(str(caught.value)) < 1500


def test_what_a_reader_raises_becomes_one_line_with_file_and_place() -> None:
    raised: list[Exception] = [
        ValueError("a\nb\x1b[0m"), IndexError(), struct.error("x"), MemoryError(), RecursionError(),
        OverflowError("big"), UnicodeDecodeError("utf-8", b"a\xff", 1, 2, "bad"), OSError(5, "Input/output error"),
        KeyError("k"), zlib.error("z"),
    ]  # fmt: skip
    for error in raised:
        with (
            pytest.raises(ul.InputError, match=r"^a\.bin: cannot be read at message 3: ") as caught,
            reading("a.bin", place=lambda: "message 3"),
        ):
            raise error
        assert str(caught.value).isprintable()
        assert caught.value.__cause__ is error  # --debug shows it
    with pytest.raises(ul.InputError, match=r"a\.bin: Grid: step_m is -1"), reading("a.bin"):
        ul.Grid((0, 0, 0), -1, (2, 2))
    with pytest.raises(ImportError), reading("a.bin"):
        raise ImportError("not a matter of the file")


def test_messages_stay_on_one_line_however_long_their_values_are() -> None:
    assert one_line("a\nb\x1b[31m\tc") == "a b\\x1b[31m c"
    assert len(one_line("x" * 100_000)) < 1300
    assert shown(10**5000) == "<int>"
    assert len(shown("y" * 1000)) < 100


@pytest.mark.parametrize(
    ("name", "read"),
    [
        *((name, ports.open) for name in ("a.mcap", "a.bag", "a.db3", "a.dat", "a.lsf", "a.lsf.gz")),
        *((name, ports.read_map) for name in ("m.yaml", "m.bt", "m.ot", "m.ply")),
        *((name, ul.load_scene) for name in ("w.sdf", "w.urdf", "w.xacro", "w.stl", "w.ply", "w.glb")),
        ("s.yaml", find_scenario), ("run/frames.mcap", lambda path: ports.open(Path(path).parent)),
        ("rail/radar.out", lambda path: ports.open(Path(path).parent)),
        ("a.zarr/zarr.json", lambda path: ports.open(Path(path).parent)),
    ],
)  # fmt: skip
def test_pipes_are_refused_before_they_are_opened(name: str, read: Callable[[str], object], tmp_path: Path) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)
    with pytest.raises(ul.InputError, match=r"is a pipe"):
        read(str(path))


def test_devices_and_links_to_them_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").symlink_to("/dev/zero")
    with pytest.raises(ul.InputError, match="is a device"):
        ports.open(tmp_path / "a.mcap")
    with pytest.raises(ul.InputError, match="is a folder"):
        regular_size(tmp_path)


HUGE = 200 * 2**30
PLY = "ply\nformat {}\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
NOTE = 'comment ullage grid {"origin_m": [0, 0, 0], "step_m": 0.1, "shape": [90000, 90000, 27], "method": "x"}\n'
MAP = b"image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"


FAR = b"\3\xc0" + 14 * b"\3\0" + b"\2\0" + 14 * b"\0\xc0" + b"\0\x80"  # two cells in opposite corners
TREE = b"# Octomap OcTree binary file\nid OcTree\nsize 33\nres 0.1\ndata\n" + FAR
CHANCES = b"# Octomap OcTree file\nid OcTree\nsize 99999999999\nres 0.1\ndata\n\0\0\0\0\1"
POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n"
GLTF = b'{"asset":{"version":"2.0"},"accessors":[{"count":90000000000,"componentType":5126,"type":"MAT4"}]}'
MANY = PLY.format("binary_little_endian 1.0", HUGE // 12).encode()
WIDE = PLY.format("ascii 1.0", 1).replace("element", NOTE + "element", 1).encode() + b"0 0 0\n"


PROMISES = [
    *(("read_map", files, words) for files, words in (
        ({"m.ply": MANY}, "element vertex"),
        ({"m.ply": PLY.format("ascii 1.0", 900).encode() + b"1 " * 500}, "promises"),
        ({"m.ply": WIDE}, "cells are too many"),
        ({"m.yaml": MAP, "m.pgm": b"P5\n450000 450000\n255\n\0\0"}, "pixels are too many"),
        ({"m.yaml": MAP, "m.pgm": b"P5\n12000 12000\n255\n\0\0"}, "pixels are too many"),
        ({"m.yaml": MAP, "m.pgm": b"P5\n9000 9000\n255\n\0\0"}, "no image"),
        ({"m.yaml": MAP, "m.pgm": POSTSCRIPT}, "no image"),
        ({"m.yaml": MAP.replace(b"m.pgm", b"../../m.pgm")}, "reaches out of the map's folder"),
        ({"m.yaml": MAP.replace(b"m.pgm", b"/etc/passwd")}, "reaches out of the map's folder"),
        ({"m.ot": CHANCES}, "cut or damaged"),
        ({"m.bt": TREE}, "cells are too many"),
    )),
    ("sdf", {"m.ply": MANY}, "element vertex"),
    ("sdf", {"m.gltf": GLTF}, "accessors without data"),
]  # fmt: skip


def test_headers_that_promise_200_gib_are_refused(tmp_path: Path) -> None:
    inputs = []
    for number, (reader, files, _) in enumerate(PROMISES):
        home = tmp_path / str(number)
        home.mkdir()
        for name, data in files.items():
            (home / name).write_bytes(data)
        inputs.append((reader, home / next(iter(files))))
    for found, (_, _, words) in zip(read_all(inputs, tmp_path), PROMISES, strict=True):
        assert_refused(found, named=False)
        assert words in found["said"]


def test_a_chunk_that_unpacks_to_more_than_it_promises_is_left_out(tmp_path: Path) -> None:
    import zstandard

    from ullage.ports.replay import MOST_CHUNK_BYTES, unpacked

    bomb = zstandard.compress(bytes(50_000_000))
    with pytest.raises(ValueError, match="does not hold"):
        unpacked(bomb, "zstd", 1000)
    with pytest.raises(ValueError, match="a chunk of"):
        unpacked(bomb, "zstd", MOST_CHUNK_BYTES + 1)
    assert len(unpacked(bomb, "zstd", 50_000_000)) == 50_000_000


@pytest.fixture(scope="module")
def blob(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The messages of a recording of ours."""
    return fuzzed.READER["mcap-messages"].seeds(tmp_path_factory.mktemp("seed"))[0]


def damaged(blob: bytes, kind: str, change: Callable[[bytearray], None], tmp_path: Path) -> Path:
    """A recording with sound checksums whose messages of one kind are changed."""
    out = b""
    for name, topic, data in fuzzed.unrolled(blob):
        if kind == "OccupancyGrid" and name.endswith("CellMap"):
            continue  # which would be read in its place
        new = bytearray(data)
        if name.endswith(f"/{kind}"):
            change(new)
        head = f"{name} {topic}".encode()
        out += struct.pack("<HI", len(head), len(new)) + head + bytes(new)
    path = tmp_path / "a.mcap"
    path.write_bytes(fuzzed.mcap_of(out))
    return path


def refused(work: Callable[[], object], *words: str) -> bool:
    """Whether it is refused, or its damaged messages are reported, in one line with these words."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DamageWarning)
            work()
    except (ul.InputError, DamageWarning) as error:
        return str(error).isprintable() and all(word in str(error) for word in words)
    return False


@pytest.mark.parametrize("name", ["RadarFrame", "RadarSettings", "CellMap", "OccupancyGrid", "Odometry"])
def test_sound_checksums_over_damaged_messages(name: str, blob: bytes, tmp_path: Path) -> None:
    rng, count = np.random.default_rng(5), 0

    def change(data: bytearray) -> None:
        for at in rng.integers(4, len(data), 3):
            data[at] = rng.choice([0, 0xFF, 0x7F, 0x80])
        if rng.random() < 0.3:
            del data[rng.integers(4, len(data)) :]

    for number in range(25):
        (tmp_path / str(number)).mkdir()
        source = ports.open(damaged(blob, name, change, tmp_path / str(number)))
        count += sum(refused(part, "a.mcap") for part in (source.frames, source.trajectory, source.map))
    assert count > 3  # the others are damaged where any value will do


def test_percent_out_of_range_is_refused(blob: bytes, tmp_path: Path) -> None:
    def worse(data: bytearray) -> None:
        data[-3] = 130

    path = damaged(blob, "CellMap", worse, tmp_path)
    with pytest.raises(ul.InputError, match=r"a\.mcap: record \d+: OccupancyMap: cells from -126 to"):
        ports.open(path).map()
    with pytest.raises(ul.InputError, match="cells from -3 to 101"):
        ul.OccupancyMap(ul.Grid((0, 0, 0), 1, (1, 2)), np.array([[-3, 101]], np.int8))


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning", "ignore::RuntimeWarning")
@pytest.mark.parametrize("name", fuzzed.READER)
def test_every_reader_refuses_damage_in_one_line(name: str, tmp_path: Path) -> None:
    """A few inputs of the kind that `make fuzz` tries by the million."""
    reader, rng = fuzzed.READER[name], np.random.default_rng(7)
    (tmp_path / "seeds").mkdir()
    (tmp_path / "work").mkdir()
    seeds = reader.seeds(tmp_path / "seeds")
    if not seeds:
        pytest.skip("needs the real recordings")
    reader.before(tmp_path / "work")
    lines = []
    for number in range(12):
        data = bytearray(seeds[number % len(seeds)][: fuzzed.LARGEST])
        for at in rng.integers(0, len(data), number):
            data[at] = rng.integers(0, 256)
        if number > 8:
            del data[rng.integers(0, len(data)) :]
        lines.append(fuzzed.read_one(reader, bytes(data), tmp_path / "work"))
    assert not lines[0]  # it has no damage
    assert fuzzed.read_one(reader, rng.bytes(500), tmp_path / "work")  # it is nothing but damage


WORLD = '<sdf version="1.9"><model name="m"><link name="l"><collision name="c"><geometry><sphere><radius>1</radius></sphere></geometry></collision></link></model></sdf>'  # noqa: E501


def scenario_in(folder: Path, text: str) -> str:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "s.yaml").write_text(text)
    return str(folder / "s.yaml")


def test_a_scenario_names_files_within_its_search_path_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "secret.sdf").write_text(WORLD)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    home = tmp_path / "scenarios"
    for field, text in (
        ("world.file", "world: {file: ../secret.sdf}"),
        ("world.file", f"world: {{file: {tmp_path / 'secret.sdf'}}}"),
        ("world.search_path", "world: {file: w.sdf, search_path: [/]}"),
        ("sensing.changes.antenna.file", "sensing: {changes: {antenna: {kind: table, file: /etc/passwd}}}"),
    ):
        with pytest.raises(ul.InputError, match=rf"s\.yaml: {field} .* reaches out of the search path.*-o {field}="):
            find_scenario(scenario_in(home, text))
    path = scenario_in(home, "world: {file: ../secret.sdf}")
    named = find_scenario(path, options=[f"world.file={tmp_path / 'secret.sdf'}"])
    assert named.world.file == str(tmp_path / "secret.sdf")
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path))
    assert find_scenario(path).world.file.endswith("secret.sdf")


def test_a_scenario_finds_the_world_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "scenarios"
    path = scenario_in(home, "world: {file: w.sdf}")
    (home / "w.sdf").write_text(WORLD)
    monkeypatch.chdir(tmp_path)
    assert Path(find_scenario(path).world.file).resolve() == home / "w.sdf"
    monkeypatch.chdir(home)
    assert find_scenario("s.yaml").world.file == "w.sdf"  # settings, and so the run's name, stay as they are written


def test_a_world_that_leads_to_xacro_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = scenario_in(tmp_path, "world: {file: r.xacro}\nflight: {waypoints: [[0, 0, 1], [1, 0, 1]]}")
    (tmp_path / "r.xacro").write_text("<robot name='r'><link name='l'/></robot>")
    with pytest.raises(SystemExit, match="2"):
        main(["run", path])
    assert "--trust-xacro" in capsys.readouterr().err.strip().splitlines()[-1]


def test_a_packed_log_that_grows_without_measure_is_refused(tmp_path: Path) -> None:
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    with (tmp_path / "a.lsf.gz").open("wb") as out:
        for _ in range(80):
            out.write(packer.compress(bytes(2**20)))
        out.write(packer.flush())
    with pytest.raises(ul.InputError, match=r"a\.lsf\.gz: unpacks to over"):
        ports.open(tmp_path / "a.lsf.gz").frames()


def test_a_store_that_promises_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    (tmp_path / "seed").mkdir()
    with ul.sink(tmp_path / "a.zarr") as sink:
        sink.write(fuzzed.plane())
        sink.write(fuzzed.small_frames())
    note = tmp_path / "a.zarr" / "front" / "samples" / "zarr.json"
    tree = json.loads(note.read_text())
    tree["shape"][0] = 10**10
    note.write_text(json.dumps(tree))
    with pytest.raises(ul.InputError, match=r"a\.zarr: samples promises \d+ bytes and holds"):
        ports.open(tmp_path / "a.zarr").frames()
