"""Figure 5.2: only cells in the square around the lobe are visited; and how much four lobes cover."""

import numpy as np

import ullage as ul


def main() -> None:
    spec = ul.RadarSpec.preset("x4m05", noise=None)
    path = ul.Trajectory.stationary((0.0, 0.0, 0.0), 25.0)
    grid = ul.Grid.covering([(-25, -25, 0), (25, 25, 0)], step_m=0.1)
    shares = {}
    for range_m in (2.0, 4.0, 8.0):
        profile = np.exp(-0.5 * ((spec.range_m - range_m) / 0.05) ** 2)[None].astype(np.float32)
        frames = ul.Frames(profile, spec.range_m, path.t_ns, spec, path, unit="thesis")
        omap = ul.map_occupancy(frames, grid, method="elfes", threshold=0.5)
        omap.plot().figure.savefig(f"thesis_square_{range_m:g}_m.png")
        rows, columns = np.nonzero(omap.percent >= 0)
        square = np.ptp(rows) + 1, np.ptp(columns) + 1
        shares[range_m] = square[0] * square[1] / grid.size
        print(f"echo at {range_m:g} m: {square[1]} x {square[0]} cells of {grid.shape[1]} x {grid.shape[0]}")
    cover = sum(65 for _ in ul.Rig.preset("thesis-4").sensors)
    print(f"four openings of 65 deg cover {cover} deg of the circle, not all of it")

    if not max(shares.values()) < 0.03:
        raise SystemExit("the square should be a small part of the grid")
    if not 3 < shares[8.0] / shares[4.0] < 5:
        raise SystemExit(
            "the square should grow with the square of the range: that is why far walls cost the thesis so much"
        )
    if cover != 260:
        raise SystemExit("four sensors should cover 260 deg")


if __name__ == "__main__":
    main()
