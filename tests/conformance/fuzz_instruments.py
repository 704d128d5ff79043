"""Parsers of what controllers and instruments write: logs and traces, exports of trackers, line profiles, poses of the flange and of
targets, range maps."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from fuzz_files import CELL
from fuzz_tables import KUKA, hand_eye, log
from fuzz_target import Target, in_file

from mbcacq.geometry import se3
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.datasets.hand_eye_sets import read_hand_eye_files
from mbcacq.recording.datasets.loose_table import TableOptions
from mbcacq.recording.datasets.merge import _log, _read, _target, merge_logs
from mbcacq.recording.datasets.observation_set import read_observation_set, read_observations
from mbcacq.spheres.cloud_files import CloudFormat, read_points

ROWS = 22  # of a log; fewer are refused
SCOPE = (
    b"Name\tYT Scope Project\nStarttime of export\t133774012345670000\tWednesday\nEndtime of export\t133774012345710000\n\n"
    + b"\t".join(b"Name\tActPos_A%d" % i for i in range(1, 6))
    + b"\n"
    + b"\t".join([b"Sample time [ms]\t2"] * 5)
    + b"\n\n"
    + b"".join(b"\t".join(b"%d\t%d.%d" % (2 * k, i, k) for i in range(1, 6)) + b"\n" for k in range(ROWS))
    + b"EOF\n"
)
TRACE = b"Time\t" + b"\t".join(b"$AXIS_ACT.A%d" % i for i in range(1, 7)) + b"\n"
TRACE += b"".join(b"%.3f\t%d.5\t2.5\t-3.5\t4\t5\t6\n" % (0.012 * k, k) for k in range(ROWS))
RTDE = b"timestamp " + b" ".join(b"actual_q_%d" % i for i in range(6)) + b"\n"
RTDE += b"".join(b"%.3f 0.%d -1.5 1.5 0 0.5 -0.25\n" % (1 + 0.008 * k, k) for k in range(10, 10 + ROWS))
RTDE_POSES = b"timestamp " + b" ".join(b"actual_TCP_pose_%d" % i for i in range(6)) + b"\n"
RTDE_POSES += b"".join(b"%.3f 0.5 0.%d -0.125 0 3.1 1e-2\n" % (1 + 0.008 * k, k) for k in range(10, 10 + ROWS))
SPATIALANALYZER = b"// SpatialAnalyzer 2023.2.1\n// Working frame: A::WORLD\n// Units: Millimeters\n" + b"".join(
    b"A, Robot, p%d, %d.5, 200.25, -3.0, 11/25/2026 1:15:%02d.250 PM\n" % (k, 1000 + k, k) for k in range(ROWS)
)
LEICA = b"Leica AT960-MR  serial 750123\nUnits: mm\n\nNo  Time [s]  X [mm]  Y [mm]  Z [mm]\n" + b"".join(
    b"%d  %.4f  %d.5  200.25  -3.0\n" % (k, 0.1 * k, 1000 + k) for k in range(ROWS)
)
API = b"API Radian Pro\nLength unit: inch\nTime,X,Y,Z\n" + b"".join(b"13:15:%02d.5,%d.5,8,-3\n" % (k, 40 + k) for k in range(ROWS))
BY_FLANGE = b"""format: mbcacq-observation-set/1
measurement: target_in_base
artefacts: [{id: target, balls: [{id: 1, centre_mm: [0, 0, 0]}]}]
stations: [{id: s1, artefact: target}]
"""
UR_POSES = b"""pose,station,x_mm,y_mm,z_mm,rx_rad,ry_rad,rz_rad,target_x_mm,target_y_mm,target_z_mm
1,s1,650.5,20,300,0,3.1,0.1,1200,50.5,20
2,s1,600,-20.25,350,0.2,2.9,-0.1,1150.5,45,60
3,s1,620,0,320,-0.3,3,0,1170,48,30
"""
PROFILE_RADIUS, LEAST = 15.0, 14  # mm; profiles


@cache
def poses() -> tuple[np.ndarray, np.ndarray]:
    """Eight poses of a flange (8, 4, 4) and of the target as the camera sees it, in mm."""
    rng = np.random.default_rng(1)
    X = se3.from_abc(np.array([40.0, -20.0, 110.0]), np.radians([-90.0, 2.0, 178.0]))
    target = se3.from_abc(np.array([700.0, 50.0, 20.0]), np.radians([20.0, 5.0, 3.0]))
    turns = np.radians([0.0, 0.0, 180.0]) + 0.4 * rng.normal(size=(8, 3))
    hand = np.array([se3.from_abc(np.array([650.0, 0, 450]) + 80 * rng.normal(size=3), turn) for turn in turns])
    return hand, se3.inverse(hand @ X) @ target


def table_of_balls() -> bytes:
    """Three balls that the scanner on the flange sees at each pose, one of them once not."""
    rows = ["A,B,C,X,Y,Z,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,x3_mm,y3_mm,z3_mm"]
    for k, (hand, eye) in enumerate(zip(*poses(), strict=True)):
        xyz, abc = se3.to_abc(hand)
        balls = se3.apply(eye, np.array([[0.0, 0, 0], [30, 0, 10], [0, 40, -10]])).ravel()
        seen = [f"{v:.4f}" for v in balls]
        rows.append(",".join([f"{v:.4f}" for v in (*np.degrees(abc), *xyz)] + (seen if k != 1 else [*seen[:6], "", "", ""])))
    return ("\n".join(rows) + "\n").encode()


def moveit_samples() -> bytes:
    """What MoveIt's calibration saves: column by column, in m."""
    hand, eye = (T.copy() for T in poses())
    rows = []
    for a, b in zip(hand, eye, strict=True):
        for name, T in (("effector_wrt_world", a), ("object_wrt_sensor", b)):
            T[:3, 3] /= 1e3
            rows.append(f"{'- ' if name[0] == 'e' else '  '}{name}: [{', '.join(f'{v:.6g}' for v in T.ravel())}]")
    return ("\n".join(rows) + "\n").encode()


