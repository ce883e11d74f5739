"""What the echoes of a planned flight will tell about clock, range zero, mount and scale of the track.

The Fisher information of steady points in white Gaussian noise [Kay1993, ch. 3]: an echo has the phase of its distance
with an unknown constant, the envelope of the pulse at its delay, and a level over the antenna's pattern. It is the
model that `ul.calibrate` fits, with its slopes and its dispersion (`bundle`). Places, phases and levels of the
reflectors are nuisances. A projection eliminates them, which equals the Schur complement of bundle adjustment
[Triggs2000]. The inverse of the information is a bound (Cramer-Rao): a real calibration is at best as sure.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import qr

from ullage import checks
from ullage.antenna import boresight_pattern, gain
from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import C0, quat_matrix
from ullage.processing.bundle import (
    DISPERSION,
    LEVEL_SIGMA_DB,
    SURVEY_SIGMA_M,
    level_slopes,
    parameter_slopes,
    pattern_slopes,
)
from ullage.processing.point_focus import RANGE, VISIBLE_M, path_slopes
from ullage.specs import RadarSpec

SNR_M = 3.0
"""Distance at which the signal-to-noise ratio of a reflector is given [m]."""
CLOCK_S, RATE, SCALE = 0.01, 5e-5, 0.01
"""Wanted sigmas: 5 mm at 0.5 m/s, the tolerance of a quartz, and 1 % of the track."""
LEVER_ARM_M = 0.01  # wanted sigma of each coordinate of the antenna's place
LEAST_SHARE = 0.1  # of a wanted sigma that a combination of quantities names
BLIND = 1e-12  # share of the greatest information that is round-off
LOST = 1e-8  # share of a quantity in what is blind


class Quantity(NamedTuple):
    """One of the nine quantities that a calibration flight must separate."""

    name: str
    unit: str
    factor: float  # of the unit a person reads over SI
    wanted: float  # sigma that a flight must reach [SI]


def quantities(spec: RadarSpec) -> tuple[Quantity, ...]:
    """Name the nine, and the sigma of each that a radar and its mount claim without a flight."""
    mount, degree = spec.mount, np.degrees(1.0)
    return (
        Quantity("clock", "ms", 1e3, CLOCK_S),
        Quantity("clock rate", "ppm", 1e6, RATE),
        Quantity("range zero", "mm", 1e3, spec.range_zero_sigma_m),
        *(Quantity(f"lever arm {axis}", "mm", 1e3, LEVER_ARM_M) for axis in "xyz"),
        *(Quantity(f"boresight {axis}", "deg", degree, max(mount.angle_sigma_deg, 0.1) / degree)
          for axis in ("up or down", "left or right")),
        Quantity("scale of the track", "%", 100.0, SCALE),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationPlan:
    """How well the echoes of a flight alone determine the nine quantities."""

    quantities: tuple[Quantity, ...]
    information: Floats  # (9, 9) in units of the wanted sigmas

    @property
    def sigma(self) -> Floats:
        """Standard deviation (9) of each quantity with the others unknown [SI]; infinite: the echoes do not show it."""
        value, vector = np.linalg.eigh(self.information)
        blind = value < BLIND * max(float(value[-1]), 1.0)
        known = (vector**2 / np.where(blind, np.inf, value)).sum(1)
        lost = (vector[:, blind] ** 2).sum(1) > LOST
        return np.where(lost, np.inf, np.sqrt(known)) * [one.wanted for one in self.quantities]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Name what the echoes do not determine within the wanted sigmas: quantities, or changes that cancel out."""
        value, vector = np.linalg.eigh(self.information)
        free = vector[:, value < 1].T
        if not len(free):
            return ()
        _, upper, order = qr(free, pivoting=True)
        reduced = np.zeros_like(free)
        reduced[:, order] = np.linalg.solve(upper[:, : len(free)], upper)
        return tuple(self._named(row) for row in reduced)

    def _named(self, change: Floats) -> str:
        """Name one change, given in units of the wanted sigmas."""
        order: list[int] = np.argsort(-np.abs(change)).tolist()
        parts = [self.quantities[k] for k in order if abs(change[k]) >= LEAST_SHARE]
        if len(parts) == 1:
            return parts[0].name
        sizes = [f"{change[k] * one.wanted * one.factor:+.2g}" for k, one in zip(order, parts, strict=False)]
        return " with ".join(f"{one.name} by {size} {one.unit}" for one, size in zip(parts, sizes, strict=True))


