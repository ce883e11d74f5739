"""Antenna patterns: smooth, one-way, in the sensor's own frame (x along the boresight, y left, z up).

The simulator takes `pattern_pairs`. Processing knows the angle of an echo off the boresight, so it reads
`boresight_pattern`, which samples the same pattern around the boresight.

The X4A02 dome goes through the values of its data sheet [NoveldaX4A02]: 5.97 dBi at the peak, 3 dB less at 32.5 deg,
0 dBi near 47.5 deg, between -5 and -8 dBi at 90 deg, a low back lobe.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Complexes, Floats
from ullage.errors import InputError
from ullage.specs import AntennaSpec, RadarSpec

X4A02_DBI = ((0.0, 5.97), (32.5, 2.97), (47.5, 0.0), (90.0, -6.5), (130.0, -11.0), (180.0, -13.0))
"""Angle off boresight [deg] and gain [dBi]; both main planes are alike. Beyond 90 deg the sheet gives no numbers."""
_CUBE = 96  # cells along each side of the cube of directions
_ANGLES, _ROLLS = 1441, 24  # samples from boresight to its back (each 0.125 deg), and of planes around it
_HALF_POWER_DB, _MAIN_LOBE_DB = 3.0, 6.0
_MOST_DB = 300.0  # of gains and attenuations in files of Planet
_FAINT = 1e-3  # pairs of patterns this much weaker than the strongest pair are left out: -60 dB
_AXES = {"vertical": 2, "horizontal": 1}  # of the sensor's frame, along which a polarisation lies
_OWN = {"vertical": np.eye(3), "horizontal": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}
"""From the sensor's frame to that of a far field, which a horizontal polarisation rolls so that its z is left."""
_DIPOLE_DBI = 2.15  # gain of the half-wave dipole [dBi], over which dBd count [Balanis2012]


def gain(antenna: AntennaSpec, directions: ArrayLike) -> Floats:
    """One-way amplitude gain (n), the square root of the power gain over isotropic.

    Args:
        antenna: which pattern.
        directions: (n, 3) unit vectors in the sensor's frame.

    Raises:
        InputError: a table cannot be read.
    """
    unit = np.atleast_2d(np.asarray(directions, float))
    unit = unit / np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-300)
    shape = _shape(antenna, unit)
    if antenna.gain_dbi is not None:
        peak = antenna.gain_dbi
    elif antenna.kind == "cosine":
        peak = _directivity_dbi(antenna)
    else:
        peak = {"isotropic": 0.0, "x4a02": X4A02_DBI[0][1], "table": _table_peak(antenna)}[antenna.kind]
    return np.asarray(shape * 10 ** (peak / 20))


def _shape(antenna: AntennaSpec, unit: Floats) -> Floats:
    """Amplitude over the peak's."""
    if antenna.kind == "isotropic":
        return np.ones(len(unit))
    if antenna.kind == "x4a02":
        return np.asarray(10 ** (_dome()(1 - np.clip(unit[:, 0], -1, 1)) / 20))
    if antenna.kind == "cosine":
        return _cosine_power(antenna, unit)
    peak = _table_peak(antenna)
    if _has_fields(antenna):
        far = _far_field(str(antenna.file)).near(antenna.frequency_hz)
        return np.asarray(np.linalg.norm(far.at(unit @ _OWN[antenna.polarization].T)[0], axis=1) / 10 ** (peak / 20))
    return _interpolated(antenna, unit, peak)


@lru_cache(maxsize=1)
def _dome():  # type: ignore[no-untyped-def]
    """Gain over the peak [dB] against 1 - cos(angle), in which the dome is smooth at both poles."""
    from scipy.interpolate import PchipInterpolator

    angle, dbi = np.asarray(X4A02_DBI).T
    return PchipInterpolator(1 - np.cos(np.radians(angle)), dbi - dbi[0])


def _cosine_power(antenna: AntennaSpec, unit: Floats) -> Floats:
    """Powers of (1 + cos)/2, halved in power at half the opening in each main plane, blended between them."""

    def power(opening_deg: float) -> float:
        level = (1 + np.cos(np.radians(opening_deg / 2))) / 2
        return 0.0 if level < 1e-12 else float(0.5 * np.log(2) / -np.log(level))

    y2, z2 = unit[:, 1] ** 2, unit[:, 2] ** 2
    side = np.maximum(y2 + z2, 1e-300)
    n = (power(antenna.azimuth_deg) * y2 + power(antenna.elevation_deg) * z2) / side
    return np.asarray(np.clip((1 + unit[:, 0]) / 2, 1e-12, 1) ** n)


