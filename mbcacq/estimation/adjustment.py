"""Adjustment of a cell to a recording: initial guess, hand-eye alone, all parameters, outliers, variance components by turns.

It is the one engine behind calibration and diagnosis: the same recording gives both the same poses, outliers, noise and geometry.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.errors import ContradictionError
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.identifiability import Undetermined, determined, still_determined
from mbcacq.estimation.initial_guess import start, with_all_stations
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import Estimate, with_common_sizes
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import Solution, system
from mbcacq.estimation.solver import COARSE, made_exact, robust_solve, settle_variances, solve
from mbcacq.estimation.terms import Term
from mbcacq.model.observations import Observations

COARSE_ROTATION = 5e-3  # rad over which the columns of the hand-eye alone are kept: its residuals are kinematic errors of that order
CONTRADICTION_MM = 25.0  # median misfit of the nominal arm beyond which the data cannot be of this cell
WORSE_ARM = 3.0  # times the errors of a new arm: one that was never calibrated, or was repaired
# Median shift of a pose's joints (rad, root of the sum of squares) that would explain its misfit, beyond which the same holds: an artefact
# at a free station never misses by much more than its size, however wrong the arm. Where an arm misses by 25 mm, 0.03 rad explain it.
CONTRADICTION_RAD = 0.05
Known = tuple[tuple[Term, np.ndarray], ...]
THIN = 200  # poses that settle geometry and noise before all of a large recording are looked at


def adjust_recording(obs: Observations, options: CalibrationOptions, links_follow: bool = False) -> Adjustment:
    """The adjustment of a whole recording; of a long one, that of a part of its poses is the start. links_follow: as ``adjust`` has it.

    Raises ContradictionError where the data contradict the cell or, with ``options.refuse``, leave it undetermined.
    """
    first = None
    if obs.n_poses > 2 * THIN and not (options.terms or options.displaced):
        first = adjust_recording(thin(obs, THIN), options)
    return adjust(obs, options, first, links_follow)


@dataclass(frozen=True, kw_only=True)
class Adjustment:
    """A converged adjustment and what led to it. noise, weights: as it states them. found: what the data leave undetermined."""

    solution: Solution
    noise: Noise
    weights: Weights
    preliminary: CellState
    found: list[Undetermined]

    @property
    def lineariser(self) -> Lineariser:
        return self.solution.lineariser

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
        at = self.solution.evaluated()
        at.forget()
        *_, chi2 = at.poses_under(self.lineariser.first_noise, self.weights).right_hand_side()
        return chi2 + at.prior.cost


def adjust(obs: Observations, options: CalibrationOptions, first: Adjustment | None = None, links_follow: bool = False) -> Adjustment:
    """Everything from the start to the settled noise; ``first``, an adjustment of some of the poses, saves most of it. links_follow:
    ``with_random_links`` comes next, which settles noise and estimate where there are such links."""
    if first is None:
        preliminary = state = fit_hand_eye(obs, options)
    else:
        preliminary, state = (with_all_stations(obs, one) for one in (first.preliminary, first.state))
    noise = None if first is None else first.noise
    begin = Estimate(state, tuple(np.zeros(t.size) for t in options.terms))
    solution, found = determined(obs, options, begin, noise)
    solution = robust_solve(solution, COARSE)  # by one name, so that one solution at a time is in memory
    solution = settle_variances(solution, links_follow=links_follow)
    # Noise larger than expected may leave more undetermined than the first look showed.
    solution, more = still_determined(solution)
    if more:
        solution = settle_variances(solve(solution, tolerance=COARSE), links_follow=links_follow)
    if not (links_follow and solution.lineariser.random_links):
        solution = made_exact(solution)
    held = [*found, *more]
    return Adjustment(solution=solution, noise=solution.noise, weights=solution.weights, preliminary=preliminary, found=held)


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


def as_it_is(obs: Observations, state: CellState, known: Known = (), hold: bool = True) -> Solution:
    """A cell on a recording, evaluated: nothing but the stations is free, without ``hold`` the hand-eye transform too; every centre counts
    alike. known: effects that displace it, with their coefficients."""
    held = parameters.hand_eye_names(obs) if hold else ()
    options = CalibrationOptions(kinematics=False, discrepancy=False, balls=False, hold=held, displaced=known)
    lineariser = Lineariser(obs, parameters.build(obs, options), options)
    return system(lineariser, Estimate(state), Noise(np.ones(3), np.full(obs.cell.robot.n, 1e-12), 1e-2), lineariser.everything)


def fit_hand_eye(obs: Observations, options: CalibrationOptions) -> CellState:
    """Hand-eye and stations with the arm as it is nominally, robustly; also the start of everything else."""
    if options.start is not None:
        return options.start
    begin = Estimate(start(obs))
    hand_eye = tuple(name for name in options.hold if name.startswith("hand_eye."))
    held = replace(options, kinematics=False, discrepancy=False, balls=False, hold=hand_eye, release=(), terms=())
    # Kinematic errors are the noise here; their size matters little, as long as it does not make structure of half the poses.
    lever = obs.cell.robot.chain.lever
    noise, worse = (Noise(np.full(3, 0.02 * k), k * 4e-4 * lever.max() / lever, 5e-4 * k) for k in (1.0, WORSE_ARM))
    at, _ = determined(obs, held, begin, noise)
    try:
        solution = robust_solve(at, 1.0, COARSE_ROTATION)
    except ContradictionError:
        solution = robust_solve(at.reweighted(worse, at.weights), 1.0, COARSE_ROTATION)
    apart = float(np.median(np.linalg.norm(solution.residual[:, :3], axis=1)))
    shift = float(np.median(solution.poses.by_pose(lambda of: np.linalg.norm(of.residual_joint * 4e-4, axis=1))))
    if apart > CONTRADICTION_MM or shift > CONTRADICTION_RAD:
        raise ContradictionError(
            f"with the nominal arm the measurements miss each other by {apart:.0f} mm, far more than an arm's errors; "
            "check the robot model (signs, units), the certificate, and that joint angles and scans belong together"
        )
    return solution.estimate.state


def with_random_links(fitted: Adjustment) -> Adjustment:
    """An adjustment with random errors of the links in the place of free ones: what the poses hardly determine stays near the nominal arm.

    With a common size for each kind of error, estimated by restricted maximum likelihood, the estimate is the best linear unbiased
    prediction (Henderson 1975): the same where the poses determine everything, and never worse in expectation where they do not.

    Parameters
    ----------
    fitted : Adjustment
        With free links; what it holds stays held, and its rejections are where the new ones begin.

    Returns
    -------
    Adjustment
        The same where the links are to be free, have a prior of their own, or too few of them are free.
    """
    layout = fitted.lineariser.layout
    if not fitted.lineariser.random_links:
        return fitted
    fitted.solution.forget()
    solution = settle_variances(fitted.solution.with_priors(with_common_sizes(layout)), sizes_first=True)
    solution = made_exact(solution)
    return replace(fitted, solution=solution, noise=solution.noise, weights=solution.weights)
