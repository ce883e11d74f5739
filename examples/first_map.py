"""Fly a room with four radars and map it."""

import numpy as np

import ullage as ul


def main() -> None:
    scene = ul.scenes.room(size_m=(8, 6, 3))
    rig = ul.Rig.preset("thesis-4")
    path = ul.Waypoints([(-2.5, -1.5, 0), (2.5, -1.5, 0), (2.5, 1.5, 0)], speed_m_s=0.5)
    flown = ul.fly(path, scene=scene, rate_hz=17)
    frames = ul.simulate(scene, flown, rig, seed=7)
    grid = ul.Grid.covering(scene.bounds, step_m=0.10, margin_m=0.5)
    omap = ul.map_occupancy(frames, grid)
    score = ul.metrics.map_quality(omap, scene, frames)
    for name in ("precision", "recall", "f1"):
        print(f"{name:10s}{score[name].value:6.3f}")
    omap.plot(scene=scene, path=flown).figure.savefig("first_map.png")

    if not score["f1"].value > 0.5:
        raise SystemExit("the map does not show the walls")
    column, row = (int(np.argmin(abs(axis))) for axis in (omap.grid.x_m, omap.grid.y_m + 1.5))
    if not omap.free[row, column]:
        raise SystemExit("a cell that the drone flew through is not free")


if __name__ == "__main__":
    main()
