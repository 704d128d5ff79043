"""What chance gives to effects of which each could be at several places."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from mbcacq.diagnosis.search.effect_prior import EffectPrior
from mbcacq.diagnosis.search.selection_criteria import FALSE_ALARM_RATE, FEWEST, SelectionCriteria


def elastic(joint, name="joint_compliance", positive=False, detectability=1.0, k=1):
    return SimpleNamespace(
        name=name, where=(f"A{joint}",), k=k, hyper=None, typical=np.full(k, 1e-6), positive=positive, detectability=detectability
    )


def alone(gain):
    return EffectPrior(np.array([gain]), np.ones(1))


@pytest.mark.parametrize("joints", [4, 6])
def test_the_best_pair_passes_by_chance_as_seldom_as_the_best_single_one(joints):
    candidates = [elastic(j) for j in range(1, joints + 1)]
    prices, rng = SelectionCriteria(candidates), np.random.default_rng(2)
    gains = np.sort(rng.normal(size=(400000, joints)) ** 2, axis=1)
    needed = prices.cost_together([(candidates[0], None), (candidates[1], None)], [alone(0.0), alone(0.0)])
    single = prices.threshold(candidates[0], None, [])

    pair, best = np.mean(gains[:, -1] + gains[:, -2] > needed), np.mean(gains[:, -1] > single)

    level = FALSE_ALARM_RATE / FEWEST * joints
    assert 0.3 * level < pair < level  # pairs share joints, so they are fewer than counted
    assert 0.7 * level < best < 1.2 * level


@pytest.mark.parametrize("together", [1, 2])
def test_of_what_only_yields_forwards_half_as_much_chance_passes(together):
    """As seldom as the same effects of either sign, with less to gain: the sign is known, so half the chances are none."""
    forwards = [elastic(j, positive=True) for j in range(1, 5)]
    both = [elastic(j) for j in range(1, 5)]
    z = np.random.default_rng(3).normal(size=(400000, 4))

    def needed(candidates):
        if together == 1:
            return SelectionCriteria(candidates).threshold(candidates[0], None, [])
        return SelectionCriteria(candidates).cost_together([(c, None) for c in candidates[:2]], [alone(0.0), alone(0.0)])

    def passed(z, least):
        return np.mean(np.sort(z**2, axis=1)[:, -together:].sum(axis=1) > least)

    level = FALSE_ALARM_RATE / FEWEST * 4
    assert needed(forwards) < needed(both) - 1.0
    assert 0.3 * level < passed(np.maximum(z, 0.0), needed(forwards)) < 1.2 * level


def test_all_places_of_all_kinds_together_pass_by_chance_as_seldom_as_stated():
    """The best of a hundred effects of noise, at sixty joints of one kind and forty of another."""
    many = [elastic(j) for j in range(60)] + [elastic(j, "joint_scale") for j in range(40)]
    prices = SelectionCriteria(many)
    gains = np.random.default_rng(5).normal(size=(40000, 100)) ** 2
    needed = np.array([prices.threshold(c, None, []) for c in many])

    assert np.mean((gains > needed).any(axis=1)) == pytest.approx(FALSE_ALARM_RATE, rel=0.15)
    assert np.ptp(needed) < 0.2


def test_effects_of_few_and_of_many_coefficients_need_the_same_multiple_of_what_a_test_needs_that_knows_them():
    """Nine in ten found by a chi2 test that is wrong once in a hundred: 1.3 times as strong, whatever the number of coefficients."""
    many = [elastic(j, name, k=k) for name, k, places in (("a", 1, 54), ("b", 2, 10), ("c", 3, 28), ("d", 6, 1)) for j in range(places)]
    prices = SelectionCriteria(many)

    def strength(k, limit):
        return brentq(lambda gain: ncx2.sf(limit, k, gain) - 0.9, 1e-3, 1e4) ** 0.5

    for name in "abcd":
        one = next(c for c in many if c.name == name)
        ratio = strength(one.k, prices.threshold(one, None, [])) / strength(one.k, chi2.isf(0.01, one.k))
        assert ratio == pytest.approx(1.295, abs=0.01)


def test_places_that_see_little_leave_their_chance_to_the_others_and_no_more():
    sights = (0.9, 0.8, 0.1, 0.1)
    candidates = [elastic(j, detectability=s) for j, s in enumerate(sights)]
    needed = np.array([SelectionCriteria(candidates).threshold(c, None, []) for c in candidates])
    alike = SelectionCriteria([elastic(j) for j in range(4)]).threshold(elastic(0), None, [])
    gains = np.random.default_rng(7).normal(size=(400000, 4)) ** 2

    assert needed[0] < alike - 0.7
    assert needed[2] > alike + 2.0
    assert 0.7 < np.mean((gains > needed).any(axis=1)) / (FALSE_ALARM_RATE / FEWEST * 4) < 1.2


def test_two_weak_joints_pass_together_where_neither_passes_alone():
    one, two = elastic(2), elastic(3)
    prices = SelectionCriteria([elastic(j) for j in range(1, 5)])
    owns = [alone(9.0), alone(9.0)]

    assert prices.cost(one, None, [], owns[0]) > 9.0
    assert (
        prices.cost(one, None, [], owns[0]) + prices.cost(two, None, [one], owns[1])
        > 18.0
        > prices.cost_together([(one, None), (two, None)], owns)
    )


def test_what_is_of_different_kinds_is_not_tested_as_one():
    other = elastic(2, "backlash")
    prices = SelectionCriteria([elastic(2), other])

    assert prices.cost_together([(elastic(2), None), (other, None)], [alone(9.0), alone(9.0)]) == np.inf
    assert prices.cost_together([(elastic(2), None)], [alone(9.0)]) == np.inf


def test_what_is_strong_where_little_is_seen_passes_too():
    """A scanner that only turned on its bracket moves the middle of its view by nothing."""
    turned = SimpleNamespace(name="mount_shift", where=("mount",), k=6, hyper=None, typical=np.ones(6), positive=False, detectability=1.0)
    prices = SelectionCriteria([turned])
    seen = np.array([1, 1, 1, 0.02, 0.02, 0.02])

    def score(gains):
        own = EffectPrior(np.array(gains), seen)
        return own.gain - prices.cost(turned, None, [], own)

    assert score([0.5, 0.2, 1.0, 30.0, 10.0, 20.0]) > 20
    assert score([8.0, 8.0, 8.0, 0.5, 0.2, 1.0]) > 0 > score([4.0, 4.0, 4.0, 4.0, 4.0, 4.0])
    strong = score([5e4, 4e4, 3e4, 1e3, 2e3, 1e3])
    assert strong > 0.99 * 1.24e5  # nothing of a plain effect is lost
