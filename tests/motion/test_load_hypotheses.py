"""Over a small range of the second axis a balancer cannot be told from masses that are not as described; the diagnosis says so."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from mbcacq.diagnosis.motion import diagnose
from mbcacq.diagnosis.motion.assemble import assemble
from mbcacq.diagnosis.motion.channel_groups import channel_groups
from mbcacq.diagnosis.motion.effect_selection import EffectSelection
from mbcacq.diagnosis.motion.fit import fit_selected
from mbcacq.diagnosis.motion.load_error import load_alternatives
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.text import motion_text
from mbcacq.geometry.dynamics import nominal_parameters, regressor
from mbcacq.model import shipped
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.trajectory import Trajectory


@pytest.fixture(scope="module")
def kr10():
    return RobotSpec.model_validate(yaml.safe_load(shipped.robot_file("kr10_r1100_2").read_text())).model()


def selection(robot, half_range_deg, heavier):
    """Eight seconds of motion, torques of an arm whose links are heavier than described by these shares, and the candidates for it."""
    rng, time = np.random.default_rng(2), np.arange(0.0, 8.0, 0.01)
    middle, reach = np.radians([0, -80, 90, 0, 60, 0]), np.radians([60, half_range_deg, 40, 60, 50, 60])
    speed, phase = rng.uniform(1.0, 2.5, 6), rng.uniform(-np.pi, np.pi, 6)
    q, qd, qdd = (reach * speed**d * np.sin(speed * time[:, None] + phase + d * np.pi / 2) for d in range(3))
    true = nominal_parameters(robot.mass * (1 + np.array(heavier)), robot.com, robot.payload_mass, robot.payload_com)
    torque = np.einsum("tjlk,lk->tj", regressor(robot.chain, q + middle, qd, qdd, robot.gravity), true)
    trajectory = Trajectory(robot, time, q + middle, torque=torque + rng.normal(0, 0.3, q.shape))
    recordings = diagnose.Recordings([trajectory])
    (group,) = channel_groups(recordings.runs, recordings.inertial, recordings.robot)
    return EffectSelection(MotionModel(group, recordings.runs)), recordings.runs


HEAVIER = [0.0, 0.08, -0.05, 0.06, 0.0, 0.0]


@pytest.mark.parametrize(
    ("half_range", "heavier", "asked"),
    [(27, HEAVIER, True), (27, [0.0] * 6, False), (65, HEAVIER, False)],
    ids=["narrow", "described", "wide"],
)
def test_a_balancer_is_an_alternative_where_masses_are_off_over_a_small_range(kr10, half_range, heavier, asked):
    chosen, _ = selection(kr10, half_range, heavier)

    found = [a for a in load_alternatives(chosen.model, chosen.pool) if a.effects[1] == "gravity_compensator:A2"]

    assert bool(found) == asked
    assert all(a.effects[0] == "arm" and 0.05 < a.odds <= 1.0 and a.correlation > 0.9 for a in found)


def test_the_verdict_says_that_it_cannot_tell_and_names_the_motion_that_would(kr10):
    chosen, runs = selection(kr10, 27, HEAVIER)
    fit = replace(fit_selected(chosen), load_alternatives=load_alternatives(chosen.model, chosen.pool))

    found = assemble([fit], runs, None)
    said = motion_text(found)

    assert found.verdict == "cannot_tell"
    assert type(found).from_json(found.to_json()) == found
    assert "arm and gravity_compensator at A2" in said
    assert re.search(r"Cannot be told apart: .*\(correlation [\d.]+, odds ", said)
    assert "plan design PLAN --motion" in said
