"""What flows between the parts: trajectories, frames, detections, metrics. Checked once, when made."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage import checks
from ullage.arrays import Floats, Longs, Singles
from ullage.display import Displayed, plots
from ullage.errors import InputError, shown
from ullage.geometry import C0, matrix_quat, quat_matrix, rotations, rpy_quat
from ullage.specs import BodySpec, RadarSpec, ThesisSpec

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Samples = NDArray[np.complex64] | Singles


def _array(name: str, value: ArrayLike, shape: tuple[int, ...], dtype: Any = np.float64) -> NDArray[Any]:
    out = checks.array(name, value, dtype)
    if out.shape != shape:
        raise InputError(f"{name} has shape {out.shape}", allowed=f"{shape}")
    if out.dtype.kind == "f" and not np.isfinite(out).all():
        row = int(np.argwhere(~np.isfinite(out))[0, 0])
        raise InputError(f"{name} is not finite in row {row}", where=name)
    return out


def _rising(t_ns: ArrayLike) -> Longs:
    out = checks.times_ns("t_ns", t_ns)
    if out.ndim != 1 or out.size == 0:
        raise InputError(f"t_ns has shape {out.shape}", allowed="(n,) with n >= 1")
    back = np.flatnonzero(np.diff(out) <= 0)
    if back.size:
        raise InputError(f"time does not rise after sample {int(back[0])}", where="t_ns", allowed="strictly rising")
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory(Displayed):
    """Poses over time: world (ENU) from body (FLU)."""

    t_ns: Longs  # (n) strictly rising
    position: Floats  # (n, 3) [m]
    quat_xyzw: Floats  # (n, 4) world_from_body
    velocity: Floats | None = None  # (n, 3) world [m/s]; None: derived from the positions
    angular_velocity: Floats | None = None  # (n, 3) body [rad/s]; None means: from the attitudes

    def __post_init__(self) -> None:
        t_ns = _rising(self.t_ns)
        n = len(t_ns)
        quat = _array("quat_xyzw", self.quat_xyzw, (n, 4))
        norm = np.linalg.norm(quat, axis=1, keepdims=True)
        if np.any(abs(norm - 1) > 1e-3):
            raise InputError(f"quaternion {int(np.argmax(abs(norm - 1)))} is not of unit length", where="quat_xyzw")
        position = _array("position", self.position, (n, 3))
        quat = np.where(abs(norm - 1) < 1e-12, quat, quat / norm)  # so that cutting or storing changes no bit
        velocity = _slope(t_ns, position) if self.velocity is None else _array("velocity", self.velocity, (n, 3))
        spin = (
            _spin(t_ns, quat)
            if self.angular_velocity is None
            else _array("angular_velocity", self.angular_velocity, (n, 3))
        )
        for name, value in zip(self.__slots__, (t_ns, position, quat, velocity, spin), strict=True):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        length = float(np.linalg.norm(np.diff(self.position, axis=0), axis=1).sum())
        return f"Trajectory({len(self)} poses, {self.duration_s:.1f} s, {length:.2f} m)"

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, key: slice | NDArray[Any]) -> Trajectory:
        velocity, spin = self.rates
        return Trajectory(self.t_ns[key], self.position[key], self.quat_xyzw[key], velocity[key], spin[key])

    @property
    def rates(self) -> tuple[Floats, Floats]:
        """Velocity (n, 3) [m/s] and angular velocity (n, 3) [rad/s], both always known after construction."""
        if self.velocity is None or self.angular_velocity is None:  # narrows the type; never true once made
            raise InputError("trajectory without rates")
        return self.velocity, self.angular_velocity

    @property
    def duration_s(self) -> float:
        """Time from first to last sample [s]."""
        return float(self.t_ns[-1] - self.t_ns[0]) * 1e-9

    @property
    def world_from_body(self) -> Floats:
        """Transforms (n, 4, 4)."""
        out = np.zeros((len(self), 4, 4))
        out[:, :3, :3] = quat_matrix(self.quat_xyzw)
        out[:, :3, 3] = self.position
        out[:, 3, 3] = 1.0
        return out

    def at(self, t_ns: ArrayLike) -> Trajectory:
        """The trajectory at other times (m): Hermite cubics in position, great arcs in attitude.

        Raises:
            InputError: a time lies outside the trajectory (one sample stands for all times).
        """
        want = np.atleast_1d(checks.times_ns("t_ns", t_ns))
        if want.ndim != 1 or want.size == 0:
            raise InputError(f"t_ns has shape {want.shape}", where="at", allowed="(m,) with m >= 1")
        velocity, spin = self.rates
        if len(self) == 1:
            return Trajectory(
                want, *(np.repeat(a, len(want), 0) for a in (self.position, self.quat_xyzw, velocity, spin))
            )
        if want.min() < self.t_ns[0] or want.max() > self.t_ns[-1]:
            raise InputError("time outside the trajectory", where="at", allowed=f"{self.t_ns[0]} .. {self.t_ns[-1]} ns")
        from scipy.interpolate import CubicHermiteSpline
        from scipy.spatial.transform import Slerp

        known, asked = (self.t_ns - self.t_ns[0]) * 1e-9, (want - self.t_ns[0]) * 1e-9
        before = np.clip(np.searchsorted(known, asked) - 1, 0, len(known) - 2)
        needed = np.union1d(before, before + 1)  # few times of a long path are asked for again and again
        known = known[needed]
        spline = CubicHermiteSpline(known, self.position[needed], velocity[needed])
        quat = Slerp(known, rotations().from_quat(self.quat_xyzw[needed]))(asked).as_quat()
        turn = np.stack([np.interp(asked, known, spin[needed, k]) for k in range(3)], axis=1)
        return Trajectory(want, spline(asked), quat, spline(asked, 1), turn)

    def resampled(self, rate_hz: float) -> Trajectory:
        """Samples at an even rate from the first time on [Hz].

        Raises:
            InputError: the rate is not above zero.
        """
        times = even_times(rate_hz, t0_ns=int(self.t_ns[0]), t1_ns=int(self.t_ns[-1]))
        return self.at(times)

    def mounted(self, body_from_sensor: Floats) -> Trajectory:
        """The path of a sensor fixed to the body by a (4, 4) transform.

        Raises:
            InputError: the transform is not rigid and right-handed.
        """
        body_from_sensor = checks.rigid("body_from_sensor", body_from_sensor, "mounted")
        velocity, spin = self.rates
        rot = quat_matrix(self.quat_xyzw)
        arm = body_from_sensor[:3, 3]
        position = self.position + rot @ arm
        attitude = matrix_quat(rot @ body_from_sensor[:3, :3])
        moving = velocity + np.einsum("nij,nj->ni", rot, np.cross(spin, arm))
        return Trajectory(self.t_ns, position, attitude, moving, spin @ body_from_sensor[:3, :3])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the flight in plan with matplotlib, a dot at its start.

        Args:
            ax: where to draw; None: a new figure.

        Returns:
            The axes.
        """
        return plots().plot_trajectory(self, ax)  # type: ignore[no-any-return]

    @classmethod
    def stationary(
        cls, position_m: Sequence[float] = (0, 0, 0), yaw_deg: float = 0.0, n: int = 1, *, rate_hz: float = 17.0
    ) -> Trajectory:
        """Standing still for `n` samples.

        Raises:
            InputError: no place, no heading, or no whole number of samples.
        """
        t_ns = even_times(rate_hz, count=checks.whole("n", n, "stationary", low=1, allowed="n >= 1"))
        quat = np.tile(rpy_quat(0, 0, np.radians(checks.number("yaw_deg", yaw_deg, "stationary"))), (n, 1))
        still, place = np.zeros((n, 3)), _point("position_m", position_m)
        return cls(t_ns, np.tile(place, (n, 1)), quat, still, still)

    @classmethod
    def line(
        cls,
        start_m: Sequence[float],
        end_m: Sequence[float],
        speed_m_s: float = 0.5,
        rate_hz: float = 17.0,
        *,
        yaw_deg: float = 0.0,
    ) -> Trajectory:
        """A straight track at constant speed and attitude, one sample per 1 / rate_hz.

        Raises:
            InputError: speed or rate is not above zero, or an end is no place.
        """
        a, b = _point("start_m", start_m), _point("end_m", end_m)
        length = float(np.linalg.norm(b - a))
        speed_m_s = checks.number("speed_m_s", speed_m_s, "line", above=0.0, allowed="> 0")
        t_ns = even_times(rate_hz, t1_ns=round(length / speed_m_s * 1e9))
        along = speed_m_s * (b - a) / max(length, 1e-12)
        n = len(t_ns)
        quat = np.tile(rpy_quat(0, 0, np.radians(checks.number("yaw_deg", yaw_deg, "line"))), (n, 1))
        return cls(t_ns, a + t_ns[:, None] * 1e-9 * along, quat, np.tile(along, (n, 1)), np.zeros((n, 3)))


