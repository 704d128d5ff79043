"""Effects of several coefficients: what chance gives them, and what they cost for what they could have fitted."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from mbcacq.diagnosis.search.effect_prior import EffectPrior


def candidate(*typical):
    return SimpleNamespace(k=len(typical), typical=np.array(typical))


@pytest.mark.parametrize("seen", [(1, 1, 1), (1, 1, 1, 0.02, 0.02, 0.02), (1, 0.3, 0.1, 0.03), (1, 0.01)])
@pytest.mark.parametrize("level", [0.05, 0.001])
def test_by_chance_the_statistic_is_chi2_of_its_degrees_of_freedom(seen, level):
    rng = np.random.default_rng(3)
    drawn = rng.normal(size=(40000, len(seen))) ** 2

    tests = [EffectPrior(gains, np.array(seen, float)).test for gains in drawn]

    rate = np.mean([chi2.sf(statistic, dof) < level for statistic, dof in tests])
    assert 0.7 * level < rate < 1.4 * level


def test_directions_hardly_seen_need_no_evidence():
    """A shift of a scanner is seen by three coefficients, its turn about the middle of the view by none: six cost little more than three."""
    three = EffectPrior(np.array([20.0, 10.0, 15.0]), np.ones(3))
    six = EffectPrior(np.array([20.0, 10.0, 15.0, 0.8, 1.2, 0.5]), np.array([1, 1, 1, 1e-3, 1e-3, 1e-3]))

    assert six.test[1] == pytest.approx(3, abs=0.1)
    assert six.price - three.price == pytest.approx(2.5, abs=0.5)  # only what was gained there
    assert EffectPrior(six.gains, np.ones(6)).price > six.price + 4


def test_evidence_is_that_of_coefficients_of_the_most_probable_size():
    """Equally seen: gain g of k coefficients costs k (1 + log(g / k)); far beyond the noise too."""
    for gains in ([9.0, 6.0, 12.0], [2e6, 5e6, 1e6]):
        each = sum(gains) / 3
        assert EffectPrior(np.array(gains), np.ones(3)).price == pytest.approx(3 * (1 + np.log(each)), rel=0.01)
    assert EffectPrior(np.array([9.0]), np.ones(1)).price == pytest.approx(1 + np.log(9.0))


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
    assert other.price == pytest.approx(one.price)
    assert other.test == pytest.approx(one.test)


def test_what_is_seen_alike_is_tested_as_it_is():
    gains = np.array([4.0, 7.0, 1.0])

    statistic, dof = EffectPrior(gains, np.ones(3)).test

    assert (statistic, dof) == pytest.approx((12.0, 3.0))
