"""The report of a run: its verdict, its metrics, and its replay, as files and in a real browser."""

from __future__ import annotations

import base64
import gzip
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ullage as ul
from ullage.config import make_scenario, scenario_text
from ullage.view.metric_words import GROUPS, OTHER, meaning
from ullage.view.replay import (
    AMBIGUOUS_CELL,
    FREE_CELL,
    OCCUPIED_CELL,
    MapHistory,
    Parts,
    cell_states,
    read_replay,
    replay,
    unpacked,
    write_replay,
)  # fmt: skip
from ullage.view.report import write_report

CHROMIUM = next((found for name in ("chromium", "google-chrome") if (found := shutil.which(name))), None)
METRICS = {
    "f1": 0.84, "precision": 0.87, "recall": 0.81, "accuracy_p90": 0.2, "surface_declared_free": 0.0, "frames": 4.0,
    "found:plate": 0.0, "real_time_factor": 2.0,
    "recall_in_view": 0.6, "surface_specular_invisible": 0.3, "false_occupied": 3.0, "worst_false_occupied": 40.0,
    "worst_false_occupied_at": 12.0,
}  # fmt: skip


@pytest.fixture
def run_folder(parts: Parts, tmp_path: Path) -> Path:
    tree: dict[str, Any] = {"name": "room", "title": parts.title, "world": {"file": "room.sdf"}}
    scenario = make_scenario(tree | {"expect": {"f1": {"min": 0.9}, "recall": {"min": 0.5}}})
    (tmp_path / "scenario.yaml").write_text(scenario_text(scenario))
    provenance = {"started": "today", "ullage": ul.__version__, "state": "complete", "interrupted": False}
    (tmp_path / "provenance.json").write_text(json.dumps(provenance))
    metrics = {name: {"value": value, "unit": "m" if name == "accuracy_p90" else ""} for name, value in METRICS.items()}
    (tmp_path / "metrics.json").write_text(json.dumps(metrics))
    objects = [
        {"name": "plate", "state": "missed", "mapped": 0.0, "observable": 0.4},
        {"name": "north", "state": "mapped", "mapped": 0.9, "observable": 0.8},
    ]
    rival = {"name": "the method of 2018", "scenario": "old", "metrics": {"f1": {"value": 0.4, "unit": ""}}}
    (tmp_path / "findings.json").write_text(
        json.dumps({"objects": objects, "compared": rival, "place": "In the plane 1.0 m above floor"})
    )
    write_replay(tmp_path, parts)
    return tmp_path


def test_the_page_says_first_what_was_mapped_and_what_was_missed(run_folder: Path) -> None:
    page = write_report(run_folder).read_text(encoding="utf-8")
    verdict = page[page.index('class="verdict"') : page.index("<h2>")]
    assert '<p class="bad">Missed: plate.</p>' in verdict
    assert "In the plane 1.0 m above floor, the map shows 60 % of all surface in range and in sight" in verdict
    assert "81 % of the surface that the radars could observe" in verdict
    assert "1 of the 2 objects in sight are mapped" in verdict
    assert "30 % was in a beam but never faced a radar" in verdict
    assert "At worst, 12 s into the flight, 40 occupied cells lay on no surface; at its end 3 do." in verdict
    assert "The method of 2018 on the same flight reaches F1 0.400." in verdict
    assert "A room &lt;with&gt; a plate" in page


def test_the_verdict_warns_of_surface_that_is_marked_as_free(run_folder: Path) -> None:
    metrics = json.loads((run_folder / "metrics.json").read_text())
    metrics["surface_declared_free"]["value"] = 0.05
    (run_folder / "metrics.json").write_text(json.dumps(metrics))
    page = write_report(run_folder).read_text(encoding="utf-8")
    assert re.search(r'class="bad">The map marks 5 % of the surface .* Do not fly by this map', page)


def test_the_verdict_says_so_where_no_surface_is_marked_as_free(run_folder: Path) -> None:
    assert "The map marks no surface in sight of the radars as free." in write_report(run_folder).read_text("utf-8")


