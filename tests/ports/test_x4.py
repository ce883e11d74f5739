"""X4 recordings of both kinds: real ones to the last sample, and whatever is left of broken ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ullage as ul
from ullage.geometry import C0

DATA = Path(__file__).parents[3] / "shared" / "data" / "x4"
FLOAT, IQ = DATA / "xethru_datafloat_20190614_141837.dat", DATA / "xethru_baseband_iq_20170913_150437.dat"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the real recordings are not here")


def datafloat(n: int, bins: int = 20, *, counter: np.ndarray | None = None) -> tuple[bytes, np.ndarray]:
    rng = np.random.default_rng(n)
    rows = np.zeros(n, [("id", "<u4"), ("counter", "<u4"), ("size", "<u4"), ("data", "<f4", (2 * bins,))])
    rows["counter"] = 7 + np.arange(n) if counter is None else counter
    rows["size"] = 2 * bins
    rows["data"] = rng.normal(size=(n, 2 * bins))
    return rows.tobytes(), rows["data"][:, :bins] + 1j * rows["data"][:, bins:]


def baseband(n: int, bins: int = 16) -> tuple[bytes, np.ndarray]:
    rng = np.random.default_rng(n)
    rows = np.zeros(
        n, [("counter", "<u4"), ("bins", "<u4"), ("axis", "<f4", 4), ("i", "<f4", bins), ("q", "<f4", bins)]
    )
    rows["counter"], rows["bins"] = 1 + np.arange(n), bins
    rows["axis"] = [0.0514403, 2.916e9, 7.29e9, 0.334321]
    rows["i"], rows["q"] = rng.normal(size=(2, n, bins))
    return rows.tobytes(), rows["i"] + 1j * rows["q"]


@needs_data
def test_real_datafloat() -> None:
    source = ul.open(FLOAT, fps=17.0, range_start_m=0.0)
    frames = source.frames()
    assert isinstance(frames, ul.Frames)
    raw = np.fromfile(FLOAT, "<f4").reshape(9128, 363)
    np.testing.assert_array_equal(frames.samples.real, raw[:, 3:183])
    np.testing.assert_array_equal(frames.samples.imag, raw[:, 183:])
    assert frames.unit == "normalised"
    np.testing.assert_allclose(np.diff(frames.range_m), C0 / 2 * 8 / 23.328e9)
    lost = int.from_bytes(raw[-1, 1].tobytes(), "little") - int.from_bytes(raw[0, 1].tobytes(), "little")
    assert frames.t_ns[-1] == round(lost / 17 * 1e9)  # frames that never arrived leave gaps in time


@needs_data
def test_real_baseband() -> None:
    frames = ul.open(IQ, fps=20.0).frames()
    assert isinstance(frames, ul.Frames)
    assert frames.samples.shape == (514, 54)
    raw = np.fromfile(IQ, "<f4").reshape(514, 114)
    np.testing.assert_array_equal(frames.samples, raw[:, 6:60] + 1j * raw[:, 60:])
    assert frames.range_m[0] == pytest.approx(0.33432, rel=1e-3)
    assert np.diff(frames.range_m) == pytest.approx(0.05144, rel=1e-3)
    assert frames.spec.center_hz == pytest.approx(7.29e9)
    np.testing.assert_allclose(frames.spec.range_m, frames.range_m, rtol=1e-12)


@needs_data
def test_what_is_not_recorded_is_said_to_be_assumed() -> None:
    with pytest.warns(ul.UllageWarning) as caught:
        ul.open(FLOAT)
    said = " ".join(str(w.message) for w in caught)
    assert "17 frames a second are assumed" in said
    assert "range of bin 0 is not recorded" in said


def test_options_are_taken(tmp_path: Path) -> None:
    content, samples = datafloat(5)
    (tmp_path / "a.dat").write_bytes(content)
    frames = ul.open(tmp_path / "a.dat", fps=50, range_start_m=0.4).frames()
    np.testing.assert_allclose(frames.samples, samples, rtol=1e-6)
    assert frames.t_ns.tolist() == [0, 20_000_000, 40_000_000, 60_000_000, 80_000_000]
    assert frames.range_m[0] == 0.4
    with pytest.raises(ul.InputError, match="fps"):
        ul.open(tmp_path / "a.dat", fps=-1, range_start_m=0)


def test_stream_is_the_whole_in_pieces(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_bytes(baseband(23)[0])
    source = ul.open(tmp_path / "a.dat", fps=10)
    parts = [part["x4"] for part in source.stream(10)]
    assert [len(p) for p in parts] == [10, 10, 3]
    np.testing.assert_array_equal(np.concatenate([p.samples for p in parts]), source.frames().samples)
    np.testing.assert_array_equal(np.concatenate([p.t_ns for p in parts]), source.frames().t_ns)


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@settings(deadline=None, max_examples=60)
@given(kind=st.sampled_from([datafloat, baseband]), data=st.data())
def test_cut_anywhere(tmp_path_factory: pytest.TempPathFactory, kind: object, data: st.DataObject) -> None:
    content, samples = kind(6)  # type: ignore[operator]
    cut = data.draw(st.integers(0, len(content)))
    path = tmp_path_factory.mktemp("x4") / "a.dat"
    path.write_bytes(content[:cut])
    whole = cut // (len(content) // 6)
    if not whole:
        with pytest.raises(ul.InputError, match=r"a\.dat"):
            ul.open(path)
        return
    np.testing.assert_allclose(ul.open(path).frames().samples, samples[:whole], rtol=1e-6)


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@settings(deadline=None, max_examples=80)
@given(content=st.binary(max_size=600), good=st.booleans())
def test_garbage_is_one_line_or_frames(tmp_path_factory: pytest.TempPathFactory, content: bytes, good: bool) -> None:
    path = tmp_path_factory.mktemp("x4") / "a.dat"
    path.write_bytes(datafloat(2)[0] + content if good else content)
    try:
        frames = ul.open(path).frames()
    except ul.InputError as error:
        said = str(error)
        assert "\n" not in said
        assert not good
    else:
        assert len(frames) >= 2 * good


def test_wrong_count_ends_the_recording_with_a_warning(tmp_path: Path) -> None:
    content = bytearray(datafloat(9)[0])
    content[4 * (12 + 160) + 8] = 99
    (tmp_path / "a.dat").write_bytes(content)
    with pytest.warns(ul.UllageWarning, match="header of frame 4 does not fit"):
        source = ul.open(tmp_path / "a.dat", fps=17, range_start_m=0)
    assert len(source.frames()) == 4


def test_cut_says_where(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_bytes(datafloat(9)[0][:-3])
    with pytest.warns(ul.UllageWarning, match="cut within frame 8"):
        source = ul.open(tmp_path / "a.dat", fps=17, range_start_m=0)
    assert len(source.frames()) == 8


def test_counter_that_jumps_back_keeps_every_frame(tmp_path: Path) -> None:
    content, _ = datafloat(9, counter=np.array([5, 6, 7, 8, 2, 3, 4, 4, 9]))
    (tmp_path / "a.dat").write_bytes(content)
    with pytest.warns(ul.UllageWarning, match="jumps back or stands still 2 times, first after frame 3"):
        frames = ul.open(tmp_path / "a.dat", fps=10, range_start_m=0).frames()
    assert (np.diff(frames.t_ns) > 0).all()
    assert len(frames) == 9


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty file"), (b"hello", "5 bytes hold no frame"), (b"\xff\xfex\x004\x00" * 99, "not an X4"),
        (np.array([0, 1, 7, 0, 0, 0], "<u4").tobytes(), "not an X4"), (datafloat(1)[0][:90], "cut within its first"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "a.dat").write_bytes(content)
    with pytest.raises(ul.InputError, match=words):
        ul.open(tmp_path / "a.dat")