@lru_cache(maxsize=32)
def _directivity_dbi(antenna: AntennaSpec) -> float:
    """Peak gain of a lossless antenna of this shape [dBi]."""
    k = np.arange(20000) + 0.5
    z, turn = 1 - 2 * k / len(k), np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    ball = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)
    return float(-10 * np.log10(np.mean(_cosine_power(antenna, ball) ** 2)))


def _text(file: str) -> str:
    try:
        return Path(file).read_text(errors="replace")
    except OSError as error:
        raise InputError(f"cannot read the antenna table: {error.strerror}", where=Path(file)) from None


@lru_cache(maxsize=8)
def _table(file: str) -> tuple[Floats, Floats, Floats]:
    """Azimuths (a), elevations (e) [deg] and gains (a, e) [dBi] of a CSV file or of cuts of Planet."""
    path, text = Path(file), _text(file)
    if path.suffix.lower() in (".msi", ".pln"):
        return _planet(text, path)
    rows = list(csv.DictReader(text.splitlines()))
    try:
        data = np.array([[float(r[c]) for c in ("azimuth_deg", "elevation_deg", "gain_dbi")] for r in rows])
    except (KeyError, TypeError, ValueError):
        raise InputError("not an antenna table", where=path,
                         allowed="numbers under azimuth_deg,elevation_deg,gain_dbi") from None  # fmt: skip
    if len(data) < 4 or not np.isfinite(data).all():
        raise InputError("too few or not finite rows in the antenna table", where=path)
    az, el = np.unique(data[:, 0]), np.unique(data[:, 1])
    grid = np.full((len(az), len(el)), np.nan)
    grid[np.searchsorted(az, data[:, 0]), np.searchsorted(el, data[:, 1])] = data[:, 2]
    if np.isnan(grid).any() or min(grid.shape) < 2:
        raise InputError("the antenna table has gaps", where=path, allowed="every azimuth with every elevation")
    return az, el, grid


def _has_fields(antenna: AntennaSpec) -> bool:
    """Whether an antenna's file holds fields with phase and polarisation, not gains alone."""
    return antenna.kind == "table" and Path(antenna.file or "").suffix.lower() == ".ffs"


class FarField(NamedTuple):
    """Far fields of an antenna at several frequencies, in directions of its own."""

    frequency_hz: Floats  # (f) rising
    turns: Floats  # (p) phi [deg]
    tilts: Floats  # (t) theta [deg]
    axes: Floats  # (3, 3) rows: the axes of those angles, in the sensor's frame
    field: Complexes  # (f, p, t, 3) in the sensor's frame; its square is the gain

    def near(self, frequency_hz: float | None) -> FarField:
        """Keep the frequency nearest to one; None: the middle one."""
        many = self.frequency_hz
        which = len(many) // 2 if frequency_hz is None else int(abs(many - frequency_hz).argmin())
        return self._replace(frequency_hz=many[[which]], field=self.field[[which]])

    def within(self, low_hz: float, high_hz: float) -> FarField:
        """Keep the frequencies of a band, and the next one on each side."""
        first = max(int(np.searchsorted(self.frequency_hz, low_hz, "right")) - 1, 0)
        some = slice(first, int(np.searchsorted(self.frequency_hz, high_hz)) + 1)
        return self._replace(frequency_hz=self.frequency_hz[some], field=self.field[some])

    def at(self, unit: Floats) -> Complexes:
        """Interpolate the fields (f, n, 3) to directions (n, 3); their lengths are those of the samples between."""
        from scipy.interpolate import RegularGridInterpolator

        x, y, z = self.axes @ unit.T
        turn = (np.degrees(np.arctan2(y, x)) - self.turns[0]) % 360 + self.turns[0]
        place = np.stack([turn, np.degrees(np.arccos(np.clip(z, -1, 1)))], axis=-1)
        out = np.empty((len(self.field), len(unit), 3), complex)
        for k, known in enumerate(self.field):
            values = np.concatenate([known, np.linalg.norm(known, axis=-1, keepdims=True)], -1)
            found = RegularGridInterpolator((self.turns, self.tilts), values, bounds_error=False, fill_value=None)(
                place
            )
            across = found[:, :3] - (found[:, :3] * unit).sum(1, keepdims=True) * unit
            length = found[:, 3].real / np.maximum(np.linalg.norm(across, axis=1), 1e-300)
            out[k] = length[:, None] * across
        return out


