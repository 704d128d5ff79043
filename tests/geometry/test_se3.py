"""Facts about rotations and rigid transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from mbcacq.geometry import se3

numbers = st.floats(-3.0, 3.0, allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(se3.skew(a) @ b, np.cross(a, b), atol=1e-12)


@given(vectors, vectors)
def test_exponential_equals_the_matrix_exponential(v, w):
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = se3.skew(w), v
    np.testing.assert_allclose(se3.exp(np.concatenate([v, w])), expm(generator), atol=1e-10)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-6, 1e-4, 1e-3])
def test_exponential_of_small_twists_keeps_full_precision(size):
    twist = size * np.array([0.3, -0.5, 0.2, 0.6, 0.1, -0.7])
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = se3.skew(twist[3:]), twist[:3]
    np.testing.assert_allclose(se3.exp(twist), expm(generator), rtol=0, atol=1e-15)


def test_rotation_log_near_half_a_turn():
    w = np.array([[np.pi - 1e-9, 0, 0], [0, np.pi - 1e-5, 0], [0, 0, 3.0]])
    np.testing.assert_allclose(se3.rotation_exp(se3.rotation_log(se3.rotation_exp(w))), se3.rotation_exp(w), atol=1e-12)


@given(vectors, vectors, vectors, vectors)
def test_adjoint_moves_a_twist_to_the_outer_frame(v, w, x, y):
    T, twist = se3.exp(np.concatenate([v, w])), 0.1 * np.concatenate([x, y])
    np.testing.assert_allclose(T @ se3.exp(twist), se3.exp(se3.adjoint(T) @ twist) @ T, atol=1e-9)


def test_kuka_angles_literal():
    """A = 90 about Z first: the flange x axis points along base y; then C = 90 tips its z axis."""
    T = se3.from_abc(np.array([1.0, 2.0, 3.0]), np.radians([90.0, 0.0, 90.0]))
    np.testing.assert_allclose(T[:3, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(T[:3, 1], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(T[:3, 3], [1, 2, 3])


@given(st.tuples(st.floats(-180, 180), st.floats(-90, 90), st.floats(-180, 180)))
def test_kuka_angles_round_trip(abc):
    T = se3.from_abc(np.zeros(3), np.radians(abc))
    xyz, back = se3.to_abc(T)
    np.testing.assert_allclose(se3.from_abc(xyz, back), T, atol=2e-8)


def test_nearest_rotation_never_mirrors():
    mirrored = np.diag([1.0, 1.0, -0.9])
    R = se3.nearest_rotation(mirrored)
    assert np.linalg.det(R) == pytest.approx(1.0)