def test_metrics_are_grouped_defined_and_bounded(run_folder: Path) -> None:
    page = write_report(run_folder).read_text(encoding="utf-8")
    order = [page.index(f"<h3>{title}</h3>") for title in ("The map against the truth", "Safe to fly", "Radar and run")]
    assert order == sorted(order)
    assert '<td class="n bad" data-label="bounds">0.9 .. </td>' in page  # F1 0.84 is out of bounds
    assert '<td class="n good" data-label="bounds">0.5 .. </td>' in page
    assert "Harmonic mean of precision and recall." in page


def test_every_metric_of_a_map_has_a_meaning(parts: Parts) -> None:
    assert parts.scene is not None
    for name in ul.metrics.map_quality(parts.maps[-1][1], parts.scene, parts.frames):
        assert meaning(name)[0] != OTHER, name
        assert meaning(name)[1], name
    assert meaning("what_is_this") == (OTHER, "")
    assert all(text.endswith(".") for words in GROUPS.values() for text in words.values())


def test_the_page_needs_nothing_from_outside_and_a_run_without_replay_has_a_page_too(run_folder: Path) -> None:
    page = write_report(run_folder).read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=\"(?!data:)", page)
    assert 'id="view"' in page
    (run_folder / "replay.json.gz").unlink()
    (run_folder / "findings.json").unlink()
    plain = write_report(run_folder).read_text(encoding="utf-8")
    assert 'id="view"' not in plain
    assert len(plain) < 20_000


def test_the_page_holds_the_replay_as_it_was_written(run_folder: Path, parts: Parts) -> None:
    page = write_report(run_folder).read_text(encoding="utf-8")
    (held,) = re.findall(r'id="data">([^<]*)<', page)
    tree = json.loads(gzip.decompress(base64.b64decode(held)))
    assert tree == read_replay(run_folder) == json.loads(json.dumps(replay(parts)))
    radar, frames = tree["radars"][0], parts.frames["radar"]
    assert np.allclose(unpacked(radar["position"]), frames.believed.position, atol=1e-5)
    assert unpacked(radar["levels"]).shape == frames.samples.shape
    assert {one["name"]: one["state"] for one in tree["world"]["objects"]}["plate"] == "missed"
    assert [one["t"] for one in tree["explained"]] == pytest.approx([5 / 17, 20 / 17])


def test_the_changes_of_the_maps_add_up_to_the_last_map(parts: Parts) -> None:
    tree = replay(parts)["map"]
    cells = np.zeros(parts.maps[-1][1].grid.size, np.uint8)
    for cell, state in zip(unpacked(tree["cell"]), unpacked(tree["state"]), strict=True):
        cells[cell] = state
    omap = parts.maps[-1][1]
    assert len(unpacked(tree["t"])) == len(parts.maps) >= 3
    assert (cells == cell_states(omap)).all()
    for state, flags in ((OCCUPIED_CELL, omap.occupied), (FREE_CELL, omap.free), (AMBIGUOUS_CELL, omap.ambiguous)):
        assert ((cells == state) == flags.ravel()).all()


def test_a_long_run_keeps_few_maps_evenly() -> None:
    grid, history = ul.Grid((0, 0, 0), 0.5, (2, 2)), MapHistory(most=10)
    for k in range(100):
        history.write(ul.OccupancyMap(grid, np.full((2, 2), k, np.int8)))
    kept = [int(omap.percent[0, 0]) for _, omap in history.maps()]
    assert 5 <= len(kept) <= 10
    assert len(set(np.diff(kept))) == 1


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make dev")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: apt-get install chromium")
    with sync_api.sync_playwright() as play:
        flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        running = play.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield running
        running.close()


def differing(before: bytes, after: bytes) -> float:
    """Share of the pixels that differ between two PNGs of one size."""
    from io import BytesIO

    from PIL import Image

    one, other = (np.asarray(Image.open(BytesIO(png)).convert("RGB")).astype(int) for png in (before, after))
    return float((abs(one - other).max(axis=2) > 12).mean())


