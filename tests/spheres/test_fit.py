"""The fit against the truth: unbiased, as good as the noise allows, deaf to what is not the ball."""

import clouds
import numpy as np
import pytest

from mbcacq.spheres.fit import rough_fits, sphere_fits

VIEW = np.array([0.0, 0.0, 1.0])
LIMIT = np.radians(65.0)


def fit_many(rng, runs, n=1500, noise=0.01, outliers=0.03, diameter=12.0, view=VIEW):
    truth = rng.uniform(-30, 30, (runs, 3))
    points = [clouds.cap(rng, c, diameter, n, noise=noise, outliers=outliers, view=view) for c in truth]
    radii = np.full(runs, diameter / 2)
    start = rough_fits(points, truth + rng.normal(0, 0.2, truth.shape), radii, 0.08)
    return truth, sphere_fits(points, start, radii, view, LIMIT, 0.08)


@pytest.fixture(scope="module")
def fitted():
    return fit_many(np.random.default_rng(11), 300)


def test_the_centre_is_unbiased_along_the_line_of_sight(fitted):
    truth, fits = fitted
    error = np.array([f.centre for f in fits]) - truth
    mean, sigma = error.mean(axis=0), error.std(axis=0) / np.sqrt(len(error))
    assert np.all(np.abs(mean) < 1e-3 / 10)  # a tenth of a micrometre; a micrometre is allowed
    assert np.all(np.abs(mean) < 4 * sigma)


def test_the_scatter_meets_the_cramer_rao_bound(fitted):
    truth, fits = fitted
    error = np.array([f.centre for f in fits]) - truth
    # evenly in projection up to 65 of 75 deg, 3 % lost: information n (E sx^2, E sx^2, E cz^2) / noise^2
    n = 1500 * 0.97 * (np.sin(LIMIT) / np.sin(np.radians(75))) ** 2
    side = np.sin(LIMIT) ** 2 / 4
    bound = 0.01 / np.sqrt(n * np.array([side, side, 1 - 2 * side]))
    assert np.all(error.std(axis=0) < 1.12 * bound)


def test_the_covariance_matches_the_scatter(fitted):
    truth, fits = fitted
    error = np.array([f.centre for f in fits]) - truth
    chi2 = np.einsum("ki,kij,kj->k", error, np.linalg.inv([f.covariance for f in fits]), error)
    assert 3 - 4 * np.sqrt(6 / len(error)) < chi2.mean() < 3 + 4 * np.sqrt(6 / len(error))


def test_the_noise_of_a_point_is_estimated():
    _, fits = fit_many(np.random.default_rng(5), 40, noise=0.02)
    assert np.mean([f.noise_mm for f in fits]) == pytest.approx(0.02, rel=0.03)


def test_the_freely_fitted_radius_shows_a_wrong_ball():
    rng = np.random.default_rng(2)
    points = [clouds.cap(rng, [1, 2, 3], 12.1, 1500)]
    fit = sphere_fits(points, np.array([[1.0, 2, 3]]), np.array([6.0]), VIEW, LIMIT, 0.08)[0]
    assert fit.radius_error == pytest.approx(0.05, abs=6 * fit.radius_sigma)


def test_half_of_the_cap_covered_causes_no_bias():
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(60):
        points = clouds.cap(rng, [0, 0, 0], 12.0, 3000)
        points = points[points[:, 0] > -0.5]
        start = rough_fits([points], np.array([[0.2, -0.1, 0.2]]), np.array([6.0]), 0.08)
        fit = sphere_fits([points], start, np.array([6.0]), VIEW, LIMIT, 0.08)[0]
        errors.append(fit.centre / np.sqrt(np.diag(fit.covariance)))
    assert np.all(np.abs(np.mean(errors, axis=0)) < 4 / np.sqrt(60))


def test_a_fit_with_nothing_to_fit_is_none():
    assert sphere_fits([np.zeros((20, 3)) + 50], np.zeros((1, 3)), np.array([6.0]), VIEW, LIMIT, 0.08) == [None]


def test_one_flipped_bit_of_a_point_moves_the_centre_by_a_fraction_of_its_uncertainty():
    rng, centre, step = np.random.default_rng(5), np.array([10.0, -5, 8]), 0.003
    raw = np.rint(clouds.cap(rng, centre, 12.0, 400, noise=0.01, view=VIEW) / step).astype(np.int16)
    flipped = [raw]
    for bit in range(48):
        flipped.append(raw.copy())
        flipped[-1].view(np.uint16)[rng.integers(len(raw)), bit // 16] ^= 1 << bit % 16
    points = [one * step for one in flipped]
    true, *fits = sphere_fits(points, np.tile(centre, (49, 1)), np.full(49, 6.0), VIEW, LIMIT, 0.08)
    moved = np.array([fit.centre for fit in fits]) - true.centre
    assert np.all(np.abs(moved) < 0.5 * np.sqrt(np.diag(true.covariance)))
