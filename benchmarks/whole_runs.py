"""Whole runs against the fake cell: where their time goes, one plan through two drivers, arms without a driver.

    python benchmarks/whole_runs.py time [--plan plans/kuka.yaml]
    python benchmarks/whole_runs.py drivers [--pairs 3] [--first-seed 1]
    python benchmarks/whole_runs.py offline FOLDER [ARM ..]

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import bench
import numpy as np
import psutil
import yaml
from bench import MBCACQ, PLANS, ROOT, option
from scipy.stats import chi2

import mbcacq
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.devices import load_driver
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.geometry import se3
from mbcacq.model import shipped
from mbcacq.model.robot_import import import_robot
from mbcacq.plan import expand, load, path
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.feasibility import check
from mbcacq.plan.routing import path_home
from mbcacq.recording import load_observations as load_run
from mbcacq.workflow import acquire
from mbcacq.workflow.controller_files import write
from mbcacq.workflow.robot_program import robot_program

NAMES = {
    "mbcacq_fakes.cell.process": "fake scanner (ray casting, encoding)",
    "mbcacq_fakes.protocols.krc.process": "fake controller (one telegram a cycle)",
    "mbcacq_kuka.rsi.cycle": "driver's cycle (one answer a telegram)",
}


def processor_times(process: psutil.Process, seen: dict[str, float]) -> None:
    """Update name of a process -> s of processor time, of a process and all below it."""
    for each in [process, *process.children(recursive=True)]:
        try:
            line, times = " ".join(each.cmdline()), each.cpu_times()
        except psutil.Error:
            continue
        name = next((text for module, text in NAMES.items() if module in line), "mbcacq itself" if each.pid == process.pid else "others")
        seen[name] = times.user + times.system


def parts_of(run: Path) -> dict[str, float]:
    """Wall time (s) of a run in each state, by its report's own reading of the recording."""
    from mbcacq.report.sources.devices import devices_of

    devices = devices_of(run)
    return dict(devices.state_s) if devices else {}


def times(given: argparse.Namespace) -> None:
    """Where the time of a dry run goes: processor time by process, wall time by state of the run.

    The processes are watched from outside, so nothing in them is slowed down. Other work on the machine lengthens the wall time and,
    on cores that share caches, the processor time too: the load is printed.
    """
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        command = [str(MBCACQ), "run", given.plan, "--dry-run", "--json", "--out", str(run)]
        began, load = time.monotonic(), os.getloadavg()[0]
        process = psutil.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        seen: dict[str, float] = {}
        while process.poll() is None:
            processor_times(process, seen)
            time.sleep(0.2)
        wall = time.monotonic() - began
        rows = {"wall_s": round(wall, 1), "load_before": load, "load_after": os.getloadavg()[0]}
        print(json.dumps(rows | {"processor_s": {k: round(v, 1) for k, v in seen.items()}}, indent=1))
        print(json.dumps({"state_s": {k: round(v, 1) for k, v in parts_of(run).items()}}, indent=1))


EKI = {"address": "127.0.0.1", "port": 54610}
# one true cell for all seeds: what a seed draws is noise only
CELL = {
    "errors": "paper",
    "station_error": {"mm": 0.0, "deg": 0.0},
    "hand_eye": {
        "rotation": [[-0.0240, -0.9997, -0.0080], [-0.9997, 0.0240, 0.0010], [-0.0008, 0.0080, -1.0]],
        "translation_mm": [2.2, -1.4, 265.6],
    },
}


def plan(name: str, driver: str, seed: int):
    """A plan of plans/ with this robot driver, in the one true cell with the noise of ``seed``."""
    loaded = load(PLANS / name)
    robot = loaded.plan.robot
    if driver == "kuka_eki":
        robot = robot.model_copy(update={"driver": driver, "options": EKI})
    return replace(loaded, plan=loaded.plan.model_copy(update={"robot": robot, "fake": {**CELL, "seed": seed}}))


def record(name: str, driver: str, seed: int, folder: Path) -> Path:
    """Run the plan against the fake cell."""
    loaded = plan(name, driver, seed)
    poses = expand(loaded)
    with load_driver("fakes", "cell")(loaded, poses, seed=seed) as cell:
        acquire.Acquisition(
            loaded=loaded, poses=poses, paths=path(loaded, poses), path_home=path_home(loaded, poses[-1]), folder=folder
        ).execute(cell.overrides())
    return folder


