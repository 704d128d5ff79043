"""Bags of ur_robot_driver and of the LBR's driver, in both encodings: the arm's joints among others, a marker among the frames of /tf."""

import numpy as np
import pytest
from driver_bags import CAMERA, TAG, at_times, stops_and_goes, write_lbr_bag, write_ur_bag
from rosbags.rosbag2 import StoragePlugin

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.bag import axes_among
from mbcacq.recording.datasets.cell_yaml import robot_of

PLUGINS = pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP], ids=["sqlite", "mcap"])
CELL = """format: mbcacq-observation-set/1
measurement: {measurement}
robot: {robot}
artefacts: [{{id: target, balls: [{{id: 1, centre_mm: [0, 0, 0]}}]}}]
stations: [{{id: place, artefact: target}}]
bag: {{file: run, {bag}}}
"""
HAND_EYE = se3.from_abc(np.array([40.0, -10.0, 90.0]), np.radians([10.0, -4.0, 3.0]))
MARKER = se3.from_abc(np.array([700.0, 100.0, 50.0]), np.radians([30.0, 0.0, 170.0]))
TRACKER = se3.from_abc(np.array([2500.0, 400.0, 300.0]), np.radians([140.0, 3.0, -2.0]))
REFLECTOR = np.array([30.0, -20.0, 110.0])


@PLUGINS
def test_a_marker_on_tf_beside_an_arm_with_a_gripper(tmp_path, plugin):
    robot = robot_of("ur10e")
    stops = np.radians([0, -80, 90, 0, 50, 0]) + np.random.default_rng(1).uniform(-0.4, 0.4, (6, 6))
    t, q = stops_and_goes(stops, 0.8, 0.6)
    times = np.arange(0.05, t[-1], 0.1)
    seen = se3.inverse(robot.chain.flange(at_times(t, q, times)) @ HAND_EYE) @ MARKER
    write_ur_bag(tmp_path / "run", plugin, t, q, times, seen)
    cell = CELL.format(measurement="artefact_in_scanner", robot="ur10e", bag=f"target: /tf, target_frame: '{TAG}'")
    (tmp_path / "cell.yaml").write_text(cell)
    obs = load_observations(tmp_path)
    np.testing.assert_allclose(obs.q, stops, atol=1e-9)
    truth = se3.inverse(robot.chain.flange(stops) @ HAND_EYE) @ MARKER
    np.testing.assert_allclose(obs.xyz, truth[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(obs.rotation, truth[:, :3, :3], atol=1e-9)
    for said, message in (("", "holds several frames"), (f", target_frame: {CAMERA}", f"has no frame '{CAMERA}'")):
        (tmp_path / "cell.yaml").write_text(cell.replace(f", target_frame: '{TAG}'", said))
        with pytest.raises(ConfigError, match=rf"the topic /tf {message}.*shoulder_link, {TAG}"):
            load_observations(tmp_path)


@PLUGINS
def test_a_reflector_beside_an_lbr(tmp_path, plugin):
    robot = robot_of("iiwa14")
    stops = np.random.default_rng(2).uniform(-0.8, 0.8, (5, 7))
    t, q = stops_and_goes(stops, 0.8, 0.6)
    times = np.arange(0.05, t[-1], 0.1)
    flange = robot.chain.flange(at_times(t, q, times))
    write_lbr_bag(tmp_path / "run", plugin, t, q, times, se3.apply(se3.inverse(TRACKER), se3.apply(flange, REFLECTOR)))
    bag = "joint_states: /lbr/joint_states, target: /tracker/point"
    (tmp_path / "cell.yaml").write_text(CELL.format(measurement="target_in_base", robot="iiwa14", bag=bag))
    obs = load_observations(tmp_path)
    np.testing.assert_allclose(obs.q, stops, atol=1e-9)
    truth = se3.apply(se3.inverse(TRACKER), se3.apply(robot.chain.flange(stops), REFLECTOR))
    np.testing.assert_allclose(obs.xyz, truth, atol=1e-6)


def test_the_axes_of_one_arm_are_picked_from_more_joints():
    gripper = ["finger_joint", "left_knuckle"]
    lbr = [f"lbr_A{i}" for i in range(1, 8)]
    assert axes_among([*gripper, *lbr], 7) == lbr
    assert axes_among(["left_a1", "left_a2", "right_a1", "right_a2"], 2) == ["left_a1", "left_a2", "right_a1", "right_a2"]
