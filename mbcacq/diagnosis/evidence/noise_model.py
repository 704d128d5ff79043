"""Restricted likelihood of the noise with a set of effects in place, its maximum, and the integral over the noise (Laplace).

The restricted log likelihood of a noise theta, with geometry and effects integrated over their priors, is
-1/2 (ln|V| + ln|Z'V^-1 Z + I| + r'P r); the average information matrix (Gilmour, Thompson, Cullis 1995) stands for its curvature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.projection import PoseSums
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior, unpack

LARGEST_STEP = 1.0  # of a logarithm in one round


@dataclass(frozen=True, eq=False)
class NoisePoint:
    """The projected problem at one noise. linear: whose ``joint`` has, after the n of the joints, columns of held size (discrepancy)."""

    linear: LinearProblem
    prior: NoisePrior
    theta: np.ndarray

    @cached_property
    def joints(self) -> int:
        return self.linear.obs.cell.robot.n

    @cached_property
    def projected(self) -> CandidateScoring:
        noise, held = unpack(self.theta), np.ones(self.linear.joint.shape[2] - self.joints)
        return CandidateScoring.of(self.linear, replace(noise, joint=np.r_[noise.joint, held]))

    @cached_property
    def noise(self) -> Noise:
        """Without what is held."""
        return unpack(self.theta)

    @cached_property
    def log_likelihood(self) -> float:
        """Restricted log likelihood with geometry alone, and the log prior of the noise."""
        p = self.projected
        return -0.5 * (p.whiten.log_det + p.log_det + p.chi2) + self.prior.log_density(self.noise)

    @cached_property
    def _joint_rows(self) -> np.ndarray:
        """(rows, n) whitened columns of a standard deviation of each joint."""
        return self.projected.whiten(self.linear.joint_columns * self.noise.joint)

    @cached_property
    def _traces(self) -> np.ndarray:
        """tr(P K) of each component, with geometry alone."""
        norms = self.projected.whiten.row_norms()
        rows = np.r_[norms.sum(axis=0)[:3], norms[:, 3:].sum()] * self._row_variances
        joints = np.sum(self._joint_rows**2, axis=0)
        return self._order(rows, joints) - self._squares(self.projected.Q)

    @cached_property
    def _sums(self) -> PoseSums:
        return PoseSums.of(self.linear)

    @cached_property
    def _row_variances(self) -> np.ndarray:
        value = np.exp(2 * self.theta)
        return np.r_[value[:3], value[3 + self.joints :]]

    def _order(self, rows: np.ndarray, joints: np.ndarray) -> np.ndarray:
        return np.r_[rows[:3], joints, rows[3:]]

    def _squares(self, columns: np.ndarray) -> np.ndarray:
        """tr(B' W K W' B) of each component, for whitened columns B (rows, k)."""
        back = self.projected.whiten.transpose(columns) ** 2
        by_row = back.sum(axis=(0, 2)) if back.shape[2] else np.zeros(self.linear.width)
        rows = np.r_[by_row[:3], by_row[3:].sum()] * self._row_variances
        joints = np.sum(self.projected.whiten.pose_products(self._joint_rows, columns) ** 2, axis=(0, 2))
        return self._order(rows, joints)

    def score(self, conditioned: CandidateScoring) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and information of the log posterior by theta, with what the problem is conditioned on in place."""
        p, r, basis = self.projected, conditioned.r, conditioned.conditioned
        trace = self._traces - (self._squares(basis) if basis.shape[1] else 0.0)
        back = p.whiten.transpose(r)
        images = np.zeros((*back.shape, len(self._row_variances)))
        for c in range(len(self._row_variances)):
            rows = slice(c, c + 1) if c < 3 else slice(3, 6)
            images[:, rows, c] = back[:, rows] * self._row_variances[c]
        rows = p.whiten(images)
        b = self._sums(self._joint_rows * r[:, None])
        joints = self._joint_rows * b[self._sums.pose_of_row]
        Y = np.concatenate([rows[:, :3], joints, rows[:, 3:]], axis=1)
        absorbed = np.concatenate([p.Q.T @ Y, basis.T @ Y])
        information = 2 * (Y.T @ Y - absorbed.T @ absorbed) + self.prior.precision
        gradient = Y.T @ r - trace - self.prior.precision @ (self.theta - self.prior.centre)
        return gradient, information

    def restricted(self, keep: np.ndarray) -> NoisePoint:
        """The same noise with only the centres in keep (M,)."""
        return replace(self, linear=self.linear.restricted(keep))

    def moved(self, gradient: np.ndarray, information: np.ndarray) -> tuple[NoisePoint, float]:
        """The point after a step of average-information scoring, and the largest change of a logarithm."""
        step = np.clip(np.linalg.solve(information, gradient), -LARGEST_STEP, LARGEST_STEP)
        return replace(self, theta=self.theta + step), float(np.abs(step).max())
