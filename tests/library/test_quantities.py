"""Digits follow the uncertainty as the GUM (7.2.6) says, units are those of the SI brochure."""

import pytest

from mbcacq.quantities import decimal_places, fixed, measured, p_value, pair, signed, significant, split_unit


@pytest.mark.parametrize(
    ("value", "expanded", "shown"),
    [
        (0.26134, 0.0561, ("0.261", "0.056")),
        (39.87, 1.5416, ("39.9", "1.5")),
        (735.2364, 12.3, ("735", "12")),
        (1.0, 0.0996, ("1.00", "0.10")),  # two digits of 0.0996 are 0.10
        (1234.0, 260.0, ("1230", "260")),
        (-0.0004, 0.0114, ("0.000", "0.011")),  # a zero has no sign
        (-2.0366e-5, 6.02e-7, ("−2.037 × 10⁻⁵", "0.060 × 10⁻⁵")),
        (1.2e-9, 6.02e-7, ("0.0 × 10⁻⁷", "6.0 × 10⁻⁷")),
    ],
)
def test_a_value_ends_where_the_second_digit_of_its_uncertainty_stands(value, expanded, shown):
    assert pair(value, expanded) == shown


def test_an_unknown_uncertainty_is_a_dash_and_an_unknown_value_too():
    assert pair(0.123456, None) == ("0.1235", "–")
    assert pair(None, None) == ("–", "–")
    assert measured(float("nan"), 0.1, "mm") == "– mm"


def test_one_unit_belongs_to_value_and_uncertainty():
    assert measured(0.26134, 0.0561, "mm") == "0.261 ± 0.056 mm"
    assert measured(0.0118, 0.00034, "°") == "(0.01180 ± 0.00034)°"
    assert measured(12.0, None, "°") == "12.00°"


@pytest.mark.parametrize(
    ("p", "shown"), [(2e-308, "p < 10⁻⁶"), (0.0, "p < 10⁻⁶"), (0.0132, "p = 0.013"), (0.4567, "p = 0.46"), (2.345e-5, "p = 2.3 × 10⁻⁵")]
)
def test_a_probability_that_nobody_knows_so_far_out_is_a_bound(p, shown):
    assert p_value(p) == shown


def test_a_power_of_ten_stands_only_where_zeros_would_fill_the_line():
    assert significant(3.07e-06, 3) == "3.07 × 10⁻⁶"
    assert significant(0.000123, 2) == "0.00012"
    assert significant(123456.0, 3) == "123000"
    assert significant(0.0) == "0"
    assert significant(-0.0456, 2) == "−0.046"


def test_units_are_separated_from_names():
    assert split_unit("A2.compliance_rad_per_Nm") == ("A2 compliance", "µrad/(N·m)", 1e6)
    assert split_unit("compliance_mm_per_N") == ("compliance", "µm/N", 1e3)
    assert split_unit("link2.time_constant_s") == ("link2 time constant", "s", 1.0)
    assert split_unit("A1.amplitude_deg") == ("A1 amplitude", "°", 1.0)
    assert split_unit("radial_per_mm2") == ("radial", "1/mm²", 1.0)
    assert split_unit("scale_per_K") == ("scale", "ppm/K", 1e6)
    assert split_unit("A2.softening_rad_per_Nm2") == ("A2 softening", "µrad/(N·m)²", 1e6)
    assert split_unit("expansion_ppm_per_K") == ("expansion", "ppm/K", 1.0)
    assert split_unit("A4.order") == ("A4 order", "", 1.0)


def test_decimal_places_of_every_size():
    assert [decimal_places(u) for u in (0.0056, 0.12, 3.4, 34.0, 340.0)] == [4, 2, 1, 0, -1]
    assert fixed(12345.0, -2) == "12300"
    assert signed(0.02) == "+0.020"
