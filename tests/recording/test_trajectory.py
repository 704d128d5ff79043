from __future__ import annotations

import numpy as np
import pytest
import synthetic

from mbcacq.errors import ConfigError
from mbcacq.model import shipped
from mbcacq.recording import load_observations, load_whole_trajectories
from mbcacq.recording.datasets.trajectory_set import read_trajectory_set, write_trajectory_set
from mbcacq.recording.rrd.trajectory_recording import trajectory_of_run

ROBOT = """\
format: mbcacq-trajectory-set/1
robot:
  name: two axes
  links:
    - {theta_deg: 0, d_mm: 100, a_mm: 0, alpha_deg: 90}
    - {theta_deg: 0, d_mm: 0, a_mm: 200, alpha_deg: 0}
  gear_ratio: [100, 50.5]
"""
SAMPLES = (
    "time_s,q1_deg,q2_deg,q1_joint_deg,tau1_Nm,tau2_Nm,i1_percent,i2_percent,oil_C,note\n"
    "0,90,-45,89.99,1,2,10,20,40,a\n0.004,91,-46,90.98,1.5,2.5,11,21,40.5,b\n"
)


@pytest.fixture
def a_trajectory(tmp_path):
    (tmp_path / "cell.yaml").write_text(ROBOT)
    (tmp_path / "trajectory.csv").write_text(SAMPLES)
    return tmp_path


def test_the_values_of_a_small_set_are_read(a_trajectory):
    t = read_trajectory_set(a_trajectory)
    assert t.robot.gear_ratio.tolist() == [100, 50.5]
    assert t.q[0].tolist() == [np.pi / 2, -np.pi / 4]
    assert t.q_joint[1, 0] == np.radians(90.98)
    assert np.isnan(t.q_joint[:, 1]).all()  # that joint has no encoder on its side
    assert t.torque.tolist() == [[1, 2], [1.5, 2.5]]
    assert t.current_unit == "percent"
    assert t.current.tolist() == [[10, 20], [11, 21]]
    assert t.temperatures["oil_C"].tolist() == [40, 40.5]
    assert t.extra["note"].tolist() == ["a", "b"]
    assert (t.q_set, t.motor_torque) == (None, None)


def test_a_trajectory_survives_writing_and_reading(a_trajectory, tmp_path):
    t = read_trajectory_set(a_trajectory)
    write_trajectory_set(t, tmp_path / "copy")
    back = read_trajectory_set(tmp_path / "copy")
    for name in ("time_s", "q", "q_joint", "torque", "current"):
        np.testing.assert_array_equal(getattr(back, name), getattr(t, name))
    np.testing.assert_array_equal(back.robot.chain.rows, t.robot.chain.rows)


def test_measured_trajectories_are_read_whole(shared_data):
    t = read_trajectory_set(shared_data / "kr300-trajectory-a")
    assert t.q.shape == t.q_set.shape == t.motor_torque.shape == (2501, 6)
    assert np.isfinite(t.q_joint).all(axis=0).tolist() == [True, True, True, False, False, False]
    assert t.robot.name == "KUKA KR 300 R2500 ultra SE with joint-side encoders on A1..A3"
    assert t.robot.chain.a[1] == 1150.0
    assert t.robot.gear_ratio[0] == 256.8571


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("trajectory.csv", "0.004", "0", r"trajectory\.csv:3: column time_s: the time does not rise"),
        ("trajectory.csv", "q2_deg", "q2", r"trajectory\.csv:1: column q2_deg is missing"),
        ("trajectory.csv", "90.98", "x", r"trajectory\.csv:3: column q1_joint_deg: 'x' is not a number"),
        ("cell.yaml", "[100, 50.5]", "[100]", r"cell\.yaml: robot: gear_ratio has 1 numbers, the robot 2 axes"),
        ("cell.yaml", "  name: two axes", "  model: kr300_r2700_2", r"cell\.yaml: robot: give either its links or the model"),
        ("cell.yaml", "trajectory-set", "observation-set", r"cell\.yaml:1: format"),
    ],
)
def test_a_fault_is_named_with_its_place(a_trajectory, file, old, new, message):
    path = a_trajectory / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message):
        read_trajectory_set(a_trajectory)


def test_a_shipped_robot_is_taken_by_its_name(tmp_path):
    assert "kr300_r2700_2" in shipped.robots()
    (tmp_path / "cell.yaml").write_text("format: mbcacq-trajectory-set/1\nrobot: {model: kr6_r900_2, payload: {mass_kg: 2}}\n")
    (tmp_path / "trajectory.csv").write_text("time_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,0,0,0,0,0,0\n")
    robot = read_trajectory_set(tmp_path).robot
    assert robot.n == 6
    assert robot.payload_mass == 2
    (tmp_path / "cell.yaml").write_text("format: mbcacq-trajectory-set/1\nrobot: {model: kr999}\n")
    with pytest.raises(ConfigError, match="there is no robot 'kr999' among those of the tool"):
        read_trajectory_set(tmp_path)


def test_load_observations_refuses_a_trajectory_set(a_trajectory):
    with pytest.raises(ConfigError, match="only mbcacq diagnose takes it"):
        load_observations(a_trajectory)


def test_the_cycles_of_a_run_are_a_trajectory(a_run):
    from mbcacq.acquisition.events import CyclesReceived

    sent = [e.cycles.columns for e in synthetic.run() if isinstance(e, CyclesReceived)]
    t = trajectory_of_run(a_run)
    np.testing.assert_array_equal(t.q, np.concatenate([c["q"] for c in sent]))
    np.testing.assert_array_equal(t.q_set, np.concatenate([c["q_command"] for c in sent]))
    assert np.all(np.diff(t.time_s) > 0)
    assert t.robot.name == "six axes"


def test_load_trajectories_takes_one_path_or_several_of_either_kind(a_run, a_trajectory):
    run, folder = load_whole_trajectories([a_run, str(a_trajectory)])
    np.testing.assert_array_equal(run.q, trajectory_of_run(a_run).q)
    np.testing.assert_array_equal(folder.q, read_trajectory_set(a_trajectory).q)
    assert [t.name for t in load_whole_trajectories(a_trajectory)] == [str(a_trajectory)]


def test_load_trajectories_refuses_what_holds_no_trajectory(a_set):
    with pytest.raises(ConfigError, match="holds no trajectory"):
        load_whole_trajectories(a_set)
