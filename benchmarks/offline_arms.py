"""Offline acquisition of arms without a driver: the program of a plan is played in the fake cell, its clouds are collected, and the
calibration is compared with that of a driven dry run of the same cell. ``python benchmarks/offline_arms.py FOLDER`` writes FOLDER/ARM and
prints a row an arm of ``offline_arms.md``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import yaml

import mbcacq
from mbcacq.devices import load_driver
from mbcacq.model import shipped
from mbcacq.model.robot_import import import_robot
from mbcacq.plan import expand, load
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.feasibility import check
from mbcacq.workflow.robot_program import robot_program, write_files

ARMS = {"abb_irb1600_145": "rapid", "fanuc_lrmate_200id": "karel", "ur10e": "urscript", "motoman_gp7": "inform"}
JOINTS = {
    "fanuc_lrmate_200id": {"couplings": [{"axis": 3, "of": 2, "factor": -1}]},
    "motoman_gp7": {"pulses_per_deg": [1489.5, 1365.3, 1297.0, 853.3, 910.2, 455.1]},
}
SEED = 3


def robot_file(arm: str, folder: Path) -> Path:
    """The tool's own robot file, or one imported from its rows."""
    rows = Path(__file__).parents[1] / "examples" / "arms" / f"{arm}.csv"
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


def main(folder: Path, arms: list[str]) -> None:
    for arm in arms:
        here, began = folder / arm, time.monotonic()
        here.mkdir(parents=True, exist_ok=True)
        mbcacq.new_plan(
            robot_file(arm, here), scanner_file(here), "mbc-8", here / "plan.yaml", mbcacq.NewPlanOptions(None, 4, 16), force=True
        )
        path = with_bar(here / "plan.yaml", arm)
        loaded = load(path)
        write_files(robot_program(loaded, ARMS[arm]), here / "program", True)
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


def _apart(a: dict, b: dict) -> dict[str, float]:
    """By how many combined standard deviations the identified parameters of two results differ, by name."""
    mine, other = ({p["name"]: p for p in result["parameters"] if p["std"]} for result in (a, b))
    return {n: abs(mine[n]["value"] - other[n]["value"]) / np.hypot(mine[n]["std"], other[n]["std"]) for n in mine if n in other}


def _bar(result: dict) -> str:
    """Error of the bar, and how many of its expected standard deviations that is: one length says little about which run is better."""
    bar = result["verification"]["places"][-1]
    return f"{bar['after_mm']:+.4f} ({bar['after_mm'] / bar['expected_mm']:+.1f} sigma)"


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or list(ARMS))
