"""An effect that shows only through another one, and that other one, solved together.

A wrong payload p, say, shows through the elastic joints: each gives way by c (tau + U p), its compliance times the torque of the declared
payload and of the error. That is linear in c for a given p, and linear in p for given c. Both are solved in turns at the point reached
(Gauss-Newton). The report is made from the last problem, written with the declared torque: there each coefficient of the coupled effect is
a parameter of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.declaration import EffectCoupling, Where
from mbcacq.effects.effect import Candidate


def couplings_of(members: Sequence[Member]) -> tuple[EffectCoupling, ...]:
    """The couplings of the effects of a set that show only through another one."""
    names = dict.fromkeys(m.candidate.name for m in members)
    return tuple(c for name in names if (c := catalogue.declaration(name).coupling) is not None)


def given_through(given: EffectSet, coupling: EffectCoupling) -> dict[Where, float]:
    """Location -> mean of the coefficient of the given effects through which a coupled one shows."""
    return {m.candidate.where: float(m.coefficients[0]) for m in given.with_coefficients if m.candidate.name == coupling.through}


def coupled(candidates: list[Candidate], context: Context, best: Hypothesis) -> Hypothesis:
    """The set whose coupled effects agree with those through which they show; the set itself if it has none.

    candidates: of the recording. The other effect is part of the set at every location at which it matters, significantly or not, so that
    the uncertainty of the coupled effect contains its uncertainty.
    """
    for coupling in couplings_of(best.members):
        best = _agreeing(candidates, context, best, coupling)
    return best


def _agreeing(candidates: list[Candidate], context: Context, best: Hypothesis, coupling: EffectCoupling) -> Hypothesis:
    there = {m.candidate.where for m in best.members if m.candidate.name == coupling.through}
    chosen = there | set(coupling.locations(context))
    carriers = [c for c in candidates if c.name == coupling.through and c.where in chosen]
    others = [m for m in best.members if m.candidate.name not in (coupling.name, coupling.through)]

    def together(*chosen: Candidate) -> Hypothesis:
        return replace(best, members=(*others, *(Member(c, None, size=OPTIONS.sizes[-1]) for c in chosen)))

    known = carried(together(*carriers), coupling)
    correction, covariance = np.zeros(coupling.size), None
    for number in range(OPTIONS.rounds):
        own = coupling.candidates(context, known, complete=True)[0]
        new = together(*(coupling.carrier(context, c, correction, str(number)) for c in carriers), own)
        found = new.solved
        step, covariance = found.coefficients[found.slices()[-1]], found.covariance[found.slices()[-1], found.slices()[-1]]
        correction = correction + step
        known = carried(new, coupling, found)
        if np.all(np.abs(step) < OPTIONS.steady * np.sqrt(np.diag(covariance))):
            break
    return together(*carriers, coupling.candidates(context, known, covariance, complete=True)[0])


def through(hypothesis: Hypothesis, coupling: EffectCoupling, solved: EffectSet) -> dict[Where, float]:
    """Location -> coefficient of each effect of a set through which a coupled one shows."""
    at = zip(hypothesis.members, solved.slices(), strict=True)
    return {m.candidate.where: float(solved.coefficients[p.start]) for m, p in at if m.candidate.name == coupling.through}


def carried(hypothesis: Hypothesis, coupling: EffectCoupling, known: EffectSet | None = None) -> Mapping[Where, float]:
    """Location -> coefficient of the effect through which a coupled one shows, to four digits; none below a share of the largest."""
    solved = known or hypothesis.solved
    found = through(hypothesis, coupling, solved)
    least = max(OPTIONS.undecided * max(found.values()), 1e-9)  # a loaded joint gives way: none is that much stiffer than another
    return {where: float(f"{max(value, least):.4g}") for where, value in found.items()}
