"""ullage: simulate ultra-wideband radars on a drone, and turn echoes into detections, images and maps.

Names are loaded when first used, so that importing the package stays quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what editors, type checkers and the documentation see of the names below
    from ullage import worlds as worlds
    from ullage.config import GuardSpec as GuardSpec
    from ullage.data import Detections as Detections
    from ullage.data import Frames as Frames
    from ullage.data import Metric as Metric
    from ullage.data import Trajectory as Trajectory
    from ullage.errors import InputError as InputError
    from ullage.errors import UllageError as UllageError
    from ullage.errors import UllageWarning as UllageWarning
    from ullage.experiments.dataset import dataset as dataset
    from ullage.flight.missions import Waypoints as Waypoints
    from ullage.flight.navigation import navigate as navigate
    from ullage.flight.vehicle import fly as fly
    from ullage.flight.vehicle import fly_log as fly_log
    from ullage.geometry import C0 as C0
    from ullage.grids import Grid as Grid
    from ullage.grids import Image as Image
    from ullage.grids import OccupancyMap as OccupancyMap
    from ullage.pipeline import run as run
    from ullage.pipeline import sink as sink
    from ullage.ports.registry import open as open
    from ullage.processing import metrics as metrics
    from ullage.processing.calibrate import calibrate as calibrate
    from ullage.processing.detect import detect as detect
    from ullage.processing.guard import Guard as Guard
    from ullage.processing.obstacles import ObstacleSectors as ObstacleSectors
    from ullage.processing.obstacles import ObstacleStage as ObstacleStage
    from ullage.processing.occupancy import map_occupancy as map_occupancy
    from ullage.processing.own_echo import own_echo as own_echo
    from ullage.processing.sar import focus as focus
    from ullage.radar.explain import explain as explain
    from ullage.radar.live import LiveRadars as LiveRadars
    from ullage.radar.receiver_fit import Receiver as Receiver
    from ullage.radar.simulate import simulate as simulate
    from ullage.specs import AntennaSpec as AntennaSpec
    from ullage.specs import MountSpec as MountSpec
    from ullage.specs import NoiseSpec as NoiseSpec
    from ullage.specs import RadarSpec as RadarSpec
    from ullage.specs import Rig as Rig
    from ullage.specs import ThesisSpec as ThesisSpec
    from ullage.view import figures as figures
    from ullage.world import scenes as scenes
    from ullage.world.load import load_scene as load_scene
    from ullage.world.scene import Scene as Scene

__version__ = "0.1.0"

_HOMES = {
    "C0": "geometry",
    "InputError": "errors",
    "UllageError": "errors",
    "UllageWarning": "errors",
    "AntennaSpec": "specs",
    "MountSpec": "specs",
    "NoiseSpec": "specs",
    "RadarSpec": "specs",
    "Rig": "specs",
    "ThesisSpec": "specs",
    "Guard": "processing.guard",
    "GuardSpec": "config",
    "ObstacleSectors": "processing.obstacles",
    "ObstacleStage": "processing.obstacles",
    "Detections": "data",
    "Frames": "data",
    "Metric": "data",
    "Trajectory": "data",
    "Grid": "grids",
    "Image": "grids",
    "OccupancyMap": "grids",
    "Scene": "world.scene",
    "load_scene": "world.load",
    "Waypoints": "flight.missions",
    "fly": "flight.vehicle",
    "fly_log": "flight.vehicle",
    "navigate": "flight.navigation",
    "simulate": "radar.simulate",
    "LiveRadars": "radar.live",
    "Receiver": "radar.receiver_fit",
    "explain": "radar.explain",
    "detect": "processing.detect",
    "focus": "processing.sar",
    "calibrate": "processing.calibrate",
    "own_echo": "processing.own_echo",
    "map_occupancy": "processing.occupancy",
    "open": "ports.registry",
    "sink": "pipeline",
    "run": "pipeline",
    "dataset": "experiments.dataset",
}
_MODULES = {"scenes": "world.scenes", "metrics": "processing.metrics", "worlds": "worlds", "figures": "view.figures"}

__all__ = sorted([*_HOMES, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value: Any = importlib.import_module(f"ullage.{_MODULES[name]}")
    elif name in _HOMES:
        value = getattr(importlib.import_module(f"ullage.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module 'ullage' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
