"""The same plan through EKI and through RSI: the same true cell, each run with noise of its own. Does the calibration notice?

``python benchmarks/eki_rsi.py [--pairs 3] [--first-seed 1]``: one RSI and one EKI run of the full plan per pair.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from mbcacq.calibration import CalibrationOptions, calibrate, verify
from mbcacq.devices import load_driver
from mbcacq.geometry import se3
from mbcacq.plan import expand, load, path
from mbcacq.plan.routing import path_home
from mbcacq.recording import load_observations as load_run
from mbcacq.workflow import acquire

PLANS = Path(__file__).parents[1] / "plans"
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


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--plan", default="kuka.yaml")
    given = parser.parse_args()
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


if __name__ == "__main__":
    main()
