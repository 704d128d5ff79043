"""Which simple change of convention removes most of the misfit? Each is fitted cheaply, the best ones by the caller's own fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbcacq.description.hypotheses import Misreading, hypotheses
from mbcacq.description.plain_fit import residual_mm, subset
from mbcacq.model.observations import Observations

Fit = Callable[[Observations], float]

MOST = 0.3  # share of the misfit that may remain with the change: it removes most of it
SAME = 1.25  # factor within which two changes explain as much and cannot be told apart
LIKELIER = ("sign", "unit", "handedness", "orientation", "order", "offset", "coupling", "frame", "rows")  # of changes that fit equally well
SCREENED = 8  # changes of the smallest residual in a few steps that are fitted to the end
FITTED = 3  # best changes that the caller's fit is asked for
MOST_ALTERNATIVES = 3  # named in the text; a mirror of positions is any mirror
MOST_CHANGES = 2  # mistakes found one after the other


@dataclass(frozen=True)
class DescriptionFinding:
    """A change of convention that fits. what: in words, after 'with'; before_mm, after_mm: residual without and with it; alternatives:
    changes that fit as well; change: applies it."""

    what: str
    before_mm: float
    after_mm: float
    alternatives: tuple[str, ...]
    change: Callable[[Observations], Observations]

    def __str__(self) -> str:
        text = f"with {self.what} the residual falls from {_number(self.before_mm)} to {_number(self.after_mm)} mm"
        if not self.alternatives:
            return text
        more = len(self.alternatives) - MOST_ALTERNATIVES
        others = " or ".join(self.alternatives[:MOST_ALTERNATIVES])
        return f"{text} (the data cannot tell it from {others}{f' and {more} more' if more > 0 else ''})"


def wrong_descriptions(observations: Observations, fit: Fit | None = None) -> tuple[DescriptionFinding, ...]:
    """Changes of convention that remove most of the misfit, in the order of finding: each was sought with those before it made.

    fit: residual (mm) of the caller's own robust fit of the plain geometry, infinite or an exception of ValueError or RuntimeError kind
    where it fails; it judges the best few. None: the quick fit, with the arm as described, judges.
    """
    found: list[DescriptionFinding] = []
    current = observations
    for _ in range(MOST_CHANGES):
        finding = _best(current, fit)
        if finding is None:
            break
        found.append(finding)
        current = finding.change(current)
    return tuple(found)


def _best(observations: Observations, fit: Fit | None) -> DescriptionFinding | None:
    few = subset(observations)
    before = residual_mm(few)
    screened = sorted(((_score(observations, few, h, True), i, h) for i, h in enumerate(hypotheses(few))), key=lambda s: s[:2])
    scored = sorted(((_score(observations, few, h, False), i, h) for _, i, h in screened[:SCREENED]), key=lambda s: s[:2])
    near = [(score, h) for score, _, h in scored if score < MOST * before]
    if not near:
        return None
    best = near[0][0]
    near = sorted(((score, h) for score, h in near if score < SAME * best), key=lambda pair: LIKELIER.index(pair[1].kind))
    if fit is None:
        return _finding(near, before)
    own_before = _own(fit, observations)
    own = sorted(((_own(fit, h.change(observations)), i, h) for i, (_, h) in enumerate(near[:FITTED])), key=lambda s: s[:2])
    judged = [(score, h) for score, _, h in own if score < MOST * own_before]
    if not judged:
        return None
    same = [(s, h) for s, h in judged if s < SAME * judged[0][0]]
    return _finding(sorted(same, key=lambda pair: LIKELIER.index(pair[1].kind)), own_before)


def _finding(near: list[tuple[float, Misreading]], before: float) -> DescriptionFinding:
    score, best = near[0]
    return DescriptionFinding(best.what, before, score, tuple(h.what for _, h in near[1:]), best.change)


def _score(observations: Observations, few: Observations, hypothesis: Misreading, screening: bool) -> float:
    """Infinite where the change leaves nothing that can be fitted. few: the subset that is fitted; rows are moved before it is taken."""
    try:
        changed = subset(hypothesis.change(observations)) if hypothesis.kind == "rows" else hypothesis.change(few)
        return residual_mm(changed, screening)
    except (ValueError, np.linalg.LinAlgError):
        return float("inf")


def _own(fit: Fit, observations: Observations) -> float:
    try:
        return float(fit(observations))
    except (ValueError, RuntimeError, np.linalg.LinAlgError):
        return float("inf")


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 1e4 else f"{value:.0f}"
