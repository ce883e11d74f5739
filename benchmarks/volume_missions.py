"""Ordinary inspection missions for maps of a volume: legs and rounds, straight, level or climbing evenly.

Each is flown by the simulated multirotor, heading along its way, with the thesis' four radars. The rooms and tanks of
the table are "room", "keg", "kettle", "tank", "basin" and "silo"; thresholds were chosen in "cabin", "vat" and "drum".
"""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.data import Frames
from ullage.world.scene import Scene

MISSIONS = ("climbing legs", "even climb", "rounds at 3 heights", "lawn-mower", "wall, leg over leg", "level round")


def world(name: str) -> Scene:
    """A room or an upright cylindrical tank, centred on the origin."""
    if name == "room":
        return ul.scenes.room((8.0, 6.0, 3.0), plate={"width_m": 1.0, "height_m": 2.0, "distance_m": 2.6})
    if name == "cabin":
        return ul.scenes.room((6.0, 4.5, 3.4), material="concrete")
    radius, height = {
        "tank": (4.0, 4.0),
        "vat": (3.2, 3.4),
        "drum": (2.6, 3.0),
        "silo": (6.0, 4.4),
        "keg": (2.5, 3.6),
        "kettle": (3.0, 3.0),
        "basin": (5.0, 4.0),
    }[name]
    return ul.scenes.cylinder(radius, height, 0.0, material="steel", edge_m=0.1)


def points(mission: str, name: str, seed: int) -> np.ndarray:
    """Waypoints (n, 3) of a mission in a world [m]."""
    rng = np.random.default_rng([seed, len(mission)])
    x, y, z = {
        "room": (2.3, 1.5, 0.8),
        "cabin": (1.6, 1.0, 0.9),
        "tank": (1.7, 1.7, 1.0),
        "vat": (1.2, 1.2, 0.8),
        "drum": (1.0, 1.0, 0.6),
        "silo": (3.0, 3.0, 1.2),
        "keg": (0.9, 0.9, 0.9),
        "kettle": (1.2, 1.2, 0.7),
        "basin": (2.4, 2.4, 1.1),
    }[name]
    low_x = -x
    if name == "room":
        x = 1.3
    loop = np.array([(low_x, -y), (x, -y), (x, y), (low_x, y)])
    if mission == "climbing legs":
        heights = [-z, -0.4 * z, 0.1 * z, 0.5 * z, z, 0.3 * z, -0.3 * z, -z]
        out = np.column_stack([np.tile(loop, (2, 1)), heights])
    elif mission == "even climb":
        way = np.tile(loop, (3, 1))
        out = np.column_stack([way, np.linspace(-z, z, len(way))])
    elif mission == "rounds at 3 heights":
        out = np.concatenate([np.column_stack([loop[[0, 1, 2, 3, 0]], np.full(5, h)]) for h in (-z, 0.0, z)])
    elif mission == "lawn-mower":
        lanes = np.linspace(-y, y, 4)
        sweep = np.array(
            [(e, lane) for k, lane in enumerate(lanes) for e in ((low_x, x) if k % 2 == 0 else (x, low_x))]
        )
        out = np.concatenate(
            [np.column_stack([way, np.full(8, h)]) for way, h in ((sweep, -z), (sweep[::-1], 0.3 * z))]
        )
    elif mission == "wall, leg over leg":
        legs = np.linspace(-z, z, 5)
        out = np.array([(e, -y, h) for k, h in enumerate(legs) for e in ((low_x, x) if k % 2 == 0 else (x, low_x))])
    else:
        out = np.column_stack([loop[[0, 1, 2, 3, 0]], np.zeros(5)])
    return out + rng.uniform(-0.12, 0.12, out.shape) * [1, 1, 0.3]


def frames_of(name: str, mission: str, seed: int, folder: Path) -> dict[str, Frames]:
    """A mission's frames, simulated once and kept in the folder."""
    file = folder / f"{name} {mission} {seed}.pkl".replace(" ", "_").replace(",", "")
    if not file.exists():
        path = ul.fly(ul.Waypoints(points(mission, name, seed), speed_m_s=0.5, stop=True), rate_hz=25)
        made = ul.simulate(world(name), path, ul.Rig.preset("thesis-4"), seed=seed)
        file.write_bytes(pickle.dumps({key: replace(f, simulated=None) for key, f in made.items()}))
    frames: dict[str, Frames] = pickle.loads(file.read_bytes())
    return frames
