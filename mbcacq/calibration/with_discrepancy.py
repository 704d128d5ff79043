"""Calibration of an arm whose errors beyond its geometry are smooth functions of posture: kept where the evidence asks for them.

The groups, their sizes and the noise beside them are found within the linear problem at the adjustment by geometry alone, by restricted
maximum likelihood. A long recording uses a part of its poses for this. All poses are then adjusted once more with the groups that are left.
Sizes begin large and the noise begins as stated, since noise that has taken up what repeats gives it back slowly.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.published_cell import cell_of, with_estimates
from mbcacq.calibration.recording_faults import joint_factor
from mbcacq.calibration.with_effects import some_poses
from mbcacq.effects import discrepancy
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm, LearntRecording
from mbcacq.estimation import forward_model, variance_components
from mbcacq.estimation.adjustment import Adjustment, adjust, with_random_links
from mbcacq.estimation.linear_problem import ExtendedProblem, LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.random_effect_sizes import consecutive, gain_of_groups, sizes_of_groups, supported_groups
from mbcacq.estimation.variance_components import NoisePrior, first_noise, noise_prior, pack

MOST_POSES = 2400  # by which groups are found and sized: 3000 of a UR10 predict as well as all of them do so (104 um; by 1200 111 um)
LEAST_GAIN = 5.0  # log evidence over geometry alone: odds of 150 to 1 for all groups together
# Log evidence that each size gains by chance, on 60 arms that err by their geometry alone. 28 own errors gain 2.4 in the median; 168 stages
# of gears gain 2.9 and at most 12.2, if those that are not supported by themselves are left out.
CHANCE, CHANCE_OF_SUPPORTED = 0.1, 0.05
LEAST_SIZE = 3e-3  # of the size at the start (1 mrad): smaller groups move no point by a micrometre
LARGEST_SIZE = 4.0  # of the same, which is large already
TURNS, ROUNDS, CONVERGED = 12, 60, 0.1  # turns of sizes and noise; steps of the fixed point in each; change of a logarithm
EXCESS = 1.2  # of the joints' noise over the data sheet's, above which the model lacks something: further kinds of groups are tried
Kind = Callable[[Context], list[EffectTerm]]
FURTHER: tuple[Kind, ...] = discrepancy.FURTHER
CORRELATED = 2.0  # standard deviations of the joints' serial correlation, from which wander is tried: what is kept the evidence decides
FASTEST_MESH, MOST_MESHES = 330.0, 6  # periods a turn of a joint: twice in each turn of a strain wave of a ratio of 160
ALIAS = 0.9  # of the window: orders so far apart look alike at the angles of a grid, and the slower one is no mesh
LEAST_GAIN_OF_MESH = 14.0  # as LEAST_GAIN, for the best of ten thousand orders of all joints
LEAST_SUPPORT = 3.0  # log Bayes factor of a group of a further kind: there are a hundred of them, most of which an arm does not have


def with_discrepancy(alone: Adjustment) -> CalibratedCell | None:
    """The recording calibrated with smooth errors of the joints.

    Parameters
    ----------
    alone : Adjustment
        The recording by geometry alone; terms of its options stay.

    Returns
    -------
    CalibratedCell or None
        With its adjustment; its effects are the groups of the arm that are left. 'discrepancy' of ``extra`` has the log evidence over
        geometry alone, of the poses by which the groups were sized, and the (n,) rms (rad) of each joint's error that poses after one
        another share, unless they are independent. None where geometry alone is as probable.
    """
    obs, options = alone.lineariser.obs, alone.lineariser.options
    here = Context(obs, alone.state, forward_model.predict(obs, alone.state))
    prior = noise_prior(obs.cell, options.noise)
    nothing = _Groups(_some_of(alone), prior, (), (), alone.noise)
    best = _grown(nothing, (discrepancy.own_errors, *FURTHER), here)
    if best.terms and joint_factor(best.noise, obs.cell) < EXCESS:
        # In few poses many functions of one angle account for a product of two, or for a frame, with sums that are wrong elsewhere.
        for first in (discrepancy.pairs, discrepancy.structure):
            best = _more_probable(best, _grown(nothing, (first, discrepancy.own_errors), here, where_noisy=()))
    if obs.n_poses <= discrepancy.OPTIONS.wander_poses and serial_correlation(alone, here.order) > CORRELATED:
        # Where the poses follow a grid, posture and order say much the same.
        best = _more_probable(best, _grown(nothing, (discrepancy.wander, discrepancy.own_errors, *FURTHER), here))
    best = _with_meshes(best, here)
    if not best.terms:
        return None
    learnt = LearntRecording.of(obs)
    built = [replace(t.term(here, learnt), sigma=t.sigma) for t in best.terms]
    chosen = replace(options, terms=(*options.terms, *built))
    cell = cell_of(with_random_links(adjust(obs, chosen, replace(alone, noise=best.noise), links_follow=True)))
    # Errors that the order of the poses explains belong to this recording. They are in the uncertainties, and say nothing of other poses.
    of_the_arm = tuple(t for t in best.terms if t.variant != discrepancy.WANDER)
    model = EffectModel(obs.cell.robot, of_the_arm, learnt, obs.cell.measurement)
    said: dict[str, Any] = {"log_evidence_gain": best.evidence - nothing.evidence}
    if (wander := wander_of(best.terms, here.n)) is not None:
        said["wander_rad"] = wander.tolist()
    effects, asked = with_estimates(model, cell) if model else None, replace(cell.fit, options=options)
    return replace(cell, effects=effects, own_fit=asked, extra={**cell.extra, "discrepancy": said})


def evidence_gain(cell: CalibratedCell) -> float:
    """Log evidence of a cell with smooth errors over geometry alone."""
    return cell.extra["discrepancy"]["log_evidence_gain"]


def _some_of(alone: Adjustment) -> LinearProblem:
    """The linear problem at an adjustment, of all poses or, of many, some."""
    obs, used, terms = alone.lineariser.obs, alone.used, alone.lineariser.options.terms
    if obs.n_poses > MOST_POSES:
        poses = some_poses(obs, MOST_POSES)
        terms = tuple(t.at_poses(poses, obs.pose) for t in terms)
        obs, used = obs.select(poses), used[poses[obs.pose]]
    return LinearProblem.of(obs, alone.state, used, terms, alone.solution.estimate.coefficients, alone.lineariser.layout)


def _more_probable(one: _Groups, other: _Groups, least: float = LEAST_GAIN) -> _Groups:
    """The explanation of two that the evidence prefers; the first one unless the preference is clear."""
    return other if other.evidence > one.evidence + least else one


def _grown(best: _Groups, kinds: Sequence[Kind], here: Context, where_noisy: Collection[Kind] = FURTHER[1:]) -> _Groups:
    """The groups with those of further kinds, one kind after the other, where the evidence asks for them. where_noisy: the kinds that are
    tried only where the joints' noise is beyond the data sheet: there are many of them."""
    allowed = first_noise(here.obs.cell)
    for kind in kinds:
        if kind in where_noisy and joint_factor(best.noise, here.obs.cell) < EXCESS:
            break
        tried = _Groups.first(best, kind(here), here)
        if tried is None:
            continue
        further = kind in FURTHER
        least = LEAST_GAIN + (CHANCE_OF_SUPPORTED if further else CHANCE) * (len(tried.terms) - len(best.terms))
        gain, size = tried.quick_gain(allowed if kind is discrepancy.structure else best.noise)
        if gain < (LEAST_GAIN if further else least):
            continue
        if further:
            tried = tried.without([key for key in size if size[key] < LEAST_SIZE and key not in best.start])
        settled = tried.settled(allowed)
        if further:
            settled = settled.supported(best.start).settled(settled.noise)
        best = _more_probable(best, settled, least)
    return best


