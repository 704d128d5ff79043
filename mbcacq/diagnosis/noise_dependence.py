"""Noise that depends on the place: whether it grows with reach, with the distance in the field or with the angle of incidence.

Real scanners are noisier far away and at slanting surfaces, and an arm that reaches out sways more. Under one noise for all poses a
search takes the scatter of the noisy ones for effects, and trusts the quiet ones too little. After a search, the squares that its model
leaves are compared over the poses, in two parts. The part that no rigid motion of a pose explains is the instrument's; the rest belongs
to joints and instrument together. Each is a sum of squares of d degrees of freedom whose variance is exp(a + b x) of a covariate x (gamma
regression).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.result import NoiseDependence
from mbcacq.diagnosis.validation.predictive_score import training_score
from mbcacq.effects.covariates import Covariates, artefact_normals
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.model.observations import Observations
from mbcacq.quantities import in_degrees

INSTRUMENT, ALL = "instrument", "instrument and joints"
LEAST_P = 1e-5  # of a dependence, for all covariates that are tried
LEAST_POSES = 20
RANGE = (0.05, 0.95)  # quantiles of a covariate between which the noise is compared
ROUNDS = 30
RANK = 1e-8  # of a pose's rigid motions: singular values below are of motions that no centre shows


Variation = tuple[NoiseDependence, np.ndarray]  # a noise that varies, and its sigma relative to the mean, (P,), at each pose


@dataclass(frozen=True)
class SquaresOfPoses:
    """Whitened squares (P,) and their degrees of freedom (P,)."""

    square: np.ndarray
    dof: np.ndarray

    def varying(self, x: np.ndarray) -> tuple[np.ndarray, float]:
        """(P,) variance exp(a + b x), and twice the log likelihood that it gains over a constant one."""
        used = self.dof > 0
        if used.sum() < LEAST_POSES or np.ptp(x[used]) < 1e-12:
            return np.ones(len(x)), 0.0
        centred = (x - x[used].mean()) / x[used].std()
        A, d, s = np.stack([np.ones(used.sum()), centred[used]], axis=1), self.dof[used], self.square[used]
        constant = float(s.sum() / d.sum())
        beta = np.array([np.log(constant), 0.0])
        for _ in range(ROUNDS):  # Fisher scoring: the expected information is A'diag(d / 2)A
            excess = s / np.exp(A @ beta) - d
            step = np.linalg.solve((A.T * d) @ A, A.T @ excess)
            beta = beta + np.clip(step, -1.0, 1.0)
            if np.abs(step).max() < 1e-6:
                break
        minus_twice = float(np.sum(d * (A @ beta) + s / np.exp(A @ beta)))
        gain = float(d.sum() * np.log(constant) + s.sum() / constant) - minus_twice
        return np.exp(np.stack([np.ones(len(x)), centred], axis=1) @ beta), gain


def covariates(obs: Observations) -> Iterator[tuple[str, str, np.ndarray]]:
    """Name, unit and value (P,) of what the noise may depend on."""
    frames = Covariates(obs).nominal_frames
    yield "reach", "mm", np.linalg.norm(frames[:, -1, :3, 3] - frames[:, 1, :3, 3], axis=1)
    if not Covariates(obs).scanner_on_flange:
        return
    count = np.maximum(np.bincount(obs.pose, minlength=obs.n_poses), 1)
    middle = np.stack([np.bincount(obs.pose, obs.xyz[:, c], obs.n_poses) / count for c in range(3)], axis=1)
    yield "depth in the field", "mm", middle[:, 2]
    yield "distance from the optical axis", "mm", np.hypot(middle[:, 0], middle[:, 1])
    normal = artefact_normals(obs, frames[:, -1, :3, :3])
    yield "angle of incidence", "°", in_degrees(np.arccos(np.clip(np.abs(normal[:, 2]), 0.0, 1.0)))


def noise_variations(full: ModelFit) -> list[Variation]:
    """The noises that vary with a covariate, the instrument's first; none of several recordings, whose noises differ already."""
    linear, noise = full.geometry_only.linear, full.noise
    if linear.obs.noise_scale is not None or linear.obs.n_poses < LEAST_POSES:
        return []
    residual = training_score(full.joint)[1]
    within, rigid = squares_of_poses(linear, residual / linear.rows.row_sigma(noise))
    whole = full.geometry_only.whiten(residual) ** 2
    total = np.bincount(np.repeat(linear.obs.pose, linear.width), whole, linear.obs.n_poses)
    out = []
    instrument = varying_most(linear.obs, within, INSTRUMENT, float(np.sqrt(np.mean(noise.point**2))))
    scale = instrument[1] if instrument else np.ones(linear.obs.n_poses)
    out += [instrument] if instrument else []
    # The rest of the rigid motions counts only in so far as the instrument's own variation does not say already.
    moved = SquaresOfPoses(np.maximum(total - within.square, 0.0) / scale**2, rigid)
    rest = varying_most(linear.obs, moved, ALL, float(np.sqrt(np.mean(noise.point**2))))
    return [*out, rest] if rest else out


