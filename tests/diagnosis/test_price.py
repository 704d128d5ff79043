"""What chance gives to effects of which each could be at several places."""

from types import SimpleNamespace

import numpy as np
import pytest

from mbcacq.diagnosis.price import FALSE_ALARM, FAMILIES, Prices
from mbcacq.diagnosis.strengths import Strengths


def elastic(joint):
    return SimpleNamespace(name="joint_compliance", where=(f"A{joint}",), k=1, hyper=None, typical=np.array([1e-6]))


def alone(gain):
    return Strengths(np.array([gain]), np.ones(1))


@pytest.mark.parametrize("joints", [4, 6])
def test_the_best_pair_passes_by_chance_as_seldom_as_the_best_single_one(joints):
    candidates = [elastic(j) for j in range(1, joints + 1)]
    prices, rng = Prices(candidates), np.random.default_rng(2)
    gains = np.sort(rng.normal(size=(400000, joints)) ** 2, axis=1)
    needed = prices.cost_together([(candidates[0], None), (candidates[1], None)], [alone(0.0), alone(0.0)])
    single = prices.threshold(candidates[0], None, [])

    pair, best = np.mean(gains[:, -1] + gains[:, -2] > needed), np.mean(gains[:, -1] > single)

    level = FALSE_ALARM / FAMILIES
    assert 0.3 * level < pair < level  # pairs share joints, so they are fewer than counted
    assert 0.7 * level < best < 1.2 * level


def test_two_weak_joints_pass_together_where_neither_passes_alone():
    one, two = elastic(2), elastic(3)
    prices = Prices([elastic(j) for j in range(1, 5)])
    owns = [alone(9.0), alone(9.0)]

    assert prices.cost(one, None, [], owns[0]) > 9.0
    assert prices.cost(one, None, [], owns[0]) + prices.cost(two, None, [one], owns[1]) > 18.0 > prices.cost_together([(one, None), (two, None)], owns)


def test_what_is_of_different_kinds_is_not_tested_as_one():
    other = SimpleNamespace(name="backlash", where=("A2",), k=1, hyper=None, typical=np.array([3e-5]))
    prices = Prices([elastic(2), other])

    assert prices.cost_together([(elastic(2), None), (other, None)], [alone(9.0), alone(9.0)]) == np.inf
    assert prices.cost_together([(elastic(2), None)], [alone(9.0)]) == np.inf
