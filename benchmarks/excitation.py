"""A balancer that a small motion hides behind the masses of the arm, and the motion designed to show it. Writes benchmarks/excitation.md.

    OMP_NUM_THREADS=1 python benchmarks/excitation.py --write       three arms (some two minutes)

The arm (MuJoCo behind the fake drives) has a balancer at A2 that nobody described, and masses that differ from their description. It is
recorded over 27 deg to either side of A2's home, diagnosed, then twice along the motion that ``mbcacq plan design --motion`` makes of that
recording, and diagnosed again with all three: what is learnt of a motion must be predicted by another.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from mbcacq_fakes.dynamics.recorded import recorded

from mbcacq.design.excitation import Excitation, FourierMotion, at_rest, design_excitation
from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.model.trajectory import Trajectory
from mbcacq.plan import LoadedPlan, load

HERE = Path(__file__).resolve().parent
PLAN = HERE.parent / "plans" / "seeing.yaml"
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


def recording(loaded: LoadedPlan, motion: FourierMotion, seed: int, number: int) -> Trajectory:
    """What the controller would write along a motion."""
    time = np.arange(0.0, motion.seconds, 0.004)
    r = recorded(loaded.cell.robot, EFFECTS, seed, number, planned=(time, motion.at(time)))
    return Trajectory(loaded.cell.robot, r.time_s, r.q, q_set=r.q_set, torque=r.torque)


def stored_result(found: MotionDiagnosis) -> str:
    names = [f"{e.name} at {'+'.join(e.where)}" for e in found.named_effects]
    open_ones = [f"; not told apart: {' and '.join(n.effects)} (odds {n.odds:.2f})" for n in found.not_separable if n.odds is not None]
    return f"{found.verdict}: {', '.join(names) or 'nothing'}{''.join(open_ones)}"


def measured(seed: int) -> dict[str, Any]:
    loaded = load(PLAN)
    first = recording(loaded, small_motion(np.radians(loaded.plan.robot.home_deg), seed), seed, 0)
    before = diagnose_trajectories([first], cross_validation=False)
    start = perf_counter()
    designed: Excitation = design_excitation(loaded, [first], SECONDS, seed)
    seconds = perf_counter() - start
    twice = [recording(loaded, designed.motion, seed, number) for number in (1, 2)]
    after = diagnose_trajectories([first, *twice], cross_validation=False)
    return {
        "seed": seed,
        "before": stored_result(before),
        "after": stored_result(after),
        "seconds": seconds,
        "std": {n: (float(b), float(a)) for n, b, a in zip(designed.names, designed.before, designed.after, strict=True)},
    }


INTRODUCTION = """# A motion that tells a balancer from masses

Made by `python benchmarks/excitation.py --write`. A KR 10 (MuJoCo, the cell of `plans/seeing.yaml`) with a balancer at A2 that nobody
described, friction at A2, and masses 2 % off their description, recorded for 20 s over 27 deg to either side of A2's home, then twice
along the motion of `mbcacq plan design --motion`. Expected standard deviations are those that the command prints, for the recording alone
and with the motion once. A load on the flange and the mass of the last link are separated by no motion, only by a known weight.

| arm | diagnosed from the recording | with the motion as well | preload, N m | growth with its stretch, N m | turned, N m/rad | design, s |
|---|---|---|---|---|---|---|"""


def report(rows: list[dict[str, Any]]) -> str:
    lines = [INTRODUCTION]
    for r in rows:
        std = [f"{before:.2f} -> {after:.2f}" for name, (before, after) in r["std"].items() if name.startswith("A2.")]
        lines.append(f"| {r['seed']} | {r['before']} | {r['after']} | {' | '.join(std)} | {r['seconds']:.0f} |")
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=SEEDS)
    parser.add_argument("--write", action="store_true", help="write excitation.md")
    asked = parser.parse_args()
    rows = []
    for seed in asked.seeds:
        rows.append(measured(seed))
        print(json.dumps(rows[-1]), flush=True)
    if asked.write:
        (HERE / "excitation.md").write_text(report(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
