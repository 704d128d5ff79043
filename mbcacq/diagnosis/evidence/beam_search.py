"""Beam search over sets of effects by their posterior probability."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import ScoredEffect, evidence_of_candidates, evidence_of_one, scanned_candidate
from mbcacq.diagnosis.evidence.coefficients import coefficients
from mbcacq.diagnosis.evidence.coupled_effects import couplings_of
from mbcacq.diagnosis.evidence.hypothesis import (
    UNMODELLED,
    Hypothesis,
    Member,
    SetPrior,
    conditioned,
    estimated,
    first_order,
    key_of,
    under,
)
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.declaration import EffectCoupling
from mbcacq.effects.effect import Candidate

LEAST_LOG_E_VALUE = float(np.log(OPTIONS.least_e_value))  # above which there is an effect, at any look at a recording that grows


@dataclass
class EvidenceSearch:
    """The candidates of a recording, and every hypothesis that was estimated, by the keys of its effects.

    alternatives: whether sets with another effect in the place of one of the best set's are compared as well. narrow: one set is followed
    instead of a beam. staged: so, and first the effects that every arm has (elastic joints), so that what they explain is not given to slow
    periodic errors, then the rest of the catalogue, and no unmodelled ones.
    """

    candidates: list[Candidate]
    unmodelled: UnmodelledEffects
    prior: SetPrior
    context: Context
    alternatives: bool = False
    narrow: bool = False
    staged: bool = False
    known: dict[tuple, Hypothesis] = field(default_factory=dict)

    def run(self, start: NoisePoint, begin: Hypothesis | None = None) -> list[Hypothesis]:
        """All hypotheses that were compared, the most probable first; the empty set is one of them.

        begin: a set, of another linearisation, from which the search goes on.
        """
        best = estimated((), start, 0.0)
        self.known = {best.key: best}
        if begin is not None and begin.members:
            best = estimated(begin.members, replace(start, theta=begin.point.theta), self.log_prior(begin.members))
            self.known[best.key] = best
            best = self.relieved(best)
        if self.staged:
            self.climbed(best, [c for c in self.candidates if catalogue.declaration(c.name).every_arm])
            best = self.ranked()[0]
        best = self.climbed(best, self.candidates)
        passes = 1 if self.staged else OPTIONS.passes
        for _ in range(passes if self.alternatives else 0):
            self.exchange(best)
            if self.ranked()[0].key == best.key:
                break
            best = self.ranked()[0]  # what stands in for an effect of it is asked as well
        return self.ranked()

    def climbed(self, best: Hypothesis, candidates: list[Candidate]) -> Hypothesis:
        """The most probable set that is reached from one by further effects.

        Two effects may be hardly more probable than none where each is taken alone, and far more so together: the elasticity of two joints
        that share their load, say. So a beam whose best set is not excluded goes on by one more effect.
        """
        beam, ahead = [best], False
        while len(beam[0].members) < OPTIONS.most_effects:
            beam = self.grown(beam, candidates)
            if not beam:
                break
            if beam[0].log_posterior <= best.log_posterior and best.members:
                near = beam[0].log_posterior > best.log_posterior + np.log(OPTIONS.undecided)
                if ahead or not near or self.narrow or self.staged:
                    break
                ahead = True
                continue
            best = beam[0] = self.enriched(self.relieved(self.polished(beam[0])))
            ahead = False
        return best

    def ranked(self) -> list[Hypothesis]:
        return sorted(self.known.values(), key=lambda h: -h.log_posterior)

    def grown(self, beam: Sequence[Hypothesis], candidates: list[Candidate]) -> list[Hypothesis]:
        """The most probable sets with one effect more, best first.

        Sets are proposed under the noise of the best one of the beam; those that may matter get a noise of their own.
        """
        point, proposed = beam[0].point, list[tuple[float, tuple[Member, ...]]]()
        width, most = (1, 2) if self.narrow or self.staged else (OPTIONS.beam, OPTIONS.estimated)
        least = max(h.log_posterior for h in self.known.values()) - OPTIONS.reach
        for node in beam:
            there = under(point, node.members, node.log_prior)
            further = self.extensions(there, candidates, least - there.log_posterior)
            proposed += [(there.log_posterior + log, (*node.members, member)) for log, member in further]
        new: dict[tuple, Hypothesis] = {}
        for log, members in sorted(proposed, key=lambda one: -one[0]):
            key = key_of(members)
            if log > least and key not in new and len(new) < most:
                new[key] = self.known.get(key) or estimated(members, point, self.log_prior(members))
        self.known.update(new)
        ranked = sorted(new.values(), key=lambda h: -h.log_posterior)[:width]
        return [h for h in ranked if h.log_posterior > ranked[0].log_posterior - OPTIONS.reach]

    def log_prior(self, members: Sequence[Member]) -> float:
        return self.prior.log_probability_of_set([m.candidate for m in members])

    def extensions(self, node: Hypothesis, candidates: list[Candidate], least: float = -np.inf) -> list[tuple[float, Member]]:
        """The effects that may be beyond a set, and their log posterior odds, most probable first. least: log posterior odds below which an
        unmodelled effect does not matter.
        """
        present = [m.candidate for m in node.members]
        possible = [
            self.weighted(scored, present)
            for scored in evidence_of_candidates(node.conditioned, candidates)
            if self.allowed(scored.candidate, present)
        ]
        for candidate in self.dependent(node):
            if not any(c.name == candidate.name for c in present):
                possible.append(self.weighted(evidence_of_one(node.conditioned, candidate), present))
        if not self.staged:
            found = self.unmodelled.evidence(node.conditioned, least)
            possible += [(log + self.prior.log_probability(m.candidate, present), m) for log, m in found]
        return sorted(possible, key=lambda one: -one[0])

    def dependent(self, node: Hypothesis) -> list[Candidate]:
        """Candidates that depend on the coefficients of a set: a wrong payload, say, shows through elastic joints."""
        names = {m.candidate.name for m in node.members}
        possible = [c for c in catalogue.couplings() if c.through in names]
        if not possible:
            return []
        found, out = coefficients(node), list[Candidate]()
        for coupling in possible:
            there = {
                m.candidate.where: float(f"{found.mean[p.start]:.2g}")
                for m, p in zip(node.members, found.slices, strict=True)
                if m.candidate.name == coupling.through
            }
            out += coupling.candidates(self.context, there)
        return out

    def weighted(self, scored: ScoredEffect, present: Sequence[Candidate]) -> tuple[float, Member]:
        return scored.log_evidence + self.prior.log_probability(scored.candidate, present), Member.of(scored)

    def allowed(self, candidate: Candidate, present: Sequence[Candidate]) -> bool:
        if candidate.several:
            return candidate.hyper is not None or not any(c.key == candidate.key for c in present)
        return not any(c.name == candidate.name and c.where == candidate.where for c in present)

    def polished(self, best: Hypothesis) -> Hypothesis:
        """A set whose last effect is a further order of a gear, or a further breakpoint, with all of these looked for anew beside each
        other, and left out where they add nothing: the first were found while the others still disturbed.
        """
        members, point, key = best.members, best.point, best.members[-1].candidate.key
        if not members[-1].candidate.components or sum(m.candidate.key == key for m in members) < 2:
            return best
        for _ in range(OPTIONS.rounds):
            before = [m.key for m in members]
            for j in reversed([j for j, m in enumerate(members) if m.candidate.key == key]):
                rest = members[:j] + members[j + 1 :]
                log, again = self.weighted(scanned_candidate(conditioned(point, rest), members[j].candidate), [m.candidate for m in rest])
                members = rest if log < 0 else (*members[:j], again, *members[j + 1 :])
            if [m.key for m in members] == before:
                break
        found = self.known.get(key_of(members)) or estimated(members, point, self.log_prior(members))
        self.known[found.key] = found
        return max(best, found, key=lambda h: h.log_posterior)

    def relieved(self, best: Hypothesis) -> Hypothesis:
        """A set with a coupled effect, or the one with the other effect at further locations in its place if that is more probable.

        A wrong payload shows through all elastic joints, so it may stand for no more than their elasticity. Every arm is elastic, so
        that is no less probable beforehand than a wrong payload.
        """
        for coupling in couplings_of(best.members):
            best = self.relieved_of(best, coupling)
        return best

    def relieved_of(self, best: Hypothesis, coupling: EffectCoupling) -> Hypothesis:
        rest = tuple(m for m in best.members if m.candidate.name != coupling.name)
        where = set(coupling.locations(self.context))
        carriers = [c for c in self.candidates if c.name == coupling.through and c.where in where]
        while True:
            present, node = [m.candidate for m in rest], conditioned(best.point, rest)
            further = [c for c in carriers if self.allowed(c, present)]
            log, member = max(
                (self.weighted(evidence_of_one(node, c), present) for c in further), key=lambda one: one[0], default=(0.0, None)
            )
            if log <= 0 or member is None:
                break
            rest = (*rest, member)
        found = self.known.get(key_of(rest)) or estimated(rest, best.point, self.log_prior(rest))
        found = replace(found, log_prior=max(found.log_prior, best.log_prior))
        self.known[found.key] = found
        return max(best, found, key=lambda h: h.log_posterior)

    def enriched(self, best: Hypothesis) -> Hypothesis:
        """A set whose last effect is unmodelled, or, where that is more probable, the one with a Gaussian process in the place of all
        unmodelled effects at that location. Whether there is an effect at all is decided without.
        """
        last = best.members[-1]
        there = log_e_value(self.ranked()) > LEAST_LOG_E_VALUE
        if last.candidate.name != UNMODELLED or not there:
            return best
        rest = tuple(m for m in best.members if m.label != last.label)
        if any(m.candidate.name == UNMODELLED for m in rest):
            return best  # what is unmodelled at several locations is not described by more detail at one
        process = self.unmodelled.process(conditioned(best.point, rest), last)
        if process is None:
            return best
        members = (*rest, process)
        found = self.known.get(key_of(members)) or estimated(members, best.point, self.log_prior(members))
        self.known[found.key] = found
        return max(best, found, key=lambda h: h.log_posterior)

    def generalise(self, best: Hypothesis) -> None:
        """Sets without one of the named effects that came last, and with an unmodelled effect in its most general form: a name that only
        mends the shape of something unmodelled is unnecessary then.
        """
        for named in best.catalogued[-OPTIONS.beam :]:
            for plain in best.unmodelled:
                others = tuple(m for m in best.members if m is not named and m is not plain)
                process = self.unmodelled.process(conditioned(best.point, others), plain)
                members = others if process is None else (*others, process)
                if process is not None and key_of(members) not in self.known:
                    self.known[key_of(members)] = estimated(members, best.point, self.log_prior(members))

    def exchange(self, best: Hypothesis) -> None:
        """Sets with another effect in the place of one of the best set's: what else it could be."""
        self.generalise(best)
        for rest in without_each(best.members):
            node = first_order(rest, best.point, self.log_prior(rest))
            self.known.setdefault(node.key, node)
            for _, member in self.extensions(node, self.candidates)[: OPTIONS.estimated]:
                members = (*rest, member)
                if key_of(members) not in self.known:
                    other = first_order(members, best.point, self.log_prior(members))
                    near = other.log_posterior > best.log_posterior - OPTIONS.reach
                    self.known[other.key] = estimated(members, best.point, other.log_prior) if near else other


def without_each(members: Sequence[Member]) -> list[tuple[Member, ...]]:
    """The set without each effect; the orders of a gear are left out one by one, and all together."""
    by_one = [tuple(m for m in members if m is not left_out) for left_out in members]
    labels = [label for label, count in Counter(m.label for m in members).items() if count > 1]
    return [*by_one, *(tuple(m for m in members if m.label != label) for label in labels)]


def log_e_value(ranked: Sequence[Hypothesis]) -> float:
    """Log of the evidence of all sets with an effect together, against none."""
    none = next(h for h in ranked if not h.members)
    some = [h.log_posterior - none.log_posterior for h in ranked if h.members]
    return float(np.logaddexp.reduce(some)) if some else -np.inf
