"""The evidence of effects: e-values, their gradients, what they decide on small and badly described recordings."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from scipy.integrate import dblquad, quad
from scipy.stats import multivariate_normal, norm

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.evidence.between_sets import likeness
from mbcacq.diagnosis.evidence.evidence_fit import fit_evidence
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.moments import sizes_with, with_others
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.posterior import alternatives_of
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.output.sufficient_poses import coefficient_limit
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.bayes_factor import log_bayes_factors, log_set_bayes_factor
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.estimation.variance_components import pack
from mbcacq.model.computed_once import ComputedOnce

SIZES = np.array([0.3, 1.0, 3.0])


GEAR, ELASTIC, BASE = ("gear_transmission_error", ("A1",)), ("joint_compliance", ("A2",)), ("base_compliance", ("base",))


@pytest.fixture(scope="module")
def small():
    """28 poses at four places of an artefact."""
    return simulated.plan(4, 0, 7)


def test_a_bayes_factor_is_one_on_average_where_there_is_nothing():
    rng = np.random.default_rng(1)
    A = np.array([[2.0, 0.5], [0.5, 1.0]])
    a = rng.multivariate_normal(np.zeros(2), A, 200_000)
    logs = log_bayes_factors(np.broadcast_to(A, (len(a), 2, 2)), a, np.array([0.3, 0.6]))
    assert np.mean(np.exp(logs)) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("positive", [False, True])
def test_a_bayes_factor_is_the_integral_over_the_coefficient(positive):
    A, a, s = 2.0, 3.0, 0.7
    low, factor = (0.0, 2.0) if positive else (-20.0, 1.0)
    value, _ = quad(lambda x: factor * norm.pdf(x, 0, s) * np.exp(a * x - 0.5 * A * x * x), low, 20.0)
    log = log_bayes_factors(np.array([[[A]]]), np.array([[a]]), np.array([s]), positive)
    assert log[0] == pytest.approx(np.log(value), abs=1e-6)


def test_a_set_of_one_effect_has_the_evidence_of_that_effect():
    A, a = np.array([[4.0, 1.0], [1.0, 3.0]]), np.array([5.0, -2.0])
    together, _ = log_set_bayes_factor(A, a, [slice(0, 2)], [SIZES], [False])
    assert together == pytest.approx(log_bayes_factors(A[None], a[None], SIZES)[0])


def test_independent_effects_multiply_their_evidence():
    A, a = np.diag([4.0, 3.0]), np.array([5.0, -2.0])
    together, _ = log_set_bayes_factor(A, a, [slice(0, 1), slice(1, 2)], [SIZES, SIZES], [False, False])
    each = [log_bayes_factors(A[None, j : j + 1, j : j + 1], a[None, j : j + 1], SIZES)[0] for j in (0, 1)]
    assert together == pytest.approx(sum(each))


def test_the_evidence_of_effects_that_share_data_is_the_density_of_the_data():
    """With coefficients integrated out, residuals are normal with X S X' + I: by the density itself, for effects of one to three columns."""
    rng = np.random.default_rng(6)
    X, sizes = rng.normal(size=(9, 6)), [0.7, 2.0, 0.3]
    r = rng.normal(size=9) + X @ rng.normal(size=6)
    slices = [slice(0, 2), slice(2, 3), slice(3, 6)]
    sigma = np.repeat(sizes, [2, 1, 3])
    found, _ = log_set_bayes_factor(X.T @ X, X.T @ r, slices, [np.array([s]) for s in sizes], [False] * 3)
    there, nothing = (multivariate_normal(cov=cov).logpdf(r) for cov in (np.eye(9) + (X * sigma**2) @ X.T, np.eye(9)))
    assert found == pytest.approx(there - nothing)


@pytest.mark.parametrize("bounded", [0, 1])
def test_an_effect_of_known_sign_beside_another_is_integrated_over_one_half(bounded):
    A, a, sizes = np.array([[4.0, 1.5], [1.5, 3.0]]), np.array([1.0, -2.0]), [0.7, 2.0]

    def density(y, x):
        c = np.array([x, y])
        return 2 * np.prod(norm.pdf(c, 0, sizes)) * np.exp(a @ c - 0.5 * c @ A @ c)

    low = [0.0 if j == bounded else -12.0 for j in (0, 1)]
    value, _ = dblquad(density, low[0], 12.0, low[1], 12.0)
    found, _ = log_set_bayes_factor(A, a, [slice(0, 1), slice(1, 2)], [np.array([s]) for s in sizes], [bounded == 0, bounded == 1])
    assert found == pytest.approx(np.log(value), abs=1e-6)


def beside_geometry(linear, columns):
    """Geometry and columns (M, R, k) of coefficients without a prior."""
    return linear.extended(columns, np.full(columns.shape[2], np.inf))


