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


def test_what_is_strong_where_little_is_seen_passes_too():
    """A scanner that only turned on its bracket moves the middle of its view by nothing."""
    turned = SimpleNamespace(name="mount_shift", where=("mount",), k=6, hyper=None, typical=np.ones(6))
    prices = Prices([turned])
    seen = np.array([1, 1, 1, 0.02, 0.02, 0.02])

    def score(gains):
        own = Strengths(np.array(gains), seen)
        return own.gain - prices.cost(turned, None, [], own)

    assert score([0.5, 0.2, 1.0, 30.0, 10.0, 20.0]) > 20
    assert score([8.0, 8.0, 8.0, 0.5, 0.2, 1.0]) > 0 > score([4.0, 4.0, 4.0, 4.0, 4.0, 4.0])
    strong = score([5e4, 4e4, 3e4, 1e3, 2e3, 1e3])
    assert strong > 0.99 * 1.24e5  # nothing of a plain effect is lost
