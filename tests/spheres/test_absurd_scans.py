"""Scans that no scanner can have taken, as a damaged header makes them: refused by name, or no ball in them; never a foreign error."""

import clouds
import numpy as np
import pytest

from mbcacq.errors import DeviceFault
from mbcacq.spheres.extract import find_spheres

MBC = clouds.artefact()


@pytest.mark.parametrize("scale", [1e6, 1e9, 1e20, (1e6, 1, 1), (1, 1, 1e7)])
def test_a_scan_wider_than_any_field_of_view_is_refused_by_name(scale):
    points = np.random.default_rng(1).uniform(-40, 40, (2000, 3)) * np.array(scale)
    with pytest.raises(DeviceFault, match="wide, no field of view is"):
        find_spheres(points.astype(np.float32), MBC)


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-3, np.float32(3e38)])
def test_points_that_coincide_or_overflow_are_no_ball(scale):
    points = np.random.default_rng(1).uniform(-1, 1, (2000, 3)).astype(np.float32) * np.float32(scale)
    if scale > 1:
        points = np.sign(points) * np.float32(np.inf)
    assert len(find_spheres(points, MBC)) == 0
