"""Sizes of groups of random effects by marginal likelihood."""

import numpy as np
import pytest

from mbcacq.estimation.random_effect_sizes import LEAST_RISE, sizes_by_marginal_likelihood

COLUMNS, ROWS = 200, 900
SLICES = [slice(0, 60), slice(60, 120), slice(120, 200)]
LIMITS = (1e-3, 100.0)


def equations(sizes, seed):
    """Normal equations of groups with coefficients of these sizes, seen through columns of unit noise."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(ROWS, COLUMNS))
    u = np.concatenate([rng.normal(0, s, p.stop - p.start) for s, p in zip(sizes, SLICES, strict=True)])
    y = X @ u + rng.normal(size=ROWS)
    return X.T @ X, X.T @ y


def log_marginal_likelihood(S, b, sizes):
    """Likelihood of the data with coefficients integrated out, up to a constant; written from its definition."""
    prior = np.concatenate([np.full(p.stop - p.start, s**2) for s, p in zip(sizes, SLICES, strict=True)])
    normal = S + np.diag(1 / prior)
    return 0.5 * (b @ np.linalg.solve(normal, b) - np.linalg.slogdet(normal)[1] - np.log(prior).sum())


def test_sizes_are_recovered_and_a_group_of_nothing_vanishes():
    found = np.array(
        [
            sizes_by_marginal_likelihood(*equations((0.5, 2.0, 0.0), seed), SLICES, np.ones(3), (0.02, 100.0), (100, LEAST_RISE))
            for seed in range(20)
        ]
    )
    np.testing.assert_allclose(np.sqrt(np.mean(found[:, :2] ** 2, axis=0)), (0.5, 2.0), rtol=0.1)
    assert np.median(found[:, 2]) < 0.03


def test_the_marginal_likelihood_is_at_its_maximum():
    S, b = equations((0.5, 2.0, 0.1), 7)
    found = sizes_by_marginal_likelihood(S, b, SLICES, np.ones(3), LIMITS, (500, LEAST_RISE))
    best = log_marginal_likelihood(S, b, found)
    for g in range(3):
        for factor in (0.8, 1.25):
            other = found.copy()
            other[g] *= factor
            assert log_marginal_likelihood(S, b, other) < best


def test_the_start_does_not_matter_and_a_kept_size_stays():
    S, b = equations((0.5, 2.0, 0.1), 8)
    small, large = (sizes_by_marginal_likelihood(S, b, SLICES, np.full(3, start), LIMITS, (500, LEAST_RISE)) for start in (0.1, 10.0))
    np.testing.assert_allclose(small, large, rtol=0.06)
    kept = sizes_by_marginal_likelihood(S, b, SLICES, np.full(3, 0.7), LIMITS, (500, LEAST_RISE), np.array([True, False, False]))
    assert kept[0] == pytest.approx(0.7)
    np.testing.assert_allclose(kept[1], small[1], rtol=0.1)
