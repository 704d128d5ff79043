"""Every export, read by somebody else: MuJoCo's URDF parser, quaternion and rotation products written out here, a hand-made MD-H chain."""

import re
import shlex

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from test_urdf import CHAIN, URDF

from mbcacq.cli.export import command

Q = np.random.default_rng(5).uniform(-2, 2, (10, 6))


@pytest.fixture(scope="module")
def out(solved, tmp_path_factory):
    import json

    folder = tmp_path_factory.mktemp("handover")
    (folder / "result.json").write_text(json.dumps(solved[0]))
    plain = URDF.replace("${pi/2}", "1.5707963267948966").replace("${-pi/2}", "-1.5707963267948966")
    (folder / "arm.urdf").write_text(plain)
    arguments = [str(folder / "result.json"), "--results", str(folder / "out"), "--urdf", str(folder / "arm.urdf"), "--tool", "4"]
    outcome = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert outcome.exit_code == 0
    return folder / "out"


def turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def rotated(q, v):
    """q v q* with q = (x, y, z, w), by Hamilton's product."""
    x, y, z, w = q
    u = np.array([x, y, z])
    return v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))


def by_hand(rows, sign, q):
    """Flange (4, 4) of H_i = Rz Tz Tx Rx Ry, product by product; mm, rad."""
    T = np.eye(4)
    for i, angle in enumerate(q):
        for R, t in (
            (turn(2, sign[i] * angle + rows["theta"][i]), (0, 0, rows["d"][i])),
            (np.eye(3), (rows["a"][i], 0, 0)),
            (turn(0, rows["alpha"][i]), (0, 0, 0)),
            (turn(1, rows["beta"][i]), (0, 0, 0)),
        ):
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = R, R @ np.array(t, float)
            T = T @ step
    return T


def test_the_result_file_is_the_true_arm_by_hand(solved):
    """With nothing but result.json a point is placed where the true cell has it, to a few hundredths of a millimetre."""
    result, _, truth, T_hand = solved
    T = by_hand(result["robot"]["calibrated"], result["robot"]["sign"], [0.2, -1.0, 1.5, 0.1, 0.6, 0.3]) @ np.array(
        result["T_flange_scanner"]
    )
    true = truth.flange(np.array([[0.2, -1.0, 1.5, 0.1, 0.6, 0.3]]))[0] @ T_hand
    np.testing.assert_allclose(T[:3, 3], true[:3, 3], atol=0.1)
    np.testing.assert_allclose(T[:3, :3], true[:3, :3], atol=3e-4)


def test_another_urdf_parser_reads_the_calibrated_arm_and_the_scanner(solved, out):
    mujoco = pytest.importorskip("mujoco", reason="an independent URDF parser is in the dev extra")
    result = solved[0]
    # MuJoCo wants masses, and keeps fixed links apart only with fusestatic="false".
    more = '<mujoco><compiler boundmass="0.01" boundinertia="0.0001" fusestatic="false" balanceinertia="true"/></mujoco></robot>'
    model = mujoco.MjModel.from_xml_string((out / "arm.urdf").read_text().replace("</robot>", more))
    data = mujoco.MjData(model)
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = turn(2, 0.3), [1, 2, 0.5]
    for q in Q:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        parsed = np.eye(4)
        parsed[:3, :3], parsed[:3, 3] = data.body("scanner_frame").xmat.reshape(3, 3), data.body("scanner_frame").xpos
        parsed = np.linalg.inv(world) @ parsed
        T = by_hand(result["robot"]["calibrated"], result["robot"]["sign"], q) @ np.array(result["T_flange_scanner"])
        np.testing.assert_allclose(1e3 * parsed[:3, 3], T[:3, 3], atol=1e-3)
        np.testing.assert_allclose(parsed[:3, :3], T[:3, :3], atol=1e-7)
    assert np.abs(by_hand(result["robot"]["nominal"], result["robot"]["sign"], Q[0]) - CHAIN.flange(Q[:1])[0]).max() < 1e-9


def test_ros_files_turn_and_shift_a_point_as_the_hand_eye_does(solved, out):
    T = np.array(solved[0]["T_flange_scanner"])
    point = np.array([12.0, -34, 56])
    there = T[:3, :3] @ point + T[:3, 3]
    data = yaml.safe_load((out / "mbcacq.calib").read_text())["transform"]
    words = shlex.split((out / "static_transform.sh").read_text().splitlines()[-1])
    launched = re.findall(r"'(--?[\w-]+|-?[\d.e+-]+|\w+)'", (out / "scanner.launch.py").read_text().split("arguments=[")[1])
    for x, y, z, *q in (
        [*(data["translation"][k] for k in "xyz"), *(data["rotation"][k] for k in "xyzw")],
        [float(words[words.index(f"--{k}") + 1]) for k in ("x", "y", "z", "qx", "qy", "qz", "qw")],
        [float(launched[launched.index(f"--{k}") + 1]) for k in ("x", "y", "z", "qx", "qy", "qz", "qw")],
    ):
        assert np.linalg.norm(q) == pytest.approx(1, abs=1e-9)
        np.testing.assert_allclose(rotated(q, point) + 1e3 * np.array([x, y, z]), there, atol=1e-6)


def test_tool_data_is_the_hand_eye_by_its_own_rotation_product(solved, out):
    line = (out / "tool_data.txt").read_bytes().decode("latin-1").split("\r\n")[0]
    assert line.startswith("TOOL_DATA[4]={X ")
    x, y, z, a, b, c = (float(v) for v in re.findall(r"[XYZABC] (-?[\d.]+)", line))
    T = np.array(solved[0]["T_flange_scanner"])
    np.testing.assert_allclose([x, y, z], T[:3, 3], atol=1e-5)
    np.testing.assert_allclose(turn(2, np.radians(a)) @ turn(1, np.radians(b)) @ turn(0, np.radians(c)), T[:3, :3], atol=2e-8)


def test_the_csv_files_hold_the_covariance_of_the_parameters(solved, out):
    """Plain text, split by hand: standard deviations of parameters.csv are the roots of the diagonal of covariance.csv."""
    head, *rows = (line.split(",") for line in (out / "covariance.csv").read_text().split("\n") if line)
    variance = {row[0]: float(row[1 + i]) for i, row in enumerate(rows)}
    head, *rows = (line.split(",") for line in (out / "parameters.csv").read_text().replace("\r", "").split("\n") if line)
    std = {row[head.index("name")]: row[head.index("std")] for row in rows}
    free = [name for name in variance if not name.startswith("hand_eye.")]  # those are given along other axes in parameters.csv
    assert len(free) > 15
    for name in free:
        assert float(std[name]) == pytest.approx(np.sqrt(variance[name]), rel=1e-9)
