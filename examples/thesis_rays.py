"""Equations 4.3 to 4.5: how far rays stand apart, and how many it takes.

Eq. 4.5 is misprinted: with 0.4 in place of 0.2 and without the + 1 it would give 28.4, not the 57.73 that stands there.
"""

import math

import matplotlib.pyplot as plt

from ullage.fan import ray_spacing_m, rays_for


def main() -> None:
    count = rays_for(65, 0.2, 10)
    printed = 32.5 / math.degrees(math.atan(0.4 / (2 * 10)))
    print(f"eq. 4.4: {count:.2f} rays stand 0.2 m apart at 10 m, so {math.ceil(count)} x {math.ceil(count)}")
    print(f"eq. 4.5 as printed: {printed:.1f}")
    for range_m in (5, 10):
        print(f"eq. 4.3: 30 rays stand {ray_spacing_m(65, 30, range_m):.3f} m apart at {range_m} m")

    ranges_m = range(1, 11)
    for rays in (30, 58):
        plt.plot(ranges_m, [ray_spacing_m(65, rays, far) for far in ranges_m], label=f"{rays} rays across 65 deg")
    plt.xlabel("range [m]")
    plt.ylabel("between rays [m]")
    plt.legend()
    plt.savefig("thesis_rays.png")

    if not abs(count - 57.73) < 0.02:
        raise SystemExit("the thesis' 57.73 rays are not found")
    if not abs(ray_spacing_m(65, 58, 10) - 0.2) < 0.002:
        raise SystemExit("58 rays should stand 0.2 m apart")


if __name__ == "__main__":
    main()
