"""Restricted likelihood of the noise with a set of effects in place, and its derivatives.

The restricted log likelihood of a noise theta, with geometry and effects integrated over their priors, is
-1/2 (ln|V| + ln|Z'V^-1 Z + I| + r'P r); the average information matrix (Gilmour, Thompson, Cullis 1995) stands for its curvature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.linalg import solve_triangular

from mbcacq.diagnosis.evidence.hypothesis import NormalSystem
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.estimation.linear_problem import ExtendedProblem, LinearProblem
from mbcacq.estimation.normal_equations import PoseSystem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior, reml_score_and_information, step_of_log_sigma, unpack


@dataclass(frozen=True, eq=False)
class NoisePoint:
    """A recording at one noise. linear: whose ``joint`` has, after the n of the joints, columns of held size (discrepancy)."""

    linear: LinearProblem
    prior: NoisePrior
    theta: np.ndarray

    def __reduce__(self) -> tuple:
        """Pickled without what can be computed again."""
        return NoisePoint, (self.linear, self.prior, self.theta)

    @cached_property
    def noise(self) -> Noise:
        """The noise of the free components."""
        return unpack(self.theta)

    @cached_property
    def complete_noise(self) -> Noise:
        """The noise of all components, those that are held among them."""
        held = np.ones(self.linear.joint.shape[2] - self.linear.obs.cell.robot.n)
        return replace(self.noise, joint=np.r_[self.noise.joint, held])

    @cached_property
    def projected(self) -> CandidateScoring:
        """The projected problem, in which candidates are compared."""
        return CandidateScoring.of(self.linear, self.complete_noise)

    def extended(self, members: Sequence[Member]) -> ExtendedProblem:
        """Geometry and effects, of coefficients in typical sizes without a prior."""
        linear = self.linear
        columns = np.concatenate([np.zeros((*linear.residual.shape, 0)), *(columns_of(linear, m) for m in members)], axis=2)
        return linear.extended(columns, np.full(columns.shape[2], np.inf))

    def conditioned(self, members: Sequence[Member]) -> CandidateScoring:
        """The projected problem with these effects, each at its most probable size, in place."""
        blocks = [(self.projected.block(m.candidate, m.hyper), 1.0 / (m.size * m.candidate.typical) ** 2) for m in members]
        return self.projected.conditioned_on(blocks)

    def solved(self, members: Sequence[Member]) -> EffectSet:
        """These effects with the posterior of their coefficients, geometry integrated out."""
        p = self.projected
        blocks = (p.block(m.candidate, m.hyper) * m.candidate.typical for m in members)
        X = np.concatenate([np.zeros((len(p.r0), 0)), *blocks], axis=1)
        absorbed = p.Q.T @ X
        return EffectSet.of(members, X.T @ X - absorbed.T @ absorbed, X.T @ p.beyond_geometry())

    def with_effects(self, extended: ExtendedProblem) -> NormalSystem:
        """The normal equations of effects, of k coefficients near one, beyond the geometry. extended: of the geometry and their columns."""
        system = extended.at(self.complete_noise)
        normal, g = system.normal, self.linear.layout.size
        k = normal.size - g
        root = np.linalg.cholesky(normal.information[:g, :g])
        reduced = solve_triangular(root, np.c_[normal.information[:g, g:], normal.gradient[:g]], lower=True)
        A = normal.information[g:, g:] - reduced[:, :k].T @ reduced[:, :k]
        a = normal.gradient[g:] - reduced[:, :k].T @ reduced[:, k]
        chi2 = normal.cost - float(np.sum(normal.station_b**2) + reduced[:, k] @ reduced[:, k])
        scale = self.linear.keep[:, None] * np.log(self.linear.rows.sigma_scale)
        log_det = system.poses.log_det + 2 * np.sum(scale) + normal.station_log_det + 2 * np.log(np.diag(root)).sum()
        log_likelihood = -0.5 * (float(log_det) + chi2) + self.prior.log_density(self.noise)
        return NormalSystem(A, a, log_likelihood, partial(self.score, system))

    def score(self, system: PoseSystem, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and information of the log posterior by theta, with the effects in place. weight (k,): prior weight of each."""
        full, prior, theta = self.complete_noise, self.prior, self.theta
        weighted = system.with_weight(np.r_[np.zeros(system.normal.size - len(weight)), weight])
        gradient, information = reml_score_and_information(weighted.after_fit(), full)
        n = len(self.noise.joint)
        free = np.r_[np.arange(3 + n), len(full.joint) + 3]  # what is held has no derivative
        return gradient[free] - prior.precision @ (theta - prior.centre), information[np.ix_(free, free)] + prior.precision

    def forget(self) -> None:
        """Give back the memory of the projected problem."""
        vars(self).pop("projected", None)

    def restricted(self, keep: np.ndarray) -> NoisePoint:
        """The same noise with only the centres in keep (M,)."""
        return replace(self, linear=self.linear.restricted(keep))

    def moved(self, gradient: np.ndarray, information: np.ndarray) -> tuple[NoisePoint, np.ndarray]:
        """The point after a step of average-information scoring, and the step of the logarithms."""
        step = step_of_log_sigma(np.linalg.solve(information, gradient))
        return replace(self, theta=self.theta + step), step


def columns_of(linear: LinearProblem, member: Member) -> np.ndarray:
    """(M, R, k) of an effect, for coefficients in typical sizes."""
    candidate = member.candidate
    columns = linear.computed_once(("columns", candidate.key, member.hyper), lambda: candidate_columns(linear, candidate, member.hyper))
    return columns * candidate.typical
