"""Beam search over sets of parametric effects, each set refitted together with the whole geometry.

An effect must pass a test to enter (``penalised_gain``); which of several sets it is, their posterior odds decide. A set may not contain
what physics forbids (a negative compliance).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.search import payload_coupling
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring, ScoredCandidate
from mbcacq.diagnosis.search.effect_prior import EffectPrior
from mbcacq.diagnosis.search.effect_set import EffectSet, SelectedEffects
from mbcacq.diagnosis.search.hyperparameters import best_hyper
from mbcacq.diagnosis.search.projected_solve import prior_weight
from mbcacq.diagnosis.search.selection_criteria import COMPANIONS, SelectionCriteria
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.effects.pose import payload

MOST_EFFECTS = 20
FEW_EFFECTS = 4  # up to which exchanging them is tried several times even in a long recording
NEAR_THRESHOLD = 0.7  # share of its threshold that a candidate must gain to be tried
INDEPENDENT = 0.02  # share of an effect's information that must remain with the other effects fitted


@dataclass(frozen=True)
class BeamSearch:
    """The candidates of these data and how they are compared.

    beam_width, branches, rounds: sets kept in a round, candidates tried for each, rounds. thorough: exchange effects until none improves.
    least_share: of chi2, that an effect must gain (long recordings). protected: keys of effects that stay while they are significant.
    threshold_reduction: chi2 by which a first effect may miss its threshold, where there is known to be an effect.
    """

    candidates: list[Candidate]
    beam_width: int = 3
    branches: int = 6
    rounds: int = 12
    thorough: bool = True
    least_share: float = 0.0
    protected: frozenset[str] = frozenset()
    context: Context | None = None
    threshold_reduction: float = 0.0

    @property
    def no_effects(self) -> EffectSet:
        """The empty set; where there is known to be an effect, a first one that misses its threshold by the reduction is better."""
        return EffectSet((), penalised_gain=-self.threshold_reduction)

    @cached_property
    def criteria(self) -> SelectionCriteria:
        return SelectionCriteria(self.candidates)

    def run(self, projected: CandidateScoring, start: EffectSet | None = None) -> EffectSet:
        """The best set of effects under the projected problem's noise."""
        return self.polished(projected, self.beam_search(projected, start))

    def polished(self, projected: CandidateScoring, model: EffectSet) -> EffectSet:
        """The set after exchanges of single effects, its payload and compliances solved together."""
        return payload_coupling.coupled(self, projected, self.exchange_effects(projected, model))

    def beam_search(self, projected: CandidateScoring, start: EffectSet | None = None) -> EffectSet:
        """Sets of effects with one more in each round, the best few kept; the best of all."""
        best = start if start is not None and start.effects else self.no_effects
        beam = [best]
        for _ in range(self.rounds):
            grown = self._grown(projected, beam)
            if not grown:
                break
            beam = sorted(grown.values(), key=lambda m: -m.log_posterior_odds)[: self.beam_width]
            passing = next((m for m in beam if m.penalised_gain > self.no_effects.penalised_gain), None)
            if passing is not None and (passing.log_posterior_odds > best.log_posterior_odds or not best.effects):
                best = passing
            elif best.effects and beam[0].log_posterior_odds < best.log_posterior_odds - 20:
                break
            if len(best.effects) >= MOST_EFFECTS:
                break  # random effects describe the remainder better
        return best

    def _grown(self, projected: CandidateScoring, beam: list[EffectSet]) -> dict[tuple, EffectSet]:
        """The sets of a beam with one effect more, or with one at every location in a long recording."""
        grown: dict[tuple, EffectSet] = {}
        for model in beam:
            branches = self.expand(projected, model)
            for more in [(b,) for b in branches[: self.branches]] + ([] if self.thorough else [best_per_location(branches)]):
                new = self.solve(projected, (*model.effects, *((s.candidate, s.hyper) for s in more)))
                if new is not None and new.penalised_gain > model.penalised_gain - self.companion_slack(model, more):
                    key = tuple(sorted((c.key, round(h or 0.0, 2)) for c, h in new.effects))
                    grown.setdefault(key, new)
        return grown

    def companion_slack(self, model: EffectSet, more: tuple[ScoredCandidate, ...]) -> float:
        """chi2 by which a first effect may miss its threshold, if others of its kind are likely: together they may pass."""
        if model.effects or len(more) != 1 or more[0].candidate.name not in COMPANIONS:
            return 0.0
        return (1 - NEAR_THRESHOLD) * self.criteria.threshold(more[0].candidate, more[0].hyper, ())

    def exchange_effects(self, projected: CandidateScoring, model: EffectSet) -> EffectSet:
        """Effects removed that are not significant, and exchanged for better ones, until nothing improves."""
        for _ in range(6 if self.thorough else 3 if len(model.effects) <= FEW_EFFECTS else 1):
            improved = model
            for j in range(len(model.effects)):
                improved = self._best_exchange(projected, model, j, improved)
            if improved is model:
                return model
            model = improved
        return model

    def _best_exchange(self, projected: CandidateScoring, model: EffectSet, j: int, improved: EffectSet) -> EffectSet:
        """The best of ``improved`` and the sets without effect j, or with another in its place."""
        protected = self.is_protected(model, j)
        rest = self.solve(projected, model.effects[:j] + model.effects[j + 1 :])
        if rest is None:
            return improved
        if rest.penalised_gain > improved.penalised_gain and not protected:
            improved = rest
        candidate, hyper = model.effects[j]
        if len(model.effects) > 6 and candidate.several and hyper is not None and hyper > 4.0:
            return improved  # a periodic error of high order can be nothing else
        possible = [s for s in self.expand(projected, rest) if not (protected and s.candidate.several)]
        for scored in possible[:2]:
            other = self.solve(projected, (*rest.effects, (scored.candidate, scored.hyper)))
            if other is None or other.penalised_gain <= rest.penalised_gain:
                continue
            if other.log_posterior_odds > improved.log_posterior_odds + 1e-6:
                improved = other
        return improved

    def is_protected(self, model: EffectSet, j: int) -> bool:
        """Whether effect j stays as long as it is significant: elasticity, which every arm has, gives way to no periodic error."""
        first = model.slices()[j].start
        significant = model.coefficients[first] > 3 * np.sqrt(model.covariance[first, first])
        return model.effects[j][0].key in self.protected and bool(significant)

    def expand(self, projected: CandidateScoring, model: EffectSet, deficit: float = 0.0) -> list[ScoredCandidate]:
        """Candidates beyond a set at their best hyper-parameter, best first; those that miss their threshold by more than the ``deficit``
        are left out.
        """
        here = projected.conditioned_on([(projected.block(c, h), prior_weight(c)) for c, h in model.effects])
        out, present = [], [c for c, _ in model.effects]
        deficit = deficit if present else max(deficit, self.threshold_reduction)

        def least(candidate: Candidate, hyper: float | None) -> float:
            threshold = NEAR_THRESHOLD * self.criteria.threshold(candidate, hyper, present)
            return max(threshold, self.least_share * projected.chi2) - deficit

        fixed = here.best_fixed(self.candidates)
        for candidate in [*self.candidates, *self.dependent_candidates(model)]:
            if not self.allowed(candidate, model):
                continue
            if candidate.key in fixed:
                hyper, gain = fixed[candidate.key]
                if gain > least(candidate, hyper):
                    out.append(here.test(candidate, hyper))
            elif (scored := best_hyper(here, candidate, lambda h, c=candidate: least(c, h))) is not None:
                out.append(scored)

        def net_gain(s: ScoredCandidate) -> float:
            return self.criteria.occam_penalty(s.candidate, s.hyper, present, self.effect_prior(*s.fitted)) - s.gain

        return sorted(out, key=net_gain)

    def effect_prior(self, candidate: Candidate, coefficients: np.ndarray, covariance: np.ndarray) -> EffectPrior:
        """In a long recording every direction of a real effect is determined, and a sum of many periodic errors has no typical size."""
        own = EffectPrior.of(candidate, coefficients, covariance)
        return own if self.thorough else own.equally_determined

    def dependent_candidates(self, model: EffectSet) -> list[Candidate]:
        """Candidates that depend on the coefficients of the set: a wrong payload shows through elastic joints."""
        if self.context is None:
            return []
        elastic = {
            int(c.where[0][1:]) - 1: model.coefficients[p.start]
            for (c, _), p in zip(model.effects, model.slices(), strict=True)
            if c.name == "joint_compliance"
        }
        return payload.correction_for(self.context, {i: float(f"{c:.2g}") for i, c in elastic.items()})

    def allowed(self, candidate: Candidate, model: EffectSet) -> bool:
        same = [c for c, _ in model.effects if c.name == candidate.name and c.where == candidate.where]
        return not same or candidate.several

    def collinear(self, model: EffectSet, S: np.ndarray) -> bool:
        """Whether two effects cancel each other: coefficients far less certain with the others fitted than they would be alone."""
        if len(model.names) < 2 or payload.NAME in model.names:
            return False
        for p in model.slices():
            own = S[p, p]
            other = np.linalg.inv(model.covariance[p, p])
            if np.linalg.eigvals(np.linalg.solve(own, other)).real.min() < INDEPENDENT:
                return True
        return False

    def solve(self, projected: CandidateScoring, effects: SelectedEffects) -> EffectSet | None:
        """All effects and the geometry together; None where physics forbids the result."""
        if not effects:
            return self.no_effects
        model, S = self._solved(projected, effects)
        if any(c.positive and model.coefficients[p.start] < 0 for (c, _), p in zip(effects, model.slices(), strict=True)):
            return None
        if self.collinear(model, S):
            return None
        if payload.NAME in model.names and "joint_compliance" not in model.names:
            return None  # a rigid arm shows no payload
        return model

    def solved(self, projected: CandidateScoring, effects: SelectedEffects) -> EffectSet:
        """All effects and the geometry together, whatever the signs of the coefficients."""
        return self._solved(projected, effects)[0] if effects else self.no_effects

    def _solved(self, projected: CandidateScoring, effects: SelectedEffects) -> tuple[EffectSet, np.ndarray]:
        """The set and its normal matrix (k, k)."""
        S, b = normal_matrix(projected, effects)
        size = np.sqrt(np.diag(S))
        covariance = np.linalg.inv(S / np.outer(size, size) + 1e-12 * np.eye(len(S))) / np.outer(size, size)
        coefficients = covariance @ b
        gain = float(b @ coefficients)
        threshold, penalty, present, owns = 0.0, 0.0, [], []
        for (candidate, hyper), p in zip(effects, EffectSet(effects).slices(), strict=True):
            own = self.effect_prior(candidate, coefficients[p], covariance[p, p])
            threshold += self.criteria.detection_threshold(candidate, hyper, present, own)
            penalty += self.criteria.occam_penalty(candidate, hyper, present, own)
            present.append(candidate)
            owns.append(own)
        if self.thorough:  # in a long recording nothing real is weak
            threshold = min(threshold, self.criteria.joint_detection_threshold(effects, owns))
        return EffectSet(effects, gain, gain - threshold, gain - penalty, coefficients, covariance), S


def normal_matrix(projected: CandidateScoring, effects: SelectedEffects) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix (k, k) with the coefficients' prior, and right-hand side (k,), of a set of effects beyond geometry."""
    if projected.conditioned.shape[1]:
        raise ValueError("a set of effects is solved on a problem that is conditioned on nothing")
    X = np.concatenate([projected.block(c, h) for c, h in effects], axis=1)
    absorbed = projected.Q.T @ X
    S = X.T @ X - absorbed.T @ absorbed + np.diag(np.concatenate([prior_weight(c) for c, _ in effects]))
    return S, X.T @ projected.r


def best_per_location(branches: list[ScoredCandidate]) -> tuple[ScoredCandidate, ...]:
    """The best candidate of every location: many joints of a real arm err at once."""
    best: dict[tuple[str, ...], ScoredCandidate] = {}
    for scored in branches:
        best.setdefault(scored.candidate.where, scored)
    return tuple(best.values())
