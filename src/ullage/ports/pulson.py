"""PulsON 440 logs, `radar.out`: one configuration, then range scans in packets [TDSR-MRM]; and P452 scans as JSON.

The configuration is bare (32 bytes), or the whole message that sets it (36) or confirms it (44). Scans are kept to the
last sample, in the radar's own counts; dropped packets leave zeros.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.ports.arrays import Arrays, load
from ullage.ports.intake import warn
from ullage.ports.protocol import mend_clock, warn_of_saturation
from ullage.specs import RadarSpec
from ullage.untrusted import reading, regular_size

STEP_S = 61e-12
LEAD_S = 10e-9
CONFIG = struct.Struct(">IiiHH4H4BBBBB")
MESSAGES = {0x1001: (4, 36), 0x1102: (4, 44)}
"""MRM_SET_CONFIG_REQUEST and MRM_GET_CONFIG_CONFIRM: where the configuration starts in them, and their length."""
SCAN_INFO = 0xF201
JSON, MOST_JSON_BYTES = "P452 scans: scan_start [ps], scans [[t_s, [samples]], ...]", 400_000_000
PACKET = np.dtype({
    "names": ["kind", "message", "t_ms", "here", "total", "index", "packets", "samples"],
    "formats": [">u2", ">u2", ">u4", ">u2", ">u4", ">u2", ">u2", (">i4", (350,))],
    "offsets": [0, 2, 8, 42, 44, 48, 50, 52], "itemsize": 1452,
})  # fmt: skip


def read_log(path: str | Path) -> Arrays:
    """Decode a PulsON log.

    Raises:
        InputError: it is no such log, or holds no scan.
    """
    path = Path(path)
    with reading(path):
        raw = path.read_bytes()
    at, front = MESSAGES.get(int.from_bytes(raw[:2], "big"), (0, CONFIG.size))
    if len(raw) < front + PACKET.itemsize:
        raise InputError(f"{len(raw)} bytes hold no scan", where=path, allowed="a PulsON 440 MRM log")
    start_ps, _, _, integration = CONFIG.unpack_from(raw, at)[1:5]
    if not (6 <= integration <= 15 and -500_000 <= start_ps <= 500_000):
        raise InputError(
            f"starts at {start_ps} ps with integration index {integration}",
            where=path,
            allowed="a PulsON 440 MRM log: -500000 .. 500000 ps, index 6 .. 15",
        )
    whole, rest = divmod(len(raw) - front, PACKET.itemsize)
    packets = np.frombuffer(raw, PACKET, whole, front)
    if rest:
        warn(f"{path}: cut within packet {whole}; the {whole} before are used")
    scans, t_ms = _assemble(packets, path)
    return _recording(scans, (t_ms - t_ms[0]) * 1_000_000, _ranges(start_ps, scans.shape[1]), integration, path)


def _ranges(start_ps: float, bins: int) -> Floats:
    """Range of each bin (b) of scans that start so long after the pulse [m]."""
    return np.asarray(C0 / 2 * (start_ps * 1e-12 - LEAD_S + STEP_S * np.arange(bins)))


def read_scans(path: str | Path) -> Arrays:
    """Read scans of a P452 as JSON: `scan_start` and `scan_end` [ps], and `scans`, each [time [s], [samples]].

    The pulse integration is not in the file; that of the preset stands in the spec.

    Raises:
        InputError: it is no such file, or its scans differ in length.
    """
    path = Path(path)
    regular_size(path, most_bytes=MOST_JSON_BYTES, allowed=JSON)
    with reading(path):
        tree = json.loads(path.read_bytes())
        start_ps, rows = float(tree["scan_start"]), tree["scans"]
        times, scans = np.array([row[0] for row in rows], float), np.array([row[1] for row in rows], np.int32)
    if scans.ndim != 2 or scans.shape[1] < 8 or not abs(start_ps) <= 500_000 or not (np.abs(times) < 9e9).all():
        raise InputError(f"scans of shape {scans.shape} from {start_ps:g} ps", where=path, allowed=JSON)
    t_ns = np.rint((times - times[0]) * 1e9).astype(np.int64)
    return _recording(scans, t_ns, _ranges(start_ps, scans.shape[1]), None, path)


ARRAYS = ("scans", "t_ms", "range_m", "scan_start_ps", "scan_stop_ps", "scan_res", "pii")


def read_arrays(path: str | Path) -> Arrays:
    """Read a PulsON log that was saved as plain arrays (`.npz`): no pickled object in it is opened.

    Keys: `scans` (n, b) in the radar's counts, `t_ms` (n) radar clock [ms], `range_m` (b) [m], and the scalars
    `scan_start_ps`, `scan_stop_ps` [ps], `scan_res` (in steps of 1.907 ps) and `pii` (pulse integration index).

    Raises:
        InputError: a key is missing, or shapes and values do not fit together.
    """
    path = Path(path)
    held = load(path, ARRAYS)
    if missing := [name for name in ARRAYS if name not in held]:
        raise InputError(f"no {', '.join(missing)}", where=path, allowed=", ".join(ARRAYS))
    scans, t_ms, range_m, _, _, _, pii = (held[name] for name in ARRAYS)
    if scans.ndim != 2 or scans.dtype.kind not in "iuf" or scans.shape != (t_ms.size, range_m.size) or not scans.size:
        shapes = f"scans {scans.shape}, t_ms {t_ms.shape}, range_m {range_m.shape}"
        raise InputError(shapes, where=path, allowed="scans (n, b) of numbers, t_ms (n), range_m (b)")
    if pii.size != 1 or not 6 <= int(pii.ravel()[0]) <= 15:
        raise InputError(f"pii is {pii.tolist()}", where=path, allowed="6 .. 15")
    range_m = range_m.astype(float)
    if range_m.size < 8 or not np.isfinite(range_m).all() or np.any(np.diff(range_m) <= 0):
        raise InputError("range_m does not rise", where=path, allowed="at least 8 rising, finite ranges [m]")
    ticks = t_ms.astype(np.int64)
    return _recording(scans, (ticks - ticks[0]) * 1_000_000, range_m, int(pii.ravel()[0]), path)


def _recording(scans: NDArray[Any], t_ns: Longs, range_m: Floats, integration: int | None, path: Path) -> Arrays:
    """The recording of scans (n, b) in the radar's counts, at times (n) from the first one on."""
    t_ns = mend_clock(t_ns, where=path)
    warn_of_saturation(scans, path)
    fps = 1e9 / float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 46.0
    counts = {} if integration is None else {"pulses_per_step": 2**integration, "iterations": 1}
    spec = RadarSpec.preset("pulson440", bins=len(range_m), range_start_m=float(range_m[0]), fps=fps, **counts)
    return Arrays(scans.astype(np.float32), range_m, t_ns, spec, None, None)


