"""Figure 2.4: a point seen from a straight track becomes a hyperbola; its apex is taken as the position."""

import numpy as np

import ullage as ul
from ullage.processing.summation import apex

TRUTH = np.array([2.5, 0.0])


def main() -> None:
    track = ul.Trajectory.line((0, -1.5, 0), (0, 1.5, 0), speed_m_s=0.25)
    ball = ul.scenes.sphere(radius_m=0.01, distance_m=float(TRUTH[0]))
    frames = ul.simulate(ball, track, ul.RadarSpec.preset("x4m05", noise=None))
    image = ul.focus(frames, ul.Grid.covering([(1.8, -1.5, 0), (3.2, 1.5, 0)], step_m=0.02), method="summation")

    image.plot(path=track).figure.savefig("thesis_hyperbola.png")

    ridge = image.grid.x_m[np.argmax(image.amplitude, axis=1)]
    across = image.grid.y_m
    told = np.hypot(TRUTH[0], across)  # range to the point where the sensor passes, laid straight ahead
    print("along the track [m]  ridge [m]  sqrt(R0^2 + s^2) [m]")
    for s in (-1.0, -0.5, 0.0, 0.5, 1.0):
        k = int(np.argmin(abs(across - s)))
        print(f"{s:19.1f}{ridge[k]:11.2f}{told[k]:22.2f}")
    top = apex(image, look_deg=0)
    miss = float(np.hypot(*(top[:2] - TRUTH)))
    print(f"apex at ({top[0]:.3f}, {top[1]:.3f}) m, {100 * miss:.1f} cm from the point")

    if not np.abs(ridge - told)[abs(across) < 1].max() < 0.08:
        raise SystemExit("the ridge is no hyperbola")
    if not miss < 0.05:
        raise SystemExit("the apex is not where the point stands")


if __name__ == "__main__":
    main()
