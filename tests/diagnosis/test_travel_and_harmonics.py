"""Lost motion that fades with travel, and periodic errors over the field of view, are in no catalogue; both are located."""

from dataclasses import replace

import numpy as np
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.nonparametric.joint_model import coefficients_of
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.verdict import verdict_of
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import FAR
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import Displacements


def context_of(obs):
    state = simulated.nominal_state(obs)
    return Context(obs, state, forward_model.predict(obs, state))


def test_travel_follows_time_and_persists_while_a_joint_stands(plan):
    q = np.zeros((4, 6))
    q[:, 0] = [0.5, 0.1, 0.5, 0.8]
    direction = np.ones((4, 6))
    direction[:, 0] = [1, 1, -1, 1]
    four = plan.select(np.arange(plan.n_poses) < 4)
    s = context_of(replace(four, q=q, direction=direction, time_s=np.array([30.0, 10.0, 40.0, 50.0])))

    travel, reported = s.last_motions

    np.testing.assert_allclose(travel[:, 0], [0.4, FAR, 0.4, 0.3])
    np.testing.assert_array_equal(reported[:, 0], [1, 1, 1, 1])
    assert np.all(travel[:, 1] == FAR)


def short_memory_of_joint_four(s):
    travel, direction = s.last_motions
    joint = np.zeros(s.obs.q.shape)
    joint[:, 3] = -8e-4 * direction[:, 3] * np.exp(-travel[:, 3] / 0.2)
    return Displacements(joint=joint)


def test_lost_motion_that_fades_with_travel_is_not_explained_by_backlash(plan):
    found = model_fit.fit_model(prepare(simulated.observe(plan, 110, [short_memory_of_joint_four])))

    assert verdict_of(found) in ("unexplained", "partly_explained")
    assert (found.cells[0].location, found.cells[0].depends_on) == ("A4", "direction_4")


def test_fringes_across_the_field_are_located_in_the_scanner_with_their_period(large_plan):
    observed = simulated.observe(large_plan, 111)
    true = 0.03 * np.sin(2 * np.pi * observed.xyz[:, 1] / 14.0 + 0.4)

    found = model_fit.fit_model(prepare(replace(observed, xyz=observed.xyz + true[:, None] * [0, 0, 1])))

    first = found.cells[0]
    assert verdict_of(found) == "unexplained"
    assert (first.location, first.depends_on) == ("scanner", "y")
    (coefficients, _), linear = found.random_effects, found.geometry_only.linear
    each = zip(found.random, coefficients_of(found.random), strict=True)
    modelled = sum(linear.displacement(group.parts, coefficients[own]) for group, own in each)
    assert np.corrcoef(modelled[:, 2], true)[0, 1] > 0.95
