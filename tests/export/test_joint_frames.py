"""Calibrated kinematics for ROS and MuJoCo: UR's own numbers come out, and MuJoCo stands where the chain says."""

import numpy as np
import pytest
import yaml

from mbcacq.exports.joint_frames import joint_frames, kinematics_yaml
from mbcacq.exports.mjcf import mjcf
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model import shipped
from mbcacq.model.cell_schema import RobotSpec


def calibrated(name):
    chain = RobotSpec.model_validate(yaml.safe_load(shipped.robot_file(name).read_text())).model().chain
    errors = np.random.default_rng(2).standard_normal((chain.n, 5)) * [1e-3, 0.3, 0.3, 1e-3, 1e-3]
    return chain, chain.with_errors(errors)


def test_nominal_ur10_gives_the_default_kinematics_of_its_description():
    """default_kinematics.yaml of ur_description, UR10."""
    found = yaml.safe_load(kinematics_yaml(calibrated("ur10")[0], "Universal Robots UR10"))["kinematics"]
    assert list(found) == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    known = {
        "shoulder": (0, 0, 0.1273, 0, 0, 0),
        "upper_arm": (0, 0, 0, np.pi / 2, 0, 0),
        "forearm": (-0.612, 0, 0, 0, 0, 0),
        "wrist_1": (-0.5723, 0, 0.163941, 0, 0, 0),
        "wrist_2": (0, -0.1157, 0, np.pi / 2, 0, 0),
        "wrist_3": (0, 0.0922, 0, np.pi / 2, np.pi, np.pi),
    }
    for link, (x, y, z, roll, pitch, yaw) in known.items():
        v = found[link]
        expected = se3.from_abc(np.array([x, y, z]), np.array([yaw, pitch, roll]))
        assert se3.from_abc(np.array([v["x"], v["y"], v["z"]]), np.array([v["yaw"], v["pitch"], v["roll"]])) == pytest.approx(
            expected, abs=1e-9
        )


@pytest.mark.parametrize("name", ["ur10", "kr10_r1100_2", "panda"])
def test_joints_that_turn_about_z_repeat_the_chain(name):
    _, chain = calibrated(name)
    frames, flange = joint_frames(chain)
    q = np.random.default_rng(1).uniform(-2, 2, chain.n)
    T = np.eye(4)
    for frame, angle in zip(frames, q, strict=True):
        T = T @ frame @ se3.transform(se3.rotation_exp(np.array([0, 0, angle])), np.zeros(3))
    assert T @ flange == pytest.approx(chain.flange(q[None])[0], abs=1e-9)


def test_mujoco_stands_where_the_calibrated_chain_says():
    mujoco = pytest.importorskip("mujoco")
    _, chain = calibrated("kr10_r1100_2")
    T_flange_scanner = se3.from_abc(np.array([1.0, 2, 265]), np.radians([90, 0, 180.0]))
    model = mujoco.MjModel.from_xml_string(mjcf(chain, T_flange_scanner, 'KR "10"'))
    data = mujoco.MjData(model)
    q = np.radians([20.0, -70, 100, 30, 40, -50])
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    expected = chain.flange(q[None])[0] @ T_flange_scanner
    assert 1e3 * data.site("scanner").xpos == pytest.approx(expected[:3, 3], abs=1e-6)
    assert data.site("scanner").xmat.reshape(3, 3) == pytest.approx(expected[:3, :3], abs=1e-9)


def test_a_single_row_is_its_own_frame():
    chain = Chain(np.array([-1.0, 1.0]), np.array([0.3, 0]), np.array([10.0, 5]), np.zeros(2), np.zeros(2), np.zeros(2))
    frames, flange = joint_frames(chain)
    assert frames[0] @ frames[1] @ flange == pytest.approx(chain.flange(np.zeros((1, 2)))[0])