def even_times(rate_hz: float, *, t0_ns: int = 0, t1_ns: int | None = None, count: int | None = None) -> Longs:
    """Longs [ns] at an even rate from t0_ns, `count` of them or up to and with t1_ns; rounded singly, so no drift.

    Raises:
        InputError: the rate is not above zero, or they are more than fit into memory.
    """
    rate_hz = checks.number("rate_hz", rate_hz, "rate_hz", above=0.0, allowed="> 0")
    if count is None:
        count = 1 if t1_ns is None else int((t1_ns - t0_ns) * rate_hz * 1e-9 + 1e-9) + 1
    if count > MOST_SAMPLES:
        raise InputError(f"{count:.3g} samples", where="rate_hz", allowed=f"at most {MOST_SAMPLES}; a lower rate")
    return np.asarray(t0_ns + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))


def _point(name: str, value: ArrayLike) -> Floats:
    """Three finite numbers [m]."""
    return np.asarray(_array(name, np.ravel(checks.array(name, value)), (3,)))


@dataclass(frozen=True, slots=True, eq=False)
class Imu:
    """Readings of an inertial unit at the body's origin, each the mean since the one before it."""

    t_ns: Longs  # (n) strictly rising
    angular_velocity: Floats  # (n, 3) body (FLU) [rad/s]
    specific_force: Floats  # (n, 3) body (FLU) [m/s2]; at rest and level (0, 0, +g)

    def __post_init__(self) -> None:
        t_ns = _rising(self.t_ns)
        object.__setattr__(self, "t_ns", t_ns)
        for name in ("angular_velocity", "specific_force"):
            object.__setattr__(self, name, _array(name, getattr(self, name), (len(t_ns), 3)))

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, key: slice | NDArray[Any]) -> Imu:
        return Imu(self.t_ns[key], self.angular_velocity[key], self.specific_force[key])


