"""Tables as instruments and controllers write them: headings behind lines of other text, columns apart by blanks, joints from 0."""

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.files.table import read_table
from mbcacq.recording.datasets.bag import in_order_of_axes
from mbcacq.recording.datasets.columns import flange_group, joint_angles, joint_columns, names_poses, target_columns, unit_above

LOGS = {
    "RTDE": ("timestamp actual_q_0 actual_q_1 actual_q_2 actual_q_3 actual_q_4 actual_q_5\n1.0 0.1 0.2 0.3 0.4 0.5 0.6\n", None, 6),
    "points": ("// an export of points\n// Units: mm\nCollection  Group  Point  X  Y  Z\nA  G1  p1  1000.5 200.25 -3.0\n", "mm", 0),
    "NumPy": ("# x y z\n1.5 2.5 3.5\n4.5 5.5 6.5\n", None, 0),
    "units twice": ("AT960\nUnits: inch\nTime [s]  X [in]  Y [in]  Z [in]\n1  1.5 2.5 3.5\n2  4.5 5.5 6.5\n", "in", 0),
    "commas": ("Instrument 1\nUnits: m\n\nX,Y,Z\n1.5,2.5,3.5\n", "m", 0),
    "tabs": ("station\t1\nX [mm]\tY [mm]\tZ [mm]\n1,5\t2,5\t3,5\n", None, 0),
}


@pytest.mark.parametrize("log", LOGS, ids=str)
def test_headings_are_found_where_they_stand(tmp_path, log):
    text, unit, joints = LOGS[log]
    (tmp_path / "a.txt").write_text(text)
    table = read_table(tmp_path / "a.txt", headings=names_poses)
    last = text.splitlines()[-1].split()[-1].replace(",", ".") if log != "commas" else "3.5"
    assert unit_above(table) == unit
    assert len(joint_columns(table)) == joints
    name = joint_columns(table)[-1] if joints else target_columns(table).translation[2]
    table.expect_decimals([name])
    assert table.number(name)[-1] == float(last)
    assert table.line[-1] == len(text.splitlines())


def test_a_unit_above_the_headings_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.txt").write_text("Units: cubits\nX,Y,Z\n1,2,3\n")
    with pytest.raises(ConfigError, match="the unit 'cubits' is no length"):
        unit_above(read_table(tmp_path / "a.txt", headings=names_poses))


SCOPE = """Name\tYT Scope Project
File\tC:\\scope.tcscopex
Starttime of export\t133774012345670000\tWednesday, 25 November 2026\t10:15:03
Endtime of export\t133774012345710000\tWednesday, 25 November 2026\t10:15:04

Name\tActPos_A1\tName\tActPos_A2\tName\tActPos_A3\tName\tActPos_A4\tName\tActPos_A5
SymbolName\tMAIN.q[1]\tSymbolName\tMAIN.q[2]\tSymbolName\tMAIN.q[3]\tSymbolName\tMAIN.q[4]\tSymbolName\tMAIN.q[5]
Sample time [ms]\t2\tSample time [ms]\t2\tSample time [ms]\t2\tSample time [ms]\t2\tSample time [ms]\t2

0\t1.5\t0\t2.5\t0\t3.5\t0\t4.5\t0\t5.5
2\t1.6\t2\t2.6\t2\t3.6\t2\t4.6\t2\t5.6
EOF
"""
TRACE = (
    "Time\t$AXIS_ACT.A1\t$AXIS_ACT.A2\t$AXIS_ACT.A3\t$AXIS_ACT.A4\t$AXIS_ACT.A5\t$AXIS_ACT.A6\n"
    "0.000\t1.5\t2.5\t3.5\t4.5\t5.5\t6.5\n0.012\t1.6\t2.6\t3.6\t4.6\t5.6\t6.6\n"
)
NAMED = {
    "scope": (SCOPE, ["ActPos_A1", "ActPos_A2", "ActPos_A3", "ActPos_A4", "ActPos_A5"]),
    "trace": (TRACE, [f"$AXIS_ACT.A{i}" for i in range(1, 7)]),
    "theta": ("\t".join(f"theta{i}" for i in range(1, 7)) + "\n" + "\t".join("123456") + "\n", [f"theta{i}" for i in range(1, 7)]),
    "ros": (  # topics of one arm sort their joints by name
        "elbow_joint\tshoulder_lift_joint\tshoulder_pan_joint\twrist_1_joint\twrist_2_joint\twrist_3_joint\telbow_joint_velocity\n"
        + "\t".join("1234567")
        + "\n",
        ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"],
    ),
    "words": ("\t".join(f"Actual position A{i} [deg]" for i in range(1, 7)) + "\n" + "\t".join("123456") + "\n", None),
}


