"""Joints in files: deg of one that turns, mm of one that slides, e1 of an external axis, nothing of one that another moves."""

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.recording.datasets.observation_set import read_observation_set, write_observation_set

CELL = """format: mbcacq-observation-set/1
measurement: target_in_base
robot:
  name: three axes on a track
  external_axes:
    - {name: E1, type: prismatic, direction: [2, 0, 0], limits_mm: [0, 4000], speed_mm_s: 500}
  links:
    - {theta_deg: 0, d_mm: 400, a_mm: 0, alpha_deg: -90, speed_deg_s: 90}
    - {theta_deg: 0, d_mm: 0, a_mm: 500, alpha_deg: 0, speed_deg_s: 90}
    - {theta_deg: 0, d_mm: 0, a_mm: 100, alpha_deg: 0, speed_deg_s: 90, follows: {link: 2, ratio: -1}}
artefacts: [{id: t, uncertainty_mm: 0.0, balls: [{id: 1, centre_mm: [0, 0, 0]}]}]
stations: [{id: one, artefact: t}]
"""
POSES = "pose,station,e1_mm,q1_deg,q2_deg,edir1,dir1,dir2\n1,one,1250.125,90,-30,1,-1,0\n2,one,0,0,45,-1,1,1\n"
CENTRES = "pose,ball,x_mm,y_mm,z_mm\n1,1,1,2,3\n2,1,4,5,6\n"


@pytest.fixture
def folder(tmp_path):
    for name, text in (("cell.yaml", CELL), ("poses.csv", POSES), ("centres.csv", CENTRES)):
        (tmp_path / name).write_text(text)
    return tmp_path


def test_positions_are_mm_of_a_slide_and_rad_of_a_turn(folder):
    obs = read_observation_set(folder)
    robot = obs.cell.robot
    assert robot.axes == ("E1", "A1", "A2", "A3")
    np.testing.assert_array_equal(obs.q, [[1250.125, np.pi / 2, np.radians(-30), 0], [0, 0, np.radians(45), 0]])
    np.testing.assert_array_equal(obs.direction, [[1, -1, 0, 0], [-1, 1, 1, 0]])
    np.testing.assert_allclose(robot.speed[:2], [500, np.pi / 2])
    # The first joint slides along x; the third keeps what it carries level: 600 mm reach at A2 = 0.
    at = robot.chain.flange(np.array([[1000.0, 0, 0, 0], [0, 0, 0.5, 0]]))
    np.testing.assert_allclose(at[0, :3, 3], [1600, 0, 400], atol=1e-9)
    np.testing.assert_allclose(at[1, :3, 3], [500 * np.cos(0.5) + 100, 0, 400 - 500 * np.sin(0.5)], atol=1e-9)


def test_what_is_written_reads_back_bit_for_bit(folder, tmp_path):
    obs = read_observation_set(folder)
    moved = obs.q.copy()
    moved[:, 0] += 1 / 3
    moved[:, 1] += 1e-17
    again = obs.__class__(**{**vars(obs), "q": moved, "cell_yaml": ""})
    write_observation_set(again, tmp_path / "again")
    found = read_observation_set(tmp_path / "again")
    np.testing.assert_array_equal(found.q, moved)
    assert found.cell.robot.chain.same_links(obs.cell.robot.chain)
    assert found.cell.robot.axes == obs.cell.robot.axes
    header = (tmp_path / "again" / "poses.csv").read_text().split("\n")[0]
    assert header == "pose,station,e1_mm,q1_deg,q2_deg,edir1,dir1,dir2"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("limits_mm: [0, 4000], ", "", "a prismatic joint needs limits_mm"),
        ("speed_mm_s: 500", "speed_deg_s: 5", "speed_deg_s is not for a prismatic joint; give speed_mm_s"),
        ("link: 2", "link: 7", "follows one that is not there"),
        ("name: E1", "name: Q1", "name"),
    ],
)
def test_a_joint_in_the_wrong_unit_is_named(folder, old, new, words):
    (folder / "cell.yaml").write_text(CELL.replace(old, new))
    with pytest.raises(ConfigError, match=words):
        read_observation_set(folder)
