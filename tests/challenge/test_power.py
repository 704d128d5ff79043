"""The informed test, and the strength at which a power curve passes 90 %."""

import numpy as np
import pytest
from detection_power import INFORMED_LEVEL, least_gain, ninety_percent_point, reports, search_multiple, with_interval


def test_one_coefficient_needs_the_sum_of_two_normal_quantiles():
    # two-sided 1 %: 2.5758; 90 % power: 1.2816 (tables of the normal distribution)
    assert least_gain(1) ** 0.5 == pytest.approx(2.5758 + 1.2816, abs=2e-4)


def test_more_coefficients_need_more():
    assert least_gain(1) < least_gain(2) < least_gain(6)


def test_ninety_percent_of_a_normal_threshold():
    """Strengths found where a normal variate of that mean passes 3: nine in ten at 3 + 1.2816."""
    rng = np.random.default_rng(4)
    multiples = np.array([0.6, 0.8, 1.0, 1.2, 1.5])
    found = multiples * 4.0 + rng.normal(size=(4000, 5)) > 3.0

    assert ninety_percent_point(multiples, found) == pytest.approx((3.0 + 1.2816) / 4.0, abs=0.02)


def test_a_larger_search_needs_a_stronger_effect():
    assert search_multiple(1, 0.5, 2 * INFORMED_LEVEL) == pytest.approx(1.0)
    # two-sided 1.96e-4 (2 % over 17 effects at 6 joints each): 3.725, and 90 % power: 1.282
    assert search_multiple(1, 1 / 102, 0.02) == pytest.approx((3.7246 + 1.2816) / (2.5758 + 1.2816), abs=1e-3)
    assert search_multiple(2, 1 / 40, 0.02) < search_multiple(2, 1 / 7000, 0.02)


def test_one_of_two_that_cannot_be_told_apart_counts_as_reported():
    truth = {"name": "joint_compliance", "where": ["A2", "A3"]}
    other = {"effects": [{"name": "joint_scale", "where": ["A2"]}], "not_separable": []}

    assert not reports(other, truth)
    assert reports({**other, "not_separable": [{"effects": ["joint_scale:A2", "joint_compliance:A2"]}]}, truth)
    assert not reports({**other, "not_separable": [{"effects": ["joint_scale:A2", "joint_compliance:A5"]}]}, truth)
    assert reports({"effects": [{"name": "joint_compliance", "where": ["A3"]}], "not_separable": []}, truth)


def test_a_figure_of_cells_has_an_interval_that_holds_the_truth_as_often_as_stated():
    """A mean of normal variates, drawn a hundred times: its 95 % interval holds zero nearly always (a little less often with few cells)."""
    rng = np.random.default_rng(6)
    held = 0
    for _ in range(100):
        values = rng.normal(size=30)
        _, low, high = with_interval(lambda cells, values=values: float(values[cells].mean()), 30)
        held += low < 0.0 < high

    assert held >= 85
