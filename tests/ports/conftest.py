"""Frames to write and read back."""

from __future__ import annotations

import os
import shutil
import subprocess
import uuid
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.ports.imc.codec import Message

IGN_TOPIC = Path("/usr/libexec/ignition/transport11/ign-transport-topic")
"""Debian's tool of Gazebo Transport."""


def some_frames(n: int = 40, *, seed: int = 0, sensor: str = "front", real: bool = False, bins: int = 24) -> ul.Frames:
    """Noise on a tumbling path, believed a little wrong."""
    rng = np.random.default_rng(seed)
    spec = ul.RadarSpec.preset("x4m05", bins=bins, range_start_m=0.3, fps=25, output="rf" if real else "baseband")
    t_ns = 1_700_000_000_000_000_000 + np.cumsum(rng.integers(1, 80_000_000, n))
    truth = tumbling(t_ns, rng)
    samples = rng.normal(size=(n, bins, 2)).astype(np.float32)
    return ul.Frames(
        samples[..., 0] if real else samples.view(np.complex64)[..., 0],
        spec.range_m,
        t_ns,
        spec,
        poses=tumbling(t_ns, rng),
        truth=truth,
        sensor=sensor,
        unit="thesis" if real else "path_gain",
    )


def tumbling(t_ns: np.ndarray, rng: np.random.Generator) -> ul.Trajectory:
    """A path with nothing even about it."""
    quat = rng.normal(size=(len(t_ns), 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    return ul.Trajectory(t_ns, rng.normal(size=(len(t_ns), 3)), quat)


def assert_same(got: ul.Frames, want: ul.Frames) -> None:
    """To the last bit."""
    assert got.samples.dtype == want.samples.dtype
    assert got.samples.tobytes() == want.samples.tobytes()
    assert got.range_m.tobytes() == want.range_m.tobytes()
    assert got.t_ns.tobytes() == want.t_ns.tobytes()
    assert (got.spec, got.sensor, got.unit, got.calibration) == (want.spec, want.sensor, want.unit, want.calibration)
    for a, b in ((got.poses, want.poses), (got.truth, want.truth), (got.track, want.track)):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert a.t_ns.tobytes() == b.t_ns.tobytes()
            for x, y in zip((a.position, a.quat_xyzw, *a.rates), (b.position, b.quat_xyzw, *b.rates), strict=True):
                assert x.tobytes() == y.tobytes()


@pytest.fixture
def frames() -> ul.Frames:
    """One sensor's."""
    return some_frames()


@pytest.fixture
def partition(monkeypatch):
    """Of Gazebo Transport, for one test alone."""
    pytest.importorskip("zmq")
    pytest.importorskip("google.protobuf")
    name = f"ullage-test-{uuid.uuid4().hex[:8]}"
    for key in ("IGN", "GZ"):
        monkeypatch.setenv(f"{key}_PARTITION", name)
        monkeypatch.setenv(f"{key}_IP", "127.0.0.1")
    return name


@pytest.fixture
def ign_topic(partition):
    """Starts Debian's `ign topic` with arguments; what still runs at the end is ended."""
    if not IGN_TOPIC.exists():
        pytest.skip("ignition-transport-cli is not installed")
    running = []

    def start(*words):
        running.append(subprocess.Popen([IGN_TOPIC, *words], stdout=subprocess.PIPE, text=True, env=os.environ))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


def same_message(one: Message, other: Message) -> None:
    """Both messages say the same, to what a quaternion and 32 bits keep."""
    assert one.name == other.name
    assert one.values.keys() == other.values.keys()
    for key, value in one.values.items():
        got = other[key]
        if isinstance(value, tuple):
            assert len(value) == len(got)
            for a, b in zip(value, got, strict=True):
                same_message(a, b)
        elif isinstance(value, float):
            assert got == pytest.approx(value, rel=1e-9, abs=1e-6), key
        else:
            assert got == value, key


def compiled(source: Path, folder: Path) -> Path:
    """Compile a C++ program on Gazebo's transport library, or skip the test."""
    if not (shutil.which("g++") and shutil.which("pkg-config")):
        pytest.skip("no g++ and pkg-config")
    words = ["pkg-config", "--cflags", "--libs", "ignition-transport11"]
    flags = subprocess.run(words, capture_output=True, text=True, check=False)
    if flags.returncode:
        pytest.skip("libignition-transport-dev (11) is not installed")
    out = folder / source.stem
    subprocess.run(["g++", "-O0", "-w", source, "-o", out, *flags.stdout.split()], check=True)
    return out
