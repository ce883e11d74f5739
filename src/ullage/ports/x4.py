"""XeThru X4 recordings: `xethru_datafloat_*.dat` and `xethru_baseband_iq_*.dat` [X4Recordings].

Both are rows of one size, so a file is mapped, not loaded, and a day's recording streams in little memory.
The X4 driver labels its bins with 3e8 m/s [NoveldaX4Driver]; here they are at the vacuum speed of light.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.ports.intake import warn
from ullage.ports.protocol import Recording, mend_clock
from ullage.specs import RadarSpec
from ullage.untrusted import reading

DRIVER_C = 3e8
FORMATS = "xethru_datafloat_*.dat or xethru_baseband_iq_*.dat"
DATAFLOAT = (("id", "<u4"), ("counter", "<u4"), ("size", "<u4"))
BASEBAND = (
    ("counter", "<u4"), ("size", "<u4"), ("bin_m", "<f4"), ("rate_hz", "<f4"), ("center_hz", "<f4"), ("start_m", "<f4")
)  # fmt: skip


class X4Source(Recording):
    """An X4 recording, read from disk as it is used.

    Args:
        path: a datafloat or baseband_iq `.dat` file; which of the two is found out.
        fps: frame rate, which neither format records [Hz]; None: 17, with a warning.
        range_start_m: range of bin 0, which datafloat does not record [m]; None: 0, with a warning.

    Raises:
        InputError: it is neither format, or holds no whole frame.
    """

    def __init__(self, path: str | Path, *, fps: float | None = None, range_start_m: float | None = None) -> None:
        super().__init__(path)
        if fps is None:
            warn(f"{self.path}: times are not recorded; 17 frames a second are assumed (say fps=)")
        self._rows, self._spec = open_rows(self.path, 17.0 if fps is None else fps, range_start_m)
        counter = self._rows["counter"].astype(np.int64)
        t_ns = np.rint((counter - counter[0]) * (1e9 / self._spec.fps)).astype(np.int64)
        self._t_ns = mend_clock(t_ns, where=self.path)

    def _names(self) -> Iterator[str]:
        yield "x4"

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """The same in pieces of at most `chunk` frames."""
        for start in range(0, len(self._t_ns), chunk):
            yield {"x4": self._cut(start, start + chunk)}

    def _cut(self, start: int, stop: int) -> Frames:
        rows, spec = self._rows[start:stop], self._spec
        samples = np.empty((len(rows), spec.bins), np.complex64)
        samples.real, samples.imag = rows["i"], rows["q"]
        return Frames(samples, spec.range_m, self._t_ns[start:stop], spec, sensor="x4", unit="normalised")


def open_rows(path: Path, fps: float, range_start_m: float | None) -> tuple[NDArray[np.void], RadarSpec]:
    """Map a recording, whichever of the two formats it has; its rows, and the spec that its header tells.

    Raises:
        InputError: it is neither, or holds no whole frame.
    """
    with reading(path), open(path, "rb") as file:
        size, head = path.stat().st_size, file.read(24)
    if len(head) < 24:
        raise InputError(f"{size} bytes hold no frame" if size else "empty file", where=path, allowed=FORMATS)
    kind, _, count = struct.unpack("<III", head[:12])
    _, bins, bin_m, rate, center, start = struct.unpack("<IIffff", head)
    if 1 <= bins <= 65536 and 1e-3 < bin_m < 10 and 1e8 < rate < 1e11 and 1e9 < center < 1e11 and abs(start) < 1e3:
        scale = C0 / DRIVER_C if abs(bin_m * 2 * rate / DRIVER_C - 1) < 1e-4 else 1.0
        rate_hz = 8 * C0 / (2 * bin_m * scale)
        spec = _x4m05(path, bins, fps, center_hz=float(center), sampling_hz=rate_hz, range_start_m=start * scale)
        return _map(path, size, BASEBAND, bins), spec
    if kind == 0 and 2 <= count <= 131072 and count % 2 == 0:
        if range_start_m is None:
            warn(f"{path}: the range of bin 0 is not recorded; 0 m is assumed (say range_start_m=)")
        bins = count // 2
        return _map(path, size, DATAFLOAT, bins), _x4m05(path, bins, fps, range_start_m=range_start_m or 0.0)
    raise InputError("not an X4 recording", where=path, allowed=FORMATS)


def _x4m05(path: Path, bins: int, fps: float, **known: Any) -> RadarSpec:
    try:
        return RadarSpec.preset("x4m05", bins=bins, fps=fps, **known)
    except InputError as error:
        raise InputError(f"its header or the options make no radar: {error}", where=path) from None


def _map(path: Path, size: int, header: tuple[tuple[str, str], ...], bins: int) -> NDArray[np.void]:
    """The whole rows whose headers agree with the first one's."""
    dtype = np.dtype([*header, ("i", "<f4", (bins,)), ("q", "<f4", (bins,))])
    whole, rest = divmod(size, dtype.itemsize)
    if not whole:
        raise InputError(f"cut within its first frame of {bins} bins", where=path, allowed=FORMATS)
    table: NDArray[np.void] = np.memmap(path, dtype, "r", shape=(whole,))
    constant = [name for name, _ in header if name != "counter"]
    same = np.all([table[name] == table[name][0] for name in constant], axis=0)
    good = whole if same.all() else int(np.argmin(same))
    if good < whole:
        warn(f"{path}: the header of frame {good} does not fit; the {good} before are used")
    elif rest:
        warn(f"{path}: cut within frame {whole}; the {whole} before are used")
    return table[:good]
