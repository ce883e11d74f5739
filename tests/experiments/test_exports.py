"""A finished run for other viewers: its .rrd, and the layout that Foxglove opens its recording with."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import ullage as ul
from ullage.experiments.exports import foxglove_layout, topics_in, write_foxglove, write_rrd
from ullage.experiments.runner import execute
from ullage.experiments.source_resolution import make_run, record
from ullage.view.replay import cell_states, images_of, map_tree, maps_of, read_replay

SMALL = ["image.step_m=0.2", "map.step_m=0.2", "flight.speed_m_s=2"]

COLOUR = {"type": "string", "pattern": "^#[0-9a-f]{8}$"}
TOPIC = {
    "type": "object",
    "properties": {
        "visible": {"type": "boolean"},
        "colorMode": {"enum": ["custom", "costmap", "map", "raw", "flat", "gradient", "colormap", "rgb", "rgba"]},
        **dict.fromkeys(("minColor", "maxColor", "unknownColor", "invalidColor"), COLOUR),
        "colorField": {"type": "string"}, "colorMap": {"enum": ["turbo", "rainbow"]}, "pointSize": {"type": "number"},
        "type": {"enum": ["axis", "arrow", "line"]}, "lineWidth": {"type": "number"},
        "gradient": {"type": "array", "items": COLOUR, "minItems": 2, "maxItems": 2},
    },
    "additionalProperties": False,
}  # fmt: skip
PATH = {
    "type": "object",
    "properties": {
        "value": {"type": "string"}, "label": {"type": "string"}, "enabled": {"type": "boolean"},
        "timestampMethod": {"enum": ["receiveTime", "headerStamp"]},
    },
    "required": ["value", "enabled", "timestampMethod"],
    "additionalProperties": False,
}  # fmt: skip
PANELS = {
    "^3D!": {
        "followTf": {"type": "string"}, "followMode": {"enum": ["follow-pose", "follow-position", "follow-none"]},
        "topics": {"type": "object", "additionalProperties": TOPIC}, "scene": {"type": "object"},
    },
    "^Image!": {"imageMode": {"type": "object", "properties": {"imageTopic": {"type": "string"}},
                              "additionalProperties": False}},
    "^Plot!": {
        "foxglovePanelTitle": {"type": "string"}, "paths": {"type": "array", "items": PATH},
        "xAxisVal": {"enum": ["timestamp", "index", "custom", "currentCustom"]}, "showLegend": {"type": "boolean"},
    },
}  # fmt: skip
"""The panels' settings, as @foxglove/studio-base 1.48.0 declares them: RendererConfig, ImageModeConfig, PlotConfig."""
LAYOUT = {
    "type": "object",
    "required": ["configById", "layout", "globalVariables", "userNodes"],
    "properties": {
        "configById": {
            "type": "object",
            "patternProperties": {
                name: {"type": "object", "properties": fields, "additionalProperties": False}
                for name, fields in PANELS.items()
            },
            "additionalProperties": False,
        },
        "globalVariables": {"type": "object"},
        "userNodes": {"type": "object"},
        "playbackConfig": {"type": "object"},
        "layout": {"$ref": "#/$defs/node"},
    },
    "additionalProperties": False,
    "$defs": {
        "node": {
            "oneOf": [
                {"type": "string", "pattern": "^[A-Za-z0-9]+![A-Za-z0-9]+$"},
                {
                    "type": "object",
                    "required": ["first", "second", "direction"],
                    "properties": {
                        "first": {"$ref": "#/$defs/node"},
                        "second": {"$ref": "#/$defs/node"},
                        "direction": {"enum": ["row", "column"]},
                        "splitPercentage": {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 100},
                    },
                    "additionalProperties": False,
                },
            ]
        }
    },
}
"""What Foxglove loads: `LayoutData` of the last public version, and a tree of panels of react-mosaic."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The folder of a run, and the recording that it wrote elsewhere by `--to`."""
    root = tmp_path_factory.mktemp("export")
    small = [*SMALL, "sensing.rate_hz=5"]
    job = make_run("ntnu-plate", options=small, out=root / "runs", to=[str(root / "x.mcap")], log=lambda _: None)
    assert not job.watched
    report = execute(job, sinks=[record(job)], log=lambda _: None)
    return report.folder, root / "x.mcap"


