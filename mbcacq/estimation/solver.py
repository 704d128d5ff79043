"""Gauss-Newton with Levenberg-Marquardt damping, on the manifold of the cell's transforms, with station poses eliminated; under a fixed
noise, and outliers rejected by turns with it."""

from __future__ import annotations

import numpy as np

from mbcacq.errors import ContradictionError
from mbcacq.estimation.linearization import LINEAR_ROTATION, Solution, largest_rotation
from mbcacq.estimation.options import Noise
from mbcacq.estimation.outliers import Weights, outlier_distances, reject_outliers

COARSE = 1e-2  # of chi square: tolerance of a fit that another follows
OUTLIER_ROUNDS = 8
REJECTED_SHARE = 0.4
SMALLEST_SHARE = 1e-4
LINEAR_DECREASE = 10.0  # of chi square, a few standard deviations: over such a step the problem is as good as linear


def robust_solve(start: Solution, tolerance: float, reuse: float = LINEAR_ROTATION) -> Solution:
    """Solve, the last step within the linear problem, and reject outliers by turns until no weight changes. reuse: as ``solve`` has it.

    Raises ContradictionError where more than REJECTED_SHARE would go.
    """
    lineariser, options = start.lineariser, start.lineariser.options
    solution = solve(start, tolerance=tolerance, within_linear=True, reuse=reuse)
    for _ in range(OUTLIER_ROUNDS if options.robust else 0):
        before = solution.weights
        distances = outlier_distances(solution.poses, solution.noise, before)
        weights = reject_outliers(distances, before, lineariser.obs.pose)
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
        candidate = now.origin.moved(layout, share * step, share * station_step, lineariser.rows.stations)
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
