"""The robot of an observation set by the name of its file: what robot import writes is not pasted."""

import numpy as np
import pytest
import yaml

from mbcacq.errors import ConfigError
from mbcacq.model import shipped
from mbcacq.model.robot_import import import_robot
from mbcacq.recording.datasets.cell_yaml import parse_cell, read_cell
from mbcacq.recording.datasets.observation_set import read_observation_set

REST = """
hand_eye: {translation_mm: [0, 0, 80]}
artefacts:
  - {id: ball, balls: [{id: 1, centre_mm: [0, 0, 0], diameter_mm: 20}]}
stations:
  - {id: s, artefact: ball}
"""


@pytest.fixture
def cell(tmp_path):
    def cell(robot, rest=REST):
        path = tmp_path / "set" / "cell.yaml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"format: mbcacq-observation-set/1\nrobot: {robot}{rest}")
        return path

    return cell


def test_what_robot_import_writes_is_named(cell, tmp_path):
    (tmp_path / "rows.csv").write_text("theta_deg,d_mm,a_mm,alpha_deg\n0,400,25,-90\n0,0,560,0\n-90,0,25,-90\n")
    (tmp_path / "arm.yaml").write_text(import_robot(tmp_path / "rows.csv", convention="standard", name="Arm: no. 1").text)
    path = cell("../arm.yaml   # the arm of hall 3")
    read, text = read_cell(path)
    assert read.robot.name == "Arm: no. 1"
    assert read.robot.chain.d.tolist() == [400, 0, 0]
    assert "# the arm of hall 3" in text
    # The text is whole: a recording of it is enough to calibrate again, wherever it is read.
    np.testing.assert_array_equal(parse_cell(text).robot.chain.rows, read.robot.chain.rows)
    (path.parent / "poses.csv").write_text("q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n0,0,0,1,2,3\n1,2,3,4,5,6\n")
    assert parse_cell(read_observation_set(path.parent).cell_yaml).robot.name == "Arm: no. 1"


@pytest.mark.parametrize("name", ["08", "1e3", "yes", "0x1F", "~", "1.0"])
def test_a_name_that_reads_like_another_type_stays_the_text_that_it_is(cell, tmp_path, name):
    own = shipped.robot_file("ur10e").read_text()
    (tmp_path / "arm.yaml").write_text(own.replace(f"name: {yaml.safe_load(own)['name']}", f'name: "{name}"', 1))
    read, text = read_cell(cell("../arm.yaml"))
    assert (read.robot.name, parse_cell(text).robot.name) == (name, name)


def test_a_robot_of_the_tool_is_named(cell):
    known = yaml.safe_load(shipped.robot_file("ur10e").read_text())
    assert read_cell(cell("ur10e"))[0].robot.name == known["name"]


@pytest.mark.parametrize(
    ("robot", "file", "words"),
    [
        ("../none.yaml", "", r"cell.yaml:2: robot: there is no file ../none.yaml"),
        ("../arm.yaml", "name: a\nlinks:\n  - {theta_deg: 0}\n", r"arm.yaml:\d+: "),
        ("../arm.yaml", "- 1\n", r"arm.yaml:1: this is no robot file"),
    ],
)
def test_a_robot_file_that_is_absent_or_damaged_is_named_with_its_line(cell, tmp_path, robot, file, words):
    (tmp_path / "arm.yaml").write_text(file)
    with pytest.raises(ConfigError, match=words):
        read_cell(cell(robot))
