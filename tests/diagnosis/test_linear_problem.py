"""A linearisation is never changed: restrictions and other residuals are new objects that share what depends on the linearisation alone."""

import dataclasses
import pickle

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.problem import prepare
from mbcacq.estimation import forward_model, parameters
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.terms import Part
from mbcacq.estimation.variance_components import reml_score_and_information


@pytest.fixture(scope="module")
def linear(plan):
    return prepare(plan).linear


def test_a_restriction_leaves_the_linear_problem_as_it_was(linear):
    none = np.zeros(len(linear.keep), bool)

    restricted = linear.restricted(none)

    assert linear.keep.any()
    assert not restricted.keep.any()
    assert restricted.unit("joint", 0, 0) is linear.unit("joint", 0, 0)


def test_a_linear_problem_cannot_be_written_to(linear):
    with pytest.raises(dataclasses.FrozenInstanceError):
        linear.residual = np.zeros(3)


def test_a_pickled_linear_problem_has_the_same_columns(linear):
    linear.computed_once("not to be sent", lambda: lambda: None)

    received = pickle.loads(pickle.dumps(linear))

    np.testing.assert_array_equal(received.residual, linear.residual)
    np.testing.assert_array_equal(received.unit("frame", 2, 4), linear.unit("frame", 2, 4))


def test_a_pickled_context_has_the_same_covariates_and_computes_them_anew(plan):
    context = prepare(plan).context
    context.computed_once(("not to be sent",), lambda: lambda: None)

    received = pickle.loads(pickle.dumps(context))

    for name in ("q2", "gravity_torque_2", "time", "axis_z"):
        np.testing.assert_array_equal(received.value(name), context.value(name))


@pytest.mark.parametrize("shown", [1, 2])
def test_effects_as_twists_of_a_pose_of_few_rows_give_what_their_own_columns_give(plan, shown):
    """One or two centres a pose have no more rows than a twist has components."""
    first = np.flatnonzero(np.r_[True, np.diff(plan.pose) != 0])
    few = np.isin(np.arange(plan.n_centres), first[:, None] + np.arange(shown))
    obs = dataclasses.replace(plan, pose=plan.pose[few], ball=plan.ball[few], xyz=plan.xyz[few])
    layout = parameters.build(obs, CalibrationOptions(balls=False))
    linear = LinearProblem.of(obs, simulated.nominal_state(obs), layout=layout)
    assert linear.columns_by_pose.by_rows
    own = dataclasses.replace(linear, columns_by_pose=dataclasses.replace(linear.columns_by_pose, by_rows=False))
    columns = np.random.default_rng(0).normal(size=(*linear.residual.shape, 4))
    noise = Noise(np.array([0.01, 0.02, 0.03]), np.full(6, 2e-5), 1e-4)
    one, other = (problem.extended(columns, np.full(4, 0.1)).at(noise) for problem in (linear, own))
    assert other.poses.columns.own.size == one.poses.columns.own.size + 4
    size = np.sqrt(np.diag(other.normal.information))
    np.testing.assert_allclose(one.normal.information / np.outer(size, size), other.normal.information / np.outer(size, size), atol=1e-9)
    np.testing.assert_allclose(one.normal.gradient / size, other.normal.gradient / size, atol=1e-6 * np.sqrt(one.normal.cost))
    for a, b in zip(reml_score_and_information(one, noise), reml_score_and_information(other, noise), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6 * np.abs(b).max())


@pytest.mark.parametrize("shown", [1, 8])
def test_what_turns_a_joint_gives_as_a_twist_what_its_columns_give(plan, shown):
    """The normal equations of a group of a joint's functions, with balls free, are those of its columns in another order."""
    obs = plan
    if shown == 1:
        first = np.flatnonzero(np.r_[True, np.diff(plan.pose) != 0])
        obs = dataclasses.replace(plan, pose=plan.pose[first], ball=plan.ball[first], xyz=plan.xyz[first])
    linear = LinearProblem.of(obs, simulated.nominal_state(obs))
    parts = [Part("joint", 1, 0, np.random.default_rng(0).normal(size=(obs.n_poses, 3))), Part("frame", 3, 4, np.ones((obs.n_poses, 3)))]
    sigma, noise = np.array([1e-4, 2e-4, 3e-4]), Noise(np.array([0.01, 0.02, 0.03]), np.full(6, 2e-5), 1e-4)
    one = linear.extended_by_twists(linear.twists_of(parts), sigma).at(noise).normal
    other = linear.extended(linear.columns(parts), sigma).at(noise).normal
    first, g = linear.columns_by_pose.twists.shape[2], linear.columns_by_pose.size
    order = np.r_[:first, g : g + 3, first:g]
    size = np.sqrt(np.diag(one.information))
    np.testing.assert_allclose(
        one.information / np.outer(size, size), other.information[np.ix_(order, order)] / np.outer(size, size), atol=1e-9
    )
    np.testing.assert_allclose(one.gradient / size, other.gradient[order] / size, atol=1e-6 * np.sqrt(one.cost))


def test_covariances_that_measurements_state_leave_residual_and_columns_on_one_scale(linear):
    """A step along a free parameter changes the residual by its column, whatever the measurements state of themselves."""
    obs = linear.obs
    sigma = np.where(np.arange(obs.n_centres) % 2, 0.005, 0.5)
    stated = dataclasses.replace(obs, covariance=sigma[:, None, None] ** 2 * np.eye(3))
    problem = LinearProblem.of(stated, linear.state)
    chain, h = linear.state.chain, 1e-6
    name = next(n for n in problem.layout.names if n.startswith("alpha_2"))
    moved = dataclasses.replace(linear.state, chain=dataclasses.replace(chain, alpha=chain.alpha + h * (np.arange(chain.n) == 1)))
    slope = (
        forward_model.residual(obs, forward_model.predict(obs, linear.state))
        - forward_model.residual(obs, forward_model.predict(obs, moved))
    ) / h
    assert np.allclose(problem.geometry[:, :, problem.layout.names.index(name)], slope, atol=1e-3 * np.abs(slope).max())
