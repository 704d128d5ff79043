"""Rows made from joint axes repeat the product of exponentials of those axes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbcacq.geometry import se3
from mbcacq.geometry.chain_from_axes import chain_from_axes


def product_of_exponentials(direction, point, flange, q):
    """T_base_flange (4, 4): each axis, as it lies at q = 0, turns everything behind it."""
    out = np.eye(4)
    for z, p, angle in zip(direction, point, q, strict=True):
        R = se3.rotation_exp(angle * z)
        out = out @ se3.transform(R, p - R @ p)
    return out @ flange


def agree(direction, point, flange):
    made = chain_from_axes(direction, point, flange)
    q = np.random.default_rng(0).uniform(-3, 3, (6, len(direction)))
    expected = np.array([product_of_exponentials(direction, point, flange, angles) for angles in q])
    assert made.flange(q) == pytest.approx(expected, abs=1e-8)
    return made


@given(seed=st.integers(0, 2**32 - 1), axes=st.sampled_from([6, 7]))
@settings(max_examples=30)
def test_skew_axes_of_any_arm(seed, axes):
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal((axes, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    agree(direction, 300 * rng.standard_normal((axes, 3)), se3.exp(np.concatenate([300 * rng.standard_normal(3), rng.standard_normal(3)])))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_parallel_meeting_and_coinciding_axes(seed):
    rng = np.random.default_rng(seed)
    direction = np.eye(3)[rng.integers(0, 3, 6)] * rng.choice([-1, 1], (6, 1))
    flange = se3.from_abc(100.0 * rng.integers(-2, 3, 3), np.pi / 2 * rng.integers(0, 4, 3))
    agree(direction, 100.0 * rng.integers(-2, 3, (6, 3)), flange)


def test_rows_of_a_data_sheet_come_back():
    """UR10: its own rows, made into axes and back."""
    X, Y, Z = np.eye(3)
    point = np.array([[0, 0, 0], [0, 0, 127.3], [-612, 0, 127.3], [-1184.3, 0, 127.3], [-1184.3, -163.941, 0], [-1184.3, -163.941, 11.6]])
    flange = se3.transform(np.stack([X, Z, -Y], axis=1), np.array([-1184.3, -256.141, 11.6]))
    made = agree(np.array([Z, -Y, -Y, -Y, -Z, -Y]), point, flange)
    chain = made.chain
    assert np.allclose(made.T_given_base, np.eye(4))
    assert np.allclose(made.T_flange_given, np.eye(4))
    assert chain.a == pytest.approx([0, -612, -572.3, 0, 0, 0], abs=1e-9)
    assert chain.d == pytest.approx([127.3, 0, 0, 163.941, 115.7, 92.2], abs=1e-9)
    assert np.degrees(chain.alpha) == pytest.approx([90, 0, 0, 90, -90, 0], abs=1e-9)
    assert np.abs(np.concatenate([chain.theta, chain.beta])).max() < 1e-12


def test_a_base_beside_axis_one_and_a_flange_beside_the_last_axis_are_stated():
    direction, point = np.tile([0.0, 0.0, 1.0], (2, 1)), np.array([[50.0, 0, 0], [350, 0, 0]])
    made = agree(direction, point, se3.transform(np.eye(3), np.array([600.0, 20, 30])))
    assert made.T_given_base[:3, 3] == pytest.approx([50, 0, 0])
    assert made.T_flange_given[:3, 3] == pytest.approx([250, 20, 0])


def test_nearly_parallel_axes_of_a_calibrated_arm_get_no_lengths_of_kilometres():
    """The UR10's axes 2 and 3, 0.15 mrad apart as a calibration leaves them; their common normal lies 4 km away."""
    X, Y, Z = np.eye(3)
    tilted = se3.rotation_exp(np.array([1.5e-4, 0, 0])) @ -Y
    point = np.array([[0, 0, 0], [0, 0, 127.3], [-612, 0, 127.3], [-1184.3, 0, 127.3], [-1184.3, -163.941, 0], [-1184.3, -163.941, 11.6]])
    flange = se3.transform(np.stack([X, Z, -Y], axis=1), np.array([-1184.3, -256.141, 11.6]))
    chain = agree(np.array([Z, -Y, tilted, -Y, -Z, -Y]), point, flange).chain
    assert np.hypot(chain.a, chain.d).max() < 620
