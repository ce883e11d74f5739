"""Logs: written and read back, read by other people's readers, and damaged ones."""

from __future__ import annotations

import gzip
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from imc_bus import estimated_state, packed, text
from test_imc_codec import one_of_each

import ullage as ul
from conftest import assert_same, some_frames
from ullage.errors import InputError, UllageWarning
from ullage.ports.imc.codec import encode
from ullage.ports.imc.table import from_xml, own, shared, to_xml


def flight(n: int = 60) -> bytes:
    """A log packed by hand: one vehicle, and another that is heard now and then."""
    log = packed(102, b"\x01" + text(b"20260101/120000"), t_s=1.7e9)
    for k in range(n):
        log += estimated_state(1.7e9 + k / 20, 0.5 * k / 20, 0, -2, 0.0)
        if k % 10 == 0:
            log += estimated_state(1.7e9 + k / 20 + 0.01, 99, 99, 0, 0, src=0x0999)
    return log


@pytest.mark.parametrize("name", ["Data.lsf", "Data.lsf.gz"])
def test_the_flight_of_whoever_logged_is_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(gzip.compress(flight()) if name.endswith("gz") else flight())
    source = ul.open(path)
    flown = source.trajectory()
    assert flown is not None
    assert len(flown) == 60
    assert np.allclose(flown.position[:, 1], 0.5 * np.arange(60) / 20, atol=1e-6)
    assert np.allclose(flown.position[:, [0, 2]], [0, 2], atol=1e-6)
    assert source.sensors == ()
    with pytest.raises(InputError, match=r"no radar frames.*DevDataBinary"):
        source.frames()
    other = ul.open(path, vehicle="0x0999").trajectory()
    assert other is not None
    assert len(other) == 6


@pytest.mark.parametrize("name", ["Data.lsf", "Data.lsf.gz"])
def test_frames_come_back_to_the_last_bit(tmp_path: Path, name: str) -> None:
    frames = {s: some_frames(seed=k, sensor=s, real=s == "left") for k, s in enumerate(("front", "left"))}
    with ul.sink(tmp_path / name) as sink:
        for start in range(0, 40, 16):
            sink.write({key: part[start : start + 16] for key, part in frames.items()})
    got = ul.open(tmp_path / name).frames()
    assert isinstance(got, dict)
    assert set(got) == {"front", "left"}
    for key, part in frames.items():
        assert_same(got[key], part)


def test_the_body_is_told_as_believed_and_as_it_was(tmp_path: Path) -> None:
    rig = ul.Rig.preset("thesis-4")
    path = ul.Trajectory.line((-1, 0, 0.5), (-0.5, 0.3, 0.5), 0.5, 25, yaw_deg=30)
    believed = ul.navigate(path, drift_m=0.1, seed=3)
    frames = ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, rig, fidelity="thesis", believed=believed)
    with ul.sink(tmp_path / "Data.lsf") as sink:
        sink.write(frames)
        sink.write(path)  # is known already
    source = ul.open(tmp_path / "Data.lsf")
    for state, want in (("EstimatedState", believed), ("SimulatedState", path)):
        got = ul.open(tmp_path / "Data.lsf", state=state).trajectory()
        assert len(got) == len(path)
        assert np.allclose(got.position, want.position, atol=1e-6)
        assert np.allclose(np.abs((got.quat_xyzw * want.quat_xyzw).sum(1)), 1, atol=1e-6)
        assert np.allclose(got.rates[0], want.rates[0], atol=1e-6)
        assert np.allclose(got.rates[1], want.rates[1], atol=1e-6)
    assert source.sensors == ("front", "left", "back", "right")
    with pytest.raises(InputError, match="exists already"):
        ul.sink(tmp_path / "Data.lsf")


def test_profiles_alone_make_frames_without_phase(tmp_path: Path) -> None:
    path = ul.Trajectory.line((-1, 0, 0), (0, 0, 0), 0.5, 25)
    radar = ul.Rig.preset("thesis-4")
    frames = ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, radar, fidelity="thesis")
    with ul.sink(tmp_path / "Data.lsf", exact="false", profile="true") as sink:
        sink.write(frames)
    with pytest.warns(UllageWarning, match="without phase"):
        got = ul.open(tmp_path / "Data.lsf").frames()
    assert set(got) == set(frames)
    for name, part in frames.items():
        there = got[name]
        assert there.unit == "normalised"
        assert np.allclose(there.poses.position, part.poses.position[: len(there)], atol=1e-5)
        assert np.allclose(np.abs((there.poses.quat_xyzw * part.poses.quat_xyzw[: len(there)]).sum(1)), 1, atol=1e-6)
        hits, want = ul.detect(there, threshold=0.038), ul.detect(part, threshold=0.038)
        assert np.median(hits.range_m) == pytest.approx(np.median(want.range_m), abs=part.spec.bin_m)


