"""The e-process of days: the exact ratio of marginal densities, blind to where the rows lie, bounded when nothing changes."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mbcacq.interim_check.e_process import EProcess, Rows
from mbcacq.interim_check.options import CheckOptions

R, SMALL = 6, CheckOptions(noise_levels=(1.0, 1.5), day_levels=(0.0, 1.0))


def process(free=0, options=SMALL):
    rng = np.random.default_rng(5)
    A = 0.4 * rng.standard_normal((R, R))
    rows = Rows(np.eye(R) + A @ A.T, 0.5 * rng.standard_normal((R, 2)), rng.standard_normal((R, free)))
    columns = [rng.standard_normal((R, k)) for k in (1, 2, 1)]
    return EProcess(rows, columns, np.array([0.5, 0.25, 0.25]), options)


def drawn(of, days, seed=1, noise=1.0, day=1.0):
    rng = np.random.default_rng(seed)
    covariance = noise**2 * of.rows.noise + day**2 * of.rows.daily @ of.rows.daily.T
    return rng.standard_normal((days, R)) @ np.linalg.cholesky(covariance).T


def dense_log_e(of, days):
    """The same by whole matrices: densities of the differences to the first day, summed over everything."""
    T = len(days)
    D = np.concatenate([-np.ones((T - 1, 1)), np.eye(T - 1)], axis=1)  # differences to the first day
    B = of.rows.free
    P = np.linalg.svd(B)[0][:, B.shape[1] :].T if B.shape[1] else np.eye(R)
    x = (D @ days @ P.T).reshape(-1)
    null, change = [], []
    for lv in of.levels:
        S = P @ (lv.noise**2 * of.rows.noise + lv.day**2 * of.rows.daily @ of.rows.daily.T) @ P.T
        C = np.kron(D @ D.T, S)
        null.append(multivariate_normal.logpdf(x, cov=C))
        for k, columns in enumerate(of.columns):
            for size in of.options.sizes:
                for n in range(1, T):
                    g = np.kron((D @ (np.arange(T) >= n).astype(float))[:, None], size * P @ columns)
                    c = of.options.onset_days
                    prior = np.exp(of.log_weight[k]) * c / (c + n - 1) / (c + n) / len(of.options.sizes) / len(of.levels)
                    change.append(np.log(prior) + multivariate_normal.logpdf(x, cov=C + g @ g.T))
    return np.logaddexp.reduce(change) - max(null)


@pytest.mark.parametrize("free", [0, 2])
def test_it_is_the_ratio_of_the_marginal_densities(free):
    of = process(free)
    days = drawn(of, 5)
    days[3:] += 1.5 * of.columns[0][:, 0]
    followed = of.follow(days)
    assert list(followed.sums) == [0, 1, 2, 3]  # with so few days no level is hopeless
    assert followed.log_e(5) == pytest.approx(dense_log_e(of, days), abs=1e-9)


def test_where_the_rows_lie_does_not_matter_and_what_is_placed_anew_neither():
    of = process(free=2)
    days = drawn(of, 6)
    placed = np.random.default_rng(3).standard_normal((6, 2)) * 50
    moved = days + 1e3 * np.arange(R) + placed @ of.rows.free.T
    assert of.follow(moved).log_e(6) == pytest.approx(of.follow(days).log_e(6), abs=1e-5)


def test_the_onsets_of_all_days_to_come_have_a_probability_of_one():
    of = process()
    assert np.exp(of.log_onsets(np.arange(1, 2_000_000, dtype=float))).sum() == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize(("noise", "day"), [(1.0, 0.0), (1.0, 1.0), (1.5, 1.0)])
def test_a_cell_that_does_not_change_seldom_looks_changed_at_any_of_many_looks(noise, day):
    of = process()
    largest = []
    for seed in range(25):
        followed = of.follow(drawn(of, 14, seed, noise, day))
        largest.append(max(followed.log_e(t) for t in range(2, 15)))
    # Ville: at most one in ten reaches ten, whatever the level of the noise; 8 of 25 have a probability below 0.3 % then.
    assert np.sum(np.array(largest) > np.log(10)) < 8


def test_a_level_of_noise_is_left_out_only_where_it_is_hopeless_whatever_changed():
    of = process()
    days = drawn(of, 200, day=0.0)
    days[100:] += 30 * of.columns[1] @ [1.0, -1.0]
    of.follow(days)
    kept = of.possible(days)
    assert of.levels.index(next(lv for lv in of.levels if (lv.noise, lv.day) == (1.0, 0.0))) in kept
    assert all(of.levels[h].noise == 1.0 for h in kept)
