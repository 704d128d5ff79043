"""Products of the columns of several models of a recording, over each part of its poses: what the models share is computed once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import add

import numpy as np

from mbcacq.diagnosis.nonparametric.joint_model import JointModel
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffect
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.predictive_score import HeldOutPrediction
from mbcacq.estimation.options import Noise
from mbcacq.estimation.whitened_columns import ColumnProducts


class SharedProducts:
    """Products over each of some parts of the poses. joint: of the fit of all data, in whose linearisation and under whose noise all is;
    its own products follow.

    Groups at all locations are a hundred times as many columns as effects, and the same without each part of the poses but for their sizes.
    """

    def __init__(self, joint: JointModel, models: Sequence[tuple[EffectSet, Sequence[RandomEffect]]], left_out: Sequence[np.ndarray]):
        """models: found without each part; left_out: (P,) bool of each."""
        self.linear, self.left_out = joint.linear, left_out
        every = [(joint.model, joint.random), *models]
        effects = {(m.candidate.key, m.hyper): m for model, _ in every for m in model.members}
        groups = {id(g.parts): g for _, random in every for g in random}
        together = JointModel(joint.linear, EffectSet(tuple(effects.values())), tuple(groups.values()), joint.whiten)
        self._parts = together.columns.products_of_parts(left_out)
        self._geometry = together.geometry
        self._own = dict(zip((*effects, *groups), (*together.effects, *together.groups), strict=True))
        joint.products = self.of(joint, range(len(left_out)))

    def of(self, joint: JointModel, parts: Iterable[int]) -> ColumnProducts:
        """The products of the columns of one of the models, over some parts."""
        own = [*((m.candidate.key, m.hyper) for m in joint.model.members), *(id(g.parts) for g in joint.random)]
        index = np.concatenate([self._geometry, *(np.arange(self._own[key].start, self._own[key].stop) for key in own)])
        return reduce(add, (self._parts[number].of_columns(index) for number in parts))

    def held_out(self, number: int, model: EffectSet, random: Sequence[RandomEffect], noise: Noise) -> HeldOutPrediction:
        """The prediction of a part by the model found without it."""
        keep, test = self.linear.keep, self.left_out[number][self.linear.obs.pose]
        others = [part for part in range(len(self.left_out)) if part != number]

        def products(joint: JointModel) -> tuple[ColumnProducts, ColumnProducts]:
            return self.of(joint, others), self.of(joint, [number])

        return HeldOutPrediction(self.linear, keep & ~test, keep & test, model, random, noise, products)
