"""Exclusion limits: the largest size of every effect at every location that a recording does not exclude, with 95 % confidence.

A coefficient c is estimated as c^ with standard deviation s, the found effects and the geometry fitted with it. |c| is below |c^| + 1.645 s
in 95 % of recordings, whatever it is. An effect of known sign is below c^ + 1.645 s, where an estimate below -s counts as -s, so that noise
never excludes what the recording could not show (power-constrained limits: Cowan, Cranmer, Gross, Vitells 2011, arXiv:1105.3166).
Of several coefficients the largest limit, in typical sizes, is that of the effect. Of the values of a hyper-parameter it is the one where
the effect is determined as at the median under the noise as stated: a change just where the station changes can always hide, and a choice
by the recording would hide an effect at one value among all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.output.next_measurements import Elsewhere
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import ExclusionLimit
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.variance_components import first_noise

QUANTILE = 1.645  # of a standard normal variable: 95 % below
LOWEST = -1.0  # estimate of an effect of known sign, in standard deviations, below which it counts as that
MOST_VALUES = 12  # of a hyper-parameter that are tried
ABSORBED = 1e-10  # share of an effect's information below which the geometry absorbs it: it has no limit
HARMLESS_MM = 1e-6  # error of a length by an effect of typical size
LENGTH_PAIRS = 400  # pairs of postures between which a length is measured
NOT_SIZES = ("order", "phase_deg", "at_pose", "time_constant_s", "transition_Nm", "breakpoint_Nm", "zero_deg")


@dataclass(frozen=True)
class CoefficientLimit:
    """hyper: value at which the limit is the median. coefficients (k,): of the effect at its limit; inf where the geometry absorbs it."""

    hyper: float | None
    coefficients: np.ndarray


@dataclass(frozen=True)
class LimitedEffect:
    """A candidate with the largest coefficients that the recording does not exclude."""

    candidate: Candidate
    limit: CoefficientLimit

    @property
    def finite(self) -> bool:
        """Whether the geometry leaves something of the effect."""
        return bool(np.all(np.isfinite(self.limit.coefficients)))

    @property
    def in_typical_sizes(self) -> float:
        """The limit, of several coefficients the largest; inf where the geometry absorbs the effect."""
        return float((self.limit.coefficients / self.candidate.typical).max()) if self.finite else np.inf


def limited_effects(setup: DiagnosisProblem, full: ModelFit, there: Elsewhere) -> list[LimitedEffect]:
    """Of every candidate that was not found, but for those that the geometry absorbs and that change no length."""
    found = {(c.name, c.where) for c, _ in full.model.effects}
    stated = CandidateScoring.of(full.geometry_only.linear, first_noise(setup.linear.obs.cell))
    missed = [c for c in of_fewest_coefficients(setup.candidates) if (c.name, c.where) not in found]
    limited = [LimitedEffect(c, coefficient_limit(full.conditioned, c, stated)) for c in missed]
    return [e for e in limited if e.finite or not harmless(there, e.candidate, e.limit.hyper)]


def exclusion_limits(limited: Sequence[LimitedEffect], there: Elsewhere) -> tuple[ExclusionLimit, ...]:
    """As they are reported, those with the largest error in the workspace first; what the geometry absorbs before all others."""
    out = []
    for effect in limited:
        name, value = parameter_of(effect.candidate, effect.limit)
        workspace, length = errors_elsewhere(there, effect.candidate, effect.limit)
        out.append(ExclusionLimit(effect.candidate.name, effect.candidate.where, name, value, workspace, length))
    return tuple(sorted(out, key=lambda e: -np.inf if e.value is None else -(e.workspace_mm or 0.0)))


def of_fewest_coefficients(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Of several variants of an effect at a location, those of fewest coefficients."""
    fewest: dict[tuple[str, tuple[str, ...]], int] = {}
    for c in candidates:
        fewest[c.name, c.where] = min(c.k, fewest.get((c.name, c.where), c.k))
    return [c for c in candidates if c.k == fewest[c.name, c.where]]


def coefficient_limit(conditioned: CandidateScoring, candidate: Candidate, stated: CandidateScoring | None = None) -> CoefficientLimit:
    """The largest coefficient that is not excluded, in typical sizes. stated: the problem under the noise as stated, by which the value of
    the hyper-parameter is chosen.
    """
    hyper = representative_value(stated or conditioned, candidate)
    estimate, std = estimated(conditioned, candidate, hyper)
    limits = upper_limits(estimate, std, candidate.positive)
    worst = np.arange(candidate.k) == int(np.argmax(limits / candidate.typical))
    return CoefficientLimit(hyper, np.where(worst, limits, 0.0) if np.all(np.isfinite(std)) else limits)


