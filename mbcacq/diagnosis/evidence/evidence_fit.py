"""The diagnosis of one recording by evidence: search, outliers with the best set in place, linearisation anew, search again.

A centre is normal about its prediction, or with a small probability anywhere within a broad normal distribution. So hypotheses with
different outliers can be compared: every outlier costs the log of that probability density. A confident name must also be better than
the effects that were not tried (``with_untried_rivals``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import LEAST_LOG_E_VALUE, EvidenceFit, linearised_anew, log_e_value
from mbcacq.diagnosis.evidence.candidate_evidence import evidence_of_candidates
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior, estimated, under
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.pose_search import PoseSearch
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.effect_columns import candidate_columns, candidate_parts
from mbcacq.diagnosis.search.effect_set import Member, prior_sigma
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.untried import UntriedEffect, untried
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.terms import term
from mbcacq.estimation.variance_components import pack


def log_density_of_outlier(linear: LinearProblem) -> float:
    """Log prior probability of an outlier times its density, without the power of 2 pi that every centre has."""
    size = np.log(OPTIONS.outlier_mm) * 3 + (np.log(OPTIONS.outlier_rad) * 3 if linear.width == 6 else 0.0)
    return float(np.log(OPTIONS.outlier_prior) - size)


def kept_centres(hypothesis: Hypothesis) -> np.ndarray:
    """(M,) bool of the centres that are more probable as measurements than as outliers, by the noise of the instrument and the joints."""
    point = hypothesis.point
    linear, noise = point.linear, point.projected.noise
    _, residual = solution(hypothesis)
    J = linear.rows.unpad(linear.joint * linear.rows.joint_sigma(noise))
    S = J @ np.swapaxes(J, 1, 2)
    S[:, np.arange(linear.width), np.arange(linear.width)] += linear.rows.row_sigma(noise) ** 2
    square = np.einsum("mr,mr->m", residual, np.linalg.solve(S, residual[:, :, None])[:, :, 0])
    log_density = -0.5 * (square + np.linalg.slogdet(S)[1])
    # A gross error adds to the noise: where the noise is as large, no centre stands out from it.
    broad = np.r_[[OPTIONS.outlier_mm] * 3, [OPTIONS.outlier_rad] * 3][: linear.width]
    S[:, np.arange(linear.width), np.arange(linear.width)] += broad**2
    return log_density > np.log(OPTIONS.outlier_prior) - 0.5 * np.linalg.slogdet(S)[1]


def fit_evidence(problem: DiagnosisProblem) -> EvidenceFit:
    """The hypotheses of a recording, outliers judged with the best of them in place; what else each effect could be is asked at the end."""
    linear = problem.linear.restricted(readmitted(problem))
    return linearised_anew(compared(problem, linear, pack(problem.noise)), partial(_compared_anew, problem), OPTIONS.passes)


def _compared_anew(problem: DiagnosisProblem, fit: EvidenceFit, before: EvidenceFit | None) -> EvidenceFit | None:
    """The sets at the linearisation of the best one, with its outliers left out; None if both stay, or time is over."""
    if fit.cut_short or (before is not None and fit.best.key == before.best.key):
        return None
    kept = judged_centres(fit)
    if not fit.best.members and np.array_equal(kept, fit.linear.keep):
        return None
    displaced = displacements(fit.best)
    linear = relinearized(fit.linear, fit.best).restricted(kept)
    wide = with_discrepancy(linear, displaced, OPTIONS.discrepancy)
    return replace(compared(problem, wide, fit.none.point.theta, fit.best, alternatives=True), linear=linear)


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
    prior = SetPrior.of(problem.candidates, len(blocks.design_blocks.locations), problem.given.labels)
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
    """(M,) bool of the centres with which a search begins. Centres rejected before anything was known may show an effect. They take part if
    one effect alone makes all centres more probable than they are as outliers without an effect.
    """
    start = NoisePoint(problem.linear, problem.prior_noise, pack(problem.noise))
    plain = problem.linear.keep
    if plain.all():
        return plain
    everything, prior = start.restricted(np.ones(len(plain), dtype=bool)), SetPrior.of(problem.candidates, 1)
    scored = evidence_of_candidates(everything.projected, [c for c in problem.candidates if not c.several or c.hyper is None])
    tried = [(plain, log_with_outliers((), start, 0.0))]
    for _, member in sorted(scored, key=lambda one: -one[0])[: OPTIONS.beam]:
        members, log_prior = (member,), prior.log_probability(member.candidate, [])
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


def with_untried_rivals(problem: DiagnosisProblem, fit: EvidenceFit) -> EvidenceFit:
    """The fit with sets in which what was not tried stands in the place of every effect at its location, as probable beforehand as the
    effect of the catalogue that it stands for.
    """
    if not fit.significant:
        return fit
    rivals = untried(problem.context, problem.candidates)
    locations = len(problem.design_blocks.locations)
    prior, known = (SetPrior.of(problem.candidates, locations, problem.given.labels), {h.key: h for h in fit.hypotheses})
    for base in {h.key: h for h in (fit.best, reported_hypothesis(fit))}.values():
        for rival in rivals:
            instead = replaced(base, rival, prior)
            if instead is not None:
                known.setdefault(instead.key, instead)
    return replace(fit, hypotheses=tuple(sorted(known.values(), key=lambda h: -h.log_posterior)))


def replaced(base: Hypothesis, rival: UntriedEffect, prior: SetPrior) -> Hypothesis | None:
    """The set with the rival in the place of all that it has at that location; None if it has nothing there, or nothing but what the
    rival stands for or is.
    """
    rest = tuple(m for m in base.members if m.candidate.where != rival.candidate.where)
    here = {m.candidate.name for m in base.members if m.candidate.where == rival.candidate.where}
    if here <= {rival.name, UNKNOWN}:
        return None
    return estimated((*rest, Member(rival.candidate, None)), base.point, log_prior(rest, rival, prior))


def log_prior(rest: Sequence[Member], rival: UntriedEffect, prior: SetPrior) -> float:
    """Log posterior of the set with the effect that the rival stands for."""
    named = replace(rival.candidate, name=rival.name)
    return prior.log_probability_of_set([*(m.candidate for m in rest), named])


def stands_for_untried(problem: DiagnosisProblem, hypothesis: Hypothesis) -> list[UntriedEffect]:
    """The effects of a set that stand for what was not tried."""
    known = {rival.candidate.key: rival for rival in untried(problem.context, problem.candidates)}
    return [known[m.candidate.key] for m in hypothesis.members if m.candidate.name == UNKNOWN and m.candidate.key in known]


def solution(hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Nuisance parameters and coefficients together (z + k,), and the residual (M, R) that they leave."""
    columns, sigma, Z = _with_geometry(hypothesis)
    values = sigma * np.linalg.solve(Z.T @ Z + np.eye(len(sigma)), Z.T @ hypothesis.point.projected.r0)
    return values, hypothesis.point.linear.residual - columns @ values


