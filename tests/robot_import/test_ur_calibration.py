"""The factory calibration of a UR arm, as its ROS driver extracts it, becomes a robot file."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from mbcacq.errors import ConfigError
from mbcacq.exports.joint_frames import kinematics_yaml
from mbcacq.geometry import se3
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.robot_import.import_robot import import_robot

ROBOTS = Path(__file__).parents[2] / "plans" / "robots"
# Numbers of a UR10e by its data sheet, with the deviations (some 0.1 mm and 1e-4 rad) that a calibration has.
CALIBRATION = """
kinematics:
  shoulder: {x: 0, y: 0, z: 0.18083, roll: 0, pitch: 0, yaw: 4.2e-05}
  upper_arm: {x: 0.00014, y: 0, z: 0, roll: 1.570441, pitch: 0, yaw: -1.1e-05}
  forearm: {x: -0.61288, y: 0, z: 0, roll: 3.141022, pitch: 3.140877, yaw: 3.141587}
  wrist_1: {x: -0.57144, y: -0.00036, z: 0.17415, roll: 0.002088, pitch: -0.001032, yaw: 1.2e-05}
  wrist_2: {x: 5.1e-05, y: -0.11981, z: -0.00026, roll: 1.572957, pitch: 0, yaw: 2.7e-06}
  wrist_3: {x: -3.4e-05, y: 0.11651, z: 0.00019, roll: 1.569156, pitch: 3.141593, yaw: -3.141592}
  hash: calib_1215668310164322373
"""


def written(tmp_path, text=CALIBRATION):
    path = tmp_path / "ur10e_calibration.yaml"
    path.write_text(text)
    return path


def by_the_definition(content, q):
    """Frame after frame: translate, turn by roll, pitch, yaw about fixed axes, turn by the joint's angle about z."""
    T = np.eye(4)
    for link, angle in zip(("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"), q, strict=True):
        e = content["kinematics"][link]
        R = np.eye(3)
        for axis, turn in ((0, e["roll"]), (1, e["pitch"]), (2, e["yaw"])):
            R = se3.rotation_exp(turn * np.eye(3)[axis][None])[0] @ R
        T = (
            T
            @ se3.transform(R, 1e3 * np.array([e["x"], e["y"], e["z"]]))
            @ se3.transform(se3.rotation_exp(np.array([[0, 0, angle]]))[0], np.zeros(3))
        )
    return T


def test_its_forward_kinematics_is_repeated(tmp_path):
    found = import_robot(written(tmp_path), speed_deg_s=120)
    model = RobotSpec.model_validate(yaml.safe_load(found.text)).model()
    for q in np.random.default_rng(1).uniform(-3, 3, (20, 6)):
        made = found.T_given_base @ model.chain.flange(q[None])[0] @ found.T_flange_given
        np.testing.assert_allclose(made, by_the_definition(yaml.safe_load(CALIBRATION), q), atol=1e-5)
    assert found.base == "base"
    assert "calib_1215668310164322373" in found.text


def test_what_is_exported_for_ros_is_read_back(tmp_path):
    text = (ROBOTS / "ur10e.yaml").read_text()
    chain = RobotSpec.model_validate(yaml.safe_load(text)).model().chain
    found = import_robot(written(tmp_path, kinematics_yaml(chain, "UR10e")))
    model = RobotSpec.model_validate(yaml.safe_load(found.text)).model()
    q = np.random.default_rng(2).uniform(-3, 3, (20, 6))
    made = found.T_given_base @ model.chain.frames(q)[:, -2] @ np.eye(4)
    np.testing.assert_allclose(made[:, :3, 3], chain.frames(q)[:, -2, :3, 3], atol=1e-3)


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("z: 0.18083", "z: 180.83", "lengths are in metres"),
        ("roll: 1.570441", "roll: ninety", "kinematics.upper_arm: needs the numbers"),
        ("x: 0.00014, ", "", "kinematics.upper_arm: needs the numbers"),
        ("pitch: 3.140877", "pitch: .nan", "kinematics.forearm: needs the numbers"),
    ],
)
def test_an_entry_that_is_wrong_is_named(tmp_path, before, after, sentence):
    with pytest.raises(ConfigError, match=sentence):
        import_robot(written(tmp_path, CALIBRATION.replace(before, after)))
