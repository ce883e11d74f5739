"""Figure 4.7: the ray model's profile of a room, before and after the moving average."""

import matplotlib.pyplot as plt
import numpy as np

import ullage as ul


def profile(width: int) -> ul.Frames:
    scene = ul.scenes.room(size_m=(8, 6, 3), plate={"width_m": 1.0, "height_m": 1.0, "distance_m": 2.0})
    spec = ul.RadarSpec.preset("x4m05", noise=None, thesis={"noise_sigma": 0.0, "smoothing_bins": width})
    return ul.simulate(scene, ul.Trajectory.stationary(), spec, fidelity="thesis")


def tops(row: np.ndarray) -> int:
    inner = row[1:-1]
    return int(np.sum((inner > row[:-2]) & (inner >= row[2:])))


def main() -> None:
    rows = {width: profile(width) for width in (1, 5)}
    for width, frames in rows.items():
        row = frames.amplitude[0]
        print(f"average over {width} bins: {tops(row)} maxima, strongest at {frames.range_m[row.argmax()]:.2f} m")
        plt.plot(frames.range_m, row, label=f"average over {width} bins")
    plt.xlabel("range [m]")
    plt.ylabel("amplitude of the ray model")
    plt.legend()
    plt.savefig("thesis_smoothing.png")

    before, after = (frames.amplitude[0] for frames in rows.values())
    if not tops(after) < tops(before):
        raise SystemExit("the average should leave fewer maxima")
    if not np.isclose(before.sum(), after.sum(), rtol=1e-3):
        raise SystemExit("an average must keep the sum")


if __name__ == "__main__":
    main()
