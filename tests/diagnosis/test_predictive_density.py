"""The predictive density of data left out, given the others."""

import numpy as np
import pytest
import simulated
from scipy.stats import multivariate_normal

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.nonparametric.joint_model import JointModel
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet
from mbcacq.diagnosis.validation import predictive_score
from mbcacq.diagnosis.validation.effect_sizes import with_estimated_prior
from mbcacq.estimation.posterior import Posterior
from mbcacq.estimation.whitened_columns import ColumnProducts


def test_predictive_density_is_that_of_the_multivariate_normal():
    """Against the plain formula: the mean and the covariance that the others foretell."""
    rng = np.random.default_rng(1)
    X, sigma, r = rng.normal(size=(30, 1, 4)), np.array([0.5, 2.0, 1.0, 3.0]), rng.normal(size=(30, 1))
    train, test = np.arange(30) < 20, np.arange(30) >= 20

    def of(which):
        A, b = X[which, 0], r[which, 0]
        return ColumnProducts(A.T @ A, A.T @ b, float(b @ b))

    known = Posterior(sigma, of(train))
    density = sum(known.predicted(of(test)))

    A, B = X[train, 0], X[test, 0]
    covariance = np.linalg.inv(A.T @ A + np.diag(1 / sigma**2))
    predicted = multivariate_normal(B @ covariance @ A.T @ r[train, 0], np.eye(10) + B @ covariance @ B.T)
    assert density == pytest.approx(-2 * predicted.logpdf(r[test, 0]) - 10 * np.log(2 * np.pi))
    assert known.solution == pytest.approx(covariance @ A.T @ r[train, 0])


def test_predictive_densities_obey_the_chain_rule(plan):
    """The chain rule: each given those before it, the surprises add up to that of all, whichever comes first."""
    observed = simulated.observe(plan, 141, [("joint_compliance", ("A2",), [2e-6], None)])
    setup = model_fit.prepare(observed)
    linear, station = setup.linear, observed.station[observed.pose]
    elastic = next(c for c in setup.candidates if c.key.startswith("joint_compliance:A2"))

    def chained(model, order):
        seen, total = np.isin(station, order[:2]), 0.0
        for k in order[2:]:
            total += predictive_score.held_out_score(linear, seen, station == k, model, (), setup.noise).negative_log_predictive_density
            seen = seen | (station == k)
        return total

    first, *rest = np.unique(station)[:6]
    ways = [chained(NO_EFFECTS, [first, rest[0], *order]) for order in (rest[1:], rest[:0:-1])]
    assert ways[0] == pytest.approx(ways[1], rel=1e-6)
    assert chained(EffectSet(((elastic, None),)), [first, *rest]) < ways[0] - 10


def test_poorly_determined_coefficients_stay_near_zero(plan):
    """A slip along the view is seen, its turn about the middle of the view is not: the prediction uses what is known of it."""
    observed = simulated.observe(plan, 142, [("mount_shift", ("mount",), [0.02, 0.0, 0.0, 0.0, 0.0, 0.0], 60.0)])
    setup = model_fit.prepare(observed)
    candidate = next(c for c in setup.candidates if c.name == "mount_shift")
    model = EffectSet(((candidate, 60.0),))
    joint = JointModel(setup.linear, model, (), setup.linear.whitener(setup.noise))
    parts, free = joint.effects, joint.posterior

    sized = with_estimated_prior(free, [candidate.typical], parts)

    shift, turn = parts[0].start, slice(parts[0].start + 3, parts[0].stop)
    assert sized.solution[shift] == pytest.approx(0.02, abs=0.004)
    assert np.linalg.norm(sized.solution[turn]) < np.linalg.norm(free.solution[turn])
    assert np.all(sized.sigma[parts[0]] < joint.sigma[parts[0]])


def test_a_model_that_leaves_more_than_noise_is_compared_by_chi2():
    sure, close = (
        predictive_score.PredictiveScore(1.0, 100, 310.0, 300.0, negative_log_predictive_density=50.0),
        predictive_score.PredictiveScore(1.0, 100, 305.0, 300.0, negative_log_predictive_density=60.0),
    )
    assert predictive_score.predicts_better(sure, close)
    assert not predictive_score.predicts_better(close, sure)

    wrong, less_wrong = (
        predictive_score.PredictiveScore(1.0, 100, chi2, 300.0, negative_log_predictive_density=s)
        for chi2, s in ((3000.0, 50.0), (2900.0, 60.0))
    )
    assert predictive_score.predicts_better(less_wrong, wrong)
    assert not predictive_score.predicts_better(wrong, less_wrong)
