"""Competition of named effects: a beam search over sets of effects, each set refitted together with the whole geometry.

A member must pass a test to enter (``score``); which of several sets it is, their evidence decides (``worth``). A set may not contain
what physics forbids (a negative compliance).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.search import payload_coupling
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring, ScoredCandidate
from mbcacq.diagnosis.search.effect_prior import EffectPrior
from mbcacq.diagnosis.search.effect_set import EffectSet, Members
from mbcacq.diagnosis.search.hyperparameters import best_hyper
from mbcacq.diagnosis.search.projected_solve import prior_weight
from mbcacq.diagnosis.search.selection_criteria import COMPANIONS, SelectionCriteria
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.effects.pose import payload

LONGEST = 20
FEW = 4  # members up to which exchanging them is tried several times even in a long recording
NEARLY = 0.7  # share of what it costs that a candidate must gain to be looked at
APART = 0.02  # share of a member's information that must be left beside the other members


@dataclass(frozen=True)
class BeamSearch:
    """The candidates of these data and how they are weighed.

    beam, branches, most: sets kept in a round, candidates tried for each, rounds. thorough: exchange members until nothing improves.
    least_share: of chi2, that a member must gain (long recordings). protected: keys of members that stay while they are significant.
    allowance: chi2 by which a first member may fail the test, where there is known to be an effect.
    """

    candidates: list[Candidate]
    beam: int = 3
    branches: int = 6
    most: int = 12
    thorough: bool = True
    least_share: float = 0.0
    protected: frozenset[str] = frozenset()
    situation: Context | None = None
    allowance: float = 0.0

    @property
    def nothing(self) -> EffectSet:
        """No effect; where there is known to be one, a first that falls short of the test by the allowance is better than none."""
        return EffectSet((), score=-self.allowance)

    @cached_property
    def prices(self) -> SelectionCriteria:
        return SelectionCriteria(self.candidates)

    def run(self, screen: CandidateScoring, start: EffectSet | None = None) -> EffectSet:
        """The best set of effects under the screen's noise."""
        return self.settled(screen, self.grow(screen, start))

    def settled(self, screen: CandidateScoring, model: EffectSet) -> EffectSet:
        return payload_coupling.settled(self, screen, self.polish(screen, model))

    def grow(self, screen: CandidateScoring, start: EffectSet | None = None) -> EffectSet:
        """Sets of effects with one more in each round, the best few kept; the best of all."""
        best = start if start is not None and start.members else self.nothing
        beam = [best]
        for _ in range(self.most):
            grown: dict[tuple, EffectSet] = {}
            for model in beam:
                branches = self.expand(screen, model)
                for more in [(b,) for b in branches[: self.branches]] + ([] if self.thorough else [at_different_places(branches)]):
                    new = self.solve(screen, (*model.members, *((s.candidate, s.hyper) for s in more)))
                    if new is not None and new.score > model.score - self.slack(model, more):
                        key = tuple(sorted((c.key, round(h or 0.0, 2)) for c, h in new.members))
                        grown.setdefault(key, new)
            if not grown:
                break
            beam = sorted(grown.values(), key=lambda m: -m.worth)[: self.beam]
            passing = next((m for m in beam if m.score > self.nothing.score), None)
            if passing is not None and (passing.worth > best.worth or not best.members):
                best = passing
            elif best.members and beam[0].worth < best.worth - 20:
                break
            if len(best.members) >= LONGEST:
                break  # the smooth model is the better place for what is left
        return best

    def slack(self, model: EffectSet, more: tuple[ScoredCandidate, ...]) -> float:
        """chi2 by which a first member may fail the test, if others of its kind are likely beside it: together they may pass."""
        if model.members or len(more) != 1 or more[0].candidate.name not in COMPANIONS:
            return 0.0
        return (1 - NEARLY) * self.prices.threshold(more[0].candidate, more[0].hyper, ())

    def polish(self, screen: CandidateScoring, model: EffectSet) -> EffectSet:
        """Drop members that do not pay, exchange members for better ones, until nothing improves."""
        for _ in range(6 if self.thorough else 3 if len(model.members) <= FEW else 1):
            improved = model
            for j in range(len(model.members)):
                protected = self.is_protected(model, j)
                rest = self.solve(screen, model.members[:j] + model.members[j + 1 :])
                if rest is None:
                    continue
                if rest.score > improved.score and not protected:
                    improved = rest
                candidate, hyper = model.members[j]
                if len(model.members) > 6 and (candidate.several and hyper > 4.0):
                    continue  # a fast wiggle can be nothing else
                possible = [s for s in self.expand(screen, rest) if not (protected and s.candidate.several)]
                for scored in possible[:2]:
                    other = self.solve(screen, (*rest.members, (scored.candidate, scored.hyper)))
                    if other is not None and other.score > rest.score and other.worth > improved.worth + 1e-6:
                        improved = other
            if improved is model:
                return model
            model = improved
        return model

    def is_protected(self, model: EffectSet, j: int) -> bool:
        """Members that stay as long as they are significant: elasticity, which every arm has, gives way to no periodic error."""
        at = model.parts()[j].start
        return model.members[j][0].key in self.protected and model.coefficients[at] > 3 * np.sqrt(model.covariance[at, at])

    def expand(self, screen: CandidateScoring, model: EffectSet, short: float = 0.0) -> list[ScoredCandidate]:
        """Candidates beyond a model at their best hyper-parameter, best first; those that cannot pay, even were they ``short`` of it,
        are left out.
        """
        here = screen.adopted([(screen.block(c, h), prior_weight(c)) for c, h in model.members])
        out, present = [], [c for c, _ in model.members]
        short = short if present else max(short, self.allowance)

        def least(candidate: Candidate, hyper: float | None) -> float:
            return max(NEARLY * self.prices.threshold(candidate, hyper, present), self.least_share * screen.chi2) - short

        fixed = here.best_fixed(self.candidates)
        for candidate in [*self.candidates, *self.beside(model)]:
            if not self.allowed(candidate, model):
                continue
            if candidate.key in fixed:
                hyper, gain = fixed[candidate.key]
                if gain > least(candidate, hyper):
                    out.append(here.test(candidate, hyper))
            elif (scored := best_hyper(here, candidate, lambda h, c=candidate: least(c, h))) is not None:
                out.append(scored)
        return sorted(out, key=lambda s: self.prices.price(s.candidate, s.hyper, present, self.strengths(*s.fitted)) - s.gain)

    def strengths(self, candidate: Candidate, coefficients: np.ndarray, covariance: np.ndarray) -> EffectPrior:
        """In a long recording nothing real is hardly seen, and what is strung together of many periodic errors has no typical size."""
        own = EffectPrior.of(candidate, coefficients, covariance)
        return own if self.thorough else own.alike

    def beside(self, model: EffectSet) -> list[Candidate]:
        """Candidates that exist only next to what the model has: a wrong payload next to elastic joints."""
        if self.situation is None:
            return []
        elastic = {
            int(c.where[0][1:]) - 1: model.coefficients[p.start]
            for (c, _), p in zip(model.members, model.parts(), strict=True)
            if c.name == "joint_compliance"
        }
        return payload.correction_for(self.situation, {i: float(f"{c:.2g}") for i, c in elastic.items()})

    def allowed(self, candidate: Candidate, model: EffectSet) -> bool:
        same = [c for c, _ in model.members if c.name == candidate.name and c.where == candidate.where]
        return not same or candidate.several

    def collinear(self, model: EffectSet, S: np.ndarray) -> bool:
        """Whether two names cancel each other: coefficients far less certain beside the others than they would be alone."""
        if len(model.names) < 2 or payload.NAME in model.names:
            return False
        for p in model.parts():
            own = S[p, p]
            other = np.linalg.inv(model.covariance[p, p])
            if np.linalg.eigvals(np.linalg.solve(own, other)).real.min() < APART:
                return True
        return False

    def solve(self, screen: CandidateScoring, members: Members, permit: bool = False) -> EffectSet | None:
        """All members and the geometry together; None where physics forbids the result and ``permit`` does not."""
        if not members:
            return self.nothing
        X = np.concatenate([screen.block(c, h) for c, h in members], axis=1)
        weight = np.concatenate([prior_weight(c) for c, _ in members])
        taken = screen.Q.T @ X
        if screen.more.shape[1]:
            raise ValueError("a set of effects is solved on a screen without adopted blocks")
        S = X.T @ X - taken.T @ taken + np.diag(weight)
        size = np.sqrt(np.diag(S))
        covariance = np.linalg.inv(S / np.outer(size, size) + 1e-12 * np.eye(len(S))) / np.outer(size, size)
        b = X.T @ screen.r
        coefficients = covariance @ b
        gain = float(b @ coefficients)
        cost, price, present, owns = 0.0, 0.0, [], []
        for (candidate, hyper), p in zip(members, EffectSet(members).parts(), strict=True):
            own = self.strengths(candidate, coefficients[p], covariance[p, p])
            cost += self.prices.cost(candidate, hyper, present, own)
            price += self.prices.price(candidate, hyper, present, own)
            present.append(candidate)
            owns.append(own)
        if self.thorough:  # in a long recording nothing real is weak
            cost = min(cost, self.prices.cost_together(members, owns))
        model = EffectSet(members, gain, gain - cost, gain - price, coefficients, covariance)
        if not permit and any(c.positive and coefficients[p.start] < 0 for (c, _), p in zip(members, model.parts(), strict=True)):
            return None
        if not permit and self.collinear(model, S):
            return None
        if not permit and payload.NAME in model.names and "joint_compliance" not in model.names:
            return None  # a rigid arm shows no payload
        return model


def at_different_places(branches: list[ScoredCandidate]) -> tuple[ScoredCandidate, ...]:
    """The best candidate of every place: many joints of a real arm err at once."""
    best: dict[tuple[str, ...], ScoredCandidate] = {}
    for scored in branches:
        best.setdefault(scored.candidate.where, scored)
    return tuple(best.values())
