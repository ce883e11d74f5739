"""A steel plate turned by 0 to 45 degrees: the cosine law of 2018 beside physical optics."""

import matplotlib.pyplot as plt
import numpy as np

import ullage as ul


def drop_db(yaw_deg: float, fidelity: str, radar: ul.RadarSpec) -> float:
    peaks = []
    for yaw in (0.0, yaw_deg):
        scene = ul.scenes.plate(width_m=0.5, height_m=0.5, distance_m=3.0, yaw_deg=yaw)
        frames = ul.simulate(scene, ul.Trajectory.stationary(), radar, fidelity=fidelity)
        peaks.append(frames.amplitude.max())
    return float(20 * np.log10(peaks[1] / peaks[0]))


def main() -> None:
    still = {"noise_sigma": 0.0, "rays_per_side": 200, "smoothing_bins": 9}  # nine bins hold the whole turned plate
    radar = ul.RadarSpec.preset("x4m05", antenna="isotropic", noise=None, thesis=still)
    print("yaw [deg]   thesis [dB]   physical [dB]")
    turns = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0)
    drops = {law: [drop_db(yaw, law, radar) for yaw in turns] for law in ("thesis", "physical")}
    for yaw, thesis, physical in zip(turns, *drops.values(), strict=True):
        print(f"{yaw:9.0f}{thesis:14.1f}{physical:16.1f}")
    for law, values in drops.items():
        plt.plot(turns, values, "o-", label=law)
    plt.xlabel("turn of the plate [deg]")
    plt.ylabel("echo relative to the plate square on [dB]")
    plt.legend()
    plt.savefig("thesis_vs_physical.png")

    if not drops["physical"][-1] < -25:
        raise SystemExit("a turned metal plate should nearly vanish")
    if not drops["thesis"][-1] > -8:
        raise SystemExit("the cosine law keeps it bright")


if __name__ == "__main__":
    main()
