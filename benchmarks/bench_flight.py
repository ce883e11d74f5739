"""How many times faster than real time a flight is, in CPU time of one core: in open air, in a room, in a hold."""

from __future__ import annotations

import time

import ullage as ul
from ullage.flight.missions import along_walls, lawnmower
from ullage.flight.physics import PHYSICS_HZ
from ullage.flight.vehicle import fly_log


def _measure(name: str, mission: ul.Waypoints, **options: object) -> None:
    fly_log(ul.Waypoints([(0, 0, 0)], hold_s=0.1))  # loads the engine and the kernels
    best = float("inf")
    for _ in range(3):
        before = time.process_time()
        flown, log = fly_log(mission, **options)
        best = min(best, time.process_time() - before)
    ratio = flown.duration_s / best
    step_us = 1e6 * best / (flown.duration_s * PHYSICS_HZ)
    print(
        f"{name:34s} {flown.duration_s:7.1f} s flown in {best * 1e3:8.0f} CPU-ms: {ratio:6.1f} x real time, "
        f"{step_us:5.1f} us a step at {PHYSICS_HZ} Hz, greatest error {log.error_m.max() * 1e3:.0f} mm, "
        f"{len(log.contacts)} contacts"
    )


def main() -> None:
    field = lawnmower((-10, -10, 5), (10, 10), 2.0)
    _measure("open air, lawnmower", field)
    _measure("open air, 3 m/s wind with gusts", field, wind_m_s=(3, 0, 0), gust_m_s=0.5)
    room = ul.scenes.room(size_m=(6, 4, 3))
    _measure("room, 0.8 m from the walls", along_walls(room, 0.0, distance_m=0.8), scene=room)
    _measure("room, 0.5 m from the walls", along_walls(room, 0.0, distance_m=0.5), scene=room)
    for name in ("ntnu_room", "cargo_hold"):
        scene = getattr(ul.scenes, name)()
        middle = scene.bounds.mean(0)[2]
        try:
            mission = along_walls(scene, middle, distance_m=1.5)
        except ul.InputError as error:
            print(f"{name}: {error}")
            continue
        _measure(f"{name}, 1.5 m, {len(scene.faces)} triangles", mission, scene=scene)


if __name__ == "__main__":
    main()
