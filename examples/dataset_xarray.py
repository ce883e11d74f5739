"""A training set made and read: echoes near the ranges that their labels state, without loading the whole set."""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

try:
    import xarray
except ImportError as lacking:
    raise SystemExit(f"lacks {lacking.name}: pip install 'ullage[scale]'") from None

import ullage as ul


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = ul.dataset(["room", "polygon"], Path(folder) / "set.zarr", n=6, frames=8, where=1)
        with xarray.open_zarr(path, chunks=None) as found:  # opens in one read; arrays come when they are used
            print(found["samples"])
            abs(found["samples"]).isel(sample=0, frame=0).plot.line(x="bin", yscale="log")  # a line a sensor
            plt.savefig("dataset_xarray.png")
            near = [nearest_peak(found.isel(sample=k)) for k in range(found.sizes["sample"])]
    print("distance from the label of the strongest echo to the largest sample near it [m]:", np.round(near, 2))
    if not np.median(near) < 0.15:
        raise SystemExit("labels and echoes disagree")


def nearest_peak(one: xarray.Dataset) -> float:
    """How far the largest sample within 0.5 m of the strongest label lies from that label [m]."""
    sensor = int(one["echo_gain_db"].isel(echo=0).values.argmax())
    label = float(one["echo_range_m"].isel(sensor=sensor, echo=0))
    profile = np.abs(one["samples"].isel(sensor=sensor, frame=one.sizes["frame"] // 2).values)
    gap = np.abs(one["range_m"].values - label)
    return float(gap[np.argmax(np.where(gap < 0.5, profile, 0))])


if __name__ == "__main__":
    main()
