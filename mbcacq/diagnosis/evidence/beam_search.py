"""Beam search over sets of effects by their posterior probability."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import ScoredEffect, evidence_of_candidates
from mbcacq.diagnosis.evidence.hypothesis import EffectPrior, Hypothesis, Member, estimated, first_order
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.options import OPTIONS
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.effects.effect import Candidate

MOST_ROUNDS = 12  # of the estimation of the noise without any effect


@dataclass
class BeamSearch:
    """The candidates of a recording, and every hypothesis that was estimated, by the keys of its effects."""

    candidates: list[Candidate]
    unmodelled: UnmodelledEffects | None
    prior: EffectPrior
    known: dict[tuple, Hypothesis] = field(default_factory=dict)

    def run(self, start: NoisePoint, begin: Hypothesis | None = None) -> list[Hypothesis]:
        """All hypotheses that were compared, the most probable first; the empty set is one of them.

        begin: a set, of another linearisation, from which the search goes on.
        """
        none = estimated((), start, 0.0, MOST_ROUNDS)
        self.known = {none.key: none}
        best, beam = none, [none]
        if begin is not None and begin.members:
            best = estimated(begin.members, replace(start, theta=begin.point.theta), begin.log_prior)
            self.known[best.key], beam = best, [best]
        for _ in range(OPTIONS.most_effects):
            beam = self.grown(beam)
            if not beam or beam[0].log_posterior <= best.log_posterior and best.members:
                break
            best = beam[0]
        self.exchange(best)
        return self.ranked()

    def ranked(self) -> list[Hypothesis]:
        return sorted(self.known.values(), key=lambda h: -h.log_posterior)

    def grown(self, beam: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The most probable sets with one effect more."""
        return self.compared([child for node in beam for child in self.extensions(node)])

    def compared(self, children: Iterable[Hypothesis]) -> list[Hypothesis]:
        """The most probable of hypotheses, each with its own noise, best first."""
        new: dict[tuple, Hypothesis] = {}
        for child in sorted(children, key=lambda h: -h.log_posterior):
            new.setdefault(child.key, child)
        out = []
        for child in list(new.values())[: OPTIONS.estimated]:
            if child.key not in self.known:
                self.known[child.key] = estimated(child.members, child.point, child.log_prior)
            out.append(self.known[child.key])
        return sorted(out, key=lambda h: -h.log_posterior)[: OPTIONS.beam]

    def extensions(self, node: Hypothesis) -> list[Hypothesis]:
        """A set with each of the candidates that are most probable beyond it."""
        present = [m.candidate for m in node.members]
        possible: list[tuple[float, Member]] = []
        for scored in evidence_of_candidates(node.conditioned, self.candidates):
            if self.allowed(scored.candidate, present):
                possible.append(self.weighted(scored, present))
        if self.unmodelled is not None:
            possible += [
                (log + self.prior.log_probability(m.candidate, present), m) for log, m in self.unmodelled.evidence(node.conditioned)
            ]
        possible.sort(key=lambda one: -one[0])
        out = []
        for _, member in possible[: OPTIONS.compared]:
            members = (*node.members, member)
            log_prior = self.prior.log_probability_of_set([m.candidate for m in members])
            out.append(first_order(members, node.point, log_prior))
        return out

    def weighted(self, scored: ScoredEffect, present: Sequence[Candidate]) -> tuple[float, Member]:
        return scored.log_evidence + self.prior.log_probability(scored.candidate, present), Member.of(scored)

    def allowed(self, candidate: Candidate, present: Sequence[Candidate]) -> bool:
        return candidate.several or not any(c.name == candidate.name and c.where == candidate.where for c in present)

    def exchange(self, best: Hypothesis) -> None:
        """Sets with another effect in the place of one of the best set's: what else it could be."""
        for j in range(len(best.members)):
            rest = best.members[:j] + best.members[j + 1 :]
            log_prior = self.prior.log_probability_of_set([m.candidate for m in rest])
            self.compared(self.extensions(first_order(rest, best.point, log_prior)))


def log_e_value(ranked: Sequence[Hypothesis]) -> float:
    """Log of the evidence of all sets with an effect together, against none."""
    none = next(h for h in ranked if not h.members)
    some = [h.log_posterior - none.log_posterior for h in ranked if h.members]
    return float(np.logaddexp.reduce(some)) if some else -np.inf
