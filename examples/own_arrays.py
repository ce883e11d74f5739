"""A map of your own profiles, poses and times: arrays of any radar with a range axis, without a preset."""

import numpy as np

import ullage as ul


def main() -> None:
    rng = np.random.default_rng(0)
    range_m = 0.05 * np.arange(120)  # of each bin [m]
    times_s = 0.05 * np.arange(200)  # of each profile [s]
    positions_m = np.c_[np.linspace(-2, 2, 200), np.zeros(200), np.ones(200)]  # of the radar, z up [m]
    looks_left = (0, 0, np.sqrt(0.5), np.sqrt(0.5))  # quaternion x, y, z, w; one for all, or one a profile
    profiles = 0.01 * np.abs(rng.standard_normal((200, 120)))  # amplitudes; complex baseband and RF are taken too
    profiles[:, 60] += 1.0  # a wall at 3 m

    frames = ul.Frames.from_arrays(profiles, range_m, times_s, positions_m, looks_left)
    omap = ul.map_occupancy(frames, ul.Grid.covering([[-3, -2, 0], [3, 4, 2]], step_m=0.1))
    print(frames, omap, sep="\n")
    ul.figures.map_figure("own_arrays.png", omap, title="a wall of plain arrays")

    rows, _ = np.nonzero(omap.occupied)
    if not len(rows) or abs(np.median(omap.grid.y_m[rows]) - 3) > 0.1:
        raise SystemExit("the wall does not stand at y = 3 m")


if __name__ == "__main__":
    main()
