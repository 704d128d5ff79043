"""The maximum-likelihood adjustment: start, hand-eye alone, everything, outliers, noise, covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration import blocks, variance
from mbcacq.calibration import start as starting
from mbcacq.calibration.adequacy import refuse_degenerate, refuse_undetermined
from mbcacq.calibration.blocks import Estimate, Layout
from mbcacq.calibration.forward import CellState
from mbcacq.calibration.linearise import Lineariser
from mbcacq.calibration.options import Noise, Options
from mbcacq.calibration.rank import hold_undetermined
from mbcacq.calibration.result import Calibration
from mbcacq.calibration.screen import distances, screen
from mbcacq.calibration.solve import Solution, Weights, solve, system
from mbcacq.errors import CalibrationError
from mbcacq.observations import Observations

COARSE, FINE = 1e-2, 1e-7
SCREEN_ROUNDS, NOISE_ROUNDS = 8, 12
REJECTED_SHARE = 0.4


def calibrate(observations: Observations, options: Options | None = None) -> Calibration:
    """Identify the cell from a recording.

    Raises CalibrationError naming what the poses leave undetermined, ConfigError for options that do not fit.
    """
    options = options or Options()
    if options.method == "paper":
        from mbcacq.calibration.paper import calibrate_paper

        return calibrate_paper(observations, options)
    obs = select_phases(observations, options)
    refuse_degenerate(obs, options)
    preliminary = fit_hand_eye(obs, options)
    layout = blocks.build(obs, options)
    start = Estimate(preliminary, tuple(np.zeros(t.size) for t in options.terms))
    noise = variance.first_noise(obs.cell)
    weights = Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
    layout, found = _determined(obs, layout, start, noise, weights, options)
    lineariser = Lineariser(obs, layout, options)
    solution, weights = robust_solve(lineariser, start, noise, weights, options, COARSE)
    solution, noise, weights = settle_noise(lineariser, solution, noise, weights, options)
    # Noise larger than expected may leave more undetermined than the first look showed.
    narrower, more = hold_undetermined(layout, solution.normal.information, obs, solution.estimate.state)
    if more:
        refuse_undetermined(more, obs, options)
        found, layout = [*found, *more], narrower
        lineariser = Lineariser(obs, layout, options)
        solution = solve(lineariser, _back_to_nominal(solution.estimate, layout, obs), noise, weights, tolerance=COARSE)
        solution, noise, weights = settle_noise(lineariser, solution, noise, weights, options)
    solution = solve(lineariser, solution, noise, weights, tolerance=FINE)
    return Calibration.of(obs, options, lineariser, solution, noise, weights, preliminary, found)


def select_phases(obs: Observations, options: Options) -> Observations:
    """The poses to fit: of the phases asked for, else all but 'verification' where there are others."""
    if obs.phase is None:
        keep = np.ones(obs.n_poses, bool)
    elif options.phases is not None:
        keep = np.isin(obs.phase, options.phases)
    else:
        keep = obs.phase != "verification"
        keep = keep if keep.any() else ~keep
    keep &= np.bincount(obs.pose, minlength=obs.n_poses) > 0
    if not keep.any():
        raise CalibrationError(f"there is no pose with a measured centre{f' in the phases {options.phases}' if options.phases else ''}; "
                               "nothing can be calibrated")
    return obs if keep.all() else obs.select(keep)


def fit_hand_eye(obs: Observations, options: Options) -> CellState:
    """Hand-eye and stations with the arm as it is nominally, robustly; also the start of everything else."""
    if options.start is not None:
        return options.start
    first = Estimate(starting.start(obs))
    held = replace(options, kinematics=False, balls=False, hold=(), release=(), terms=())
    # Kinematic errors are the noise here; their size matters little.
    noise = Noise(np.full(3, 0.02), np.full(obs.cell.robot.n, 4e-4), 5e-4)
    layout = blocks.build(obs, held)
    weights = Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
    at = system(Lineariser(obs, layout, held), first, noise, weights)
    layout, found = hold_undetermined(layout, at.normal.information, obs, first.state)
    refuse_undetermined(found, obs, options)
    solution, _ = robust_solve(Lineariser(obs, layout, held), first, noise, weights, held, 1.0)
    return solution.estimate.state


def robust_solve(lineariser: Lineariser, start: Estimate | Solution, noise: Noise, weights: Weights, options: Options,
                 tolerance: float) -> tuple[Solution, Weights]:
    """Solve and screen by turns until no verdict changes."""
    solution = solve(lineariser, start, noise, weights, tolerance=tolerance)
    for _ in range(SCREEN_ROUNDS if options.robust else 0):
        d = distances(lineariser.rows, solution.linear.J, solution.linear.residual, noise, weights)
        fresh = screen(d, weights, lineariser.obs.pose)
        if np.array_equal(fresh.centre, weights.centre) and np.array_equal(fresh.pose, weights.pose):
            break
        weights = fresh
        if np.mean(weights.pose == 0) > REJECTED_SHARE or np.mean(weights.centre == 0) > REJECTED_SHARE:
            raise CalibrationError(f"more than {REJECTED_SHARE:.0%} of the measurements contradict the rest; check the certificate of the "
                                   "artefact, the stations, and that joint angles and scans belong together")
        solution = solve(lineariser, solution, noise, weights, tolerance=tolerance)
    return solution, weights


def settle_noise(lineariser: Lineariser, solution: Solution, noise: Noise, weights: Weights,
                 options: Options) -> tuple[Solution, Noise, Weights]:
    """Estimate the noise, refit, screen again, by turns."""
    prior = variance.noise_prior(lineariser.obs.cell, variance.first_noise(lineariser.obs.cell), options.noise)
    for _ in range(NOISE_ROUNDS):
        noise, change = variance.improve(solution, noise, prior)
        solution, weights = robust_solve(lineariser, solution, noise, weights, options, COARSE)
        if change < 0.03:
            break
    return solution, noise, weights


def _determined(obs: Observations, layout: Layout, start: Estimate, noise: Noise, weights: Weights, options: Options):
    at = system(Lineariser(obs, layout, options), start, noise, weights)
    narrower, found = hold_undetermined(layout, at.normal.information, obs, start.state)
    refuse_undetermined(found, obs, options)
    return narrower, found


def _back_to_nominal(estimate: Estimate, layout: Layout, obs: Observations) -> Estimate:
    """Held kinematic parameters return to their nominal values."""
    nominal = obs.cell.robot.chain
    errors = estimate.state.chain.rows - nominal.rows
    errors[~layout.blocks[0].free.reshape(errors.shape)] = 0.0
    return replace(estimate, state=replace(estimate.state, chain=nominal.with_errors(errors)))