def difference(a: dict, b: dict) -> tuple[np.ndarray, float, int]:
    """Differences of two results' arm and mount parameters in units of their combined standard deviations, and chi-squared with its
    degrees of freedom."""
    names = [n for n in a["names"] if n in b["names"] and not n.startswith("ball")]
    values = [{p["name"]: p["error"] for p in r["parameters"]} for r in (a, b)]
    arm = [n for n in names if not n.startswith("hand_eye")]
    apart = [values[0][n] - values[1][n] for n in arm]
    if mount := [n for n in names if n.startswith("hand_eye")]:
        A, B = (np.array(r["T_flange_scanner"]) for r in (a, b))
        turn = se3.rotation_log(B[:3, :3].T @ A[:3, :3])  # the mount is T exp(x, y, z, rx, ry, rz)
        twist = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (*(B[:3, :3].T @ (A - B)[:3, 3]), *turn), strict=True))
        apart += [twist[n.split(".")[1]] for n in mount]
    order = [*arm, *mount]
    cov = sum(np.array(r["covariance"])[np.ix_([r["names"].index(n) for n in order], [r["names"].index(n) for n in order])] for r in (a, b))
    apart = np.array(apart)
    return apart / np.sqrt(np.diag(cov)), float(apart @ np.linalg.solve(cov, apart)), len(order)


def drivers(given: argparse.Namespace) -> None:
    """The same plan through EKI and through RSI: the same true cell, each run with noise of its own. Does the calibration notice?

    One RSI and one EKI run of the full plan per pair.
    """
    total = count = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for k in range(given.pairs):
            results = {}
            for offset, driver in enumerate(("kuka_rsi", "kuka_eki")):
                seed, began = given.first_seed + 2 * k + offset, time.monotonic()
                observations = load_run(record(given.plan, driver, seed, Path(folder) / f"{driver}{seed}"))
                took = time.monotonic() - began
                calibration = calibrate(observations, CalibrationOptions())
                results[driver] = calibration.to_dict()
                after = verify(observations, calibration, limit_mm=0.1).to_dict()["after"]
                print(
                    f"{driver} seed {seed}: {len(observations.phase)} poses in {took:.0f} s, bar error mean {after['mean_mm']:.4f} mm, "
                    f"largest {after['max_mm']:.4f} mm",
                    flush=True,
                )
            z, value, n = difference(results["kuka_rsi"], results["kuka_eki"])
            total, count = total + value, count + n
            print(
                f"  apart by {np.sqrt(np.mean(z**2)):.2f} sigma rms, {np.abs(z).max():.2f} at most; chi2 {value:.1f} for {n}, "
                f"p = {chi2.sf(value, n):.2f}",
                flush=True,
            )
    print(f"all pairs: chi2 {total:.1f} for {count:.0f}, p = {chi2.sf(total, count):.2f}")


ARMS = {"abb_irb1600_145": "rapid", "fanuc_lrmate_200id": "karel", "ur10e": "urscript", "motoman_gp7": "inform"}
JOINTS = {
    "fanuc_lrmate_200id": {"couplings": [{"axis": 3, "of": 2, "factor": -1}]},
    "motoman_gp7": {"pulses_per_deg": [1489.5, 1365.3, 1297.0, 853.3, 910.2, 455.1]},
}


SEED = 3


def robot_file(arm: str, folder: Path) -> Path:
    """The tool's own robot file, or one imported from its rows."""
    rows = ROOT / "examples" / "arms" / f"{arm}.csv"
    if not rows.exists():
        return shipped.robot_file(arm)
    out = folder / f"{arm}.yaml"
    out.write_text(import_robot(rows, convention="standard").text, encoding="utf-8")
    return out


def scanner_file(folder: Path) -> Path:
    """A Gocator on a bracket of 80 mm: short wrists need the room."""
    scanner = yaml.safe_load((shipped.folder() / "scanners" / "gocator-3210.yaml").read_text(encoding="utf-8"))
    scanner["hand_eye"]["translation_mm"] = [0, 0, 345]
    scanner["scanner"] |= {"driver": "folder", "options": {"folder": "clouds"}, "resolution_mm": 0.4}
    out = folder / "scanner.yaml"
    out.write_text(yaml.safe_dump(scanner), encoding="utf-8")
    return out


