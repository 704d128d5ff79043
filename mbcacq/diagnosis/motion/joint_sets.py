"""Sets of effects of poses and of motion of one run together: evidences add, and a shared effect is in both or in neither.

1. A set of each evidence (poses, and every kind of mismatch of the motion) makes a joint set. Effects that were compared in several of
   them are in all of these or in none.
2. Its log posterior odds are the sum. An effect that is in several has one coefficient: half the squared distance of what they state of it,
   in combined standard deviations, is taken off. The prior of a shared effect counts in each evidence, so that odds are understated.
3. What neither decides alone, because another set is not excluded there, is decided where the joint sets exclude it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from mbcacq.diagnosis.options import OPTIONS

MOST_SETS = 12  # of each evidence: further ones are less probable than the best by far

Distance = Any  # (label, parameters, parameters) -> distance in combined standard deviations


@dataclass(frozen=True)
class EvidenceSets:
    """The sets of one evidence: log posterior odds, and the parameters by effect (``name:location``)."""

    log_odds: tuple[float, ...]
    effects: tuple[Mapping[str, Mapping[str, Any]], ...]

    @property
    def known(self) -> frozenset[str]:
        """The effects that were compared."""
        return frozenset(label for one in self.effects for label in one)


@dataclass(frozen=True)
class JointSet:
    """effects: labels; log_odds: natural logarithm of the posterior probability relative to the most probable joint set's."""

    effects: tuple[str, ...]
    log_odds: float


def joint_sets(evidences: Sequence[EvidenceSets], distance: Distance) -> tuple[JointSet, ...]:
    """All consistent joint sets, the most probable first; none if the evidences share no consistent one."""
    known = [one.known for one in evidences]
    shared = {label for i, one in enumerate(known) for label in one if any(label in other for other in known[:i])}
    chosen = [np.argsort(one.log_odds)[::-1][:MOST_SETS] for one in evidences]
    found: dict[frozenset[str], float] = {}
    for picks in product(*chosen):
        sets = [one.effects[i] for one, i in zip(evidences, picks, strict=True)]
        if any(len({label in s for s, k in zip(sets, known, strict=True) if label in k}) > 1 for label in shared):
            continue
        log = sum(one.log_odds[i] for one, i in zip(evidences, picks, strict=True)) - disagreement(sets, shared, distance)
        labels = frozenset(label for s in sets for label in s)
        found[labels] = float(np.logaddexp(found.get(labels, -np.inf), log))
    best = max(found.values(), default=0.0)
    ranked = sorted(found.items(), key=lambda item: -item[1])
    return tuple(JointSet(tuple(sorted(labels)), log - best) for labels, log in ranked)


def disagreement(sets: Sequence[Mapping[str, Mapping[str, Any]]], shared: set[str], distance: Distance) -> float:
    """Half the squared distance of the parameters that several sets state of one effect."""
    total = 0.0
    for label in shared:
        stated = [s[label] for s in sets if label in s]
        total += sum(0.5 * distance(label, one, other) ** 2 for i, one in enumerate(stated) for other in stated[:i])
    return total


def not_excluded(sets: Sequence[JointSet]) -> tuple[JointSet, ...]:
    """Joint sets, neither part nor extension of the most probable one, that have more than a twentieth of its probability."""
    if not sets:
        return ()
    best = set(sets[0].effects)
    least = float(np.log(OPTIONS.undecided))
    return tuple(s for s in sets[1:] if s.log_odds > least and not (best <= set(s.effects) or best >= set(s.effects)))
