"""The search for effects in poses: candidates of the catalogue, effects that show only through others, and unmodelled ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import LEAST_LOG_E_VALUE, EvidenceSearch, log_e_value
from mbcacq.diagnosis.evidence.candidate_evidence import (
    Scored,
    evidence_of_candidate,
    evidence_of_candidates,
    evidence_of_one,
    scanned_candidate,
)
from mbcacq.diagnosis.evidence.coupled_effects import couplings_of, given_through, through
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, under
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet, Member
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.declaration import EffectCoupling
from mbcacq.effects.effect import Candidate
from mbcacq.effects.effect_term import UNKNOWN

# Effects enter a staged search together where each has this share of the log odds of the best one, and of its own beside those before it:
# what is at another location hardly changes them, and what is the same thing as another loses them.
SHARE_OF_ODDS = 0.5
SAME = 1.0 - 1e-9  # correlation of two names of one covariate: the torque about a joint and the component of the moment there


@dataclass(kw_only=True)
class PoseSearch(EvidenceSearch):
    """The candidates of a recording of poses.

    given: effects that are in the problem from the beginning. staged: one set is followed, and first the effects that every arm has
    (elastic joints), so that what they explain is not given to slow periodic errors, then the rest of the catalogue, and none unmodelled.
    Effects at different locations that do not take from each other enter together.
    """

    candidates: list[Candidate]
    unmodelled: UnmodelledEffects
    context: Context
    given: EffectSet = NO_EFFECTS
    staged: bool = False

    def begun(self, best: Hypothesis) -> Hypothesis:
        return self.relieved(best)

    def climbed_to_the_best(self, best: Hypothesis) -> Hypothesis:
        if self.staged:
            self.climbed(best, [c for c in self.candidates if catalogue.declaration(c.name).every_arm])
            best = self.ranked()[0]
            return self.climbed(best, self.candidates)
        best = self.climbed(best, self.candidates)
        common = self.with_common_effects(best)
        return best if common is best else self.climbed(common, self.candidates)

    def with_common_effects(self, best: Hypothesis) -> Hypothesis:
        """A set with an unmodelled function of a load, or, where that is more probable, one with what every arm has at all of its joints
        (elasticity) beside it or in its place. A general function may be better than any one of these and worse than all of them, so that
        single steps do not lead there.
        """
        common = [c for c in self.candidates if catalogue.declaration(c.name).every_arm]
        if not best.unmodelled:
            return best
        present = [m.candidate for m in best.members]
        further = [evidence_of_one(best.conditioned, c)[1] for c in common if self.allowed(c, present)]
        return max(best, self.pruned(self.estimated((*best.members, *further), best.point)), key=lambda h: h.log_posterior)

    def grown(self, beam: Sequence[Hypothesis], candidates: list[Candidate]) -> list[Hypothesis]:
        """As the search of a short recording; a staged one follows one set, which effects enter together."""
        if not self.staged:
            return super().grown(beam, candidates)
        (best,) = beam
        further = self.extensions(under(best.point, best.members, best.log_prior), candidates)
        entering = self.together(best, further)
        tried = [entering] if len(entering) > 1 else [(m,) for log, m in further[: self.width[1]] if log > -OPTIONS.reach]
        found = max((self.estimated((*best.members, *some), best.point) for some in tried), key=lambda h: h.log_posterior, default=None)
        if found is None:
            return []
        for key in dict.fromkeys(m.candidate.key for m in found.members[len(best.members) :]):
            found = self.polished(found, key)
        return [found]

    def together(self, best: Hypothesis, further: Sequence[tuple[float, Member]]) -> tuple[Member, ...]:
        """The effects that enter a set together: of each location the one of largest log odds, as these are beside those before it."""
        entering: tuple[Member, ...] = ()
        for log, member in further:
            room = len(best.members) + len(entering) < self.most_effects
            if log <= max(SHARE_OF_ODDS * further[0][0], 0.0) or not room:
                break
            if any(set(m.candidate.where) & set(member.candidate.where) for m in entering):
                continue
            if entering:
                beside = best.point.conditioned((*best.members, *entering))
                present = [m.candidate for m in (*best.members, *entering)]
                again, member = self.weighted(evidence_of_candidate(beside, member.candidate), present)
                if again < SHARE_OF_ODDS * log:
                    continue
            entering = (*entering, member)
        return entering

    def improved(self, best: Hypothesis) -> Hypothesis:
        if self.staged:
            return self.relieved(best)
        return self.enriched(self.relieved(self.polished(best, best.members[-1].candidate.key)))

    @property
    def looks_ahead(self) -> bool:
        return not (self.narrow or self.staged)

    @property
    def passes(self) -> int:
        return 1 if self.staged else OPTIONS.passes

    @property
    def width(self) -> tuple[int, int]:
        return (1, 2) if self.narrow or self.staged else (OPTIONS.beam, OPTIONS.estimated)

    def further(self, node: Hypothesis, candidates: list[Candidate], least: float) -> list[tuple[float, Member]]:
        present = [m.candidate for m in node.members]
        scored = evidence_of_candidates(node.conditioned, candidates)
        possible = [self.weighted(one, present) for one in scored if self.allowed(one[1].candidate, present)]
        for candidate in self.dependent(node):
            if not any(c.name == candidate.name for c in present):
                possible.append(self.weighted(evidence_of_one(node.conditioned, candidate), present))
        if not self.staged:
            found = self.unmodelled.evidence(node.conditioned, least)
            possible += [(log + self.prior.log_probability(m.candidate, present), m) for log, m in found]
        return possible

    def dependent(self, node: Hypothesis) -> list[Candidate]:
        """Candidates that depend on the coefficients of a set: a wrong payload, say, shows through elastic joints."""
        names = {*(m.candidate.name for m in node.members), *self.given.names}
        possible = [c for c in catalogue.couplings() if c.through in names]
        if not possible:
            return []
        out = list[Candidate]()
        for coupling in possible:
            there = {where: float(f"{value:.2g}") for where, value in through(node, coupling, node.solved).items()}
            there |= given_through(self.given, coupling)
            out += coupling.candidates(self.context, there)
        return out

    def weighted(self, scored: Scored, present: Sequence[Candidate]) -> tuple[float, Member]:
        """Log posterior odds of a scored effect."""
        log, member = scored
        return log + self.prior.log_probability(member.candidate, present), member

    def allowed(self, candidate: Candidate, present: Sequence[Candidate]) -> bool:
        if candidate.several:
            return candidate.hyper is not None or not any(c.key == candidate.key for c in present)
        return not any(c.name == candidate.name and c.where == candidate.where for c in present)

    def polished(self, best: Hypothesis, key: str) -> Hypothesis:
        """A set that has several orders of a gear, or several breakpoints, each a candidate of this key, with all of these looked for anew
        beside each other, and left out where they add nothing: the first were found while the others still disturbed.
        """
        members, point = best.members, best.point
        same = [m for m in members if m.candidate.key == key]
        if len(same) < 2 or not same[0].candidate.components:
            return best
        for _ in range(OPTIONS.rounds):
            before = [m.key for m in members]
            for j in reversed([j for j, m in enumerate(members) if m.candidate.key == key]):
                rest = members[:j] + members[j + 1 :]
                log, again = self.weighted(scanned_candidate(point.conditioned(rest), members[j].candidate), [m.candidate for m in rest])
                members = rest if log < 0 else (*members[:j], again, *members[j + 1 :])
            if [m.key for m in members] == before:
                break
        found = self.estimated(members, point)
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
            present, node = [m.candidate for m in rest], best.point.conditioned(rest)
            further = [c for c in carriers if self.allowed(c, present)]
            log, member = max((self.weighted(evidence_of_one(node, c), present) for c in further), key=lambda o: o[0], default=(0.0, None))
            if log <= 0 or member is None:
                break
            rest = (*rest, member)
        found = self.estimated(rest, best.point)
        found = replace(found, log_prior=max(found.log_prior, best.log_prior))
        self.known[found.key] = found
        return max(best, found, key=lambda h: h.log_posterior)

    def enriched(self, best: Hypothesis) -> Hypothesis:
        """A set whose last effect is unmodelled, or, where that is more probable, the one with a Gaussian process in the place of all
        unmodelled effects at that location. Whether there is an effect at all is decided without.
        """
        last = best.members[-1]
        there = log_e_value(self.ranked()) > LEAST_LOG_E_VALUE
        if last.candidate.name != UNKNOWN or not there:
            return best
        rest = tuple(m for m in best.members if m.label != last.label)
        if any(m.candidate.name == UNKNOWN for m in rest):
            return best  # what is unmodelled at several locations is not described by more detail at one
        process = self.unmodelled.process(best.point.conditioned(rest), last)
        if process is None:
            return best
        members = (*rest, process)
        found = self.estimated(members, best.point)
        return max(best, found, key=lambda h: h.log_posterior)

    def generalise(self, best: Hypothesis) -> None:
        """Sets without one of the named effects that came last, and with an unmodelled effect in its most general form: a name that only
        mends the shape of something unmodelled is unnecessary then.
        """
        for named in best.catalogued[-OPTIONS.beam :]:
            for plain in best.unmodelled:
                others = tuple(m for m in best.members if m is not named and m is not plain)
                process = self.unmodelled.process(best.point.conditioned(others), plain)
                members = others if process is None else (*others, process)
                if process is not None and self.looked_at(members, best).log_posterior > best.log_posterior - OPTIONS.reach:
                    self.estimated(members, best.point)

    def compare_general_forms(self, best: Hypothesis) -> None:
        """Sets with a general function in the place of all names at a joint that depend on its load or angle: two names that come near to
        one curve are no explanation of it. A function of nothing but their own covariate is the same physics with a curve: it stands beside
        them, as what they leave.
        """
        for at in dict.fromkeys(m.candidate.where for m in best.catalogued if len(m.candidate.where) == 1):
            names = [m for m in best.catalogued if m.candidate.where == at]
            others = tuple(m for m in best.members if m not in names)
            process = None if self.out_of_time() else self.unmodelled.process(best.point.conditioned(others), names[0])
            if process is None:
                continue
            members = (*(best.members if self.same_covariate(process, names) else others), process)
            if self.looked_at(members, best).log_evidence > best.log_evidence - OPTIONS.reach:
                self.estimated(members, best.point)

    def same_covariate(self, process: Member, names: Sequence[Member]) -> bool:
        """Whether a process is a function of nothing but the one covariate of some named effects."""
        own, *further = {m.candidate.depends_on for m in names}
        of = {name for part in process.candidate.parts(None) for name in part.covariates}
        value = self.context.value
        return not further and all(abs(np.corrcoef(value(name), value(own))[0, 1]) > SAME for name in of)

    def exchange(self, best: Hypothesis) -> None:
        self.generalise(best)
        self.compare_general_forms(best)
        super().exchange(best)
