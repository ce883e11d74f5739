"""CPU-ms per frame of the physical radar, by scene, bounce order, range and world size."""

import time

import numpy as np

import ullage as ul
from ullage.radar.physical import echoes


def cost(scene, spec, bounces, path, count=20):
    track = path[:count]
    echoes(scene, track[:1], spec, max_bounces=bounces)
    start = time.process_time()
    echoes(scene, track, spec, max_bounces=bounces)
    return (time.process_time() - start) / len(track) * 1e3


def main():
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    line = ul.Trajectory.line((0.1, 0.1, 0.0), (0.6, 0.3, 0.1), 0.5, 50)
    room = ul.scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    long = ul.scenes.room((60, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    ball = ul.scenes.sphere(0.3, 3.0)
    worlds = {"plate in a 6x4x3 room": (room, line), "the same, 60 m long": (long, line), "sphere": (ball, line)}
    for name in ("cargo-hold", "cluttered-room"):
        try:
            scene = ul.load_scene(ul.world_path(name)) if hasattr(ul, "world_path") else _library(name)
        except (ul.UllageError, ImportError, AttributeError) as error:
            print(f"{name}: left out ({error})")
            continue
        middle = scene.bounds.mean(0)
        worlds[name] = (scene, ul.Trajectory.line(middle, middle + np.array([0.5, 0.2, 0.1]), 0.5, 50))
    print(f"{'world':26s}{'faces':>8s}" + "".join(f"{b:>9d} b." for b in (1, 2, 3)) + "   [CPU-ms a frame]")
    for name, (scene, path) in worlds.items():
        row = [cost(scene, radar, b, path) for b in (1, 2, 3)]
        print(f"{name:26s}{len(scene.faces):8d}" + "".join(f"{v:12.2f}" for v in row))


def _library(name):
    from ullage.world.library import WORLDS

    return ul.load_scene(WORLDS[name].path)


if __name__ == "__main__":
    main()
