"""Exclusion limits: the largest size of every effect at every location that a recording does not exclude, with 95 % confidence.

A coefficient c is estimated as c^ with standard deviation s, the found effects and the geometry fitted with it. |c| is below |c^| + 1.645 s
in 95 % of recordings, whatever it is. An effect of known sign is below c^ + 1.645 s, where an estimate below -s counts as -s, so that noise
never excludes what the recording could not show (power-constrained limits: Cowan, Cranmer, Gross, Vitells 2011, arXiv:1105.3166).
Of several coefficients the largest limit, in typical sizes, is that of the effect. Of the values of a hyper-parameter it is the one where
the effect is determined as at the median under the noise as stated: a change just where the station changes can always hide, and a choice
by the recording would hide an effect at one value among all others.

That nothing was found means something only where something could have been: the limits decide whether that is said.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.next_measurements import Elsewhere, SizedEffect
from mbcacq.diagnosis.output.noise_floor import NOT_SIZES
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import ExclusionLimit
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.variance_components import first_noise

QUANTILE = 1.645  # of a standard normal variable: 95 % below
MOST_VALUES = 12  # of a hyper-parameter that are tried
ROUNDED = 1e-10  # share of an effect's information, or displacement, below which what is left of it is rounding
ENOUGH = 0.5  # share of the effects that a verdict ``none`` excludes at their typical size


def limited_effects(setup: DiagnosisProblem, full: ModelFit, there: Elsewhere) -> list[SizedEffect]:
    """Every candidate that was not found, at its limit, but for those that the geometry absorbs and that change no length."""
    found = {(c.name, c.where) for c, _ in full.model.effects}
    stated = CandidateScoring.of(full.geometry_only.linear, first_noise(setup.linear.obs.cell))
    missed = [c for c in of_fewest_coefficients(setup.candidates) if (c.name, c.where) not in found]
    limited = [coefficient_limit(full.conditioned, c, stated) for c in missed]
    return [e for e in limited if np.isfinite(e.in_typical_sizes) or not harmless(there, e)]


def exclusion_limits(limited: Sequence[SizedEffect], there: Elsewhere) -> tuple[ExclusionLimit, ...]:
    """As they are reported, those with the largest error in the workspace first; what the geometry absorbs before all others."""
    out = (ExclusionLimit(e.candidate.name, e.candidate.where, *parameter_of(e), *errors_elsewhere(there, e), usual(e)) for e in limited)
    return tuple(sorted(out, key=lambda e: -np.inf if e.value is None else -(e.workspace_mm or 0.0)))


def usual(effect: SizedEffect) -> float | None:
    """The limit in typical sizes of the effect; None where the geometry absorbs it."""
    return effect.in_typical_sizes if np.isfinite(effect.in_typical_sizes) else None


def says_too_little(limited: Sequence[SizedEffect], poses: int) -> str | None:
    """A sentence where a recording of so many poses excludes too little for a verdict ``none``."""
    share = excluded_share(limited)
    if share >= ENOUGH:
        return None
    said = f"of the effects of the catalogue {share:.0%} are excluded at their typical size, less than half"
    enough = sufficient_poses(limited, poses)
    if enough > OPTIONS.most_poses:
        return f"{said}, and more poses like these would not exclude half of them: measure other postures"
    return f"{said}: {enough:.0f} poses like these, instead of {poses}, would exclude half of them"


def excluded_share(limited: Sequence[SizedEffect]) -> float:
    """Share of the effects whose exclusion limit is below their typical size; 1 where there is none."""
    return sum(w for w, e in zip(weights(limited), limited, strict=True) if e.in_typical_sizes <= 1.0) if limited else 1.0


def sufficient_poses(limited: Sequence[SizedEffect], poses: int) -> float:
    """Number of poses like the ``poses`` of the recording at which enough effects would be excluded; inf where no number is enough.

    Limits fall with 1 / sqrt(number of poses) where each further pose repeats one of the recording, and faster where it does not.
    """
    sizes = np.array([e.in_typical_sizes for e in limited])
    ranked = np.argsort(sizes, kind="stable")
    last = ranked[int(np.searchsorted(np.cumsum(weights(limited)[ranked]), ENOUGH - 1e-9))]
    return float(np.ceil(poses * max(sizes[last], 1.0) ** 2))


def weights(limited: Sequence[SizedEffect]) -> np.ndarray:
    """(E,) of each effect, of sum one: every kind counts alike, every location of a kind too, as in their prior probability."""
    locations = Counter(e.candidate.name for e in limited)
    return np.array([1.0 / (len(locations) * locations[e.candidate.name]) for e in limited])


def of_fewest_coefficients(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Of several variants of an effect at a location, those of fewest coefficients."""
    fewest: dict[tuple[str, tuple[str, ...]], int] = {}
    for c in candidates:
        fewest[c.name, c.where] = min(c.k, fewest.get((c.name, c.where), c.k))
    return [c for c in candidates if c.k == fewest[c.name, c.where]]