def test_a_cut_and_damaged_log_gives_what_can_be_read(tmp_path: Path) -> None:
    whole = gzip.compress(flight())
    path = tmp_path / "Data.lsf.gz"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.warns(UllageWarning, match=r"Data.lsf.gz: .*all that can be read is used"):
        flown = ul.open(path).trajectory()
    assert 20 < len(flown) < 60
    hurt = bytearray(flight())
    hurt[1000:1100] = b"\xfe\x54" * 50
    (tmp_path / "Data.lsf").write_bytes(hurt)
    with pytest.warns(UllageWarning, match="belong to no whole packet"):
        assert 55 <= len(ul.open(tmp_path / "Data.lsf").trajectory()) < 60


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no packet of IMC"),
        (b"\x1f\x8bnonsense", "no packet of IMC"),
        (bytes(range(256)) * 40, "no packet of IMC"),
    ],
)
def test_what_is_no_log_is_said(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "Data.lsf").write_bytes(data)
    with pytest.raises(InputError, match=words):
        ul.open(tmp_path / "Data.lsf").trajectory()


def test_unknown_options_are_said(tmp_path: Path) -> None:
    (tmp_path / "Data.lsf").write_bytes(flight())
    with pytest.raises(InputError, match=r"no option 'colour'.*vehicle, state, origin"):
        ul.open(tmp_path / "Data.lsf", colour=1)
    with pytest.raises(InputError, match="origin is '95,1'"):
        ul.open(tmp_path / "Data.lsf", origin="95,1").trajectory()


def test_the_definition_that_is_written_is_our_table(tmp_path: Path) -> None:
    (tmp_path / "IMC.xml").write_bytes(to_xml(own()))
    assert from_xml(tmp_path / "IMC.xml").by_id == own().by_id
    (tmp_path / "other.xml").write_text("<messages version='6.0.0'/>")
    with pytest.raises(InputError, match=r"version 6.0.0.*IMC 5.x"):
        from_xml(tmp_path / "other.xml")
    (tmp_path / "bad.xml").write_text("<messages version='5.4.1'><message id='x'/></messages>")
    with pytest.raises(InputError, match=r"bad.xml:1: a message's definition"):
        from_xml(tmp_path / "bad.xml")


def written(folder: Path) -> Path:
    frames = some_frames(12, sensor="front")
    with ul.sink(folder / "Data.lsf") as sink:
        sink.write(frames)
    return folder / "Data.lsf"


def test_numbers_have_the_names_that_dune_gives_them() -> None:
    imcpy = pytest.importorskip("imcpy", reason="imcpy, which holds DUNE's own codec, is not installed")

    def members(holder: type) -> list[dict[str, int]]:
        kinds = [kind for kind in vars(holder).values() if hasattr(kind, "__members__")]
        return [{name.lstrip("_"): int(value) for name, value in kind.__members__.items()} for kind in kinds]

    count = 0
    for kind in own().by_id.values():
        there = members(getattr(imcpy, kind.name, object))
        for part in kind.fields:
            if part.values is not None and not part.values.name:
                names = {name.lstrip("_"): number for name, number in part.values.numbers.items()}
                count += names in there  # newer definitions have a few more
    assert count >= 150
    for values in (*shared(own(), "Enumerated"), *shared(own(), "Bitfield")):
        there = getattr(imcpy, values.name, None)  # it lacks Boolean
        assert there is None or values.numbers == {key: int(value) for key, value in there.__members__.items()}


def learnt(folder: Path) -> None:
    """A log, and beside it what pyimclsts makes of its definition."""
    pytest.importorskip("pyimclsts")
    written(folder)
    (folder / "IMC.xml").write_bytes(gzip.decompress((folder / "IMC.xml.gz").read_bytes()))
    run = [sys.executable, "-m", "pyimclsts.extract"]
    subprocess.run(run, cwd=folder, check=True, capture_output=True, input=b"", timeout=60)


def test_pyimclsts_reads_and_writes_all_349_messages_in_either_byte_order(tmp_path: Path) -> None:
    learnt(tmp_path)
    code = """
import sys, pyimclsts.network as network
for line in sys.stdin:
    message = network.unpack(bytes.fromhex(line))
    print(type(message).__name__, message.pack(is_big_endian=False).hex(), message.pack(is_big_endian=True).hex())
"""
    packets = one_of_each(list(own().by_name), most=1.0)  # it refuses values out of the bounds of the definition
    want = [(packet.name, encode(packet).hex(), encode(packet, big=True).hex()) for packet in packets]
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True,
        input="\n".join(hexed for _, little, big in want for hexed in (little, big)), timeout=60,
    )  # fmt: skip
    assert [tuple(line.split()) for line in told.stdout.splitlines()] == [one for one in want for _ in range(2)]


def test_pyimclsts_replays_the_file_itself(tmp_path: Path) -> None:
    learnt(tmp_path)
    code = """
import collections, pyimclsts.network as network, pyimc_generated as there
count = collections.Counter()
replay = network.subscriber(network.file_interface("Data.lsf"))
for kind in ("EstimatedState", "DevDataBinary", "SonarData", "Distance", "EntityInfo"):
    replay.subscribe_async(lambda message, send: count.update([type(message).__name__]), getattr(there.messages, kind))
replay.run()
print(*sorted(count.items()))
"""
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=60
    )
    want = {"DevDataBinary": 13, "Distance": 12, "EntityInfo": 2, "EstimatedState": 12, "SonarData": 12}
    assert told.stdout.splitlines()[-1] == " ".join(map(str, want.items()))
    assert told.stderr == ""  # it asks for the list of entities by the name of that operation
