"""A steel plate turned by 0 to 45 degrees: the cosine law of 2018 beside physical optics."""

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
    for yaw in (5.0, 20.0, 45.0):
        print(f"{yaw:9.0f}{drop_db(yaw, 'thesis', radar):14.1f}{drop_db(yaw, 'physical', radar):16.1f}")

    if not drop_db(45, "physical", radar) < -25:
        raise SystemExit("a turned metal plate should nearly vanish")
    if not drop_db(45, "thesis", radar) > -8:
        raise SystemExit("the cosine law keeps it bright")


if __name__ == "__main__":
    main()