@dataclass(frozen=True, slots=True, eq=False)
class Height:
    """Heights of the body, as a barometer or a range to the floor gives them."""

    t_ns: Longs  # (n) strictly rising
    height_m: Floats  # (n) z in the world [m]
    sigma_m: float  # of one reading; their errors are independent [m]

    def __post_init__(self) -> None:
        t_ns = _rising(self.t_ns)
        object.__setattr__(self, "t_ns", t_ns)
        object.__setattr__(self, "height_m", _array("height_m", self.height_m, (len(t_ns),)))
        checks.number("sigma_m", self.sigma_m, "Height", above=0.0, allowed="> 0")

    def __len__(self) -> int:
        return len(self.t_ns)


def _slope(t_ns: Longs, position: Floats) -> Floats:
    if len(t_ns) == 1:
        return np.zeros_like(position)
    order: Literal[1, 2] = 2 if len(t_ns) > 2 else 1
    return np.asarray(np.gradient(position, (t_ns - t_ns[0]) * 1e-9, axis=0, edge_order=order))


def _spin(t_ns: Longs, quat: Floats) -> Floats:
    if len(t_ns) == 1:
        return np.zeros((1, 3))
    rot = rotations().from_quat(quat)
    step = (rot[:-1].inv() * rot[1:]).as_rotvec() / (np.diff(t_ns)[:, None] * 1e-9)
    return np.vstack([step[:1], (step[:-1] + step[1:]) / 2, step[-1:]])


MOST_SAMPLES = 20_000_000
"""Poses of one path: they take 2 GB."""
Unit = Literal["path_gain", "normalised", "thesis"]
LEAST_BINS = 2
"""Range bins of a frame: two have a width."""
MOST_S = 9e9
"""Times lie within 285 years of zero, as nanoseconds in 64 bits do [s]."""
UNEVEN = 0.01
"""Largest deviation of a range bin's width from the median, relative."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Offsets of a radar against a track: what was added to its clock and to its range axis, and how sure that is."""

    t_offset_s: float  # pose clock minus radar clock [s]
    range_offset_m: float  # added to range_m [m]
    t_sigma_s: float  # one sigma [s]
    range_sigma_m: float  # one sigma [m]
    gain_db: float  # coherence of the strongest scatterers gained over the frames as they came [dB]
    method: str = ""  # what the offsets were found from
    probability: float = 0.0  # posterior probability of this candidate; 0: not estimated
    modes: tuple[tuple[float, float, float], ...] = ()  # candidates: clock [s], range [m], probability; best first
    clock_posterior: tuple[tuple[float, float], ...] = ()  # clock offset [s], log density below its greatest value
    scale: float = 1.0  # how many times as large as given the echoes take the track to be; it was not applied
    scale_sigma: float = 0.0  # one sigma; 0: not estimated
    message: str = ""  # what is suspected of the track, and what the echoes cannot tell
    estimates: tuple[tuple[float, ...], ...] = ()  # of `CalibrationPlan`'s nine: value, sigma, sigma of the prior [SI]
    covariance: tuple[tuple[float, ...], ...] = ()  # (9, 9) of them; mount, rate and scale were not applied

    def __post_init__(self) -> None:
        for name in ("modes", "clock_posterior", "estimates", "covariance"):  # JSON gives lists
            object.__setattr__(self, name, tuple(tuple(row) for row in getattr(self, name)))


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFrom:
    """What frames were simulated from: for whoever explains them, never for processing; no recording holds it."""

    scene: Any  # the Scene, which is of a higher layer
    max_bounces: int
    seed: int
    body: BodySpec | None = None  # what the radars saw of the drone itself


