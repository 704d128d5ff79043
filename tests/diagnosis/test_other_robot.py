"""A recording that does not belong to the robot is no mismatch to explain; it is refused."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.estimation.adjustment import adjust_recording, fit_hand_eye
from mbcacq.estimation.options import CalibrationOptions


@pytest.mark.parametrize("spoil", [np.radians, lambda q: q[:, [0, 1, 2, 4, 3, 5]]], ids=["angles in rad", "joints exchanged"])
def test_angles_of_another_robot_are_refused(plan, spoil):
    obs = simulated.observe(plan, 7)
    with pytest.raises(CalibrationError, match="miss each other by"):
        diagnose(replace(obs, q=spoil(obs.q)))


@pytest.mark.parametrize("size", [1.0, 0.5])
def test_an_artefact_of_any_size_contradicts_angles_in_rad(plan, size):
    """No hand-eye fits such data, and the last digit of an angle decides where its fit ends. The balls of a small artefact may then miss
    each other by less than those of a poor arm do. The answer is the same for all of them."""
    whole, bar = plan.cell.artefacts
    artefacts = (replace(whole, centres=size * whole.centres), bar)
    obs = simulated.observe(replace(plan, cell=replace(plan.cell, artefacts=artefacts)), 7)
    rng = np.random.default_rng(3)
    for _ in range(3):
        q = np.radians(obs.q) + rng.normal(0, 1e-11, obs.q.shape)
        with pytest.raises(ContradictionError, match="miss each other by"):
            fit_hand_eye(replace(obs, q=q), CalibrationOptions())


def test_an_arm_whose_zeros_are_two_degrees_off_is_still_this_arm(plan):
    obs = simulated.observe(plan, 7)
    offset = np.radians(2.0) * np.array([1, -1, 1, 1, -1, 1])
    adjusted = adjust_recording(replace(obs, q=obs.q + offset), CalibrationOptions(refuse=False))
    assert np.std(adjusted.solution.residual[adjusted.used]) < 0.02
