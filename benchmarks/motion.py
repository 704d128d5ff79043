"""An arm in motion: challenges and their score, a motion designed to tell two effects apart, runs with it, models of MuJoCo, the KR 300.

    python benchmarks/motion.py score --challenges 100 --jobs 2 --json trajectories.json
    OMP_NUM_THREADS=1 python benchmarks/motion.py excitation --write
    python benchmarks/motion.py figures ../shared/data/kr300-trajectory-a ../shared/data/kr300-trajectory-b --out docs/data
    OMP_NUM_THREADS=1 python benchmarks/motion.py concealed --write
    OMP_NUM_THREADS=1 python benchmarks/motion.py concealed --tools 12 --short 0
    python benchmarks/motion.py mujoco --write

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter
from typing import Any

import bench
import numpy as np
from bench import HERE, PLANS, curve, keeps, line, option, svg, text, writes
from mbcacq_fakes.dynamics.recorded import recorded
from motion.mujoco_models import mujoco_models
from motion.run_and_motion import concealed
from motion_challenge import MotionChallengeResult, draw, run_challenge

from mbcacq.design.excitation import Excitation, FourierMotion, at_rest, design_excitation
from mbcacq.diagnosis.motion.diagnose import Recordings, diagnose_trajectories
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.model import shipped
from mbcacq.model.trajectory import Trajectory
from mbcacq.plan import LoadedPlan, load
from mbcacq.quantities import significant
from mbcacq.recording.datasets.trajectory_set import read_trajectory_set

WITHIN = 3.0


def one_challenge(number: int) -> MotionChallengeResult:
    return run_challenge(draw(number), shipped.robot("kr10_r1100_2"), recorded)


def score_table(results: list[MotionChallengeResult]) -> dict:
    detectable = [r for r in results if any(r.detectable)]
    clean = [r for r in results if not r.truth]
    sigmas = [v for r in results for v in r.score.sigmas.values()]
    by_name: dict[str, list[int]] = {}
    for r in results:
        for t, m in zip(r.truth, r.detectable, strict=True):
            if m:
                row = by_name.setdefault(t["name"], [0, 0])
                row[0] += f"{t['name']}:{'+'.join(t['where'])}" in r.score.reported
                row[1] += 1
    return {
        "challenges": len(results),
        "with_detectable_effects": len(detectable),
        "clean": len(clean),
        "detected": sum(r.verdict != "none" for r in detectable),
        "named_and_located_first": sum(r.score.identified for r in detectable),
        "with_a_false_name": sum(bool(r.score.false_names) for r in results),
        "clean_with_a_false_name": sum(bool(r.score.false_names) for r in clean),
        "parameters": len(sigmas),
        "parameters_within_3_sigma": sum(s <= WITHIN for s in sigmas),
        "found_by_name": by_name,
    }


def score(given: argparse.Namespace) -> None:
    """Faults of a moving arm, diagnosed blind: what is found, what is measured, what is claimed wrongly.

    Each challenge is one arm (KR 10 R1100-2) with no, one, two or three effects, recorded in two motions. The figures stand in
    benchmarks/trajectories.md.
    """
    results = []
    with ProcessPoolExecutor(given.jobs) as pool:
        for r in pool.map(one_challenge, range(given.first, given.first + given.challenges)):
            results.append(r)
            truth = ", ".join(
                f"{t['name']}:{'+'.join(t['where'])}{'' if m else ' (small)'}" for t, m in zip(r.truth, r.detectable, strict=True)
            )
            far = {k: round(v, 1) for k, v in r.score.sigmas.items() if v > WITHIN}
            ending = f"{r.verdict:<17} {truth or 'nothing'} | extra {r.score.false_names} | far {far}"
            print(f"{r.challenge.number} {'ok ' if r.score.identified else 'MISS'} {ending}", flush=True)
    print(json.dumps(score_table(results), indent=1))
    if given.json is not None:
        given.json.write_text(json.dumps([r.to_dict() for r in results], indent=1, default=float), encoding="utf-8")


SEEDS = (71, 72, 73)
SECONDS = 20.0
TRAVEL_DEG = np.array([30.0, 27.0, 20.0, 30.0, 30.0, 40.0])  # to either side of home
EFFECTS = [{"name": "gravity_compensator", "strength": 1.0}, {"name": "friction", "where": "A2", "kind": "plain"}]


def small_motion(home: np.ndarray, seed: int) -> FourierMotion:
    """About home, at random."""
    rng, falling = np.random.default_rng([seed, 5]), 1.0 / np.arange(1, 6)
    motion = at_rest(home, SECONDS, rng.normal(size=(len(home), 5)) * falling, rng.normal(size=(len(home), 5)) * falling)
    away = np.abs(motion.at(np.linspace(0.0, SECONDS, 500)) - home).max(axis=0)
    return motion.scaled(np.radians(TRAVEL_DEG[: len(home)]) / away)


def recorded_along(loaded: LoadedPlan, motion: FourierMotion, seed: int, number: int) -> Trajectory:
    """What the controller would write along a motion."""
    time = np.arange(0.0, motion.seconds, 0.004)
    r = recorded(loaded.cell.robot, EFFECTS, seed, number, planned=(time, motion.at(time)))
    return Trajectory(loaded.cell.robot, r.time_s, r.q, q_set=r.q_set, torque=r.torque)


def stored_result(found: MotionDiagnosis) -> str:
    names = [f"{e.name} at {'+'.join(e.where)}" for e in found.named_effects]
    open_ones = [f"; not separable: {' and '.join(n.effects)} (odds {n.odds:.2f})" for n in found.not_separable if n.odds is not None]
    return f"{found.verdict}: {', '.join(names) or 'nothing'}{''.join(open_ones)}"


def designed_motion(seed: int) -> dict[str, Any]:
    loaded = load(PLANS / "seeing.yaml")
    first = recorded_along(loaded, small_motion(np.radians(loaded.plan.robot.home_deg), seed), seed, 0)
    before = diagnose_trajectories([first], cross_validation=False)
    start = perf_counter()
    designed: Excitation = design_excitation(loaded, [first], SECONDS, seed)
    seconds = perf_counter() - start
    twice = [recorded_along(loaded, designed.motion, seed, number) for number in (1, 2)]
    after = diagnose_trajectories([first, *twice], cross_validation=False)
    return {
        "seed": seed,
        "before": stored_result(before),
        "after": stored_result(after),
        "seconds": seconds,
        "std": {n: (float(b), float(a)) for n, b, a in zip(designed.names, designed.before, designed.after, strict=True)},
    }


INTRODUCTION = """# A motion that tells a balancer from masses

