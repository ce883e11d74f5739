"""Several instruments as one source, with poses of another port: scripted ones, then simulated devices to a map."""

from __future__ import annotations

import itertools
import math
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ullage as ul
from ullage.cli import main
from ullage.data import gathered
from ullage.errors import InputError
from ullage.ports.instruments import group
from ullage.ports.instruments.group import InstrumentGroup, LiveTarget, mounted, named
from ullage.ports.instruments.simulated import SimulatedMrm, SimulatedX4
from ullage.ports.instruments.source import NotReadyError
from ullage.ports.live import Address
from ullage.ports.pose_events import ModelPose, Notice

sys.path.insert(0, str(Path(__file__).parents[1] / "mavlink"))
SPEC = ul.RadarSpec.preset("x4m05", bins=16)
MOUNT = ul.MountSpec(position_m=(0.1, 0.2, 0.3), yaw_deg=90)
NAMES = ("front", "left", "back", "right")


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is late: only what a test keeps silent gives nothing."""
    for name in ("ORDER_S", "POSE_S", "FIRST_POSE_S", "PATIENCE_S"):
        monkeypatch.setattr(group, name, 120.0)
    monkeypatch.setattr("ullage.ports.instruments.x4.ANSWER_S", 120.0)
    monkeypatch.setattr("ullage.ports.instruments.x4.SILENCE_S", 120.0)


class Scripted:
    """Address and source in one: gives these times in batches, then ends or fails."""

    scheme = "x4"

    def __init__(self, name: str, batches: list[list[int]], *, spec: ul.RadarSpec = SPEC, error: Any = None) -> None:
        self.options, self._batches, self._spec, self._error = {"sensor": name, "duration_s": 1}, batches, spec, error
        self.lag_s, self.refusals, self.after = 2.0, list[InputError](), threading.Event()
        self.after.set()

    def __str__(self) -> str:
        return f"x4:{self.options['sensor']}"

    def open(self, part: str) -> Scripted:
        if self.refusals:
            raise self.refusals.pop(0)
        return self

    def stream(self) -> Any:
        self.after.wait(60)
        for batch in self._batches:
            samples = np.full((len(batch), self._spec.bins), 1 + 1j, np.complex64)
            name, spec = self.options["sensor"], self._spec.but()  # as set up anew: each batch is placed by itself
            yield {name: ul.Frames(samples, spec.range_m, np.array(batch), spec, sensor=name)}
            time.sleep(0)
        if self._error is not None:
            raise self._error

    def stop(self) -> None: ...

    def close(self) -> None: ...


class ScriptedPoses:
    """Gives these poses, then silence; sets an event once the last one was asked for."""

    def __init__(self, poses: list[ModelPose | Notice]) -> None:
        self._left, self.given = list(poses), threading.Event()

    def __str__(self) -> str:
        return "mavlink:scripted"

    def open(self, part: str) -> ScriptedPoses:
        assert part == "poses"
        return self

    def next(self, timeout_s: float) -> Any:
        if self._left:
            return self._left.pop(0)
        self.given.set()
        time.sleep(0.01)
        return None

    def close(self) -> None: ...


def present_ns() -> int:
    return time.time_ns() // 1_000_000_000 * 1_000_000_000


def pieces_of(addresses: list[Any], poses: Any = None) -> tuple[list[dict[str, ul.Frames]], list[str]]:
    said: list[str] = []
    with InstrumentGroup(addresses, poses, log=said.append) as source:
        return list(source.stream()), said


def test_frames_of_all_instruments_come_once_and_in_order_of_time() -> None:
    rng, zero = np.random.default_rng(5), present_ns()
    addresses, sent = [], {}
    for number, name in enumerate(NAMES):
        times = (zero + np.arange(200) * 58_823_529 + number * 9_000_000).tolist()
        cuts = [0, *sorted(rng.choice(np.arange(1, 200), 60, replace=False).tolist()), 200]
        addresses.append(Scripted(name, [times[a:b] for a, b in itertools.pairwise(cuts)]))
        sent[name] = times
    pieces, said = pieces_of(addresses)
    assert {name: part.t_ns.tolist() for name, part in gathered(pieces).items()} == sent
    begins = [min(int(part.t_ns[0]) for part in piece.values()) for piece in pieces]
    ends = [max(int(part.t_ns[-1]) for part in piece.values()) for piece in pieces]
    assert all(begin > end for begin, end in zip(begins[1:], ends, strict=False))
    assert said == []


def path(zero_ns: int, k: int) -> ModelPose:
    """A straight flight at 2 m/s along y that turns by 0.5 rad/s."""
    t_s = 0.02 * k
    return ModelPose(zero_ns + k * 20_000_000, (1.0, 2.0 * t_s, 3.0), (0.0, 0.0, math.sin(t_s / 4), math.cos(t_s / 4)))


def test_frames_are_at_the_poses_of_their_times_behind_the_mount() -> None:
    zero = present_ns()
    times = [zero + 7_000_000 + k * 58_823_529 for k in range(60)]
    left = Scripted("left", [[t] for t in times], spec=SPEC.but(mount=MOUNT))
    poses = ScriptedPoses([path(zero, k) for k in range(200)])
    left.after = poses.given
    pieces, _ = pieces_of([left], poses)
    frames = gathered(pieces)["left"]
    t_s = (np.array(times) - zero) * 1e-9
    flown = ul.Trajectory(
        np.array(times), np.column_stack([np.ones(60), 2 * t_s, np.full(60, 3.0)]),
        np.column_stack([np.zeros((60, 2)), np.sin(t_s / 4), np.cos(t_s / 4)]),
    )  # fmt: skip
    wanted = flown.mounted(MOUNT.body_from_sensor())
    np.testing.assert_allclose(frames.believed.position, wanted.position, atol=1e-6)
    np.testing.assert_allclose(frames.believed.quat_xyzw, wanted.quat_xyzw, atol=1e-9)
    np.testing.assert_allclose(frames.believed.rates[0][1:], wanted.rates[0][1:], atol=0.01)  # by the frame before


def test_frames_without_poses_are_kept_and_said_in_one_line_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the first pose, in a gap that is too long, and after the last one."""
    zero = present_ns()
    times = [zero + 7_000_000 + k * 50_000_000 for k in range(100)]
    front = Scripted("front", [times[k : k + 3] for k in range(0, 100, 3)])
    known = [k for k in range(50, 200) if not 80 <= k <= 140]  # from 1 s on, none from 1.6 to 2.8 s, none after 4 s
    poses = ScriptedPoses([path(zero, k) for k in known])
    front.after = poses.given
    monkeypatch.setattr(group, "POSE_S", 0.5)
    pieces, said = pieces_of([front], poses)
    rows = [(t, part.poses is not None) for piece in pieces for part in piece.values() for t in part.t_ns.tolist()]
    assert [t for t, _ in rows] == times
    for t, posed in rows:
        t_s = (t - zero) * 1e-9
        assert posed == (1.0 <= t_s <= 1.58 or 2.82 <= t_s <= 3.98), t_s
    lost = [line for line in said if "no poses; frames are kept" in line]
    assert len(lost) == 2
    assert sum("poses come again" in line for line in said) == 1
    assert f"{sum(not posed for _, posed in rows)} of 100 frames have no pose" in said