def _with_meshes(best: _Groups, here: Context) -> _Groups:
    """The groups with single orders of meshes, one after the other. Thousands of orders are no smooth function: a candidate is the one that
    a joint's errors follow best, as the groups leave them. Those of a joint are looked for once more where the others' are in place."""
    for _ in range(MOST_MESHES):
        more = _with_mesh(best, here)
        if more.evidence < best.evidence + LEAST_GAIN_OF_MESH:
            break
        best = more
    for at in sorted({t.where for t in best.terms if discrepancy.ORDER in t.hyper}):
        own = [t.key for t in best.terms if t.where == at and discrepancy.ORDER in t.hyper]
        best = _more_probable(best, _with_mesh(best.without(own), here), 0.0)
    return best


def _with_mesh(groups: _Groups, here: Context) -> _Groups:
    """The groups with the strongest order, if it has more power than any of noise alone."""
    power, joint, order = _strongest_order(groups)
    tried = _Groups.first(groups, [discrepancy.mesh(here, joint, order)], here) if power > LEAST_GAIN_OF_MESH else None
    return groups if tried is None else tried.settled(groups.noise)


def _strongest_order(groups: _Groups) -> tuple[float, int, float]:
    """The order above those of wheels that a joint's errors follow best, as the groups leave them: its power in the periodogram (1 in the
    mean of noise, Scargle 1982), the joint, and the order."""
    problem, noise = groups.problem, groups.noise
    left = groups.extended.at(noise).after_fit().poses.by_pose(lambda of: of.residual_joint)
    error, q = problem.rows.per_pose(left) * noise.joint, problem.obs.q
    found = 0.0, 0, 0.0
    for j in np.flatnonzero(~problem.obs.cell.robot.chain.prismatic).tolist():
        step = np.pi / 2 / max(float(np.ptp(q[:, j])), np.pi / 2)  # a quarter of the distance of orders that can be told apart
        shifts = np.arange(8 * step, 2 * FASTEST_MESH, step)
        alike = shifts[_periodogram(shifts, q[:, j], np.full(len(q), 1 / len(q))) > ALIAS**2]
        orders = np.arange(discrepancy.OPTIONS.fastest + 1.0, min(alike.min(initial=np.inf) / 2, FASTEST_MESH), step)
        power, best = np.zeros(1), 0.0
        for _ in range(2 if len(orders) else 0):
            power = _periodogram(orders, q[:, j], error[:, j] / max(float(np.linalg.norm(error[:, j])), 1e-300))
            best = float(orders[power.argmax()])
            orders = np.linspace(best - step, best + step, 33)
        found = max(found, (float(power.max()), j, best))
    return found


