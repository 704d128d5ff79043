"""The fit of a linearised cell: Gauss-Newton with Levenberg-Marquardt damping, on the manifold of the cell's transforms, with station
poses eliminated; and by turns with it the rejection of outliers, the noise, and the sizes of random effects."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache

import numpy as np
from threadpoolctl import ThreadpoolController

from mbcacq.errors import ContradictionError
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import usual_sizes
from mbcacq.estimation.pose_information import Weights, reject_outliers
from mbcacq.estimation.random_effect_sizes import sizes_of_groups
from mbcacq.estimation.solution import LINEAR_ROTATION, Solution, largest_rotation
from mbcacq.estimation.variance_components import between, log_restricted_posterior, reml_step

COARSE, FINE = 1e-2, 1e-7  # of chi square: tolerance of a fit that another follows, and of what is published
SMALLEST_SHARE = 1e-4
LINEAR_DECREASE = 10.0  # of chi square, a few standard deviations: over such a step the problem is as good as linear
OUTLIER_ROUNDS = 8
REJECTED_SHARE = 0.4
NOISE_TURNS, NOISE_ROUNDS, HALVINGS = 8, 30, 6  # turns of noise and outliers; steps of the noise in each; halvings of a step
NOISE_GAIN = 0.01  # of the log posterior: then the noise is within 0.14 of its own standard deviation before the last step
# Gain of the log posterior below which the noise is settled, where it is settled once more, with random links: within two standard
# deviations, of which the last step leaves little.
ROUGH_NOISE_GAIN = 2.0
# Sizes of random effects, as factors of their sigma at the start, which is large already.
LEAST_SIZE, LARGEST_SIZE, SIZE_CONVERGED = 1e-4, 4.0, 0.05
SIZE_TURNS, SIZE_ROUNDS = 12, 60  # turns of noise and sizes; steps of the fixed point in each


def robust_solve(start: Solution, tolerance: float, reuse: float = LINEAR_ROTATION) -> Solution:
    """Solve, the last step within the linear problem, and reject outliers by turns until no weight changes. reuse: as ``solve`` has it.

    Raises ContradictionError where more than REJECTED_SHARE would go.
    """
    lineariser, options = start.lineariser, start.lineariser.options
    solution = solve(start, tolerance=tolerance, within_linear=True, reuse=reuse)
    for _ in range(OUTLIER_ROUNDS if options.robust else 0):
        before = solution.weights
        weights = reject_outliers(solution.poses, before)
        if np.array_equal(weights.centre, before.centre) and np.array_equal(weights.pose, before.pose):
            break
        if np.mean(weights.pose == 0) > REJECTED_SHARE or np.mean(weights.centre == 0) > REJECTED_SHARE:
            if not options.refuse:
                # So many are structure, not outliers.
                return solve(solution, weights=lineariser.everything, tolerance=tolerance, within_linear=True, reuse=reuse)
            raise ContradictionError(
                f"more than {REJECTED_SHARE:.0%} of the measurements contradict the rest; check the certificate of the "
                "artefact, the stations, and that joint angles and scans belong together"
            )
        determined = solution.determined
        solution = solve(solution, weights=weights, tolerance=tolerance, within_linear=True, reuse=reuse)
        if determined and not solution.determined:
            # What is left determines less than everything did: the noise is taken for too small, and its estimate comes first.
            return solve(solution, weights=lineariser.everything, tolerance=tolerance, within_linear=True, reuse=reuse)
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
        step = now.normal.gauss_newton_step(layout.scale, damping)
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
        candidate = now.there.estimate.moved(layout, share * step, share * station_step, lineariser.rows.stations)
        there = lineariser.evaluate(candidate)
        # The weights depend weakly on the estimate; a step is judged by those it was computed with.
        cost = now.poses.chi2(there.rows) + there.prior.cost
        if cost <= now.cost * (1 + 1e-9) + tolerance:
            now = now.moved(there, turned, iteration, reuse)
            damping, share, taken = damping / 10 if damping > 1e-3 else 0.0, 1.0, 0.0
        else:
            # Damping holds back the parameters only; the share holds back the stations as well.
            damping, share = max(10 * damping, 1e-2), share / 4
    return now


def settle_variances(solution: Solution, *, sizes_first: bool = False, links_follow: bool = False) -> Solution:
    """Noise, and the sizes of the random effects that have none of their own, by turns until both are settled; the solution's layout has
    them as priors. Sizes begin large: the noise then holds only what no random effect explains. sizes_first: the noise is settled with
    the same effects free, which is as large as they can be. links_follow: all of it is settled once more, with random links.
    """
    noise_gain = ROUGH_NOISE_GAIN if links_follow and solution.lineariser.random_links else NOISE_GAIN
    first = solution.lineariser.layout
    size, cell = dict.fromkeys(first.sized, 1.0), solution.lineariser.obs.cell
    for turn in range(SIZE_TURNS if size else 1):
        if turn or not sizes_first:
            solution = settle_noise(solution, noise_gain)
        if not size:
            break
        before, limits = size, (LEAST_SIZE / min(size.values()), LARGEST_SIZE)
        groups = solution.lineariser.layout.sized
        factor = sizes_of_groups(solution.normal, solution.prior, groups, limits, SIZE_ROUNDS, usual_sizes(cell))
        size = {name: float(np.clip(factor[name] * s, LEAST_SIZE, LARGEST_SIZE)) for name, s in size.items()}
        layout = first.resized(size)
        solution = solution.with_priors(layout)
        solution = solve(solution, tolerance=COARSE, within_linear=True)
        if max(abs(np.log(size[name] / before[name])) for name in size) < SIZE_CONVERGED:
            break
    return solution


def settle_noise(solution: Solution, noise_gain: float = NOISE_GAIN) -> Solution:
    """Estimate the noise by REML and refit, by turns, until its log posterior can rise by less than ``noise_gain``; reject outliers
    again, and where that changes what takes part, all of it once more."""
    for _ in range(NOISE_TURNS):
        before = solution.weights
        solution = most_probable_noise(refitted, solution, enough=noise_gain)
        solution = robust_solve(solution, COARSE)
        if solution.weights is before:
            break
    return solution


def refitted(at: Solution, noise: Noise) -> Solution:
    """The fit under another noise."""
    return solve(at, noise, tolerance=COARSE, within_linear=True)


def most_probable_noise(
    refit: Callable[[Solution, Noise], Solution], solution: Solution, rounds: int = NOISE_ROUNDS, enough: float = NOISE_GAIN
) -> Solution:
    """The fit with the noise by REML. refit: the fit under another noise, from the one before. enough: gain of the log posterior, with a
    step that promises less than which it ends.

    A step that would lower the log posterior is halved: variance components that share one excess would all take it up at once, and give
    it back in the next step.
    """
    prior = solution.lineariser.noise_prior
    for _ in range(rounds):
        before = solution
        proposed, gain = reml_step(before.system, before.noise, prior)
        reached = log_restricted_posterior(before.system, before.noise, prior)
        before.forget()
        for _ in range(HALVINGS):
            there = refit(before, proposed)
            if log_restricted_posterior(there.system, there.noise, prior) > reached - NOISE_GAIN:
                solution = there
                break
            proposed = between(before.noise, proposed)
        if gain < enough or solution is before:
            break
    return solution


def made_exact(solution: Solution) -> Solution:
    """A settled solution solved to the end with residuals at its estimate; settled again where the problem is less linear than its last
    steps promised."""
    exact = solution.evaluated()
    if exact.normal.decrease(exact.normal.gauss_newton_step(exact.lineariser.layout.scale)) > COARSE:
        exact = robust_solve(exact, COARSE)
        exact = settle_noise(exact)
    return solve(exact, tolerance=FINE)


@cache
def _libraries() -> ThreadpoolController:
    """The libraries of linear algebra that are loaded; looking for them takes a millisecond, which a calibration has once."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """A context in which numpy and SciPy have one thread."""
    return _libraries().limit(limits=1)
