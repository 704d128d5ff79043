"""One pattern of error in several joints is found with its offsets and directions; joints that have nothing in common are left apart."""

import numpy as np

from mbcacq.effects import unmodelled
from mbcacq.effects.common_pattern import OwnErrors, find_common_pattern
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