def _periodogram(orders: np.ndarray, q: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(H,) squared magnitude of the sums of values (P,) by evenly spaced orders (H,) of an angle q (P,).

    Every order is one of a few far apart and one of a few near zero, and its sum an element of the product of two small matrices.
    """
    near = max(int(np.ceil(np.sqrt(len(orders)))), 1)
    far, beyond = orders[::near], orders[:near] - orders[:1]
    sums = (np.exp(1j * np.outer(far, q)) * values) @ np.exp(1j * np.outer(q, beyond))
    return np.abs(sums.ravel()[: len(orders)]) ** 2


def wander_of(terms: Sequence[EffectTerm], joints: int) -> np.ndarray | None:
    """(n,) rad rms over the poses of what wanders at each joint, by the sizes of its cosines; None where nothing does."""
    rms = np.zeros(joints)
    for t in terms:
        if t.variant == discrepancy.WANDER:
            rms[t.parts[0].index] = np.sqrt(np.sum(t.sigma**2) / 2)
    return rms if rms.any() else None


def serial_correlation(adjusted: Adjustment, order: np.ndarray) -> float:
    """By how many standard deviations the joints' errors of poses after one another agree more than by chance; order: (P,) rank of each.

    Products of neighbours are as often negative as positive where errors are independent, whatever their sizes.
    """
    rows = adjusted.lineariser.rows
    error = rows.per_pose(adjusted.solution.poses.by_pose(lambda of: of.residual_joint * of.share[:, None]))[np.argsort(order)]
    products = np.sum(error[1:] * error[:-1], axis=1)
    return float(products.sum() / np.sqrt(np.maximum(np.sum(products**2), 1e-300)))


def _twists(problem: LinearProblem, groups: Sequence[EffectTerm], here: Covariates) -> list[np.ndarray]:
    """(P, u, k) of each group; the functions of all groups that turn one joint are evaluated together."""
    found: dict[str, np.ndarray] = {}
    for joint in {g.parts[0].index for g in groups if g.parts[0].place == "joint"}:
        own = [g for g in groups if (g.parts[0].place, g.parts[0].index) == ("joint", joint)]
        part = replace(own[0].parts[0], columns=tuple(column for g in own for column in g.parts[0].columns))
        ends = np.cumsum([g.k for g in own])[:-1]
        found |= zip((g.key for g in own), np.split(problem.twists_of(evaluated(here, [part])), ends, axis=2), strict=True)
    return [found[g.key] if g.key in found else problem.twists_of(evaluated(here, g.parts)) for g in groups]


@dataclass(frozen=True)
class _Groups:
    """Groups within the linear problem; all move a pose as a whole. twists: (P, u, k) of each; start: of each group by key, rad, where the
    estimation of its size began."""

    problem: LinearProblem
    prior: NoisePrior
    terms: tuple[EffectTerm, ...]
    twists: tuple[np.ndarray, ...]
    noise: Noise
    start: dict[str, float] = field(default_factory=dict)

    @classmethod
    def first(cls, known: _Groups, groups: Sequence[EffectTerm], here: Context) -> _Groups | None:
        """The known groups with further ones. here: of the whole recording, of which the problem may hold a part."""
        if not groups:
            return None
        there = here if known.problem.obs is here.obs else Covariates(known.problem.obs)
        built = _twists(known.problem, groups, there)
        start = known.start | {g.key: float(g.sigma.max()) for g in groups}
        return replace(known, terms=(*known.terms, *groups), twists=(*known.twists, *built), start=start)

    @property
    def extended(self) -> ExtendedProblem:
        nothing = self.problem.columns_by_pose.twists[:, :, :0]
        return self.problem.extended_by_twists(np.concatenate([nothing, *self.twists], axis=2), self._sigma)

    def at_their_sizes(self, extended: ExtendedProblem) -> ExtendedProblem:
        """The extended problem of the same groups in other sizes, at the present ones."""
        first = self.problem.columns_by_pose.twists.shape[2]
        return replace(extended, prior=replace(extended.prior, sigma=np.insert(self.problem.sigma, first, self._sigma)))

    @property
    def index(self) -> dict[str, np.ndarray]:
        """Indices of each group's coefficients among the parameters."""
        first = self.problem.columns_by_pose.twists.shape[2]
        places = consecutive(t.k for t in self.terms)
        return {t.key: first + np.arange(p.start, p.stop) for t, p in zip(self.terms, places, strict=True)}

    def quick_gain(self, noise: Noise) -> tuple[float, dict[str, float]]:
        """Log evidence that the groups add under a noise that holds what they would explain, which is less than they add with their own
        noise; and their sizes then."""
        extended = self.extended
        return gain_of_groups(extended.at(noise).normal, extended.prior, self.index, (LEAST_SIZE, LARGEST_SIZE), ROUNDS)

    def supported(self, known: Collection[str]) -> _Groups:
        """The groups but those beyond the known ones that the recording does not support by themselves."""
        extended = self.extended
        doubtful = {t.key for t in self.terms} - set(known)
        kept = supported_groups(extended.at(self.noise).normal, extended.prior, self.index, doubtful, LEAST_SUPPORT)
        return self.without({t.key for t in self.terms} - kept)

    def without(self, keys: Collection[str]) -> _Groups:
        """The groups but these."""
        kept = [j for j, t in enumerate(self.terms) if t.key not in keys]
        return replace(self, terms=tuple(self.terms[j] for j in kept), twists=tuple(self.twists[j] for j in kept))

    def settled(self, noise: Noise) -> _Groups:
        """Sizes and noise by turns, from sizes at their start and this noise. A group that shrinks to nothing is left out at once:
        the noise of later turns is larger and leaves even less for it to explain."""
        groups, extended = self, None
        for _ in range(TURNS):
            if not groups.terms:
                break
            extended = groups.extended if extended is None else groups.at_their_sizes(extended)
            system = extended.at(noise)
            factor = sizes_of_groups(system.normal, extended.prior, groups.index, (1e-6, LARGEST_SIZE), ROUNDS)
            earlier, (noise, _) = noise, variance_components.reml_step(system.after_fit(), noise, groups.prior)
            moved = max(abs(np.log(f)) for key, f in factor.items())
            terms, groups = groups.terms, groups._resized(factor)
            extended = extended if len(groups.terms) == len(terms) else None
            if max(moved, float(np.abs(pack(noise) - pack(earlier)).max())) < CONVERGED:
                break
        return replace(groups, noise=noise)

    def _resized(self, factor: Mapping[str, float]) -> _Groups:
        """With the sizes multiplied, none beyond the largest, and without the groups that are too small to matter."""
        kept, terms = [], []
        for j, t in enumerate(self.terms):
            present, start = float(t.sigma.max()), self.start[t.key]
            size = min(present * factor[t.key], LARGEST_SIZE * start)
            if size > LEAST_SIZE * start:
                kept.append(j)
                terms.append(replace(t, sigma=t.sigma * (size / present)))
        return replace(self, terms=tuple(terms), twists=tuple(self.twists[j] for j in kept))

    @cached_property
    def evidence(self) -> float:
        """Log evidence under this noise."""
        system = self.extended.at(self.noise).after_fit()
        return variance_components.log_evidence(system, self.noise, self.prior, self._sigma)

    @property
    def _sigma(self) -> np.ndarray:
        """Prior sigma of all coefficients."""
        return np.concatenate([np.zeros(0), *(t.sigma for t in self.terms)])
