"""A scan brought into the base frame: exactly where the calibrated cell puts it, and as well known as said."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.calibration.calibrate import calibrate
from mbcacq.cli.app import app
from mbcacq.cli.apply import command
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.exports.format import chains
from mbcacq.exports.scan_correction import place_scan
from mbcacq.files.open3d_library import open3d
from mbcacq.geometry import se3
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.geometry.flange_poses import flange_coordinates
from mbcacq.model.cell import Artefact, Cell, Station, arm_of_flange_poses
from mbcacq.model.observations import Observations
from mbcacq.quantities import uncertainty
from mbcacq.recording.datasets.cell_yaml import robot_of
from mbcacq.workflow.arm_positions import typed_joints
from mbcacq.workflow.load import counted_joints

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


def test_joint_angles_count_as_the_plan_of_the_run_says_that_the_controller_counts_them(solved, tmp_path):
    """FANUC: J3 = q3 - q2, from the horizontal; here J6 = q6 + 90 deg beside it."""
    counts = "{couplings: [{axis: 3, of: 2, factor: -1}], offset_deg: [0, 0, 0, 0, 0, 90]}"
    (tmp_path / "plan.yaml").write_text(f"robot:\n  controller_joints: {counts}\n")
    of_a_run = {**solved[0], **counted_joints(tmp_path, 6)}
    np.testing.assert_allclose(typed_joints("10,20,-30,5,45,100", of_a_run).q, np.radians([10, 20, -10, 5, 45, 10]))
    on_a_track = {**solved[0], "robot": {**solved[0]["robot"], "sliding": [0]}}
    np.testing.assert_allclose(typed_joints("1500,20,-30,5,45,100", on_a_track).q, [1500, *np.radians([20, -30, 5, 45, 100])])


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


def test_joint_angles_in_radians_are_refused(result_file, tmp_path):
    """0.1 to 2.1 rad are taken for a posture near zero otherwise, and the cloud lands a metre away."""
    (tmp_path / "scan.ply").write_text(ONE_POINT)
    joints = "--joints=0.1,-1.2,2.1,0,0.4,1.5"
    with pytest.raises(ConfigError, match=r"looks like radians; give them in degrees \(\[6, -69, 120, 0, 23, 86\]\)"):
        CliRunner().invoke(command, [str(result_file), joints, str(tmp_path / "scan.ply")], catch_exceptions=False)


def nominal_cell(X, *, of_flange):
    """A result of a cell whose hand-eye transform alone was calibrated: of a UR10e, or of the poses of its flange."""
    robot = robot_of("ur10e")
    rng = np.random.default_rng(2)
    q = np.radians([0, -80, 90, 0, 50, 0]) + rng.uniform(-0.6, 0.6, (14, 6))
    F = robot.chain.flange(q)
    board = se3.inverse(F @ X) @ se3.from_abc(np.array([700.0, 50, 20]), np.radians([20.0, 5, 3]))
    arm, q = (arm_of_flange_poses("arm", None, flange_coordinates(F)), flange_coordinates(F)) if of_flange else (robot, q)
    artefact = Artefact("board", "", (1,), np.zeros((1, 3)), np.zeros(1))
    cell = Cell(arm, X, (artefact,), (Station("s", "board"),))
    k = np.arange(14)
    obs = Observations(cell, k + 1, 0 * k, q, k, 0 * k, board[:, :3, 3], rotation=board[:, :3, :3])
    return calibrate(obs, CalibrationOptions(kinematics=False)).to_dict()


@pytest.fixture(scope="module")
def clouds(tmp_path_factory):
    """Twelve clouds of one point of the base, with tables of the joint angles and of the flange's poses, and both results."""
    folder = tmp_path_factory.mktemp("placed")
    X = se3.from_abc(np.array([40.0, -20, 110]), np.radians([30.0, -5, 170]))
    q = np.radians([0, -80, 90, 0, 50, 0]) + np.random.default_rng(4).uniform(-0.5, 0.5, (12, 6))
    F = robot_of("ur10e").chain.flange(q)
    point = np.array([600.0, -80, 120])
    (folder / "clouds").mkdir()
    joints, flange = ["file,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"], ["file,X,Y,Z,A,B,C"]
    for k, (angles, T) in enumerate(zip(q, F, strict=True), 1):
        x, y, z = se3.apply(se3.inverse(T @ X), point)
        header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
        (folder / "clouds" / f"scan{k}.ply").write_text(f"{header}{x:.9f} {y:.9f} {z:.9f}\n")
        joints.append(f"scan{k}.ply," + ",".join(f"{v:.10f}" for v in np.degrees(angles)))
        xyz, abc = se3.to_abc(T)
        flange.append(f"scan{k}.ply," + ",".join(f"{v:.10f}" for v in (*xyz, *np.degrees(abc))))
    (folder / "joints.csv").write_text("\n".join([joints[0], *joints[:0:-1]]) + "\n")  # in another order
    (folder / "flange.csv").write_text("\n".join(flange) + "\n")
    (folder / "arm.json").write_text(json.dumps(nominal_cell(X, of_flange=False)))
    (folder / "poses.json").write_text(json.dumps(nominal_cell(X, of_flange=True)))
    return folder, point, flange[5]


