"""Calibration with effects as terms of the cell, refitted with everything else or held; unmodelled groups get the size they ask for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import compress

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell, adjusted_cell
from mbcacq.calibration.cell_estimate import square_root
from mbcacq.calibration.published_cell import with_estimates
from mbcacq.calibration.return_to_geometry import returning_to_geometry
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.effects import unmodelled as groups
from mbcacq.effects.common_pattern import LEAST_JOINTS, CommonPattern, OwnErrors, find_common_pattern
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect import JOINTS
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import BEYOND, UNKNOWN, EffectTerm
from mbcacq.effects.learnt_range import own_angle
from mbcacq.errors import ConfigError
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise, select_phases
from mbcacq.estimation.parameters import Estimate, ParameterLayout, build
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.random_effect_sizes import OTHERS, consecutive, eliminated, sizes_by_marginal_likelihood, without_prior
from mbcacq.estimation.solution import Solution, system
from mbcacq.estimation.solver import most_probable_noise, one_thread
from mbcacq.estimation.terms import Term
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.observations import Observations


@dataclass(frozen=True, kw_only=True)
class GroupSizeOptions:
    """How the size of each group of unmodelled effects is estimated."""

    turns: int = 4  # of size, step and noise; geometry and effects no longer move by then
    turns_again: int = 2  # of the same from a noise that was found with other groups; what is learnt is the same with four
    most_poses: int = 600  # by which sizes and noise are found, to a few per cent; coefficients take all that are learnt from
    most_learnt: int = 3000  # poses of one recording: more repeat its own drift, and the arm so learnt is worse elsewhere (transfer.md)
    noise_steps: int = 1  # of the noise in each; two lead to the same within the noise's uncertainty
    least_before_last: float = 0.1  # of a group's prior size: smaller ones do not come back once the noise has fallen
    fixed_units: tuple[str, ...] = ("rad/Nm",)  # physical priors, whose size is not estimated


OPTIONS = GroupSizeOptions()
Fit = Callable[[Observations, CalibrationOptions], CalibratedCell]


def refitted(
    observations: Observations, options: CalibrationOptions | None, model: EffectModel, fit: Fit, *, hold: bool = False
) -> CalibratedCell:
    """The cell with effects: geometry as usual, the coefficients of the effects with it; their hyper-parameters are kept.

    fit: calibrates observations under any options. hold: the effects stay as they were learnt, the geometry alone is fitted. Unmodelled
    effects are learnt from 3000 poses at most, evenly at random; the calibration is of these. Raises ConfigError if the effects are of
    another arm, and what ``fit`` raises.
    """
    options = options or CalibrationOptions()
    obs = _learnt_from(observations, options, model, hold)
    with one_thread():
        return fitted_with_effects(obs, options, model, hold, fit)


def refitted_effects(observations: Observations, options: CalibrationOptions, model: EffectModel, fit: Fit) -> EffectModel | None:
    """The effects of the cell that ``refitted`` returns, in less time: the geometry alone is not fitted for comparison."""
    obs = _learnt_from(observations, options, model, hold=False)
    with one_thread():
        found = _fitted(obs, options, model, hold=False, fit=fit).effects
    return found and found.select(lambda t: t.variant != BEYOND)


def _learnt_from(observations: Observations, options: CalibrationOptions, model: EffectModel, hold: bool) -> Observations:
    """The poses that effects are learnt from. Raises ConfigError as ``refitted``."""
    if options.method != "ml":
        raise ConfigError("effects are fitted by --method ml; the staged method knows geometry alone")
    refuse_effects_of_other_arm(observations, model)
    obs = select_phases(observations, options)
    if obs.n_poses > OPTIONS.most_learnt and not hold and any(t.name == UNKNOWN for t in model.terms):
        obs = obs.select(some_poses(obs, OPTIONS.most_learnt))
    return obs


def fitted_with_effects(obs: Observations, options: CalibrationOptions, model: EffectModel, hold: bool, fit: Fit) -> CalibratedCell:
    """The observations calibrated with effects by ``fit``, which calibrates them under any options, beside the geometry alone."""
    alone = fit(obs, replace(options, discrepancy=False, refuse=False, random_links=False))
    return _beside(alone, _fitted(obs, options, model, hold, fit))


def _fitted(obs: Observations, options: CalibrationOptions, model: EffectModel, hold: bool, fit: Fit) -> CalibratedCell:
    """The observations calibrated with effects. These are the account of what the arm does beyond its geometry: no discrepancy is sought
    beside them."""
    options = replace(options, discrepancy=False)
    held = model if hold else model.select(lambda t: t.held)
    free = model.select(lambda t: not (hold or t.held or t.variant == BEYOND)).learnt_at(obs)
    options = replace(options, displaced=(*options.displaced, *zip(held.at(obs), held.coefficients, strict=True)))
    fitted = _fitted_beside_held(obs, options, free, fit) if free else fit(obs, options)
    return replace(fitted, effects=replace(model, terms=(*held.terms, *(fitted.effects.terms if fitted.effects else ()))))


def _fitted_beside_held(obs: Observations, options: CalibrationOptions, model: EffectModel, fit: Fit) -> CalibratedCell:
    """The same with effects that are all fitted."""
    lenient = replace(options, refuse=False)  # what is undetermined without the effects may be determined with them
    parametric, unmodelled = model.parametric, model.select(lambda t: t.name == UNKNOWN)
    fitted = fit(obs, replace(options, terms=parametric.at(obs)) if parametric else lenient)
    if not unmodelled:
        return replace(fitted, effects=with_estimates(parametric, fitted))
    stage, noise = sized_groups(fitted, options, parametric, unmodelled)
    pattern = common_pattern_of(stage, noise, parametric, unmodelled)
    if pattern is None:
        return with_groups(stage, noise, parametric, unmodelled)
    # Lines of these joints are in the pattern: a second description of one error takes it away from the first.
    apart = parametric.select(lambda t: not t.periodic_in_own_angle or joint_of(t) not in pattern.joints)
    if len(apart.terms) < len(parametric.terms):
        fitted = fit(obs, replace(options if apart else lenient, terms=apart.at(obs), start=fitted.state))
    patterned = with_pattern(obs, unmodelled, pattern)
    stage, noise = sized_groups(fitted, options, apart, patterned, noise)
    found = with_groups(stage, noise, apart, patterned)
    return replace(found, extra={**found.extra, "common_pattern": asdict(pattern)})


def common_pattern_of(sized: _Stage, noise: Noise, parametric: EffectModel, unmodelled: EffectModel) -> CommonPattern | None:
    """The pattern that joints share in their own errors, by its evidence in a recording, where the groups for them have these sizes.

    None if there is none, where the recording is too short to tell, or where the groups have one.
    """
    fitted, options = sized.fitted, sized.options
    known = any(t.variant == groups.COMMON_PATTERN for t in unmodelled.terms)
    own = [t for t in unmodelled.terms if own_joint(t) is not None and t.k == 2 * groups.OPTIONS.own_order]
    if known or fitted.fit.observations.n_poses < groups.OPTIONS.many_poses or len(own) < LEAST_JOINTS:
        return None
    others = parametric.select(lambda t: not t.periodic_in_own_angle)
    bare = replace(fitted, own_fit=replace(fitted.fit, coefficients=tuple(np.zeros(t.k) for t in others.terms)))
    stage = _Stage.first(bare, options, others, unmodelled, np.ones(fitted.fit.observations.n_poses, bool))
    # Linearised where the groups have taken their share: an arm that was fitted without them is bent by them.
    stage = replace(stage, estimate=replace(stage.estimate, state=sized.estimate.state))
    size = {g.key: g.sigma * s for g, s in zip(sized.groups, sized.scale, strict=True)}
    normal = stage.system(noise).normal
    layout = stage.layout
    position = {name: j for j, name in enumerate(layout.names)}
    index = {joint_of(t): np.array([position[name] for name in t.names]) for t in own}
    sigma = {joint_of(t): size.get(t.key, OPTIONS.least_before_last * t.sigma) for t in own}
    weight = layout.sigma**-2.0
    information = normal.information.copy()
    for columns in index.values():
        information[columns, columns] -= weight[columns]
    shape = groups.pattern_sigma()
    largest = max(float(np.max(one / shape)) for one in sigma.values())
    return find_common_pattern(OwnErrors(information, normal.gradient, index, sigma, shape * largest, groups.open_deviation_sigma()))


def with_pattern(obs: Observations, unmodelled: EffectModel, pattern: CommonPattern) -> EffectModel:
    """The groups with one pattern for the joints that share it, and small deviations of each from it."""
    here = Covariates(obs)
    shared = groups.common_pattern(here, pattern.offset, pattern.direction, pattern.joints)
    others = [t for t in unmodelled.terms if own_joint(t) not in pattern.joints]
    return replace(unmodelled, terms=(shared, *(groups.deviation(here, i) for i in pattern.joints), *others))


def own_joint(t: EffectTerm) -> int | None:
    """The joint of which a group is the own error, by its own angle; None for another group."""
    if t.name != UNKNOWN or t.variant or len(t.where) != 1 or t.depends_on != own_angle(t.where[0]) or t.parts[0].place != "joint":
        return None
    return joint_of(t)


def joint_of(t: EffectTerm) -> int:
    """The index of the joint at which an effect acts; -1 for another location."""
    return t.parts[0].index if t.where[0].startswith(JOINTS) else -1


def _beside(alone: CalibratedCell, fitted: CalibratedCell) -> CalibratedCell:
    """The calibration with the arm that geometry alone gives, and its misfit, beside it: 'geometry_alone' of result.json."""
    rows = {p: getattr(alone.state.chain, p).tolist() for p in PARAMETERS}
    figures = {"rms_mm": alone.fit.rms_mm, "chi2": alone.fit.chi2, "dof": alone.fit.dof}
    return replace(fitted, extra={**fitted.extra, "geometry_alone": {"calibrated": rows, **figures}})


def refuse_effects_of_other_arm(obs: Observations, model: EffectModel, recording: str = "the recording") -> None:
    """Raises ConfigError if effects were learnt on another arm than that of a recording."""
    refuse_other_arm("these effects were learnt on", model.robot.name, model.robot.chain, obs.cell.robot, recording)


def sized_groups(
    fitted: CalibratedCell, options: CalibrationOptions, parametric: EffectModel, unmodelled: EffectModel, start: Noise | None = None
) -> tuple[_Stage, Noise]:
    """The sizes of unmodelled groups beside a calibration that has the parametric effects, and the noise that they leave. start: a noise
    to begin with.

    Each group is a random effect whose size maximises the marginal likelihood (MacKay 1992), with the geometry, the stations and the
    parametric effects free; groups that the data do not ask for are dropped.
    """
    obs = fitted.fit.observations
    stage = _Stage.first(fitted, options, parametric, unmodelled, some_poses(obs, OPTIONS.most_poses))
    noise = start or fitted.noise
    at = stage.system(noise)
    turns = OPTIONS.turns if start is None else OPTIONS.turns_again
    for turn in range(turns):
        stage = stage.sized(at, last=turn == turns - 1)
        at = most_probable_noise(stage.reweighted, stage.system(noise), OPTIONS.noise_steps)
        noise = at.noise
    return stage, noise


def with_groups(stage: _Stage, noise: Noise, parametric: EffectModel, unmodelled: EffectModel) -> CalibratedCell:
    """The calibration by all poses with groups that were sized by some of them."""
    fitted = stage.fitted
    if stage.observations is not fitted.fit.observations:
        stage = stage.by_all_poses(parametric, unmodelled)
        stage = stage.sized(stage.system(noise), last=True)
    at = stage.system(noise)
    chosen = replace(stage.options, terms=stage.terms)
    used, open_ones = fitted.fit.weights, list(fitted.fit.undetermined)
    adjusted = Adjustment(solution=at, noise=noise, weights=used, preliminary=fitted.preliminary, found=open_ones)
    result = with_uncertain_sizes(adjusted_cell(chosen, adjusted), stage)
    sized = (replace(g, sigma=g.sigma * s) for g, s in zip(stage.groups, stage.scale, strict=True))
    model = replace(parametric, terms=(*parametric.terms, *sized))
    found = replace(result, effects=with_estimates(model, result))
    long = stage.fitted.fit.used_poses >= groups.OPTIONS.many_poses  # slow orders, which trade with geometry, have small sizes there
    return found if long else returning_to_geometry(found, fitted, with_estimates(parametric, fitted))


def with_uncertain_sizes(cell: CalibratedCell, stage: _Stage) -> CalibratedCell:
    """The cell with a covariance for groups whose sizes were estimated; their coefficients are its last parameters.

    The variance of a group follows from the g coefficients that the recording determines, and from OTHERS that are usual. Its posterior
    mean is (g + OTHERS) / (g + OTHERS - 2) times the most probable one (inverse gamma). Where the recording was not, that is what the
    group may be.
    """
    C, first = cell.covariance, len(cell.covariance) - sum(g.k for g in stage.groups)
    weight = np.zeros(len(C))
    for g, s, own in zip(stage.groups, stage.scale, consecutive(g.k for g in stage.groups), strict=True):
        if not given_size(g):
            at, prior = slice(first + own.start, first + own.stop), (g.sigma * s) ** 2
            known = OTHERS + g.k - float(np.sum(np.diag(C)[at] / prior))
            weight[at] = -2 / known / prior
    root = square_root(C)
    return replace(cell, covariance=root @ np.linalg.solve(np.eye(len(C)) + root.T @ (weight[:, None] * root), root.T))


def terms_beyond(fitted: CalibratedCell, parametric: EffectModel) -> tuple[Term, ...]:
    """The terms that a fit has beside its parametric effects, which come first: what differs from one recording to the next."""
    terms, count = fitted.fit.options.terms, len(fitted.fit.coefficients) - len(parametric.terms)
    return terms[len(terms) - count :]


def some_poses(obs: Observations, most: int) -> np.ndarray:
    """(P,) bool of at most so many poses, evenly at random along their order."""
    if obs.n_poses <= most:
        return np.ones(obs.n_poses, bool)
    chosen = np.zeros(obs.n_poses, bool)
    rng = np.random.default_rng(0)
    chosen[[rng.choice(part) for part in np.array_split(np.arange(obs.n_poses), most)]] = True
    return chosen


@dataclass(frozen=True)
class _Stage:
    """An estimate with the groups that are left, by all or some of the poses. built: the terms of the parametric effects, those that the
    fit has beside them, then one for each group; scale: (G,) size of each group in units of its prior size.
    """

    fitted: CalibratedCell
    options: CalibrationOptions
    observations: Observations
    weights: Weights
    built: tuple[Term, ...]
    groups: tuple[EffectTerm, ...]
    scale: np.ndarray
    estimate: Estimate

    @classmethod
    def first(
        cls, fitted: CalibratedCell, options: CalibrationOptions, parametric: EffectModel, unmodelled: EffectModel, poses: np.ndarray
    ) -> _Stage:
        """By these poses (P,) bool, with the groups at zero."""
        groups = unmodelled.terms
        start = Estimate(fitted.state, (*fitted.fit.coefficients, *(np.zeros(g.k) for g in groups)))
        obs, weights = fitted.fit.observations, fitted.fit.weights
        further = terms_beyond(fitted, parametric)
        if not poses.all():
            further = tuple(t.at_poses(poses, obs.pose) for t in further)
            options = replace(options, displaced=tuple((t.at_poses(poses, obs.pose), c) for t, c in options.displaced))
            obs, weights = obs.select(poses), Weights(weights.centre[poses[obs.pose]], weights.pose[poses])
        built = (*parametric.at(obs), *further, *unmodelled.at(obs))
        return cls(fitted, options, obs, weights, built, groups, scale=np.ones(len(groups)), estimate=start)

    def by_all_poses(self, parametric: EffectModel, unmodelled: EffectModel) -> _Stage:
        """The same sizes and estimate by all poses."""
        obs = self.fitted.fit.observations
        left = replace(unmodelled, terms=self.groups)
        built = (*parametric.at(obs), *terms_beyond(self.fitted, parametric), *left.at(obs))
        options = replace(self.options, displaced=self.fitted.fit.options.displaced)
        return replace(self, options=options, observations=obs, weights=self.fitted.fit.weights, built=built)

    @property
    def named(self) -> tuple[Term, ...]:
        return self.built[: len(self.built) - len(self.groups)]

    @property
    def terms(self) -> tuple[Term, ...]:
        """All terms, the groups' priors at their sizes."""
        own = self.built[len(self.named) :]
        return (*self.named, *(replace(t, sigma=t.sigma * s) for t, s in zip(own, self.scale, strict=True)))

    @cached_property
    def layout(self) -> ParameterLayout:
        layout = build(self.observations, replace(self.options, terms=self.terms)).holding(self.fitted.layout.held)
        return ParameterLayout((self.fitted.layout.blocks[0], *layout.blocks[1:]))  # the sizes of the links' errors stay

    @cached_property
    def lineariser(self) -> Lineariser:
        return Lineariser(self.observations, self.layout, replace(self.options, terms=self.terms))

    def system(self, noise: Noise) -> Solution:
        """The normal equations at the estimate."""
        return system(self.lineariser, self.estimate, noise, self.weights)

    def reweighted(self, at: Solution, noise: Noise) -> Solution:
        """The normal equations at the same estimate under another noise."""
        return at.reweighted(noise, self.weights)

    def sized(self, at: Solution, last: bool) -> _Stage:
        """The groups at the sizes that the linearised problem asks for, and the estimate after the step of that problem.

        Groups that it does not ask for are dropped in the last turn only: at first the noise still contains what they would explain.
        """
        layout, normal = self.layout, at.normal
        first = layout.size - sum(g.k for g in self.groups)
        own = np.arange(first, layout.size)
        information, right = without_prior(normal, at.prior, own)
        smallest = groups.OPTIONS.smallest if last else OPTIONS.least_before_last
        scale = group_scales(*eliminated(information, right, own), self.groups, self.scale, smallest)
        scale = scale if last else np.maximum(scale, smallest)
        prior = np.concatenate([g.sigma * s for g, s in zip(self.groups, scale, strict=True)])
        size = np.concatenate([layout.scale[:first], prior])
        solved = size * np.linalg.solve(
            size[:, None] * information * size + np.diag(np.r_[np.zeros(first), np.ones(len(prior))]), size * right
        )
        step = solved - np.r_[np.zeros(first), at.prior.offset[own]]
        moved = self.estimate.moved(layout, step, normal.station_step(step), self.lineariser.rows.stations)
        alive = np.r_[np.ones(len(self.named), bool), scale > 0]
        kept = Estimate(moved.state, tuple(compress(moved.coefficients, alive)))
        built, left = tuple(compress(self.built, alive)), tuple(compress(self.groups, scale > 0))
        return replace(self, built=built, groups=left, scale=scale[scale > 0], estimate=kept)


def group_scales(S: np.ndarray, b: np.ndarray, several: Sequence[EffectTerm], start: np.ndarray, smallest: float) -> np.ndarray:
    """(G,) size of each group in units of its prior size, zero where it is below the smallest. S (k, k), b (k,): normal equations of the
    groups without their priors, all else eliminated.
    """
    sigma = np.concatenate([g.sigma for g in several])
    fixed = np.array([given_size(g) for g in several])
    begin, slices, tuned = np.where(fixed, 1.0, start), consecutive(g.k for g in several), groups.OPTIONS
    normal, limits = sigma[:, None] * S * sigma, (smallest, tuned.largest)
    return sizes_by_marginal_likelihood(normal, sigma * b, slices, begin, limits, tuned.ending, fixed)


def given_size(t: EffectTerm) -> bool:
    """Whether a group's prior size is physical, and not estimated."""
    return t.units[0] in OPTIONS.fixed_units