def _assemble(packets: NDArray[np.void], path: Path) -> tuple[NDArray[np.int32], Longs]:
    scan = (packets["kind"] == SCAN_INFO) & (packets["here"] <= 350)
    if not scan.any():
        raise InputError("no range scans in it", where=path, allowed="a PulsON 440 MRM log")
    shapes, counts = np.unique(packets[scan][["total", "packets"]], return_counts=True)
    bins, per_scan = (int(value) for value in shapes[np.argmax(counts)])
    if not (8 <= bins <= 65536 and per_scan == -(-bins // 350)):
        raise InputError(f"says {bins} samples in {per_scan} packets", where=path, allowed="350 samples a packet")
    good = scan & (packets["total"] == bins) & (packets["packets"] == per_scan) & (packets["index"] < per_scan)
    if not good.any():
        raise InputError("no range scans in it", where=path, allowed="a PulsON 440 MRM log")
    if not good.all():
        warn(f"{path}: {int((~good).sum())} packets make no sense, first packet {int(np.argmin(good))}; left out")
    kept = packets[good]
    new = np.concatenate(
        [[True], (np.diff(kept["message"].astype(np.int64)) != 0) | (np.diff(kept["t_ms"].astype(np.int64)) != 0)]
    )
    number = np.cumsum(new) - 1
    scans = np.zeros((number[-1] + 1, per_scan, 350), np.int32)
    scans[number, kept["index"]] = kept["samples"]
    dropped = scans.shape[0] * per_scan - len(kept)
    if dropped > 0:
        warn(f"{path}: {dropped} packets are missing; their samples are zero")
    return scans.reshape(len(scans), -1)[:, :bins], kept["t_ms"][new].astype(np.int64)
