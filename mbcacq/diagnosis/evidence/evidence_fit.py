"""The diagnosis of one recording by evidence: search, outliers with the best set in place, linearisation anew, search again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import LEAST_LOG_E_VALUE, RankedSets, log_e_value
from mbcacq.diagnosis.evidence.candidate_evidence import evidence_of_candidates
from mbcacq.diagnosis.evidence.coefficients import displacements, relinearized, with_discrepancy
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior, estimated, under
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.outliers import kept_centres, log_density_of_outlier
from mbcacq.diagnosis.evidence.pose_search import PoseSearch
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.variance_components import pack


@dataclass(frozen=True)
class EvidenceFit(RankedSets):
    """The sets of effects of poses. linear: the linearisation of the best one, without discrepancy."""

    linear: LinearProblem = field(kw_only=True)


def fit_evidence(problem: DiagnosisProblem) -> EvidenceFit:
    """The hypotheses of a recording, outliers judged with the best of them in place; what else each effect could be is asked at the end."""
    linear = problem.linear.restricted(readmitted(problem))
    fit = compared(problem, linear, pack(problem.noise))
    for _ in range(OPTIONS.passes):
        if fit.cut_short:
            break
        before = fit.best.key
        kept = judged_centres(fit)
        if not fit.best.members and np.array_equal(kept, linear.keep):
            break
        displaced = displacements(fit.best)
        linear = relinearized(linear, fit.best).restricted(kept)
        wide = with_discrepancy(linear, displaced, OPTIONS.discrepancy)
        fit = replace(compared(problem, wide, fit.none.point.theta, fit.best, alternatives=True), linear=linear)
        if fit.best.key == before:
            break
    return fit


def compared(
    problem: DiagnosisProblem,
    linear: LinearProblem,
    theta: np.ndarray,
    begin: Hypothesis | None = None,
    alternatives: bool = False,
    narrow: bool = False,
    staged: bool = False,
) -> EvidenceFit:
    """The hypotheses of a linearisation as it is. theta: noise of the empty set, to begin with. begin: a set from which the search goes on;
    alternatives, narrow, staged: of the search (see there).
    """
    blocks = UnmodelledEffects(problem.design_blocks)
    prior = SetPrior.of(problem.candidates, blocks.locations, [g.candidate.label for g in problem.given])
    search = PoseSearch(
        candidates=problem.candidates,
        prior=prior,
        alternatives=alternatives,
        narrow=narrow,
        unmodelled=blocks,
        context=problem.context,
        given=problem.given,
        staged=staged,
        budget=problem.budget,
    )
    ranked = search.run(NoisePoint(linear, problem.prior_noise, theta), begin)
    return EvidenceFit(tuple(ranked), search.known[()], log_e_value(ranked), LEAST_LOG_E_VALUE, prior, search.cut_short, linear=linear)


def readmitted(problem: DiagnosisProblem) -> np.ndarray:
    """(M,) bool of the centres with which a search begins. Those that were rejected before anything was known may be an effect themselves:
    they take part where one effect alone makes all centres more probable than they are as outliers of no effect.
    """
    start = NoisePoint(problem.linear, problem.prior_noise, pack(problem.noise))
    plain = problem.linear.keep
    if plain.all():
        return plain
    everything, prior = start.restricted(np.ones(len(plain), dtype=bool)), SetPrior.of(problem.candidates, 1)
    scored = evidence_of_candidates(everything.projected, [c for c in problem.candidates if not c.several or c.hyper is None])
    tried = [(plain, log_with_outliers((), start, 0.0))]
    for one in sorted(scored, key=lambda s: -s.log_evidence)[: OPTIONS.beam]:
        members, log_prior = (Member(one.candidate, one.hyper, one.log_mass),), prior.log_probability(one.candidate, [])
        keep = kept_centres(under(everything, members, log_prior))
        tried.append((keep, log_with_outliers(members, everything.restricted(keep), log_prior)))
    return max(tried, key=lambda one: one[1])[0]


def judged_centres(fit: EvidenceFit) -> np.ndarray:
    """(M,) bool of the centres that are no outliers: with the best set in place where it is significant with its own outliers against no
    effect with its own, else with none.
    """
    best, none = fit.best, fit.none
    plain = kept_centres(none)
    if not best.members:
        return plain
    own = kept_centres(best)
    gain = log_with_outliers(best.members, best.point.restricted(own), best.log_prior)
    return own if gain - log_with_outliers((), none.point.restricted(plain), 0.0) > fit.least else plain


def log_with_outliers(members: Sequence[Member], point: NoisePoint, log_prior: float) -> float:
    """Log posterior of a set, the centres that its point leaves out being outliers."""
    outliers = float(np.sum(~point.linear.keep))
    return estimated(members, point, log_prior).log_posterior + log_density_of_outlier(point.linear) * outliers