def test_the_gradient_by_the_noise_is_the_derivative_of_its_likelihood(small):
    setup = prepare(simulated.observe(small, 11))
    prior, nothing = setup.prior_noise, beside_geometry(setup.linear, np.zeros((*setup.linear.residual.shape, 0)))
    point = NoisePoint(setup.linear, prior, prior.centre)
    gradient, _ = point.with_effects(nothing).score(np.zeros(0))
    for c in (0, 2, 4):
        step = 1e-4 * (np.arange(len(prior.centre)) == c)
        above, below = (replace(point, theta=point.theta + sign * step).with_effects(nothing).log_likelihood for sign in (1, -1))
        assert gradient[c] == pytest.approx((above - below) / 2e-4, rel=1e-3, abs=1e-2)


def test_the_gradient_with_an_effect_is_that_of_its_integrated_likelihood(small):
    setup = prepare(simulated.observe(small, 11, [("joint_compliance", ("A2",), [2e-6], None)]))
    prior = setup.prior_noise
    point = NoisePoint(setup.linear, prior, prior.centre)
    effect = next(c for c in setup.candidates if c.name == "joint_compliance" and c.where == ("A3",))
    columns = beside_geometry(setup.linear, candidate_columns(setup.linear, effect) * effect.typical)

    def log_likelihood(theta):
        there = replace(point, theta=theta).with_effects(columns)
        return there.log_likelihood + log_bayes_factors(there.A[None], there.a[None], np.array([2.0]))[0]

    gradient, _ = point.with_effects(columns).score(np.array([2.0**-2]))
    for c in (0, 4):
        step = 1e-4 * (np.arange(len(prior.centre)) == c)
        numeric = (log_likelihood(point.theta + step) - log_likelihood(point.theta - step)) / 2e-4
        assert gradient[c] == pytest.approx(numeric, rel=1e-3, abs=1e-2)


def test_stations_may_be_eliminated_or_projected_out(small):
    setup = prepare(simulated.observe(small, 11))
    point = NoisePoint(setup.linear, setup.prior_noise, setup.prior_noise.centre)
    for name, where in (("backlash", ("A2",)), ("joint_compliance", ("A3",)), ("scanner_scale", ("scanner",))):
        effect = next(c for c in setup.candidates if c.name == name and c.where == where)
        eliminated = point.with_effects(beside_geometry(setup.linear, candidate_columns(setup.linear, effect) * effect.typical))
        _, S, b = point.projected.candidate_products(effect, None)
        assert eliminated.A == pytest.approx(S * np.outer(effect.typical, effect.typical), rel=1e-6)
        assert eliminated.a == pytest.approx(b * effect.typical, rel=1e-5, abs=1e-6)


def test_blocks_made_of_sums_equal_those_made_of_whitened_columns(small):
    setup = prepare(simulated.observe(small, 11, [("joint_compliance", ("A2",), [2e-6], None)]))
    effect = next(c for c in setup.candidates if c.name == "joint_compliance" and c.where == ("A2",))
    plain = CandidateScoring.of(setup.linear, setup.noise)
    projected = plain.conditioned_on([(plain.block(effect, None), effect.typical**-2.0)])
    evidence = EvidenceMap(projected, setup.design_blocks.groups).evaluate(projected)
    basis = np.concatenate([projected.Q, projected.conditioned], axis=1)
    for number, log in list(enumerate(evidence.log_bayes_factor))[::60]:
        X = projected.whiten(candidate_columns(setup.linear, setup.design_blocks.candidate(number)))
        typical = setup.design_blocks.candidate(number).typical / np.linalg.norm(X, axis=0)
        S, b = X.T @ X - (basis.T @ X).T @ (basis.T @ X), X.T @ projected.r
        assert log == pytest.approx(log_bayes_factors((S * np.outer(typical, typical))[None], (b * typical)[None])[0], rel=1e-5, abs=1e-4)


def test_sizes_at_other_orders_are_those_of_a_fit_with_all_columns(small):
    """The coefficients of a gear at three orders beside an elastic joint: by geometry and both effects in one least-squares problem."""
    setup = prepare(simulated.observe(small, 11, [("joint_compliance", ("A2",), [2e-6], None)]))
    gear, elastic = (next(c for c in setup.candidates if (c.name, c.where) == of) for of in (GEAR, ELASTIC))
    point, orders = NoisePoint(setup.linear, setup.prior_noise, setup.prior_noise.centre), np.array([2.0, 2.5, 3.7])
    member, beside = Member(gear, 2.0), Member(elastic, None, size=1.0)
    hypothesis = Hypothesis((member, beside), point, 0.0)
    found = sizes_with(with_others(hypothesis, member), member, orders)
    geometry, sigma = setup.linear.nuisance()
    sigma = np.concatenate([sigma, member.sizes[-1] * gear.typical, elastic.typical])
    whiten = setup.linear.whitener(point.complete_noise)
    for order, sizes in zip(orders, found, strict=True):
        effects = [candidate_columns(setup.linear, gear, float(order)), candidate_columns(setup.linear, elastic)]
        X = whiten(np.concatenate([geometry, *effects], axis=2)) * sigma
        whole = sigma * np.linalg.solve(X.T @ X + np.eye(len(sigma)), X.T @ whiten(setup.linear.residual))
        np.testing.assert_allclose(sizes, whole[-3:-1], rtol=1e-5, atol=1e-5 * np.abs(whole[-3:-1]).max())