@dataclass(frozen=True, slots=True, eq=False)
class Frames(Displayed):
    """What one radar gave: one row of range bins per frame, with the poses that the processor may believe."""

    samples: Samples  # (n, b) complex64 baseband, or float32 RF or amplitude, in `unit`
    range_m: Floats  # (b) rising [m]
    t_ns: Longs  # (n) strictly rising
    spec: RadarSpec
    poses: Trajectory | None = None  # world_from_sensor at t_ns, as believed; None: unknown
    truth: Trajectory | None = None  # world_from_sensor as it was; never handed to processing
    sensor: str = "radar"
    unit: Unit = (
        "path_gain"  # path_gain: sqrt(received / transmitted power); normalised: the sensor's own; thesis: eq. 4.2
    )
    track: Trajectory | None = None  # world_from_sensor over the whole recording, in the pose clock; None: only `poses`
    calibration: Calibration | None = None  # set by ul.calibrate
    simulated: SimulatedFrom | None = None  # set by ul.simulate

    def __post_init__(self) -> None:
        self._check_kinds()
        t_ns = _rising(self.t_ns)
        raw = checks.as_given("samples", self.samples)
        if raw.ndim != 2 or len(raw) != len(t_ns) or raw.shape[1] < LEAST_BINS:
            raise InputError(f"samples have shape {raw.shape}", where=self.sensor,
                             allowed=f"({len(t_ns)}, bins), {LEAST_BINS} bins or more")  # fmt: skip
        samples = checks.array("samples", raw, np.complex64 if np.iscomplexobj(raw) else np.float32)
        range_m = _array("range_m", self.range_m, (samples.shape[1],))
        step = np.diff(range_m)
        if np.any(step <= 0):
            raise InputError("range_m does not rise", where=self.sensor)
        if np.abs(step / np.median(step) - 1).max() > UNEVEN:
            raise InputError("range_m is not evenly spaced", where=self.sensor, allowed="bins of one width")
        for name in ("poses", "truth"):
            path = getattr(self, name)
            if path is not None and not np.array_equal(path.t_ns, t_ns):
                raise InputError(
                    f"{name} are not at the frames' times",
                    where=self.sensor,
                    allowed="one pose per frame; use Trajectory.at",
                )
        for name, value in (("samples", samples), ("range_m", range_m), ("t_ns", t_ns)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_arrays(
        cls,
        samples: ArrayLike,
        range_m: ArrayLike,
        times_s: ArrayLike,
        positions_m: ArrayLike | None = None,
        quaternions_xyzw: ArrayLike | None = None,
        *,
        sensor: str = "radar",
        **radar: Any,
    ) -> Frames:
        """Frames of any radar from plain arrays; the range axis and the frame rate come from the arrays.

        Args:
            samples: profiles (n, b): complex baseband, real RF, or amplitudes, which are real and never negative.
            range_m: range of each bin (b), evenly spaced [m].
            times_s: of each frame (n), rising [s].
            positions_m: of the radar in the world (n, 3) [m], z up; None: unknown, so that nothing can be mapped.
            quaternions_xyzw: world_from_radar (n, 4), or one for all (4). The radar looks along its x axis, with z up.
                None: along the world's x axis.
            sensor: name of the radar.
            **radar: fields of `RadarSpec`, such as center_hz, which images need. Without bandwidth_hz it is that of the
                X4M05, or what the bins can hold.

        Raises:
            InputError: shapes or values do not fit together, naming the argument.
        """
        given, axis = checks.as_given("samples", samples), np.atleast_1d(checks.as_given("range_m", range_m))
        seconds = np.atleast_1d(checks.array("times_s", times_s, np.float64))
        unit = 1.0 if checks.is_in_nanoseconds(seconds.ravel(), "times_s") else 1e9
        if seconds.ndim != 1 or not np.isfinite(seconds).all() or abs(seconds).max(initial=0) * unit > MOST_S * 1e9:
            raise InputError("times_s is not in seconds", where="from_arrays", allowed=f"(n,) within {MOST_S:g} s")
        if axis.ndim != 1 or len(axis) < LEAST_BINS or not np.isfinite(axis).all() or not np.all(np.diff(axis) > 0):
            allowed = f"(bins,) rising and finite [m], {LEAST_BINS} bins or more"
            raise InputError(f"range_m has shape {axis.shape} or does not rise", where="from_arrays", allowed=allowed)
        t_ns = np.rint(seconds * unit).astype(np.int64)
        signed = not np.iscomplexobj(given) and bool(np.any(given < 0))
        width = min(RadarSpec().bandwidth_hz, C0 / 2 / float(np.median(np.diff(axis))))
        spec = RadarSpec(name="arrays").on_axis(
            axis, t_ns, **{"output": "rf" if signed else "baseband", "bandwidth_hz": width, **radar}
        )
        poses = None
        if positions_m is not None:
            turns = checks.array("quaternions_xyzw", (0, 0, 0, 1) if quaternions_xyzw is None else quaternions_xyzw)
            places = checks.array("positions_m", positions_m)
            poses = Trajectory(t_ns, places, np.tile(turns, (len(t_ns), 1)) if turns.shape == (4,) else turns)
        return cls(given, axis, t_ns, spec, poses, sensor=sensor, unit="normalised")

    def _check_kinds(self) -> None:
        """Refuse fields of another type, which no processor could use."""
        for name, kind in (("spec", RadarSpec), ("sensor", str)):
            if not isinstance(given := getattr(self, name), kind):
                raise InputError(f"{name} is {shown(given)}", where="Frames", allowed=f"a {kind.__name__}")
        for name in ("poses", "truth", "track"):
            given = getattr(self, name)
            if given is not None and not isinstance(given, Trajectory):
                raise InputError(f"{name} is a {type(given).__name__}", where="Frames", allowed="a Trajectory, or None")
        if self.unit not in get_args(Unit):
            raise InputError(f"unit is {shown(self.unit)}", where="Frames", allowed=", ".join(get_args(Unit)))

    def __repr__(self) -> str:
        n, bins = self.samples.shape
        seconds, known = float(self.t_ns[-1] - self.t_ns[0]) * 1e-9, "with" if self.poses is not None else "without"
        reach = f"{self.range_m[0]:.2f} to {self.range_m[-1]:.2f} m"
        return f"Frames({self.sensor!r}, {n} x {bins} bins, {seconds:.1f} s, {reach}, {self.unit}, {known} poses)"

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, key: slice | NDArray[Any]) -> Frames:
        poses = None if self.poses is None else self.poses[key]
        truth = None if self.truth is None else self.truth[key]
        return replace(self, samples=self.samples[key], t_ns=self.t_ns[key], poses=poses, truth=truth)

    @property
    def amplitude(self) -> Singles:
        """Magnitude of each bin (n, b)."""
        return np.abs(self.samples)

    @property
    def ray_model(self) -> ThesisSpec | None:
        """Settings of the ray model whose amplitudes these are; None: waves, simulated or received by a real radar."""
        return self.spec.thesis if self.unit == "thesis" else None

    @property
    def believed(self) -> Trajectory:
        """The poses, for a processor that cannot do without.

        Raises:
            InputError: the frames carry no poses.
        """
        if self.poses is None:
            raise InputError("these frames have no poses", where=self.sensor, allowed="frames of a known track")
        return self.poses

    def plot(self, ax: Axes | None = None, *, frame: int | None = None) -> Axes:
        """Draw amplitude over time and range with matplotlib, or one profile.

        Args:
            ax: where to draw; None: a new figure.
            frame: index of the only frame to draw; None: all.

        Returns:
            The axes.

        Raises:
            InputError: there is no such frame.
        """
        return plots().plot_frames(self, ax, frame=frame)  # type: ignore[no-any-return]

    def chunks(self, size: int = 256) -> Iterator[Frames]:
        """The same frames in pieces of at most `size`."""
        for start in range(0, len(self), size):
            yield self[start : start + size]