@pytest.mark.parametrize(("result", "table"), [("arm.json", "joints.csv"), ("arm.json", "flange.csv"), ("poses.json", "flange.csv")])
def test_a_folder_is_placed_by_joints_and_by_poses_of_the_flange_alike(clouds, tmp_path, result, table):
    folder, point, _ = clouds
    words = [str(folder / result), str(folder / "clouds"), "--poses", str(folder / table), "--out", str(tmp_path / "placed"), "--json"]
    done = CliRunner().invoke(command, words + (["--orientation", "kuka"] if table == "flange.csv" else []), catch_exceptions=False)
    said = json.loads(done.stdout)
    assert said["matched"] == "rows are matched by the names in column file"
    assert len(said["clouds"]) == 12
    for k in range(1, 13):
        placed = (tmp_path / "placed" / f"scan{k}_base.ply").read_bytes().split(b"end_header\n")[1]
        np.testing.assert_allclose(np.frombuffer(placed, "<f8", 3), point, atol=2e-6)


def test_what_a_table_of_positions_leaves_open_is_asked(clouds, tmp_path):
    folder, point, row = clouds
    given = [str(folder / "poses.json"), str(folder / "clouds"), "--out", str(tmp_path / "out")]
    open_ = CliRunner().invoke(command, [*given, "--poses", str(folder / "flange.csv")])
    assert "leave the convention of the orientation open; say --orientation" in str(open_.exception)
    (tmp_path / "short.csv").write_text("\n".join((folder / "flange.csv").read_text().splitlines()[:-1]) + "\n")
    short = CliRunner().invoke(command, [*given, "--poses", str(tmp_path / "short.csv"), "--orientation", "kuka"])
    assert "column file has no row for scan12.ply" in str(short.exception)
    assert not (tmp_path / "out").exists()
    one = [str(folder / "poses.json"), str(folder / "clouds" / "scan5.ply"), "--out", str(tmp_path / "one.ply")]
    wrong = CliRunner().invoke(command, [*one, f"--flange={row.split(',', 1)[1]}", "--orientation", "abb"])
    assert "--flange has 6 numbers" in str(wrong.exception)
    assert CliRunner().invoke(command, [*one, f"--flange={row.split(',', 1)[1]}", "--orientation", "kuka"]).exit_code == 0
    placed = (tmp_path / "one.ply").read_bytes().split(b"end_header\n")[1]
    np.testing.assert_allclose(np.frombuffer(placed, "<f8", 3), point, atol=2e-6)


def test_a_pose_of_the_flange_does_not_tell_the_posture_of_an_arm_with_calibrated_links(solved):
    with pytest.raises(ConfigError, match="this result corrects the arm's links"):
        place_scan(solved[0], flange_coordinates(np.eye(4)[None])[0], np.zeros((1, 3)), flange=True)
