"""The loop: everything reaches every sink, Ctrl-C ends cleanly, a failing sink does not lose the others."""

from __future__ import annotations

import pstats
import signal
import weakref
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from cProfile import Profile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ullage as ul
from ullage import cli
from ullage.experiments.ros2_nodes import MappingOptions, mapping_stages
from ullage.experiments.run import RangeTime, SampledFrames
from ullage.flow import Due
from ullage.pipeline import DetectStage, ImageStage, InMemorySource, MapStage
from ullage.ports.publisher import Publisher
from ullage.processing.own_echo import OwnEchoFilter
from ullage.stop_signals import StopFlag, raise_if_stopped, stop_as_ctrl_c


def thesis_frames(n: int = 60) -> ul.Frames:
    path = ul.Trajectory.line((-1, 0, 0), (1, 0, 0), 0.5, n / 4)[:n]
    return ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, ul.RadarSpec.preset("x4m05"), fidelity="thesis", seed=3)


class Kept:
    def __init__(self) -> None:
        self.items: list[Any] = []
        self.closed = False

    def write(self, item: Any) -> None:
        self.items.append(item)

    def close(self) -> None:
        self.closed = True


class Cut:
    """A source that is interrupted after `after` pieces."""

    def __init__(self, frames: ul.Frames, after: int) -> None:
        self.frames, self.after = frames, after

    def stream(self) -> Iterator[dict[str, ul.Frames]]:
        for index, part in enumerate(self.frames.chunks(10)):
            if index == self.after:
                raise KeyboardInterrupt
            yield {"front": part}


class Foreign:
    """A stage in whose second piece Ctrl-C comes, in code that makes another error of any exception."""

    pieces = 0

    def update(self, chunk: dict[str, ul.Frames]) -> list[Any]:
        self.pieces += 1
        try:
            if self.pieces == 2:
                signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise TypeError("Cannot compare structured arrays") from error
        return []

    def finish(self) -> list[Any]:
        return []


@pytest.mark.usefixtures("heeded_signals")
def test_ctrl_c_ends_a_run_after_the_piece_under_way() -> None:
    frames, kept, stage = thesis_frames(), Kept(), Foreign()
    outcome = ul.run(InMemorySource(frames, size=7), stages=[stage, DetectStage()], sinks=[kept])
    assert outcome.interrupted
    assert (stage.pieces, outcome.frames) == (2, 14)
    assert kept.closed


