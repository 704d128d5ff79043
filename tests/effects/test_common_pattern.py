"""One pattern of error in several joints is found with its offsets and directions; joints that have nothing in common are left apart."""

import numpy as np

from mbcacq.effects import unmodelled
from mbcacq.effects.common_pattern import Curve, find_common_pattern
from mbcacq.effects.effect_model import EffectModel
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel

ORDERS = np.arange(1, 41).astype(float)


def pattern(rng):
    size = ORDERS**2 / (ORDERS**2 + 25) / (1 + (ORDERS / 20) ** 4)
    return size * rng.standard_normal(40), size * rng.standard_normal(40)


def errs(pattern, x):
    phase = np.outer(x, ORDERS)
    return np.sin(phase) @ pattern[0] + np.cos(phase) @ pattern[1]


def curve_of(f, ranges, rng):
    """The curve of a joint that visited some ranges (deg), of which f is the error."""
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    spectrum = np.fft.rfft(f(angle)) / 360
    q = np.concatenate([np.radians(rng.uniform(low, high, int(20 * (high - low)))) for low, high in ranges])
    return Curve.of(q, ORDERS, -spectrum.imag[1:41], spectrum.real[1:41])


def test_offsets_and_directions_of_a_shared_pattern_are_found():
    rng = np.random.default_rng(1)
    f = pattern(rng)
    true = {0: (0.7, 1), 1: (2.0, 1), 2: (5.1, -1), 4: (3.3, 1)}
    seen = {0: [(0, 200)], 1: [(150, 330)], 2: [(20, 170)], 4: [(200, 350), (0, 60)]}
    curves = {i: curve_of(lambda x, o=o, d=d: d * errs(f, d * x - o), seen[i], rng) for i, (o, d) in true.items()}
    found = find_common_pattern(curves)
    assert found is not None
    assert found.joints == (0, 1, 2, 4)
    turn = found.direction[0] * true[0][1]  # the pattern itself may be mirrored
    for i, offset, direction in zip(found.joints, found.offset, found.direction, strict=True):
        assert direction * turn == true[i][1]
        relative = (offset - found.offset[0]) - turn * (true[i][0] - true[0][0])
        assert abs(np.mod(relative + np.pi, 2 * np.pi) - np.pi) < np.radians(1.0)


def test_joints_with_nothing_in_common_stay_apart():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        own = [pattern(rng) for _ in range(5)]
        curves = {i: curve_of(lambda x, p=p: errs(p, x), [(0, 150)], rng) for i, p in enumerate(own)}
        assert find_common_pattern(curves) is None


def test_the_term_of_a_pattern_turns_each_joint_by_its_own_copy():
    rng = np.random.default_rng(3)
    chain = Chain(*np.zeros((6, 3)))
    robot = RobotModel("arm", chain, np.tile([-3.0, 3.0], (3, 1)), np.zeros(3), np.zeros((3, 3)))
    obs = EffectModel(robot).poses(rng.uniform(-3, 3, (30, 3)))
    term = unmodelled.common_pattern(unmodelled.Covariates(obs), [0.4, 2.2], [1, -1], [0, 2])
    values = rng.standard_normal(term.k)
    orders = np.arange(1, 61)
    joint = EffectModel(robot, (term.__class__(**{**term.__dict__, "coefficients": values}),)).displacements(obs).joint

    def f(x):
        return np.sin(np.outer(x, orders)) @ values[:60] + np.cos(np.outer(x, orders)) @ values[60:]

    np.testing.assert_allclose(joint[:, 0], f(obs.q[:, 0] - 0.4), atol=1e-9)
    np.testing.assert_allclose(joint[:, 1], 0)
    np.testing.assert_allclose(joint[:, 2], -f(-obs.q[:, 2] - 2.2), atol=1e-9)
