"""Recordings of radars by the programs of their makers: PulsON, X4 and A121.

PulsON 440 logs, `radar.out`: one configuration, then range scans in packets [TDSR-MRM]; and P452 scans as JSON. The
configuration is bare (32 bytes), or the whole message that sets it (36) or confirms it (44). Scans are kept to the last
sample, in the radar's own counts; dropped packets leave zeros.

XeThru X4 recordings: `xethru_datafloat_*.dat` and `xethru_baseband_iq_*.dat` [X4Recordings]. Both are rows of one size,
so a file is mapped, not loaded, and a day's recording streams in little memory. The X4 driver labels its bins with
3e8 m/s [NoveldaX4Driver]; here they are at the vacuum speed of light.

Acconeer A121 recordings, `.h5` as the exploration tool writes them [AcconeerET]. Each subsweep of each sensor is a
radar of its own, since range step and pulse differ: `sensor1`, or `sensor1_2` for the second of several. Each sweep is
a frame: the first at the tick of its frame, the others at the sweep rate. The tool takes rising phase for rising
distance; here it falls (-4 pi range / wavelength), so samples are conjugated.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs
from ullage.data import Frames
from ullage.errors import InputError
from ullage.geometry import C0
from ullage.ports.arrays import Arrays, load
from ullage.ports.containers import array_in, open_hdf5
from ullage.ports.intake import warn
from ullage.ports.protocol import Recording, mend_clock, warn_of_saturation
from ullage.specs import MountSpec, RadarSpec
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


A121_CENTER_HZ, DECIMATION, LEAST_BINS = 60.5e9, 8, 8
A121_WIDTH_M = {"PROFILE_1": 0.04, "PROFILE_2": 0.07, "PROFILE_3": 0.14, "PROFILE_4": 0.19, "PROFILE_5": 0.32}
"""Full width at half maximum of the envelope over range, for each profile [m] [AcconeerET]."""
A121_BAND = 0.569
"""-10 dB bandwidth of a Gaussian pulse, times its width over range, over the speed of light."""
MOST_BYTES = 2_000_000_000
SESSIONS = {"session", "sessions"}
"""Groups of an HDF5 file, one of which the exploration tool makes."""


def read_sessions(path: Path, *, mount: MountSpec | None = None) -> dict[str, Frames]:
    """Read the first session of a recording, by the names of its radars.

    Raises:
        InputError: it is no such recording, is damaged, or has no subsweep of 8 points or more.
        MissingExtra: h5py is not installed.
    """
    out: dict[str, Frames] = {}
    with reading(path), open_hdf5(path) as file:
        session = "sessions/session_0" if "sessions" in file else "session"
        config = _tree(file, f"{session}/session_config")
        ticks_hz = float(_tree(file, "server_info")["ticks_per_second"])
        for group, sensors in enumerate(config["groups"]):
            for entry, (number, sensor) in enumerate(sorted(sensors.items(), key=lambda item: int(item[0]))):
                name = f"sensor{int(number)}" + f"_group{group}" * (group > 0)
                place = f"{session}/group_{group}/entry_{entry}"
                out |= _Entry(file, place, sensor, ticks_hz, path).frames(name, mount)
    if not out:
        what = f"no subsweep of {LEAST_BINS} points or more"
        raise InputError(what, where=path, allowed="an A121 recording of range profiles")
    return out


def subsweep_fields(one: Mapping[str, Any], base_m: float) -> dict[str, Any]:
    """Return the fields of a RadarSpec that a subsweep settles.

    Args:
        one: start point, step length, profile and hwaas, as the exploration tool names them.
        base_m: range of one step [m].
    """
    return {
        "name": "a121", "center_hz": A121_CENTER_HZ, "bandwidth_hz": A121_BAND * C0 / A121_WIDTH_M[one["profile"]],
        "decimation": DECIMATION, "sampling_hz": DECIMATION * C0 / (2 * base_m * int(one["step_length"])),
        "range_start_m": base_m * int(one["start_point"]), "iterations": 1, "pulses_per_step": int(one["hwaas"]),
    }  # fmt: skip


def _tree(file: Any, name: str) -> Any:
    """The values of a JSON text in the file."""
    return json.loads(bytes(array_in(file, name, most_bytes=1_000_000)[()]))


class _Entry:
    """One sensor of a session."""

    def __init__(self, file: Any, place: str, sensor: dict[str, Any], ticks_hz: float, path: Path) -> None:
        self._about = _tree(file, f"{place}/metadata")
        frame = array_in(file, f"{place}/result/frame", most_bytes=MOST_BYTES)
        if frame.ndim != 3 or not frame.size or not np.iscomplexobj(frame):
            raise InputError(f"frames of shape {frame.shape}", where=path, allowed="(n, sweeps, points) complex")
        tick = array_in(file, f"{place}/result/tick", most_bytes=MOST_BYTES)
        self._sensor, self._path = sensor, path
        self._samples = frame.conj().reshape(-1, frame.shape[2]).astype(np.complex64)
        self._t_ns = mend_clock(self._times(tick, frame.shape[1], ticks_hz), where=path)
        saturated = int(array_in(file, f"{place}/result/data_saturated", most_bytes=MOST_BYTES).sum())
        if saturated:
            warn(f"{path}: {saturated} of {len(frame)} frames are saturated; their strongest echoes are cut off")

    def _times(self, tick: NDArray[Any], sweeps: int, ticks_hz: float) -> Longs:
        start_s = (tick - tick[0]) / ticks_hz
        rate_hz = float(self._sensor.get("sweep_rate") or self._about["max_sweep_rate"])
        times = start_s[:, None] + np.arange(sweeps) / rate_hz
        return np.asarray(np.rint(times.ravel() * 1e9), np.int64)

    def frames(self, name: str, mount: MountSpec | None) -> dict[str, Frames]:
        """Frames of each subsweep with enough points."""
        out, short = {}, 0
        for number, (which, spec) in enumerate(self._subsweeps(mount), 1):
            if spec is None:
                short += 1
                continue
            one = name if len(self._sensor["subsweeps"]) == 1 else f"{name}_{number}"
            samples = np.ascontiguousarray(self._samples[:, which])
            out[one] = Frames(samples, spec.range_m, self._t_ns, spec, sensor=one, unit="normalised")
        if short and out:
            warn(f"{self._path}: {short} subsweeps of {name} have fewer than {LEAST_BINS} points; left out")
        return out

    def _subsweeps(self, mount: MountSpec | None) -> Iterator[tuple[slice, RadarSpec | None]]:
        base_m = float(self._about["base_step_length_m"])
        step = np.diff(self._t_ns)
        fps = 1e9 / float(np.median(step)) if len(step) else 10.0
        shapes = zip(self._about["subsweep_data_offset"], self._about["subsweep_data_length"], strict=True)
        for (start, count), one in zip(shapes, self._sensor["subsweeps"], strict=True):
            which = slice(int(start), int(start) + int(count))
            if len(self._samples[0, which]) != int(count):
                raise InputError(f"a subsweep of {count} points from {start}", where=self._path, allowed="those it has")
            if count < LEAST_BINS:
                yield which, None
                continue
            spec = RadarSpec(own_echo_m=0.0, **subsweep_fields(one, base_m), bins=int(count), fps=fps)
            yield which, spec.but(mount=mount) if mount else spec
