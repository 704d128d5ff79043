"""A wrong pose that hides in the joint noise is named; joint noise beyond the data sheet is never silent."""

from dataclasses import replace

import numpy as np
import pytest
from cells import scanner_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.recording_faults import deletions
from mbcacq.cli.tables import remarks
from mbcacq.estimation.adjustment import adjust
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solver import solve


def ten_poses(seed):
    return scanner_cell(np.random.default_rng(seed), stations=2, per_station=5).observations


def with_pose_off(obs, pose=3, mm=0.512):
    xyz = obs.xyz.copy()
    xyz[obs.pose == pose] += [0, 0, mm]
    return replace(obs, xyz=xyz)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_pose_that_hides_in_the_joint_noise_of_a_small_plan_is_named(seed):
    found = calibrate(with_pose_off(ten_poses(seed)), CalibrationOptions(refuse=False))
    content = found.to_dict()
    assert found.fit.rejected == ()
    assert found.noise.joint.mean() > 80e-6
    assert content["joint_noise_check"]["pose"] == 3
    assert "Look at pose 3 first" in content["warnings"][0]
    assert any("Warning: The estimated joint noise is" in line for line in remarks(content))


@pytest.mark.parametrize("seed", range(3))
def test_a_recording_without_a_wrong_pose_has_no_new_key(seed):
    content = calibrate(ten_poses(seed), CalibrationOptions(refuse=False)).to_dict()
    assert not {"joint_noise_check", "warnings"} & content.keys()


def test_the_linearised_deletion_is_that_of_a_fit_without_the_pose():
    obs = scanner_cell(np.random.default_rng(1), stations=3, per_station=6).observations
    fitted = adjust(obs, CalibrationOptions(refuse=False))
    solution = solve(fitted.solution, tolerance=1e-10)
    names = fitted.lineariser.layout.names
    hand_eye = np.array([i for i, name in enumerate(names) if name.startswith("hand_eye.")])
    deleted = deletions(solution, hand_eye)
    for pose in (0, 7, 17):
        weight = np.ones(obs.n_poses)
        weight[pose] = 0.0
        without = solve(solution, weights=Weights(fitted.weights.centre, weight), tolerance=1e-10)
        assert solution.cost - without.cost == pytest.approx(deleted.chi2[pose], rel=0.02)
        moved = np.linalg.inv(solution.estimate.state.T_flange_scanner) @ without.estimate.state.T_flange_scanner
        np.testing.assert_allclose(moved[:3, 3], deleted.shift[pose][:3], rtol=0.1, atol=2e-4)