@pytest.mark.slow
def test_in_chromium_the_replay_is_drawn_the_slider_moves_the_drone_and_an_echo_is_explained(
    run_folder: Path, browser: Any
) -> None:
    page = browser.new_page(viewport={"width": 1000, "height": 900})
    wrong: list[str] = []
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda request: wrong.append(request.url) if not request.url.startswith("file:") else None)
    page.goto(write_report(run_folder).as_uri())
    page.wait_for_selector("body[data-ready]", state="attached")
    stage = page.locator("#stage")
    at_end, place = stage.screenshot(), page.evaluate("document.body.dataset.drone")
    boxes = [box for box in page.locator("#layers input").all() if box.is_checked()]
    for box in boxes:
        box.set_checked(False)
    assert differing(at_end, stage.screenshot()) > 0.05
    for box in boxes:
        box.set_checked(True)
    page.evaluate(
        "() => { const s = document.getElementById('time'); s.value = 0; s.dispatchEvent(new Event('input')) }"
    )
    at_start, first = stage.screenshot(), page.evaluate("document.body.dataset.drone")
    assert [float(v) for v in first.split()] == pytest.approx([-1, -0.5, 0], abs=0.01)
    assert [float(v) for v in place.split()] == pytest.approx([-0.5, 0.5, 0], abs=0.05)
    assert differing(at_start, at_end) > 0.002
    page.click("#next")
    page.locator("#profiles li button").first.click()
    assert re.match(r"radar: .* bounce, \d+\.\d\d m, -\d+\.\d dB", page.inner_text("#explanation"))
    assert differing(stage.screenshot(), at_start) > 0.002
    page.uncheck("#layers label:has-text('echoes') input")
    page.click("#view", position={"x": 500, "y": 300})  # the middle of the picture: some object of the room
    assert re.match(r"[\w ]+ at \(-?\d+\.\d\d, .*\) m: (missed|not in sight)", page.inner_text("#explanation"))
    assert page.locator(".mark:visible").count() >= 3  # a length, heights and north
    assert "occupied" in page.inner_text("#legend")
    seen = stage.screenshot()
    page.locator("tr[data-object='plate']").click()
    assert page.inner_text("#explanation") == "plate: missed."
    assert differing(stage.screenshot(), seen) > 0.05  # the camera flew there
    page.click("#theme")
    assert wrong == []
    page.close()


@pytest.mark.slow
def test_on_a_phone_the_page_does_not_scroll_sideways_and_the_picture_fits(run_folder: Path, browser: Any) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.goto(write_report(run_folder).as_uri())
    page.wait_for_selector("body[data-ready]", state="attached")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.locator("#stage").bounding_box()["height"] < 350
    unit = page.locator("td.unit:not(:empty)").first
    value = unit.locator("xpath=preceding-sibling::td[1]")
    assert unit.bounding_box()["y"] == pytest.approx(value.bounding_box()["y"], abs=5)
    assert page.evaluate("document.documentElement.scrollHeight") < 9000
    page.close()


@pytest.mark.slow
def test_without_webgl_the_page_shows_the_map_and_the_reason(run_folder: Path, browser: Any) -> None:
    (run_folder / "figures").mkdir(exist_ok=True)
    ul.figures.map_figure(run_folder / "figures" / "map.png", ul.OccupancyMap(
        ul.Grid((0, 0, 0), 0.5, (4, 4)), np.zeros((4, 4), np.int8)), title="map")  # fmt: skip
    page = browser.new_page(viewport={"width": 1000, "height": 700})
    page.add_init_script("HTMLCanvasElement.prototype.getContext = ((real) => function (kind, ...rest) {"
                         " return kind.startsWith('webgl') ? null : real.call(this, kind, ...rest); })"
                         "(HTMLCanvasElement.prototype.getContext)")  # fmt: skip
    page.goto(write_report(run_folder).as_uri())
    page.wait_for_selector("body[data-ready]", state="attached")
    assert "no WebGL" in page.inner_text("#stage")
    assert page.locator("#stage img").is_visible()
    assert page.locator("#profiles canvas").first.is_visible()
    page.close()


def test_without_a_world_the_replay_spans_flight_and_known_cells(parts: Parts) -> None:
    from dataclasses import replace

    low, high = replay(replace(parts, scene=None))["bounds"]
    grid, known = parts.maps[-1][1].grid, np.argwhere(~parts.maps[-1][1].unknown)
    assert low[0] == pytest.approx(grid.origin_m[0] + known[:, 1].min() * grid.step_m)
    assert high[1] == pytest.approx(grid.origin_m[1] + (known[:, 0].max() + 1) * grid.step_m)
    assert replay(parts)["bounds"] == parts.scene.bounds.tolist() if parts.scene else False