Recording = Frames | Mapping[str, Frames] | Sequence[Frames]
"""Frames of one sensor, or of several by name or in a row."""


def sensors_of(frames: Recording) -> list[Frames]:
    """Every sensor's frames as a list.

    Raises:
        InputError: nothing, or something else, was given.
    """
    if not isinstance(frames, Frames | Iterable):
        raise InputError(f"frames is {shown(frames)}", where="frames", allowed="Frames, or a dict or list of them")
    parts = [frames] if isinstance(frames, Frames) else list(frames.values() if isinstance(frames, Mapping) else frames)
    if not parts or not all(isinstance(part, Frames) for part in parts):
        raise InputError("no frames", where="frames", allowed="Frames, or a dict or list of them")
    return parts


def one_sensor(frames: object, where: str) -> Frames:
    """The frames of one sensor.

    Raises:
        InputError: something else was given.
    """
    if not isinstance(frames, Frames):
        raise InputError(f"frames is a {type(frames).__name__}", where=where, allowed="Frames of one sensor")
    return frames


def joined(parts: Sequence[Frames]) -> Frames:
    """Pieces of one sensor's recording, in order of time, as one.

    Raises:
        InputError: the pieces differ in sensor, bins or settings.
    """
    if not parts:
        raise InputError("no frames", where="joined")
    first = parts[0]
    if len(parts) == 1:
        return first
    if any(p.sensor != first.sensor or not np.array_equal(p.range_m, first.range_m) for p in parts):
        raise InputError("pieces of different sensors or range axes", where="joined")
    return replace(
        first,
        samples=np.concatenate([p.samples for p in parts]),
        t_ns=np.concatenate([p.t_ns for p in parts]),
        poses=strung([p.poses for p in parts]),
        truth=strung([p.truth for p in parts]),
        simulated=first.simulated if all(p.simulated is first.simulated for p in parts) else None,
    )


