"""Image a small sphere from a straight track: the image is sharp, and where the sphere stands."""

import numpy as np

import ullage as ul


def width_m(values: np.ndarray, step_m: float) -> float:
    fine = np.interp(np.arange(0, len(values) - 1, 0.01), np.arange(len(values)), values)
    return float(np.sum(fine > fine.max() / np.sqrt(2)) * 0.01 * step_m)


def main() -> None:
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    track = ul.Trajectory.line((0, -0.6, 0), (0, 0.6, 0), speed_m_s=0.2)
    frames = ul.simulate(ul.scenes.sphere(radius_m=0.02, distance_m=3.0), track, radar)
    grid = ul.Grid.covering([(2.5, -0.5, 0), (3.5, 0.5, 0)], step_m=0.01)
    image = ul.focus(frames, grid)
    lines = ul.focus(frames, grid, method="summation")

    image.plot(path=track).figure.savefig("sar_point.png")

    row, column = np.unravel_index(np.argmax(image.amplitude), grid.shape)
    across = width_m(image.amplitude[:, column], grid.step_m)
    along = width_m(image.amplitude[row], grid.step_m)
    summed = width_m(lines.amplitude[:, np.argmax(lines.amplitude.max(axis=0))], grid.step_m)
    print(f"peak at {image.peak_m[:2]} m; -3 dB widths {along:.3f} m in range, {across:.3f} m across")
    print(f"the thesis' summation: {summed:.3f} m across")

    if not np.hypot(*(image.peak_m[:2] - (2.98, 0.0))) < 0.03:
        raise SystemExit("the image has the sphere elsewhere")
    theory = 0.886 * radar.wavelength_m / 2 * 3.0 / 1.2  # 0.886 lambda / 2 times range over aperture
    if not 0.8 < across / theory < 1.3:
        raise SystemExit(f"the image is {across:.3f} m wide, theory has {theory:.3f} m")
    if not summed > 5 * across:
        raise SystemExit("summation of amplitudes should be far wider")


if __name__ == "__main__":
    main()