def squares_of_poses(linear: LinearProblem, scaled: np.ndarray) -> tuple[SquaresOfPoses, np.ndarray]:
    """Squares of a residual (M, R) in units of the instrument's noise that no rigid motion of the pose explains; and the rank (P,) of the
    rigid motions.
    """
    keep = linear.keep[:, None]
    rows = linear.rows
    columns = rows.per_pose(rows.pad(np.where(keep[:, :, None], linear.prediction.gradient, 0.0)))
    values = rows.per_pose(rows.pad(np.where(keep, scaled, 0.0)[:, :, None]))[:, :, 0]
    lengths = np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    U, s, _ = np.linalg.svd(columns / lengths, full_matrices=False)
    moves = s > RANK * np.maximum(s[:, :1], 1e-300)
    along = np.einsum("prk,pr->pk", U, values) * moves
    count = np.bincount(linear.obs.pose, linear.keep, linear.obs.n_poses) * linear.width
    rank = np.minimum(moves.sum(axis=1), count)
    return SquaresOfPoses(np.maximum(np.sum(values**2, axis=1) - np.sum(along**2, axis=1), 0.0), count - rank), rank


def varying_most(obs: Observations, squares: SquaresOfPoses, of: str, sigma_mm: float) -> Variation | None:
    """The variation with the covariate by which the squares vary most; None if it is no more than chance, or too little to matter."""
    tried = [(name, unit, x, *squares.varying(x)) for name, unit, x in covariates(obs)]
    name, unit, x, variance, gain = max(tried, key=lambda one: one[4])
    p_value = min(float(chdtrc(1, max(gain, 0.0))) * len(tried), 1.0)
    scale = np.sqrt(variance / np.exp(np.mean(np.log(variance))))
    low, high = np.quantile(x, RANGE)
    near, far = (float(np.interp(end, np.sort(x), scale[np.argsort(x)])) for end in (low, high))
    if p_value > LEAST_P or max(near, far) < OPTIONS.noticeable * min(near, far):
        return None
    low, high, near, far = float(low), float(high), sigma_mm * near, sigma_mm * far
    entry = NoiseDependence(of=of, covariate=name, unit=unit, low=low, high=high, sigma_low_mm=near, sigma_high_mm=far, p_value=p_value)
    return entry, scale


def with_noise_scale(obs: Observations, found: list[Variation]) -> Observations:
    """The observations with the noise of each pose relative to the mean, as several recordings have it."""
    scale = np.ones((obs.n_poses, 3 + obs.cell.robot.n))
    for entry, relative in found:
        scale[:, : None if entry.of == ALL else 3] *= relative[:, None]
    return replace(obs, noise_scale=scale)
