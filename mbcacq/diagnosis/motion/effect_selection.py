"""Which effects a group of channels needs: the sets of the evidence search, linearised anew after every effect.

Effects that hide each other (friction of all joints, a tool, a balancer) start together, and those that are not needed are left out. One by
one, each would have to stand out of the structure that the others leave. Whenever a set changes, the delay of the channel, the continuous
hyper-parameters and the load are estimated anew, and periodic components are looked for in what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.diagnosis.effect_found import Alternative
from mbcacq.diagnosis.evidence.beam_search import LEAST_LOG_E_VALUE, EvidenceFit, linearised_anew, log_e_value
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior, estimated
from mbcacq.diagnosis.evidence.posterior import alternatives_of, reported_hypothesis
from mbcacq.diagnosis.executor import UNLIMITED, TimeBudget
from mbcacq.diagnosis.motion.candidate_pool import CandidatePool
from mbcacq.diagnosis.motion.effect_search import ODDS_OF_COMMON, MotionSearch, log_prior_mass, sized, that_show
from mbcacq.diagnosis.motion.gram_point import GramPoint, GramProblem
from mbcacq.diagnosis.motion.hyperparameters import estimate_hyperparameters
from mbcacq.diagnosis.motion.load_error import follow_load_error
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Candidate

MOST_PASSES = 60  # linearisations: one an effect, and some more where an effect is left out again
TRIED = 5  # effects of the most evidence that are compared, each with the colour of the residual that it would leave


@dataclass(frozen=True)
class Judged:
    """What the last comparison says of a selected effect. p_value: one over its Bayes factor in its set. before, after: held-out mean
    square (J,) without it and with it. alternatives: what else could stand in its place."""

    p_value: float = 1.0
    before: np.ndarray = field(default_factory=lambda: np.zeros(0))
    after: np.ndarray = field(default_factory=lambda: np.zeros(0))
    alternatives: list[Alternative] = field(default_factory=list)


class EffectSelection:
    """Selects effects for a model. start: (J,) held-out mean square of the model's base alone. sets: what was compared last. judged: each
    form of an effect that was selected, empty if a part is held out."""

    def __init__(self, model: MotionModel, candidates: list[Candidate] | None = None, budget: TimeBudget = UNLIMITED) -> None:
        """candidates: what may be selected, None for the whole catalogue. budget: when it is spent, the set is not changed any more."""
        self.budget = budget
        self.model = model
        self.pool = CandidatePool(model, catalogue.motion_candidates(model.group, model.runs) if candidates is None else candidates)
        self._left_out: set[tuple] = set()
        self.judged: dict[tuple, Judged] = {}
        chosen = model.chosen()
        self.start = model.held_out_mean_square(chosen, model.fold_normals(model.weights(chosen)))
        self.sets: EvidenceFit | None = None

    def run(self) -> None:
        """Start with what every arm may have; change the set as long as that makes it more probable; report what the evidence shows."""
        self.model.selected = [forms[len(forms) // 2] for forms in self.pool.usual()]
        linearised_anew(self._compared(settle=True), self._compared_anew, MOST_PASSES)
        self.sets = self._compared(alternatives=self.model.store.whole)
        self._report(self.sets)
        self.pool.forget_step()

    def _compared_anew(self, fit: EvidenceFit, before: EvidenceFit | None) -> EvidenceFit | None:
        """The sets near the most probable one, linearised about it; None if nothing is beyond it, or time is over."""
        best, selected = fit.hypotheses[0], _forms(self.model.selected)
        if before is not None:
            if _forms(best.members) == selected:
                best = self._grown(best)
                if _forms(best.members) == selected:
                    return None
            self._left_out |= selected - _forms(best.members)  # what came and went is not asked again
        self._take(best)
        return None if self.budget.spent else self._compared()

    def _compared(self, settle: bool = False, alternatives: bool = False) -> EvidenceFit:
        """The sets near the present one, in the present linearisation."""
        model, pool, store = self.model, self.pool, self.model.store
        pool.forget_step()
        chosen = model.chosen()
        weights = model.weights(chosen)
        colour = model.colour(chosen, weights)
        every = [*pool.forms, *pool.periodic(weights, chosen)]
        offered = [forms for forms in every if forms[0].candidate.form not in self._left_out]
        problem, prior = GramProblem.of(model, colour), np.array(store.prior)
        information = np.diag(problem.weighted(weights * colour, corrected=True))[:-1]
        shown = [that_show(tuple(forms), information) for forms in offered]
        candidates = [tuple(sized(one, prior, information) for one in forms) for forms in shown if forms]
        members = tuple(sized(e, prior, information) for e in model.selected)
        of = SetPrior.of([forms[0].candidate for forms in candidates], 1, odds_of_common=ODDS_OF_COMMON)
        search = MotionSearch(candidates=candidates, prior=of, alternatives=alternatives, narrow=True, settle=settle, budget=self.budget)
        self._colour, self._search = colour, search
        alone = np.asarray(store.base, dtype=int)
        of_alone = model.weights(alone)
        # The start of the search matters: from much more noise than there is, the noise of no effect would not settle in a few rounds.
        start = GramPoint(problem, -np.log(of_alone * model.colour(alone, of_alone)))
        there = Hypothesis(members, GramPoint(problem, -np.log(weights * colour)), 0.0)
        ranked = search.run(start, there)
        log_e = log_e_value(ranked) - log_prior_mass(candidates)
        return EvidenceFit(tuple(ranked), search.known[()], log_e, LEAST_LOG_E_VALUE, search.prior, cut_short=self.budget.spent)

    def _grown(self, best: Hypothesis) -> Hypothesis:
        """The set with the further effect that makes it more probable by most, each with the colour of the residual that it would leave.

        The residual of an effect at a joint counts as coloured noise there, and would hide the effect as long as it is not tried.
        """
        search, found, most = self._search, best, 0.0
        if len(best.members) >= search.most_effects:
            return best
        for _, member in search.extensions(best, search.candidates)[:TRIED]:
            chosen = np.concatenate([self.model.chosen(), member.columns]).astype(int)
            colour = self.model.colour(chosen, self.model.weights(chosen))
            problem = best.point.problem.recoloured(np.minimum(colour / self._colour, 1.0))
            without = estimated(best.members, replace(best.point, problem=problem), best.log_prior)
            members = (*best.members, member)
            grown = estimated(members, without.point, search.log_prior(members))
            gain = grown.log_posterior - without.log_posterior
            if gain > most:
                most, found = gain, grown
        return found if found is best else search.settled(found, first=len(best.members))

    def _take(self, best: Hypothesis) -> None:
        """Make a set that of the model, and linearise anew."""
        model, known = self.model, {e.candidate.form: e for e in self.model.selected}
        model.selected = [self._placed(member, known.get(member.candidate.form)) for member in best.members]
        if not any(e.candidate.rows.channel_delay for e in model.selected):
            model.store.correct_delay(0.0)
        self.pool.forget_step()
        new = any(_relinearises(e.candidate) for e in model.selected if e.candidate.form not in known)
        if new or len(model.selected) < len(known):
            estimate_hyperparameters(model)
        follow_load_error(model)
        for effect in model.selected:
            self.pool.extend(effect)

    def _placed(self, member: Member, before: Member | None) -> Member:
        """An effect of a set in columns that stay: those that it had ``before``, at the same value of its hyper-parameter."""
        if before is None:
            return self.pool.kept(member)
        return replace(member, columns=before.columns) if before.hyper == member.hyper else member

    def _report(self, sets: EvidenceFit) -> None:
        """Keep what the evidence shows, with the held-out errors without and with each effect, and what else it could be.

        With a part of the recordings held out, nothing is reported but predicted, by the most probable set.
        """
        model = self.model
        if not model.store.whole:
            return
        reported = reported_hypothesis(sets) if sets.significant else sets.none
        forms = {m.candidate.form: m for m in reported.members}
        model.selected = [e for e in model.selected if e.candidate.form in forms]
        if not any(e.candidate.rows.channel_delay for e in model.selected):
            model.store.correct_delay(0.0)
        follow_load_error(model)
        chosen = model.chosen()
        weights = model.weights(chosen)
        normals = model.fold_normals(weights)
        after = model.held_out_mean_square(chosen, normals)
        for effect in model.selected:
            member = forms[effect.candidate.form]
            rest = tuple(m for m in reported.members if m is not member)
            lost = reported.log_evidence - estimated(rest, reported.point, 0.0).log_evidence
            others = [Alternative.of_label(*one) for one in alternatives_of(sets, reported, member.label).items()]
            p_value, before = float(np.exp(-max(lost, 0.0))), self._mean_square_without(effect, weights, normals)
            self.judged[effect.candidate.form] = Judged(p_value, before, after, others)

    def _mean_square_without(self, effect: Member, weights: np.ndarray, normals: dict[int, np.ndarray]) -> np.ndarray:
        model, chosen = self.model, self.model.chosen(without=effect)
        if not effect.candidate.rows.channel_delay:
            return model.held_out_mean_square(chosen, normals)
        delay = model.store.delay
        model.store.correct_delay(0.0)
        out = model.held_out_mean_square(chosen, model.fold_normals(weights))
        model.store.correct_delay(delay)
        return out


def _forms(members: Sequence[Member]) -> frozenset:
    return frozenset(m.candidate.form for m in members)


def _relinearises(candidate: Candidate) -> bool:
    return (candidate.hyper is not None and candidate.hyper.refine) or candidate.rows.channel_delay or candidate.rows.follows_load