@lru_cache(maxsize=8)
def _far_field(file: str) -> FarField:
    """Read a far-field source of CST, version 3.

    The boresight is z in the file and left is x. The gain is the directivity times the radiated power over the
    stimulated one, if the file names both.
    """
    from scipy.integrate import trapezoid

    words = " ".join(line for line in _text(file).splitlines() if not line.lstrip().startswith("//")).split()
    try:
        values = np.array([float(word) for word in words[2:]])
        count = int(values[0])
        axes, power = values[4:10].reshape(2, 3), values[10 : 10 + 4 * count].reshape(count, 4)
        size = [int(value) for value in values[10 + 4 * count : 12 + 4 * count]]
        parts = values[10 + 4 * count :].reshape(count, 2 + 6 * size[0] * size[1])[:, 2:]
        phi, theta, *field = parts.reshape(count, size[0], size[1], 6).transpose(3, 0, 1, 2)
        turns, tilts = phi[0, :, 0], theta[0, 0]
        known = np.all(np.diff(turns) > 0) and np.all(np.diff(tilts) > 0) and np.isfinite(values).all()
        known = known and np.linalg.norm(axes, axis=1).all() and np.any(field, axis=(0, 2, 3)).all()
        steps = np.diff(turns).max(), np.diff(tilts).max()
        whole = known and np.ptp(turns) >= 360 - 1.5 * steps[0] and np.ptp(tilts) > 179 and max(steps) <= 30
    except (IndexError, OverflowError, ValueError):
        whole = False
    if words[1:2] != ["Farfield"] or not whole:
        raise InputError(
            "not a far field",
            where=Path(file),
            allowed="a far-field source of CST, version 3, of the whole sphere, each 30 deg or less",
        )
    z, x = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    own = np.stack([x, np.cross(z, x), z])[:, [2, 0, 1]]  # forward, left and up in the file are z, x and y
    polar, level = field[0] + 1j * field[1], field[2] + 1j * field[3]
    if np.ptp(turns) < 360:  # the first cut again, as the last one
        turns = np.append(turns, turns[0] + 360)
        polar, level = (np.concatenate([part, part[:, :1]], axis=1) for part in (polar, level))
    density = abs(polar) ** 2 + abs(level) ** 2
    around, down = np.radians(turns)[:, None], np.radians(tilts)
    ring = trapezoid(density, around[:, 0], axis=1) * np.sin(down)
    both = np.minimum(power[:, 0], power[:, 2]) > 0
    share = np.where(both, power[:, 0], 1.0) / np.where(both, power[:, 2], 1.0)
    scale = np.sqrt(share * 4 * np.pi / trapezoid(ring, down, axis=1))[:, None, None]
    upright = np.cos(down) * np.cos(around), np.cos(down) * np.sin(around), -np.sin(down) + 0 * around
    aside = -np.sin(around) + 0 * down, np.cos(around) + 0 * down, np.zeros(density.shape[1:])
    local = scale[..., None] * (polar[..., None] * np.stack(upright, -1) + level[..., None] * np.stack(aside, -1))
    frequency_hz, order = np.unique(power[:, 3], return_index=True)
    return FarField(frequency_hz, turns, tilts, own, (local @ own)[order])


