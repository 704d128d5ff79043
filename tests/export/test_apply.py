"""A scan brought into the base frame: exactly where the calibrated cell puts it, and as well known as said."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from peer_open3d import open3d

from mbcacq.cli.app import app
from mbcacq.cli.apply import command
from mbcacq.errors import ConfigError
from mbcacq.exports.format import chains
from mbcacq.exports.scan_correction import place_scan
from mbcacq.geometry import se3
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.quantities import uncertainty

ONE_POINT = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
Q = np.radians([10.0, -60, 95, 15, 35, 20])


def box(rng, n=500):
    return rng.uniform([-40, -40, -30], [40, 40, 30], (n, 3))


def test_points_go_where_the_true_cell_has_them(solved):
    result, _, truth, T_hand = solved
    points = box(np.random.default_rng(0))
    moved, placed = place_scan(result, Q, points.astype(np.float32))
    should = se3.apply(truth.flange(Q[None])[0] @ T_hand, points)
    assert moved.dtype == np.float64
    assert np.abs(moved - should).max() < 4 * placed.worst_mm
    assert placed.worst_mm < 0.1


def test_the_uncertainty_is_the_scatter_of_cells_drawn_from_the_covariance(solved):
    result = solved[0]
    _, calibrated = chains(result)
    T_hand = np.array(result["T_flange_scanner"])
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(np.zeros(len(result["names"])), np.array(result["covariance"]), 3000, method="eigh")
    corner = np.array([[40.0, -40, 30], [-40, 40, -30]])
    positions = []
    for draw in draws:
        errors, twist = np.zeros((6, 5)), np.zeros(6)
        for name, value in zip(result["names"], draw, strict=True):
            if name.startswith("hand_eye."):
                twist[["x", "y", "z", "rx", "ry", "rz"].index(name[9:])] = value
            elif not name.startswith("ball_"):
                p, i = name.split("_")
                errors[int(i) - 1, PARAMETERS.index(p)] = value
        T = calibrated.with_errors(errors).flange((Q + rng.normal(0, result["noise"]["joint_rad"]))[None])[0] @ T_hand @ se3.exp(twist)
        positions.append(se3.apply(T, corner).mean(axis=0))
    _, placed = place_scan(result, Q, corner)
    np.testing.assert_allclose(np.std(positions, axis=0), placed.total_mm, rtol=0.08)
    np.testing.assert_allclose(placed.total_mm**2, placed.parameters_mm**2 + placed.repeatability_mm**2)


def test_wrong_joints_are_refused(solved):
    with pytest.raises(ConfigError, match="6 axes, 5 joint angles"):
        place_scan(solved[0], Q[:5], np.zeros((1, 3)))
    with pytest.raises(ConfigError, match="not a finite number"):
        place_scan(solved[0], Q * np.nan, np.zeros((1, 3)))


@pytest.mark.parametrize(("joint", "angle"), [(0, 170.1), (2, -171.0), (5, 361.0)])
def test_joints_the_arm_cannot_reach_are_refused(solved, result_file, tmp_path, joint, angle):
    """Limits of this arm: -170 to 170 deg on every axis."""
    q = np.degrees(Q)
    q[joint] = angle
    with pytest.raises(ConfigError, match=f"joint {joint + 1} at {angle:g}° is outside its limits -170 to 170°"):
        place_scan(solved[0], np.radians(q), np.zeros((1, 3)))
    (tmp_path / "scan.ply").write_text(ONE_POINT)
    outcome = CliRunner().invoke(app, ["apply", str(result_file), "--joints", ",".join(map(str, q)), str(tmp_path / "scan.ply")])
    assert outcome.exit_code == 2
    assert not (tmp_path / "scan_base.ply").exists()


def test_an_angle_on_its_limit_and_a_result_without_limits_are_taken(solved):
    """Both go where the true cell has them; the second posture is outside the limits that this result does not state."""
    result, _, truth, T_hand = solved
    on = np.radians([170.0, -60, 95, 15, 35, 20])
    older = {**result, "robot": {k: v for k, v in result["robot"].items() if k != "limits"}}
    for stated, q in ((result, on), (older, on + 0.2)):
        moved, placed = place_scan(stated, q, np.zeros((1, 3)))
        assert np.abs(moved[0] - (truth.flange(q[None])[0] @ T_hand)[:3, 3]).max() < 4 * placed.worst_mm


def test_the_uncertainty_of_the_cloud_is_printed(solved, result_file, tmp_path):
    (tmp_path / "scan.ply").write_text(ONE_POINT)
    outcome = CliRunner().invoke(
        app, ["apply", str(result_file), "--joints", ",".join(map(str, np.degrees(Q))), str(tmp_path / "scan.ply")]
    )
    _, placed = place_scan(solved[0], Q, np.array([[1.0, 2, 3]]))
    assert outcome.exit_code == 0
    assert f"3D {2e3 * placed.rms_mm:.0f} µm in the middle" in outcome.stdout
    for sigma in placed.total_mm:
        assert uncertainty(2e3 * sigma) in outcome.stdout


def test_the_command_keeps_what_the_cloud_carries(solved, result_file, tmp_path):
    rng = np.random.default_rng(2)
    points, normals = box(rng, 50), np.tile([0.0, 0, 1], (50, 1))
    o3d = open3d()
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(points))
    cloud.point["intensity"] = o3d.core.Tensor(np.arange(50, dtype=np.float32)[:, None])
    cloud.point["normals"] = o3d.core.Tensor(normals)
    source = tmp_path / "scan.ply"
    o3d.t.io.write_point_cloud(str(source), cloud)
    outcome = CliRunner().invoke(command, [str(result_file), "--joints", ",".join(map(str, np.degrees(Q))), str(source), "--json"])
    assert outcome.exit_code == 0, outcome.output
    said = json.loads(outcome.stdout)
    T = np.array(said["T_base_scanner"])
    back = o3d.t.io.read_point_cloud(said["output"])
    np.testing.assert_allclose(back.point.positions.numpy(), se3.apply(T, points), atol=1e-9)
    np.testing.assert_array_equal(back.point.intensity.numpy()[:, 0], np.arange(50))
    np.testing.assert_allclose(back.point.normals.numpy(), normals @ T[:3, :3].T, atol=1e-6)
    with pytest.raises(ConfigError, match="--force"):
        CliRunner().invoke(command, [str(result_file), "--joints=0,0,0,0,0,0", str(source)], catch_exceptions=False)


@pytest.mark.parametrize("joints", ["", "a,b", "1;2;x"])
def test_joint_angles_that_are_no_numbers_are_refused(result_file, tmp_path, joints):
    with pytest.raises(ConfigError, match="is not a list of numbers"):
        CliRunner().invoke(command, [str(result_file), "--joints", joints, str(tmp_path / "a.ply")], catch_exceptions=False)
