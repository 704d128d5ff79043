"""A run of a heavy arm that conceals a tool, a balancer, elastic joints and backlash, in its poses and in the motion between them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from bench import HERE, Kept, table, wilson
from concealed_run import (
    BALANCER_SHARE,
    DECLARED_COM_MM,
    DECLARED_KG,
    SOFT,
    WIDTH_DEG,
    chosen_poses,
    faults,
    observed_poses,
    recorded_moves,
    tool,
)

import mbcacq
from mbcacq.plan import LoadedPlan, expand, load
from mbcacq.quantities import K
from mbcacq.workflow.diagnose_recordings import Question, diagnose_motion, diagnose_poses, with_motion

ARM = "kr210_r2700_2"
POSES = 68  # that calibrate; 32 more judge
FEW, NARROW = (26, 36), ("p1", "p4")  # poses of short runs; stations between which their motion is recorded, over 53 deg of A2
SHORT_KG = 15.0  # further load of a short run
IN_TORQUES_KG, IN_POSES_KG = 40.0, 90.0  # further loads that contradict each other
NAMED = ("payload:mount", "gravity_compensator:A2", "backlash:A4", "joint_compliance:A2", "joint_compliance:A3")


def concealed_plan(folder: Path, further_kg: float) -> Path:
    """A plan of the arm whose fake has all of it, at rest and in motion."""
    options = mbcacq.NewPlanOptions(poses=POSES)
    made = mbcacq.new_plan(ARM, "gocator-3210", "mbc-8", folder / "plan.yaml", options)
    plan = yaml.safe_load((folder / "plan.yaml").read_text(encoding="utf-8"))
    plan["robot"]["payload"] = {"mass_kg": DECLARED_KG, "com_mm": DECLARED_COM_MM.tolist()}
    at_rest, moving = faults(made.cell.robot, further_kg)
    plan["fake"] = {"hidden": at_rest, "robot": {"moving": moving}}
    path = folder / "concealed.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False), encoding="utf-8")
    return path


def label(effect: Mapping[str, Any]) -> str:
    return f"{effect['name']}:{'+'.join(effect['where'])}"


def each(effect: Mapping[str, Any]) -> list[str]:
    """``name:location`` of an effect that is reported for several joints at once."""
    return [label(effect)] if effect["name"] == "wrist_coupling" else [f"{effect['name']}:{at}" for at in effect["where"]]


def stated(effects: Sequence[Mapping[str, Any]]) -> dict[str, tuple[float, float]]:
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


def outcome(found: Mapping[str, Any]) -> dict[str, Any]:
    """What the poses alone, the motion alone and both together state."""
    both, given = found["together"], found.get("given_motion")
    best = set(both["sets"][0]["effects"]) if both["sets"] else set()
    sets = [{label(e) for e in one["effects"]} for one in given["evidence"]["sets"]] if given else []
    here = set().union(*sets) & best
    together = next((given["evidence"]["sets"][i]["effects"] for i, names in enumerate(sets) if names == here), [])
    return {
        "verdicts": [found["verdict"], found["motion"]["verdict"], both["verdict"]],
        "names": [sorted({name for e in one["effects"] if not e.get("trend") for name in each(e)}) for one in (found, found["motion"])],
        "trends": sorted({name for one in (found, found["motion"]) for e in one["effects"] if e.get("trend") for name in each(e)}),
        "together_names": sorted(best),
        "poses": stated(found["effects"]),
        "motion": stated(found["motion"]["effects"]),
        "together": stated(together),
        "open": ["|".join(pair["effects"]) for pair in (*found["not_separable"], *found["motion"]["not_separable"])],
        "decided": [pair["named"] for pair in found["decided"]],
        "contradictions": [f"{a['name']} {a['parameter']}" for a in found["agreement"] if not a["agrees"]],
    }


def measured(further_kg: float, seed: int) -> dict[str, Any]:
    """One dry run, diagnosed."""
    with TemporaryDirectory() as made:
        folder = Path(made)
        plan = concealed_plan(folder, further_kg)
        mbcacq.run(plan, dry_run=True, out=folder / "run", seed=seed)
        return {"what": "dry run", "tool_kg": further_kg, "seed": seed, **outcome(mbcacq.diagnose(folder / "run").to_dict())}


def short_run(loaded: LoadedPlan, kilograms: tuple[float, float], seed: int, count: int) -> dict[str, Any]:
    """A short run, computed without protocols and pictures, and diagnosed. kilograms: further load in the torques and in the poses."""
    poses, narrow = chosen_poses(list(expand(loaded)), seed, count, NARROW)
    at_rest, moving = faults(loaded.cell.robot, *kilograms)
    how = Question(workers=1)
    motion = diagnose_motion(recorded_moves(loaded, narrow, moving, seed), how).motion
    found = with_motion(diagnose_poses(observed_poses(loaded, poses, at_rest, seed), how), motion, how)
    return {
        "what": "short run",
        "tool_kg": kilograms[0],
        "poses_kg": kilograms[1],
        "count": count,
        "seed": seed,
        **outcome(found.to_dict()),
    }


WAYS = ("cannot tell", "right", "part", "wrong")
UNCOUNTED = ("friction", "drive_lag", "channel_latency")  # every arm has them, or they were not asked for
COLUMNS = ("joint_compliance A2", "joint_compliance A3", "backlash A4", "gravity_compensator", "payload")
UNIT = {"joint_compliance A2": 1e6, "joint_compliance A3": 1e6, "backlash A4": 1.0, "payload": 1.0}
HEADS = ["by", "A2, µrad/(N m)", "A3, µrad/(N m)", "A4 backlash, deg", "balancer", "tool, kg", "verdict"]


def shown(name: str, said: Mapping[str, tuple[float, float]]) -> str:
    if name not in said:
        return "–"
    value, std = said[name]
    return "named" if name not in UNIT else f"{UNIT[name] * value:.3g} ± {UNIT[name] * K * std:.2g}"


def three_lines(first: list[Any], r: Mapping[str, Any]) -> list[list[Any]]:
    """What the poses, the motion and both together state, a line each, behind the first columns."""
    each = enumerate(("poses", "motion", "together"))
    blank = [""] * len(first)
    return [[*(blank if j else first), by, *(shown(name, r[by]) for name in COLUMNS), r["verdicts"][j]] for j, by in each]


def truth(further_kg: float) -> dict[str, float]:
    return {"payload": tool(further_kg)[0], "backlash A4": WIDTH_DEG} | {f"joint_compliance {at}": c for at, c in SOFT.items()}


def farthest(said: Mapping[str, tuple[float, float]], further_kg: float) -> float:
    """By how many standard deviations the worst stated value is off the concealed one."""
    true = truth(further_kg)
    return max((abs(said[name][0] - true[name]) / said[name][1] for name in said if name in true), default=0.0)


def within(said: Mapping[str, tuple[float, float]], further_kg: float) -> list[bool]:
    """Whether each stated value is within its expanded uncertainty of the concealed one."""
    true = truth(further_kg)
    return [abs(said[name][0] - true[name]) <= K * said[name][1] for name in said if name in true]


def rate(yes: int, n: int) -> str:
    """'2 of 16 (3 to 36 %)'."""
    low, high = wilson(yes, max(n, 1))
    return f"{yes} of {n} ({low:.0f} to {high:.0f} %)"


def judged(r: Mapping[str, Any], which: int) -> str:
    """What the poses (0), the motion (1) or both together (2) say, in a word (``SHORT``)."""
    if r["verdicts"][which] == "cannot_tell":
        return "cannot tell"
    names = set(r["names"][which] if which < 2 else r["together_names"])
    if {name for name in names - set(NAMED) if not name.startswith(UNCOUNTED) and name not in r["trends"]}:
        return "wrong"
    return "right" if set(NAMED) <= names else "part"


def counted(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table of what is named in short runs."""
    lines = []
    for which, by in enumerate(("poses", "motion", "together")):
        said = [judged(r, which) for r in rows]
        inside = [one for r in rows for one in within(r[by], r["tool_kg"])]
        ways = [rate(said.count(way), len(rows)) if way == "wrong" else said.count(way) for way in WAYS]
        lines.append([by, *ways, rate(sum(inside), len(inside)), f"{max(farthest(r[by], r['tool_kg']) for r in rows):.1f}"])
    neither = [r for r in rows if judged(r, 0) == judged(r, 1) == "cannot tell"]
    named = [r for r in rows if "payload" in r["together"]]
    tools = sum(abs(r["together"]["payload"][0] - tool(r["tool_kg"])[0]) <= K * r["together"]["payload"][1] for r in named)
    further = sum(bool({n for n in r["together_names"] if n not in NAMED and not n.startswith(UNCOUNTED)}) for r in rows)
    return [
        *table(["by", *WAYS, "values within U", "farthest value, σ"], lines),
        "",
        f"In {len(neither)} of {len(rows)} runs neither can tell by itself. "
        f"In {sum(judged(r, 2) == 'right' for r in neither)} of these both together name all five effects, and no other but as a trend. "
        f"Together the tool is named in {len(named)} runs, in {tools} within its U. The joint set has a further effect in {further} runs.",
    ]


