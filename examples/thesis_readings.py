"""Figure 5.1: readings of one object from several places reinforce each other in Elfes' grid."""

import numpy as np

import ullage as ul

OBJECT = np.array([2.0, 1.6])


def reading(x: float) -> ul.Frames:
    """One echo, from the object's range, seen somewhat off the axis."""
    spec = ul.RadarSpec.preset("x4m05", noise=None)
    away = OBJECT - (x, 0.0)
    yaw_deg = 90 - 0.6 * np.degrees(np.arctan2(away[0], away[1]))
    path = ul.Trajectory.stationary((x, 0.0, 0.0), float(yaw_deg))
    profile = np.exp(-0.5 * ((spec.range_m - np.hypot(*away)) / 0.05) ** 2)[None].astype(np.float32)
    return ul.Frames(profile, spec.range_m, path.t_ns, spec, path, unit="thesis")


def main() -> None:
    grid = ul.Grid.covering([(-0.6, -0.4, 0), (4.6, 3.2, 0)], step_m=0.1)
    cell = np.ravel_multi_index(tuple(grid.index([[*OBJECT, 0]])[0][0]), grid.shape)
    chances = []
    for count in (1, 10, 100):
        places = np.linspace(0.4, 3.6, count) if count > 1 else [0.4]
        frames = [reading(float(x)) for x in places]
        omap = ul.map_occupancy(frames, grid, method="elfes", threshold=0.5)
        omap.plot().figure.savefig(f"thesis_readings_{count}.png")
        chances.append(int(omap.percent.ravel()[cell]))
        print(f"{count:3d} readings: the object's cell is held occupied at {chances[-1]} %")

    if not chances[0] < chances[1] <= chances[2]:
        raise SystemExit("readings should reinforce each other")
    if not chances[2] >= 90:
        raise SystemExit("after a hundred readings the object should be certain")


if __name__ == "__main__":
    main()