def _planet(text: str, path: Path) -> tuple[Floats, Floats, Floats]:
    """The same of an MSI Planet file, from its cuts through the boresight [PlanetMSI].

    Angles count clockwise as seen from above and from the left, so that horizontal 90 is right and vertical 90 is down.
    Between the cuts, attenuations in dB are the Boolean sum of interpolations over azimuth and over elevation
    [GordonHall1973]: both cuts are met all round, and around a lobe their attenuations add up.
    """
    try:
        peak = next(filter(None, (_planet_gain(line) for line in text.splitlines())))
        across, upright = (_planet_cut(text, name) for name in ("HORIZONTAL", "VERTICAL"))
        if abs(peak[0]) > _MOST_DB:
            raise ValueError("GAIN")
    except (StopIteration, OverflowError, ValueError):
        raise InputError(
            "not an MSI Planet antenna file", where=path,
            allowed="GAIN in dBd or dBi, then HORIZONTAL and VERTICAL cuts: an angle in degrees and an attenuation "
            "of 0 to 300 dB a line, all round, each 30 deg or less",
        ) from None  # fmt: skip
    az, el = np.arange(-180.0, 181.0), np.arange(-90.0, 91.0)
    back, level = (1 - np.cos(np.radians(az[:, None]))) / 2, np.cos(np.radians(el)) ** 2
    loss = (1 - back) * _on_cut(upright, -el) + back * _on_cut(upright, 180 + el)
    loss += level * (_on_cut(across, -az)[:, None] - (1 - back) * _on_cut(across, 0) - back * _on_cut(across, 180))
    return az, el, peak[0] - np.maximum(loss, 0)


def _planet_gain(line: str) -> tuple[float] | None:
    """Gain of the line of an MSI Planet file that has it [dBi]; without a unit it is over a dipole's."""
    found = re.fullmatch(r"\s*GAIN\s+([-+]?\d+\.?\d*)\s*(dB[di])?\s*", line, re.IGNORECASE)
    return (float(found[1]) + (0.0 if (found[2] or "").lower() == "dbi" else _DIPOLE_DBI),) if found else None


def _planet_cut(text: str, name: str) -> Floats:
    """Angles [deg] and attenuations [dB] (n, 2) of one cut of an MSI Planet file.

    Raises:
        ValueError: there is none, or it has gaps.
    """
    _, *rows = re.split(rf"^[ \t]*{name}[ \t]+(\d+)[ \t]*$", text, maxsplit=1, flags=re.IGNORECASE | re.MULTILINE)
    if not rows:
        raise ValueError(name)
    count = int(rows[0])
    cut = np.array([[float(word) for word in line.split()] for line in rows[1].split("\n")[1 : count + 1]])
    if cut.shape != (count, 2) or not np.isfinite(cut).all() or cut[:, 1].min() < 0 or cut[:, 1].max() > _MOST_DB:
        raise ValueError(name)
    angles = np.sort(cut[:, 0] % 360)
    if np.diff(angles, append=angles[0] + 360).max() > 30:
        raise ValueError(name)
    return cut


def _on_cut(cut: Floats, angles: Floats | float) -> Floats:
    """Attenuations [dB] at angles (n) [deg] of a cut."""
    return np.asarray(np.interp(angles, cut[:, 0], cut[:, 1], period=360))


def _table_peak(antenna: AntennaSpec) -> float:
    if antenna.kind != "table":
        return 0.0
    if not antenna.file:
        raise InputError("a table antenna needs a file", where="antenna.file")
    if _has_fields(antenna):
        field = _far_field(antenna.file).near(antenna.frequency_hz).field
        return float(10 * np.log10((abs(field) ** 2).sum(-1).max()))
    return float(_table(antenna.file)[2].max())


def _interpolated(antenna: AntennaSpec, unit: Floats, peak: float) -> Floats:
    """The table's amplitude over its peak; directions beyond the table take its edge."""
    from scipy.interpolate import RegularGridInterpolator

    az, el, dbi = _table(str(antenna.file))
    interpolate = RegularGridInterpolator((az, el), 10 ** ((dbi - peak) / 20))
    a = np.clip(np.degrees(np.arctan2(unit[:, 1], unit[:, 0])), az[0], az[-1])
    e = np.clip(np.degrees(np.arcsin(np.clip(unit[:, 2], -1, 1))), el[0], el[-1])
    return np.asarray(interpolate(np.stack([a, e], 1)))


@lru_cache(maxsize=1)
def _cube_directions() -> Floats:
    """Unit vectors (6 m m, 3) on a cube of directions; faces +x -x +y -y +z -z."""
    side = np.linspace(-1, 1, _CUBE + 1)
    a, b = (g.ravel() for g in np.meshgrid(side, side, indexing="ij"))
    one = np.ones_like(a)
    faces = [(one, a, b), (-one, a, b), (a, one, b), (a, -one, b), (a, b, one), (a, b, -one)]
    out = np.concatenate([np.stack(face, 1) for face in faces])
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


