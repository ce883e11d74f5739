"""Checks an installation, part by part."""

from __future__ import annotations

import importlib
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ullage.specs import Rig

NEEDED = (
    "numpy",
    "scipy",
    "numba",
    "embreex",
    "trimesh",
    "lxml",
    "mujoco",
    "pydantic",
    "mcap",
    "rosbags",
    "matplotlib",
)
OPTIONAL = {"pyoctomap": "octomap", "zarr": "zarr", "rerun": "view", "pymavlink": "mavlink", "distributed": "scale"}


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check."""

    name: str
    sound: bool
    found: str
    optional: bool = False


def checks() -> Iterator[Check]:
    """Python, libraries, kernels, worlds, disk."""
    yield Check("python", sys.version_info >= (3, 11), sys.version.split()[0])
    for name in NEEDED:
        yield _library(name)
    for name, extra in OPTIONAL.items():
        yield _library(name, extra=extra)
    yield _kernels()
    yield _rays()
    yield _worlds()
    yield _disk()


def _library(name: str, *, extra: str = "") -> Check:
    try:
        importlib.import_module(name)
        found, sound = version("rerun-sdk" if name == "rerun" else name), True
    except (ImportError, PackageNotFoundError) as error:
        found, sound = f"pip install 'ullage[{extra}]'" if extra else f"not usable: {error}", False
    return Check(name, sound, found, optional=bool(extra))


def _kernels() -> Check:
    from ullage.experiments.warmup import compiled
    from ullage.kernels.loops import cache_folder

    where = f"kept in {folder}" if (folder := cache_folder()) else "no folder to keep them in can be written"
    return Check("kernels", True, "compiled" if compiled() else f"will be compiled at the first run, {where}")


def _rays() -> Check:
    import numpy as np

    from ullage.world.raycast import Raycaster
    from ullage.world.scenes import plate

    _, distance = Raycaster(plate(width_m=1, height_m=1, distance_m=3)).hits(np.zeros(3), np.array([[1.0, 0.1, 0.1]]))
    return Check("ray casting", bool(abs(distance[0] - 3) < 1e-6), f"a plate at 3 m is met at {distance[0]:.6f} m")


def _worlds() -> Check:
    from ullage.world.library import WORLDS

    missing = [world.name for world in WORLDS.values() if not world.path.is_file()]
    return Check("worlds", not missing, f"{len(WORLDS)} found" if not missing else f"missing {', '.join(missing)}")


def _disk() -> Check:
    from ullage.specs import Rig

    rig, free = Rig.preset("thesis-4"), shutil.disk_usage(Path.cwd()).free
    low, high = (60e-6 * recording_rate(rig, sample_bytes=size) for size in (4, 8))
    text = f"{free / 1e9:.1f} GB free here (a minute of four radars takes {low:.0f} to {high:.0f} MB)"
    return Check("disk", free > 200e6, text)


def recording_rate(rig: Rig, *, sample_bytes: int) -> float:
    """Bytes a second that a recording of these radars takes.

    Noise keeps the samples and the profiles (4 bytes a bin) from being compressed. All else, a twentieth, is measured:
    poses, detections, and the map of the cargo hold.

    Args:
        rig: the radars.
        sample_bytes: 8 for complex baseband, 4 for the real samples of the thesis model.
    """
    return 1.05 * sum((sample_bytes + 4) * spec.bins * spec.fps for spec in rig.sensors.values())
