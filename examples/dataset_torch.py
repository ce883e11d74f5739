"""A training set for PyTorch: samples are read from disk as the loader asks for them."""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

try:
    import torch
    import zarr
    from torch.utils.data import DataLoader, Dataset
except ImportError as lacking:
    raise SystemExit(f"lacks {lacking.name}: pip install torch 'ullage[scale]'") from None

import ullage as ul
from ullage.experiments.dataset import read_index


class EchoPatches(Dataset):
    """Amplitudes and positions of a sample, and its patch of truth.

    Args:
        path: of a set that `ullage dataset` made.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self._group = str(path), None
        failed = [row["failed"] != "" for row in read_index(path)]
        self.numbers = [k for k, empty in enumerate(failed) if not empty]

    def __len__(self) -> int:
        """How many samples are there."""
        return len(self.numbers)

    def __getitem__(self, number: int) -> dict[str, torch.Tensor]:
        """One sample; only its own chunks are read."""
        if self._group is None:  # opened here, so that each process of a loader has its own
            self._group = zarr.open_group(self.path, mode="r")
        k = self.numbers[number]
        echoes = torch.from_numpy(self._group["samples"][k])  # (sensor, frame, bin), complex
        place = torch.from_numpy(self._group["believed_position_m"][k])
        return {
            "decibels": 20 * torch.log10(echoes.abs().clamp_min(1e-6)),
            "position_m": (place - place.mean(0)).float(),
            "truth": torch.from_numpy(self._group["occupancy"][k]).long(),
        }


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = ul.dataset("room", Path(folder) / "set.zarr", n=4, frames=8, where=1)
        batch = next(iter(DataLoader(EchoPatches(path), batch_size=4)))
    plt.imshow(batch["truth"][0].numpy(), origin="lower")
    plt.savefig("dataset_torch.png")
    print({name: tuple(values.shape) for name, values in batch.items()})
    if batch["decibels"].shape[:3] != (4, 4, 8) or 2 not in batch["truth"]:
        raise SystemExit("the loader gives no samples")


if __name__ == "__main__":
    main()
