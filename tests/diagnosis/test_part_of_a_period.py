"""A periodic error over a quarter of its period: no order is claimed, and no size larger than what the recording shows."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState, Displacements
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, Station
from mbcacq.model.observations import Observations

AMPLITUDE, ORDER = 1.2e-3, 4.0
TOOL = se3.transform(se3.rotation_exp(np.array([0.2, 0.1, 0.3])), np.array([30.0, 20.0, 180.0]))
TRACKER = se3.transform(se3.rotation_exp(np.array([0.0, 0.0, 0.3])), np.array([2500.0, 300.0, 400.0]))


def wave_of_joint_five(context):
    joint = np.zeros(context.obs.q.shape)
    joint[:, 4] = AMPLITUDE * np.sin(ORDER * context.obs.q[:, 4] + 0.4)
    return Displacements(joint=joint)


@pytest.fixture(scope="module")
def seen_by_a_tracker():
    """60 poses of a target on the flange with its orientation; A5 turns over a quarter of the period."""
    rng, arm = np.random.default_rng(3), simulated.robot()
    q = np.clip(rng.uniform(0.5 * arm.limits[:, 0], 0.5 * arm.limits[:, 1], (60, arm.n)), -2.2, 2.2)
    q[:, 4] = rng.uniform(0.35, 0.35 + 2 * np.pi / ORDER / 4, 60)
    target = Artefact("target", "target", (1,), np.zeros((1, 3)), np.zeros(1))
    cell = Cell(arm, TOOL, (target,), (Station("1", "target"),), "tracker", simulated.POINT_NOISE, measurement=TARGET_IN_BASE)
    pose, none, unit = np.arange(60), np.zeros(60, int), np.tile(np.eye(3), (60, 1, 1))
    blank = Observations(cell, pose, none, q, pose, none, np.zeros((60, 3)), rotation=unit)
    nominal = CellState(arm.chain, TOOL, TRACKER[None], np.zeros((1, 3)))
    seen = forward_model.predict(blank, nominal)
    template = Observations(cell, pose, none, q, pose, none, seen.xyz, rotation=seen.rotation)
    return simulated.observe(template, 8, [wave_of_joint_five])


def test_a_quarter_of_a_period_is_no_gear_error_and_no_larger_than_the_misfit(seen_by_a_tracker):
    found = diagnose(seen_by_a_tracker)
    (effect,) = found.effects
    assert (effect.name, effect.where) == ("unknown", ("A5",))
    assert set(effect.parameters) == {"A5(q5).rms_mm"}
    assert effect.parameters["A5(q5).rms_mm"].value < found.fit.train.before_rms_mm
