"""The candidates of the catalogue of motion with their columns, and which of them may be selected next."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel, SelectedEffect, Variant
from mbcacq.diagnosis.motion.spectrum import periodic_candidates
from mbcacq.effects.motion_effect import MotionCandidate


class CandidatePool:
    """Candidates with their columns in the store of a model. Columns from number ``mark`` on are those of one step of the selection."""

    def __init__(self, model: MotionModel, candidates: list[MotionCandidate]) -> None:
        self._model, self.candidates = model, candidates
        self.forms = [self._of(c) for c in candidates if not c.extends]
        self.mark = len(model.store.prior)

    def _of(self, candidate: MotionCandidate, only: float | None = None) -> list[Variant]:
        """One variant for each value of the hyper-parameter that is tried, or for ``only`` one."""
        hypers: list[float | None] = [None] if candidate.hyper is None else list(candidate.hyper.values)
        if only is not None:
            hypers = [only]
        if len(candidate.joints) > 1:
            return [Variant(candidate, h, self._model.add(candidate, h)) for h in hypers]
        return self._model.add_of_one_joint([candidate] * len(hypers), hypers)

    def usual(self) -> list[list[Variant]]:
        """The candidates with which a selection starts, one at each location."""
        first: dict[tuple, list[Variant]] = {}
        for variants in self.forms:
            if variants[0].candidate.usual:
                first.setdefault(variants[0].candidate.location, variants)
        return list(first.values())

    def periodic(self, weights: np.ndarray, chosen: np.ndarray) -> list[list[Variant]]:
        """Periodic components of the present residual, in columns that ``forget_step`` removes."""
        model = self._model
        x = model.store.solve(model.store.normal(weights), chosen)
        found = [
            candidate
            for j, joint in enumerate(model.group.joints)
            for candidate in periodic_candidates(model.group, model.runs, joint, model.store.residual(j, chosen, x), model.store.training)
        ]
        return [[variant] for variant in model.add_of_one_joint(found, [_middle(c) for c in found])]

    def keep(self, variant: Variant) -> Variant:
        """The variant with columns that stay, whatever ``forget_step`` removes."""
        if len(variant.ids) and variant.ids[0] < self.mark:
            return variant
        self.forget_step()
        kept = Variant(variant.candidate, variant.hyper, self._model.add(variant.candidate, variant.hyper))
        self.mark = len(self._model.store.prior)
        return kept

    def forget_step(self) -> None:
        self._model.store.forget(self.mark)

    def extend(self, effect: SelectedEffect) -> None:
        """Offer the refinements of an effect that was selected; its columns and theirs stay."""
        candidate = effect.candidate
        if not candidate.extends:
            offered = {(v[0].candidate.location, v[0].candidate.variant) for v in self.forms}
            for refinement in self.candidates:
                known = (refinement.location, refinement.variant) in offered
                here = refinement.extends and refinement.location == candidate.location
                if here and not known and self._can_be_tested(refinement, candidate):
                    self.forms.append(self._of(refinement, effect.variant.hyper if refinement.shares_hyper else None))
        self.mark = len(self._model.store.prior)

    def _can_be_tested(self, refinement: MotionCandidate, candidate: MotionCandidate) -> bool:
        """A deviation that accumulates with time can only be tested on another motion, not on other moments of the same."""
        several = len({s.run for s in self._model.store.segments}) >= 2
        return not refinement.shares_hyper or (several and candidate.hyper is not None and not candidate.hyper.refine)


def _middle(candidate: MotionCandidate) -> float:
    assert candidate.hyper is not None
    return float(candidate.hyper.values[len(candidate.hyper.values) // 2])