@pytest.mark.parametrize("stated", [0.2, 1.0, 5.0])
def test_a_small_clean_recording_is_clean_whatever_noise_is_stated(small, stated):
    obs = simulated.observe(small, 31)
    obs = replace(obs, cell=replace(obs.cell, noise_mm=obs.cell.noise_mm * stated))
    found = diagnose(obs, folds=2)
    assert found.verdict == "none"
    assert found.effects == ()
    assert any("what is stated" in note for note in found.notes) == (stated != 1.0)
    assert 0.8 < found.fit.held_out.before_chi2_dof < 1.25


def test_every_effect_has_alternatives_with_their_odds(small):
    found = diagnose(simulated.observe(small, 32, [("backlash", ("A2",), [2e-4], None)]), folds=2)
    assert found.verdict == "explained"
    (effect,) = found.effects
    assert (effect.name, effect.where) == ("backlash", ("A2",))
    assert effect.alternatives
    assert all(a.odds is not None and a.odds < 0.05 for a in effect.alternatives)


def test_alternatives_of_parallel_joints_name_the_other_joint(small):
    fit = fit_evidence(prepare(simulated.observe(small, 33, [("joint_scale", ("A2",), [2e-4], None)])))
    assert "joint_scale:A3" in alternatives_of(fit, fit.best, "joint_scale:A2")


def test_what_two_sets_explain_is_alike_by_the_dense_covariance_of_the_rows(small):
    """The elasticity of A2 against that of the base: coefficients, and the correlation of what both explain beyond the geometry, from
    the normal equations of the evidence and from the matrix of all whitened rows.
    """
    setup = prepare(simulated.observe(small, 34, [(*ELASTIC, [4e-6], None)]))
    point = NoisePoint(setup.linear, setup.prior_noise, pack(setup.noise))
    one, other = (Member(next(c for c in setup.candidates if (c.name, c.where) == of), None) for of in (ELASTIC, BASE))
    ours, theirs = point.solved([one]), point.solved([other])

    whiten, (columns, sigma) = setup.linear.whitener(setup.noise), setup.linear.nuisance()
    Z, r = whiten(columns * sigma), whiten(setup.linear.residual[..., None])[:, 0]
    rows, nothing = np.concatenate([Z, np.eye(len(sigma))]), np.zeros(len(sigma))  # a row for each prior

    def left(y):
        return y - Z @ np.linalg.lstsq(rows, np.r_[y, nothing], rcond=None)[0]

    X = [whiten(candidate_columns(setup.linear, m.candidate, None) * m.candidate.typical) for m in (one, other)]
    found = [(x[:, 0] @ left(r)) / (x[:, 0] @ left(x[:, 0]) + 1.0) for x in X]
    assert ours.coefficients == pytest.approx(found[0] * one.candidate.typical, rel=1e-6)
    a, b = (x[:, 0] * c for x, c in zip(X, found, strict=True))
    expected = abs(a @ left(b)) / np.sqrt((a @ left(a)) * (b @ left(b)))
    assert 0.3 < expected < 0.999
    assert likeness(Hypothesis((one,), point, 0.0), ours, theirs) == pytest.approx(expected, rel=1e-6)


def test_nineteen_of_twenty_true_sizes_are_below_their_limit(small):
    """A joint scale of three standard deviations, under noise that is known: 95 %, within what 1000 trials allow."""
    setup = prepare(simulated.observe(small, 60))
    scale = next(c for c in setup.candidates if c.name == "joint_scale" and c.where == ("A5",))
    projected = CandidateScoring.of(setup.linear, setup.noise)
    X, S, _ = projected.candidate_products(scale, None)
    true = 3.0 / np.sqrt(S[0, 0])
    rng, below = np.random.default_rng(3), 0
    for _ in range(1000):
        r0 = true * X[:, 0] + rng.normal(size=len(X))
        drawn = replace(projected, r0=r0, known=ComputedOnce(candidates={(scale.key, None): (X, S, projected_onto(projected, X, r0))}))
        below += coefficient_limit(drawn, scale).coefficients[0] >= true
    assert 0.93 < below / 1000 < 0.97


def projected_onto(projected, X, r0):
    return X.T @ (r0 - projected.Q @ (projected.Q.T @ r0))
