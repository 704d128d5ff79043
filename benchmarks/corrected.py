"""The arm steered by its calibrated model: true errors at 50 new places, for the arm as it is, corrected by geometry, and with effects.

    python benchmarks/corrected.py [--drivers simulated,kuka-rsi,kuka-eki] [--out runs/corrected-benchmark]

A fake cell conceals an elastic A2 and A3 and a wavy A4 besides its errors of geometry. It is recorded at the places of plans/seeing.yaml by
the array path, calibrated, diagnosed, and calibrated with what was found. Then it is sent to 50 other places, by ``mbcacq.run`` against the
fake cell at the wire of each driver: with the plan's own targets, with targets corrected by the geometry, and by geometry and effects.
The true flange of every recorded pose (the world's own arm, with all it conceals) is compared with the place that was meant. Base and tool
are adjusted to the 50 places, as a user who teaches a base and a tool does; repeatability is that of one arrival, by two at the same joint
angles.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mbcacq_fakes.cell.build_world import make_world
from mbcacq_fakes.world.description import from_cell
from mbcacq_fakes.world.options import parse

import mbcacq
from mbcacq.calibration.sealed_json import sealed_text
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.geometry import se3
from mbcacq.plan import LoadedPlan, expand
from mbcacq.workflow.corrected_targets import corrected_targets

ROOT = Path(__file__).parents[1]
SEED = 7
HIDDEN = [
    {"name": "joint_compliance", "where": "A2", "compliance_rad_per_Nm": 2.0e-6},
    {"name": "joint_compliance", "where": "A3", "compliance_rad_per_Nm": 3.0e-6},
    {"name": "gear_transmission_error", "where": "A4", "order": 2.0, "amplitude_deg": 0.01, "phase_deg": 40.0},
]
DRIVERS = {
    "simulated": {"driver": "simulated", "options": {}},
    "kuka-rsi": {"driver": "kuka_rsi", "options": {"bind": "127.0.0.1", "port": 49152, "cycle_ms": 12}},
    "kuka-eki": {"driver": "kuka-eki", "options": {"address": "127.0.0.1", "port": 54610, "tool": 1, "base": 0, "mode": "any"}},
}
# Two places of the artefact where none stood in the calibration, seen from 25 sides each.
PLACES = (("n1", [680, 60, 60], [10, 5, 0]), ("n2", [560, -260, 180], [-25, 0, 10]))


def new_places(folder: Path, driver: str) -> Path:
    """The plan with 50 new places, for a driver."""
    plan: dict[str, Any] = yaml.safe_load((ROOT / "plans" / "seeing.yaml").read_text())
    plan["name"], plan["robot"] = "new places", plan["robot"] | DRIVERS[driver]
    plan["robot"]["model"] = str(ROOT / "plans" / plan["robot"]["model"])
    plan["artefacts"] = [str(ROOT / "plans" / plan["artefacts"][0])]
    plan["sensors"], plan["exposures"] = [], 1
    plan["stations"] = [
        {"id": name, "artefact": "mbc", "pose_in_base": {"translation_mm": xyz, "abc_deg": abc}} for name, xyz, abc in PLACES
    ]
    rng = np.random.default_rng(3)
    views = [
        {"tilt_deg": float(rng.uniform(3, 24)), "azimuth_deg": float(rng.uniform(0, 360)), "roll_deg": float(rng.uniform(0, 90))}
        for _ in range(25)
    ]
    rounded = [{key: round(value, 1) for key, value in view.items()} for view in views]
    plan["steps"] = [{"name": "new places", "phase": "position", "do": "look", "stations": [n for n, *_ in PLACES], "views": rounded}]
    plan["fake"] = {"hidden": HIDDEN}
    path = folder / f"{driver}.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False))
    return path


def learn(folder: Path) -> tuple[Path, Path]:
    """result.json of the geometry alone and of that with what the diagnosis found."""
    loaded = mbcacq.load_plan(ROOT / "plans" / "seeing.yaml")
    recorded, _ = observe(loaded, expand(loaded), Scenario(0, "two", SEED, (), SEED, 1.0), HIDDEN)
    geometry = mbcacq.calibrate(recorded)
    better = geometry.with_effects(mbcacq.diagnose(recorded))
    out = []
    for name, cell in (("geometry", geometry), ("effects", better)):
        out.append(folder / f"{name}.json")
        out[-1].write_text(sealed_text(cell.to_dict() | {"simulated": True}))
    return out[0], out[1]


def true_flange(loaded: LoadedPlan, q: np.ndarray, arrivals: int) -> np.ndarray:
    """(P, 4, 4): the world's own flange at reported joint angles q (P, n), with all that it conceals and one draw of repeatability."""
    facts = replace(from_cell(loaded.cell, loaded.plan.scanner.field_of_view), planned_q=q, pace_s=4.0)
    world = make_world(facts, parse({"hidden": HIDDEN}), SEED)
    number = np.arange(len(q))
    station = np.zeros(len(q), dtype=int)
    still = np.zeros_like(q)
    at = world.moments(q, still, still, number + arrivals, 4.0 * number, station, facts.station_artefact[station])
    moved = world.displaced(at)
    return world.scanner_pose(at, moved) @ np.linalg.inv(world.hand_eye)


