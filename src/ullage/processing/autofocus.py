"""Correct poses by minimum image entropy, with a prior from the navigation's errors."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Singles
from ullage.data import Frames, Trajectory
from ullage.errors import InputError, UllageWarning
from ullage.grids import Grid
from ullage.processing.backprojection import Backprojector, oversampled, oversampling
from ullage.processing.baseband import checked, to_baseband
from ullage.processing.sar import frame_weights


def autofocus(
    frames: Frames,
    grid: Grid,
    *,
    white_m: float = 0.003,
    drift_m: float = 0.05,
    knot_s: float = 2.0,
    patches: int = 8,
    rounds: int = 3,
) -> Frames:
    """Frames whose poses are moved so that the image's entropy is least [Kragh2006].

    Each frame may move by its own step of sigma `white_m`, and all together along a spline of sigma `drift_m` with a
    knot each `knot_s`. The brightest patches of the image are used, half of them held out: the corrections are kept
    only where the held-out half, which they never saw, grew sharper too. Otherwise the frames come back as they were,
    so that autofocus never makes an image worse by its own measure.

    Args:
        frames: one sensor's frames, complex baseband or RF, with poses.
        grid: where the scene is; a plane without a height takes the sensors' mean height.
        white_m: sigma of the error of a single pose [m]; 0: none.
        drift_m: sigma of the smooth error [m]; 0: none.
        knot_s: time between the spline's knots [s].
        patches: how many bright patches to use.
        rounds: number of times that echoes are read again at the corrected ranges.

    Raises:
        InputError: no poses, no phase, or a prior out of bounds.
    """
    if white_m < 0 or drift_m < 0 or white_m + drift_m == 0 or knot_s <= 0:
        raise InputError(
            f"white_m {white_m}, drift_m {drift_m}, knot_s {knot_s}", where="autofocus", allowed=">= 0, not all 0"
        )
    grid = grid.at_height(float(frames.believed.position[:, 2].mean()))
    cells = _bright_patches(checked(frames), grid, patches)
    if len(cells) < 2:
        warnings.warn("nothing bright enough to focus on; poses left alone", UllageWarning, stacklevel=2)
        return frames
    basis = _basis(frames, white_m, drift_m, knot_s)
    tried = _moved(frames, _solve(frames, np.concatenate(cells[::2]), basis, rounds))
    test = np.concatenate(cells[1::2])
    if not entropy_at(tried, test) < entropy_at(frames, test):
        return frames
    best = _moved(frames, _solve(frames, np.concatenate(cells), basis, rounds))
    everywhere = np.concatenate(cells)
    return best if entropy_at(best, everywhere) < entropy_at(frames, everywhere) else frames


def entropy_at(frames: Frames, points: Floats) -> float:
    """Entropy [nats] of the image at points (m, 3)."""
    return PointEchoes.of(frames, points).entropy(np.zeros((len(frames), 3)))[0]


def _bright_patches(frames: Frames, grid: Grid, most: int) -> list[Floats]:
    """Points (m, 3) around the brightest cells that stay coherent, one array a patch, brightest first."""
    image = Backprojector(grid)
    image.update(frames, weights=frame_weights(frames))
    score = np.abs(image.values).astype(float) ** 2 * np.sqrt(image.coherence)
    axes = np.meshgrid(*((grid.z_m,) if grid.dims == 3 else ()), grid.y_m, grid.x_m, indexing="ij")[::-1]
    places = np.stack([*axes, *(() if grid.dims == 3 else (np.full(grid.shape, grid.origin_m[2]),))], axis=-1)
    fine = frames.spec.wavelength_m / 2
    offset = np.stack(np.meshgrid(np.arange(-6, 7), np.arange(-6, 7), indexing="ij"), -1).reshape(-1, 2) * fine
    out: list[Floats] = []
    top = float(score.max())
    while len(out) < most and score.max() > 1e-3 * top > 0:
        centre = places[np.unravel_index(int(score.argmax()), score.shape)]
        out.append(centre + np.column_stack([offset, np.zeros(len(offset))]))
        score[np.linalg.norm(places - centre, axis=-1) < 13 * fine] = 0
    return out


@dataclass(frozen=True, slots=True)
class PointEchoes:
    """What each frame adds to each point, and how that turns as the frame is moved."""

    parts: NDArray[np.complex64]  # (m, n) weighted
    toward: Singles  # (m, n, 3) unit vectors from sensor to point
    turn: float  # phase per metre, 4 pi / wavelength

    @classmethod
    def of(cls, frames: Frames, points: Floats) -> PointEchoes:
        """The echoes of all frames (n) at some points (m, 3) [m]."""
        bin_m = float(np.diff(frames.range_m).mean())
        factor = oversampling(frames.spec, bin_m)
        fine = oversampled(to_baseband(frames), factor)
        ray = points[:, None, :] - frames.believed.position[None]
        reach = np.linalg.norm(ray, axis=2)
        u = np.clip((reach - frames.range_m[0]) * factor / bin_m, 0, fine.shape[1] - 1.001)
        low = u.astype(int)
        row = np.arange(len(frames))[None, :]
        echo = fine[row, low] + (u - low) * (fine[row, low + 1] - fine[row, low])
        turn = 4 * np.pi / frames.spec.wavelength_m
        weight = frame_weights(frames) / len(frames)
        parts = echo * np.exp(1j * turn * reach) * weight
        return cls(parts.astype(np.complex64), (ray / reach[..., None]).astype(np.float32), turn)

    def entropy(self, step: Floats) -> tuple[float, Floats]:
        """Entropy of the points' power when each frame is moved by `step` (n, 3), and its gradient (n, 3)."""
        phase = -self.turn * np.einsum("mnk,nk->mn", self.toward, step.astype(np.float32))
        turned = self.parts * np.exp(1j * phase)
        image = turned.sum(1)
        power = np.abs(image).astype(float) ** 2
        total = max(float(power.sum()), 1e-300)
        share = np.log(power / total + 1e-30)
        value = float(-(power / total * share).sum())
        slope = -(share + value) / total  # d value / d power
        # d power / d phase_mn = 2 Re(conj(B_m) j t_mn) = -2 Im(conj(B_m) t_mn)
        by_phase = slope[:, None] * -2 * np.imag(image.conj()[:, None] * turned)
        return value, np.asarray(-self.turn * np.einsum("mn,mnk->nk", by_phase, self.toward), np.float64)


