"""The diagnosis of one recording by evidence: search, outliers with the best set in place, linearisation anew, search again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import EvidenceSearch, log_e_value, log_e_value_at_false_alarm_rate
from mbcacq.diagnosis.evidence.coefficients import displacements, relinearized, with_discrepancy
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior, estimated
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.options import OPTIONS
from mbcacq.diagnosis.evidence.outliers import kept_centres, log_density_of_outlier
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.variance_components import pack


@dataclass(frozen=True)
class EvidenceFit:
    """hypotheses: all that were compared, most probable first, the empty set (``none``) among them. linear: the linearisation of the best
    one, without discrepancy. log_e_value: of all effects together against none; above ``least`` there is an effect.
    """

    hypotheses: tuple[Hypothesis, ...]
    none: Hypothesis
    linear: LinearProblem
    log_e_value: float
    least: float

    @property
    def significant(self) -> bool:
        return self.log_e_value > self.least

    @property
    def best(self) -> Hypothesis:
        """The most probable set where there is an effect at all, else the empty one."""
        return next(h for h in self.hypotheses if h.members) if self.significant else self.none


def fit_evidence(problem: DiagnosisProblem) -> EvidenceFit:
    """The hypotheses of a recording, outliers judged with the best of them in place; what else each effect could be is asked at the end."""
    linear = problem.linear
    fit = compared(problem, linear, pack(problem.noise))
    for _ in range(OPTIONS.relinearizations):
        before = fit.best.key
        kept = judged_centres(fit)
        if not fit.best.members and np.array_equal(kept, linear.keep):
            break
        displaced = displacements(fit.best)
        linear = relinearized(linear, fit.best).restricted(kept) if fit.best.members else linear.restricted(kept)
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
    prior = SetPrior.of(problem.candidates, blocks.locations)
    search = EvidenceSearch(problem.candidates, blocks, prior, problem.context, alternatives, narrow, staged)
    ranked = search.run(NoisePoint(linear, problem.prior_noise, theta), begin)
    return EvidenceFit(tuple(ranked), search.known[()], linear, log_e_value(ranked), log_e_value_at_false_alarm_rate(linear.obs.n_poses))


def judged_centres(fit: EvidenceFit) -> np.ndarray:
    """(M,) bool of the centres that are no outliers: with the best set in place where it is significant with its own outliers against no
    effect with its own, else with none.
    """
    linear = fit.none.point.linear
    own, plain = kept_centres(fit.best), kept_centres(fit.none)
    if np.mean(~plain) > DIAGNOSIS.most_outliers:
        plain = linear.keep
    if not fit.best.members:
        return plain
    if np.mean(~own) > DIAGNOSIS.most_outliers:
        own = linear.keep
    cost = log_density_of_outlier(linear)
    logs = []
    for hypothesis, keep in ((fit.best, own), (fit.none, plain)):
        there = estimated(hypothesis.members, hypothesis.point.restricted(keep), hypothesis.log_prior)
        logs.append(there.log_posterior + cost * float(np.sum(~keep)))
    return own if logs[0] - logs[1] > fit.least else plain