def page(rows: list[dict[str, Any]]) -> str:
    dry = sorted((r for r in rows if r["what"] == "dry run"), key=lambda r: (r["tool_kg"], r["seed"]))
    short = sorted((r for r in rows if r["what"] == "short run" and r["tool_kg"] == r["poses_kg"]), key=lambda r: (r["count"], r["seed"]))
    other = [r for r in rows if r["what"] == "short run" and r["tool_kg"] != r["poses_kg"]]
    parts = [PAGE, ""]
    if dry:
        lines = [line for r in dry for line in three_lines([f"{tool(r['tool_kg'])[0]:g} ({DECLARED_KG:g} declared)", r["seed"]], r)]
        parts += ["## Dry runs", "", *table(["concealed tool, kg", "seed", *HEADS], lines), ""]
    if short:
        parts += [SHORT, "", *counted(short), "", NOTES, ""]
    if other:
        found = sum(bool(r["contradictions"]) and r["verdicts"][2] == "cannot_tell" for r in other)
        false = sum(bool(r["contradictions"]) for r in short)
        where = [f"{r['count']} poses, seed {r['seed']}: {', '.join(r['contradictions'])}" for r in short if r["contradictions"]]
        parts += [
            CONTRADICTION,
            "",
            f"A contradiction is reported in {rate(found, len(other))} of such runs, and in {rate(false, len(short))} of the consistent "
            f"ones.{' The latter: ' + '; '.join(where) + '.' if where else ''}",
            "",
        ]
    return "\n".join(parts)


