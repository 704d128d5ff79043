"""How well data left out agree with what the others predict."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.nonparametric.joint_model import JointModel
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet, Member
from mbcacq.diagnosis.validation import predictive_score
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import SharedProducts, with_estimated_prior
from mbcacq.estimation.whitened_columns import ColumnProducts, Posterior


def test_chi2_of_a_prediction_is_the_mahalanobis_distance():
    """Against the plain formula: the mean and the covariance that the others predict."""
    rng = np.random.default_rng(1)
    X, sigma, r = rng.normal(size=(30, 1, 4)), np.array([0.5, 2.0, 1.0, 3.0]), rng.normal(size=(30, 1))
    train, test = np.arange(30) < 20, np.arange(30) >= 20

    def of(which):
        A, b = X[which, 0], r[which, 0]
        return ColumnProducts(A.T @ A, A.T @ b, float(b @ b))

    known = Posterior(sigma, of(train))
    chi2 = known.predicted(of(test))

    A, B = X[train, 0], X[test, 0]
    covariance = np.linalg.inv(A.T @ A + np.diag(1 / sigma**2))
    away = r[test, 0] - B @ covariance @ A.T @ r[train, 0]
    assert chi2 == pytest.approx(away @ np.linalg.solve(np.eye(10) + B @ covariance @ B.T, away))
    assert known.solution == pytest.approx(covariance @ A.T @ r[train, 0])


def test_of_a_misfit_that_noise_alone_explains_no_effect_removes_a_share_beyond_its_scatter():
    """Without an excess there is nothing to take a share of: chi2 falls by what noise makes of it, up to twice its standard deviation."""

    def score(chi2):
        return predictive_score.PredictiveScore(square=1.0, count=150, chi2=chi2, dof=450.0)

    for before in (430.0, 450.0, 460.0):
        found = CrossValidation(score(before), score(before - 3.0), "station", without={"station_drift:station3": score(before)})
        share = found.gain("station_drift:station3")
        assert share == pytest.approx(3.0 / np.sqrt(2.0 * 450.0))
        assert share < 2.0 * found.gain_std(share) < 1.0


def test_an_effect_that_is_there_predicts_stations_left_out(large_plan):
    observed = simulated.observe(large_plan, 141, [("joint_compliance", ("A2",), [2e-6], None)])
    setup = prepare(observed)
    station = observed.station[observed.pose]
    elastic = next(c for c in setup.candidates if c.key.startswith("joint_compliance:A2"))
    train, test = station < station.max(), station == station.max()

    plain, known = (
        predictive_score.HeldOutPrediction(setup.linear, train, test, model, (), setup.noise).score()
        for model in (NO_EFFECTS, EffectSet((Member(elastic, None),)))
    )
    assert known.chi2 < plain.chi2 - 10
    assert known.square < plain.square


def test_scores_by_shared_products_are_those_of_each_model_by_itself(plan):
    setup = prepare(simulated.observe(plan, 141, [("joint_compliance", ("A2",), [2e-6], None)]))
    linear, station = setup.linear, setup.linear.obs.station
    elastic, other = (
        EffectSet((Member(next(c for c in setup.candidates if c.label == f"joint_compliance:{at}"), None),)) for at in ("A2", "A3")
    )
    left_out, models = [station % 2 == k for k in (0, 1)], [(elastic, ()), (NO_EFFECTS, ())]
    fit = JointModel(linear, other, (), linear.whitener(setup.noise))
    products = SharedProducts(fit, models, left_out)

    for number, (model, random) in enumerate(models):
        test = left_out[number][linear.obs.pose]
        alone = predictive_score.HeldOutPrediction(linear, linear.keep & ~test, linear.keep & test, model, random, setup.noise).score()
        shared = products.held_out(number, model, random, setup.noise).score()
        assert (shared.square, shared.chi2, shared.dof) == pytest.approx((alone.square, alone.chi2, alone.dof), rel=1e-9)
    assert fit.posterior.solution == pytest.approx(JointModel(linear, other, (), fit.whiten).posterior.solution, rel=1e-6)


def test_poorly_determined_coefficients_stay_near_zero(large_plan):
    """A slip along the view is seen, its turn about the middle of the view is not: the prediction uses what is known of it."""
    observed = simulated.observe(large_plan, 142, [("mount_shift", ("mount",), [0.02, 0.0, 0.0, 0.0, 0.0, 0.0], 60.0)])
    setup = prepare(observed)
    candidate = next(c for c in setup.candidates if c.name == "mount_shift")
    model = EffectSet((Member(candidate, 60.0),))
    joint = JointModel(setup.linear, model, (), setup.linear.whitener(setup.noise))
    parts, free = joint.effects, joint.posterior

    sized = with_estimated_prior(free, [candidate.typical], parts)

    shift, turn = parts[0].start, slice(parts[0].start + 3, parts[0].stop)
    assert sized.solution[shift] == pytest.approx(0.02, abs=0.004)
    assert np.linalg.norm(sized.solution[turn]) < np.linalg.norm(free.solution[turn])
    assert np.all(sized.sigma[parts[0]] < joint.sigma[parts[0]])
