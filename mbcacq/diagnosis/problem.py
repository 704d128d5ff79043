"""The diagnosis problem: the geometry fitted, the recording linearised there, and every candidate effect; long recordings thinned."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.observation_fit import adjusted_fit
from mbcacq.calibration.share import share_of
from mbcacq.diagnosis.executor import UNLIMITED, TimeBudget
from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.result import GeometryAlone
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet, Member
from mbcacq.effects import catalogue, unmodelled
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import RECORDING
from mbcacq.effects.effect import MOMENT, ON_THE_ARM, Candidate, HyperEstimate, ParameterEstimate, Parameters, StandstillRows
from mbcacq.effects.functions import of, times
from mbcacq.effects.support import joints_without_drive
from mbcacq.errors import CalibrationError
from mbcacq.estimation.adjustment import Adjustment, adjust, adjust_recording
from mbcacq.estimation.identifiability import Undetermined
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import CalibrationOptions, Noise, select_phases
from mbcacq.estimation.several_recordings import joint_problem
from mbcacq.estimation.variance_components import NoisePrior
from mbcacq.model.observations import Observations

EACH_RECORDING = "each recording"  # variant of an effect with a coefficient of its own in every recording


@dataclass(frozen=True)
class DiagnosisProblem:
    """The recording linearised at its geometric fit, and everything that may explain it.

    Attributes
    ----------
    dropped : dict[str, str]
        Effect -> what the recording lacks for it.
    noise : Noise
        The noise with geometry alone, as calibration estimates it.
    prior_noise : NoisePrior
        Prior of the variance components.
    undetermined : tuple[Undetermined, ...]
        Parameters of the geometry that the poses leave open.
    design_blocks : DesignBlocks
        Design blocks of unmodelled effects; they depend on the poses alone.
    geometry_alone : tuple[GeometryAlone, ...]
        The cell of each recording as calibration has it; whatever is thinned or readmitted later, it stays.
    budget : TimeBudget
        Budget of the time for the search.
    given : EffectSet
        Effects whose coefficients are known beforehand. They are no candidates, since they are in the problem from the beginning.
    """

    linear: LinearProblem
    context: Context
    candidates: list[Candidate]
    dropped: dict[str, str]
    noise: Noise
    prior_noise: NoisePrior
    design_blocks: DesignBlocks
    undetermined: tuple[Undetermined, ...] = ()
    geometry_alone: tuple[GeometryAlone, ...] = ()
    budget: TimeBudget = UNLIMITED
    given: EffectSet = NO_EFFECTS

    @property
    def in_part(self) -> bool:
        """Whether it has so many poses that effects are searched in a part of them, and what is unmodelled stands at all locations."""
        return self.linear.obs.n_poses > unmodelled.OPTIONS.many_poses

    @property
    def possible(self) -> list[Candidate]:
        """The candidates without names that the drives of the arm rule out: what it cannot have need not be excluded."""
        return [c for c in self.candidates if not joints_without_drive(c, self.linear.obs.cell.robot)]

    def searched(self, keep: np.ndarray) -> DiagnosisProblem:
        """The poses of the centres keep (M,) bool in which effects are searched: all of them, or as many as are searched of a long
        recording, evenly at random.
        """
        if self.in_part:
            return thinned(self, keep, OPTIONS.searched_poses)
        return self.with_linearization(self.linear.restricted(keep))

    def with_observations(self, obs: Observations, options: CalibrationOptions) -> DiagnosisProblem:
        """The same poses under another noise, adjusted anew; what is stated of geometry alone stays."""
        options = replace(options, refuse=False)
        anew = problem_of(obs, options, adjust_recording(obs, options))
        return replace(anew, geometry_alone=self.geometry_alone, budget=self.budget)

    def with_linearization(self, linear: LinearProblem) -> DiagnosisProblem:
        """The same with another linearisation of the same poses, or with other centres kept."""
        return replace(self, linear=linear)


@contextmanager
def determined(recordings: Observations | Sequence[Observations]) -> Iterator[None]:
    """Raises CalibrationError for fewer poses than a diagnosis needs, and where it turns out that they do not determine the cell."""
    every = [recordings] if isinstance(recordings, Observations) else recordings
    if any(r.cell.length_scale for r in every):
        raise CalibrationError("distances alone are calibrated and not diagnosed: a diagnosis needs places or poses of a target")
    poses = sum(r.n_poses for r in every)
    if poses < OPTIONS.fewest_poses:
        raise CalibrationError(f"{poses} poses are too few for a diagnosis: measure at least {OPTIONS.fewest_poses}")
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the recording does not determine the cell ({error}): measure more stations and orientations") from error


def prepare(recordings: Observations | Sequence[Observations], options: CalibrationOptions | None = None) -> DiagnosisProblem:
    """The recording adjusted as calibration does it: the same poses, outliers, noise and geometry.

    Several recordings of one arm are one problem: arm and effects are shared, base, tool, stations, artefacts and noise are not. Parameters
    that the poses leave undetermined are held. Raises CalibrationError if a recording contradicts its cell, ConfigError if the
    recordings are not of one arm.
    """
    options = replace(options or CalibrationOptions(), refuse=False)
    if isinstance(recordings, Observations):
        obs, parts = select_phases(recordings, options), ()
        adjusted = adjust_recording(obs, options)
    else:
        obs, start, parts = joint_problem(recordings, options)
        adjusted = adjust(obs, replace(options, start=start))
    fit, whole = adjusted_fit(options, adjusted)
    each = [share_of(fit, whole, parts, r, options) for r in range(len(parts))] or [(fit, whole)]
    problem = problem_of(obs, options, adjusted)
    return replace(problem, geometry_alone=tuple(GeometryAlone.of(*one) for one in each))


def problem_of(obs: Observations, options: CalibrationOptions, adjusted: Adjustment) -> DiagnosisProblem:
    """The problem of adjusted observations, without the cells of geometry alone."""
    keep = adjusted.used | not_grossly_off(adjusted.solution.residual)
    linear = LinearProblem.of(obs, adjusted.state, keep, layout=adjusted.lineariser.asked, given=options.displaced)
    context = Context(obs, adjusted.state, linear.prediction)
    candidates, dropped = catalogue.candidates(context)
    tried, noise = [*candidates, *differing(candidates, obs)], (adjusted.noise, adjusted.lineariser.noise_prior)
    return DiagnosisProblem(linear, context, tried, dropped, *noise, DesignBlocks(context), undetermined=tuple(adjusted.found))


def differing(candidates: Sequence[Candidate], obs: Observations) -> list[Candidate]:
    """Each effect of one coefficient on the arm once more, with a coefficient of its own in every one of several recordings."""
    if obs.recording is None:
        return []
    alike = [c for c in candidates if c.k == 1 and c.hyper is None and c.where[0].startswith(ON_THE_ARM)]
    return [of_each_recording(c, obs) for c in alike]


def of_each_recording(candidate: Candidate, obs: Observations) -> Candidate:
    """The candidate with one coefficient for each recording."""
    count = obs.n_recordings
    here = [of(RECORDING, "is", r) for r in range(count)]
    parts = [replace(p, columns=tuple(times(one, p.columns[0]) for one in here)) for p in candidate.parts()]

    def report(c: np.ndarray, v: np.ndarray, hyper: HyperEstimate) -> Parameters:
        each = [candidate.report(c[r : r + 1], v[r : r + 1, r : r + 1], hyper) for r in range(count)]
        return {
            name: ParameterEstimate(tuple(_first(e[name].value) for e in each), tuple(_first(e[name].std) for e in each))
            for name in each[0]
        }

    rows = StandstillRows(parts, np.repeat(candidate.typical, count))
    return replace(candidate, rows=rows, report=report, positive=False, variant=EACH_RECORDING)


def _first(value: float | tuple[float, ...]) -> float:
    return float(np.atleast_1d(value)[0])


def not_grossly_off(residual: np.ndarray) -> np.ndarray:
    """(M,) bool of the centres with which a search begins although the geometry alone rejects them: an effect may be what puts them off.

    residual (M, R): of the adjusted geometry.
    """
    distance = np.linalg.norm(residual[:, :3], axis=1)
    return distance < OPTIONS.gross_medians * np.median(distance)


def thinned(problem: DiagnosisProblem, keep: np.ndarray, most: int) -> DiagnosisProblem:
    """The same recording with at most ``most`` of the poses that have a kept centre, evenly at random along its order."""
    obs = problem.linear.obs
    has = np.flatnonzero(np.bincount(obs.pose[keep], minlength=obs.n_poses) > 0)
    rng = np.random.default_rng(0)
    chosen = np.zeros(obs.n_poses, bool)
    chosen[[rng.choice(part) for part in np.array_split(has[np.argsort(problem.context.order[has])], min(most, len(has)))]] = True
    small = obs.select(chosen)
    given = [(one.at_poses(chosen, obs.pose), mean) for one, mean in problem.linear.given]
    linear = LinearProblem.of(small, problem.linear.state, keep[chosen[obs.pose]], layout=problem.linear.layout, given=given)
    context = Context(small, problem.linear.state, linear.prediction)
    candidates = catalogue.candidates(context)[0]
    return replace(problem, linear=linear, context=context, candidates=candidates, design_blocks=DesignBlocks(context))


def transferred(source: DiagnosisProblem, target: DiagnosisProblem, members: Sequence[Member]) -> tuple[Member, ...]:
    """The effects found on one thinning of a recording as candidates of another, to be solved anew there."""
    by_key = {c.key: c for c in target.candidates}
    out = []
    for m in members:
        hyper, known = m.hyper, m.candidate.hyper
        if known is not None and known.kind == MOMENT and hyper is not None:
            hyper = same_moment(source, target, hyper)
        if m.candidate.key in by_key:
            out.append(replace(m, candidate=by_key[m.candidate.key], hyper=hyper))
    return tuple(out)


def same_moment(source: DiagnosisProblem, target: DiagnosisProblem, moment: float) -> float:
    """Rank, in the order of the target's poses, of the pose at a rank in the source's order."""
    pose = source.linear.obs.pose_id[np.flatnonzero(source.context.order == int(moment))[0]]
    listed = target.linear.obs.pose_id[np.argsort(target.context.order)]
    if np.any(listed == pose):
        return float(np.flatnonzero(listed == pose)[0])
    return float(moment) * len(listed) / source.linear.obs.n_poses
