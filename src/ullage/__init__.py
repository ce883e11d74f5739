"""ullage: simulate ultra-wideband radars on a drone, and turn echoes into detections, images and maps.

Names are loaded when first used, so that importing the package stays quick.
"""

from __future__ import annotations

import importlib
from typing import Any

from ullage.display import register_drawer

__version__ = "0.2.0"

_HOMES = {
    "C0": "geometry",
    "InputError": "errors",
    "UllageError": "errors",
    "UllageWarning": "errors",
    "AntennaSpec": "specs",
    "BodySpec": "specs",
    "BoxSpec": "specs",
    "MountSpec": "specs",
    "NoiseSpec": "specs",
    "RadarSpec": "specs",
    "Rig": "specs",
    "RotorSpec": "specs",
    "ThesisSpec": "specs",
    "Guard": "processing.guard",
    "GuardSpec": "config",
    "ObstacleSectors": "processing.obstacles",
    "ObstacleStage": "processing.obstacles",
    "Detections": "data",
    "Frames": "data",
    "Metric": "data",
    "Imu": "data",
    "Height": "data",
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
    "ImuSpec": "specs",
    "simulate_imu": "flight.imu",
    "simulate_height": "flight.imu",
    "simulate": "radar.simulate",
    "LiveRadars": "radar.live",
    "Receiver": "radar.receiver_fit",
    "explain": "radar.explain",
    "detect": "processing.detect",
    "focus": "processing.sar",
    "calibrate": "processing.calibrate",
    "plan_calibration": "processing.calibration_plan",
    "own_echo": "processing.own_echo",
    "odometry": "processing.odometry.odometry",
    "Odometry": "processing.odometry.odometry",
    "map_occupancy": "processing.occupancy",
    "open": "ports.registry",
    "read_imu": "ports.tracked",
    "sink": "pipeline",
    "run": "pipeline",
    "dataset": "experiments.dataset",
    "explore": "experiments.explore",
}
_MODULES = {"scenes": "world.scenes", "metrics": "processing.metrics", "worlds": "worlds", "figures": "view.figures"}
register_drawer("ullage.view.plots")

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
