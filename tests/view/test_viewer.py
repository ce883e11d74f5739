"""The viewer's sink: what it writes is read back by rerun's own reader, and by rerun's own program."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Picture

import ullage as ul
from ullage.errors import MissingExtra
from ullage.grids import MappedSurface
from ullage.pipeline import DetectStage, ImageStage, InMemorySource, MapStage

rr = pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'ullage[view]'")

from ullage.view import viewer_plots, viewer_scene  # noqa: E402
from ullage.view.viewer import ViewerSink, spread  # noqa: E402

ROOM = {"size_m": (6, 4, 3), "plate": {"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}}


def some_frames(seconds: float = 1.0, *, rig: str = "thesis-4") -> dict[str, ul.Frames]:
    path = ul.Trajectory.line((-1, 0, 0), (-1 + 0.5 * seconds, 0.2, 0), 0.5, 17)
    found = ul.simulate(ul.scenes.room(**ROOM), path, ul.Rig.preset(rig), fidelity="thesis", seed=2)
    return found if isinstance(found, dict) else {found.sensor: found}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, ul.Frames]]:
    path = tmp_path_factory.mktemp("view") / "room.rrd"
    room, frames = ul.scenes.room(**ROOM), some_frames(3.0)
    grid = ul.Grid.covering(room.bounds, 0.1, z_m=0.25)
    sink = ul.sink(f"viewer:{path}")
    sink.write(room)
    stages = [DetectStage(), MapStage(grid, "elfes"), ImageStage(grid, "summation")]
    ul.run(InMemorySource(frames, size=10), stages=stages, sinks=[sink])
    return path, frames


def rows(path: Path, entity: str, part: str) -> list[tuple[Any, Any]]:
    """Times [ns] (None: for good) and values of one component of one entity, by rerun's reader."""
    out = []
    for chunk in rr.chunk.RrdReader(path).stream():
        if chunk.entity_path != f"/{entity}":
            continue
        table = chunk.to_record_batch()
        names = [n for n in table.schema.names if n.endswith(f":{part}")]
        if names:
            times = table.column("time").cast("int64").to_pylist() if "time" in table.schema.names else None
            values = table.column(names[0]).to_pylist()
            out += list(zip(times or [None] * len(values), values, strict=True))
    return sorted(out, key=lambda row: -1 if row[0] is None else row[0])


def test_rays_are_drawn_once_and_only_where_asked_for(recorded: tuple[Path, Any], tmp_path: Path) -> None:
    path = tmp_path / "rays.rrd"
    with ul.sink(f"viewer:{path}?rays=true") as sink:
        sink.write(some_frames(0.3))
        sink.write(some_frames(0.3))
    for name in recorded[1]:
        drawn = rows(path, f"world/radars/{name}/rays", "strips")
        assert [time for time, _ in drawn] == [None]
        assert len(drawn[0][1]) == 225
        assert not rows(recorded[0], f"world/radars/{name}/rays", "strips")