def upper_limits(estimate: np.ndarray, std: np.ndarray, positive: bool) -> np.ndarray:
    """(k,) what the size of each coefficient does not exceed in 95 % of recordings."""
    return (np.maximum(estimate, LOWEST * std) if positive else np.abs(estimate)) + QUANTILE * std


def representative_value(projected: CandidateScoring, candidate: Candidate) -> float | None:
    """The value of the hyper-parameter at which the effect is determined as at the median of those that are tried."""
    if candidate.hyper is None:
        return None
    values = tried_values(candidate)
    values.sort(key=lambda hyper: float((estimated(projected, candidate, hyper)[1] / candidate.typical).max()))
    return values[len(values) // 2]


def estimated(conditioned: CandidateScoring, candidate: Candidate, hyper: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (k,) and their standard deviations, with everything else in place; inf where the geometry absorbs one of them."""
    X, S, b = conditioned.candidate_products(candidate, hyper)
    absorbed = conditioned.conditioned.T @ X
    S, b = S - absorbed.T @ absorbed, b - absorbed.T @ conditioned.along
    size = np.sqrt(np.maximum(np.sum(X * X, axis=0), 1e-300))
    scaled = S / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < ABSORBED:
        return np.zeros(candidate.k), np.full(candidate.k, np.inf)
    covariance = np.linalg.inv(scaled) / np.outer(size, size)
    return covariance @ b, np.sqrt(np.diag(covariance))


def tried_values(candidate: Candidate) -> list[float | None]:
    """Values of the hyper-parameter at which an effect can show."""
    hyper = candidate.hyper
    if hyper is None:
        return [None]
    if hyper.preferred:
        return [float(v) for v in hyper.preferred if v in hyper.values]
    values = np.sort(hyper.values)
    return [float(v) for v in values[:: int(np.ceil(len(values) / MOST_VALUES))]]


def parameter_of(candidate: Candidate, limit: CoefficientLimit) -> tuple[str, float | None]:
    """Name, with its unit, and value of the parameter that is limited; None where the geometry absorbs it."""
    if not np.all(np.isfinite(limit.coefficients)):
        return next(iter(candidate.report(candidate.typical, np.eye(candidate.k), limit.hyper))), None
    reported = candidate.report(limit.coefficients, np.zeros((candidate.k, candidate.k)), limit.hyper)
    sizes = {name: float(np.abs(p.value).max()) for name, p in reported.items() if name.rpartition(".")[2] not in NOT_SIZES}
    return max(sizes.items(), key=lambda item: item[1] > 0)


def harmless(there: Elsewhere, candidate: Candidate, hyper: float | None) -> bool:
    """Whether an effect displaces everything alike, as a constant sag does: no length shows it, nor suffers from it."""
    _, length = errors_elsewhere(there, candidate, CoefficientLimit(hyper, candidate.typical))
    return length is not None and length < HARMLESS_MM


def errors_elsewhere(there: Elsewhere, candidate: Candidate, limit: CoefficientLimit) -> tuple[float | None, float | None]:
    """Largest displacement (mm) over postures in the workspace, and the error of lengths between pairs of them that 95 % do not exceed.

    None for what the geometry absorbs, for effects over time, which no posture has, and for single balls or stations.
    """
    if not np.all(np.isfinite(limit.coefficients)):
        return None, None
    moved = there.displacement(candidate.key, limit.hyper, limit.coefficients)
    if moved is None or not np.any(moved):
        return None, None
    linear = there.linear
    T = linear.prediction.T_base_scanner if there.context.scanner_on_flange else linear.prediction.T_base_station
    in_base = np.einsum("pij,pj->pi", T[:, :3, :3], moved)
    position = linear.prediction.T_base_scanner[:, :3, 3]
    first, second = np.random.default_rng(0).integers(0, len(position), (2, LENGTH_PAIRS))
    apart = position[first] - position[second]
    along = apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
    length = np.abs(np.sum((in_base[first] - in_base[second]) * along, axis=1))
    return float(np.linalg.norm(moved, axis=1).max()), float(np.quantile(length, 0.95))
