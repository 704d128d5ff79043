"""The hand-eye transform for ROS 2: metres, x y z w, flange to scanner."""

import ast
import shlex

import numpy as np
import pytest
import read_back
import yaml

from mbcacq.errors import ConfigError
from mbcacq.exports import ros

# half a turn about x and 265 mm out
T = np.array([[1.0, 0, 0, 1.5], [0, -1, 0, -2.0], [0, 0, -1, 265.0], [0, 0, 0, 1]])


def test_easy_handeye2_reads_metres_and_a_quaternion():
    data = yaml.safe_load(ros.hand_eye_yaml(T, name="cell_1"))
    assert data["transform"]["translation"] == {"x": 0.0015, "y": -0.002, "z": 0.265}
    assert data["transform"]["rotation"] == pytest.approx({"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0})
    assert data["parameters"]["calibration_type"] == "eye_in_hand"
    assert data["parameters"]["robot_effector_frame"] == "tool0"


def test_an_easy_handeye2_file_reads_back(tmp_path):
    rng = np.random.default_rng(0)
    R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotated = T.copy()
    rotated[:3, :3] = R * np.sign(np.linalg.det(R))
    path = tmp_path / "a.calib"
    path.write_text(ros.hand_eye_yaml(rotated, name="a"))
    np.testing.assert_allclose(read_back.hand_eye(path), rotated, atol=1e-12)


def test_the_command_and_the_launch_file_say_the_same():
    words = shlex.split(ros.static_transform_command(T))
    assert words[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    assert words[words.index("--frame-id") + 1] == "tool0"
    assert float(words[words.index("--z") + 1]) == 0.265
    tree = ast.parse(ros.launch_file(T))
    lists = [
        [e.value for e in node.elts]
        for node in ast.walk(tree)
        if isinstance(node, ast.List) and all(isinstance(e, ast.Constant) for e in node.elts)
    ]
    assert words[4:] in lists


def test_a_frame_name_cannot_carry_code():
    with pytest.raises(ConfigError, match="name of a ROS frame"):
        ros.launch_file(T, parent='x"); import os; ("')
