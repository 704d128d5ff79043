"""What the commands that are struck read: observation sets, results, runs, plans, tables, logs. Each in two versions, a and b."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench import PLANS, changed_plan

from faults.preloaded import Work, command, in_child
from faults.small_run import two_stations

DH_ROWS = "theta_deg,d_mm,a_mm,alpha_deg\n0,400,25,-90\n-90,0,455,0\n0,0,35,-90\n0,420,0,90\n0,0,0,-90\n"  # five of six
SPHERES = "label,x,y,z,d,U,k\nS1,1,2,3,12,0.002,2\nS2,31,2,3,12,0.002,2\nS3,31,42,3,12,0.002,2\n"  # three of four
JOINTS = "0,-90,90,0,30,0"
REST_S, RATE_HZ = 1.2, 100.0


def make(work: Work) -> None:
    """Do the work, which must end well."""
    if code := in_child(work):
        raise SystemExit(f"exit code {code} while the inputs are made")


def _alter(step: int, plan: dict[str, Any]) -> None:
    """Another speed, which programs of poses state, and another port, which files of the controller state."""
    plan["robot"]["speed"] = 0.1 * (1 + step)
    plan["robot"]["options"]["port"] += step


def make_inputs(work: Path) -> None:
    """Observation sets a and b, their results, a finished run, a torn one, and what else the commands take."""
    from mbcacq.model.json_text import sealed_text

    for seed, name in enumerate("ab"):
        make(command("simulate", PLANS / "kuka.yaml", "--noise", "--seed", seed, "--out", work / name))
        for other in "ab"[seed:]:
            shutil.copytree(work / name, work / f"arms-{other}" / "arm" / name)
    make(command("calibrate", work / "a", "--out", work / "a.json"))
    other = json.loads((work / "a.json").read_text())
    other["T_flange_scanner"][2][3] += 1.0
    for angle in range(6):
        other["robot"]["calibrated"]["theta"][angle] += 1e-4
    (work / "b.json").write_text(sealed_text(other))
    for place, name in enumerate("ab"):
        changed_plan("quick.yaml", work / f"plan-{name}.yaml", partial(_alter, place))
        (work / f"hand-eye-{name}.csv").write_text(hand_eye_table(place))
        (work / f"rows-{name}.csv").write_text(f"{DH_ROWS}0,{80 + place},0,0\n")
    (work / "points.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n" + f"{JOINTS}\n" * 20)
    (work / "scan.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2000\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        + "".join(f"{i % 50}.5 {i // 50}.25 {i % 7}.125\n" for i in range(2000))
    )
    make_files(work)
    print("ready for the commands on sets", flush=True)


def measure_checks(work: Path) -> None:
    """Two checks of the result a, in a simulated cell that is another one than the calibrated."""

    def simulate(plan: dict[str, Any]) -> None:
        for device in ("robot", "scanner"):
            plan[device] |= {"driver": "simulated", "options": {}}

    cell = changed_plan("quick.yaml", work / "check.yaml", simulate)
    for seed, name in enumerate("ab"):
        files = ("--history", work / "checks.json", "--out", work / f"check-{name}")
        make(finding_changes(command("check", work / "a.json", cell, "--dry-run", "--seed", seed, *files)))


def finding_changes(check: Work) -> Work:
    """A check that ends well where it finds the cell changed."""

    def work() -> None:
        try:
            check()
        except SystemExit as end:
            if end.code != 11:
                raise

    return work


def briefly_designed(design: Work) -> Work:
    """The design of a motion, its search cut short: what is struck is the writing."""

    def work() -> None:
        from mbcacq.design import excitation

        excitation.OPTIONS = excitation.ExcitationOptions(drawn=10, begun=4, improved=0)
        design()

    return work


def rehearsal(plan: Path, folder: Path, seed: int) -> Work:
    """A robot program of the plan, written and played by the fake cell of this seed."""

    def work() -> None:
        for words in (
            ("plan", "program", plan, "--for", "csv", "--out", folder / "program", "--replace"),
            ("fakes", plan, "--program", folder / "program", "--clouds", folder / "clouds", "--seed", seed),
        ):
            try:
                command(*words)()
            except SystemExit as end:
                if end.code:
                    raise

    return work


def copied_and_edited(plan: str, folder: Path) -> Work:
    """A plan's copy, and a line of the user's behind each of its files."""

    def work() -> None:
        from mbcacq.workflow.copy_plan import copy_plan

        for file in copy_plan(plan, folder):
            file.write_text(file.read_text() + "# mine\n")

    return work


def hand_eye_table(seed: int) -> str:
    """Twenty poses of the flange as a KUKA shows them (mm, deg), and of a target as the camera on it sees it (mm, quaternion)."""
    from scipy.spatial.transform import Rotation

    from mbcacq.geometry import se3

    rng = np.random.default_rng(seed)
    xyz, abc = rng.uniform(-100, 100, (20, 3)) + [600, 0, 500], rng.uniform(-40, 40, (20, 3)) + [0, 90, 0]
    T_flange_camera, T_base_target = (
        se3.from_abc(np.array(at), np.radians(by)) for at, by in (([10, 20, 80], [5, 3, 90]), ([900, 0, 0], [0, 0, 0]))
    )
    target = se3.inverse(se3.from_abc(xyz, np.radians(abc)) @ T_flange_camera) @ T_base_target
    rows = np.column_stack([xyz, abc, target[:, :3, 3], Rotation.from_matrix(target[:, :3, :3]).as_quat()])
    head = "X,Y,Z,A,B,C,target_x_mm,target_y_mm,target_z_mm,target_qx,target_qy,target_qz,target_qw"
    return "\n".join([head, *(",".join(f"{value:.6f}" for value in row) for row in rows)]) + "\n"


def make_run(work: Path) -> None:
    """A finished run of 16 poses, and one whose recording is torn in its middle."""
    make(command("run", two_stations(work), "--dry-run", "--out", work / "run"))
    shutil.copytree(work / "run", work / "torn", ignore=shutil.ignore_patterns("result*", "report*"))
    data = (work / "torn" / "run.rrd").read_bytes()
    (work / "torn" / "run.rrd").write_bytes(data[: len(data) * 2 // 3])
    shutil.copytree(work / "torn", work / "mended")
    make(command("recover", work / "mended"))
    print("ready for the commands on runs", flush=True)


def make_files(work: Path) -> None:
    """Certificates, a controller's data, logs of an arm and of a tracker, plans to be mended, designed and ordered."""
    (work / "config.dat").write_bytes(b"DEFDAT\r\nTOOL_DATA[1]={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}\r\nENDDAT\r\n")
    for place, name in enumerate("ab"):
        (work / f"spheres-{name}.csv").write_text(f"{SPHERES}S4,1,2,{33 + place},12,0.002,2\n")
        write_motion_logs(work, name, place)

    def to_be_ordered(plan: dict[str, Any]) -> None:
        plan["steps"] = [{**plan["steps"][1], "phase": "position"}]

    text = (PLANS / "quick.yaml").read_text()
    for old, new in (("robots/", f"{PLANS}/robots/"), ("artefacts/", f"{PLANS}/artefacts/"), ("[600, 0, 150]", "[1250, 0, 150]")):
        text = text.replace(old, new)
    (work / "far.yaml").write_text(text)
    changed_plan("quick.yaml", work / "ordered.yaml", to_be_ordered)


