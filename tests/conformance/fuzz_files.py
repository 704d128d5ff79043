"""Parsers of plans, observation sets, certificates, run folders and results."""

from __future__ import annotations

import json
from pathlib import Path

from fuzz_target import Target, in_file

from mbcacq.exports.certificate import read_certificate_file
from mbcacq.exports.result_json import load_result
from mbcacq.files.table import read_table
from mbcacq.model import yaml_source
from mbcacq.recording.datasets import csv_columns
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.datasets.observation_set import _read_centres, _read_poses, read_observation_set
from mbcacq.recording.rrd.checked_lines import checked_line, read_lines
from mbcacq.recording.rrd.checksums import read_stretches
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.run_plan import plan_files_text, read_kept_plan
from mbcacq.report.sources.from_result import content_of

POSES = b"""pose,station,phase,time_s,q1_deg,q2_deg,dir1,dir2,air_C,note
0,1,position,0.5,10.5,-20.25,1,-1,21.5,first
1,far,hold-out,4.5,-10.0,2e1,0,1,21.75,"a, b"
"""
CENTRES = b"""pose,ball,x_mm,y_mm,z_mm,n_points,rms_mm,qx,qy,qz,qw
0,1,1.5,-2.25,0.001,200,0.01,0,0,0,1
0,2,30.5,1e-3,5,180,0.012,0,0,0,1
1,7,.5,40,-5,170,0.009,0.5,0.5,0.5,0.5
"""
CELL = b"""format: mbcacq-observation-set/1
robot:
  name: two axes
  repeatability_mm: 0.02
  links:
    - {sign: -1, theta_deg: 0, d_mm: 400, a_mm: 25, alpha_deg: -90, gear_ratio: 119.2, mass_kg: 20}
    - {sign: 1, theta_deg: 0, d_mm: 0, a_mm: 560, alpha_deg: 0}
hand_eye: {abc_deg: [10, 20, 30], translation_mm: [1.5, -2.25, 240]}
artefacts:
  - id: mbc
    balls: [{id: 1, centre_mm: [0, 0, 0], diameter_mm: 12}, {id: 2, centre_mm: [30, 0, 5], diameter_mm: 12},
            {id: 7, centre_mm: [0, 40, -5], diameter_mm: 12}]
stations: [{id: 1, artefact: mbc}, {id: far, artefact: mbc}]
scanner: {name: made, noise_mm: [0.005, 0.005, 0.009]}
"""
SET = {"poses.csv": POSES, "centres.csv": CENTRES, "cell.yaml": CELL}
LISTED = b"label,x_mm,y_mm,z_mm,d_mm,U_mm,k,T_C\n1,0.5,-2,3e1,12.001,0.002,2,20.0\n2,10,0,0,12,0.002,2,20.0\n"
LISTED_HERE = "\ufeffBall;X (mm);Y (mm);Z (mm);Diameter (mm)\nK1;0,5;-2;30;12,001\nK2;10;0;0;12\n".encode()
BALLS = b"id: mbc\nT_C: 20\nuncertainty_mm: 0.001\nballs:\n  - {label: K1, centre_mm: [0, 0.5, 3], diameter: 12}\n  - {label: K2, centre_mm: [1, 2, 3], diameter: 12}\n"
DMIS = b"""DMISMN/'certificate'
UNITS/MM,ANGDEC
$$ a comment
FA(BALL 1)=FEAT/SPHERE,OUTER,CART,0.5,-2.0,$
30.0,12.001
FA(BALL 2)=FEAT/SPHERE,OUTER,CART,10,0,0,12
"""
PLAN = b"""format: mbcacq-plan/1
name: made     # a comment
steps:
  - {name: look, poses: [[0, -90, 90, 0, 0, 0], [1.5, -90, 90, 0, 0, 0]]}
  - &again {name: "quoted \\u00e4", count: 12}
  - *again
text: |
  several
  lines
"""