def panels_of(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else panels_of(node["first"]) + panels_of(node["second"])


def topics_of(layout: dict[str, Any]) -> set[str]:
    """Every topic that a layout names."""
    panels = layout["configById"]
    named = set(panels["3D!ullage"]["topics"])
    named |= {panel["imageMode"]["imageTopic"] for panel in panels.values() if "imageMode" in panel}
    named |= {path["value"].rpartition(".")[0] for panel in panels.values() for path in panel.get("paths", [])}
    return named


def test_the_layout_names_topics_of_the_recording_only(finished: tuple[Path, Path]) -> None:
    folder, recording = finished
    layout = json.loads(write_foxglove(folder).read_text())
    jsonschema.validate(layout, LAYOUT)
    assert sorted(panels_of(layout["layout"])) == sorted(layout["configById"])
    named = topics_of(layout)
    assert named <= set(topics_in(recording)) == set(topics_in(folder / "frames.mcap"))
    wanted = {"/map", "/map/plane", "/image", "/path", "/world", "/radar/front/profile", "/radar/front/range"}
    assert wanted <= named
    drawn = layout["configById"]["3D!ullage"]["topics"]["/map"]
    assert drawn["unknownColor"].endswith("00")  # clear
    assert not drawn["visible"]  # /map/plane shows its cells, and the ambiguous ones
    assert foxglove_layout(["/map"])["configById"]["3D!ullage"]["topics"]["/map"]["visible"]


def test_a_recording_with_less_has_a_layout_with_less() -> None:
    for topics in (["/tf"], ["/image"], ["/radar/a/range"], ["/image", "/radar/a/range", "/radar/b/range"]):
        layout = foxglove_layout(topics)
        jsonschema.validate(layout, LAYOUT)
        assert topics_of(layout) <= set(topics)
        assert sorted(panels_of(layout["layout"])) == sorted(layout["configById"])


def test_maps_and_image_of_a_replay_are_those_that_went_in(finished: tuple[Path, Path]) -> None:
    tree = read_replay(finished[0])
    maps, image = maps_of(tree), images_of(tree)[0]
    again = map_tree(maps, 0, float(maps[0][1].grid.origin_m[2]))
    assert again["state"] == tree["map"]["state"]
    assert again["cell"] == tree["map"]["cell"]
    assert set(np.unique(cell_states(maps[-1][1]))) >= {0, 1, 2}
    assert image.amplitude.max() == pytest.approx(1.0)
    assert maps_of({}) == images_of({}) == []


def test_a_folder_without_a_recording_is_refused_in_one_line(finished: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.copytree(finished[0], tmp_path / "run")
    (tmp_path / "run" / "frames.mcap").write_bytes(b"no mcap")
    with pytest.raises(ul.InputError, match=r"cannot read.*an MCAP file"):
        write_foxglove(tmp_path / "run")
    (tmp_path / "run" / "frames.mcap").unlink()
    for write in (write_foxglove, write_rrd):
        with pytest.raises(ul.InputError, match=r"no frames\.mcap") as error:
            write(tmp_path / "run")
        assert "\n" not in str(error.value)


def test_the_rrd_of_a_run_holds_world_flight_maps_and_image(finished: tuple[Path, Path]) -> None:
    rr = pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'ullage[view]'")
    path = write_rrd(finished[0])
    write_rrd(finished[0])  # again, over the one before
    chunks = list(rr.chunk.RrdReader(path).stream())
    there = {chunk.entity_path for chunk in chunks}
    assert {"/world/map", "/world/image", "/world/flown", "/world/drone", "/profiles/front/range_time"} <= there
    assert any(name.startswith("/world/scene/") for name in there)
    assert sum(chunk.to_record_batch().num_rows for chunk in chunks if chunk.entity_path == "/world/map") >= 2


def test_a_run_that_is_watched_gives_its_image_while_it_flies(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'ullage[view]'")
    images: list[ul.Image] = []

    class Taking:
        def write(self, item: Any) -> None:
            images.extend([item] if isinstance(item, ul.Image) else [])

        def close(self) -> None:
            pass

    small = [*SMALL, "sensing.rate_hz=20"]
    job = make_run("ntnu-plate", tasks=("image",), options=small, out=tmp_path, to=[f"viewer:{tmp_path / 'a.rrd'}"])
    execute(job, sinks=[Taking()], log=lambda _: None, draw=False)
    assert job.watched
    assert len(images) >= 3
    filled = [int((np.abs(image.values) > 0).sum()) for image in images]
    assert filled == sorted(filled)
    assert filled[0] < filled[-1]
