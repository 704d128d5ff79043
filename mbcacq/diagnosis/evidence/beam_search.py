"""Beam search over sets of effects by their posterior probability."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import ScoredEffect, evidence_of_candidates, evidence_of_one
from mbcacq.diagnosis.evidence.coefficients import coefficients
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, Member, SetPrior, conditioned, estimated, first_order
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.options import OPTIONS
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.effects.pose import payload

MOST_ROUNDS = 12  # of the estimation of the noise without any effect


@dataclass
class EvidenceSearch:
    """The candidates of a recording, and every hypothesis that was estimated, by the keys of its effects."""

    candidates: list[Candidate]
    unmodelled: UnmodelledEffects | None
    prior: SetPrior
    context: Context | None = None
    beam: int = OPTIONS.beam
    estimated: int = OPTIONS.estimated
    known: dict[tuple, Hypothesis] = field(default_factory=dict)

    def run(self, start: NoisePoint, begin: Hypothesis | None = None) -> list[Hypothesis]:
        """All hypotheses that were compared, the most probable first; the empty set is one of them.

        begin: a set, of another linearisation, from which the search goes on. What else an effect could be is asked by ``exchange``.
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
        return self.ranked()

    def ranked(self) -> list[Hypothesis]:
        return sorted(self.known.values(), key=lambda h: -h.log_posterior)

    def grown(self, beam: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The most probable sets with one effect more. What extends each is proposed under the noise of the most probable one."""
        proposing = [conditioned(beam[0].point, node.members) for node in beam]
        return self.compared([child for node, here in zip(beam, proposing, strict=True) for child in self.extensions(node, here)])

    def compared(self, children: Iterable[Hypothesis]) -> list[Hypothesis]:
        """The most probable of hypotheses, best first, each with its own noise where that can make it matter."""
        new: dict[tuple, Hypothesis] = {}
        for child in sorted(children, key=lambda h: -h.log_posterior):
            new.setdefault(child.key, child)
        least = max(h.log_posterior for h in self.known.values()) - OPTIONS.reach
        out = []
        for child in list(new.values())[: self.estimated]:
            if child.key not in self.known:
                near = child.log_posterior > least
                self.known[child.key] = estimated(child.members, child.point, child.log_prior) if near else child
            out.append(self.known[child.key])
        return sorted(out, key=lambda h: -h.log_posterior)[: self.beam]

    def extensions(
        self, node: Hypothesis, projected: CandidateScoring, catalogued: int = OPTIONS.compared, unmodelled: int = OPTIONS.compared
    ) -> list[Hypothesis]:
        """A set with each of the candidates that are most probable beyond it: at most so many of the catalogue, and unmodelled ones.

        projected: the problem with the set in place, under the noise by which candidates are proposed.
        """
        present = [m.candidate for m in node.members]
        possible = [
            self.weighted(scored, present)
            for scored in evidence_of_candidates(projected, self.candidates)
            if self.allowed(scored.candidate, present)
        ]
        for candidate in self.dependent(node):
            if not any(c.name == candidate.name for c in present):
                possible.append(self.weighted(evidence_of_one(projected, candidate), present))
        others: list[tuple[float, Member]] = []
        if self.unmodelled is not None:
            found = self.unmodelled.evidence(projected)
            others = [(log + self.prior.log_probability(m.candidate, present), m) for log, m in found]
        chosen = sorted(possible, key=lambda one: -one[0])[:catalogued] + others[:unmodelled]
        out = []
        for _, member in sorted(chosen, key=lambda one: -one[0])[: OPTIONS.compared]:
            members = (*node.members, member)
            log_prior = self.prior.log_probability_of_set([m.candidate for m in members])
            out.append(first_order(members, node.point, log_prior))
        return out

    def dependent(self, node: Hypothesis) -> list[Candidate]:
        """Candidates that depend on the coefficients of a set: a wrong payload shows through elastic joints."""
        if self.context is None or not any(m.candidate.name == "joint_compliance" for m in node.members):
            return []
        found = coefficients(node)
        elastic = {
            int(m.candidate.where[0][1:]) - 1: float(f"{found.mean[p.start]:.2g}")
            for m, p in zip(node.members, found.slices, strict=True)
            if m.candidate.name == "joint_compliance"
        }
        return payload.correction_for(self.context, elastic)

    def weighted(self, scored: ScoredEffect, present: Sequence[Candidate]) -> tuple[float, Member]:
        return scored.log_evidence + self.prior.log_probability(scored.candidate, present), Member.of(scored)

    def allowed(self, candidate: Candidate, present: Sequence[Candidate]) -> bool:
        return candidate.several or not any(c.name == candidate.name and c.where == candidate.where for c in present)

    def exchange(self) -> list[Hypothesis]:
        """All hypotheses, with sets that have another effect in the place of one of the best set's: what else it could be."""
        best = next((h for h in self.ranked() if h.members), self.known[()])
        for j in range(len(best.members)):
            rest = best.members[:j] + best.members[j + 1 :]
            log_prior = self.prior.log_probability_of_set([m.candidate for m in rest])
            node = first_order(rest, best.point, log_prior)
            self.known.setdefault(node.key, node)
            for other in self.extensions(node, node.conditioned, OPTIONS.rivals, OPTIONS.unmodelled_rivals):
                if other.key not in self.known:
                    near = other.log_posterior > best.log_posterior - OPTIONS.reach
                    self.known[other.key] = estimated(other.members, other.point, other.log_prior) if near else other
        return self.ranked()


def log_e_value(ranked: Sequence[Hypothesis]) -> float:
    """Log of the evidence of all sets with an effect together, against none."""
    none = next(h for h in ranked if not h.members)
    some = [h.log_posterior - none.log_posterior for h in ranked if h.members]
    return float(np.logaddexp.reduce(some)) if some else -np.inf
