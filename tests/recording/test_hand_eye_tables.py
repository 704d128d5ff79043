"""Tables of flange and target poses as controllers, cameras and other programs write them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import mbcacq
from mbcacq.cli.data import command
from mbcacq.errors import ConfigError
from mbcacq.geometry import orientations, se3
from mbcacq.recording.datasets.cell_yaml import robot_of
from mbcacq.recording.datasets.hand_eye_sets import read_hand_eye_files
from mbcacq.recording.datasets.loose_table import TableOptions, read_loose_table

X = se3.transform(Rotation.from_euler("ZYX", [-90, 2, 178], degrees=True).as_matrix(), np.array([40.0, -20, 110]))
Z = se3.transform(Rotation.from_euler("ZYX", [20, 5, 3], degrees=True).as_matrix(), np.array([700.0, 50, 20]))
ALONE = mbcacq.CalibrationOptions(kinematics=False)


def poses(n=20, seed=1):
    rng = np.random.default_rng(seed)
    down = Rotation.from_euler("x", 180, degrees=True).as_matrix()
    F = se3.transform(down @ se3.rotation_exp(0.35 * rng.normal(size=(n, 3))), np.array([650.0, 0, 450]) + 80 * rng.normal(size=(n, 3)))
    return F, se3.inverse(F @ X) @ Z


def rotations(F):
    return Rotation.from_matrix(F[:, :3, :3])


def write(path, header, *columns, separator=","):
    rows = np.column_stack(columns)
    text = "\n".join(separator.join(f"{v:.7f}" for v in row) for row in rows)
    Path(path).write_text(f"{header}\n{text}\n")
    return Path(path)


WRITTEN = {
    "kuka": ("X,Y,Z,A,B,C", lambda F: (F[:, :3, 3], rotations(F).as_euler("ZYX", degrees=True))),
    "fanuc": ("X [mm],Y [mm],Z [mm],W [deg],P [deg],R [deg]", lambda F: (F[:, :3, 3], rotations(F).as_euler("xyz", degrees=True))),
    "ur": ("robot_x,robot_y,robot_z,robot_rx,robot_ry,robot_rz", lambda F: (F[:, :3, 3] / 1e3, rotations(F).as_rotvec())),
    "yaskawa": (
        "tcp_x_mm,tcp_y_mm,tcp_z_mm,tcp_rx_deg,tcp_ry_deg,tcp_rz_deg",
        lambda F: (F[:, :3, 3], rotations(F).as_euler("xyz", degrees=True)),
    ),
    "staubli": (
        "flange_x,flange_y,flange_z,flange_rx,flange_ry,flange_rz",
        lambda F: (F[:, :3, 3], rotations(F).as_euler("XYZ", degrees=True)),
    ),
    "abb": ("x,y,z,q1,q2,q3,q4", lambda F: (F[:, :3, 3], np.roll(rotations(F).as_quat(), 1, axis=1))),
    "ros": (
        "pose.position.x,pose.position.y,pose.position.z,pose.orientation.x,pose.orientation.y,pose.orientation.z,pose.orientation.w",
        lambda F: (F[:, :3, 3] / 1e3, rotations(F).as_quat()),
    ),
    "kawasaki": ("X,Y,Z,O,A,T", lambda F: (F[:, :3, 3], rotations(F).as_euler("ZYZ", degrees=True))),
    "matrix": (",".join(f"T_base_flange_{i}{j}" for i in range(4) for j in range(4)), lambda F: (F.reshape(-1, 16),)),
}


@pytest.mark.parametrize("maker", WRITTEN)
def test_the_flange_is_read_as_each_maker_writes_it(maker, tmp_path):
    F, C = poses()
    header, columns = WRITTEN[maker]
    path = write(tmp_path / "a.csv", f"{header},sphere_x_mm,sphere_y_mm,sphere_z_mm", *columns(F), C[:, :3, 3])
    obs = read_loose_table(path).observations
    np.testing.assert_allclose(obs.cell.robot.chain.flange(obs.q), F, atol=2e-4)
    found = mbcacq.calibrate(path, ALONE)
    np.testing.assert_allclose(found.state.T_flange_scanner, X, atol=5e-3)


@pytest.mark.parametrize("maker", orientations.MAKERS)
def test_numbers_and_matrices_agree_in_every_convention(maker):
    word = orientations.MAKERS[maker]
    R = poses()[0][:, :3, :3]
    if word in orientations.QUATERNIONS:
        numbers = rotations(poses()[0]).as_quat()
        numbers = numbers if word == "xyzw" else np.roll(numbers, 1, axis=1)
    else:
        numbers = orientations.to_numbers(R, word)
    np.testing.assert_allclose(orientations.to_matrices(numbers, word), R, atol=1e-12)


def test_a_quaternion_is_no_three_angles():
    with pytest.raises(ValueError, match="4 numbers are no angles about x, y, z, axes fixed .*fanuc"):
        orientations.to_matrices(np.array([[1.0, 0, 0, 0]]), orientations.MAKERS["fanuc"])


def test_fanuc_turns_about_fixed_axes_and_kuka_about_its_own():
    """W P R = 90 90 0 turns z to x by way of -y; A B C = 90 90 0 turns x down, then z to y."""
    turn = np.radians([[90.0, 90.0, 0.0]])
    np.testing.assert_allclose(
        orientations.to_matrices(turn, orientations.MAKERS["fanuc"])[0], [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-12
    )
    np.testing.assert_allclose(
        orientations.to_matrices(turn, orientations.MAKERS["kuka"])[0], [[0, -1, 0], [0, 0, 1], [-1, 0, 0]], atol=1e-12
    )


def test_what_headings_leave_open_is_decided_by_the_data_and_said(tmp_path):
    F, C = poses()
    header, columns = WRITTEN["staubli"]
    path = write(tmp_path / "a.csv", f"{header},target_x,target_y,target_z,target_rx,target_ry,target_rz", *columns(F), C[:, :3, 3],
                 rotations(C).as_rotvec())  # fmt: skip
    said = " / ".join(read_loose_table(path).sentences)
    for words in ("axes turning along (staubli)", "in rad as rotation vector", "eye in hand"):
        assert words in said


def test_what_the_data_cannot_decide_is_asked(tmp_path):
    """Turned about one axis alone, Euler angles of different orders are the same numbers."""
    F, _ = poses()
    F[:, :3, :3] = Rotation.from_euler("z", np.linspace(-60, 60, len(F))[:, None], degrees=True).as_matrix()
    C = se3.inverse(F @ X) @ Z
    header, columns = WRITTEN["staubli"]
    path = write(tmp_path / "a.csv", f"{header},ball_x_mm,ball_y_mm,ball_z_mm", *columns(F), C[:, :3, 3])
    with pytest.raises(ConfigError, match="say which it is: --flange"):
        read_loose_table(path, TableOptions(measurement="artefact_in_scanner"))


def test_lengths_that_may_be_metres_or_millimetres_are_asked_about(tmp_path):
    F, C = poses()
    F[:, :3, 3] *= 0.03
    path = write(
        tmp_path / "a.csv",
        "x,y,z,a,b,c,ball_x_mm,ball_y_mm,ball_z_mm",
        F[:, :3, 3],
        rotations(F).as_euler("ZYX", degrees=True),
        C[:, :3, 3],
    )
    with pytest.raises(ConfigError, match=r"a\.csv:1: column x: .* metres or millimetres"):
        read_loose_table(path)


def test_an_observation_set_takes_the_columns_of_a_controller(tmp_path):
    F, C = poses()
    folder = tmp_path / "set"
    folder.mkdir()
    write(folder / "poses.csv", "Nr,X,Y,Z,Rx,Ry,Rz,Cam X,Cam Y,Cam Z", np.arange(1, len(F) + 1), *WRITTEN["staubli"][1](F), C[:, :3, 3])
    cell = (
        "format: mbcacq-observation-set/1\nartefacts: [{id: a, balls: [{id: 1, centre_mm: [0, 0, 0]}]}]\nstations: [{id: 1, artefact: a}]\n"
    )
    (folder / "cell.yaml").write_text(cell)
    with pytest.raises(ConfigError, match=r"may be a rotation vector.*flange_poses: \{orientation: ur\}"):
        mbcacq.load_observations(folder)
    (folder / "cell.yaml").write_text(cell + "flange_poses: {orientation: staubli}\ncolumns: {pose: Nr}\n")
    obs = mbcacq.load_observations(folder)
    np.testing.assert_allclose(obs.cell.robot.chain.flange(obs.q), F, atol=2e-4)
    np.testing.assert_allclose(obs.xyz, C[:, :3, 3], atol=1e-6)


def test_data_new_writes_a_set_and_says_how_it_understood_the_table(tmp_path):
    F, C = poses()
    path = write(tmp_path / "a.csv", "X,Y,Z,A,B,C,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,x3_mm,y3_mm,z3_mm", *WRITTEN["kuka"][1](F),
                 *(se3.apply(C, np.array(b)) for b in ([0.0, 0, 0], [60.0, 0, 0], [0.0, 50, 10])))  # fmt: skip
    done = CliRunner().invoke(command, ["new", str(path), "--out", str(tmp_path / "set"), "--json"])
    content = json.loads(done.stdout)
    assert content["poses"] == len(F)
    assert content["measurement"] == "artefact_in_scanner"
    assert any("without certificate" in sentence for sentence in content["understood"])
    found = mbcacq.calibrate(tmp_path / "set", ALONE)
    np.testing.assert_allclose(found.state.T_flange_scanner, X, atol=5e-3)
    assert "a.csv" not in CliRunner().invoke(command, ["new", str(path), "--out", str(tmp_path / "set")]).stdout  # not replaced
    assert CliRunner().invoke(command, ["new", str(path), "--out", str(tmp_path / "set"), "--force"]).exit_code == 0


def test_a_column_phase_keeps_poses_out_of_the_fit(tmp_path):
    """Ten rows that are 0.5 mm off do not move the hand-eye transform."""
    F, C = poses(30)
    C[-10:, 2, 3] += 0.5
    path = write(tmp_path / "a.csv", "X,Y,Z,A,B,C,ball_x_mm,ball_y_mm,ball_z_mm", *WRITTEN["kuka"][1](F), C[:, :3, 3])
    phases = ["phase", *["calibration"] * 20, *["verification"] * 10]
    path.write_text("".join(f"{line},{phase}\n" for line, phase in zip(path.read_text().splitlines(), phases, strict=True)))
    read = read_loose_table(path)
    assert any("10 verification" in sentence for sentence in read.sentences)
    np.testing.assert_allclose(mbcacq.calibrate(read.observations, ALONE).state.T_flange_scanner[:3, 3], X[:3, 3], atol=5e-3)


def test_samples_of_moveit_and_easy_handeye(tmp_path):
    F, C = poses()
    metres = np.array([1e-3, 1e-3, 1e-3, 1.0])

    def flat(T):
        return (T * np.array([1, 1, 1, 1.0]) * np.where(np.arange(4) == 3, metres[:, None], 1.0)).reshape(-1).tolist()

    (tmp_path / "moveit.yaml").write_text(
        json.dumps([{"effector_wrt_world": flat(f), "object_wrt_sensor": flat(c)} for f, c in zip(F, C, strict=True)])
    )

    def transform(T):
        q = Rotation.from_matrix(T[:3, :3]).as_quat()
        return {
            "translation": dict(zip("xyz", (T[:3, 3] / 1e3).tolist(), strict=True)),
            "rotation": dict(zip("xyzw", q.tolist(), strict=True)),
        }

    (tmp_path / "easy.samples").write_text("")
    (tmp_path / "easy.yaml").write_text(
        json.dumps({"samples": [{"robot": transform(f), "tracking": transform(c)} for f, c in zip(F, C, strict=True)]})
    )
    for name in ("moveit", "easy"):
        obs = read_hand_eye_files([tmp_path / f"{name}.yaml"], TableOptions(measurement="artefact_in_scanner")).observations
        np.testing.assert_allclose(mbcacq.calibrate(obs, ALONE).state.T_flange_scanner, X, atol=5e-3)
    with pytest.raises(ConfigError, match="say --eye-in-hand or --eye-to-hand"):
        read_hand_eye_files([tmp_path / "easy.yaml"], TableOptions())


def test_two_files_with_times_and_a_folder_of_matrices(tmp_path):
    F, C = poses()
    time = 0.5 * np.arange(len(F))
    head = "t, x, y, z, q_x, q_y, q_z, q_w"
    hand = write(tmp_path / "poses_B_H.csv", head, time, F[:, :3, 3] / 1e3, rotations(F).as_quat())
    keep = np.arange(len(F)) % 4 > 0
    inverse = se3.inverse(C[keep])  # the eye as the world sees it
    eye = write(tmp_path / "poses_W_E.csv", head, time[keep] + 0.003, inverse[:, :3, 3] / 1e3, rotations(inverse).as_quat())
    obs = read_hand_eye_files([hand, eye], TableOptions(measurement="artefact_in_scanner")).observations
    assert obs.n_poses == keep.sum()
    np.testing.assert_allclose(mbcacq.calibrate(obs, ALONE).state.T_flange_scanner, X, atol=5e-3)
    folder = tmp_path / "matrices"
    folder.mkdir()
    for k, (f, c) in enumerate(zip(F, C, strict=True)):
        data = ", ".join(f"{v:.9g}" for v in f.ravel())
        (folder / f"pos{k:02d}.yaml").write_text(
            f"%YAML:1.0\n---\nPoseState: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data: [ {data} ]\n"
        )
        np.savetxt(folder / f"target{k:02d}.txt", c)
    obs = read_hand_eye_files([folder], TableOptions()).observations
    np.testing.assert_allclose(mbcacq.calibrate(obs, ALONE).state.T_flange_scanner, X, atol=5e-3)


def vectors(T):
    return T[:, :3, 3] / 1e3, rotations(T).as_rotvec()


@pytest.mark.parametrize("camera", ["tvec_{},rvec_{}", "board_tvec_{},board_rvec_{}", "tvec[{}],rvec[{}]", "cam_t{},cam_rvec_{}"])
def test_vectors_of_opencv_are_of_the_camera_beside_a_flange_of_plain_names(camera, tmp_path):
    F, C = poses()
    place, turn = camera.split(",")
    numbered = "012" if "[" in camera else "xyz"
    header = ",".join(["x,y,z,rx,ry,rz", *(place.format(c) for c in numbered), *(turn.format(c) for c in numbered), "note"])
    understood = read_loose_table(write(tmp_path / "a.csv", header, *vectors(F), *vectors(C), np.arange(len(F))))
    obs = understood.observations
    np.testing.assert_allclose(obs.cell.robot.chain.flange(obs.q), F, atol=2e-4)
    np.testing.assert_allclose(obs.rotation, C[:, :3, :3], atol=1e-6)
    assert "not used: note (of no use here)" in understood.sentences


def test_an_orientation_without_an_owner_is_asked_about(tmp_path):
    F, C = poses()
    header = "qx,qy,qz,qw,flange_x,flange_y,flange_z,target_x,target_y,target_z"
    with pytest.raises(ConfigError, match="are an orientation, and nothing says whose; name them flange_"):
        read_loose_table(write(tmp_path / "a.csv", header, rotations(F).as_quat(), F[:, :3, 3], C[:, :3, 3]))


MATRIX = ",".join(f"{thing}_T_{i}{j}" for thing in ("robot", "target") for i in range(4) for j in range(4))


@pytest.mark.parametrize("robot_by_rows", [True, False])
@pytest.mark.parametrize("target_by_rows", [True, False])
def test_matrices_are_read_by_rows_or_columns_as_their_last_row_says(robot_by_rows, target_by_rows, tmp_path):
    F, C = poses()
    written = [T if by_rows else np.swapaxes(T, 1, 2) for T, by_rows in ((F, robot_by_rows), (C, target_by_rows))]
    obs = read_loose_table(write(tmp_path / "a.csv", MATRIX, *(T.reshape(-1, 16) for T in written))).observations
    np.testing.assert_allclose(obs.cell.robot.chain.flange(obs.q), F, atol=2e-4)
    np.testing.assert_allclose(obs.xyz, C[:, :3, 3], atol=1e-6)


def test_a_matrix_whose_last_row_is_none_is_refused_in_its_line(tmp_path):
    F, C = poses()
    F[4, 3] = (0.0, 0.5, 0.0, 1.0)
    with pytest.raises(ConfigError, match="a.csv:6: column robot_T_30: the last row of the matrix is not 0 0 0 1"):
        read_loose_table(write(tmp_path / "a.csv", MATRIX, F.reshape(-1, 16), C.reshape(-1, 16)))


BOTH = "robot_x_mm,robot_y_mm,robot_z_mm,robot_qx,robot_qy,robot_qz,robot_qw,target_x_mm,target_y_mm,target_z_mm,target_qx,target_qy,target_qz,target_qw"


def test_rows_that_do_not_belong_together_are_said_to_be_so(tmp_path):
    """A shift is named; an order at random fits nothing, whatever is said beside it."""
    F, C = poses()
    columns = [(T[:, :3, 3], rotations(T).as_quat()) for T in (F, C)]
    shifted = write(tmp_path / "a.csv", BOTH, *columns[0], *(np.roll(part, 3, axis=0) for part in columns[1]))
    with pytest.raises(ConfigError, match="each measurement belonging to the pose 3 rows back the residual falls from"):
        read_loose_table(shifted)
    order = np.random.default_rng(5).permutation(len(F))
    mixed = write(tmp_path / "b.csv", BOTH, *columns[0], *(part[order] for part in columns[1]))
    for options in (None, TableOptions(measurement="artefact_in_scanner")):
        with pytest.raises(ConfigError, match=r"no reading fits better than .* mm \(rows paired at random"):
            read_loose_table(mixed, options)


def test_measurements_that_never_change_are_no_measurements(tmp_path):
    F, C = poses()
    C[:] = C[0]
    with pytest.raises(ConfigError, match="all 20 measurements are the same to the last digit"):
        read_loose_table(write(tmp_path / "a.csv", BOTH, F[:, :3, 3], rotations(F).as_quat(), C[:, :3, 3], rotations(C).as_quat()))


@pytest.mark.parametrize(
    ("stretched", "words"),
    [
        ((1.01, 1.01, 1.01), "the measured places times {}: the pitch or size of the target, or a unit is wrong by that"),
        ((1.0, 1.0, 1.01), "the measured places along z of the scanner times {}: the focal length or the depth scale of the camera"),
        ((1.0, 1.0, 1.0), ""),
    ],
    ids=["pitch", "focal length", "right"],
)
def test_a_length_that_the_poses_of_the_flange_contradict_is_said_with_what_it_would_be(stretched, words, tmp_path):
    """1 / 1.01 = 0.9901; noise of 0.1 mm and 0.3 mrad, so that the factor is known to 0.001."""
    F, C = poses(24)
    rng = np.random.default_rng(3)
    C[:, :3, 3] = (C[:, :3, 3] + rng.normal(0, 0.1, (24, 3))) * stretched
    C[:, :3, :3] = C[:, :3, :3] @ se3.rotation_exp(rng.normal(0, 3e-4, (24, 3)))
    path = write(tmp_path / "a.csv", BOTH, F[:, :3, 3], rotations(F).as_quat(), C[:, :3, 3], rotations(C).as_quat())
    said = " ".join(map(str, mbcacq.calibrate(path, ALONE).to_dict().get("warnings", ())))
    if not words:
        assert "A length contradicts" not in said
        return
    before, after = words.split("{}")
    assert f"A length contradicts the poses of the flange: with {before}" in said
    assert after in said
    factor = float(said.split(" times ")[1].split(" ± ")[0])
    assert factor == pytest.approx(1 / 1.01, abs=2e-3)


def test_a_pitch_is_doubted_where_all_views_are_from_one_distance(tmp_path):
    """Then a scale is nearly a shift of the camera and of the target: only 5 mm of distance and 10 mm sideways tell them apart."""
    rng = np.random.default_rng(11)
    X, Z = se3.exp(np.r_[30.0, -10, 120, 0.2, -0.3, 0.1]), se3.exp(np.r_[650.0, 0, 100, 3.0, 0.1, 0.2])
    turn = se3.rotation_exp(np.c_[rng.uniform(-0.4, 0.4, (24, 2)), rng.uniform(-0.7, 0.7, 24)])
    middle = np.c_[rng.uniform(-10, 10, (24, 2)), rng.uniform(295, 305, 24)]
    C = se3.transform(turn, middle - turn @ np.array([80.0, 60, 0]))
    F = Z @ se3.inverse(C) @ se3.inverse(X)
    F[:, :3, 3] += rng.normal(0, 0.02, (24, 3))
    C[:, :3, 3] = 1.015 * (C[:, :3, 3] + rng.normal(0, 0.02, (24, 3)))
    path = write(tmp_path / "a.csv", BOTH, F[:, :3, 3], rotations(F).as_quat(), C[:, :3, 3], rotations(C).as_quat())
    found = mbcacq.calibrate(path, ALONE).to_dict()
    said = " ".join(map(str, found["warnings"]))
    assert float(said.split(" times ")[1].split(" ± ")[0]) == pytest.approx(1 / 1.015, abs=5e-3)
    assert "the pitch or size of the target" in said
    assert found["scale_from"].startswith("stated lengths of the target; by the poses of the flange they are 0.98")


def test_degrees_under_a_heading_of_radians_are_refused(tmp_path):
    F, C = poses(12)
    headings = ",".join(["x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad", *BOTH.split(",")[7:]])
    degrees = np.rad2deg(rotations(F).as_rotvec())
    path = write(tmp_path / "a.csv", headings, F[:, :3, 3], degrees, C[:, :3, 3], rotations(C).as_quat())
    with pytest.raises(ConfigError, match=r"rx_rad, ry_rad, rz_rad are said to be radians, and reach \d+; if they are degrees"):
        read_loose_table(path)


UR10E_ROWS = (
    (180.7, 0, 90),
    (0, -612.7, 0),
    (0, -571.55, 0),
    (174.15, 0, 90),
    (119.85, 0, -90),
    (116.55, 0, 0),
)  # d, a, alpha as published


def tool_by_the_controller(q, tool):
    """(P, 3) mm: a point of the tool in the base of a UR10e, by its published parameters."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for angle, (d, a, alpha) in zip(q.T, UR10E_ROWS, strict=True):
        turn = Rotation.from_euler("z", angle[:, None]).as_matrix() @ Rotation.from_euler("x", alpha, degrees=True).as_matrix()
        along = np.stack([a * np.cos(angle), a * np.sin(angle), np.full(len(q), d)], axis=1)
        T = T @ se3.transform(turn, along)
    return se3.apply(T, np.tile(tool, (len(q), 1)))


