"""Gauss-Newton with Levenberg-Marquardt damping, on the manifold of the cell's transforms, with station poses eliminated; under a fixed
noise, and outliers rejected by turns with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.errors import ContradictionError
from mbcacq.estimation.identifiability import determines
from mbcacq.estimation.linearization import Evaluation, Lineariser, Linearization
from mbcacq.estimation.normal_equations import Normal, PoseSystem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.outliers import Weights, outlier_distances, reject_outliers
from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.pose_information import PoseInformation
from mbcacq.estimation.prior import Prior, prior_rows
from mbcacq.estimation.whitening import Whitening

COARSE = 1e-2  # of chi square: tolerance of a fit that another follows
OUTLIER_ROUNDS = 8
REJECTED_SHARE = 0.4
SMALLEST_SHARE = 1e-4
# Steps over which the problem is as good as linear: rotations (rad) whose second order moves a point 1 m away by 20 nm, and a decrease of
# chi square of a few standard deviations.
LINEAR_ROTATION, LINEAR_DECREASE = 2e-4, 10.0


@dataclass(frozen=True)
class SolverStep:
    """A step (g,) of the parameters and (S', 6) of the stations in use, from a solution within its linear problem."""

    start: Solution
    parameters: np.ndarray
    stations: np.ndarray


@dataclass(frozen=True)
class Solution:
    """An estimate and the whitened system at it. X: (P, B R, g + 7) whitened; cost: chi square with the prior rows.

    lineariser: of the recording and its parameters. origin: estimate at which the residual was evaluated. step: what led from there here
    within the linear problem; None where the residual is that of the estimate itself. turned: rad, at most, of any rotation since the
    columns were made.
    """

    lineariser: Lineariser
    origin: Estimate
    linear: Linearization
    poses: PoseInformation
    normal: Normal
    prior: Prior
    noise: Noise
    weights: Weights
    iterations: int
    turned: float = 0.0
    step: SolverStep | None = None

    @property
    def exact(self) -> bool:
        """Whether the residual was evaluated at the estimate."""
        return self.step is None

    @cached_property
    def estimate(self) -> Estimate:
        if self.step is None:
            return self.origin
        return moved_estimate(self.origin, self.lineariser, self.step.parameters, self.step.stations)

    @property
    def cost(self) -> float:
        return self.normal.cost

    @property
    def system(self) -> PoseSystem:
        return PoseSystem(self.poses, self.normal)

    @cached_property
    def whitening(self) -> Whitening:
        return Whitening(self.normal.rows, self.linear.J, self.noise, self.weights.centre, self.weights.pose)

    @cached_property
    def X(self) -> np.ndarray:
        return self.whitening(self.linear.X)

    @property
    def whitened_residual(self) -> np.ndarray:
        """(M, R) of unit variance."""
        rows = self.normal.rows
        return rows.unpad(self.whitening(self.linear.columns.residual[..., None]))[..., 0]

    def reweighted(self, noise: Noise, weights: Weights) -> Solution:
        """The system with other noise or weights, at the estimate where the residual was evaluated."""
        if noise is self.noise and weights is self.weights:
            return self
        at = self if self.step is None else self.step.start
        poses = at.poses_under(noise, weights)
        normal = Normal(self.lineariser.rows, poses.normal_equations(), at.prior)
        return replace(at, poses=poses, normal=normal, noise=noise, weights=weights)

    def poses_under(self, noise: Noise, weights: Weights) -> PoseInformation:
        """The poses of an exact solution with other noise or weights."""
        if weights is self.weights:
            return self.poses.with_noise(noise)
        return PoseInformation.of(self.lineariser.rows, self.linear.columns, noise, weights.centre, weights.pose)

    def with_priors(self, layout: ParameterLayout) -> Solution:
        """The system with other priors of the same parameters, at the estimate where the residual was evaluated."""
        at = self if self.step is None else self.step.start
        lineariser = at.lineariser.with_layout(layout)
        prior = prior_rows(lineariser.obs.cell, layout, at.origin, lineariser.rows.stations)
        return replace(at, lineariser=lineariser, prior=prior, normal=at.normal.with_prior(prior, at.prior))

    def stepped(self, step: np.ndarray) -> Solution:
        """The same linear problem after a step (g,) of the parameters and the best stations; of an exact solution."""
        rows, station_step = self.lineariser.rows, self.normal.station_step(step)
        residual = self.poses.residual_after(step, station_step)
        columns = replace(self.linear.columns, residual=residual)
        return replace(
            self,
            linear=replace(self.linear, residual=self.lineariser.unweighted(rows.unpad(residual)), columns=columns),
            poses=self.poses.with_residual(columns),
            normal=self.normal.after(step),
            prior=replace(self.prior, offset=self.prior.offset + step, station_offset=self.prior.station_offset + station_step),
            step=SolverStep(self, step, station_step),
        )

    def evaluated(self) -> Solution:
        """The system with the residual at its estimate; its columns are made anew where a rotation since they were made is not small."""
        if self.step is None:
            return self
        turned = self.turned + largest_rotation(self.lineariser.layout, self.step.parameters, self.step.stations)
        there = self.lineariser.evaluate(self.estimate)
        if turned > LINEAR_ROTATION:
            return _linearised(self.lineariser, there, self.noise, self.weights, self.iterations)
        return self.moved(there, turned, self.iterations)

    def moved(self, there: Evaluation, turned: float, iterations: int) -> Solution:
        """The system at a nearby estimate with the columns as they are."""
        columns = replace(self.linear.columns, residual=there.rows)
        poses = self.poses.with_residual(columns)
        return replace(
            self,
            origin=there.estimate,
            linear=Linearization(there.prediction, there.residual, columns),
            poses=poses,
            normal=self.normal.with_right_hand_side(*poses.right_hand_side(), there.prior),
            prior=there.prior,
            turned=turned,
            step=None,
            iterations=iterations,
        )


def system(lineariser: Lineariser, estimate: Estimate, noise: Noise, weights: Weights) -> Solution:
    """The whitened normal equations at an estimate."""
    return _linearised(lineariser, lineariser.evaluate(estimate), noise, weights, 0)


def _linearised(lineariser: Lineariser, there: Evaluation, noise: Noise, weights: Weights, iterations: int) -> Solution:
    linear = lineariser.at(there)
    poses = PoseInformation.of(lineariser.rows, linear.columns, noise, weights.centre, weights.pose)
    return Solution(
        lineariser=lineariser,
        origin=there.estimate,
        linear=linear,
        poses=poses,
        normal=Normal(lineariser.rows, poses.normal_equations(), there.prior),
        prior=there.prior,
        noise=noise,
        weights=weights,
        iterations=iterations,
    )


def largest_rotation(layout: ParameterLayout, step: np.ndarray, station_step: np.ndarray) -> float:
    """Largest rotation (rad) of the arm's links, the hand-eye or a station in a step."""
    turning = layout.turning
    largest = np.abs(step[: len(turning)][turning]).max(initial=0.0)
    return float(max(largest, np.abs(station_step[:, 3:]).max(initial=0.0)))


def moved_estimate(estimate: Estimate, lineariser: Lineariser, step: np.ndarray, station_step: np.ndarray) -> Estimate:
    """The estimate after a step (g,) and local twists (S', 6) of the stations in use."""
    whole = np.zeros((len(estimate.state.T_base_station), 6))
    whole[lineariser.rows.stations] = station_step
    return estimate.moved(lineariser.layout, step, whole)


def robust_solve(start: Solution, tolerance: float, reuse: float = LINEAR_ROTATION) -> Solution:
    """Solve, the last step within the linear problem, and reject outliers by turns until no weight changes. reuse: as ``solve`` has it.

    Raises ContradictionError where more than REJECTED_SHARE would go.
    """
    lineariser, options = start.lineariser, start.lineariser.options
    solution = solve(start, tolerance=tolerance, within_linear=True, reuse=reuse)
    for _ in range(OUTLIER_ROUNDS if options.robust else 0):
        before = solution.weights
        weights = reject_outliers(outlier_distances(solution.poses, solution.noise, before), before, lineariser.obs.pose)
        if np.array_equal(weights.centre, before.centre) and np.array_equal(weights.pose, before.pose):
            break
        everything = Weights.full(lineariser.obs)
        if np.mean(weights.pose == 0) > REJECTED_SHARE or np.mean(weights.centre == 0) > REJECTED_SHARE:
            if not options.refuse:
                # So many are structure, not outliers.
                return solve(solution, weights=everything, tolerance=tolerance, within_linear=True, reuse=reuse)
            raise ContradictionError(
                f"more than {REJECTED_SHARE:.0%} of the measurements contradict the rest; check the certificate of the "
                "artefact, the stations, and that joint angles and scans belong together"
            )
        determined = determines(lineariser.layout, solution.normal.information)
        solution = solve(solution, weights=weights, tolerance=tolerance, within_linear=True, reuse=reuse)
        if determined and not determines(lineariser.layout, solution.normal.information):
            # What is left determines less than everything did: the noise is taken for too small, and its estimate comes first.
            return solve(solution, weights=everything, tolerance=tolerance, within_linear=True, reuse=reuse)
    return solution


def solve(
    start: Solution,
    noise: Noise | None = None,
    weights: Weights | None = None,
    *,
    tolerance: float = 1e-6,
    limit: int = 30,
    within_linear: bool = False,
    reuse: float = LINEAR_ROTATION,
) -> Solution:
    """Iterate until the next step would take less than ``tolerance`` off the cost (chi square).

    noise, weights: those of the start if not given. within_linear: a small step is the last, and is taken within the linear problem; then
    the solution is not ``exact``. reuse: rotation (rad) over which columns are kept from step to step.
    """
    lineariser, layout = start.lineariser, start.lineariser.layout
    noise, weights = start.noise if noise is None else noise, start.weights if weights is None else weights
    now = (start if within_linear else start.evaluated()).reweighted(noise, weights)
    damping, share = 0.0, 1.0
    taken = now.normal.decrease(start.step.parameters) if within_linear and start.step is not None and now.step is None else 0.0
    for iteration in range(1, limit + 1):
        step = gauss_newton_step(now.normal, layout.scale, damping)
        promised = now.normal.decrease(step)
        if promised < tolerance or share < SMALLEST_SHARE:
            break
        if now.step is not None:
            now = now.evaluated()
            continue
        station_step = now.normal.station_step(step)
        turned = now.turned + share * largest_rotation(layout, step, station_step)
        if within_linear and not damping and promised - taken < LINEAR_DECREASE and turned < LINEAR_ROTATION:
            return now.stepped(step)
        there = lineariser.evaluate(moved_estimate(now.origin, lineariser, share * step, share * station_step))
        # The weights depend weakly on the estimate; a step is judged by those it was computed with.
        cost = now.poses.chi2(there.rows) + there.prior.cost
        if cost <= now.cost * (1 + 1e-9) + tolerance:
            if turned < reuse:
                now = now.moved(there, turned, iteration)
            else:
                now = _linearised(lineariser, there, noise, weights, iteration)
            damping, share, taken = damping / 10 if damping > 1e-3 else 0.0, 1.0, 0.0
        else:
            # Damping holds back the parameters only; the share holds back the stations as well.
            damping, share = max(10 * damping, 1e-2), share / 4
    return now


def gauss_newton_step(normal: Normal, scale: np.ndarray, damping: float) -> np.ndarray:
    """Step (g,) of the reduced normal equations: Gauss-Newton without ``damping``, Levenberg-Marquardt with it (relative to each
    parameter's own information)."""
    H = scale[:, None] * normal.information * scale
    diagonal, on = np.diag(H).copy(), np.arange(len(H))
    H[on, on] += damping * diagonal + 1e-14 * diagonal.max(initial=0.0)
    return scale * np.linalg.solve(H, scale * normal.gradient)
