"""Ordinary inspection missions for maps of a volume: legs and rounds, straight, level or climbing evenly.

Each is flown by the simulated multirotor, heading along its way, with the thesis' four radars. The rooms and tanks of
the table are "room", "hall", "den", "keg", "kettle", "tank", "basin" and "silo", and the lying tank "boiler", of which
lanes are flown along the axis; thresholds were chosen in "cabin", "vat" and "drum". `OTHERS` are missions of their
own in other rooms.
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
TANKS = ("tank", "vat", "drum", "silo", "keg", "kettle", "basin", "boiler")
LANES = ((-0.7, -0.5), (0.05, -0.8), (0.7, -0.45), (0.6, 0.4), (-0.05, 0.75), (-0.65, 0.5), (0.15, 0.0))  # x, z [m]


def rounds(x: float, y: float, heights: tuple[float, ...]) -> np.ndarray:
    """Closed rounds (n, 3) at these heights [m]."""
    loop = np.array([(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)])
    return np.concatenate([np.column_stack([loop, np.full(5, h)]) for h in heights])


def climb(x: float, y: float, low: float, high: float) -> np.ndarray:
    """Two rounds (9, 3) that climb evenly [m]."""
    loop = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    return np.column_stack([np.concatenate([loop, loop, loop[:1]]), np.linspace(low, high, 9)])


def to_and_fro(x: float, lanes: np.ndarray) -> np.ndarray:
    """Legs (n, 3) of 2 x, one after the other, at these y and z (l, 2) [m]."""
    return np.array([(e, *lane) for k, lane in enumerate(lanes) for e in ((-x, x) if k % 2 == 0 else (x, -x))])


def mower(x: float, y: float, low: float, high: float) -> np.ndarray:
    """Four lanes at one height and back at another [m]."""
    there, back = (to_and_fro(x, np.column_stack([np.linspace(-y, y, 4), np.full(4, h)])) for h in (low, high))
    return np.concatenate([there, back[::-1]])


OTHERS = {
    "6 x 4 x 3 m, rounds at two heights": ((6.0, 4.0, 3.0), None, rounds(1.8, 1.0, (-0.6, 0.5)), "along"),
    "the same, rounds at three heights, one heading": (
        (6.0, 4.0, 3.0), None, rounds(1.8, 1.0, (-0.8, 0.0, 0.8)), "hold"),
    "9 x 5 x 3.6 m, rounds at three heights": ((9.0, 5.0, 3.6), None, rounds(3.2, 1.3, (-1.0, 0.1, 1.0)), "along"),
    "7 x 5 x 3 m with a plate, two rounds that climb evenly by 1.4 m": (
        (7.0, 5.0, 3.0), {"width_m": 1.0, "height_m": 1.5, "distance_m": 2.4}, climb(1.5, 1.4, -0.7, 0.7), "along"),
    "9 x 7 x 4 m, lawn-mower at two heights": ((9.0, 7.0, 4.0), None, mower(3.0, 2.2, -1.0, 0.9), "along"),
    "7 x 5 x 3.2 m, five legs over each other along one wall": (
        (7.0, 5.0, 3.2), None, to_and_fro(2.2, np.array([(-1.2, h) for h in np.linspace(-0.9, 0.9, 5)])), "along"),
    "5 x 5 x 5 m, rounds at four heights": ((5.0, 5.0, 5.0), None, rounds(1.4, 1.5, (-1.6, -0.4, 0.8, 1.6)), "along"),
}  # fmt: skip
"""Size of a room of concrete [m], a plate in it, waypoints (n, 3) [m] and yaw, by what they are called."""


def world(name: str) -> Scene:
    """A room or an upright cylindrical tank, centred on the origin."""
    if name == "room":
        return ul.scenes.room((8.0, 6.0, 3.0), plate={"width_m": 1.0, "height_m": 2.0, "distance_m": 2.6})
    if name in ("cabin", "den"):
        return ul.scenes.room({"cabin": (6.0, 4.5, 3.4), "den": (5.0, 4.2, 2.7)}[name], material="concrete")
    if name == "hall":
        plate = {"width_m": 1.4, "height_m": 2.0, "distance_m": 3.2, "yaw_deg": 30}
        return ul.scenes.room((9.5, 7.0, 3.8), material="concrete", plate=plate)
    if name in OTHERS:
        size, plate, *_ = OTHERS[name]
        return ul.scenes.room(size, material="concrete", plate=plate)
    if name == "boiler":
        return ul.scenes.cylinder(1.8, 8.0, 0.0, 90.0, material="steel", edge_m=0.1)
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
    if name == "boiler":
        ends = [(2.6, -2.6) if k % 2 else (-2.6, 2.6) for k in range(len(LANES))]
        lanes = np.array([(x, y, z) for (x, z), there in zip(LANES, ends, strict=True) for y in there])
        return lanes + rng.uniform(-0.1, 0.1, lanes.shape)
    x, y, z = {
        "room": (2.3, 1.5, 0.8),
        "cabin": (1.6, 1.0, 0.9),
        "den": (1.3, 0.9, 0.6),
        "hall": (2.4, 2.0, 1.1),
        "tank": (1.7, 1.7, 1.0),
        "vat": (1.2, 1.2, 0.8),
        "drum": (1.0, 1.0, 0.6),
        "silo": (3.0, 3.0, 1.2),
        "keg": (0.9, 0.9, 0.9),
        "kettle": (1.2, 1.2, 0.7),
        "basin": (2.4, 2.4, 1.1),
    }[name]
    low_x = -x
    x = {"room": 1.3, "hall": 1.44}.get(name, x)
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


def frames_of(name: str, mission: str, seed: int, folder: Path, bounces: int = 1) -> dict[str, Frames]:
    """A mission's frames, simulated once and kept in the folder; `OTHERS` have a mission of their own."""
    more = f" {bounces} bounces" if bounces > 1 else ""
    file = folder / f"{name} {mission} {seed}{more}.pkl".replace(" ", "_").replace(",", "")
    if not file.exists():
        places, yaw = OTHERS[name][2:] if name in OTHERS else (points(mission, name, seed), "along")
        path = ul.fly(ul.Waypoints(places, speed_m_s=0.5, stop=True, yaw=yaw), rate_hz=25)
        made = ul.simulate(world(name), path, ul.Rig.preset("thesis-4"), seed=seed, max_bounces=bounces)
        file.write_bytes(pickle.dumps({key: replace(f, simulated=None) for key, f in made.items()}))
    frames: dict[str, Frames] = pickle.loads(file.read_bytes())
    return frames
