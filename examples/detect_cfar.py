"""Detect a weak sphere: CFAR finds it, keeps its false alarm rate, and does not depend on the receiver's gain."""

from dataclasses import replace

import numpy as np

import ullage as ul

PFA = 1e-3


def main() -> None:
    radar = ul.RadarSpec.preset("x4m05")
    hover = ul.Trajectory.stationary(n=300)
    frames = ul.simulate(ul.scenes.sphere(radius_m=0.1, distance_m=4.0), hover, radar, seed=3)
    hits = ul.detect(frames, method="cfar", pfa=PFA)

    hits.plot(frames.plot()).figure.savefig("detect_cfar.png")

    near = abs(hits.range_m - 3.9) < 0.15  # the echo comes from the sphere's front
    found = len(np.unique(hits.frame[near])) / len(frames)
    print(f"found in {found:.1%} of frames, at {np.median(hits.range_m[near]):.3f} m")
    if not found > 0.99:
        raise SystemExit("the sphere is missed")
    if not abs(np.median(hits.range_m[near]) - 3.9) < 0.02:
        raise SystemExit("the sphere stands elsewhere")

    bins = np.sum(abs(frames.range_m - 3.9) > 0.5)
    alarms = np.sum(abs(hits.range_m - 3.9) > 0.5) / (bins * len(frames))
    print(f"false alarms a bin: {alarms:.1e}, asked for at most {PFA:.0e}")
    if not alarms < 2 * PFA:
        raise SystemExit("too many false alarms")

    louder = ul.detect(replace(frames, samples=frames.samples * 8), method="cfar", pfa=PFA)
    if not np.array_equal(louder.frame, hits.frame):
        raise SystemExit("a change of gain changes what is found")


if __name__ == "__main__":
    main()
