"""Beam search over sets of effects by their posterior probability.

The search is one for poses and for motion. What a recording is made of, and which candidates there are beyond a set, is in a subclass:
``pose_search.PoseSearch`` and ``motion.effect_search.MotionSearch``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from mbcacq.diagnosis.evidence.hypothesis import EvidencePoint, Hypothesis, SetPrior, estimated, first_order, key_of, under
from mbcacq.diagnosis.executor import UNLIMITED, TimeBudget
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.effect_set import Member

LEAST_LOG_E_VALUE = float(np.log(OPTIONS.least_e_value))  # above which there is an effect, at any look at a recording that grows


@dataclass(kw_only=True)
class EvidenceSearch:
    """The candidates of a recording, and every hypothesis that was estimated, by the keys of its effects.

    alternatives: whether sets with another effect in the place of one of the best set's are compared as well. narrow: one set is followed
    instead of a beam. budget: when it is spent, what was compared by then is all that is compared; ``cut_short`` says so.
    """

    most_effects: ClassVar[int] = OPTIONS.most_effects

    candidates: list[Any]
    prior: SetPrior
    alternatives: bool = False
    narrow: bool = False
    budget: TimeBudget = UNLIMITED
    cut_short: bool = False
    known: dict[tuple, Hypothesis] = field(default_factory=dict)

    # What a kind of recording says

    def further(self, node: Hypothesis, candidates: list[Any], least: float) -> list[tuple[float, Member]]:
        """The effects that may be beyond a set, with their log posterior odds. least: odds below which one does not matter."""
        raise NotImplementedError

    def improved(self, best: Hypothesis) -> Hypothesis:
        """The best set of a round, or a better one that is near it."""
        return best

    def begun(self, best: Hypothesis) -> Hypothesis:
        """The set from which the search goes on, or a better one that is near it."""
        return best

    def climbed_to_the_best(self, best: Hypothesis) -> Hypothesis:
        """The most probable set that is reached from one by further effects."""
        return self.climbed(best, self.candidates)

    def goes_on(self, best: Hypothesis) -> bool:
        """Whether further effects are looked for in the same linearisation."""
        return len(best.members) < self.most_effects

    @property
    def looks_ahead(self) -> bool:
        """Whether a set that is a little less probable than the one before is followed by one more effect."""
        return False

    @property
    def passes(self) -> int:
        """How often the best set's effects are exchanged for others, at most."""
        return OPTIONS.passes

    # The search

    def run(self, start: EvidencePoint, begin: Hypothesis | None = None) -> list[Hypothesis]:
        """All hypotheses that were compared, the most probable first; the empty set is one of them.

        begin: a set, of another linearisation, from which the search goes on.
        """
        best = estimated((), start, 0.0)
        self.known = {best.key: best}
        if begin is not None and begin.members:
            best = self.estimated(begin.members, self.restarted(start, begin))
            best = self.begun(best)
        best = self.climbed_to_the_best(best)
        for _ in range(self.passes if self.alternatives else 0):
            if self.out_of_time():
                break
            self.exchange(best)
            if self.ranked()[0].key == best.key:
                break
            best = self.ranked()[0]  # what stands in for an effect of it is asked as well
        for h in self.known.values():
            h.forget()
        return self.ranked()

    def out_of_time(self) -> bool:
        """Whether the search must end here."""
        self.cut_short = self.cut_short or self.budget.spent
        return self.cut_short

    def restarted(self, start: EvidencePoint, begin: Hypothesis) -> EvidencePoint:
        """The start at the noise of a set of another linearisation."""
        return replace(start, theta=begin.point.theta)  # pyright: ignore[reportCallIssue, reportArgumentType] -- both kinds of points have it

    def estimated(self, members: Sequence[Member], point: EvidencePoint) -> Hypothesis:
        """The hypothesis of a set, estimated where it is not known."""
        key = key_of(members)
        if key not in self.known:
            self.known[key] = estimated(members, point, self.log_prior(members))
        return self.known[key]

    def climbed(self, best: Hypothesis, candidates: list[Any]) -> Hypothesis:
        """The most probable set that is reached from one by further effects of these.

        Two effects may be hardly more probable than none where each is taken alone, and far more so together: the elasticity of two joints
        that share their load, say. So a beam whose best set is not excluded goes on by one more effect, where the search looks ahead.
        """
        beam, ahead = [best], False
        while self.goes_on(beam[0]) and not self.out_of_time():
            before, beam = beam, self.grown(beam, candidates)
            for h in before:
                h.forget()
            if not beam:
                break
            if beam[0].log_posterior <= best.log_posterior and best.members:
                near = beam[0].log_posterior > best.log_posterior + np.log(OPTIONS.undecided)
                if ahead or not near or not self.looks_ahead:
                    break
                ahead = True
                continue
            best = beam[0] = self.improved(beam[0])
            ahead = False
        return best

    def pruned(self, best: Hypothesis) -> Hypothesis:
        """A set without the effects that make it less probable, left out one by one, the least probable first."""
        while best.members:
            doubtful = [one for one in best.members if self.doubtful(best, one)]
            parts = [self.estimated(tuple(m for m in best.members if m is not one), best.point) for one in doubtful]
            first = max(parts, key=lambda h: h.log_posterior, default=None)
            if first is None or first.log_posterior < best.log_posterior:
                break
            best = first
        return best

    def doubtful(self, best: Hypothesis, member: Member) -> bool:
        """Whether a set may be more probable without this effect."""
        return True

    def ranked(self) -> list[Hypothesis]:
        return sorted(self.known.values(), key=lambda h: -h.log_posterior)

    @property
    def width(self) -> tuple[int, int]:
        """Sets that are kept of a round, and sets that get a noise of their own."""
        return (1, 2) if self.narrow else (OPTIONS.beam, OPTIONS.estimated)

    def grown(self, beam: Sequence[Hypothesis], candidates: list[Any]) -> list[Hypothesis]:
        """The most probable sets with one effect more, best first.

        Sets are proposed under the noise of the best one of the beam; those that may matter get a noise of their own.
        """
        point, proposed = beam[0].point, list[tuple[float, tuple[Member, ...]]]()
        width, most = self.width
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

    def extensions(self, node: Hypothesis, candidates: list[Any], least: float = -np.inf) -> list[tuple[float, Member]]:
        """The effects that may be beyond a set, and their log posterior odds, most probable first."""
        return sorted(self.further(node, candidates, least), key=lambda one: -one[0])

    def exchange(self, best: Hypothesis) -> None:
        """Sets with another effect in the place of one of the best set's: what else it could be."""
        for rest in without_each(best.members):
            if self.out_of_time():
                break
            self.exchanged(rest, best)

    def exchanged(self, rest: tuple[Member, ...], best: Hypothesis) -> None:
        """The set without an effect, and the most probable ones with another in its place."""
        node = self.looked_at(rest, best)
        self.known.setdefault(node.key, node)
        likely = [(log, (*rest, member)) for log, member in self.extensions(node, self.candidates)[: OPTIONS.estimated]]
        for log, members in [one for one in likely if key_of(one[1]) not in self.known][: self.width[1]]:
            if self.may_matter(node.log_posterior + log, best):
                other = self.looked_at(members, best)
                near = other.log_posterior > best.log_posterior - OPTIONS.reach
                self.known[other.key] = estimated(members, best.point, other.log_prior) if near else other

    def may_matter(self, log_posterior: float, best: Hypothesis) -> bool:
        """Whether a set of this log posterior, as far as it is known, is looked at."""
        return True

    def looked_at(self, members: Sequence[Member], best: Hypothesis) -> Hypothesis:
        """A set near the best one, as well as it must be known to decide whether it matters."""
        return first_order(members, best.point, self.log_prior(members))


