"""Headers as libraries and programs write them: each is read as it is meant, or what it leaves open is asked."""

import numpy as np
import pytest
from test_hand_eye_tables import poses, rotations, write

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.recording.datasets.loose_table import TableOptions, read_loose_table

F, C = poses()
VIEWED = se3.inverse(C)  # the camera in the target


def millimetres(T):
    return T[:, :3, 3]


def metres(T):
    return T[:, :3, 3] / 1e3


def vector(T):
    return rotations(T).as_rotvec()


def xyzw(T):
    return rotations(T).as_quat()


def wxyz(T):
    return np.roll(rotations(T).as_quat(), 1, axis=1)


def matrix(T):
    return T[:, :3, :3].reshape(-1, 9)


def whole(T):
    return T.reshape(-1, 16)


def euler(axes):
    return lambda T: rotations(T).as_euler(axes, degrees=True)


def each(pattern, *components):
    return ",".join(pattern.format(c) for c in components)


NINE, SIXTEEN = ([f"{i}{j}" for i in range(n) for j in range(n)] for n in (3, 4))
QUATERNION = ("x", "y", "z", "w")
SEVEN = ("x", "y", "z", "qx", "qy", "qz", "qw")


def of_ros(thing):
    return f"{each(thing + '.position.{}', *'xyz')},{each(thing + '.orientation.{}', *QUATERNION)}"


BOARD = (each("target_{}", *SEVEN), metres, xyzw)
HEADERS = {  # header and columns of the flange, and of the target
    "OpenCV vectors": ("x,y,z,rx,ry,rz", metres, vector, f"{each('tvec_{}', *'xyz')},{each('rvec_{}', *'xyz')}", metres, vector),
    "OpenCV vectors by number": (each("tcp_{}", *"xyz", "rx", "ry", "rz"), metres, vector, "tvec0,tvec1,tvec2,rvec0,rvec1,rvec2", metres, vector),
    "OpenCV calibrateHandEye": (
        f"{each('R_gripper2base_{}', *NINE)},{each('t_gripper2base_{}', *'012')}", matrix, millimetres,
        f"{each('R_target2cam_{}', *NINE)},{each('t_target2cam_{}', *'012')}", matrix, millimetres,
    ),
    "board of OpenCV": ("x,y,z,rx,ry,rz", metres, vector, f"{each('board_tvec_{}', *'xyz')},{each('board_rvec_{}', *'xyz')}", metres, vector),
    "ROS tf": (
        f"{each('robot.translation.{}', *'xyz')},{each('robot.rotation.{}', *QUATERNION)}", metres, xyzw,
        f"{each('optical.translation.{}', *'xyz')},{each('optical.rotation.{}', *QUATERNION)}", metres, xyzw,
    ),
    "ROS poses": (of_ros("pose"), metres, xyzw, of_ros("marker.pose"), metres, xyzw),
    "ROS text log": (of_ros("field.pose"), metres, xyzw, *BOARD),
    "MoveIt": (each("effector_wrt_world_{}", "tx", "ty", "tz", *SEVEN[3:]), metres, xyzw, each("object_wrt_sensor_{}", "tx", "ty", "tz", *SEVEN[3:]), metres, xyzw),
    "easy_handeye": (each("robot_{}", *("tx", "ty", "tz", "rx", "ry", "rz", "rw")), metres, xyzw, each("optical_{}", *("tx", "ty", "tz", "rx", "ry", "rz", "rw")), metres, xyzw),
    "easy_handeye2": (each("hand_{}", *SEVEN), metres, xyzw, each("tracking_{}", *SEVEN), metres, xyzw),
    "Zivid angles": (each("robot_{}", *"xyz", "roll", "pitch", "yaw"), millimetres, euler("xyz"), each("board_{}", *"xyz", "roll", "pitch", "yaw"), millimetres, euler("xyz")),
    "Zivid matrices": (each("pos_{}", *SIXTEEN), whole, each("board_{}", *SIXTEEN), whole),
    "RoboDK": (each("{} (mm)", *"XYZ") + "," + each("R{} (deg)", *"xyz"), millimetres, euler("XYZ"), each("target {} (mm)", *"XYZ") + "," + each("target R{} (deg)", *"xyz"), millimetres, euler("XYZ")),
    "RoboDK with u, v, w": ("pose_u,pose_v,pose_w,x,y,z", vector, millimetres, "marker_x,marker_y,marker_z,marker_u,marker_v,marker_w", millimetres, vector),
    "Kalibr": (f"{each('p_WH_{}', *'xyz')},{each('q_WH_{}', *QUATERNION)}", metres, xyzw, f"{each('p_CT_{}', *'xyz')},{each('q_CT_{}', *QUATERNION)}", metres, xyzw),
    "EuRoC": (f"{each('p_RS_R_{} [m]', *'xyz')},{each('q_RS_{} []', 'w', *'xyz')}", metres, wxyz, *BOARD),
    "TUM": (each("{}", "tx", "ty", "tz", *SEVEN[3:]), metres, xyzw, each("cam_{}", "tx", "ty", "tz", *SEVEN[3:]), metres, xyzw),
    "from frame to frame": (each("base_T_flange_{}", *SEVEN), metres, xyzw, each("cam_T_board_{}", *SEVEN), metres, xyzw),
    "camera in the target": (each("flange_{}", *SEVEN), metres, xyzw, each("target_T_cam_{}", *SEVEN), lambda _: metres(VIEWED), lambda _: xyzw(VIEWED)),
    "words behind": (each("{}", *SEVEN), metres, xyzw, each("{}_cam", *SEVEN), metres, xyzw),
    "KUKA and OpenCV": ("X,Y,Z,A,B,C", millimetres, euler("ZYX"), f"{each('tvec_{}', *'xyz')},{each('rvec_{}', *'xyz')}", millimetres, vector),
    "FANUC and a board": ("X,Y,Z,W,P,R", millimetres, euler("xyz"), each("board_{}", *"xyz", "rx", "ry", "rz"), millimetres, vector),
    "ABB": ("x,y,z,q1,q2,q3,q4", millimetres, wxyz, each("tag_{}", *"xyz", "q1", "q2", "q3", "q4"), millimetres, wxyz),
    "numbered quaternions": (f"{each('flange_{}', *'xyz')},{each('flange_quat_{}', *'0123')}", metres, xyzw, *BOARD),
    "three of a rotation": (f"{each('robot_pos_{}', *'xyz')},{each('robot_rot_{}', *'xyz')}", metres, vector, f"{each('aruco_trans_{}', *'xyz')},{each('aruco_rot_{}', *'xyz')}", metres, vector),
}  # fmt: skip


