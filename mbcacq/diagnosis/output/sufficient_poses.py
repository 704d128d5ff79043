"""Whether a recording could have shown the effects of the catalogue at their typical sizes, and how many poses like its own could.

Finding nothing means something only if something could have been found. Each effect is taken by itself here, with the found effects and the
geometry free. Its hyper-parameter has the value at which it is determined as at the median. The effect would then be found, though perhaps
with alternatives that cannot be told apart. ``exclusion_limits`` computes the reported limits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.next_measurements import Elsewhere, harmless
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.variance_components import first_noise

QUANTILE = 1.645  # of a standard normal variable: 95 % below
MOST_VALUES = 12  # of a hyper-parameter that are tried
ABSORBED = 1e-6  # information on a typical size below which the geometry absorbs the effect
ROUNDED = 1e-10  # share of an effect's information, or displacement, below which what is left of it is rounding
ENOUGH = 0.5  # share of the effects that a verdict ``none`` excludes at their typical size


def limited_effects(setup: DiagnosisProblem, full: ModelFit, there: Elsewhere) -> list[Member]:
    """Every candidate that was not found, at its limit, but for those that the geometry absorbs and that change no length."""
    found = {m.candidate.location for m in full.model.members}
    stated = CandidateScoring.of(full.geometry_only.linear, first_noise(setup.linear.obs.cell))
    missed = [c for c in of_fewest_coefficients(setup.possible) if (c.name, c.where) not in found]
    limited = [coefficient_limit(full.conditioned, c, stated) for c in missed]
    return [e for e in limited if np.isfinite(e.in_typical_sizes) or not harmless(there, e)]


def says_too_little(limited: Sequence[Member], poses: int) -> str | None:
    """A sentence where a recording of so many poses excludes too little for a verdict ``none``."""
    share = excluded_share(limited)
    if share >= ENOUGH:
        return None
    said = f"{share:.0%} of the effects of the catalogue are excluded at their typical size, less than half"
    enough = sufficient_poses(limited, poses)
    if enough > OPTIONS.most_poses:
        return f"{said}, and more poses like these would not exclude half of them: measure other postures"
    return f"{said}: {enough:.0f} poses like these, instead of {poses}, would exclude half of them"


def excluded_share(limited: Sequence[Member]) -> float:
    """Share of the effects whose exclusion limit is below their typical size; 1 where there is none."""
    return sum(w for w, e in zip(weights(limited), limited, strict=True) if e.in_typical_sizes <= 1.0) if limited else 1.0


def sufficient_poses(limited: Sequence[Member], poses: int) -> float:
    """Number of poses like the ``poses`` of the recording at which enough effects would be excluded; inf where no number is enough.

    Limits fall with 1 / sqrt(number of poses) where each further pose repeats one of the recording, and faster where it does not.
    """
    sizes = np.array([e.in_typical_sizes for e in limited])
    ranked = np.argsort(sizes, kind="stable")
    last = ranked[int(np.searchsorted(np.cumsum(weights(limited)[ranked]), ENOUGH - 1e-9))]
    return float(np.ceil(poses * max(sizes[last], 1.0) ** 2))


def weights(limited: Sequence[Member]) -> np.ndarray:
    """(E,) weights of the effects, with sum one. All kinds have equal weight, and so do all locations of a kind, as in the prior
    probability."""
    locations = Counter(e.candidate.name for e in limited)
    return np.array([1.0 / (len(locations) * locations[e.candidate.name]) for e in limited])


def of_fewest_coefficients(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The variants of each effect at a location that have fewest coefficients."""
    fewest: dict[tuple[str, tuple[str, ...]], int] = {}
    for c in candidates:
        fewest[c.name, c.where] = min(c.k, fewest.get((c.name, c.where), c.k))
    return [c for c in candidates if c.k == fewest[c.name, c.where]]


def coefficient_limit(conditioned: CandidateScoring, candidate: Candidate, stated: CandidateScoring | None = None) -> Member:
    """The largest coefficient that is not excluded, in typical sizes; all of them inf where the geometry absorbs one. stated: the problem
    under the noise as stated, by which the value of the hyper-parameter is chosen.
    """
    hyper = representative_value(stated or conditioned, candidate)
    estimate, std = estimated(conditioned, candidate, hyper)
    limits = (np.maximum(estimate, -std) if candidate.positive else np.abs(estimate)) + QUANTILE * std
    worst = np.arange(candidate.k) == int(np.argmax(limits / candidate.typical))
    return Member(candidate, hyper, coefficients=np.where(worst | ~np.isfinite(std), limits, 0.0))


def representative_value(projected: CandidateScoring, candidate: Candidate) -> float | None:
    """The value of the hyper-parameter whose information on the effect is the median of the values tried."""
    hyper = candidate.hyper
    if hyper is None:
        return None
    values = np.sort(hyper.values)
    tried = [v for v in hyper.preferred if v in values] or values[:: int(np.ceil(len(values) / MOST_VALUES))].tolist()
    order = np.argsort(largest_deviations(projected, candidate, tried), kind="stable")
    return float(tried[order[len(tried) // 2]])


def largest_deviations(projected: CandidateScoring, candidate: Candidate, values: Sequence[float]) -> np.ndarray:
    """(H,) of the standard deviations of an effect's coefficients the largest, in typical sizes, at each value of its hyper-parameter; inf
    where the geometry absorbs it.
    """
    if not candidate.components:
        return np.array([(estimated(projected, candidate, value)[1] / candidate.typical).max() for value in values])
    S, _ = projected.normal_matrices(candidate, np.array(values))
    value, vectors = np.linalg.eigh(S * np.outer(candidate.typical, candidate.typical))
    variance = (vectors**2 / np.maximum(value, ABSORBED)[:, None, :]).sum(axis=2)
    return np.where(value[:, 0] > ABSORBED, np.sqrt(variance.max(axis=1)), np.inf)


def estimated(conditioned: CandidateScoring, candidate: Candidate, hyper: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (k,) and their standard deviations, with everything else in place; inf where the geometry absorbs one of them."""
    X, S, b = conditioned.products_beside(candidate, hyper)
    size = np.sqrt(np.maximum(np.sum(X * X, axis=0), 1e-300))
    scaled = S / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < ROUNDED:
        return np.zeros(candidate.k), np.full(candidate.k, np.inf)
    covariance = np.linalg.inv(scaled) / np.outer(size, size)
    return covariance @ b, np.sqrt(np.diag(covariance))