PAGE = f"""# Poses and motion of one run

**Question.** What do the poses, the motion between them, and both together say of the same concealed effects?

`python benchmarks/motion.py concealed --tools --short 8 --first 101 --write`. Runs of a KR 210 (`mbcacq plan new --robot {ARM}
--poses {POSES}`) conceal elastic joints (A2 {1e6 * SOFT["A2"]:g}, A3 {1e6 * SOFT["A3"]:g} µrad/(N m)), a balancer at A2 that carries
{100 * BALANCER_SHARE:g} % of the largest gravity torque, backlash of A4 ({WIDTH_DEG:g} deg), friction of all joints and a tool that is
heavier than declared, both in the poses and in the torques and joint-side angles that the controller sends."""

SHORT = f"""## Short runs

Runs of {FEW[0]} or {FEW[1]} poses, of which the motion between the poses at two stations is recorded. It is slow, and A2 turns 53 deg. The
tool is {SHORT_KG:g} kg heavier than declared ({tool(SHORT_KG)[0]:g} kg). The fakes compute the runs, without protocols and pictures.
'Right': all five effects are named and no other; 'part': some of them; 'wrong': another effect is among them, and not as a trend (friction
and delays do not count). Values of A2, A3, A4 and the tool within U (k = 2); intervals of 95 %."""

NOTES = """Poses alone name the balancer, or leave open whether A2 is elastic alone or with a balancer. If the verdict is `explained`, its
value is within U in all runs; if it is `cannot_tell`, the value is too small by up to four standard deviations, and that of A3 too large:
poses cannot tell a heavier tool from softer joints. Together with the motion both are resolved."""

CONTRADICTION = f"""## A contradiction

The same run, with a tool of {tool(IN_TORQUES_KG)[0]:g} kg in the torques and one of {tool(IN_POSES_KG)[0]:g} kg in the poses."""


def concealed(given: argparse.Namespace) -> None:
    """What the poses, the motion, and both together say of the same concealed effects.

    A dry run takes two to three minutes of a processor, a short run about one.
    """
    kept = Kept(given.kept)
    done = {(r["what"], r["tool_kg"], r.get("poses_kg"), r.get("count"), r["seed"]) for r in kept.rows}

    def add(row: dict[str, Any]) -> None:
        kept.add(row)
        print(row, flush=True)

    with TemporaryDirectory() as made:
        loaded = load(concealed_plan(Path(made), SHORT_KG))
        kinds = [(SHORT_KG, SHORT_KG, count, given.short) for count in FEW] + [(IN_TORQUES_KG, IN_POSES_KG, FEW[-1], given.short // 2)]
        for torques, poses, count, most in kinds:
            for seed in range(given.first, given.first + most):
                if ("short run", torques, poses, count, seed) not in done:
                    add(short_run(loaded, (torques, poses), seed, count))
    for kg in given.tools:
        for seed in range(given.first, given.first + given.seeds):
            if ("dry run", kg, None, None, seed) not in done:
                add(measured(kg, seed))
    if given.write:
        (HERE / "run_and_motion.md").write_text(page(kept.rows), encoding="utf-8")
    else:
        print(page(kept.rows))