**Question.** Does the motion that the program designs show a balancer that a small motion hides?

`python benchmarks/motion.py excitation --write`. A KR 10 (MuJoCo, the cell of `plans/seeing.yaml`) has a balancer at A2 that nobody
described, friction at A2, and masses 2 % off their description. It is recorded for 20 s over 27 deg to either side of A2's home, then twice
along the motion of `mbcacq plan design --motion`. Expected standard deviations are those that the command prints, for the recording alone
and with the motion once. No motion separates a load on the flange from the mass of the last link, only a known weight does.

| arm | diagnosed from the recording | with the motion as well | preload, N m | growth with its stretch, N m | turned, N m/rad | design, s |
|---|---|---|---|---|---|---|"""


def excitation_page(rows: list[dict[str, Any]]) -> str:
    lines = [INTRODUCTION]
    for r in rows:
        std = [f"{before:.2f} -> {after:.2f}" for name, (before, after) in r["std"].items() if name.startswith("A2.")]
        lines.append(f"| {r['seed']} | {r['before']} | {r['after']} | {' | '.join(std)} | {r['seconds']:.0f} |")
    return "\n".join([*lines, ""])


def excitation(given: argparse.Namespace) -> None:
    """A balancer that a small motion hides behind the masses of the arm, and the motion designed to show it.

    The arm (MuJoCo behind the fake drives) has a balancer at A2 that nobody described, and masses that differ from their description. It is
    recorded over 27 deg to either side of A2's home, diagnosed, then twice along the motion that ``mbcacq plan design --motion`` makes of
    that recording, and diagnosed again with all three. A model learnt on one motion must predict another. Three arms take some two minutes.
    """
    rows = []
    for seed in given.seeds:
        rows.append(designed_motion(seed))
        print(json.dumps(rows[-1]), flush=True)
    if given.write:
        (HERE / "excitation.md").write_text(excitation_page(rows), encoding="utf-8")


WIDTH, HEIGHT, LEFT, TOP = 430, 110, 56, 34
GREY, BLUE = "#bbbbbb", "#1f6fb2"
TITLES = {
    "q_joint": "Joint-side minus motor-side angle, mdeg",
    "q_set": "Actual angle minus set point, deg",
    "tau": "Torque minus rigid arm, N m",
}


def figure(kind: str, panels: list[list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]]) -> str:
    """panels[row][column] = (name, time (T,), before (T,), after (T,))."""
    rows, columns = len(panels), len(panels[0])
    out = [text(10, 18, f"{TITLES[kind]}; grey: before, blue: what the other trajectory leaves unexplained", 13)]
    for i, row in enumerate(panels):
        for j, (name, time, before, after) in enumerate(row):
            x, y = LEFT + j * (WIDTH + LEFT), TOP + i * (HEIGHT + 22)
            top = max(float(np.abs(before).max()), 1e-12)
            out += [text(x, y + 10, name), text(x - 4, y + 10, significant(top), 10, "end")]
            out.append(line(x, y + HEIGHT / 2, x + WIDTH, y + HEIGHT / 2, "#dddddd"))
            for values, colour in ((before, GREY), (after, BLUE)):
                shown = zip(time[::6], np.clip(values[::6], -top, top), strict=True)
                long = time[-1] - time[0]
                out.append(curve(((x + WIDTH * (t - time[0]) / long, y + HEIGHT / 2 * (1 - v / top)) for t, v in shown), colour))
    return svg(LEFT + columns * (WIDTH + LEFT), TOP + rows * (HEIGHT + 22) + 8, out)


def panels(folders: list[Path]) -> dict[str, list[list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]]]:
    trajectories = [read_trajectory_set(f) for f in folders]
    out: dict[str, list] = {}
    for held in range(len(trajectories)):
        for e in Recordings(trajectories).explain(held)[0]:
            scale = {"q_joint": 1e3 * np.degrees(1), "q_set": np.degrees(1)}.get(e.group.name, 1.0)
            rows = out.setdefault(e.group.name, [[] for _ in e.group.joints])
            for k, joint in enumerate(e.group.joints):
                used = e.used[k][held]
                before, after = (scale * residual[k][held][used] for residual in (e.residual_before, e.residual_after))
                if e.group.refit:
                    before, after = before - before.mean(), after - after.mean()
                time = trajectories[held].time_s[used]
                rms = " -> ".join(significant(float(values.std())) for values in (before, after))
                rows[k].append((f"A{joint + 1}, {folders[held].name}: {rms} rms", time, before, after))
    return out


def figures(given: argparse.Namespace) -> None:
    """The pictures of docs/data/kr300.md: residuals before and after, of each trajectory as predicted by the other one."""
    for kind, rows in panels(given.folders).items():
        (given.out / f"kr300-{kind}.svg").write_text(figure(kind, rows), encoding="utf-8")


if __name__ == "__main__":
    SCORE = [option("--challenges", type=int, default=100), option("--first", type=int, default=1000, help="seed of the first challenge")]
    NO_PEER = option("--no-peer", action="store_true", help="leave mujoco.sysid out")
    CELLS = [
        option("--tools", type=float, nargs="*", default=[0.0, 12.0, 25.0], help="further kilograms of the dry runs"),
        option("--seeds", type=int, default=1, help="dry runs for each tool"),
        option("--short", type=int, default=12, help="short runs of each kind"),
        option("--first", type=int, default=1, help="seed of the first run of each kind"),
    ]
    bench.main(
        __doc__,
        {
            "score": (score, [*SCORE, option("--jobs", type=int, default=1), option("--json", type=Path)]),
            "excitation": (excitation, [option("--seeds", type=int, nargs="*", default=SEEDS), writes("benchmarks/excitation.md")]),
            "figures": (figures, [option("folders", nargs="+", type=Path), option("--out", type=Path, required=True)]),
            "concealed": (concealed, [*CELLS, keeps("run_and_motion.jsonl"), writes("benchmarks/run_and_motion.md")]),
            "mujoco": (mujoco_models, [NO_PEER, writes("benchmarks/mujoco_models.md")]),
        },
    )
