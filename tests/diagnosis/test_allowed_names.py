"""A name is a physical claim: what the data want beyond what physics allows is unmodelled, at the same location and of the same size."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
import yaml

from mbcacq.calibration.calibrate import calibrate_with_effects
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.problem import prepare
from mbcacq.effects.support import refusal
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.recording.datasets.cell_writer import robot_to_yaml

SCALE = [("joint_scale", ("A5",), [4e-4], None)]


@pytest.fixture(scope="module")
def small():
    return simulated.plan(6, 3)


def test_a_geared_joint_has_no_scale_and_what_looks_like_one_is_unmodelled_there(small):
    recorded = simulated.observe(small, 55, SCALE, drives=False)
    found = diagnose(recorded, folds=2)
    assert [(e.name, e.where, e.depends_on) for e in found.effects] == [("unknown", ("A5",), "q5")]
    (said,) = [note for note in found.notes if note.startswith("joint_scale at A5")]
    assert "0.000" in said
    assert "refused as a name: the robot file states no drive of the joint" in said
    assert {(kept.name, kept.where, kept.depends_on) for kept in found.model.terms} == {("unknown", ("A5",), "q5")}
    moved = calibrate_with_effects(recorded, None, found.model).effects.displacements(recorded).joint[:, 4]
    assert np.polyfit(recorded.q[:, 4], moved, 1)[0] == pytest.approx(4e-4, abs=5e-5)


def test_a_belt_permits_the_name(small):
    found = diagnose(simulated.observe(small, 55, SCALE), folds=2)
    assert [(e.name, e.where) for e in found.effects] == [("joint_scale", ("A5",))]


def test_a_link_that_would_have_to_grow_by_a_centimetre_does_not_grow(small):
    growth = next(c for c in prepare(small).candidates if c.name == "thermal_growth" and c.where == ("link2",))
    robot, c = small.cell.robot, np.array([9.1 / np.ptp(small.temperatures["robot_C"])])
    assert refusal(growth, robot, c, np.eye(1) * (0.05 * c) ** 2) == growth.support.limit
    assert refusal(growth, robot, c, np.eye(1) * (0.5 * c) ** 2) == ""  # it may be as small as a link grows


def test_nothing_gives_way_against_its_load(small):
    problem = prepare(small)
    soft = next(c for c in problem.candidates if c.name == "joint_compliance" and c.where == ("A2",))
    robot = small.cell.robot
    assert refusal(soft, robot, np.array([-2e-6]), np.eye(1) * 1e-14) == "it cannot be negative"
    assert refusal(soft, robot, np.array([-2e-6]), np.eye(1) * 4e-12) == ""
    assert refusal(soft, robot, np.array([2e-6]), np.eye(1) * 1e-14) == ""


def test_every_effect_of_the_usual_size_is_one_that_physics_allows(small):
    for c in prepare(small).candidates:
        assert np.all(c.typical < np.broadcast_to(c.support.largest, c.typical.shape)), c.key


def test_the_robot_file_keeps_the_drives():
    robot = replace(simulated.robot(), drives=("gear", None, None, None, "belt", None))
    read = yaml.safe_load(robot_to_yaml("mbcacq-robot/1", robot))["robot"]
    assert RobotSpec.model_validate(read).model().drives == robot.drives
