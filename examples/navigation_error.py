"""What navigation costs an image: white position noise smears it, a slow drift moves it."""

import matplotlib.pyplot as plt
import numpy as np

import ullage as ul


def main() -> None:
    scene = ul.scenes.sphere(radius_m=0.05, distance_m=2.0)
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    track = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0), speed_m_s=0.3)
    grid = ul.Grid.covering([(1.5, -0.5, 0), (2.5, 0.5, 0)], step_m=0.01)
    peaks = {}
    figure, panels = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
    for noise_m, panel in zip((0.0, 0.003, 0.010), panels, strict=True):
        believed = ul.navigate(track, noise_m=noise_m, seed=5)
        image = ul.focus(ul.simulate(scene, track, radar, believed=believed), grid)
        peaks[noise_m] = float(image.amplitude.max())
        image.plot(panel).set_title(f"{1000 * noise_m:.0f} mm")
        print(f"{1000 * noise_m:4.0f} mm white noise: peak {20 * np.log10(peaks[noise_m] / peaks[0.0]):+.1f} dB")

    figure.savefig("navigation_error.png")

    # With white errors along the line of sight the mean echo falls by exp(-(2 k sigma)^2 / 2).
    k = 2 * np.pi / radar.wavelength_m
    expected = np.exp(-((2 * k * 0.003) ** 2) / 2)
    print(f"theory for 3 mm: {20 * np.log10(expected):+.1f} dB")
    if not abs(peaks[0.003] / peaks[0.0] - expected) < 0.12:
        raise SystemExit("3 mm of white noise should cost what theory says")
    if not peaks[0.010] < 0.5 * peaks[0.0]:
        raise SystemExit("10 mm should break the focus")

    drifted = ul.navigate(track, drift_m=0.05, drift_time_s=1e4, seed=5)
    image = ul.focus(ul.simulate(scene, track, radar, believed=drifted), grid)
    if not image.amplitude.max() > 0.9 * peaks[0.0]:
        raise SystemExit("an error that stays the same should not smear")


if __name__ == "__main__":
    main()
