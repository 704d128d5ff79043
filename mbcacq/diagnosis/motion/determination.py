"""Is an effect determined by the data? A value at the end of what was tried is no estimate."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.search.effect_set import Member

BOUND = 1e-6  # relative distance from the first or last value tried within which a hyper-parameter is at that bound


def at_bound(member: Member) -> bool:
    """The reported hyper-parameter is at the first or last value that was tried."""
    tried, hyper = member.candidate.hyper, member.hyper
    if tried is None or not tried.name or hyper is None:
        return False
    first, last = float(np.min(tried.values)), float(np.max(tried.values))
    return hyper >= last * (1.0 - BOUND) or (not tried.from_none and hyper <= first * (1.0 + BOUND))


def canonical_correlation(spread: np.ndarray, own: list[int], other: list[int]) -> float:
    """Largest canonical correlation between two sets of coefficients with covariance ``spread``."""
    one, two = (_whitener(spread[np.ix_(at, at)]) for at in (own, other))
    return float(np.clip(np.linalg.svd(one @ spread[np.ix_(own, other)] @ two.T, compute_uv=False)[0], 0.0, 1.0))


def _whitener(v: np.ndarray) -> np.ndarray:
    d = 1.0 / np.sqrt(np.maximum(np.diag(v), 1e-300))
    values, vectors = np.linalg.eigh(v * np.outer(d, d))
    good = values > 1e-8
    return (vectors[:, good] / np.sqrt(values[good])).T * d