def test_reruns_own_program_finds_the_file_whole(recorded: tuple[Path, Any]) -> None:
    program = Path(sys.executable).with_name("rerun")
    if not program.exists():
        pytest.skip("no rerun program beside this python")
    done = subprocess.run([program, "rrd", "verify", recorded[0]], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_everything_that_flowed_is_there(recorded: tuple[Path, dict[str, ul.Frames]]) -> None:
    there = {chunk.entity_path for chunk in rr.chunk.RrdReader(recorded[0]).stream()}
    wanted = {"/world/map", "/world/image", "/world/flown", "/world/drone", "/world/scene/plate"}
    for name in recorded[1]:
        wanted |= {
            f"/world/radars/{name}", f"/world/radars/{name}/beam", f"/world/echoes/{name}/arcs",
            f"/profiles/{name}/range_time", f"/profiles/{name}/now", f"/nearest/{name}", f"/strongest/{name}",
        }  # fmt: skip
    assert wanted <= there


def test_poses_are_those_of_the_frames(recorded: tuple[Path, dict[str, ul.Frames]]) -> None:
    for name, part in recorded[1].items():
        seen = rows(recorded[0], f"world/radars/{name}", "translation")
        assert [t for t, _ in seen] == part.t_ns.tolist()
        assert np.allclose([v[0] for _, v in seen], part.believed.position, atol=1e-6)


def test_the_drone_is_where_its_radars_are_not(recorded: tuple[Path, dict[str, ul.Frames]]) -> None:
    front, back = recorded[1]["front"].believed.position, recorded[1]["back"].believed.position
    seen = np.array([v[0] for _, v in rows(recorded[0], "world/drone", "translation")])
    assert np.allclose(seen, (front + back) / 2, atol=1e-6)


def test_levels_are_the_frames_own_in_db(recorded: tuple[Path, dict[str, ul.Frames]]) -> None:
    part = recorded[1]["front"]
    seen = [v[0] for _, v in rows(recorded[0], "strongest/front", "scalars")]
    assert np.allclose(seen, 20 * np.log10(part.amplitude.max(axis=1)), atol=1e-4)


def test_arcs_lie_at_the_range_that_was_detected(recorded: tuple[Path, dict[str, ul.Frames]]) -> None:
    part = recorded[1]["front"]
    hits = ul.detect(part)
    seen = {t: v for t, v in rows(recorded[0], "world/echoes/front/arcs", "strips") if v}
    assert sorted(seen) == sorted(set(hits.t_ns.tolist()))
    for t_ns, range_m in zip(hits.t_ns.tolist(), hits.range_m, strict=True):
        away = np.linalg.norm(np.array(seen[t_ns][0]) - part.believed.at(t_ns).position, axis=1)
        assert np.allclose(away, range_m, atol=1e-5)


def test_the_map_lies_where_its_grid_lies(recorded: tuple[Path, Any]) -> None:
    corners = [v[0] for _, v in rows(recorded[0], "world/map", "translation")]
    assert len(corners) >= 3  # it grew before our eyes
    assert corners[-1][2] == pytest.approx(0.25)
    assert np.all(np.array(corners)[:, :2] >= [-3.2, -2.2])
    assert len(rows(recorded[0], "world/map", "data")) == len(corners)


def test_the_rolling_picture_has_the_echo_at_its_range_and_now_at_the_right() -> None:
    picture = viewer_plots.RangeTime(np.linspace(0, 10, 100))
    level = np.full((34, 100), -80.0, np.float32)
    level[:, 30] = -20
    picture.add((np.arange(34) * 1e9 / 17).astype(np.int64), level)
    shown = np.asarray(Picture.open(io.BytesIO(picture.png(-20.0))))
    assert shown.shape == (100, viewer_plots.COLUMNS)
    assert np.argmax(np.where(shown[:, -1] == viewer_plots.EMPTY, 0, shown[:, -1])) == 99 - 30
    filled = (shown != viewer_plots.EMPTY).any(axis=0)
    assert filled[-20:].all()
    assert not filled[: viewer_plots.COLUMNS // 2].any()


def test_frames_are_thinned_evenly_and_end_with_the_newest() -> None:
    t_ns = (np.arange(1000) * 1e6).astype(np.int64)  # 1 kHz
    kept = spread(t_ns, 30.0)
    assert kept[-1] == 999
    assert 28 <= len(kept) <= 32
    assert np.diff(t_ns[kept])[1:].min() >= 30e6
    assert spread(t_ns, 1e6).tolist() == list(range(1000))


def test_walls_face_inwards_so_that_one_sees_into_a_room() -> None:
    room = ul.scenes.room(**ROOM)
    hull = viewer_scene.hull_objects(room)
    assert not hull[room.object("plate")]
    assert hull.any()


def test_a_volume_becomes_boxes_and_waits_for_the_end(tmp_path: Path) -> None:
    grid = ul.Grid((0, 0, 0), 0.5, (2, 3, 4))
    percent = np.full(grid.shape, -1, np.int8)
    percent[1, 2, 3] = 90
    path = tmp_path / "volume.rrd"
    with ViewerSink(path) as sink:
        sink.write(ul.OccupancyMap(grid, np.zeros(grid.shape, np.int8)))
        sink.write(ul.OccupancyMap(grid, percent))  # too soon after the other: shown when closed
    seen = rows(path, "world/map", "centers")
    assert np.allclose(seen[-1][1], [[1.75, 1.25, 0.75]])


def test_recordings_without_poses_show_their_profiles(tmp_path: Path) -> None:
    from dataclasses import replace

    part = replace(next(iter(some_frames(rig="single").values())), poses=None, truth=None)
    part = replace(part, t_ns=part.t_ns + 1_530_000_000 * 10**9)  # a clock of dates
    path = tmp_path / "bare.rrd"
    with ViewerSink(path) as sink:
        sink.write(part)
        sink.write(ul.detect(part))
    there = {chunk.entity_path for chunk in rr.chunk.RrdReader(path).stream()}
    assert f"/strongest/{part.sensor}" in there
    assert "/world/drone" not in there
    assert rows(path, f"strongest/{part.sensor}", "scalars")[0][0] == part.t_ns[0]


def test_what_cannot_be_shown_or_written_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there.rrd").write_bytes(b"x")
    (tmp_path / "file").write_bytes(b"x")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    cases = {
        f"viewer:{tmp_path / 'there.rrd'}": "exists already.*overwrite=True",
        f"viewer:{tmp_path / 'file' / 'a.rrd'}": "cannot write",
        f"viewer:{tmp_path / 'a.mp4'}": r"not something a viewer shows.*FILE\.rrd",
    }
    cases["viewer:rerun+http://127.0.0.1:1/proxy"] = "no viewer answers"
    if sys.platform.startswith("linux"):
        cases["viewer:"] = r"no display to open a viewer on.*viewer:FILE\.rrd"
    for target, words in cases.items():
        with pytest.raises(ul.InputError, match=words) as error:
            ul.sink(target)
        assert "\n" not in str(error.value)
    with pytest.raises(ul.InputError, match=r"no option 'colour'.*overwrite"):
        ul.sink(f"viewer:{tmp_path / 'a.rrd'}", colour=1)
    sink = ul.sink(f"viewer:{tmp_path / 'there.rrd'}", overwrite=True)
    sink.close()
    sink.close()
    with pytest.raises(ul.InputError, match="closed already"):
        sink.write(some_frames(0.2))


def test_without_rerun_one_line_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtra, match=r"pip install 'ullage\[view\]'"):
        ul.sink(f"viewer:{tmp_path / 'a.rrd'}")


def test_the_file_is_readable_to_the_last_piece_without_being_closed(tmp_path: Path) -> None:
    path = tmp_path / "cut.rrd"
    code = (
        "import os, ullage as ul\n"
        f"sink = ul.sink('viewer:{path}')\n"
        "sink.write(ul.Frames([[1.0, 2.0]] * 4, [0.0, 1.0], range(0, 400, 100), ul.RadarSpec.preset('x4m05')))\n"
        "import time; time.sleep(1.0)\n"
        "os._exit(9)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 9
    done = subprocess.run(
        [Path(sys.executable).with_name("rerun"), "rrd", "print", path], capture_output=True, text=True, check=False
    )
    assert "/strongest/radar" in done.stdout


def test_a_running_viewer_is_shown_no_more_than_it_can_take(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    sink = ViewerSink(tmp_path / "a.rrd")
    sink.live = True  # all but the window
    clock = [100.0]
    monkeypatch.setattr("ullage.view.viewer.time.monotonic", lambda: clock[0])
    part = next(iter(some_frames(20.0, rig="single").values()))
    for piece in part.chunks(34):  # two seconds of flight in half a second each
        sink.write(piece)
        clock[0] += 0.5
    sink.close()
    pieces = -(-len(part) // 34)
    shown = len(rows(tmp_path / "a.rrd", f"strongest/{part.sensor}", "scalars"))
    assert 15 * (pieces - 1) <= shown <= 15 * pieces + 30
    assert shown < len(part)


def test_surfaces_are_lines_along_them_by_kind(tmp_path: Path) -> None:
    grid = ul.Grid((0.0, 0.0, 1.5), 0.1, (4, 40))
    points, normals = np.array([[2.0, 0.0], [2.0, 0.1]]), np.tile([-1.0, 0.0], (2, 1))
    given = np.zeros(2), np.array([2.0, 0.0, 0.0, 1.0]), np.eye(4), 40.0, 2
    surfaces = (
        MappedSurface("plane", *given, True, points, normals),
        MappedSurface("edge", *given, False, points, normals),
    )
    with ul.sink(f"viewer:{tmp_path / 'map.rrd'}") as sink:
        sink.write(ul.OccupancyMap(grid, np.zeros(grid.shape, np.int8), surfaces=surfaces))
    ((_, strips),) = rows(tmp_path / "map.rrd", "world/surfaces/plane", "strips")
    np.testing.assert_allclose(np.asarray(strips)[..., 0], 2.0)
    np.testing.assert_allclose(np.asarray(strips).mean(axis=1)[:, 1], [0.0, 0.1], atol=1e-6)
    ((_, hidden),) = rows(tmp_path / "map.rrd", "world/surfaces/edge", "strips")
    assert not hidden  # not on the map


def test_surfaces_of_a_volume_are_shown_at_their_own_height(tmp_path: Path) -> None:
    grid = ul.Grid((0.0, 0.0, 0.0), 0.1, (20, 20, 20))
    points, normals = np.array([[0.5, 0.5, 1.8]]), np.array([[0.0, 0.0, -1.0]])
    given = np.zeros(3), np.array([1.8, 0, 0, 1.0, 0]), np.eye(5), 40.0, 1
    with ul.sink(f"viewer:{tmp_path / 'map.rrd'}") as sink:
        ceiling = MappedSurface("plane", *given, True, points, normals)
        sink.write(ul.OccupancyMap(grid, np.zeros(grid.shape, np.int8), surfaces=(ceiling,)))
    ((_, strips),) = rows(tmp_path / "map.rrd", "world/surfaces/plane", "strips")
    assert np.asarray(strips).shape == (2, 2, 3)
    np.testing.assert_allclose(np.asarray(strips)[..., 2], 1.8, atol=1e-6)
