"""A recording that does not belong to the robot is no mismatch to explain; it is refused."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.errors import CalibrationError


@pytest.mark.parametrize("spoil", [np.radians, lambda q: q[:, [0, 1, 2, 4, 3, 5]]], ids=["angles in rad", "joints exchanged"])
def test_angles_of_another_robot_are_refused(plan, spoil):
    obs = simulated.observe(plan, 7)
    with pytest.raises(CalibrationError, match="miss each other by"):
        diagnose(replace(obs, q=spoil(obs.q)))