JOURNAL = b"".join(
    checked_line(entry)
    for entry in (
        {
            "time_s": 0.0,
            "event": "run_started",
            "name": "made",
            "started": "2026-01-02T03:04:05+00:00",
            "n_poses": 3,
            "versions": {"numpy": "2"},
        },
        {"time_s": 1.5, "event": "pose_done", "pose": 0, "station": "1", "balls": 8, "robot_time_s": 12.5},
        {"time_s": 1.6, "event": "gap", "kind": "pose", "text": "pose 1 was left out", "pose": 1},
        {"time_s": 2.0, "event": "run_stopped", "exit_status": "fail", "reason": "a wall"},
    )
)
CHECKSUMS = checked_line({"file": "run.rrd", "start": 0, "end": 512, "poses": [1, 2], "sha256": "00" * 32}) * 2
AXES_OF = {name: [0.1, 0.2] for name in ("theta", "d", "a", "alpha", "beta")}
FRAME = [[1, 0, 0, 1.5], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
RESULT = json.dumps(
    {
        "format": "mbcacq-result/1",
        "method": "ml",
        "robot": {
            "name": "made",
            "sign": [1, -1],
            "limits": [[-3, 3], [-3, 3]],
            "nominal": AXES_OF,
            "calibrated": AXES_OF,
            "errors": AXES_OF,
        },
        "T_flange_scanner": FRAME,
        "stations": [{"id": "1", "artefact": "mbc", "T_base_station": FRAME, "std": [0.1] * 6}],
        "balls": [{"id": 1, "centre_mm": [1, 2, 3]}],
        "parameters": [{"name": "theta_1", "value": 0.1, "error": 0.0, "unit": "rad", "std": 0.001, "status": "free"}],
        "names": ["theta_1"],
        "covariance": [[1e-6]],
        "noise": {"scanner_mm": [0.01, 0.01, 0.02], "joint_rad": [1e-5, 1e-5]},
        "fit": {"poses": 3, "centres": 24, "rms_mm": 0.02, "chi2": 50.0, "dof": 52, "rank": 1},
        "verification": {"places": [{"station": "2", "balls": [1, 2], "certified_mm": 10.0, "before_mm": 0.3, "after_mm": 0.02}]},
    }
).encode()


def result_json(path: Path) -> object:
    """Read, and said in the words of a report."""
    return content_of(load_result(path))


def plan_text(data: bytes) -> object:
    return yaml_source.parse(data.decode("utf-8", "replace"), Path("plan.yaml"))


def file_targets() -> list[Target]:
    """All of them."""
    cell = parse_cell(CELL.decode())

    def read_poses(path: Path) -> object:
        return _read_poses(read_table(path, csv_columns.poses_schema(cell.robot, cell.ball_ids)), cell, "")

    _, poses = in_file("poses.csv", read_poses)(POSES)
    kept = plan_files_text({"a.yaml": "a: 1", "b.yaml": "b: [2]"}, "real").encode()
    return [
        Target("plan YAML", (PLAN,), plan_text),
        Target("cell YAML", (CELL,), lambda data: parse_cell(data.decode("utf-8", "replace"))),
        Target("observation set, poses.csv", (POSES,), in_file("poses.csv", read_poses)),
        Target(
            "observation set, centres.csv",
            (CENTRES,),
            in_file("centres.csv", lambda path: _read_centres(read_table(path, csv_columns.CENTRES), cell, poses)),
        ),
        Target("observation set, cell.yaml", (CELL,), in_file("cell.yaml", lambda path: read_observation_set(path.parent), SET)),
        Target("certificate CSV", (LISTED, LISTED_HERE), in_file("c.csv", lambda path: read_certificate_file(path, "mbc"))),
        Target("certificate YAML", (BALLS,), in_file("c.yaml", lambda path: read_certificate_file(path, "mbc"))),
        Target("certificate DMIS", (DMIS,), in_file("c.dmo", lambda path: read_certificate_file(path, "mbc"))),
        Target("journal", (JOURNAL,), in_file("journal.jsonl", lambda path: (read_lines(path), find_gaps(path.parent)))),
        Target("checksums", (CHECKSUMS,), in_file("checksums.jsonl", lambda path: read_stretches(path.parent))),
        Target(
            "plan kept in a run folder", (kept,), in_file("plan.files.json", lambda path: read_kept_plan(path.parent), {"plan.yaml": PLAN})
        ),
        Target("result JSON", (RESULT,), in_file("result.json", result_json)),
    ]
