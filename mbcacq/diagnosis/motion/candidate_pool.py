"""The candidates of the catalogue of motion with their columns, and which of them may be selected next."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel, SelectedEffect
from mbcacq.diagnosis.motion.spectrum import periodic_candidates
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate


class CandidatePool:
    """Candidates with their columns in the store of a model. Columns from number ``mark`` on are those of one step of the selection."""

    def __init__(self, model: MotionModel, candidates: list[Candidate]) -> None:
        self._model, self.candidates = model, candidates
        self.forms = [self._of(c) for c in candidates if not c.rows.extends]
        self.mark = len(model.store.prior)

    def _of(self, candidate: Candidate, only: float | None = None) -> list[Member]:
        """One variant for each value of the hyper-parameter that is tried, or for ``only`` one."""
        hypers: list[float | None] = [None] if candidate.hyper is None else list(candidate.hyper.values)
        if only is not None:
            hypers = [only]
        if len(candidate.rows.joints) > 1:
            return [Member(candidate, h, columns=self._model.add(candidate, h)) for h in hypers]
        return self._model.add_of_one_joint([candidate] * len(hypers), hypers)

    def usual(self) -> list[list[Member]]:
        """The candidates with which a selection starts, one at each location."""
        first: dict[tuple, list[Member]] = {}
        for variants in self.forms:
            if variants[0].candidate.rows.usual:
                first.setdefault(variants[0].candidate.location, variants)
        return list(first.values())

    def periodic(self, weights: np.ndarray, chosen: np.ndarray) -> list[list[Member]]:
        """Periodic components of the present residual, in columns that ``forget_step`` removes."""
        model = self._model
        x = model.store.solve(model.store.normal(weights), chosen)
        found = [
            candidate
            for j, joint in enumerate(model.group.joints)
            for candidate in periodic_candidates(model.group, model.runs, joint, model.store.residual(j, chosen, x), model.store.training)
        ]
        return [[member] for member in model.add_of_one_joint(found, [_middle(c) for c in found])]

    def keep(self, effect: SelectedEffect) -> None:
        """Give an effect columns that stay, whatever ``forget_step`` removes."""
        member = effect.member
        if len(member.columns) and member.columns[0] < self.mark:
            return
        self.forget_step()
        effect.at(member.hyper, self._model.add(member.candidate, member.hyper))
        self.mark = len(self._model.store.prior)

    def forget_step(self) -> None:
        self._model.store.forget(self.mark)

    def extend(self, effect: SelectedEffect) -> None:
        """Offer the refinements of an effect that was selected; its columns and theirs stay."""
        candidate = effect.candidate
        if not candidate.rows.extends:
            offered = {v[0].candidate.form for v in self.forms}
            for refinement in self.candidates:
                known = refinement.form in offered
                here = refinement.rows.extends and refinement.location == candidate.location
                if here and not known and self._can_be_tested(refinement, candidate):
                    self.forms.append(self._of(refinement, effect.member.hyper if refinement.rows.shares_hyper else None))
        self.mark = len(self._model.store.prior)

    def _can_be_tested(self, refinement: Candidate, candidate: Candidate) -> bool:
        """A deviation that accumulates with time can only be tested on another motion, not on other moments of the same."""
        several = len({s.run for s in self._model.store.segments}) >= 2
        return not refinement.rows.shares_hyper or (several and candidate.hyper is not None and not candidate.hyper.refine)


def _middle(candidate: Candidate) -> float:
    assert candidate.hyper is not None
    return float(candidate.hyper.values[len(candidate.hyper.values) // 2])