def coefficient_limit(conditioned: CandidateScoring, candidate: Candidate, stated: CandidateScoring | None = None) -> SizedEffect:
    """The largest coefficient that is not excluded, in typical sizes; all of them inf where the geometry absorbs one. stated: the problem
    under the noise as stated, by which the value of the hyper-parameter is chosen.
    """
    hyper = representative_value(stated or conditioned, candidate)
    estimate, std = estimated(conditioned, candidate, hyper)
    limits = (np.maximum(estimate, -std) if candidate.positive else np.abs(estimate)) + QUANTILE * std
    worst = np.arange(candidate.k) == int(np.argmax(limits / candidate.typical))
    return SizedEffect(candidate, hyper, np.where(worst | ~np.isfinite(std), limits, 0.0))


def representative_value(projected: CandidateScoring, candidate: Candidate) -> float | None:
    """The value of the hyper-parameter at which the effect is determined as at the median of those that are tried."""
    hyper = candidate.hyper
    if hyper is None:
        return None
    values = np.sort(hyper.values)
    tried = [v for v in hyper.preferred if v in values] or values[:: int(np.ceil(len(values) / MOST_VALUES))].tolist()
    tried.sort(key=lambda value: float((estimated(projected, candidate, value)[1] / candidate.typical).max()))
    return float(tried[len(tried) // 2])


def estimated(conditioned: CandidateScoring, candidate: Candidate, hyper: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (k,) and their standard deviations, with everything else in place; inf where the geometry absorbs one of them."""
    X, S, b = conditioned.candidate_products(candidate, hyper)
    absorbed = conditioned.conditioned.T @ X
    S, b = S - absorbed.T @ absorbed, b - absorbed.T @ conditioned.along
    size = np.sqrt(np.maximum(np.sum(X * X, axis=0), 1e-300))
    scaled = S / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < ROUNDED:
        return np.zeros(candidate.k), np.full(candidate.k, np.inf)
    covariance = np.linalg.inv(scaled) / np.outer(size, size)
    return covariance @ b, np.sqrt(np.diag(covariance))


def parameter_of(effect: SizedEffect) -> tuple[str, float | None]:
    """Name, with its unit, and value of the parameter that is limited; None where the geometry absorbs it."""
    candidate, nothing = effect.candidate, np.zeros((effect.candidate.k, effect.candidate.k))
    if not np.isfinite(effect.in_typical_sizes):
        return next(iter(candidate.report(candidate.typical, nothing, effect.hyper))), None
    reported = candidate.report(effect.coefficients, nothing, effect.hyper)
    sizes = {name: float(np.abs(p.value).max()) for name, p in reported.items() if name.rpartition(".")[2] not in NOT_SIZES}
    return max(sizes.items(), key=lambda item: item[1] > 0)


def harmless(there: Elsewhere, effect: SizedEffect) -> bool:
    """Whether an effect displaces everything alike, as a constant sag does: no length shows it, nor suffers from it."""
    workspace, length = errors_elsewhere(there, replace(effect, coefficients=effect.candidate.typical))
    return workspace is not None and length is not None and length < ROUNDED * workspace


def errors_elsewhere(there: Elsewhere, effect: SizedEffect) -> tuple[float | None, float | None]:
    """Largest displacement (mm) over postures in the workspace, and the error of lengths between pairs of them that 95 % do not exceed.

    None for what the geometry absorbs, for effects over time, which no posture has, and for single balls or stations.
    """
    moved = there.displacement(effect) if np.isfinite(effect.in_typical_sizes) else None
    if moved is None or not np.any(moved):
        return None, None
    linear = there.linear
    T = linear.prediction.T_base_scanner if there.context.scanner_on_flange else linear.prediction.T_base_station
    in_base = np.einsum("pij,pj->pi", T[:, :3, :3], moved)
    position = linear.prediction.T_base_scanner[:, :3, 3]
    first, second = np.random.default_rng(0).integers(0, len(position), (2, len(position)))
    apart = position[first] - position[second]
    along = apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
    length = np.abs(np.sum((in_base[first] - in_base[second]) * along, axis=1))
    return float(np.linalg.norm(moved, axis=1).max()), float(np.quantile(length, 0.95))