@pytest.mark.parametrize("log", NAMED, ids=str)
def test_the_joints_of_scopes_and_traces_are_found_by_their_names(tmp_path, log):
    text, names = NAMED[log]
    (tmp_path / "a.txt").write_text(text)
    table = read_table(tmp_path / "a.txt", headings=names_poses)
    assert joint_columns(table) == (names or [f"Actual position A{i} [deg]" for i in range(1, 7)])


def test_a_scope_has_one_time_for_all_its_channels(tmp_path):
    (tmp_path / "a.csv").write_text(SCOPE)
    table = read_table(tmp_path / "a.csv", headings=names_poses)
    assert table.number("Time [ms]").tolist() == [0, 2]
    assert table.number("ActPos_A5").tolist() == [5.5, 5.6]
    (tmp_path / "b.csv").write_text(SCOPE.replace("2\t1.6\t2\t2.6", "2\t1.6\t3\t2.6"))
    with pytest.raises(ConfigError):
        read_table(tmp_path / "b.csv", headings=names_poses)


@pytest.mark.parametrize("separator", [" ", ", "])
def test_points_of_spatialanalyzer_need_no_headings(tmp_path, separator):
    rows = [("A", "Tracker", f"p{k}", f"{1000.5 + k}", "200.25", "-3.0") for k in range(3)]
    text = "// SpatialAnalyzer 2023.1\n// Units: Millimeters\n" + "".join(separator.join(row) + "\n" for row in rows)
    (tmp_path / "a.txt").write_text(text)
    table = read_table(tmp_path / "a.txt", headings=names_poses)
    assert unit_above(table) == "mm"
    assert table.numbers(target_columns(table).translation)[2].tolist() == [1002.5, 200.25, -3.0]


def test_a_recording_over_rtde_has_the_pose_of_the_flange(tmp_path):
    names = [f"{who}_TCP_pose_{i}" for who in ("target", "actual") for i in range(6)]
    (tmp_path / "a.csv").write_text("timestamp " + " ".join(names) + "\n1.0 " + "9 " * 6 + "0.5 0.25 -0.125 0 0 1.5707963267948966\n")
    table = read_table(tmp_path / "a.csv", headings=names_poses)
    flange = flange_group(table)
    assert flange.names == tuple(names[6:])
    assert flange.transforms(table)[0, :3, 3].tolist() == [500, 250, -125]
    assert flange.transforms(table)[0, 1, 0] == pytest.approx(1)


def test_joints_of_drivers_are_put_into_the_order_of_the_axes():
    ur = ["elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
    assert in_order_of_axes([f"left_{name}" for name in ur])[:3] == [
        "left_shoulder_pan_joint",
        "left_shoulder_lift_joint",
        "left_elbow_joint",
    ]
    assert in_order_of_axes(["joint_a2", "joint_a1", "joint_a3"]) == ["joint_a1", "joint_a2", "joint_a3"]
    assert in_order_of_axes(["waist", "elbow"]) == ["waist", "elbow"]


@pytest.mark.parametrize(("heading", "rad"), [("actual_q_{}", True), ("J{}", False), ("J{} [rad]", True)])
def test_joints_are_in_the_unit_that_their_names_say(tmp_path, heading, rad):
    names = [heading.format(i) for i in range(6)] if "q_" in heading else [heading.format(i) for i in range(1, 7)]
    (tmp_path / "a.csv").write_text(",".join(names) + "\n0.5,-7,1,1,1,1\n")
    table = read_table(tmp_path / "a.csv", headings=names_poses)
    assert joint_angles(table, joint_columns(table))[0, 1] == (-7 if rad else np.radians(-7.0))
