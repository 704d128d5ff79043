"""Parsers of tables that people bring: trajectories, DH rows, points, logs of joints, fleets, hand-eye data."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_files import CELL
from fuzz_target import Target, in_file

from mbcacq.exports.programs.points_csv import read_points
from mbcacq.fleet.arm_prior import read_priors
from mbcacq.fleet.control_chart import EVALUATED
from mbcacq.fleet.recordings import listed
from mbcacq.geometry import se3
from mbcacq.model import shipped
from mbcacq.model.robot_import import import_robot
from mbcacq.plan import expand, load
from mbcacq.recording.datasets import merge
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.datasets.loose_table import TableOptions, read_loose_table
from mbcacq.recording.datasets.trajectory_set import read_motion, read_trajectory_set
from mbcacq.workflow.cloud_session import _slots
from mbcacq.workflow.joint_log import read_joint_log
from mbcacq.workflow.robot_program import plan_digest

KUKA = TableOptions(flange="kuka", target="kuka", measurement="artefact_in_scanner")
TRAJECTORY = b"""time_s,q1_deg,q2_deg,q1_set_deg,q2_set_deg,i1_A,tau2_Nm,motor_C,note
0.0,10,-20,10.01,-20,1.5,-3e1,25,a
0.004,10.5,-20.25,10.5,-20.3,1.25,-29,25,"b, c"
0.008,11,-20.5,11,-20.6,1,-28.5,25,
"""
MOTION = b"""format: mbcacq-trajectory-set/1
robot:
  name: two axes
  links:
    - {theta_deg: 0, d_mm: 400, a_mm: 25, alpha_deg: -90, mass_kg: 20}
    - {theta_deg: 0, d_mm: 0, a_mm: 560, alpha_deg: 0}
"""
DH = b"""theta_deg,d_mm,a_mm,alpha_deg,lower_deg,upper_deg,mass_kg,joint
0,400,25,-90,-170,170,20,A1
0,0,560,0,-100,100,10,A2
-90,0,25,-90,-90,90,5,A3
"""
DH_HERE = "θ (rad);d [m];a [m];α (rad)\n0;0,4;0,025;-pi/2\n0;0;0,56;0\n-pi/2;0;0,025;-90°\n".encode()
DH_YAML = b"rows:\n  - {theta_deg: 0, d_mm: 400, a_mm: 25, alpha_deg: -90}\n  - {theta_deg: 0, d_mm: 0, a_mm: 560, alpha_deg: pi/2}\n"
POINTS = b"name,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\nhome,0,-90,90,0,0,0\nP1,10.5,-80,80,1e1,30,-5\n"
POINTS_HERE = b"X (mm);Y (mm);Z (mm);A (deg);B (deg);C (deg)\r\n500;0,5;600;0;90;0\r\n510;1,5;600;0;90;10\r\n"
FLEET = b"recording,arm,time\na,arm-1,2026-03-01\nb/c.rrd,arm-2,2026-03-02T08:30:00+01:00\n"
LOG = b"time_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n" + b"".join(b"%.3f,%d.5,%d,0,1,2,3\n" % (0.1 * k, k, -k) for k in range(22))
LOG_OF_FLANGE = b"timestamp;x [mm];y [mm];z [mm];a [deg];b [deg];c [deg]\n" + b"".join(
    b"0,%d;%d,5;%d;3;0;1;2\n" % (k, k, -k) for k in range(10, 34)
)


@cache
def _quick() -> tuple[Any, Any]:
    """The shipped quick plan and its poses."""
    loaded = load(shipped.folder() / "quick.yaml")
    return loaded, expand(loaded)


def _joint_rows() -> list[list[float]]:
    loaded, poses = _quick()
    return [np.degrees(pose.q).tolist() for pose in poses[:3]]


def joint_csv() -> bytes:
    """The first poses of the plan as a controller's table."""
    rows = [f"{k},{','.join(f'{v:.4f}' for v in row)}" for k, row in enumerate(_joint_rows())]
    return ("pose,A1,A2,A3,A4,A5,A6\n" + "\n".join(rows) + "\n").encode()


def joint_dat() -> bytes:
    """The same as the data list of a KRL program."""
    rows = [f"mb_at[{k + 1}]={{{','.join(f'A{i + 1} {v:.4f}' for i, v in enumerate(row))},E1 0.0}}" for k, row in enumerate(_joint_rows())]
    return ("DEFDAT mbcacq_poses\n" + "\n".join(rows) + "\nENDDAT\n").encode()


def joint_messages() -> bytes:
    """The same as messages in the log of a UR controller."""
    rows = [f"2026-01-01 INFO mbcacq joints [{', '.join(f'{np.radians(v):.6f}' for v in row)}]" for row in _joint_rows()]
    return ("\n".join(rows) + "\n").encode()


