"""A finished run for other people's viewers: a file for rerun, and a layout for Foxglove."""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ullage.errors import InputError, UllageWarning
from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import load_world
from ullage.files import write_whole
from ullage.grids import Image, OccupancyMap
from ullage.pipeline import Chunk, DetectStage, run, sink
from ullage.ports.registry import open as open_source
from ullage.view.replay import FILE as REPLAY
from ullage.view.replay import images_of, maps_of, read_replay
from ullage.world.scene import Scene

RECORDING = "frames.mcap"
RRD = "report.rrd"
LAYOUT = "foxglove.json"
CLEAR = "#00000000"


@dataclass(slots=True)
class Kept:
    """Gives the maps that a run kept as their times come, and its image at the end."""

    maps: Sequence[tuple[float, OccupancyMap]]  # with seconds since the first frame
    images: Sequence[Image]
    _start_ns: int | None = None
    _given: int = 0

    def update(self, chunk: Chunk) -> Iterator[OccupancyMap]:
        """The maps up to the end of this piece."""
        if self._start_ns is None:
            self._start_ns = min(int(part.t_ns[0]) for part in chunk.values())
        now_s = (max(int(part.t_ns[-1]) for part in chunk.values()) - self._start_ns) * 1e-9
        while self._given < len(self.maps) and self.maps[self._given][0] <= now_s + 1e-3:
            yield self.maps[self._given][1]
            self._given += 1

    def finish(self) -> Iterable[Any]:
        """The last map and the image."""
        return [*(omap for _, omap in self.maps[-1:]), *self.images]


def write_rrd(folder: Path) -> Path:
    """Write world, flight, profiles, detections, maps and image of a run as `report.rrd`, which rerun opens.

    Raises:
        MissingExtra: rerun is not installed.
        InputError: the run has no recording, or the file cannot be written.
    """
    recording = _recording(folder)
    scenario = find_scenario(str(folder / "scenario.yaml"))
    tree = read_replay(folder) if (folder / REPLAY).exists() else {}
    kept = Kept(maps_of(tree), images_of(tree))
    viewer = sink(f"viewer:{folder / RRD}", overwrite=True)
    if tree.get("world") and (scene := _world(scenario)) is not None:
        viewer.write(scene)
    detected = DetectStage(scenario.detect.method, scenario.detect.threshold)
    if not scenario.remove_own_echo:
        detected.own_echo = None
    run(open_source(recording), stages=[detected, kept], sinks=[viewer])
    return folder / RRD


def _recording(folder: Path) -> Path:
    if not (folder / RECORDING).is_file():
        raise InputError(f"no {RECORDING}", where=folder, allowed="a run that kept its recording")
    return folder / RECORDING


def _world(scenario: Any) -> Scene | None:
    """Load the world of a simulated run; a missing file gives a warning."""
    try:
        return load_world(scenario.world)
    except InputError as error:
        warnings.warn(f"without its world: {error}", UllageWarning, stacklevel=3)
        return None


def write_foxglove(folder: Path) -> Path:
    """Write `foxglove.json`: a layout for the topics that the recording of a run has.

    Raises:
        InputError: the run has no recording, it has no index, or the file cannot be written.
    """
    layout = json.dumps(foxglove_layout(topics_in(_recording(folder))), indent=2)
    write_whole(folder / LAYOUT, lambda out: out.write(layout.encode()))
    return folder / LAYOUT


def topics_in(recording: Path) -> list[str]:
    """Return the topics of an MCAP file in order.

    Raises:
        InputError: it cannot be read, or has no index.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with recording.open("rb") as file:
            summary = make_reader(file).get_summary()
    except (OSError, ValueError, struct.error, McapError) as error:
        raise InputError(f"cannot read: {error}", where=recording, allowed="an MCAP file") from None
    if summary is None or not summary.channels:
        raise InputError("no index", where=recording, allowed="a finished recording; ullage doctor FOLDER mends one")
    return sorted({channel.topic for channel in summary.channels.values()})


def foxglove_layout(topics: Sequence[str]) -> dict[str, Any]:
    """Arrange the world in three dimensions next to the image and the range of each radar's nearest echo.

    Args:
        topics: of the recording; only these are named.
    """
    shown = {topic: style for topic in topics if (style := _style(topic))}
    if "/map/plane" in shown and "/map" in shown:  # the same cells, without those that are ambiguous
        shown["/map"] |= {"visible": False}
    ranges = [topic for topic in topics if topic.startswith("/radar/") and topic.endswith("/range")]
    panels: dict[str, dict[str, Any]] = {
        "3D!ullage": {"followTf": "map", "followMode": "follow-none", "topics": shown,
                      "scene": {"transforms": {"showLabel": False, "axisScale": 0.5}}},
    }  # fmt: skip
    if "/image" in topics:
        panels["Image!ullage"] = {"imageMode": {"imageTopic": "/image"}}
    if ranges:
        paths = [
            {"value": f"{topic}.range", "label": topic.split("/")[2], "enabled": True, "timestampMethod": "receiveTime"}
            for topic in ranges
        ]
        panels["Plot!ullage"] = {"foxglovePanelTitle": "Range of the nearest echo [m]", "paths": paths,
                                 "xAxisVal": "timestamp", "showLegend": True}  # fmt: skip
    world, *beside = panels
    side: Any = {"first": beside[0], "second": beside[1], "direction": "column"} if beside[1:] else "".join(beside)
    whole = {"first": world, "second": side, "direction": "row", "splitPercentage": 65} if side else world
    return {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1},
            "layout": whole}  # fmt: skip


def _style(topic: str) -> dict[str, Any]:
    """Return how a topic is drawn in three dimensions; empty if it is not."""
    last = topic.rpartition("/")[2]
    points = {"visible": True, "colorField": "intensity", "colorMode": "colormap", "colorMap": "turbo"}
    if topic == "/map":
        clear = {"unknownColor": CLEAR, "invalidColor": CLEAR}
        return {"visible": True, "colorMode": "custom", "minColor": "#ffffff8c", "maxColor": "#000000ff"} | clear
    if topic in ("/world", "/map/cubes", "/map/plane", "/map/surfaces"):
        return {"visible": True}
    if topic == "/path":
        return {"visible": True, "type": "line", "lineWidth": 0.05, "gradient": ["#ff2e63ff", "#ff2e63ff"]}
    if topic.startswith("/radar/") and last in ("profile", "detections"):
        return points | {"pointSize": 8 if last == "detections" else 3}
    return {}
