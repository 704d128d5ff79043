"""What is reported agrees with the held-out table: a joint that a model makes worse keeps none, and a bound is no estimate."""

from types import SimpleNamespace

import numpy as np
import pytest

from mbcacq.diagnosis.motion.assemble import HeldOutTable
from mbcacq.diagnosis.motion.fit import at_bound
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Hyperparameter
from mbcacq.effects.kinds.drive_lag import LAGS_S, LOOPS_S


def fit(*effects):
    group = SimpleNamespace(joints=(0, 2), index=(0, 2).index)
    parts = [
        SimpleNamespace(candidate=SimpleNamespace(rows=SimpleNamespace(joints=joints)), gain=np.array(gain)) for joints, gain in effects
    ]
    return SimpleNamespace(group=group, effects=parts, held_out_before=np.ones(2), held_out_after=np.ones(2), floor=np.full(2, 0.1))


def test_a_joint_that_gets_worse_on_held_out_data_is_refused():
    table = HeldOutTable.of(fit(((0,), [3.0, 0.0]), ((2,), [0.0, 5.0])), np.array([[4.0, 4.0], [1.0, 9.0]]))
    assert table.refused.tolist() == [False, True]
    assert table.after.tolist() == [1.0, 4.0]
    assert [table.keeps(effect) for effect in table.fit.effects] == [True, False]


def test_effects_of_a_joint_remove_together_what_the_table_says():
    table = HeldOutTable.of(fit(((0,), [6.0, 0.0]), ((0, 2), [2.0, 1.0])), np.array([[4.0, 4.0], [1.0, 2.0]]))
    assert sum(table.gains).tolist() == pytest.approx([3.0, 2.0])
    assert sum(table.share(gain, [0]) for gain in table.gains) == pytest.approx(3.0 / (4.0 - 0.01))


@pytest.mark.parametrize(("hyper", "bound"), [(LOOPS_S[-1], True), (LOOPS_S[0], True), (2.2, False)])
def test_a_value_at_the_end_of_what_was_tried_is_a_bound(hyper, bound):
    candidate = SimpleNamespace(hyper=Hyperparameter("A1.time_constant_s", LOOPS_S, 4.0), least_size=0.0)
    assert at_bound(Member(candidate, hyper)) == bound


def test_no_lag_at_all_is_a_value():
    candidate = SimpleNamespace(hyper=Hyperparameter("A1.time_constant_s", LAGS_S, 4.0, from_none=True), least_size=0.0)
    assert not at_bound(Member(candidate, LAGS_S[0]))