@pytest.mark.parametrize("maker", HEADERS)
def test_a_header_is_read_as_its_program_means_it(maker, tmp_path):
    parts = HEADERS[maker]
    second = next(i for i, part in enumerate(parts) if i and isinstance(part, str))
    columns = [column(F) for column in parts[1:second]] + [column(C) for column in parts[second + 1 :]]
    said = read_loose_table(write(tmp_path / "a.csv", f"{parts[0]},{parts[second]},note", *columns, np.arange(len(F))))
    obs = said.observations
    assert obs.cell.measurement == "artefact_in_scanner"
    np.testing.assert_allclose(obs.cell.robot.chain.flange(obs.q), F, atol=2e-4)
    np.testing.assert_allclose(obs.xyz, C[:, :3, 3], atol=2e-3)
    np.testing.assert_allclose(obs.rotation, C[:, :3, :3], atol=2e-6)
    assert said.sentences[-1] == "not used: note (of no use here)"


@pytest.mark.parametrize(
    ("flange", "target", "asked"),
    [
        ("base2gripper", "target2cam", "'base2gripper' is the flange's pose to some, and its inverse to OpenCV; .*: --flange-direct or --flange-inv"),
        ("base_to_ee", "cam_T_board", "'base_to_ee' is the flange's pose to some"),
        ("gripper2base", "cam2target", "'cam2target' is the target's pose to some, and its inverse to OpenCV; .*: --target-direct or --target-inv"),
    ],
)  # fmt: skip
def test_a_direction_that_a_name_leaves_open_is_asked(flange, target, asked, tmp_path):
    header = f"{each(flange + '_{}', *SEVEN)},{each(target + '_{}', *SEVEN)}"
    path = write(tmp_path / "a.csv", header, metres(F), xyzw(F), metres(C), xyzw(C))
    with pytest.raises(ConfigError, match=f"a.csv:1: {asked}"):
        read_loose_table(path)
    obs = read_loose_table(path, TableOptions(flange_inverted=False, target_inverted=False)).observations
    np.testing.assert_allclose(obs.cell.robot.chain.flange(obs.q), F, atol=2e-4)
    from_base = write(tmp_path / "b.csv", header, metres(se3.inverse(F)), xyzw(se3.inverse(F)), metres(C), xyzw(C))
    obs = read_loose_table(from_base, TableOptions(flange_inverted=True, target_inverted=False)).observations
    np.testing.assert_allclose(obs.cell.robot.chain.flange(obs.q), F, atol=2e-4)
    np.testing.assert_allclose(obs.xyz, C[:, :3, 3], atol=2e-3)


def test_a_header_whose_numbers_tell_two_poses_apart_is_refused(tmp_path):
    header = f"{each('{}1', *SEVEN)},{each('{}2', *SEVEN)}"
    with pytest.raises(ConfigError, match="no columns give the pose of the flange"):
        read_loose_table(write(tmp_path / "a.csv", header, metres(F), xyzw(F), metres(C), xyzw(C)))