def write_motion_logs(work: Path, name: str, seed: int) -> None:
    """Joint angles of an arm that rests ten times, and what a tracker whose clock is 12 s late saw of a reflector on its flange."""
    from mbcacq.geometry import se3
    from mbcacq.recording.datasets.cell_yaml import robot_of

    rng = np.random.default_rng(seed)
    stops = np.radians([0, -80, 90, 0, 50, 0]) + rng.uniform(-0.6, 0.6, (10, 6))
    rest = int(REST_S * RATE_HZ)
    q = [np.repeat(stops[:1], rest, axis=0)]
    for before, after in zip(stops[:-1], stops[1:], strict=True):
        s = np.linspace(0, 1, int(rng.uniform(60, 220)))[:, None]
        q += [before + (3 * s**2 - 2 * s**3) * (after - before), np.repeat(after[None], rest, axis=0)]
    joints = np.concatenate(q)
    time = np.arange(len(joints)) / RATE_HZ
    seen = se3.apply(robot_of("ur10e").chain.flange(joints), np.array([30.0, -20.0, 110.0])) + rng.normal(0, 0.01, (len(joints), 3))
    for of, rows, head in (("arm", np.degrees(joints), "Time,J1,J2,J3,J4,J5,J6"), ("tracker", seen, "Time,X [mm],Y [mm],Z [mm]")):
        stamps = time + (12.0 if of == "tracker" else 0.0)
        lines = [",".join(f"{value:.5f}" for value in (t, *row)) for t, row in zip(stamps, rows, strict=True)]
        (work / f"{of}-{name}.csv").write_text("\n".join([head, *lines]) + "\n")


def make_torques(work: Path) -> None:
    """Recordings of torque over little of the joints' ranges, from which a motion is designed."""
    from mbcacq.geometry.dynamics import nominal_parameters, regressor
    from mbcacq.model.trajectory import Trajectory
    from mbcacq.plan import load
    from mbcacq.recording.datasets.trajectory_set import write_trajectory_set

    robot = load(PLANS / "quick.yaml").cell.robot
    described = nominal_parameters(robot.mass, robot.com, robot.payload_mass, robot.payload_com)
    time = np.arange(0.0, 4.0, 0.01)
    for seed, name in enumerate("ab"):
        rng = np.random.default_rng(seed)
        size, speed = np.radians([10, 27, 10, 10, 10, 10]), rng.uniform(2, 4, 6)
        home = np.radians([0, -90, 90, 0, 90, 0])
        q = home + size * np.sin(speed * time[:, None])
        qd, qdd = size * speed * np.cos(speed * time[:, None]), home - q
        torque = np.einsum("tjlk,lk->tj", regressor(robot.chain, q, qd, qdd * speed**2, robot.gravity), described)
        write_trajectory_set(Trajectory(robot, time, q, torque=torque + rng.normal(0, 0.3, q.shape)), work / f"torque-{name}")