def geometry_of(hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean (z,) and covariance (z, z) of stations and free geometry, effects integrated out; the last are given effects."""
    _, sigma, Z = _with_geometry(hypothesis)
    z = len(sigma) - len(prior_sigma(hypothesis.members))
    inverse = np.linalg.inv(Z.T @ Z + np.eye(len(sigma)))
    values = sigma * (inverse @ (Z.T @ hypothesis.point.projected.r0))
    return values[:z], (sigma[:, None] * inverse * sigma)[:z, :z]


def _with_geometry(hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (M, R, z + k) of stations, free geometry and effects, their prior sigma, and the same whitened, in units of sigma."""
    linear, members = hypothesis.point.linear, hypothesis.members
    columns, sigma = linear.nuisance()
    columns = np.concatenate([columns, *(candidate_columns(linear, m.candidate, m.hyper) for m in members)], axis=2)
    sigma = np.r_[sigma, prior_sigma(members)]
    return columns, sigma, hypothesis.point.projected.whiten(columns) * sigma


def relinearized(linear: LinearProblem, hypothesis: Hypothesis) -> LinearProblem:
    """Linearised anew with the effects in place: a fit without them had distorted the derivatives.

    linear: the problem of the hypothesis without the columns of its discrepancy.
    """
    members = hypothesis.members
    if not members:
        return linear
    effects = [term(m.candidate.name, candidate_parts(linear, m.candidate, m.hyper), sigma=m.size * m.candidate.typical) for m in members]
    return linear.adjusted(effects, hypothesis.point.noise)


def displacements(hypothesis: Hypothesis) -> list[np.ndarray]:
    """(M, R) of each effect, by the mean of its coefficients."""
    linear, found = hypothesis.point.linear, hypothesis.solved
    return [
        candidate_columns(linear, m.candidate, m.hyper) @ found.coefficients[p] for m, p in zip(found.members, found.slices(), strict=True)
    ]


def with_discrepancy(linear: LinearProblem, displaced: list[np.ndarray], share: float) -> LinearProblem:
    """Each effect is wrong, at each pose, by a share of what it displaces there: columns (M, R) as those of a joint's repeatability."""
    if not displaced:
        return linear
    extra = linear.rows.pad(share * np.stack(displaced, axis=2))
    return replace(linear, columns_by_pose=linear.columns_by_pose.with_noise(extra))
