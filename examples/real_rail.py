"""Find the clocks of a real rail recording by focus, image it, and set the image beside the survey.

real_rail.py FOLDER, where FOLDER holds radar.out (PulsON 440), mocap.csv (Motive) and reflector.csv.
"""

import sys

import numpy as np

import ullage as ul

ABOVE_FLOOR_M = 0.07  # of the reflectors


def main(folder: str) -> None:
    source = ul.open(folder)
    frames = ul.calibrate(source.frames())
    found = frames.calibration
    print(f"clock {found.t_offset_s:+.3f} s, range {found.range_offset_m:+.3f} m, {found.gain_db:.1f} dB sharper")
    track = frames.poses.position
    box = np.stack([track.min(0), track.max(0)])
    image = ul.focus(frames, ul.Grid.covering(box, step_m=0.03, margin_m=5, z_m=ABOVE_FLOOR_M))
    image.plot(path=frames.poses).figure.savefig("real_rail.png")
    truth = source.reflectors()[0]  # for judging only; nothing above has seen it

    near = np.hypot(image.grid.x_m[None] - truth[0], image.grid.y_m[:, None] - truth[1]) < 0.5
    row, column = np.unravel_index(np.argmax(image.amplitude * near), near.shape)
    miss = np.hypot(image.grid.x_m[column] - truth[0], image.grid.y_m[row] - truth[1])
    level = image.amplitude[row, column] / np.median(image.amplitude)
    print(f"brightest cell near the surveyed reflector: {100 * miss:.1f} cm from it, {level:.0f} times the median")
    if not miss < 0.10:
        raise SystemExit("the reflector is not where it was surveyed")
    if not level > 5:
        raise SystemExit("nothing stands out of the clutter there")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(sys.argv[1])