def with_bar(path: Path, arm: str) -> Path:
    """The plan with the long bar, each end seen from two sides, at the first place that the arm reaches; and what its controller needs."""
    plan = yaml.safe_load(path.read_text(encoding="utf-8"))
    plan["robot"]["controller_joints"] = JOINTS.get(arm)
    plan["artefacts"].append(str(shipped.folder() / "artefacts" / "bar-735.yaml"))
    out = path.with_name("with-bar.yaml")
    places = [np.array(s["pose_in_base"]["translation_mm"]) for s in plan["stations"]]
    step = {"name": "bar", "phase": "verification", "do": "look", "stations": ["b1"], "balls": "each"}
    step["views"] = [{"tilt_deg": 15, "azimuth_deg": 180}, {"tilt_deg": 10, "azimuth_deg": 60, "roll_deg": 40}]
    for place in [np.mean(places, axis=0), *places]:
        for turn in (0, 90, 45, -45):
            station = {"id": "b1", "artefact": "bar", "pose_in_base": {"translation_mm": place.tolist(), "abc_deg": [turn, 0, 0]}}
            tried = {**plan, "stations": [*plan["stations"], station], "steps": [*plan["steps"], step]}
            out.write_text(yaml.safe_dump(tried), encoding="utf-8")
            loaded = load(out)
            poses, unreachable = expand_reachable(loaded)
            if not unreachable and not any(f.level == "error" for f in check(loaded, poses)):
                return out
    raise SystemExit(f"{arm}: no place for the bar was found")


def _apart(a: dict, b: dict) -> dict[str, float]:
    """By how many combined standard deviations the identified parameters of two results differ, by name."""
    mine, other = ({p["name"]: p for p in result["parameters"] if p["std"]} for result in (a, b))
    return {n: abs(mine[n]["value"] - other[n]["value"]) / np.hypot(mine[n]["std"], other[n]["std"]) for n in mine if n in other}


def _bar(result: dict) -> str:
    """Error of the bar, and how many of its expected standard deviations that is: one length says little about which run is better."""
    bar = result["verification"]["places"][-1]
    return f"{bar['after_mm']:+.4f} ({bar['after_mm'] / bar['expected_mm']:+.1f} sigma)"


def offline(given: argparse.Namespace) -> None:
    """Offline acquisition of arms without a driver, beside a driven dry run of the same cell.

    The program of a plan is played in the fake cell, its clouds are collected, and the calibration is compared with that of a driven
    dry run. Writes FOLDER/ARM and prints a row an arm of ``offline_arms.md``.
    """
    for arm in given.arms:
        here, began = given.folder / arm, time.monotonic()
        here.mkdir(parents=True, exist_ok=True)
        mbcacq.new_plan(
            robot_file(arm, here), scanner_file(here), "mbc-8", here / "plan.yaml", mbcacq.NewPlanOptions(None, 4, 16), force=True
        )
        path = with_bar(here / "plan.yaml", arm)
        loaded = load(path)
        write(robot_program(loaded, ARMS[arm]), here / "program", True)
        planned = time.monotonic()
        clouds = here / "clouds"
        load_driver("fakes", "rehearsal")(loaded, expand(loaded), here / "program", clouds, seed=SEED)
        collected = mbcacq.collect(loaded, mbcacq.Sources(clouds, joints=clouds / "joints.csv"), out=here / f"collected-{time.time():.0f}")
        driven = mbcacq.run(loaded, dry_run=True, seed=SEED, out=here / f"driven-{time.time():.0f}")
        a, b = (np.array(r.content["T_flange_scanner"])[:3, 3] for r in (collected, driven))
        apart = _apart(collected.content, driven.content)
        worst = max(apart, key=lambda name: apart[name])
        before = collected.content["verification"]["places"][-1]["before_mm"]
        row = [arm, ARMS[arm], f"{np.linalg.norm(a - b):.4f}", f"{apart[worst]:.2f} ({worst}, of {len(apart)})", f"{before:+.3f}"]
        row += [_bar(collected.content), _bar(driven.content), f"{planned - began:.0f} + {time.monotonic() - planned:.0f}"]
        print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    PAIRS = [option("--pairs", type=int, default=3), option("--first-seed", type=int, default=1), option("--plan", default="kuka.yaml")]
    ARMS_ASKED = option("arms", nargs="*", default=list(ARMS), metavar="ARM")
    bench.main(
        __doc__,
        {
            "time": (times, [option("--plan", default="plans/kuka.yaml")]),
            "drivers": (drivers, PAIRS),
            "offline": (offline, [option("folder", type=Path), ARMS_ASKED]),
        },
    )
