"""Adjustment of a cell to a recording: initial guess, hand-eye alone, all parameters, outliers, variance components by turns.

It is the one engine behind calibration and diagnosis: the same recording gives both the same poses, outliers, noise and geometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from mbcacq.errors import ContradictionError
from mbcacq.estimation import initial_guess as starting
from mbcacq.estimation import parameters, variance_components
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.identifiability import Undetermined, determines, hold_undetermined, refuse_undetermined
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.outliers import outlier_distances, reject_outliers
from mbcacq.estimation.parameters import Estimate, ParameterLayout, usual_sizes, with_common_sizes
from mbcacq.estimation.random_effect_sizes import sizes_of_groups
from mbcacq.estimation.solver import (
    LINEAR_ROTATION,
    Solution,
    Weights,
    evaluated,
    gauss_newton_step,
    reweighted_poses,
    solve,
    system,
    with_prior_of,
)
from mbcacq.estimation.variance_components import NoisePrior
from mbcacq.model.observations import Observations

COARSE, FINE = 1e-2, 1e-7
OUTLIER_ROUNDS, NOISE_ROUNDS, HALVINGS = 8, 30, 6
NOISE_GAIN = 0.01  # of the log posterior: then the noise is within 0.14 of its own standard deviation before the last step
# The same where the noise is settled once more, with random links: within two standard deviations, of which the last step leaves little.
ROUGH_NOISE_GAIN = 2.0
REJECTED_SHARE = 0.4
COARSE_ROTATION = 5e-3  # rad over which the columns of the hand-eye alone are kept: its residuals are kinematic errors of that order
CONTRADICTION_MM = 25.0  # median misfit of the nominal arm beyond which the data cannot be of this cell
WORSE_ARM = 3.0  # times the errors of a new arm: one that was never calibrated, or was repaired
# Median shift of a pose's joints (rad, root of the sum of squares) that would explain its misfit, beyond which the same holds: an artefact
# at a free station never misses by much more than its size, however wrong the arm. Where an arm misses by 25 mm, 0.03 rad explain it.
CONTRADICTION_RAD = 0.05
# Sizes of random effects, as factors of their sigma at the start, which is large already.
LEAST_SIZE, LARGEST_SIZE, SIZE_CONVERGED = 1e-4, 4.0, 0.05
SIZE_TURNS, SIZE_ROUNDS = 12, 60  # turns of noise and sizes; steps of the fixed point in each
THIN = 200  # poses that settle geometry and noise before all of a large recording are looked at


def adjust_recording(obs: Observations, options: CalibrationOptions, links_follow: bool = False) -> Adjustment:
    """The adjustment of a whole recording; of a long one, that of a part of its poses is the start. links_follow: as ``adjust`` has it.

    Raises ContradictionError where the data contradict the cell or, with ``options.refuse``, leave it undetermined.
    """
    first = adjust(thin(obs, THIN), options) if obs.n_poses > 2 * THIN and not (options.terms or options.displaced) else None
    return adjust(obs, options, first, links_follow)


@dataclass(frozen=True, kw_only=True)
class Adjustment:
    """A converged adjustment and what led to it."""

    lineariser: Lineariser
    solution: Solution
    noise: Noise
    weights: Weights
    preliminary: CellState
    found: list[Undetermined]

    @property
    def state(self) -> CellState:
        return self.solution.estimate.state

    @property
    def used(self) -> np.ndarray:
        """(M,) bool: centres that took part."""
        return (self.weights.centre > 0) & (self.weights.pose[self.lineariser.obs.pose] > 0)

    @cached_property
    def stated_chi2(self) -> float:
        """Chi square under the noise that scanner and data sheet state, or a guess of their class, with the prior rows."""
        at, noise = evaluated(self.lineariser, self.solution), variance_components.first_noise(self.lineariser.obs.cell)
        *_, chi2 = reweighted_poses(self.lineariser, at, noise, self.weights).right_hand_side()
        return chi2 + at.prior.cost


def adjust(obs: Observations, options: CalibrationOptions, first: Adjustment | None = None, links_follow: bool = False) -> Adjustment:
    """Everything from the start to the settled noise; ``first``, an adjustment of some of the poses, saves most of it. links_follow:
    ``with_random_links`` comes next, which settles noise and estimate where there are such links."""
    weights = Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
    if first is None:
        preliminary = fit_hand_eye(obs, options)
        start = Estimate(preliminary, tuple(np.zeros(t.size) for t in options.terms))
        noise = variance_components.first_noise(obs.cell)
    else:
        preliminary, whole = (starting.with_all_stations(obs, state) for state in (first.preliminary, first.state))
        start, noise = Estimate(whole, tuple(np.zeros(t.size) for t in options.terms)), first.noise
        if any(t.sized for t in options.terms):
            noise = variance_components.first_noise(obs.cell)  # what random effects explain is in the other's noise
    layout = parameters.build(obs, options)
    lineariser = Lineariser(obs, layout, options)
    at = system(lineariser, start, noise, weights)
    layout, found = hold_undetermined(layout, at.normal.information, obs, start.state)
    refuse_undetermined(found, obs, options)
    if found:
        lineariser = Lineariser(obs, layout, options)
    solution, weights = robust_solve(lineariser, start if found else at, noise, weights, options, COARSE)
    links_follow = links_follow and options.random_links
    lineariser, solution, noise, weights = settle_variances(
        lineariser, solution, noise, weights, options, noise_gain=_noise_gain(layout, links_follow)
    )
    layout = lineariser.layout
    # Noise larger than expected may leave more undetermined than the first look showed.
    layout, more = hold_undetermined(layout, solution.normal.information, obs, solution.estimate.state)
    if more:
        refuse_undetermined(more, obs, options)
        found = [*found, *more]
        lineariser = Lineariser(obs, layout, options)
        solution = solve(lineariser, _back_to_nominal(solution.estimate, layout, obs), noise, weights, tolerance=COARSE)
        lineariser, solution, noise, weights = settle_variances(
            lineariser, solution, noise, weights, options, noise_gain=_noise_gain(layout, links_follow)
        )
        layout = lineariser.layout
    if _noise_gain(layout, links_follow) == NOISE_GAIN:
        solution, noise, weights = made_exact(lineariser, solution, noise, weights, options)
    return Adjustment(lineariser=lineariser, solution=solution, noise=noise, weights=weights, preliminary=preliminary, found=found)


def _noise_gain(layout: ParameterLayout, links_follow: bool) -> float:
    return ROUGH_NOISE_GAIN if links_follow and with_common_sizes(layout) is not layout else NOISE_GAIN


def made_exact(
    lineariser: Lineariser, solution: Solution, noise: Noise, weights: Weights, options: CalibrationOptions
) -> tuple[Solution, Noise, Weights]:
    """A settled solution solved to the end with residuals at its estimate; settled again where the problem is less linear than its last
    steps promised."""
    exact = evaluated(lineariser, solution)
    if exact.normal.decrease(gauss_newton_step(exact.normal, lineariser.layout.scale, 0.0)) > COARSE:
        exact, weights = robust_solve(lineariser, exact, noise, weights, options, COARSE)
        exact, noise, weights = settle_noise(lineariser, exact, noise, weights, options)
    return solve(lineariser, exact, noise, weights, tolerance=FINE), noise, weights


def thin(obs: Observations, size: int) -> Observations:
    """About ``size`` poses: whole stations where there are many, evenly chosen poses of each where there are few."""
    rng = np.random.default_rng(1)
    stations = np.unique(obs.station)
    per_station = max(12, size // len(stations))
    chosen = stations if per_station * len(stations) <= size else rng.choice(stations, max(size // per_station, 1), replace=False)
    keep = np.zeros(obs.n_poses, bool)
    for s in chosen:
        there = np.flatnonzero(obs.station == s)
        keep[there[np.unique(np.linspace(0, len(there) - 1, min(per_station, len(there))).astype(int))]] = True
    return obs.select(keep)


def fit_hand_eye(obs: Observations, options: CalibrationOptions) -> CellState:
    """Hand-eye and stations with the arm as it is nominally, robustly; also the start of everything else."""
    if options.start is not None:
        return options.start
    first = Estimate(starting.start(obs))
    held = replace(options, kinematics=False, discrepancy=False, balls=False, hold=(), release=(), terms=())
    # Kinematic errors are the noise here; their size matters little, as long as it does not make structure of half the poses.
    lever = obs.cell.robot.chain.lever
    noise, worse = (Noise(np.full(3, 0.02 * k), k * 4e-4 * lever.max() / lever, 5e-4 * k) for k in (1.0, WORSE_ARM))
    layout = parameters.build(obs, held)
    weights = Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
    lineariser = Lineariser(obs, layout, held)
    at = system(lineariser, first, noise, weights)
    layout, found = hold_undetermined(layout, at.normal.information, obs, first.state)
    refuse_undetermined(found, obs, options)
    if found:
        lineariser = Lineariser(obs, layout, held)
    begin = first if found else at
    try:
        solution, _ = robust_solve(lineariser, begin, noise, weights, held, 1.0, COARSE_ROTATION)
    except ContradictionError:
        solution, _ = robust_solve(lineariser, begin, worse, weights, held, 1.0, COARSE_ROTATION)
    apart = float(np.median(np.linalg.norm(solution.linear.residual[:, :3], axis=1)))
    shift = float(np.median(solution.poses.by_pose(lambda of: np.linalg.norm(of.residual_joint * 4e-4, axis=1))))
    if apart > CONTRADICTION_MM or shift > CONTRADICTION_RAD:
        raise ContradictionError(
            f"with the nominal arm the measurements miss each other by {apart:.0f} mm, far more than an arm's errors; "
            "check the robot model (signs, units), the certificate, and that joint angles and scans belong together"
        )
    return solution.estimate.state


def robust_solve(
    lineariser: Lineariser,
    start: Estimate | Solution,
    noise: Noise,
    weights: Weights,
    options: CalibrationOptions,
    tolerance: float,
    reuse: float = LINEAR_ROTATION,
) -> tuple[Solution, Weights]:
    """Solve, the last step within the linear problem, and reject outliers by turns until no weight changes. reuse: as ``solve`` has it.

    Raises ContradictionError where more than REJECTED_SHARE would go.
    """
    solution = solve(lineariser, start, noise, weights, tolerance=tolerance, within_linear=True, reuse=reuse)
    for _ in range(OUTLIER_ROUNDS if options.robust else 0):
        d = outlier_distances(solution.poses, lineariser.weighted(solution.linear.residual), noise, weights)
        fresh = reject_outliers(d, weights, lineariser.obs.pose)
        if np.array_equal(fresh.centre, weights.centre) and np.array_equal(fresh.pose, weights.pose):
            break
        everything = Weights(np.ones_like(weights.centre), np.ones_like(weights.pose))
        weights = fresh
        if np.mean(weights.pose == 0) > REJECTED_SHARE or np.mean(weights.centre == 0) > REJECTED_SHARE:
            if not options.refuse:
                # So many are structure, not outliers.
                return solve(lineariser, solution, noise, everything, tolerance=tolerance, within_linear=True, reuse=reuse), everything
            raise ContradictionError(
                f"more than {REJECTED_SHARE:.0%} of the measurements contradict the rest; check the certificate of the "
                "artefact, the stations, and that joint angles and scans belong together"
            )
        determined = determines(lineariser.layout, solution.normal.information)
        solution = solve(lineariser, solution, noise, weights, tolerance=tolerance, within_linear=True, reuse=reuse)
        if determined and not determines(lineariser.layout, solution.normal.information):
            # What is left determines less than everything did: the noise is taken for too small, and its estimate comes first.
            return solve(lineariser, solution, noise, everything, tolerance=tolerance, within_linear=True, reuse=reuse), everything
    return solution, weights


def settle_variances(
    lineariser: Lineariser,
    solution: Solution,
    noise: Noise,
    weights: Weights,
    options: CalibrationOptions,
    sizes_first: bool = False,
    noise_gain: float = NOISE_GAIN,
) -> tuple[Lineariser, Solution, Noise, Weights]:
    """Noise, and the sizes of the random effects that have none of their own, by turns until both are settled; the lineariser has them as
    priors. Sizes begin large: the noise then holds only what no random effect explains. sizes_first: the noise is settled with the
    same effects free, which is as large as they can be. noise_gain: as ``settle_noise`` has it.
    """
    first = lineariser.layout
    size, usual = dict.fromkeys(first.sized, 1.0), usual_sizes(lineariser.obs.cell)
    for turn in range(SIZE_TURNS if size else 1):
        if turn or not sizes_first:
            solution, noise, weights = settle_noise(lineariser, solution, noise, weights, options, noise_gain)
        if not size:
            break
        before, present = size, LEAST_SIZE / min(size.values())
        factor = sizes_of_groups(solution.normal, solution.prior, lineariser.layout.sized, (present, LARGEST_SIZE), SIZE_ROUNDS, usual)
        size = {name: float(np.clip(factor[name] * s, LEAST_SIZE, LARGEST_SIZE)) for name, s in size.items()}
        lineariser = lineariser.with_layout(first.resized(size))
        solution = solve(lineariser, with_prior_of(lineariser, solution), noise, weights, tolerance=COARSE, within_linear=True)
        if max(abs(np.log(size[name] / before[name])) for name in size) < SIZE_CONVERGED:
            break
    return lineariser, solution, noise, weights


def settle_noise(
    lineariser: Lineariser, solution: Solution, noise: Noise, weights: Weights, options: CalibrationOptions, noise_gain: float = NOISE_GAIN
) -> tuple[Solution, Noise, Weights]:
    """Estimate the noise by REML and refit, by turns, until its log posterior can rise by less than ``noise_gain``; reject outliers
    again, and where that changes what takes part, all of it once more."""
    prior = variance_components.noise_prior(lineariser.obs.cell, options.noise)
    for _ in range(OUTLIER_ROUNDS):
        refit = partial(_refitted, lineariser, weights)
        solution, noise = most_probable_noise(refit, solution, noise, prior, enough=noise_gain)
        before = weights
        solution, weights = robust_solve(lineariser, solution, noise, weights, options, COARSE)
        if weights is before:
            break
    return solution, noise, weights


def _refitted(lineariser: Lineariser, weights: Weights, at: Solution, noise: Noise) -> Solution:
    return solve(lineariser, at, noise, weights, tolerance=COARSE, within_linear=True)


def most_probable_noise(
    refit: Callable[[Solution, Noise], Solution],
    solution: Solution,
    noise: Noise,
    prior: NoisePrior,
    rounds: int = NOISE_ROUNDS,
    enough: float = NOISE_GAIN,
) -> tuple[Solution, Noise]:
    """Noise by REML, and the fit with it. refit: the fit under another noise, from the one before. enough: gain of the log posterior,
    with a step that promises less than which it ends.

    A step that would lower the log posterior is halved: variance components that share one excess would all take it up at once, and give
    it back in the next step.
    """
    reached = variance_components.log_restricted_posterior(solution.system, noise, prior)
    for _ in range(rounds):
        proposed, gain = variance_components.reml_step(solution.system, noise, prior)
        for _ in range(HALVINGS):
            there = refit(solution, proposed)
            value = variance_components.log_restricted_posterior(there.system, proposed, prior)
            if value > reached - NOISE_GAIN:
                solution, noise, reached = there, proposed, value
                break
            proposed = variance_components.between(noise, proposed)
        if gain < enough or noise is not proposed:
            break
    return solution, noise


def _back_to_nominal(estimate: Estimate, layout: ParameterLayout, obs: Observations) -> Estimate:
    """Held kinematic parameters return to their nominal values."""
    nominal = obs.cell.robot.chain
    errors = estimate.state.chain.rows - nominal.rows
    errors[~layout.blocks[0].free.reshape(errors.shape)] = 0.0
    return replace(estimate, state=replace(estimate.state, chain=nominal.with_errors(errors)))