@lru_cache(maxsize=32)
def cube(antenna: AntennaSpec) -> Floats:
    """The gains of `gain` on a cube of directions (6, m, m)."""
    return gain(antenna, _cube_directions()).reshape(6, _CUBE + 1, _CUBE + 1)


@dataclass(frozen=True, slots=True, eq=False)
class PatternPair:
    """A pattern that sends and one that receives, each of one polarisation; a radar is the sum of its pairs."""

    axes: Floats  # (2, 3) axis of each in the sensor's frame; its field is the unit vector along that across the wave
    table: Complexes  # (1 or 2, 6, m, m) amplitudes on a cube of directions, of both or of each (`kernels.facets`)
    transfer: Callable[[Floats], Complexes] | None = None  # of the pair at frequencies (n) [Hz]; None: 1
    tail_s: float = 0.0  # how long its response may last: samples in frequency tell no more [s]

    def swapped(self) -> Complexes:
        """Return the table of the pair that sends from its receiver."""
        return np.ascontiguousarray(self.table[::-1])

    def carrier(self, frequency_hz: float) -> complex:
        """Return the transfer at one frequency."""
        return 1.0 + 0j if self.transfer is None else complex(self.transfer(np.array([frequency_hz]))[0])


class _Term(NamedTuple):
    """A part of a pattern that has one polarisation, and is a function of direction times one of frequency."""

    axis: int  # of the sensor's frame
    table: Complexes  # (6, m, m)
    frequency_hz: Floats  # (f)
    values: Complexes  # (f)

    def transfer(self, frequency_hz: Floats) -> Complexes:
        """Interpolate the values by a cubic spline; beyond the first and last frequency they stay."""
        from scipy.interpolate import CubicSpline

        known = self.frequency_hz
        return np.asarray(CubicSpline(known, self.values)(np.clip(frequency_hz, known[0], known[-1])))


@lru_cache(maxsize=32)
def pattern_pairs(spec: RadarSpec) -> tuple[PatternPair, ...]:
    """List what a radar's antennas do as pairs of scalar patterns, without those 60 dB below the strongest.

    Gains alone make one pair. A far field is a sum of terms, and a radar with it has pairs of these.

    Raises:
        InputError: a table cannot be read.
    """
    antenna = spec.antenna
    kinds = antenna.polarization, antenna.receive_polarization or antenna.polarization
    if not _has_fields(antenna):
        return (PatternPair(np.eye(3)[[_AXES[kind] for kind in kinds]], cube(antenna)[None].astype(complex)),)
    sent = _terms(spec, kinds[0])
    taken = sent if kinds[0] == kinds[1] else _terms(spec, kinds[1])
    level = np.multiply.outer(
        *([abs(one.table).max() * abs(one.values).max() for one in side] for side in (sent, taken))
    )
    out = []
    for (i, one), (j, other) in product(enumerate(sent), enumerate(taken)):
        twice = sent is taken and spec.antenna_offset_m == 0  # in one place both orders are the same wave
        if level[i, j] < _FAINT * level.max() or (twice and j < i):
            continue
        table = np.stack([one.table] if one is other else [one.table * (2 if twice else 1), other.table])
        tail = 1 / np.diff(one.frequency_hz).min() if len(one.values) > 1 else 0.0
        out.append(PatternPair(np.eye(3)[[one.axis, other.axis]], table, _product(one, other), float(tail)))
    return tuple(out)


def _product(one: _Term, other: _Term) -> Callable[[Floats], Complexes] | None:
    if len(one.values) == 1:
        return None
    return lambda frequency_hz: one.transfer(frequency_hz) * other.transfer(frequency_hz)