def plan_calibration(
    track: Trajectory,
    spec: RadarSpec,
    reflectors: ArrayLike,
    *,
    survey_sigma_m: float = SURVEY_SIGMA_M,
    snr_db: float = 20.0,
    level_sigma_db: float = LEVEL_SIGMA_DB,
    track_sigma_m: float = 0.001,
) -> CalibrationPlan:
    """Predict how well a flight past reflectors determines clock, clock rate, range zero, mount and scale.

    Frames less than half a wavelength of flight apart see the same clutter, so that they count as a share of one
    sample; a turn by half the antenna's opening counts as one, too.

    Example:
        >>> import ullage as ul
        >>> flown = ul.fly(ul.Waypoints([[0, -2, 1.5], [0, 2, 1.5], [1, 0, 2.2]], yaw=0.0, stop=True))
        >>> plan = ul.plan_calibration(flown, ul.RadarSpec.preset("pulson440"), [[3, 0, 1], [3, 2, 2]])
        >>> plan.sigma.shape
        (9,)

    Args:
        track: world_from_body.
        spec: of the radar, with its mount: waveform, antenna, frame rate, and the sigmas that are wanted.
        reflectors: (r, 3) places, world [m].
        survey_sigma_m: one sigma of each coordinate of the places [m]; infinite: unknown places.
        snr_db: signal-to-noise ratio of a reflector on boresight at 3 m in one frame, noise including clutter [dB].
        level_sigma_db: how far levels stray from the antenna's pattern over 0.35 m of flight or half an opening [dB].
        track_sigma_m: white error of the distances, one sigma: of the track and of where reflectors reflect [m].

    Raises:
        InputError: the track is one pose, or a place or number is not finite or out of bounds.
    """
    places = np.atleast_2d(np.asarray(checks.array("reflectors", reflectors), float))
    if places.ndim != 2 or places.shape[1] != 3 or not len(places) or not np.isfinite(places).all():
        raise InputError(f"reflectors of shape {places.shape}", where="plan_calibration", allowed="(r, 3) finite [m]")
    if len(track) < 2:
        raise InputError("a track of one pose", where="plan_calibration", allowed="2 poses or more")
    errors = _Errors(10 ** (snr_db / 10), level_sigma_db * np.log(10) / 20, track_sigma_m)
    for name, given in (("survey_sigma_m", survey_sigma_m), *errors._asdict().items()):
        if not given > 0:
            raise InputError(f"{name} is {given}", where="plan_calibration", allowed="above 0")
    known = quantities(spec)
    wanted, information = np.array([one.wanted for one in known]), np.zeros((len(known), len(known)))
    for echoes, slopes in _rows(track.resampled(spec.fps), spec, places, errors):
        nuisance = np.vstack([echoes, np.eye(3, echoes.shape[1]) / survey_sigma_m])
        slope = np.vstack([slopes, np.zeros((3, len(known)))]) * wanted
        size = np.maximum(np.linalg.norm(nuisance, axis=0), 1e-30)
        left = slope - nuisance / size @ np.linalg.lstsq(nuisance / size, slope, rcond=1e-10)[0]
        information += left.T @ left
    return CalibrationPlan(known, information)


class _Errors(NamedTuple):
    snr: float  # power ratio on boresight at SNR_M
    level: float  # sigma of the logarithm of the amplitude of one view
    track_sigma_m: float


def _rows(track: Trajectory, spec: RadarSpec, places: Floats, errors: _Errors) -> Iterator[tuple[Floats, Floats]]:
    """Whitened slopes of each reflector's phases, envelopes and levels, over nuisances (m, 5) and quantities (m, 9)."""
    sensor = track.mounted(spec.mount.body_from_sensor())
    body, turn = quat_matrix(track.quat_xyzw), quat_matrix(sensor.quat_xyzw)
    velocity, spin = sensor.rates
    t_s = (track.t_ns - track.t_ns.mean()) * 1e-9
    moved = np.gradient(np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(sensor.position, axis=0), axis=1))])
    turned = np.linalg.norm(spin, axis=1) * np.gradient(t_s) / boresight_pattern(spec.antenna).half_power_rad
    samples, views = np.minimum(moved / (spec.wavelength_m / 2) + turned, 1.0), moved / VISIBLE_M + turned
    phase, envelope = 4 * np.pi / spec.wavelength_m, np.sqrt(2) / (C0 * spec.pulse_sigma_s)  # per metre
    zero, one = np.zeros(len(t_s)), np.ones(len(t_s))

    moved = path_slopes(velocity, spin, body, track.position, t_s)

    for place in places:
        away = place - sensor.position
        distance = np.linalg.norm(away, axis=1)
        ray = away / distance[:, None]
        ahead = np.einsum("nij,ni->nj", turn, ray)
        power = (gain(spec.antenna, ahead) / gain(spec.antenna, [[1.0, 0, 0]])) ** 4 * (SNR_M / distance) ** 4
        power = errors.snr * power * ((distance >= spec.range_m[0]) & (distance <= spec.range_m[-1]))
        steady = 1 / (1 / np.maximum(power, 1e-30) + 2 * (phase * errors.track_sigma_m) ** 2)
        lean = pattern_slopes(spec, ahead)
        off, twist = level_slopes(ray, distance, np.einsum("nij,nj->ni", turn, lean), lean, ahead)
        phases = parameter_slopes(ray, None, *moved)
        envelopes = phases - np.eye(len(phases[0]))[RANGE]

        weight = np.sqrt(2 * steady * samples / DISPERSION)[:, None]
        noise = DISPERSION / np.maximum(2 * power * samples, 1e-30)
        seen = 1 / np.sqrt(errors.level**2 / np.maximum(views, 1e-30) + noise)[:, None]
        parts = (
            (weight * phase, ray, one, zero, phases),
            (weight * envelope, ray, zero, zero, envelopes),
            (seen, off, zero, one, parameter_slopes(off, twist, *moved)),
        )
        yield (
            np.vstack([size * np.column_stack([over, common, level]) for size, over, common, level, _ in parts]),
            np.vstack([size * slope for size, *_, slope in parts]),
        )
