"""Sums over poses of sines and cosines of many orders, against the sums as they are written."""

import numpy as np
import pytest

from mbcacq.diagnosis.search.effect_columns import AngleNodes, Harmonics, PoseFunctions, angle_of_harmonics
from mbcacq.effects.functions import cosine, linear, scaled, sine


@pytest.mark.parametrize(("poses", "span", "highest"), [(9000, 4 * np.pi, 120.0), (4000, 2.0, 260.0), (6000, 0.3, 80.0), (300, 6.0, 200.0)])
def test_sums_over_poses_are_those_of_each_sine_and_cosine(poses, span, highest):
    """Of many poses by a grid, of few directly: to rounding of a sum, for weights of either sign and orders between those of equal steps."""
    rng = np.random.default_rng(3)
    x = rng.uniform(-span / 3, 2 * span / 3, poses)
    orders = np.unique(np.r_[np.arange(1.0, highest, 0.37), 2.0, np.pi, highest])
    weights = rng.standard_normal((poses, 3))
    found = Harmonics(x, orders)
    assert (AngleNodes(x, orders).spread is None) == (poses == 300)
    each = np.stack([np.sin(orders[:, None] * x), np.cos(orders[:, None] * x)], axis=1)
    scale = np.abs(weights).sum(axis=0)
    assert np.all(np.abs(found.sums(weights) - each @ weights) < 1e-11 * scale)
    products = np.einsum("hip,hjp,pa->hija", each, each, weights)
    assert np.all(np.abs(found.sums_of_products(weights) - products) < 1e-11 * scale)
    assert found.size == (len(orders), 2)


def test_functions_by_their_values_are_summed_alike():
    rng = np.random.default_rng(4)
    values, weights = rng.standard_normal((5, 40, 3)), rng.standard_normal((40, 2))
    found = PoseFunctions(values)
    np.testing.assert_allclose(found.sums(weights), np.einsum("hpf,pa->hfa", values, weights), atol=1e-12)
    np.testing.assert_allclose(found.sums_of_products(weights), np.einsum("hpf,hpg,pa->hfga", values, values, weights), atol=1e-12)


def test_only_a_sine_and_a_cosine_of_one_angle_are_harmonics():
    orders = np.array([[1.0], [2.0]])
    assert angle_of_harmonics((sine("q2", orders), cosine("q2", orders))) == "q2"
    assert angle_of_harmonics((cosine("q2", orders), sine("q2", orders))) is None
    assert angle_of_harmonics((sine("q2", orders), cosine("q3", orders))) is None
    assert angle_of_harmonics((sine("q2", orders), cosine("q2", 2 * orders))) is None
    assert angle_of_harmonics((scaled(sine("q2", orders), 2.0), cosine("q2", orders))) is None
    assert angle_of_harmonics((linear("q2"),)) is None