@pytest.mark.parametrize(("angle_decimals", "point_decimals"), [(4, 2), (2, 1), (7, 7)])
def test_points_that_the_arm_computed_itself_are_asked_about(tmp_path, angle_decimals, point_decimals):
    rng = np.random.default_rng(4)
    q = rng.uniform(-1, 1, (40, 6)) * [2, 1, 1.5, 2, 2, 3] + [0, -1.2, 1.2, 0, 0.8, 0]
    computed = np.round(tool_by_the_controller(q, [5.0, -8.0, 120.0]), point_decimals)
    header, angles = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm", np.round(np.degrees(q), angle_decimals)
    table, options = write(tmp_path / "own.csv", header, angles, computed), TableOptions(robot=robot_of("ur10e"))
    with pytest.raises(ConfigError, match="the points are where Universal Robots UR10e itself computes them from the joint angles"):
        read_loose_table(table, options)
    assert read_loose_table(table, replace(options, by_instrument=True)).observations.n_poses == 40
    measured = write(tmp_path / "measured.csv", header, angles, computed + rng.normal(0, 0.3, computed.shape))
    assert read_loose_table(measured, options).observations.n_poses == 40


def test_a_table_without_a_header_is_refused_as_that(tmp_path):
    (tmp_path / "numbers.csv").write_text("10.0,-20.0,30.0,1,2,3\n11.0,-21.0,31.0,2,3,4\n")
    with pytest.raises(ConfigError, match=r"numbers.csv:1: the first line holds numbers, so there is no header"):
        read_loose_table(tmp_path / "numbers.csv")


def test_orientations_that_are_exact_do_not_make_places_more_certain_than_they_are(tmp_path):
    """A simulation's orientations have no noise; those of places is 0.05 mm. Chi square of 36 degrees of freedom is below 68, at 1e-3."""
    chi2 = 0.0
    for seed in range(12):
        F, C = poses(16, seed)
        C[:, :3, 3] += np.random.default_rng(seed + 99).normal(0, 0.05, (16, 3))
        path = write(tmp_path / "a.csv", BOTH, F[:, :3, 3], rotations(F).as_quat(), C[:, :3, 3], rotations(C).as_quat())
        found = mbcacq.calibrate(path, ALONE)
        off = (se3.inverse(found.state.T_flange_scanner) @ X)[:3, 3]
        at = [found.names.index(f"hand_eye.{c}") for c in "xyz"]
        chi2 += off @ np.linalg.solve(found.covariance[np.ix_(at, at)], off)
    assert chi2 < 68