def easy_handeye_samples() -> bytes:
    """What easy_handeye2 saves: translations in m and quaternions."""
    rows = ["samples:"]
    for pair in zip(*poses(), strict=True):
        for name, T in zip(("- robot", "  tracking"), pair, strict=True):
            t, angle = T[:3, 3] / 1e3, se3.rotation_log(T[:3, :3])
            half = np.linalg.norm(angle) / 2
            xyz = angle / (2 * half) * np.sin(half)
            vector = ", ".join(f"{c}: {v:.6g}" for c, v in zip("xyz", t, strict=True))
            turn = ", ".join(f"{c}: {v:.6g}" for c, v in zip("xyzw", (*xyz, np.cos(half)), strict=True))
            rows.append(f"{name}: {{translation: {{{vector}}}, rotation: {{{turn}}}}}")
    return ("\n".join(rows) + "\n").encode()


def matrix_files() -> dict[str, bytes]:
    """A file of 16 numbers for each pose of the flange and of the target."""
    return {
        f"{name}{k}.txt": "\n".join(" ".join(f"{v:.5f}" for v in row) for row in T[k]).encode()
        for name, T in zip(("pos", "target"), poses(), strict=True)
        for k in range(6)
    }


def pose_table(T: np.ndarray) -> bytes:
    """Times, places and quaternions, as trackers of markers write them."""
    rows = ["timestamp,x [mm],y [mm],z [mm],a [deg],b [deg],c [deg]"]
    for k, one in enumerate(T):
        xyz, abc = se3.to_abc(one)
        rows.append(f"{k}.5," + ",".join(f"{v:.4f}" for v in (*xyz, *np.degrees(abc))))
    return ("\n".join(rows) + "\n").encode()


@cache
def profiles() -> tuple[bytes, bytes, bytes]:
    """Line profiles of one sphere: in one table with the flange's poses; the poses alone; the points alone."""
    rng = np.random.default_rng(2)
    X, sphere = se3.from_abc(np.array([30.0, -10, 120]), np.radians([5.0, -4, 8])), np.array([650.0, 20, 90])
    one, hand, points = ["profile,X,Y,Z,A,B,C,profile_x_mm,profile_z_mm"], ["profile,X,Y,Z,A,B,C"], ["profile,x_mm,z_mm"]
    for k in range(LEAST):
        R = se3.rotation_exp(0.4 * np.random.default_rng(k % 4).normal(size=3)) @ np.diag([1.0, -1, -1])
        s = np.array([rng.uniform(-20, 20), rng.uniform(-11, 11), 300 + rng.uniform(-20, 20)])
        xyz, abc = se3.to_abc(se3.transform(R, sphere - R @ (X[:3, :3] @ s + X[:3, 3])))
        pose = ",".join(f"{v:.4f}" for v in (*xyz, *np.degrees(abc)))
        r = np.sqrt(PROFILE_RADIUS**2 - s[1] ** 2)
        hand.append(f"{k},{pose}")
        for angle in np.linspace(-0.9, 0.9, 12):
            x, z = s[0] + r * np.sin(angle), s[2] - r * np.cos(angle)
            one.append(f"{k},{pose},{x:.5f},{z:.5f}")
            points.append(f"{k},{x:.5f},{z:.5f}")
    return tuple(("\n".join(rows) + "\n").encode() for rows in (one, hand, points))  # type: ignore[return-value]


def moving_logs() -> tuple[bytes, bytes]:
    """The logs of an arm that rests and moves by turns, and of a tracker that saw it."""
    rng = np.random.default_rng(4)
    at = np.repeat(np.cumsum(rng.uniform(0.1, 1.0, 8)), rng.integers(7, 14, 8))
    at = np.convolve(at, np.ones(4) / 4, mode="valid")
    joints = b"time_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n" + b"".join(
        b"%.1f,%.4f,-80,90,0,%.4f,0\n" % (0.1 * k, 20 * a, 5 * a) for k, a in enumerate(at)
    )
    seen = b"Units: mm\nTime\tX [mm]\tY [mm]\tZ [mm]\n" + b"".join(
        b"%.1f\t%.3f\t%.3f\t20\n" % (7 + 0.1 * k, 900 * np.cos(0.35 * a), 900 * np.sin(0.35 * a)) for k, a in enumerate(at)
    )
    return joints, seen


