"""Every example runs, finds its physical statement true, and leaves a picture."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NEEDS = {
    "real_rail": [DATA / "pulson440" / "rail_a"],
    "receiver_beside_recording": [DATA / "x4" / "xethru_datafloat_20190614_141837.dat"],
}
LIBRARIES = {"dataset_torch": ["torch", "zarr", "pyarrow"], "dataset_xarray": ["xarray", "zarr", "pyarrow"]}
WRITES = {"receiver_beside_recording": ["receiver.png"]}


SLOW = {"real_rail", "first_map"}
MARKED = [pytest.param(p, marks=pytest.mark.slow if p.stem in SLOW else (), id=p.stem) for p in EXAMPLES]


@pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
@pytest.mark.parametrize("path", MARKED)
def test_example(path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    needed = NEEDS.get(path.stem, [])
    if missing := [str(p) for p in needed if not p.exists()]:
        pytest.skip(f"recordings are not part of the package: no {missing[0]}")
    for library in LIBRARIES.get(path.stem, []):
        pytest.importorskip(library)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path), *map(str, needed), *WRITES.get(path.stem, [])])
    try:
        runpy.run_path(str(path), run_name="__main__")
    except SystemExit as end:
        pytest.fail(f"{path.name}: {end.code}")
    assert [picture.name for picture in tmp_path.glob("*.png") if picture.stat().st_size > 1000]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_is_short_and_checks_itself(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= 61
    assert "SystemExit(" in text or path.stem == "receiver_beside_recording"


GALLERY = [
    pytest.param(p, marks=pytest.mark.slow if p.stem == "two_maps" else (), id=p.stem)
    for p in sorted((ROOT / "examples" / "gallery").glob("*.py"))
]


@pytest.mark.parametrize("path", GALLERY)
def test_a_script_of_the_gallery_leaves_its_picture(
    path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    assert (tmp_path / f"{path.stem}.png").stat().st_size > 5_000
    assert path.read_text(encoding="utf-8").count("\n") <= 15