def _basis(frames: Frames, white_m: float, drift_m: float, knot_s: float) -> Floats:
    """Columns (n, k) scaled so that unit coefficients are one sigma."""
    from scipy.interpolate import BSpline

    n = len(frames)
    columns = [white_m * np.eye(n)] if white_m > 0 else []
    if drift_m > 0:
        time = (frames.t_ns - frames.t_ns[0]) * 1e-9
        pieces = max(1, int(np.ceil(time[-1] / knot_s)))
        inner = np.linspace(0, max(time[-1], 1e-9), pieces + 1)
        knots = np.r_[[inner[0]] * 3, inner, [inner[-1]] * 3]
        columns.append(drift_m * BSpline.design_matrix(time, knots, 3).toarray())
    return np.concatenate(columns, axis=1)


def _solve(frames: Frames, points: Floats, basis: Floats, rounds: int) -> Floats:
    """The most likely steps (n, 3) [m]: frames x entropy / 2 plus the prior, echoes read anew each round."""
    from scipy.optimize import minimize

    guess = np.zeros((basis.shape[1], 3))
    for _ in range(rounds):
        start = basis @ guess
        echoes = PointEchoes.of(_moved(frames, start), points)

        def cost(flat: Floats, echoes: PointEchoes = echoes, start: Floats = start) -> tuple[float, Floats]:
            c = flat.reshape(-1, 3)
            value, slope = echoes.entropy(basis @ c - start)
            scale = len(frames) / 2
            return scale * value + float((c**2).sum()) / 2, (scale * basis.T @ slope + c).ravel()

        options: Any = {"maxiter": 60}
        found: Any = minimize(cost, guess.ravel(), jac=True, method="L-BFGS-B", options=options)
        guess = found.x.reshape(guess.shape)
    return np.asarray(basis @ guess)


def _moved(frames: Frames, step: Floats) -> Frames:
    path = frames.believed
    return replace(frames, poses=Trajectory(path.t_ns, path.position + step, path.quat_xyzw))
