from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mbcacq.files import angles

ANGLES = st.floats(min_value=-10.0, max_value=10.0, allow_nan=False) | st.floats(
    allow_nan=False, allow_infinity=False, min_value=-1e15, max_value=1e15
)


@given(st.lists(ANGLES, min_size=1, max_size=50))
def test_every_angle_survives_writing_and_reading(values):
    q = np.array(values)
    text = angles.degrees_text(q)
    back = angles.radians(np.array(text, dtype=float), text)
    np.testing.assert_array_equal(back.view(np.int64), q.view(np.int64))


@given(st.integers(-36_000_000, 36_000_000))
def test_a_decimal_from_a_file_is_written_as_it_stood(micro):
    degrees = micro / 100_000
    assert float(angles.degrees_text(np.radians([degrees]))[0]) == degrees


def test_short_decimals_convert_as_numpy_does_and_long_ones_exactly():
    assert angles.radians(np.array([180.0]), ["180"])[0] == np.pi
    assert angles.radians(np.array([90.0]), ["90.000000000000000000"])[0] == math.pi / 2
    third = "19.09859317102744029226605160470172344"  # 60 / pi
    assert angles.radians(np.array([float(third)]), [third])[0] == 1 / 3
