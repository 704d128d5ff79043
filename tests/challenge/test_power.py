"""The test that knows the truth, and where a power curve passes 90 %."""

import pytest

from mbcacq.challenge.power import least_gain, needed


def test_one_coefficient_needs_the_sum_of_two_normal_quantiles():
    # two-sided 1 %: 2.5758; 90 % power: 1.2816 (tables of the normal distribution)
    assert least_gain(1) ** 0.5 == pytest.approx(2.5758 + 1.2816, abs=2e-4)


def test_more_coefficients_need_more():
    assert least_gain(1) < least_gain(2) < least_gain(6)


def test_ninety_percent_is_found_between_two_measured_strengths():
    assert needed((0.8, 1.0, 1.2), (0.2, 0.8, 1.0)) == pytest.approx(1.1)
    assert needed((0.8, 1.0, 1.2), (0.95, 0.9, 1.0)) == 0.8
    assert needed((0.8, 1.0), (0.2, 0.5)) is None
