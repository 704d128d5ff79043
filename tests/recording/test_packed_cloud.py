"""A packed cloud comes back within the rounding that is stated, whatever its points are."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mbcacq.devices import Scan
from mbcacq.recording.rrd.packed_cloud import MOST_MM, STEP_MM, packable, packed, unpacked

EMPTY = Scan(np.zeros((0, 3), np.float32))
COORDINATE = st.floats(-60_000, 60_000, width=32)


@given(hnp.arrays(np.float32, st.tuples(st.integers(0, 40), st.just(3)), elements=COORDINATE))
def test_points_come_back_within_half_a_step_and_the_resolution_of_float32(points):
    again = unpacked(EMPTY, packed(Scan(points))).points
    assert again.dtype == np.float32
    assert again.shape == points.shape
    assert np.all(np.abs(again.astype(float) - points) <= STEP_MM / 2 + np.spacing(np.abs(points)))


@given(hnp.arrays(np.int32, st.integers(0, 40), elements=st.integers(0, 2**31 - 1)))
def test_pixels_and_intensities_come_back_exactly(pixel):
    scan = Scan(np.zeros((len(pixel), 3), np.float32), (pixel % 256).astype(np.uint8), (1, 9), pixel)
    again = unpacked(dataclasses.replace(scan, points=EMPTY.points, intensity=None, pixel=None), packed(scan))
    np.testing.assert_array_equal(again.pixel, pixel)
    np.testing.assert_array_equal(again.intensity, scan.intensity)
    assert again.shape == (1, 9)


def test_points_that_are_not_finite_or_very_far_are_not_packed():
    for bad in (np.nan, np.inf, MOST_MM):
        assert not packable(Scan(np.array([[0, 0, bad]], np.float32)))
    assert packable(EMPTY)


def test_the_bytes_of_one_point_are_these():
    """x = 1 mm is 8192 steps, folded 16384 = 0x4000; the other axes are 0: nine lowest, second, third and highest bytes."""
    import zlib

    bytes_of = packed(Scan(np.array([[1.0, 0, 0]], np.float32)))["packed_points"].tobytes()
    assert zlib.decompress(bytes_of) == bytes([0, 0, 0, 0x40, 0, 0, 0, 0, 0, 0, 0, 0])


def test_damaged_bytes_are_named():
    components = packed(Scan(np.ones((50, 3), np.float32)))
    components["packed_points"] = components["packed_points"][:-3]
    with pytest.raises(ValueError, match="damaged"):
        unpacked(EMPTY, components)
