"""A run of a heavy arm that conceals a tool, a balancer, elastic joints and backlash, in its poses and in the motion between them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from bench import HERE, Kept, table

import mbcacq
from mbcacq.geometry.gravity import gravity_torque, upright_angle
from mbcacq.quantities import K

ARM = "kr210_r2700_2"
POSES = 68  # that calibrate; 32 more judge
DECLARED_KG, DECLARED_COM_MM = 20.0, np.array([0.0, 0.0, 60.0])
FURTHER_COM_MM = np.array([20.0, -10.0, 80.0])  # of what hangs on the flange and is not declared
SOFT = {"A2": 5e-7, "A3": 1e-6}  # rad/(N m)
WIDTH_DEG = 0.006  # backlash of A4
BALANCER_SHARE, LEVER_RATIO, STIFFENS = 0.4, 0.25, 0.8  # of the largest gravity torque of A2; lever over column; over its stroke


def tool(further_kg: float) -> tuple[float, np.ndarray]:
    """Mass in kg and centre of gravity (3,) mm of all that hangs on the flange."""
    total = DECLARED_KG + further_kg
    return total, (DECLARED_KG * DECLARED_COM_MM + further_kg * FURTHER_COM_MM) / total


def spring_of(plan: mbcacq.LoadedPlan) -> list[float]:
    """The balancer of the moving arm: sign, ratio, stiffness (N m), length at rest and upright angle (rad), as the arm at rest has it."""
    robot = plan.cell.robot
    q = np.zeros((361, robot.n))
    q[:, 1] = np.linspace(-np.pi, np.pi, len(q))
    frames = robot.chain.frames(q)
    load = gravity_torque(robot.chain, frames, robot.mass, robot.com, DECLARED_KG, DECLARED_COM_MM, robot.gravity)[:, 1]
    up = upright_angle(robot.chain, robot.gravity)
    assert up is not None, "the second axis lies level"
    end = LEVER_RATIO * np.stack([np.sin(q[:, 1] - up), np.cos(q[:, 1] - up)], axis=1)
    rod = np.array([0.0, 1.0]) - end
    length = np.linalg.norm(rod, axis=1)
    force = 1 + STIFFENS * (length - (1 - LEVER_RATIO)) / (2 * LEVER_RATIO)
    pull = (force / length)[:, None] * rod
    torque = np.abs(end[:, 0] * pull[:, 1] - end[:, 1] * pull[:, 0])
    largest = BALANCER_SHARE * np.abs(load).max() / torque.max()
    stiffness = float(STIFFENS * largest / (2 * LEVER_RATIO))
    return [-1.0, LEVER_RATIO, stiffness, (1 - LEVER_RATIO) - 2 * LEVER_RATIO / STIFFENS, float(up + np.pi / 2)]


def concealed_plan(folder: Path, further_kg: float) -> Path:
    """A plan of the arm whose fake has all of it, at rest and in motion."""
    options = mbcacq.NewPlanOptions(poses=POSES)
    made = mbcacq.new_plan(ARM, "gocator-3210", "mbc-8", folder / "plan.yaml", options)
    plan = yaml.safe_load((folder / "plan.yaml").read_text(encoding="utf-8"))
    plan["robot"]["payload"] = {"mass_kg": DECLARED_KG, "com_mm": DECLARED_COM_MM.tolist()}
    total, com = tool(further_kg)
    soft = [{"name": "joint_compliance", "where": at, "compliance_rad_per_Nm": c} for at, c in SOFT.items()]
    balancer = {"name": "gravity_compensator", "compliance_rad_per_Nm": SOFT["A2"], "share": BALANCER_SHARE, "lever_ratio": LEVER_RATIO}
    play = {"name": "backlash", "where": "A4", "width_deg": WIDTH_DEG}
    plan["fake"] = {
        # At rest the balancer brings the elasticity of its joint with it.
        "hidden": [balancer, {"name": "payload", "mass_kg": total, "com_mm": com.tolist(), "compliance_rad_per_Nm": 0}, soft[1], play],
        "robot": {
            "moving": [
                {"name": "gravity_compensator", "spring": spring_of(made)},
                {"name": "payload", "mass_kg": further_kg, "com_mm": FURTHER_COM_MM.tolist()},
                *soft,
                play,
                *({"name": "friction", "where": f"A{j + 1}", "kind": "plain"} for j in range(made.cell.robot.n)),
            ]
        },
    }
    path = folder / "concealed.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False), encoding="utf-8")
    return path


def stated(effects: list[Mapping[str, Any]]) -> dict[str, tuple[float, float]]:
    """Label and parameter -> value and standard deviation of what the table shows."""
    wanted = {"joint_compliance": "compliance_rad_per_Nm", "payload": "mass_kg", "backlash": "width_deg", "gravity_compensator": ""}
    out: dict[str, tuple[float, float]] = {}
    for e in effects:
        if e["name"] in wanted:
            for name, p in e["parameters"].items():
                if wanted[e["name"]] and name.endswith(wanted[e["name"]]) and not isinstance(p["value"], list):
                    out[f"{e['name']} {name.partition('.')[0] if '.' in name else ''}".strip()] = (p["value"], p["std"])
            if not wanted[e["name"]]:
                out["gravity_compensator"] = (np.nan, np.nan)
    return out


def measured(further_kg: float, seed: int) -> dict[str, Any]:
    """One run, diagnosed: what the poses alone, the motion alone and both together state."""
    with TemporaryDirectory() as made:
        folder = Path(made)
        plan = concealed_plan(folder, further_kg)
        mbcacq.run(plan, dry_run=True, out=folder / "run", seed=seed)
        found = mbcacq.diagnose(folder / "run").to_dict()
    both, given = found["together"], found.get("given_motion")
    best = set(both["sets"][0]["effects"]) if both["sets"] else set()
    together = (
        next((s["effects"] for s in given["evidence"]["sets"] if {f"{e['name']}:{'+'.join(e['where'])}" for e in s["effects"]} <= best), [])
        if given
        else []
    )
    return {
        "tool_kg": further_kg,
        "seed": seed,
        "verdicts": [found["verdict"], found["motion"]["verdict"], both["verdict"]],
        "poses": stated(found["effects"]),
        "motion": stated(found["motion"]["effects"]),
        "together": stated(together),
        "contradictions": sum(not a["agrees"] for a in found["agreement"]),
    }


COLUMNS = ("joint_compliance A2", "joint_compliance A3", "backlash A4", "gravity_compensator", "payload")
UNIT = {"joint_compliance A2": 1e6, "joint_compliance A3": 1e6, "backlash A4": 1.0, "payload": 1.0}


def shown(name: str, said: Mapping[str, tuple[float, float]]) -> str:
    if name not in said:
        return "–"
    value, std = said[name]
    return "named" if name not in UNIT else f"{UNIT[name] * value:.3g} ± {UNIT[name] * K * std:.2g}"


def page(rows: list[dict[str, Any]]) -> str:
    heads = ["concealed tool, kg", "seed", "by", "A2, µrad/(N m)", "A3, µrad/(N m)", "A4 backlash, deg", "balancer", "tool, kg", "verdict"]
    lines = []
    for r in sorted(rows, key=lambda r: (r["tool_kg"], r["seed"])):
        total = tool(r["tool_kg"])[0]
        for j, by in enumerate(("poses", "motion", "together")):
            first = [f"{total:g} ({DECLARED_KG:g} declared)", r["seed"]] if j == 0 else ["", ""]
            lines.append([*first, by, *(shown(name, r[by]) for name in COLUMNS), r["verdicts"][j]])
    return "\n".join([PAGE, "", *table(heads, lines), ""])


PAGE = f"""# Poses and motion of one run

Made by `python benchmarks/motion.py concealed --write`. Dry runs of a KR 210 (`mbcacq plan new --robot {ARM} --poses
{POSES}`) conceal elastic joints (A2 {1e6 * SOFT["A2"]:g}, A3 {1e6 * SOFT["A3"]:g} µrad/(N m)), a balancer at A2 that carries
{100 * BALANCER_SHARE:g} % of the largest gravity torque, backlash of A4 ({WIDTH_DEG:g} deg), friction of all joints and a tool that is
heavier than declared, both in the poses and in the torques and joint-side angles that the controller sends. Values with U (k = 2), of what
each diagnosis names."""


def concealed(given: argparse.Namespace) -> None:
    """What the poses, the motion, and both together say of the same concealed effects.

    A run takes two to three minutes of a processor.
    """
    kept = Kept(given.kept)
    done = {(r["tool_kg"], r["seed"]) for r in kept.rows}
    for kg in given.tools:
        for seed in range(1, given.seeds + 1):
            if (kg, seed) not in done:
                kept.add(measured(kg, seed))
                print(kept.rows[-1], flush=True)
    if given.write:
        (HERE / "run_and_motion.md").write_text(page(kept.rows), encoding="utf-8")
    else:
        print(page(kept.rows))