@pytest.mark.usefixtures("heeded_signals")
@pytest.mark.parametrize("flagged", [False, True])
def test_an_error_that_foreign_code_makes_of_ctrl_c_ends_a_command_as_ctrl_c_does(
    flagged: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stage = Foreign()

    def command(*words: object, **options: object) -> None:
        with StopFlag(raises_at=1) if flagged else nullcontext():
            for _ in range(2):
                stage.update({})

    monkeypatch.setattr(cli, "app", command)
    with pytest.raises(SystemExit) as ended:
        cli.main([])
    assert ended.value.code == 130
    assert capsys.readouterr().err == "ullage: interrupted\n"


@pytest.mark.usefixtures("heeded_signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_sets_the_flag_and_the_second_raises(number: signal.Signals) -> None:
    with stop_as_ctrl_c(), StopFlag() as stop:
        assert not stop.requested
        signal.raise_signal(number)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)


@pytest.mark.usefixtures("heeded_signals")
def test_ctrl_c_that_was_lost_ends_its_own_work_and_not_the_next() -> None:
    with stop_as_ctrl_c():
        with StopFlag(raises_at=1), suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            raise_if_stopped()
    with StopFlag(raises_at=1), suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    raise_if_stopped()
    with stop_as_ctrl_c():
        raise_if_stopped()


def test_every_frame_reaches_the_sink_and_the_map_is_that_of_the_whole() -> None:
    frames = thesis_frames()
    grid = ul.Grid.covering([[-4, -3, 0], [4, 3, 1]], 0.1)
    kept = Kept()
    stages = [DetectStage(), MapStage(grid, "elfes")]
    outcome = ul.run(InMemorySource(frames, size=7), stages=stages, sinks=[kept])
    assert outcome.frames == len(frames)
    assert sum(len(item[frames.sensor]) for item in kept.items if isinstance(item, dict)) == len(frames)
    assert kept.closed
    whole = ul.map_occupancy(frames, grid, method="elfes")
    assert np.array_equal(outcome.results[-1].percent, whole.percent)


def test_every_detection_is_counted() -> None:
    frames = ul.simulate(ul.scenes.room((4, 3, 3)), ul.Trajectory.line((-1, 0, 0), (1, 0, 0), 0.5, 9),
                         ul.RadarSpec.preset("x4m05"), seed=3)  # fmt: skip
    stage, kept = DetectStage(None, own_echo=None), Kept()
    ul.run(frames, stages=[stage], sinks=[kept])
    given = [item for item in kept.items if isinstance(item, ul.Detections)]
    assert stage.found == sum(map(len, given)) == len(ul.detect(frames, method="peaks", remove_own_echo=False))
    assert stage.found > len(frames)
    rays, first = thesis_frames(), DetectStage(None, own_echo=None)
    ul.run(rays, stages=[first])
    assert first.found == len(ul.detect(rays, method="first_peak", remove_own_echo=False)) <= len(rays)


def test_frames_in_memory_are_a_source() -> None:
    frames = thesis_frames()
    for source in (frames, {"front": frames}, [frames]):
        outcome = ul.run(source, stages=[DetectStage()])
        assert outcome.frames == len(frames)
    with pytest.raises(ul.InputError, match=r"run: the source is a str \(allowed: ul.open"):
        ul.run("flight.mcap")  # type: ignore[arg-type]
    with pytest.raises(ul.InputError, match="no frames"):
        ul.run({})


@pytest.mark.parametrize("method", ["elfes", "ullage"])
def test_a_live_flight_may_leave_the_grid_and_come_back(method: str) -> None:
    """The map is that of what was seen from inside; that it goes out is said once each time."""
    there = np.concatenate([np.linspace(0, 1, 25), np.linspace(1, 0, 25), np.linspace(0, 1, 25)])
    path = ul.Trajectory(
        np.arange(75) * 66_000_000, np.array([[0.5 + x, 0, 0] for x in there]), np.tile([0, 0, 0, 1.0], (75, 1))
    )
    frames = ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, ul.RadarSpec.preset("x4m05"), fidelity="thesis")
    grid = ul.Grid.covering([[-4, -3, 0], [1.0, 3, 1]], 0.1)
    with pytest.raises(ul.InputError, match="does not hold the flight"):
        ul.run(InMemorySource(frames, size=7), stages=[MapStage(grid, method)])
    with pytest.warns(ul.UllageWarning, match=r"left the map \(x -4\.0") as said:
        outcome = ul.run(InMemorySource(frames, size=7), stages=[MapStage(grid, method, live=True)])
    inside = frames[grid.index(frames.believed.position)[1]]
    assert 0 < len(inside) < len(frames)
    assert np.array_equal(outcome.results[-1].percent, ul.map_occupancy(inside, grid, method=method).percent)
    assert len([note for note in said if "left the map" in str(note.message)]) == 2


def test_detections_count_frames_from_the_start_of_the_recording() -> None:
    frames = thesis_frames()
    kept = Kept()
    ul.run(InMemorySource(frames, size=7), stages=[DetectStage()], sinks=[kept])
    found = np.concatenate([item.frame for item in kept.items if isinstance(item, ul.Detections)])
    assert np.array_equal(found, ul.detect(frames).frame)


def test_ctrl_c_ends_with_everything_so_far_written() -> None:
    kept = Kept()
    grid = ul.Grid.covering([[-4, -3, 0], [4, 3, 1]], 0.1)
    outcome = ul.run(Cut(thesis_frames(), 3), stages=[MapStage(grid, "elfes")], sinks=[kept])
    assert outcome.interrupted
    assert outcome.frames == 30
    assert kept.closed
    assert isinstance(kept.items[-1], ul.OccupancyMap)


