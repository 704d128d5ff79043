"""A designed motion: at rest at both ends, within the limits, free of collisions, and telling what the recording did not."""

import csv
import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.cli.plan import command
from mbcacq.design.excitation import ExcitationOptions, at_rest, design_excitation
from mbcacq.errors import ConfigError
from mbcacq.geometry.dynamics import nominal_parameters, regressor
from mbcacq.model.trajectory import Trajectory
from mbcacq.plan import load
from mbcacq.plan.clearance import Clearance
from mbcacq.plan.motion_limits import motion_limits
from mbcacq.recording.datasets.trajectory_set import write_trajectory_set

PLAN = "plans/seeing.yaml"
SECONDS = 20.0
SMALL = ExcitationOptions(drawn=20, begun=4, improved=60)


@pytest.fixture(scope="module")
def loaded():
    return load(PLAN)


@pytest.fixture(scope="module")
def narrow(loaded):
    """Eight seconds over 27 deg to either side of A2's home, and little of the other axes; torques of the arm as described, and noise."""
    robot, rng = loaded.cell.robot, np.random.default_rng(4)
    time = np.arange(0.0, 8.0, 0.01)
    sine, cosine = rng.normal(size=(2, robot.n, 4))
    motion = at_rest(np.radians(loaded.plan.robot.home_deg), 8.0, sine, cosine)
    motion = motion.scaled(np.radians([10, 27, 10, 10, 10, 10]) / np.abs(motion.at(time) - motion.home).max(axis=0))
    q, qd, qdd = (motion.at(time, d) for d in range(3))
    described = nominal_parameters(robot.mass, robot.com, robot.payload_mass, robot.payload_com)
    torque = np.einsum("tjlk,lk->tj", regressor(robot.chain, q, qd, qdd, robot.gravity), described)
    return Trajectory(robot, time, q, torque=torque + rng.normal(0, 0.3, q.shape))


@pytest.fixture(scope="module")
def designed(loaded, narrow):
    return design_excitation(loaded, [narrow], SECONDS, options=SMALL)


def test_a_series_begins_and_ends_at_home_at_rest():
    rng, home = np.random.default_rng(1), np.array([0.3, -1.2])
    motion = at_rest(home, 7.0, rng.normal(size=(2, 5)), rng.normal(size=(2, 5)))

    ends = np.array([0.0, 7.0])

    np.testing.assert_allclose(motion.at(ends), [home, home], atol=1e-12)
    np.testing.assert_allclose(motion.at(ends, 1), 0.0, atol=1e-12)
    np.testing.assert_allclose(motion.at(ends, 2), 0.0, atol=1e-12)


def test_rates_of_a_series_are_its_derivatives():
    rng = np.random.default_rng(2)
    motion = at_rest(np.zeros(2), 7.0, rng.normal(size=(2, 5)), rng.normal(size=(2, 5)))
    t, h = np.array([2.3]), 1e-5

    for order in (1, 2, 3):
        difference = (motion.at(t + h, order - 1) - motion.at(t - h, order - 1)) / (2 * h)
        np.testing.assert_allclose(motion.at(t, order), difference, rtol=1e-6)


def test_the_designed_motion_keeps_all_limits(loaded, designed):
    time, limits, robot = np.linspace(0.0, SECONDS, 3001), motion_limits(loaded), loaded.cell.robot
    q = designed.motion.at(time)

    assert np.all(q > robot.limits[:, 0])
    assert np.all(q < robot.limits[:, 1])
    for order, most in enumerate((limits.speed, limits.acceleration, limits.jerk), start=1):
        assert np.all(np.abs(designed.motion.at(time, order)) < most)


def test_the_designed_motion_touches_nothing(loaded, designed):
    clearance = Clearance(loaded)
    q = designed.motion.at(np.linspace(0.0, SECONDS, 201))

    assert all(clearance.along_segment(a, b, None, loaded.plan.clearance_mm) is None for a, b in pairwise(q))


def test_the_designed_motion_tells_the_balancer_apart(designed):
    std = dict(zip(designed.names, designed.after / designed.before, strict=True))

    assert std["A2.stretched_Nm"] < 0.5
    assert std["A2.turned_Nm_per_rad"] < 0.2
    assert all(ratio <= 1.0 + 1e-9 for ratio in std.values())


def test_the_table_has_the_angles_of_the_motion_in_degrees(designed):
    head, *rows = csv.reader(designed.table().splitlines())
    values = np.array(rows, dtype=float)

    assert head == ["time_s", *(f"q{i}_deg" for i in range(1, 7))]
    assert values[-1, 0] == SECONDS
    np.testing.assert_allclose(np.radians(values[:, 1:]), designed.motion.at(values[:, 0]), atol=1e-6)


def test_recordings_without_torque_are_refused(loaded, narrow):
    with pytest.raises(ConfigError, match="no torque"):
        design_excitation(loaded, [replace(narrow, torque=None)], SECONDS)


def test_the_command_writes_a_table_and_replaces_none(narrow, tmp_path, monkeypatch):
    monkeypatch.setattr("mbcacq.design.excitation.OPTIONS", SMALL)
    write_trajectory_set(narrow, tmp_path / "set")
    asked = ["design", PLAN, "--motion", str(tmp_path / "set"), "--seconds", "5", "--out", str(tmp_path / "motion.csv"), "--json"]

    first, again = CliRunner().invoke(command, asked), CliRunner().invoke(command, asked)

    assert first.exit_code == 0, first.output
    assert set(json.loads(first.output)["std"]) >= {"A2.preload_Nm", "mass_kg"}
    assert (tmp_path / "motion.csv").read_text().startswith("time_s,q1_deg")
    assert "exists already" in str(again.exception)