def test_poses_of_another_clock_count_from_their_arrival() -> None:
    begun = time.time()

    class Now(ScriptedPoses):
        """An autopilot without TIMESYNC, which started a quarter of an hour ago; x is the time since the test began."""

        def next(self, timeout_s: float) -> Any:
            time.sleep(0.02)
            s = time.time() - begun
            return ModelPose(round((s + 900) * 1e9), (s, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))

    front = Scripted("front", [[round((begun + 0.05 * k) * 1e9)] for k in range(4, 30)])
    pieces, _ = pieces_of([front], Now([]))
    frames = gathered([piece for piece in pieces if piece["front"].poses is not None])["front"]
    assert len(frames)
    assert abs(frames.believed.position[:, 0] - (frames.t_ns * 1e-9 - begun)).max() < 0.5


def test_an_instrument_that_fails_does_not_stop_the_others() -> None:
    zero = present_ns()
    times = [zero + k * 50_000_000 for k in range(30)]
    good, bad = Scripted("good", [[t] for t in times]), Scripted("bad", [times[:3]], error=ValueError("no\nway"))
    pieces, said = pieces_of([good, bad])
    assert {name: len(part) for name, part in gathered(pieces).items()} == {"good": 30, "bad": 3}
    assert said == ["x4:bad: ended by ValueError: no way"]


def test_an_instrument_that_is_not_ready_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(group, "RETRY_S", 0.01)
    times = [present_ns() + k * 50_000_000 for k in range(30)]
    early, late = Scripted("early", [[t] for t in times]), Scripted("late", [times])
    late.refusals = [NotReadyError("no such device", where="x4:late") for _ in range(3)]
    pieces, said = pieces_of([early, late])
    assert {name: len(part) for name, part in gathered(pieces).items()} == {"early": 30, "late": 30}
    assert said == ["x4:late: no such device; waiting for it", "x4:late: measures"]


