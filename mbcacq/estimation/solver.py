"""Gauss-Newton with Levenberg-Marquardt damping, on the manifold of the cell's transforms; noise and weights are fixed, station poses
eliminated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.estimation.forward_model import Prediction
from mbcacq.estimation.linearization import Lineariser, Linearization
from mbcacq.estimation.normal_equations import Normal, PoseSystem, Prior
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.pose_information import PoseInformation
from mbcacq.estimation.whitening import Whitening
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell

SMALLEST_SHARE = 1e-4
# Steps over which the problem is as good as linear: rotations (rad) whose second order moves a point 1 m away by 20 nm, and a decrease of
# chi square of a few standard deviations.
LINEAR_ROTATION, LINEAR_DECREASE = 2e-4, 10.0


@dataclass(frozen=True)
class Weights:
    """Weight of each centre (M,) and each pose (P,): 1 full, 0 rejected."""

    centre: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class SolverStep:
    """A step (g,) of the parameters and (S', 6) of the stations in use, from a solution within its linear problem."""

    start: Solution
    layout: ParameterLayout
    parameters: np.ndarray
    stations: np.ndarray


@dataclass(frozen=True)
class Solution:
    """An estimate and the whitened system at it. X: (P, B R, g + 7) whitened; cost: chi square with the prior rows.

    origin: estimate at which the residual was evaluated. step: what led from there here within the linear problem; None where the
    residual is that of the estimate itself. turned: rad, at most, of any rotation since the columns were made.
    """

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
        return moved_estimate(self.origin, self.step.layout, self.normal.rows.stations, self.step.parameters, self.step.stations)

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


def system(lineariser: Lineariser, estimate: Estimate, noise: Noise, weights: Weights, iterations: int = 0) -> Solution:
    """The whitened normal equations at an estimate."""
    return _system(lineariser, estimate, lineariser(estimate), noise, weights, iterations)


def _system(lineariser: Lineariser, estimate: Estimate, linear: Linearization, noise: Noise, weights: Weights, iterations: int) -> Solution:
    prior = prior_rows(lineariser.obs.cell, lineariser.layout, estimate, lineariser.rows.stations)
    poses = PoseInformation.of(lineariser.rows, linear.columns, noise, weights.centre, weights.pose)
    normal = Normal(lineariser.rows, poses.normal_equations(), prior)
    return Solution(
        origin=estimate, linear=linear, poses=poses, normal=normal, prior=prior, noise=noise, weights=weights, iterations=iterations
    )


def reweighted(lineariser: Lineariser, at: Solution, noise: Noise, weights: Weights) -> Solution:
    """The system with other noise or weights, at the estimate where the residual was evaluated."""
    if noise is at.noise and weights is at.weights:
        return at
    at = at if at.step is None else at.step.start
    poses = reweighted_poses(lineariser, at, noise, weights)
    normal = Normal(lineariser.rows, poses.normal_equations(), at.prior)
    return replace(at, poses=poses, normal=normal, noise=noise, weights=weights)


def reweighted_poses(lineariser: Lineariser, at: Solution, noise: Noise, weights: Weights) -> PoseInformation:
    """The poses at the estimate of an exact solution, with other noise or weights."""
    if weights is at.weights:
        return at.poses.with_noise(noise)
    return PoseInformation.of(lineariser.rows, at.linear.columns, noise, weights.centre, weights.pose)


def with_prior_of(lineariser: Lineariser, at: Solution) -> Solution:
    """The system with the prior of the lineariser's layout, at the estimate where the residual was evaluated."""
    at = at if at.step is None else at.step.start
    prior = prior_rows(lineariser.obs.cell, lineariser.layout, at.estimate, lineariser.rows.stations)
    return replace(at, prior=prior, normal=at.normal.with_prior(prior, at.prior))


def stepped(lineariser: Lineariser, at: Solution, step: np.ndarray) -> Solution:
    """The same linear problem after a step (g,) of the parameters and the best stations; ``at`` must be exact."""
    rows, columns = lineariser.rows, at.linear.columns
    station_step = at.normal.station_step(step)
    residual = at.poses.residual_after(step, station_step)
    linear = replace(at.linear, residual=lineariser.unweighted(rows.unpad(residual)), columns=replace(columns, residual=residual))
    prior = replace(at.prior, offset=at.prior.offset + step, station_offset=at.prior.station_offset + station_step)
    poses, normal = at.poses.with_residual(linear.columns), at.normal.after(step)
    taken = SolverStep(at, lineariser.layout, step, station_step)
    return replace(at, linear=linear, poses=poses, normal=normal, prior=prior, step=taken)


def evaluated(lineariser: Lineariser, at: Solution) -> Solution:
    """The system with the residual at its estimate; its columns are made anew where a rotation since they were made is not small."""
    if at.step is None:
        return at
    turned = at.turned + largest_rotation(lineariser.layout, at.step.parameters, at.step.stations)
    prediction, residual = lineariser.residual(at.estimate)
    if turned > LINEAR_ROTATION:
        linear = lineariser.at(at.estimate.state.chain, prediction, residual)
        return _system(lineariser, at.estimate, linear, at.noise, at.weights, at.iterations)
    return _with_residual(lineariser, at, at.estimate, prediction, residual, turned)


def _with_residual(
    lineariser: Lineariser, at: Solution, estimate: Estimate, prediction: Prediction, residual: np.ndarray, turned: float
) -> Solution:
    """The system at a nearby estimate with the columns as they are."""
    columns = replace(at.linear.columns, residual=lineariser.rows.pad(lineariser.weighted(residual)))
    prior = prior_rows(lineariser.obs.cell, lineariser.layout, estimate, lineariser.rows.stations)
    poses = at.poses.with_residual(columns)
    normal = at.normal.with_right_hand_side(*poses.right_hand_side(), prior)
    linear = Linearization(prediction, residual, columns)
    return replace(at, origin=estimate, linear=linear, poses=poses, normal=normal, prior=prior, turned=turned, step=None)


def largest_rotation(layout: ParameterLayout, step: np.ndarray, station_step: np.ndarray) -> float:
    """Largest rotation (rad) of the arm's links, the hand-eye or a station in a step."""
    turning = layout.turning
    largest = np.abs(step[: len(turning)][turning]).max(initial=0.0)
    return float(max(largest, np.abs(station_step[:, 3:]).max(initial=0.0)))


def moved_estimate(
    estimate: Estimate, layout: ParameterLayout, stations: np.ndarray, step: np.ndarray, station_step: np.ndarray
) -> Estimate:
    """The estimate after a step (g,) and local twists (S', 6) of the stations in use."""
    whole = np.zeros((len(estimate.state.T_base_station), 6))
    whole[stations] = station_step
    return estimate.moved(layout, step, whole)


def solve(
    lineariser: Lineariser,
    start: Estimate | Solution,
    noise: Noise,
    weights: Weights,
    *,
    tolerance: float = 1e-6,
    limit: int = 30,
    within_linear: bool = False,
    reuse: float = LINEAR_ROTATION,
) -> Solution:
    """Iterate until the next step would take less than ``tolerance`` off the cost (chi square).

    A ``Solution`` of the same lineariser as start saves evaluating it anew. within_linear: a small step is the last, and is taken
    within the linear problem; then the solution is not ``exact``. reuse: rotation (rad) over which columns are kept from step to step.
    """
    layout = lineariser.layout
    damping, share = 0.0, 1.0
    taken = 0.0
    if isinstance(start, Solution):
        now = reweighted(lineariser, start if within_linear else evaluated(lineariser, start), noise, weights)
        if start.step is not None and now.step is None:
            taken = now.normal.decrease(start.step.parameters) if within_linear else 0.0
    else:
        now = system(lineariser, start, noise, weights)
    for iteration in range(1, limit + 1):
        step = gauss_newton_step(now.normal, layout.scale, damping)
        promised = now.normal.decrease(step)
        if promised < tolerance or share < SMALLEST_SHARE:
            break
        if now.step is not None:
            now = evaluated(lineariser, now)
            continue
        station_step = now.normal.station_step(step)
        turned = now.turned + share * largest_rotation(layout, step, station_step)
        if within_linear and not damping and promised - taken < LINEAR_DECREASE and turned < LINEAR_ROTATION:
            return stepped(lineariser, now, step)
        candidate = moved_estimate(now.origin, layout, lineariser.rows.stations, share * step, share * station_step)
        prediction, residual = lineariser.residual(candidate)
        prior = prior_rows(lineariser.obs.cell, layout, candidate, lineariser.rows.stations)
        # The weights depend weakly on the estimate; a step is judged by those it was computed with.
        cost = now.poses.chi2(lineariser.rows.pad(lineariser.weighted(residual))) + prior.cost
        if cost <= now.cost * (1 + 1e-9) + tolerance:
            if turned < reuse:
                now = replace(_with_residual(lineariser, now, candidate, prediction, residual, turned), iterations=iteration)
            else:
                linear = lineariser.at(candidate.state.chain, prediction, residual)
                now = _system(lineariser, candidate, linear, noise, weights, iteration)
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


def prior_rows(cell: Cell, layout: ParameterLayout, estimate: Estimate, stations: np.ndarray) -> Prior:
    """Certificates, priors of the arm and of terms, and the placements that were given, at an estimate."""
    balls = (estimate.state.balls - cell.ball_centres).reshape(-1)
    arm = (estimate.state.chain.rows - cell.robot.chain.rows).reshape(-1)
    if (centre := layout.blocks[0].centre) is not None:
        arm = arm - centre
    offsets = [arm, np.zeros(len(layout.blocks[1].names)), balls, *estimate.coefficients]
    offset = np.concatenate([o[b.free] for o, b in zip(offsets, layout.blocks, strict=True)])
    information = np.zeros((len(stations), 6, 6))
    twist = np.zeros((len(stations), 6))
    for j, s in enumerate(stations):
        station = cell.stations[s]
        if station.T_base_station is not None:
            information[j], twist[j] = known_placement(cell, s, station.T_base_station, estimate.state.T_base_station[s])
    return Prior(layout.sigma, offset, information, twist)


def known_placement(cell: Cell, s: int, given: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information (6, 6) and offset (6,) of station ``s`` at T (4, 4), which was ``given`` (4, 4) with sigma_mm for each of its balls
    (0.05 mm if not said)."""
    station = cell.stations[s]
    sigma = station.sigma_mm or 0.05
    points = cell.artefact(station.artefact).centres
    columns = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -se3.skew(points)], axis=2)
    off = se3.inverse(given) @ T
    information = np.einsum("mri,mrj->ij", columns, columns) / sigma**2 / max(len(points) / 3, 1)
    return information, np.concatenate([off[:3, 3], se3.rotation_log(off[:3, :3])])
