"""The gain of an effect is what chi2 falls by when it is fitted."""

import numpy as np
import pytest
import simulated
from likelihood_gain import best_hyper, gain_at, gains

from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.bayes_factor import prior_weight
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring

ORDER = 3.0


@pytest.fixture(scope="module")
def problem(plan):
    return prepare(simulated.observe(plan, 161, [("gear_transmission_error", ("A2",), [6e-5, 3e-5], ORDER)]))


@pytest.fixture(scope="module")
def projected(problem):
    return CandidateScoring.of(problem.linear, problem.noise)


def candidate(problem, name, location):
    return next(c for c in problem.candidates if (c.name, c.where) == (name, (location,)))


@pytest.mark.parametrize(("name", "hyper"), [("joint_scale", None), ("gear_transmission_error", ORDER)])
def test_gain_is_the_fall_of_chi2(problem, projected, name, hyper):
    one = candidate(problem, name, "A2")

    fitted = projected.conditioned_on([(projected.block(one, hyper), prior_weight(one))])

    assert gain_at(projected, one, hyper).gain == pytest.approx(projected.chi2 - fitted.chi2, rel=1e-6)


def test_gains_of_a_scan_are_those_of_each_value(problem, projected):
    gear = candidate(problem, "gear_transmission_error", "A2")
    orders = np.array([2.0, ORDER, 4.5])

    each = [gain_at(projected, gear, float(order)).gain for order in orders]

    np.testing.assert_allclose(gains(projected, gear, orders), each, rtol=1e-6)


def test_the_true_order_gains_most(problem, projected):
    assert best_hyper(projected, candidate(problem, "gear_transmission_error", "A2")).hyper == pytest.approx(ORDER, abs=0.1)
