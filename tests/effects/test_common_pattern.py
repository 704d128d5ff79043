"""One pattern of error in several joints is found with its offsets and directions; joints that have nothing in common are left apart."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mbcacq.effects import unmodelled
from mbcacq.effects.common_pattern import JointAlignment, OwnErrors, PatternComparison, find_common_pattern
from mbcacq.effects.effect_model import EffectModel
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel

COUNT = 24
ORDERS = np.arange(1, COUNT + 1).astype(float)
SIZE = 1e-4 * np.tile(ORDERS**2 / (ORDERS**2 + 25) / (1 + (ORDERS / 16) ** 4), 2)
NOISE = 5e-5


def pattern(rng):
    return SIZE * rng.standard_normal(2 * COUNT)


def basis(x):
    phase = np.outer(x, ORDERS)
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


def errors_of(curves, ranges, rng):
    """What 400 measurements of each joint's error, at angles in its ranges (deg), say of its sines and cosines; an offset of each joint
    is free, as the geometry is."""
    k, joints = 2 * COUNT, sorted(curves)
    g = (k + 1) * len(joints)
    information, right, index = np.zeros((g, g)), np.zeros(g), {}
    for number, i in enumerate(joints):
        each = [np.radians(rng.uniform(low, high, 400 // len(ranges[i]))) for low, high in ranges[i]]
        q = np.concatenate(each)
        A = np.c_[basis(q), np.ones(len(q))] / NOISE
        y = (curves[i](q) + 2e-4) / NOISE + rng.standard_normal(len(q))
        own = np.arange((k + 1) * number, (k + 1) * (number + 1))
        information[np.ix_(own, own)], right[own], index[i] = A.T @ A, A.T @ y, own[:-1]
    deviation = np.tile(np.where(ORDERS < 5, 1e-5, 3e-6), 2)
    return OwnErrors(information, right, index, dict.fromkeys(joints, SIZE), SIZE, deviation)


def test_offsets_and_directions_of_a_shared_pattern_are_found():
    rng = np.random.default_rng(1)
    f = pattern(rng)
    true = {0: (0.7, 1), 1: (2.0, 1), 2: (5.1, -1), 4: (3.3, 1)}
    seen = {0: [(0, 200)], 1: [(150, 330)], 2: [(20, 170)], 4: [(200, 350), (0, 60)]}
    found = find_common_pattern(errors_of({i: lambda x, o=o, d=d: d * (basis(d * x - o) @ f) for i, (o, d) in true.items()}, seen, rng))
    assert found is not None
    assert found.joints == (0, 1, 2, 4)
    turn = found.direction[0] * true[0][1]  # the pattern itself may be mirrored
    for i, offset, direction in zip(found.joints, found.offset, found.direction, strict=True):
        assert direction * turn == true[i][1]
        relative = (offset - found.offset[0]) - turn * (true[i][0] - true[0][0])
        assert abs(np.mod(relative + np.pi, 2 * np.pi) - np.pi) < np.radians(1.0)


def test_a_joint_that_the_first_ones_keep_out_is_taken_in_once_more_of_the_pattern_is_known():
    """Six joints that were each seen over a part of a turn: three of them show too little of the pattern for the others."""
    rng = np.random.default_rng(127)
    f = pattern(rng)
    true = {i: (rng.uniform(0, 2 * np.pi), int(rng.choice([1, -1]))) for i in range(6)}
    parts = [(rng.uniform(70, 170), rng.uniform(-180, 180)) for _ in true]
    seen = {i: [(low, low + width)] for i, (width, low) in enumerate(parts)}
    found = find_common_pattern(errors_of({i: lambda x, o=o, d=d: d * (basis(d * x - o) @ f) for i, (o, d) in true.items()}, seen, rng))
    assert found is not None
    assert found.joints == (0, 1, 2, 3, 4, 5)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_bayes_factor_of_an_offset_is_that_of_two_gaussians_of_the_measurements(direction):
    """Sines and cosines of three orders, by the covariance of what was measured instead of the normal equations of coefficients."""
    rng = np.random.default_rng(4)
    order, noise, k = np.arange(1, 4), 3e-5, 6
    q0, q1 = rng.uniform(0, 2.5, 30), rng.uniform(1, 4.5, 40)

    def sines(x):
        return np.concatenate([np.sin(np.outer(x, order)), np.cos(np.outer(x, order))], axis=1)

    pattern, own, deviation = (np.tile(size * rng.uniform(0.5, 2, 3), 2) for size in (1e-4, 8e-5, 1e-5))
    y = np.concatenate([sines(q0) @ (pattern * rng.standard_normal(k)), sines(q1) @ (own * rng.standard_normal(k))])
    y += 1e-4 + noise * rng.standard_normal(70)
    X = np.zeros((70, 14))
    X[:30, :6], X[30:, 6:12], X[:30, 12], X[30:, 13] = sines(q0), sines(q1), 1, 1
    errors = OwnErrors(
        X.T @ X / noise**2, X.T @ y / noise**2, {0: np.arange(6), 1: np.arange(6, 12)}, dict.fromkeys((0, 1), own), pattern, deviation
    )
    offsets = np.array([0.0, 0.4, 3.3])
    found = PatternComparison.of(errors, {0: JointAlignment(0.0, 1, 0.0, 1.0)}, 1).log_bayes_factors(offsets, direction)
    free = 0.1**2 * X[:, 12:] @ X[:, 12:].T + noise**2 * np.eye(70)  # an offset of each joint is as good as free

    def covariance(of_pattern, beside, size):
        A, B = np.zeros((70, k)), np.zeros((70, k))
        A[:30], A[30:], B[30:] = sines(q0), of_pattern, beside
        first = X[:, :6] * deviation
        return (A * pattern) @ (A * pattern).T + first @ first.T + (B * size) @ (B * size).T + free

    apart = multivariate_normal.logpdf(y, np.zeros(70), covariance(0.0, sines(q1), own))
    for offset, log_bayes_factor in zip(offsets, found, strict=True):
        follows = direction * sines(direction * q1 - offset)
        together = multivariate_normal.logpdf(y, np.zeros(70), covariance(follows, sines(q1), deviation))
        assert log_bayes_factor == pytest.approx(together - apart, abs=1e-4)


def test_joints_with_nothing_in_common_stay_apart():
    for seed in range(2):
        rng = np.random.default_rng(seed)
        own = {i: pattern(rng) for i in range(4)}
        seen = {i: [(0, 150)] for i in own}
        assert find_common_pattern(errors_of({i: lambda x, p=p: basis(x) @ p for i, p in own.items()}, seen, rng)) is None


def test_a_joint_with_an_error_of_its_own_stays_apart():
    rng = np.random.default_rng(6)
    f, other = pattern(rng), pattern(rng)
    curves = {i: lambda x, o=o: basis(x - o) @ f for i, o in enumerate((0.0, 1.0, 2.5))} | {3: lambda x: basis(x) @ other}
    found = find_common_pattern(errors_of(curves, {i: [(0, 300)] for i in curves}, rng))
    assert found is not None
    assert found.joints == (0, 1, 2)


def test_the_term_of_a_pattern_turns_each_joint_by_its_own_copy():
    rng = np.random.default_rng(3)
    chain = Chain(*np.zeros((6, 3)))
    robot = RobotModel("arm", chain, np.tile([-3.0, 3.0], (3, 1)), np.zeros(3), np.zeros((3, 3)))
    obs = EffectModel(robot).poses(rng.uniform(-3, 3, (30, 3)))
    term = unmodelled.common_pattern(unmodelled.Covariates(obs), [0.4, 2.2], [1, -1], [0, 2])
    values = rng.standard_normal(term.k)
    orders = np.arange(1, 61)
    moved = EffectModel(robot, (term.__class__(**{**term.__dict__, "coefficients": values}),)).displacements(obs)
    assert moved is not None
    joint = moved.joint
    assert joint is not None

    def f(x):
        return np.sin(np.outer(x, orders)) @ values[:60] + np.cos(np.outer(x, orders)) @ values[60:]

    np.testing.assert_allclose(joint[:, 0], f(obs.q[:, 0] - 0.4), atol=1e-9)
    np.testing.assert_allclose(joint[:, 1], 0)
    np.testing.assert_allclose(joint[:, 2], -f(-obs.q[:, 2] - 2.2), atol=1e-9)