def program_table() -> bytes:
    """Pose, exposure and plan of each cloud of a robot program."""
    loaded, poses = _quick()
    return ("pose,exposure,plan\n" + "".join(f"{pose.number},0,{plan_digest(loaded)}\n" for pose in poses[:3])).encode()


def hand_eye() -> bytes:
    """Six poses of a flange and what a camera on it sees of one target, as its controller and its program write them."""
    rng = np.random.default_rng(1)
    T_flange_camera = se3.from_abc(np.array([40.0, -20.0, 110.0]), np.radians([-90.0, 2.0, 178.0]))
    T_base_target = se3.from_abc(np.array([700.0, 50.0, 20.0]), np.radians([20.0, 5.0, 3.0]))
    rows = []
    for _ in range(6):
        T = se3.from_abc(np.array([650.0, 0.0, 450.0]) + 80 * rng.normal(size=3), np.radians([0.0, 0.0, 180.0]) + 0.4 * rng.normal(size=3))
        seen = se3.to_abc(se3.inverse(T @ T_flange_camera) @ T_base_target)
        rows.append(",".join(f"{v:.5f}" for xyz, abc in (se3.to_abc(T), seen) for v in (*xyz, *np.degrees(abc))))
    heads = [f"{thing}_{c}" for thing in ("flange", "target") for c in ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg")]
    return (",".join(heads) + "\n" + "\n".join(rows) + "\n").encode()


def fleet_parquet(without: Sequence[str] = ()) -> bytes:
    """Five calibrated arms of two axes. without: columns that are left out."""
    import pyarrow as pa
    from pyarrow import parquet

    row = {"status": EVALUATED, "names": ["theta_1"], "covariance": [1e-6], "nominal": [0.1] * 10, "robot": "two axes"}
    row |= {"error.theta_1": 0.01, "std.theta_1": 1e-3, "time": None}
    out = io.BytesIO()
    parquet.write_table(
        pa.Table.from_pylist([{"recording": f"r{k}", "arm": f"arm-{k}", **row} for k in range(5)]).drop_columns(list(without)), out
    )
    return out.getvalue()


def log(path: Path) -> object:
    """One of the two logs that ``data merge`` takes."""
    table = merge._read(path, {})
    hand, values = merge._arm(table)
    return merge._log(table, values, hand is None)


def points(path: Path) -> bytes:
    """Read and written with corrected angles, as ``correct`` does."""
    found = read_points(path, 6)
    q = np.nan_to_num(found.q)
    return found.written(q, np.zeros(len(q)), np.ones(len(q), dtype=bool), [""] * len(q))


def _joints(path: Path) -> object:
    loaded, poses = _quick()
    return read_joint_log(path, loaded, poses)


def _slots_of(path: Path) -> object:
    loaded, poses = _quick()
    return _slots(loaded, poses, path, frozenset(), 3)


def table_targets() -> list[Target]:
    """All of them."""
    robot = parse_cell(CELL.decode()).robot
    return [
        Target(
            "trajectory set, trajectory.csv",
            (TRAJECTORY,),
            in_file("trajectory.csv", lambda path: read_motion(path.parent, robot, simulated=False)),
        ),
        Target(
            "trajectory set, cell.yaml",
            (MOTION,),
            in_file("cell.yaml", lambda path: read_trajectory_set(path.parent), {"trajectory.csv": TRAJECTORY}),
        ),
        Target("DH rows CSV", (DH, DH_HERE), in_file("rows.csv", lambda path: import_robot(path, convention="standard"))),
        Target("DH rows YAML", (DH_YAML,), in_file("rows.yaml", lambda path: import_robot(path, convention="modified"))),
        Target("table of points", (POINTS, POINTS_HERE), in_file("points.csv", points)),
        Target("log of joints, CSV", (joint_csv(),), in_file("joints.csv", _joints)),
        Target("log of joints, KRL", (joint_dat(),), in_file("joints.dat", _joints)),
        Target("log of joints, messages", (joint_messages(),), in_file("joints.log", _joints)),
        Target("table of a robot program", (program_table(),), in_file("poses.csv", _slots_of)),
        Target("table of recordings", (FLEET,), in_file("fleet.csv", listed)),
        Target("fleet Parquet", (fleet_parquet(),), in_file("fleet.parquet", read_priors)),
        Target("hand-eye table", (hand_eye(),), in_file("poses.csv", lambda path: read_loose_table(path, KUKA))),
        Target("log to be merged", (LOG, LOG_OF_FLANGE), in_file("log.csv", log)),
    ]
