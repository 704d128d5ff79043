"""The candidates of the catalogue of motion with their columns, and which of them may be selected next.

Periodic components in a joint's own angle are proposed by a Fourier transform of the residual, summed in fine steps of angle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Candidate
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals
from mbcacq.effects.motion_periods import periodic_component, range_of_orders


def periodic_candidates(
    group: ChannelGroup, runs: tuple[MotionSignals, ...], joint: int, residual: np.ndarray, training: np.ndarray
) -> list[Candidate]:
    """Candidates for the strongest spectral lines of a residual (Ttot,): the strongest, the strongest above its background, and those
    near one and two periods per motor turn. training: (Ttot,) which samples take part."""
    effect = catalogue.periodic_in(group.name)
    limits = None if effect is None else range_of_orders(effect[1].lowest_order, runs, joint)
    if effect is None or limits is None:
        return []
    lowest, highest, spacing = limits
    q = np.concatenate([run.q[:, joint] for run in runs])
    observed = (float(q[training > 0].min()), float(q[training > 0].max()))
    power, orders = _power(q, residual * training, limits, NUMBERS.spectrum_oversampling)
    if len(power) < 3:
        return []
    tried = (highest - lowest) / spacing
    found = [(float(orders[i]), tried) for i in _strongest(power, NUMBERS.background_orders)]
    ratio = runs[0].gear_ratio
    motor_orders = [] if ratio is None else [turns * abs(float(ratio[joint])) for turns in (1, 2)]
    for motor_order in motor_orders:
        near = np.flatnonzero(np.abs(orders - motor_order) <= spacing)
        if len(near):
            found.append((float(orders[near[np.argmax(power[near])]]), NUMBERS.motor_order_trials))
    return [periodic_component(effect, joint, group.axes[joint], order, spacing / 2, trials, observed) for order, trials in found]


def _power(q: np.ndarray, residual: np.ndarray, limits: tuple[float, float, float], oversampling: int) -> tuple[np.ndarray, np.ndarray]:
    """Power of a residual (Ttot,) over the angle q, and its orders, both within the limits."""
    lowest, highest, spacing = limits
    step = 2 * np.pi / (highest * oversampling)
    bins = np.round((q - float(q.min())) / step).astype(int)
    length = int(2 ** np.ceil(np.log2(max(oversampling * 2 * np.pi / spacing / step, bins.max() + 2))))
    power = np.abs(np.fft.rfft(np.bincount(bins, residual, minlength=length), length)) ** 2
    orders = 2 * np.pi * np.arange(len(power)) / (length * step)
    inside = (orders >= lowest) & (orders <= highest)
    return power[inside], orders[inside]


def _strongest(power: np.ndarray, background: int) -> set[int]:
    """Positions of the strongest line and of the strongest one above the geometric mean of its ``background`` neighbours."""
    picks = {int(np.argmax(power))}
    if len(power) > 2 * background:
        kernel = np.ones(background) / background
        ground = np.exp(np.convolve(np.pad(np.log(power + 1e-300), background // 2, mode="edge"), kernel, mode="valid"))
        picks.add(int(np.argmax(power / ground[: len(power)])))
    return picks


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

    def kept(self, effect: Member) -> Member:
        """The effect in columns that stay, whatever ``forget_step`` removes."""
        if len(effect.columns) and effect.columns[0] < self.mark:
            return effect
        self.forget_step()
        columns = self._model.add(effect.candidate, effect.hyper)
        self.mark = len(self._model.store.prior)
        return replace(effect, columns=columns)

    def forget_step(self) -> None:
        self._model.store.forget(self.mark)

    def extend(self, effect: Member) -> None:
        """Offer the refinements of an effect that was selected; its columns and theirs stay."""
        candidate = effect.candidate
        if not candidate.rows.extends:
            offered = {v[0].candidate.form for v in self.forms}
            for refinement in self.candidates:
                known = refinement.form in offered
                here = refinement.rows.extends and refinement.location == candidate.location
                if here and not known and self._can_be_tested(refinement, candidate):
                    self.forms.append(self._of(refinement, effect.hyper if refinement.rows.shares_hyper else None))
        self.mark = len(self._model.store.prior)

    def untested(self) -> list[np.ndarray]:
        """Add the columns of the refinements of selected effects that cannot be tested here. Returns their numbers."""
        slow = [e for e in self._model.selected if e.candidate.hyper is not None and not e.candidate.hyper.refine]
        own = [(r, e) for e in slow for r in self.candidates if r.rows.shares_hyper and r.location == e.candidate.location]
        return [self._model.add(r, e.hyper) for r, e in own if not self._can_be_tested(r, e.candidate)]

    def _can_be_tested(self, refinement: Candidate, candidate: Candidate) -> bool:
        """A deviation that accumulates with time can only be tested on another motion, not on other moments of the same."""
        several = len({run for run, *_ in self._model.store.segments}) >= 2
        return not refinement.rows.shares_hyper or (several and candidate.hyper is not None and not candidate.hyper.refine)


def _middle(candidate: Candidate) -> float:
    assert candidate.hyper is not None
    return float(candidate.hyper.values[len(candidate.hyper.values) // 2])