def tracker_log(path: Path) -> object:
    """The log of an instrument, as ``data merge`` takes it."""
    table = _read(path, {})
    seen = _target(table)
    return _log(table, table.numbers(seen.translation) * (seen.with_units(table).length or 1.0), False)


def range_maps() -> tuple[bytes, ...]:
    """A small map of counts, of heights, and a compressed one."""
    import tifffile

    made = []
    for counts, options in (
        (np.arange(30, dtype="<u2").reshape(5, 6), {}),
        (np.linspace(0, 2, 30, dtype="<f4").reshape(5, 6), {"byteorder": ">"}),
        (np.arange(256, dtype="<u2").reshape(16, 16), {"compression": "zlib", "tile": (16, 16)}),
    ):
        out = io.BytesIO()
        tifffile.imwrite(out, counts, **options)
        made.append(out.getvalue())
    return tuple(made)


def instrument_targets() -> list[Target]:
    """All of them; range maps where tifffile is installed."""
    sphere = TableOptions(diameter_mm=2 * PROFILE_RADIUS, flange="kuka", measurement="artefact_in_scanner")
    of_hand, matrices = TableOptions(measurement="artefact_in_scanner"), matrix_files()
    (one, hand, points), (moved, tracked) = profiles(), moving_logs()
    out = [
        Target("log TwinCAT Scope", (SCOPE,), in_file("scope.csv", log)),
        Target("log KUKA trace", (TRACE,), in_file("trace.txt", log)),
        Target("log RTDE", (RTDE, RTDE_POSES), in_file("rtde.csv", log)),
        Target("log of a tracker", (SPATIALANALYZER, LEICA, API), in_file("tracker.txt", tracker_log)),
        Target(
            "two logs merged",
            (tracked,),
            in_file("tracker.txt", lambda path: merge_logs(path.with_name("joints.csv"), path, {}), {"joints.csv": moved}),
        ),
        Target("line profiles, one table", (one,), in_file("p.csv", lambda path: read_hand_eye_files([path], sphere))),
        Target(
            "line profiles, points",
            (points,),
            in_file("p.csv", lambda path: read_hand_eye_files([path.with_name("poses.csv"), path], sphere), {"poses.csv": hand}),
        ),
        Target("poses of a flange", (UR_POSES,), in_file("poses.csv", _of(_ur(BY_FLANGE)))),
        Target("cell.yaml of poses of a flange", (_ur(BY_FLANGE),), in_file("cell.yaml", _set, {"poses.csv": UR_POSES})),
        Target("wide table of joints", _wide(), in_file("poses.csv", _of(CELL))),
        Target("hand-eye table of balls", (table_of_balls(),), in_file("t.csv", lambda path: read_hand_eye_files([path], KUKA))),
        Target("hand-eye table, conventions", (hand_eye(),), in_file("t.csv", lambda path: read_hand_eye_files([path], TableOptions()))),
        Target(
            "hand-eye samples", (moveit_samples(), easy_handeye_samples()), in_file("s.yaml", lambda p: read_hand_eye_files([p], of_hand))
        ),
        Target(
            "hand-eye pair of tables",
            (pose_table(poses()[1]),),
            in_file(
                "eye.csv", lambda path: read_hand_eye_files([path.with_name("hand.csv"), path], KUKA), {"hand.csv": pose_table(poses()[0])}
            ),
        ),
        Target(
            "hand-eye folder of matrices",
            (matrices.pop("target0.txt"),),
            in_file("target0.txt", lambda path: read_hand_eye_files([path.parent], of_hand), matrices),
        ),
    ]
    if find_spec("tifffile"):
        form = CloudFormat(range_map=(0.1, 0.1, 0.01, 100.0))
        out.append(Target("cloud TIFF", range_maps(), in_file("c.tif", lambda path: read_points(path, form))))
    return out


def _set(path: Path) -> object:
    return read_observation_set(path.parent)


def _of(cell: bytes) -> Callable[[Path], object]:
    text = cell.decode()
    known = parse_cell(text)
    return lambda path: read_observations(path.parent, known, text)


def _ur(cell: bytes) -> bytes:
    return cell + b"flange_poses: {orientation: ur}\n"


def _wide() -> tuple[bytes, ...]:
    """Joint angles and what was measured in one row: of several balls, and of one."""
    return (
        b"pose,station,q1_deg,q2_deg,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n0,1,10.5,-20.25,1.5,-2.25,0.5,30.5,1e-3,5\n1,far,-10,20,3,4,5,,,\n",
        b"pose;station;q1_deg;q2_deg;ball;x_mm;y_mm;z_mm\n0;1;10,5;-20,25;1;1,5;-2,25;0,5\n1;far;-10;20;7;3;4;5\n",
    )
