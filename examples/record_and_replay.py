"""Record to MCAP, replay in pieces, get the same bits; the public mcap reader opens the file too."""

import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

import ullage as ul


def main() -> None:
    scene = ul.scenes.room(plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    path = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0))
    frames = ul.simulate(scene, path, ul.RadarSpec.preset("x4m05"), seed=1)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "flight.mcap"
        with ul.sink(place) as sink:
            sink.write(frames)
        again = ul.open(place).frames()
        pieces = [part for chunk in ul.open(place).stream(10) for part in chunk.values()]
        with place.open("rb") as file:
            topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    again.plot().figure.savefig("record_and_replay.png")
    print(f"{len(again)} frames in {len(pieces)} pieces; topics {', '.join(sorted(topics))}")

    if not np.array_equal(again.samples, frames.samples):
        raise SystemExit("the samples have changed")
    if not np.array_equal(again.poses.position, frames.poses.position):
        raise SystemExit("the poses have changed")
    if not np.array_equal(np.concatenate([piece.samples for piece in pieces]), frames.samples):
        raise SystemExit("pieces differ from the whole")


if __name__ == "__main__":
    main()
