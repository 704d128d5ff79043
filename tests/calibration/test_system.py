"""The pieces of the estimator against plain linear algebra: columns, whitening, elimination of the stations."""

import numpy as np
import pytest
from cells import iiwa, scanner_cell, tracker_cell

from mbcacq.estimation import parameters, variance_components, whitening
from mbcacq.estimation.adjustment import adjust_recording
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.normal_equations import Normal
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import NOISE_GAIN, most_probable_noise, solve
from mbcacq.estimation.terms import Part, term


def simulated(kind, rng, more=1):
    if kind == "tracker":
        return tracker_cell(rng, poses=12 * more)
    if kind == "tracker with orientation":
        return tracker_cell(rng, poses=12 * more, orientation=True)
    return scanner_cell(rng, stations=2, per_station=3 * more, chain=iiwa() if kind == "seven axes" else None)


KINDS = ["scanner", "seven axes", "tracker", "tracker with orientation"]


@pytest.mark.parametrize("kind", KINDS)
def test_columns_of_every_parameter_are_derivatives(kind):
    rng = np.random.default_rng(1)
    cell = simulated(kind, rng)
    obs = cell.observations
    effect = term("effect", [Part("joint", 1, 0, rng.normal(size=(obs.n_poses, 2)))])
    options = CalibrationOptions(terms=(effect,))
    layout = parameters.build(obs, options)
    lineariser = Lineariser(obs, layout, options)
    at = Estimate(cell.truth, (np.zeros(2),))
    g = layout.size
    columns = lineariser.rows.unpad(lineariser.at(lineariser.evaluate(at)).dense)
    stations = len(cell.truth.T_base_station)
    for j, name in enumerate(layout.names):
        step = np.zeros(g)
        step[j] = 1e-4
        difference = (
            lineariser.evaluate(at.moved(layout, -step, np.zeros((stations, 6)))).residual
            - lineariser.evaluate(at.moved(layout, step, np.zeros((stations, 6)))).residual
        )
        np.testing.assert_allclose(columns[..., j], difference / 2e-4, atol=1e-3, rtol=1e-5, err_msg=name)
    for c in range(6):
        twist = np.zeros((stations, 6))
        twist[:, c] = 1e-4
        difference = (
            lineariser.evaluate(at.moved(layout, np.zeros(g), -twist)).residual
            - lineariser.evaluate(at.moved(layout, np.zeros(g), twist)).residual
        )
        np.testing.assert_allclose(columns[..., g + c], difference / 2e-4, atol=1e-3, rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_solution_gave_back_is_made_again(kind):
    """Under its own noise, at the residual of a step within its linear problem, and from the start of that step under another noise."""
    rng = np.random.default_rng(6)
    cell = simulated(kind, rng)
    obs, options = cell.observations, CalibrationOptions()
    lineariser = Lineariser(obs, parameters.build(obs, options), options)
    noise, other = (Noise(np.full(3, 0.01 * k), np.full(obs.cell.robot.n, 1e-5), 2e-4) for k in (1, 2))
    start = system(lineariser, Estimate(cell.truth), noise, Weights(rng.uniform(0.5, 1, obs.n_centres), np.ones(obs.n_poses)))
    at = start.stepped(start.normal.gauss_newton_step(lineariser.layout.scale))

    def figures():
        again = at.reweighted(other, at.weights)
        squares = at.poses.chi2(start.there.rows), again.cost
        return *squares, *at.poses.products(), *at.poses.right_hand_side(), at.there.prediction.xyz, again.normal.information

    before = figures()
    for columns_too in (False, True):
        at.forget(columns_too)
        for one, same in zip(figures(), before, strict=True):
            np.testing.assert_array_equal(one, same)


@pytest.mark.parametrize("kind", KINDS)
def test_whitening_is_the_inverse_covariance_of_each_pose(kind):
    rng = np.random.default_rng(2)
    cell = simulated(kind, rng)
    obs = cell.observations
    options = CalibrationOptions()
    lineariser = Lineariser(obs, parameters.build(obs, options), options)
    noise = Noise(np.array([0.01, 0.02, 0.03]), rng.uniform(1e-5, 1e-4, obs.cell.robot.n), 2e-4)
    weights = Weights(rng.uniform(0.5, 1, obs.n_centres), rng.uniform(0.5, 1, obs.n_poses))
    solution = system(lineariser, Estimate(cell.truth), noise, weights)
    rows = lineariser.rows
    identity = np.tile(np.eye(rows.depth * rows.width), (obs.n_poses, 1, 1))
    W = solution.whitening(identity)
    inverse = np.swapaxes(W, 1, 2) @ W
    np.testing.assert_allclose(solution.whitening.transpose(identity), np.swapaxes(W, 1, 2), rtol=1e-9, atol=1e-9)
    sigma2 = np.tile(noise.row_sigma(rows.width) ** 2, rows.depth)
    for p in range(obs.n_poses):
        J = solution.columns.of_joints[p] * noise.joint
        weight = np.repeat(weights.centre[obs.pose == rows.order[p]], rows.width)
        covariance = (np.diag(sigma2 / weight) + J @ J.T) / weights.pose[rows.order[p]]
        np.testing.assert_allclose(inverse[p] @ covariance, np.eye(len(covariance)), atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_elimination_of_stations_gives_the_step_and_covariance_of_the_dense_system(kind):
    rng = np.random.default_rng(3)
    cell = simulated(kind, rng)
    obs = cell.observations
    # Few poses: a handful of parameters, so that the dense system is regular.
    options = CalibrationOptions(kinematics=False)
    layout = parameters.build(obs, options)
    lineariser = Lineariser(obs, layout, options)
    noise = Noise(np.array([0.01, 0.02, 0.03]), np.full(obs.cell.robot.n, 1e-5), 1e-4)
    now = system(lineariser, Estimate(cell.truth), noise, lineariser.everything)
    g, stations = layout.size, len(lineariser.rows.stations)
    dense = np.zeros((now.X.shape[0], now.X.shape[1], g + 6 * stations))
    dense[..., :g] = now.X[..., :g]
    for p in range(obs.n_poses):
        s = lineariser.rows.run[p]
        dense[p, :, g + 6 * s : g + 6 * s + 6] = now.X[p, :, g : g + 6]
    A = dense.reshape(-1, dense.shape[2])
    r = now.X[..., -1].reshape(-1)
    H = A.T @ A + np.diag(np.concatenate([1 / now.prior.sigma**2, np.zeros(6 * stations)]))
    expected = np.linalg.solve(H, A.T @ r - np.concatenate([now.prior.offset / now.prior.sigma**2, np.zeros(6 * stations)]))
    step = now.normal.gauss_newton_step(layout.scale, 0.0)
    np.testing.assert_allclose(step, expected[:g], rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(now.normal.station_step(step).reshape(-1), expected[g:], rtol=1e-5, atol=1e-9)
    C = np.linalg.inv(H)
    np.testing.assert_allclose(np.linalg.inv(now.normal.information), C[:g, :g], rtol=1e-5, atol=1e-14)
    for s, block in enumerate(now.normal.station_covariance(C[:g, :g])):
        part = slice(g + 6 * s, g + 6 * s + 6)
        np.testing.assert_allclose(block, C[part, part], rtol=1e-4, atol=1e-12)


def test_redundant_parameters_are_held_by_name():
    rng = np.random.default_rng(4)
    layout = parameters.build(scanner_cell(rng, stations=1, per_station=2).observations, CalibrationOptions(balls=False))
    assert layout.names == (
        "a_1",
        "alpha_1",
        "theta_2",
        "a_2",
        "alpha_2",
        "beta_2",
        "theta_3",
        "d_3",
        "a_3",
        "alpha_3",
        "theta_4",
        "d_4",
        "a_4",
        "alpha_4",
        "theta_5",
        "d_5",
        "a_5",
        "alpha_5",
        *(f"hand_eye.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")),
    )
    assert {"theta_1", "d_1", "d_2", "beta_3", "theta_6", "beta_6"} <= set(layout.held)


def weighted_system(kind, rng, hold=(), kinematics=True, more=1):
    """A system with an effect, with centres and poses rejected, and its normal equations from whitened rows."""
    cell = simulated(kind, rng, more)
    obs = cell.observations
    effect = term("effect", [Part("joint", 1, 0, rng.normal(size=(obs.n_poses, 2)))], sigma=1e-4)
    options = CalibrationOptions(terms=(effect,), hold=hold, kinematics=kinematics)
    layout = parameters.build(obs, options)
    lineariser = Lineariser(obs, layout, options)
    noise = Noise(np.array([0.01, 0.02, 0.03]), rng.uniform(1e-5, 1e-4, obs.cell.robot.n), 2e-4)
    weights = Weights((rng.uniform(size=obs.n_centres) > 0.1).astype(float), (rng.uniform(size=obs.n_poses) > 0.1).astype(float))
    at = system(lineariser, Estimate(cell.truth, (np.zeros(2),)), noise, weights)
    return lineariser, at, normal_of_rows(lineariser.rows, at.X, at.prior)


def normal_of_rows(rows, X, prior):
    """Normal equations summed over whitened rows X (P, B R, g + 7)."""
    g = X.shape[2] - 7
    whole = np.einsum("pmi,pmj->ij", X, X)
    shared = np.add.reduceat(np.swapaxes(X[..., g : g + 6], 1, 2) @ X, rows.first, axis=0)
    products = whole[:g, :g], shared[..., g : g + 6], shared[..., :g]
    return Normal(rows, products, (whole[:g, -1], shared[..., g + 6], whole[-1, -1]), prior)


def dense_noise_score(at):
    """Gradient and average information by the log sigmas, from the covariance matrix V of all rows and the formulas of the textbook."""
    rows, noise, X, J = at.normal.rows, at.noise, at.columns.dense, at.columns.of_joints
    g, (P, m) = at.normal.size, X.shape[:2]
    used = (at.whitening.scale[..., 0] > 0).reshape(-1)
    columns = np.zeros((P, m, g + 6 * len(rows.stations)))
    columns[..., :g] = X[..., :g]
    for p in range(P):
        first = g + 6 * rows.run[p]
        columns[p, :, first : first + 6] = X[p, :, g : g + 6]
    axis = np.tile(np.minimum(np.arange(rows.width), 3), P * rows.depth)
    sigma2 = np.r_[noise.point, noise.turn] ** 2
    parts = [np.diag(np.where(axis == c, sigma2[c], 0.0)) for c in range(4)]  # V is the sum of its parts
    for j in range(len(noise.joint)):
        part = np.zeros((P, m, P, m))
        for p in range(P):
            part[p, :, p] = noise.joint[j] ** 2 * np.outer(J[p, :, j], J[p, :, j])
        parts.insert(3 + j, part.reshape(P * m, P * m))
    parts = [part[np.ix_(used, used)] for part in parts]
    Z, r = columns.reshape(P * m, -1)[used], X[..., -1].reshape(-1)[used]
    inverse_root = np.linalg.inv(np.linalg.cholesky(sum(parts)))
    inverse = inverse_root.T @ inverse_root
    known = np.diag(np.r_[1 / at.prior.sigma, np.zeros(Z.shape[1] - g)])  # rows of the prior
    A = np.concatenate([inverse_root @ Z, known])
    U, value, _ = np.linalg.svd(A / np.linalg.norm(A, axis=0), full_matrices=False)
    fitted = U[: len(Z), value > 1e-6]
    projection = inverse_root.T @ (np.eye(len(Z)) - fitted @ fitted.T) @ inverse_root
    images = np.stack([part @ inverse @ r for part in parts], axis=1)
    gradient = [r @ inverse @ part @ inverse @ r - np.sum(projection * part) for part in parts]
    return np.array(gradient), 2 * images.T @ projection @ images


@pytest.mark.parametrize("hold", [(), ("ball_1.x",)], ids=["balls free", "one coordinate held"])
@pytest.mark.parametrize("kind", KINDS)
def test_twists_of_the_poses_give_the_normal_equations_of_the_whitened_rows(kind, hold):
    if hold and kind.startswith("tracker"):
        hold = ("theta_2",)
    _, at, rows = weighted_system(kind, np.random.default_rng(4), hold)
    normal = at.normal
    size = np.sqrt(np.diag(rows.information))
    np.testing.assert_allclose(normal.information / np.outer(size, size), rows.information / np.outer(size, size), rtol=0, atol=1e-9)
    np.testing.assert_allclose(normal.gradient / size, rows.gradient / size, rtol=0, atol=1e-9 * np.sqrt(rows.cost))
    np.testing.assert_allclose(normal.cost, rows.cost, rtol=1e-12)
    step = normal.gauss_newton_step(np.ones(normal.size), 1e-3)
    np.testing.assert_allclose(normal.station_step(step), rows.station_step(step), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("part", [3, 2], ids=["stations cut", "whole stations"])
@pytest.mark.parametrize("kind", KINDS)
def test_blocks_of_poses_give_what_all_poses_at_once_give(kind, part, monkeypatch):
    def of_blocks():
        lineariser, at, _ = weighted_system(kind, np.random.default_rng(10), more=2)
        step = at.normal.gauss_newton_step(lineariser.layout.scale, 1e-3)
        moved = at.stepped(step)
        sizes = np.sqrt(np.diag(at.normal.information))
        scores = variance_components.reml_score_and_information(at.system, at.noise)
        found = at.normal.information / np.outer(sizes, sizes), at.normal.gradient / sizes, moved.step.stations, *scores
        chi2 = at.poses.chi2(moved.columns.residual)
        found = *found, at.cost, at.poses.log_det, chi2, moved.residual, at.poses.right_hand_side()[1]
        return len(at.poses.blocks), at.columns.residual.size, found

    count, rows, whole = of_blocks()
    assert count == 1
    monkeypatch.setattr(whitening, "ROWS_AT_ONCE", rows / part)
    count, _, parts = of_blocks()
    assert count >= part
    for one, other in zip(parts, whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-8 * np.abs(other).max())


@pytest.mark.parametrize("kind", KINDS)
def test_noise_scores_are_those_of_the_dense_covariance(kind):
    _, at, _ = weighted_system(kind, np.random.default_rng(5), more=4)
    score, information = variance_components.reml_score_and_information(at.system, at.noise)
    expected, average = dense_noise_score(at)
    np.testing.assert_allclose(score, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(information, average, rtol=1e-5, atol=1e-6 * np.abs(average).max())


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_within_the_linear_problem_leads_where_its_normal_equations_say(kind):
    lineariser, at, _ = weighted_system(kind, np.random.default_rng(6))
    step = 1e-3 * at.normal.gauss_newton_step(lineariser.layout.scale, 1e-3)
    there = at.stepped(step)
    again = Normal(lineariser.rows, there.poses.products(), there.poses.right_hand_side(), there.prior)
    size = np.sqrt(np.diag(again.information))
    np.testing.assert_allclose(there.normal.gradient / size, again.gradient / size, rtol=0, atol=1e-8 * np.sqrt(at.cost))
    np.testing.assert_allclose(there.cost, again.cost, rtol=1e-9)
    assert not there.exact


@pytest.mark.parametrize("kind", KINDS)
def test_noise_scores_are_derivatives_of_the_log_posterior(kind):
    lineariser, at, _ = weighted_system(kind, np.random.default_rng(7), kinematics=False)
    prior = variance_components.noise_prior(lineariser.obs.cell)
    theta = variance_components.pack(at.noise)

    def fitted(theta):
        there = at.reweighted(variance_components.unpack(theta), at.weights)
        return there.stepped(there.normal.gauss_newton_step(lineariser.layout.scale, 0.0)).system

    def log_posterior(theta):
        return variance_components.log_restricted_posterior(fitted(theta), variance_components.unpack(theta), prior)

    score, _ = variance_components.reml_score_and_information(fitted(theta), at.noise)
    difference = [(log_posterior(theta + e) - log_posterior(theta - e)) / 2e-4 for e in 1e-4 * np.eye(len(theta))]
    np.testing.assert_allclose(score - prior.precision @ (theta - prior.centre), difference, rtol=1e-4, atol=1e-3)


def test_the_adjusted_noise_is_where_its_log_posterior_is_largest():
    # Joints a hundred times as noisy as the data sheet says: far from where the search begins.
    obs = scanner_cell(np.random.default_rng(8), stations=6, joint_rad=1e-3).observations
    found = adjust_recording(obs, CalibrationOptions(refuse=False))
    prior = variance_components.noise_prior(obs.cell)
    theta = variance_components.pack(found.noise)

    def log_posterior(theta):
        noise = variance_components.unpack(theta)
        there = found.solution.reweighted(noise, found.weights)
        step = there.normal.gauss_newton_step(found.lineariser.layout.scale, 0.0)
        return variance_components.log_restricted_posterior(there.stepped(step).system, noise, prior)

    here = log_posterior(theta)
    assert all(log_posterior(theta + s * e) < here + NOISE_GAIN for e in np.eye(len(theta)) for s in (-0.2, -0.02, 0.02, 0.2))


def test_columns_are_kept_while_nothing_turns_and_made_anew_otherwise():
    lineariser, begin, _ = weighted_system("scanner", np.random.default_rng(9), kinematics=False)
    at = system(lineariser, solve(begin).estimate, begin.noise, begin.weights)
    step = lineariser.layout.scale
    near, far = at.stepped(1e-6 * step), at.stepped(0.02 * step)
    for there, kept in ((near, True), (far, False)):
        again = there.evaluated()
        assert again.exact
        assert (again.columns.basis is at.columns.basis) == kept
        np.testing.assert_allclose(again.residual, lineariser.evaluate(again.estimate).residual, rtol=0, atol=1e-12)
        normal = system(lineariser, again.estimate, at.noise, at.weights).normal
        np.testing.assert_allclose(again.cost, normal.cost, rtol=1e-7)


def test_noise_that_was_taken_far_too_large_comes_down_without_swinging():
    """Components that share one excess overshoot together; at a given estimate their steps swing by more each time unless they are halved."""
    cell = simulated("tracker", np.random.default_rng(9), more=4)
    found = adjust_recording(cell.observations, CalibrationOptions())
    prior = variance_components.noise_prior(cell.observations.cell)
    large = Noise(30 * found.noise.point, 30 * found.noise.joint, 30 * found.noise.turn)

    def refit(at, noise):
        return at.reweighted(noise, found.weights)

    at = system(found.lineariser, found.solution.estimate, large, found.weights)
    reached = [variance_components.log_restricted_posterior(at.system, at.noise, prior)]
    for _ in range(10):
        at = most_probable_noise(refit, at, 1)
        reached.append(variance_components.log_restricted_posterior(at.system, at.noise, prior))
    assert np.all(np.diff(reached) > -NOISE_GAIN)
    assert reached[-1] - reached[-2] < NOISE_GAIN
    assert np.all(variance_components.pack(large) - variance_components.pack(at.noise) > 2.0)