@pytest.mark.parametrize("parts", [{"stages": ["map"]}, {"sinks": ["flight.mcap"]}])
def test_names_are_no_stages_or_sinks(parts: dict[str, Any]) -> None:
    with pytest.raises(ul.InputError, match="objects with"):
        ul.run(thesis_frames(3), **parts)


def test_sinks_are_closed_when_the_source_fails() -> None:
    class Broken:
        def stream(self) -> Iterator[dict[str, ul.Frames]]:
            raise ul.InputError("gone", where="port")
            yield {}

    kept = Kept()
    with pytest.raises(ul.InputError, match="gone"):
        ul.run(Broken(), sinks=[kept])
    assert kept.closed


def test_what_is_watched_stays_bounded() -> None:
    frames = thesis_frames()
    picture, sampled = RangeTime(most=8), SampledFrames(most=8)
    for part in frames.chunks(5):
        picture.update({"front": part})
        sampled.update({"front": part})
    (name, t_s, range_m, amplitude) = picture.pictures()[0]
    assert name == "front"
    assert 4 <= len(t_s) <= 8
    assert amplitude.shape == (len(t_s), len(range_m))
    assert amplitude.max() == pytest.approx(float(frames.amplitude[: len(t_s) * 8].max()), rel=0.2)
    assert 4 <= len(sampled.frames()["front"]) <= 9


def test_what_is_kept_of_a_piece_does_not_keep_the_piece() -> None:
    frames = rig_frames(32)
    publisher = Publisher()
    given = [
        SampledFrames(most=8).update,
        OwnEchoFilter(most=8).learn,
        lambda chunk: publisher.messages(chunk["left"].poses),
    ]
    for keep in given:
        chunk = {name: part[np.arange(32)] for name, part in frames.items()}
        poses = [part.poses for part in chunk.values() if part.poses is not None]
        arrays = [weakref.ref(part.samples) for part in chunk.values()]
        arrays += [weakref.ref(path.position) for path in poses]
        keep(chunk)
        del chunk, poses
        assert [array() is None for array in arrays] == [True] * 4, keep


def test_a_threshold_for_detections_does_not_break_the_map() -> None:

    spec = ul.RadarSpec.preset("x4m05")
    path = ul.Trajectory.line((0, 0, 0), (0.2, 0, 0), rate_hz=25)
    noise = 1e-5 * (np.random.default_rng(1).normal(size=(len(path), spec.bins, 2)) @ [1, 1j])
    frames = ul.Frames(noise.astype(np.complex64), spec.range_m, path.t_ns, spec, poses=path)
    stage = MapStage(ul.Grid((-1, -1, 0), 0.1, (20, 20)), "ullage", threshold=0.1)
    assert len([*stage.update({"radar": frames}), *stage.finish()]) == 2


def rig_frames(n: int = 120) -> dict[str, ul.Frames]:
    """Two radars with direct path, past a wire."""
    path = ul.Trajectory.line((-1, 0, 0), (1, 0, 0), 0.5, n / 4)[:n]
    scene = ul.scenes.wire(radius_m=0.01, length_m=2.0, distance_m=2.0)
    out = {}
    for name, yaw in (("front", 0.0), ("left", 90.0)):
        spec = ul.RadarSpec.preset("x4m05", mount={"yaw_deg": yaw})
        frames = ul.simulate(scene, path, ul.Rig(sensors={name: spec}), seed=3)
        out |= frames if isinstance(frames, dict) else {name: frames}
    return out


