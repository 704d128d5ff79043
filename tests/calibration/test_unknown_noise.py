"""What is stated of an estimate by few poses counts that its noise is itself an estimate."""

import numpy as np
from cells import scanner_cell

from mbcacq.estimation.adjustment import adjust_recording
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.solution import covariance_of, covariance_under_its_noise
from mbcacq.estimation.variance_components import log_restricted_posterior, pack, reml_score_and_information, unpack

ALONE = CalibrationOptions(kinematics=False, refuse=False)


def solved(per_station, stations=1):
    made = scanner_cell(np.random.default_rng(7), stations=stations, per_station=per_station)
    return adjust_recording(made.observations, ALONE).solution.evaluated()


def averaged_over_the_noise(at, draws):
    """Mean covariance plus covariance of the estimates, over the restricted posterior itself: a broader normal density is drawn from, and
    every draw weighs what the posterior is beside it."""
    prior, middle = at.lineariser.noise_prior, pack(at.noise)
    _, information = reml_score_and_information(at.system, at.noise)
    drawn = (information + prior.precision)[:-1, :-1] / 1.5
    theta = np.tile(middle, (draws, 1))
    theta[:, :-1] = np.random.default_rng(0).multivariate_normal(middle[:-1], np.linalg.inv(drawn), draws)
    log_weight, covariances, steps = np.empty(draws), [], []
    for k, one in enumerate(theta):
        noise = unpack(one)
        there = at.reweighted(noise, at.weights)
        off = (one - middle)[:-1]
        log_weight[k] = log_restricted_posterior(there.system.after_fit(), noise, prior) + 0.5 * off @ drawn @ off
        covariances.append(covariance_under_its_noise(there))
        steps.append(there.normal.gauss_newton_step(there.lineariser.layout.scale))
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    assert 1 / np.sum(weight**2) > 0.1 * draws, "the draws do not cover the posterior"
    off = np.array(steps) - weight @ np.array(steps)
    return np.einsum("k,kij->ij", weight, np.array(covariances)) + off.T @ (weight[:, None] * off)


def test_ten_poses_state_the_average_over_what_their_noise_may_be():
    at = solved(10)
    mounted = [k for k, name in enumerate(at.lineariser.layout.names) if name.startswith("hand_eye.")]
    each = covariance_of(at), averaged_over_the_noise(at, 1500), covariance_under_its_noise(at)
    stated, average, plain = (np.sqrt(np.diag(C))[mounted] for C in each)
    assert np.max(np.abs(plain / average - 1)) > 0.08
    np.testing.assert_allclose(stated, average, rtol=0.04)


def test_many_poses_state_the_same_as_under_their_noise():
    at = solved(20, stations=5)
    np.testing.assert_array_equal(covariance_of(at), covariance_under_its_noise(at))
    few = solved(12, stations=5)
    np.testing.assert_allclose(np.diag(covariance_of(few)), np.diag(covariance_under_its_noise(few)), rtol=0.1)