@dataclass(frozen=True)
class EvidenceFit:
    """All sets that were compared, the most probable first, the empty one (``none``) among them. log_e_value: of all effects together
    against none; above ``least`` there is an effect. prior: of the sets. cut_short: time ran out before all was compared. linear: the
    rows at the linearisation of the best one, without discrepancy.
    """

    hypotheses: tuple[Hypothesis, ...]
    none: Hypothesis
    log_e_value: float
    least: float
    prior: SetPrior
    cut_short: bool = False
    linear: Any = None

    @property
    def significant(self) -> bool:
        return self.log_e_value > self.least

    @property
    def undecided(self) -> bool:
        """Whether the evidence neither shows an effect nor is as weak as without one."""
        return float(np.log(OPTIONS.noteworthy_e_value)) < self.log_e_value <= self.least

    @property
    def best(self) -> Hypothesis:
        """The most probable set where there is an effect at all, else the empty one."""
        return next(h for h in self.hypotheses if h.members) if self.significant else self.none


def linearised_anew(first: EvidenceFit, again: Callable[[EvidenceFit, EvidenceFit | None], EvidenceFit | None], most: int) -> EvidenceFit:
    """The sets of a recording that is linearised anew with the best set in place, as long as that changes it.

    again: gets a fit and the one before it, if there is one, and returns the fit at the linearisation of the first; None if it stays.
    most: how often.
    """
    before, fit = None, first
    for _ in range(most):
        new = again(fit, before)
        if new is None:
            break
        before, fit = fit, new
    return fit


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