@pytest.mark.parametrize("held", [2048, 25])
def test_an_image_grows_as_the_flight_goes_on_and_ends_as_the_whole_one(held: int) -> None:
    frames = rig_frames()
    grid = ul.Grid.covering([[-1, -1, 0], [3, 2, 0.1]], 0.05, z_m=0.0)
    finals = {}
    for every_s in (None, 0.2):
        kept = Kept()
        stage = ImageStage(grid, every_s=every_s, held_frames=held)
        ul.run(InMemorySource(frames, size=4), stages=[stage], sinks=[kept])
        images = [item for item in kept.items if isinstance(item, ul.Image)]
        finals[every_s] = images[-1]
        assert len(images) == (1 if every_s is None else pytest.approx(4.0 / 0.2, abs=2))
    strongest = np.abs(finals[None].values).max()
    assert np.array_equal(finals[0.2].values, finals[None].values)  # to the bit
    assert np.array_equal(finals[0.2].coherence, finals[None].coherence)
    early = images[-2].values  # without the last piece, and less sure of the own echo
    assert np.abs(np.abs(early) - np.abs(finals[None].values)).max() < 0.2 * strongest
    assert np.abs(images[1].values).max() > 0


def test_no_piece_of_a_growing_image_sums_more_than_four_times_its_frames() -> None:
    frames = rig_frames()
    grid = ul.Grid.covering([[-1, -1, 0], [3, 2, 0.1]], 0.05, z_m=0.0)
    stage = ImageStage(grid, every_s=0.2, held_frames=40)
    sums = []
    for start in range(0, 120, 4):
        chunk = {name: part[start : start + 4] for name, part in frames.items()}
        profile = Profile()
        profile.runcall(lambda chunk=chunk: list(stage.update(chunk)))
        calls = pstats.Stats(profile).stats
        sums.append(sum(row[0] for (file, _, name), row in calls.items()
                        if name == "update" and Path(file).stem == "backprojection"))  # fmt: skip
    assert min(sums) == 2  # one for each radar
    assert max(sums) == 8
    assert sum(sums) > 100  # those that waited are summed on the way


@pytest.mark.parametrize("period_s", [0.0588, 0.1, 0.13])
def test_what_is_due_five_times_a_second_comes_five_times_a_second(period_s: float) -> None:
    due = Due(0.2)
    count = sum(due.reached(round(k * period_s * 1e9)) for k in range(round(20 / period_s)))
    assert count == pytest.approx(100, abs=2)


def test_what_is_due_comes_again_after_the_clock_steps_back() -> None:
    due = Due(1.0)
    assert due.reached(100_000_000_000)
    assert not due.reached(100_500_000_000)
    assert due.reached(3_000_000_000)
    assert not due.reached(3_500_000_000)
    assert due.reached(4_000_000_000)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_step_of_the_clock_does_not_count_as_duration(step_s: float) -> None:
    frames = thesis_frames()
    covered_s = float(frames.t_ns[-1] - frames.t_ns[0]) * 1e-9
    later = replace(frames, t_ns=frames.t_ns + round(step_s * 1e9) + 4 * 10**12, poses=None, truth=None)
    first = replace(frames, t_ns=frames.t_ns + 4 * 10**12, poses=None, truth=None)
    done: list[float] = []

    class Stepped:
        def stream(self) -> Iterator[dict[str, ul.Frames]]:
            yield {"front": first}
            yield {"front": later}

    outcome = ul.run(Stepped(), progress=done.append)
    assert outcome.duration_s == pytest.approx(covered_s * (2 if step_s > 0 else 1))
    assert done[-1] == outcome.duration_s


def test_the_duration_of_slow_frames_is_that_of_their_stamps() -> None:
    frames = thesis_frames()[:20]
    slow = replace(frames, t_ns=np.arange(20) * 5_000_000_000, poses=None, truth=None)
    assert ul.run(slow).duration_s == pytest.approx(95.0)


def test_the_stages_of_the_mapping_node_estimate_the_own_echo_once() -> None:
    frames = thesis_frames()[:4]
    stages = mapping_stages({"front": frames}, MappingOptions(image=True))
    echoes = {id(stage.own_echo) for stage in stages if isinstance(stage, DetectStage | MapStage | ImageStage)}
    assert len(stages) == 3
    assert len(echoes) == 1


def test_a_map_larger_than_memory_is_refused_before_the_flight() -> None:
    grid = ul.Grid((0, 0, 0), 1e-4, (60_000, 40_000))
    with pytest.raises(ul.InputError, match=r"takes 7\.2 GB"):
        MapStage(grid)