@lru_cache(maxsize=8)
def _terms(spec: RadarSpec, polarization: str) -> list[_Term]:
    """Split the far field of an antenna in a radar's band into terms of one polarisation each.

    The larger part has the field along an axis a that the fields follow most: c(u) times the unit vector along
    (1 - u u^T) a. The rest d(u) is across both, along p = a x u. It is the sum over the two other axes b of
    d (p . b) (1 - u u^T) b, since p has no part along a. Over frequency each is a sum of products, by its singular
    values.
    """
    antenna, unit = spec.antenna, _cube_directions()
    reach = 6 / (2 * np.pi * spec.pulse_sigma_s)
    far = _far_field(str(antenna.file)).within(spec.center_hz - reach, spec.center_hz + reach)
    field = far.at(unit @ _OWN[polarization].T) @ _OWN[polarization]
    if antenna.gain_dbi is not None:
        field = field * 10 ** ((antenna.gain_dbi - _table_peak(antenna)) / 20)
    across = np.sqrt(np.maximum(1 - unit**2, 0.0))
    along = field / np.maximum(across, 1e-9)  # each component over its axis' length across the wave
    main = max(_AXES.values(), key=lambda k: float((abs(along[..., k]) ** 2).sum()))
    axis = np.eye(3)[main]
    aside = np.cross(axis, unit) / np.maximum(across[:, [main]], 1e-9)
    rest, parts = np.einsum("fni,ni->fn", field, aside), []
    for k in range(3):
        part = along[..., k] if k == main else rest * aside[:, k] * across[:, k]
        _, vectors = np.linalg.eigh(part @ part.conj().T)
        for column in vectors.T:
            table = (column.conj() @ part).reshape(6, _CUBE + 1, _CUBE + 1)
            parts.append(_Term(k, table, far.frequency_hz, column))
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class BoresightPattern:
    """One-way gain against the angle off boresight, over all planes that hold the boresight.

    A pattern that differs between planes has a greatest and a mean gain at each angle. They agree for an antenna that
    is symmetric about its boresight.
    """

    angle_rad: Floats  # (k) from 0 to pi
    greatest_dbi: Floats  # (k)
    mean_dbi: Floats  # (k) mean of the decibels
    half_power_rad: float  # half opening: geometric mean of where the main planes have fallen by 3 dB; at most pi
    main_lobe_rad: float  # where the mean has fallen by 6 dB; a data sheet says little of the gain beyond; at most pi

    @property
    def peak_dbi(self) -> float:
        """Greatest gain in any direction [dBi]."""
        return float(self.greatest_dbi.max())

    def gain_dbi(self, angle_rad: float | Floats) -> Floats:
        """Mean gain [dBi] at angles off boresight (n)."""
        return np.asarray(np.interp(angle_rad, self.angle_rad, self.mean_dbi))


@lru_cache(maxsize=32)
def boresight_pattern(antenna: AntennaSpec) -> BoresightPattern:
    """Sample an antenna around its boresight: what processing needs of beam width and side lobes.

    Raises:
        InputError: a table cannot be read.
    """
    angle = np.linspace(0, np.pi, _ANGLES)
    roll = 2 * np.pi * np.arange(_ROLLS) / _ROLLS
    off, aside = np.sin(angle)[:, None], np.stack([np.cos(roll), np.sin(roll)], -1)
    ahead = np.broadcast_to(np.cos(angle)[:, None, None], (_ANGLES, _ROLLS, 1))
    unit = np.concatenate([ahead, off[..., None] * aside], axis=2)
    dbi = 20 * np.log10(np.maximum(gain(antenna, unit.reshape(-1, 3)), 1e-15)).reshape(_ANGLES, _ROLLS)
    mean = dbi.mean(axis=1)
    main = [_first_fall(angle, dbi[:, k], _HALF_POWER_DB) for k in range(0, _ROLLS, _ROLLS // 4)]
    half = float(np.exp(np.mean(np.log(main))))
    return BoresightPattern(angle, dbi.max(axis=1), mean, half, _first_fall(angle, mean, _MAIN_LOBE_DB))


def _first_fall(angle: Floats, dbi: Floats, fall_db: float) -> float:
    """First angle at which a gain (k) has fallen by so much from its value on boresight; pi where it never does."""
    low = np.flatnonzero(dbi <= dbi[0] - fall_db)
    return _crossing(angle, dbi, dbi[0] - fall_db, max(int(low[0]) - 1, 0)) if len(low) else float(np.pi)


def _crossing(angle: Floats, dbi: Floats, level: float, index: int) -> float:
    """Angle between two samples, the first at `index`, at which a falling gain reaches a level."""
    fall = dbi[index] - dbi[index + 1]
    share = (dbi[index] - level) / fall if fall > 0 else 1.0
    return float(angle[index] + np.clip(share, 0, 1) * (angle[index + 1] - angle[index]))
