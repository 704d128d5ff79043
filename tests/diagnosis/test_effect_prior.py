"""Effects of several coefficients: their detection statistic under noise, and their Occam penalty."""

import numpy as np
import pytest
import simulated
from scipy.stats import chi2

from mbcacq.diagnosis.search.effect_prior import EffectPrior


def candidate(*typical):
    return simulated.candidate("mount_shift", "mount", list(typical))


@pytest.mark.parametrize("seen", [(1, 1, 1), (1, 1, 1, 0.02, 0.02, 0.02), (1, 0.3, 0.1, 0.03), (1, 0.01)])
def test_detection_statistic_of_noise_is_chi2_of_its_dof(seen):
    rng = np.random.default_rng(3)
    drawn = rng.normal(size=(40000, len(seen))) ** 2

    tests = [EffectPrior(gains, np.array(seen, float)).detection_statistic for gains in drawn]

    p = chi2.sf(*np.transpose(tests))
    for level in (0.05, 0.001):
        assert 0.7 * level < np.mean(p < level) < 1.4 * level


def test_poorly_determined_directions_have_no_occam_penalty():
    """A shift of a scanner is determined by three coefficients, its rotation by none: six have little more penalty than three."""
    three = EffectPrior(np.array([20.0, 10.0, 15.0]), np.ones(3))
    six = EffectPrior(np.array([20.0, 10.0, 15.0, 0.8, 1.2, 0.5]), np.array([1, 1, 1, 1e-3, 1e-3, 1e-3]))

    assert six.detection_statistic[1] == pytest.approx(3, abs=0.1)
    assert six.occam_penalty - three.occam_penalty == pytest.approx(2.5, abs=0.5)  # only what was gained there
    assert EffectPrior(six.gains, np.ones(6)).occam_penalty > six.occam_penalty + 4


def test_occam_penalty_is_that_of_the_most_probable_size():
    """Equally seen: gain g of k coefficients costs k (1 + log(g / k)); far beyond the noise too."""
    for gains in ([9.0, 6.0, 12.0], [2e6, 5e6, 1e6]):
        each = sum(gains) / 3
        assert EffectPrior(np.array(gains), np.ones(3)).occam_penalty == pytest.approx(3 * (1 + np.log(each)), rel=0.01)
    assert EffectPrior(np.array([9.0]), np.ones(1)).occam_penalty == pytest.approx(1 + np.log(9.0))


def test_neither_units_nor_axes_matter():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6))
    covariance, c = root @ root.T, 3 * rng.normal(size=6)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    both = np.kron(np.eye(2), turn)
    metres = np.array([1e-3] * 3 + [1.0] * 3)
    typical = [0.03] * 3 + [1e-4] * 3

    one = EffectPrior.of(candidate(*typical), c, covariance)
    other = EffectPrior.of(
        candidate(*(np.array(typical) * metres)), (both @ c) * metres, both @ covariance @ both.T * np.outer(metres, metres)
    )

    assert one.gain == pytest.approx(c @ np.linalg.solve(covariance, c))
    assert other.occam_penalty == pytest.approx(one.occam_penalty)
    assert other.detection_statistic == pytest.approx(one.detection_statistic)


def test_equally_determined_directions_are_tested_by_their_chi2():
    gains = np.array([4.0, 7.0, 1.0])

    statistic, dof = EffectPrior(gains, np.ones(3)).detection_statistic

    assert (statistic, dof) == pytest.approx((12.0, 3.0))
