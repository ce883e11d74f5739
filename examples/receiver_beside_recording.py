"""Set the simulated X4 receiver beside a recording: receiver_beside_recording.py RECORDING.dat FIGURE.png."""

import sys
import warnings
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # the figure is one of the studies, beside the package

import ullage as ul
from studies.receiver_figure import draw_receiver


def main(recording: str, figure: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ul.UllageWarning)  # neither times nor ranges matter here
        frames = ul.open(recording).frames()
    draw_receiver(frames[200:4900], Path(figure))
    print(f"{figure}: {len(frames)} frames read, 200 to 4900 at rest")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(*sys.argv[1:])