def test_what_cannot_be_is_said_in_one_line() -> None:
    one, other = Scripted("a", []), Scripted("b", [])
    one.refusals = [NotReadyError("no such device", where="x4:a")]
    other.refusals = [NotReadyError("in use", where="x4:b")]
    with pytest.raises(NotReadyError, match="x4:a: no such device"):
        InstrumentGroup([one, other])
    other.refusals = [InputError("no option 'volume'", where="x4:b")]
    with pytest.raises(InputError, match="no option 'volume'"):
        InstrumentGroup([one, other])
    addresses = [Address.of("x4:/dev/a"), Address.of("x4:/dev/b?fps=10")]
    with pytest.raises(InputError, match=r"x4:/dev/a and x4:/dev/b: two radars are named 'x4' \(allowed: sensor=NAME"):
        named(addresses)
    with pytest.raises(InputError, match=r"x4:/dev/a: no radar 'x4' in the rig \(allowed: front, left"):
        mounted(addresses[:1], ul.Rig.preset("thesis-4"))
    with pytest.raises(InputError, match=r"'cargo-hold' together with other sources \(allowed: instruments: x4:, mrm:"):
        LiveTarget.of(["x4:/dev/a", "cargo-hold"])
    with pytest.raises(InputError, match=r"'cargo-hold' together with a port of poses"):
        LiveTarget.of(["cargo-hold"], "mavlink:udpin://:14550")
    with pytest.raises(InputError, match=r"--poses: no poses come from 'x4:/dev/b' \(allowed: ros2:, imc:, mavlink:\)"):
        LiveTarget.of(["x4:/dev/a"], "x4:/dev/b")


def test_a_rig_gives_the_mounts_that_an_address_does_not_have() -> None:
    rig = ul.Rig.preset("thesis-4")
    texts = ["x4:/dev/a?sensor=left", "mrm:host?sensor=back&mount={yaw_deg: 33}"]
    left, back = mounted([Address.of(text) for text in texts], rig)
    assert left.options["mount"] == rig.sensors["left"].mount
    assert back.options["mount"] == "{yaw_deg: 33}"


@pytest.fixture
def devices() -> Any:
    pytest.importorskip("serial")
    made = [SimulatedX4() for _ in range(4)]
    yield made
    for one in made:
        one.close()


def test_an_x4_and_a_pulson_are_received_together() -> None:
    pytest.importorskip("serial")
    x4, mrm = SimulatedX4(), SimulatedMrm()
    texts = [f"x4:{x4.path}?fps=17&iterations=8&duration_s=2&lag=0", f"mrm:{mrm.address}?fps=17&duration_s=2&lag=0"]
    try:
        with InstrumentGroup([Address.of(text) for text in texts], log=[].append) as source:
            assert source.sensors == ("x4", "mrm")
            frames = source.frames()
    finally:
        x4.close()
        mrm.close()
    assert {name: len(part) >= 30 for name, part in frames.items()} == {"x4": True, "mrm": True}  # 2 s by their clocks
    assert frames["mrm"].samples.dtype == np.float32
    apart_s = 1e-9 * (frames["x4"].t_ns[:, None] - frames["mrm"].t_ns)
    assert np.median(np.abs(apart_s).min(1)) < 0.06  # one clock: a frame of either is near one of the other


def test_four_devices_and_an_autopilot_give_a_map_by_one_command(devices: Any, tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    from mavlink_autopilot import Autopilot, local_poses

    poses = local_poses(lambda t_s: (0.2 * math.sin(t_s), 0.2 * math.cos(t_s), -1.0))
    words = [
        f"x4:{x4.path}?sensor={name}&fps=17&iterations=8&bins=96&duration_s=3&lag=0"
        for x4, name in zip(devices, NAMES, strict=True)
    ]
    words[3] += "&mount={yaw_deg: -80}"
    with Autopilot(poses=poses, boot_ns=-time.monotonic_ns() + 10**12) as pilot:
        port = f"mavlink:udp://127.0.0.1:{pilot.port}"
        main_ok(["run", *words, "--poses", port, "-o", "sensing.rig=thesis-4", "--out", str(tmp_path / "runs"),
                 "--to", str(tmp_path / "all.mcap")])  # fmt: skip
    (folder,) = (one for one in (tmp_path / "runs").iterdir() if not one.is_symlink())
    assert (folder / "map.yaml").exists()
    pieces = list(ul.open(tmp_path / "all.mcap").stream())
    for name, yaw_deg in zip(NAMES, (0, 90, 180, -80), strict=True):
        parts = [piece[name] for piece in pieces if name in piece]
        assert sum(map(len, parts)) >= 45  # 3 s by the frames' own clock
        assert parts[0].spec.mount.yaw_deg == pytest.approx(yaw_deg)
        posed = gathered({name: part} for part in parts if part.poses is not None)[name]
        away = posed.believed.position - posed.spec.mount.position_m
        np.testing.assert_allclose(away[:, 2], 1.0, atol=0.01)
        assert np.hypot(*away[:, :2].T).max() < 0.45
        assert len(posed) >= 20


def main_ok(words: list[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert not end.value.code
