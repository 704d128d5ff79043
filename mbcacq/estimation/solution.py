"""An estimate with the whitened normal equations of its linearised problem, under a noise and weights: what a solver moves from step to
step. Its covariance is averaged over what the noise may be.

Ten poses leave the repeatability of the joints uncertain by a factor of 1.8, and a covariance under the most probable noise is then too
small: it grows with the square of the noise, whose mean lies above the most probable value, and the estimate itself depends on the noise
(Kackar and Harville 1984). Both are averaged over the posterior of the noise's logarithms along its longest axis, which is the level that
the joints share, at points on a grid that weigh what the posterior is there (as Rue, Martino and Chopin 2009 integrate hyper-parameters).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.estimation.linearization import EvaluatedEstimate, Lineariser
from mbcacq.estimation.normal_equations import Normal, PoseSystem, Prior
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import UNDETERMINED, Estimate, ParameterLayout
from mbcacq.estimation.pose_columns import PoseColumns
from mbcacq.estimation.pose_information import PoseInformation, Weights
from mbcacq.estimation.variance_components import log_restricted_posterior, pack, reml_score_and_information, unpack
from mbcacq.estimation.whitening import Whitening

# Rotations (rad) over which the problem is as good as linear: their second order moves a point 1 m away by 20 nm.
LINEAR_ROTATION = 2e-4


@dataclass(frozen=True)
class SolverStep:
    """A step (g,) of the parameters and (S', 6) of the stations in use, from a solution within its linear problem."""

    start: Solution
    parameters: np.ndarray
    stations: np.ndarray


@dataclass(frozen=True)
class Solution:
    """An estimate and the whitened system at it. X: (P, B R, g + 7) whitened; cost: chi square with the prior rows.

    lineariser: of the recording and its parameters. there: where the residual was evaluated. poses, normal: by the columns and under the
    noise and weights. step: what led from there here within the linear problem; None where the residual is that of the estimate itself.
    turned: rad, at most, of any rotation since the columns were made.
    """

    lineariser: Lineariser
    there: EvaluatedEstimate
    poses: PoseInformation
    normal: Normal
    noise: Noise
    weights: Weights
    iterations: int
    turned: float = 0.0
    step: SolverStep | None = None

    @property
    def residual(self) -> np.ndarray:
        """(M, R)."""
        return self.there.residual

    @property
    def prior(self) -> Prior:
        return self.there.prior

    @property
    def columns(self) -> PoseColumns:
        return self.poses.columns

    @property
    def exact(self) -> bool:
        """Whether the residual was evaluated at the estimate."""
        return self.step is None

    @property
    def determined(self) -> bool:
        """Whether the data determine every free parameter; as the smallest eigenvalue says, but cheaper."""
        scale = self.lineariser.layout.scale
        try:
            np.linalg.cholesky(scale[:, None] * self.normal.information * scale - np.eye(len(scale)) / UNDETERMINED**2)
        except np.linalg.LinAlgError:
            return False
        return True

    @cached_property
    def estimate(self) -> Estimate:
        if self.step is None:
            return self.there.estimate
        lineariser, step = self.lineariser, self.step
        return self.there.estimate.moved(lineariser.layout, step.parameters, step.stations, lineariser.rows.stations)

    @property
    def cost(self) -> float:
        return self.normal.cost

    @property
    def system(self) -> PoseSystem:
        return PoseSystem(self.poses, self.normal)

    @cached_property
    def whitening(self) -> Whitening:
        return Whitening(self.normal.rows, self.columns.of_joints, self.noise, self.weights.centre, self.weights.pose)

    @cached_property
    def X(self) -> np.ndarray:
        return self.whitening(self.columns.dense)

    @property
    def whitened_residual(self) -> np.ndarray:
        """(M, R) of unit variance."""
        rows = self.normal.rows
        return rows.unpad(self.whitening(self.columns.residual[..., None]))[..., 0]

    def forget(self, columns_too: bool = False) -> None:
        """Give back the memory of what is made again where it is asked for, before one under another noise takes the place of this one.
        columns_too: one with other columns.
        """
        for at in (self,) if self.step is None else (self, self.step.start):
            at.poses.forget(columns_too)
            vars(at).pop("whitening", None)
            vars(at.there).pop("prediction", None)

    def reweighted(self, noise: Noise, weights: Weights) -> Solution:
        """The system with other noise or weights, at the estimate where the residual was evaluated."""
        if noise is self.noise and weights is self.weights:
            return self
        at = self if self.step is None else self.step.start
        poses = at.poses_under(noise, weights)
        normal = Normal(self.lineariser.rows, poses.products(), poses.right_hand_side(), at.prior)
        return replace(at, poses=poses, normal=normal, noise=noise, weights=weights)

    def poses_under(self, noise: Noise, weights: Weights) -> PoseInformation:
        """The poses of an exact solution with other noise or weights."""
        if weights is self.weights:
            return self.poses.with_noise(noise)
        return PoseInformation.of(self.lineariser.rows, self.columns, noise, weights.centre, weights.pose)

    def with_priors(self, layout: ParameterLayout) -> Solution:
        """The system with other priors of the same parameters, at the estimate where the residual was evaluated."""
        at = self if self.step is None else self.step.start
        lineariser = at.lineariser.with_layout(layout)
        there = replace(at.there, prior=replace(at.prior, sigma=layout.sigma))
        return replace(at, lineariser=lineariser, there=there, normal=at.normal.with_prior(there.prior, at.prior))

    def stepped(self, step: np.ndarray) -> Solution:
        """The same linear problem after a step (g,) of the parameters and the best stations; of an exact solution."""
        rows, station_step = self.lineariser.rows, self.normal.station_step(step)
        residual = self.poses.residual_after(step, station_step)
        offset, station_offset = self.prior.offset + step, self.prior.station_offset + station_step
        prior = replace(self.prior, offset=offset, station_offset=station_offset)
        there = replace(self.there, residual=self.lineariser.unweighted(rows.unpad(residual)), rows=residual, prior=prior)
        poses = self.poses.with_residual(replace(self.columns, residual=residual))
        return replace(self, there=there, poses=poses, normal=self.normal.after(step), step=SolverStep(self, step, station_step))

    def evaluated(self) -> Solution:
        """The system with the residual at its estimate; its columns are made anew where a rotation since they were made is not small."""
        if self.step is None:
            return self
        turned = self.turned + largest_rotation(self.lineariser.layout, self.step.parameters, self.step.stations)
        there = self.lineariser.evaluate(self.estimate)
        return self.moved(there, turned, self.iterations)

    def moved(self, there: EvaluatedEstimate, turned: float, iterations: int, reuse: float = LINEAR_ROTATION) -> Solution:
        """The system at another estimate, under the same noise and weights. turned: rad, at most, of any rotation since the columns were
        made; within ``reuse`` they stay as they are."""
        if turned >= reuse:
            self.forget(columns_too=True)
            return _whitened(self.lineariser, there, self.noise, self.weights, iterations)
        poses = self.poses.with_residual(replace(self.columns, residual=there.rows))
        normal = self.normal.with_right_hand_side(*poses.right_hand_side(), there.prior)
        return replace(self, there=there, poses=poses, normal=normal, turned=turned, step=None, iterations=iterations)


def system(lineariser: Lineariser, estimate: Estimate, noise: Noise, weights: Weights) -> Solution:
    """The whitened normal equations at an estimate."""
    return _whitened(lineariser, lineariser.evaluate(estimate), noise, weights, 0)


def _whitened(lineariser: Lineariser, there: EvaluatedEstimate, noise: Noise, weights: Weights, iterations: int) -> Solution:
    poses = PoseInformation.of(lineariser.rows, lineariser.at(there), noise, weights.centre, weights.pose)
    normal = Normal(lineariser.rows, poses.products(), poses.right_hand_side(), there.prior)
    return Solution(lineariser, there, poses, normal, noise, weights, iterations)


def largest_rotation(layout: ParameterLayout, step: np.ndarray, station_step: np.ndarray) -> float:
    """Largest rotation (rad) of the arm's links, the hand-eye or a station in a step."""
    turning = layout.turning
    largest = np.abs(step[: len(turning)][turning]).max(initial=0.0)
    return float(max(largest, np.abs(station_step[:, 3:]).max(initial=0.0)))


# More poses leave less than LEAST_VARIANCE along that axis (seen with arms of six and of seven axes).
FEW_POSES = 64
LEAST_VARIANCE = 0.05  # of a logarithm: it makes a standard deviation 5 % larger
LARGEST_VARIANCE = 0.5  # a grid by a larger one would be too wide for what the posterior is
GRID = np.linspace(-2.25, 3.0, 8)  # standard deviations; the posterior of a small noise has its longer tail where it is larger


def covariance_of(at: Solution) -> np.ndarray:
    """Covariance of the free parameters.

    Parameters
    ----------
    at : Solution
        Converged, under its most probable noise.

    Returns
    -------
    np.ndarray
        (g, g), mm and rad, as the layout has the parameters.
    """
    if at.lineariser.obs.n_poses > FEW_POSES:
        return covariance_under_its_noise(at)
    at = at.evaluated()
    axis = _longest_axis(at)
    return covariance_under_its_noise(at) if axis is None else _averaged_along(at, axis)


def covariance_under_its_noise(at: Solution) -> np.ndarray:
    """(g, g) covariance of the free parameters if the noise is as the solution has it."""
    scale = at.lineariser.layout.scale
    return scale[:, None] * positive_inverse(scale[:, None] * at.normal.information * scale) * scale


def positive_inverse(H: np.ndarray) -> np.ndarray:
    """Inverse (g, g) of a symmetric matrix that is positive but for rounding: a variance never comes out negative, as it may from a plain
    inverse where the largest and the smallest information are 16 digits apart. Such directions get the variance of the rounding."""
    value, vector = np.linalg.eigh(H)
    return (vector / np.maximum(value, 1e-15 * len(H) * value[-1])) @ vector.T if len(H) else H


def _longest_axis(at: Solution) -> np.ndarray | None:
    """(K,) step of the noise's logarithms, a standard deviation along the longest axis of their posterior; None where that is short."""
    _, information = reml_score_and_information(at.system, at.noise)
    seen = slice(None) if at.lineariser.rows.width > 3 else slice(-1)  # without measured orientations their noise has no part in it
    variances, axes = np.linalg.eigh(np.linalg.inv((information + at.lineariser.noise_prior.precision)[seen, seen]))
    if variances[-1] < LEAST_VARIANCE:
        return None
    step = np.zeros(len(information))
    step[seen] = np.sqrt(min(variances[-1], LARGEST_VARIANCE)) * axes[:, -1]
    return step


def _averaged_along(at: Solution, axis: np.ndarray) -> np.ndarray:
    """(g, g) mean of the covariances along an axis (K,), and covariance of the estimates there."""
    scale, prior = at.lineariser.layout.scale, at.lineariser.noise_prior
    log_density, covariances, steps = [], [], []
    for along in GRID:
        noise = unpack(pack(at.noise) + along * axis)
        there = at.reweighted(noise, at.weights)
        log_density.append(log_restricted_posterior(there.system.after_fit(), noise, prior))
        covariances.append(covariance_under_its_noise(there))
        steps.append(there.normal.gauss_newton_step(scale))
    weight = np.exp(np.array(log_density) - max(log_density))
    weight /= weight.sum()
    off = np.array(steps) - weight @ np.array(steps)
    return np.einsum("k,kij->ij", weight, np.array(covariances)) + off.T @ (weight[:, None] * off)