def makes_room(kept: list[Frames], part: Frames) -> bool:
    """Whether a piece is to be kept beside others: joined, one without poses would take them from all.

    Pieces without poses are cleared as soon as one with poses comes.
    """
    if part.poses is not None and kept and kept[-1].poses is None:
        kept.clear()
    return part.poses is not None or not kept or kept[-1].poses is None


def gathered(pieces: Iterable[Mapping[str, Frames]]) -> dict[str, Frames]:
    """Pieces of a recording of several sensors, in order of time, as one Frames of each by name."""
    parts: dict[str, list[Frames]] = {}
    for piece in pieces:
        for name, part in piece.items():
            parts.setdefault(name, []).append(part)
    return {name: joined(some) for name, some in parts.items()}


@overload
def strung(paths: Sequence[Trajectory]) -> Trajectory: ...
@overload
def strung(paths: Sequence[Trajectory | None]) -> Trajectory | None: ...
def strung(paths: Sequence[Trajectory | None]) -> Trajectory | None:
    """Pieces of a path, in order of time, as one; None where a piece is not known."""
    known = [p for p in paths if p is not None]
    if len(known) < len(paths):
        return None
    rates = [p.rates for p in known]
    return Trajectory(
        np.concatenate([p.t_ns for p in known]),
        np.concatenate([p.position for p in known]),
        np.concatenate([p.quat_xyzw for p in known]),
        np.concatenate([r[0] for r in rates]),
        np.concatenate([r[1] for r in rates]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Detections(Displayed):
    """Echoes judged to be objects."""

    frame: Longs  # (d) index into the frames
    t_ns: Longs  # (d)
    range_m: Floats  # (d) [m]
    amplitude: Floats  # (d) in the frames' unit
    snr_db: Floats  # (d) over the frame's noise floor [dB], NaN where unknown
    point: Floats  # (d, 3) world [m], NaN where the bearing is unknown
    sensor: str = "radar"

    def __repr__(self) -> str:
        return f"Detections({self.sensor!r}, {len(self)} echoes in {len(np.unique(self.frame))} frames)"

    def __len__(self) -> int:
        return len(self.frame)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw range over time with matplotlib, coloured by signal-to-noise ratio.

        `hits.plot(frames.plot())` draws them as circles over the frames.

        Args:
            ax: where to draw; None: a new figure.

        Returns:
            The axes.
        """
        return plots().plot_detections(self, ax)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class Metric:
    """One measured number."""

    name: str
    value: float
    unit: str = ""
