"""The fake controller's arm comes to rest, at every cycle of the controller."""

import pytest
from mbcacq_fakes.dynamics.ideal_arm import IdealArm

HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
@pytest.mark.parametrize("lag_s", [0.0, 0.005, 0.02, 0.1])
def test_a_move_ends_at_its_set_point_as_one_arrival(cycle_s, lag_s):
    arm = IdealArm(HOME, cycle_s, lag_s)
    for k in range(3):
        there = (10.0 * (k + 1), *HOME[1:])
        assert arm.step(there) or arm.step(there) or arm.step(there)
        assert not arm.standstill
        for _ in range(int(2 / cycle_s)):
            arm.step(there)
        assert arm.q == pytest.approx(there, abs=1e-5)
        assert arm.standstill
        assert arm.arrivals == k + 1
