"""Inertial parameters of bodies that can exist."""

import numpy as np

from mbcacq.diagnosis.motion.inertial_consistency import InertialBodies, _solve, is_consistent, pseudo_inertia


def body(points, masses):
    """Inertial parameters (10,) of point masses, by the definition of each."""
    tensor = sum(m * ((p @ p) * np.eye(3) - np.outer(p, p)) for p, m in zip(points, masses, strict=True))
    moment = sum(m * p for p, m in zip(points, masses, strict=True))
    i, j = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])
    return np.r_[sum(masses), moment, tensor[i, j]]


def four_points(seed):
    rng = np.random.default_rng(seed)
    return body(rng.normal(size=(6, 3)), rng.uniform(0.5, 2.0, 6))


def test_point_masses_have_a_positive_pseudo_inertia():
    parameters = four_points(1)[None]
    assert is_consistent(parameters).all()
    P = pseudo_inertia(parameters)[0]
    assert P[3, 3] == parameters[0, 0]
    assert np.linalg.eigvalsh(P)[0] > 0


def test_a_tensor_that_breaks_the_triangle_inequality_is_not_consistent():
    parameters = np.r_[1.0, 0, 0, 0, 1.0, 0, 0, 1.0, 0, 2.5]  # Izz > Ixx + Iyy
    assert not is_consistent(parameters[None])[0]


def test_a_consistent_target_is_reached_and_another_is_brought_to_the_border():
    described, truth = four_points(2), four_points(3)
    bodies = InertialBodies(described[None], np.ones((1, 10)), np.arange(10)[None], np.array([10]))
    free = np.ones((1, 10), dtype=bool)
    target = np.r_[truth - described, 0.7]
    np.testing.assert_allclose(_solve(bodies, free, np.eye(11), target), target, atol=1e-4)
    impossible = np.r_[1.0, 0, 0, 0, 1.0, 0, 0, 1.0, 0, 2.5] - described
    solved = _solve(bodies, free, np.eye(11), np.r_[impossible, -0.5])
    found = (described + solved[:10])[None]
    assert np.linalg.eigvalsh(pseudo_inertia(found))[0, 0] > 0
    assert 0 <= solved[10] < 1e-3
    assert 0.1 < np.linalg.norm(solved[:10] - impossible) < 0.5


def test_a_heavy_tool_that_the_description_lacks_fits_as_well_as_its_truth():
    """Slow motion determines moments well and tensors hardly, and the sum of link and tool a thousand times better than each."""
    link, tool = four_points(2), body(np.array([0.1, -0.05, 0.3]) + 0.05 * np.random.default_rng(5).normal(size=(6, 3)), np.full(6, 7.0))
    bodies = InertialBodies(np.stack([link, np.zeros(10)]), np.ones((2, 10)), np.arange(20).reshape(2, 10), np.array([20]))
    sigma = np.r_[0.5, 0.01, 0.01, 0.1, np.full(6, 1.0)]
    each, both, rotor = np.eye(21)[:20] / np.tile(sigma, 2)[:, None], np.eye(10, 21) + np.eye(10, 21, 10), np.eye(1, 21, 20)
    root = np.concatenate([each, 1e3 * both / sigma[:, None], 100 * rotor])
    truth = np.r_[np.zeros(10), tool, 0.3]
    for seed in range(3):
        measured = truth + np.linalg.lstsq(root, np.random.default_rng(seed).normal(size=31), rcond=None)[0]
        solved = _solve(bodies, np.ones((2, 10), dtype=bool), root, measured)
        assert np.sum((root @ (solved - measured)) ** 2) <= np.sum((root @ (truth - measured)) ** 2)
        assert abs(solved[10] - tool[0]) < 3 * sigma[0]
