"""The size of an effect of a long recording is stated with what random effects at all locations could do in its place."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.nonparametric.joint_model import RandomEffect
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates

SOFT = 5e-6


@pytest.fixture(scope="module")
def found(plan):
    observed = simulated.observe(plan, 12, [("joint_compliance", ("A2",), [SOFT], None)])
    problem = prepare(observed)
    fit = model_fit.fit_model(replace(problem, candidates=[c for c in problem.candidates if c.name == "joint_compliance"]))
    assert [m.candidate.where for m in fit.model.members] == [("A2",)]
    return fit


def beside(found, *groups):
    here = Covariates(found.geometry_only.linear.obs)
    random = tuple(RandomEffect.of(here, replace(group, sigma=group.sigma * scale)) for group, scale in groups)
    return replace(found, random=random, estimated=None)


def test_a_size_is_that_of_least_squares_with_the_random_effects_as_correlated_noise(found):
    linear = found.geometry_only.linear
    own = unmodelled.group(Covariates(linear.obs), "A2", "q2")
    stated, covariance = beside(found, (own, 0.1)).stated(0)

    whiten = found.geometry_only.whiten
    (member,) = found.model.members
    geometry = found.joint.known[:, :, : len(found.joint.geometry)]
    effect = candidate_columns(linear, member.candidate, member.hyper)
    group = linear.columns(RandomEffect.of(Covariates(linear.obs), own).parts) * (0.1 * own.sigma)
    G, X, E, y = (whiten(one).reshape(-1, one.shape[-1]) for one in (group, geometry, effect, linear.residual[..., None]))
    noise = np.eye(len(y)) + G @ G.T  # random effects are noise of covariance G G'
    sigma = found.joint.sigma[: geometry.shape[2] + 1]
    columns = np.c_[X, E] * sigma
    weighted = np.linalg.solve(noise, np.c_[columns, y])
    inverse = np.linalg.inv(columns.T @ weighted[:, :-1] + np.eye(len(sigma)))

    np.testing.assert_allclose(covariance[0, 0], sigma[-1] ** 2 * inverse[-1, -1], rtol=1e-6)
    np.testing.assert_allclose(stated[0], sigma[-1] * (inverse @ columns.T @ weighted[:, -1])[-1], rtol=1e-6)
    assert abs(stated[0] - SOFT) < 4 * np.sqrt(covariance[0, 0])
    assert covariance[0, 0] > 1.3 * found.model.covariance[0, 0]


def test_a_group_at_its_place_of_its_covariate_is_the_effect_itself(found):
    here = Covariates(found.geometry_only.linear.obs)
    same, other = unmodelled.group(here, "A2", "gravity_torque_2"), unmodelled.group(here, "A3", "q3")
    alone, with_it = (beside(found, *groups).stated(0) for groups in (((other, 0.1),), ((other, 0.1), (same, 1.0))))

    np.testing.assert_allclose(with_it[0], alone[0], rtol=1e-9)
    np.testing.assert_allclose(with_it[1], alone[1], rtol=1e-9)


def test_without_random_effects_at_all_locations_it_is_that_of_the_search(found):
    coefficients, covariance = found.stated(0)

    np.testing.assert_array_equal(coefficients, found.model.coefficients)
    np.testing.assert_array_equal(covariance, found.model.covariance)