def missed(there: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """(P,) mm between flanges and places, base and tool adjusted."""
    base, tool, weight = np.zeros(6), np.zeros(6), np.tile([1, 1, 1, 300, 300, 300], len(goals))
    for _ in range(6):
        now = se3.exp(base) @ there @ se3.exp(tool)
        local = se3.inverse(now) @ goals
        left = np.concatenate([local[:, :3, 3], se3.rotation_log(local[:, :3, :3])], axis=1).reshape(-1)
        A = np.concatenate([se3.adjoint(se3.inverse(now)), np.tile(np.eye(6), (len(now), 1, 1))], axis=2).reshape(-1, 12)
        step = np.linalg.lstsq(A * weight[:, None], left * weight)[0]
        base, tool = base + step[:6], tool + step[6:]
    return np.linalg.norm((se3.exp(base) @ there @ se3.exp(tool))[:, :3, 3] - goals[:, :3, 3], axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--drivers", default="simulated,kuka-rsi,kuka-eki")
    parser.add_argument("--out", type=Path, default=Path("runs") / "corrected-benchmark")
    parser.add_argument("--targets", default="nominal,geometry,effects")
    parser.add_argument("--model-only", action="store_true", help="Without driving: the true flange at the targets themselves.")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    results = given.out / "geometry.json", given.out / "effects.json"
    if not all(r.exists() for r in results):
        learn(given.out)
    print("| driver | targets | rms / µm | median | largest | as the scanner measures it, before → after / µm |\n|---|---|--:|--:|--:|---|")
    for driver in given.drivers.split(","):
        loaded = mbcacq.load_plan(new_places(given.out, driver))
        poses = expand(loaded)
        goals = loaded.cell.robot.chain.flange(np.array([p.q for p in poses]))
        for name in given.targets.split(","):
            result, measured = {"nominal": None, "geometry": results[0], "effects": results[1]}[name], ""
            if given.model_only:
                q = np.array([p.q for p in poses]) if result is None else corrected_targets(loaded, poses, result, True).corrected
            else:
                folder = given.out / f"{driver}-{name}"
                if not (folder / "result.json").exists():
                    mbcacq.run(loaded, dry_run=True, seed=SEED, out=folder, corrected=result)
                obs = mbcacq.load_observations(folder)
                q = obs.q
                improved = json.loads((folder / "result.json").read_text()).get("arm_improved")
                if improved:
                    measured = f"{1e3 * improved['before']['rms_mm']:.0f} → {1e3 * improved['after']['rms_mm']:.1f}"
            mm = 1e3 * missed(true_flange(loaded, q, 0), goals)
            row = f"| {driver} | {name} | {np.sqrt(np.mean(mm**2)):.1f} | {np.median(mm):.1f} | {mm.max():.1f} | {measured} |"
            print(row, flush=True)
        again = np.linalg.norm((true_flange(loaded, q, 0) - true_flange(loaded, q, 1000))[:, :3, 3], axis=1) * 1e3 / np.sqrt(2)
        print(f"| {driver} | repeatability | {np.sqrt(np.mean(again**2)):.1f} | {np.median(again):.1f} | {again.max():.1f} | |")


if __name__ == "__main__":
    main()
