"""False alarms, detection and naming over made cells of the fake world, which shares no code with the diagnosis.

    python benchmarks/diagnosis.py clean 200 | catalogue 6 | outside 6 | outliers 3   [--data FOLDER] [--seed N]

The poses and the cell are those of an observation set (by default ../shared/data/example-compliance); everything else is made anew.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mbcacq_fakes import hidden, recorded

from mbcacq.diagnosis import base_fit, finding
from mbcacq.diagnosis.conclude import verdict_of
from mbcacq.observations import Observations
from mbcacq.recording import load

DATA = Path(__file__).parents[2] / "shared" / "data" / "example-compliance"


@dataclass(frozen=True)
class Planned:
    q: np.ndarray
    station: str
    balls: tuple[int, ...]
    exposures: int = 1


def measured(template: Observations, effects: list[dict], seed: int, outliers: float = 0.0) -> tuple[Observations, dict]:
    """The plan of a recording, run in a cell of the fake world that conceals some effects."""
    cell = template.cell
    T = base_fit.start(template).T_base_station
    planned = replace(cell, stations=tuple(replace(s, T_base_station=T[i]) for i, s in enumerate(cell.stations)))
    poses = [
        Planned(
            template.q[p], cell.stations[template.station[p]].id, tuple(int(cell.ball_ids[b]) for b in template.ball[template.pose == p])
        )
        for p in range(template.n_poses)
    ]
    got = recorded.observe(planned, poses, effects, seed, outliers=outliers)
    order = np.lexsort((got.ball, got.pose))
    obs = Observations(
        cell,
        np.arange(len(got.q)),
        got.station,
        got.q,
        got.pose[order],
        got.ball[order],
        got.xyz[order],
        time_s=got.time_s,
        direction=got.direction,
        temperatures={"air_C": got.air_C, "robot_C": got.robot_C},
    )
    return obs, got.truth


def examine(obs: Observations) -> tuple[str, list[tuple[str, tuple[str, ...]]], finding.Finding]:
    found = finding.find(finding.prepare(obs))
    return verdict_of(found), [(c.name, c.where) for c, _ in found.model.members], found


def where_of(truth: dict) -> set[str]:
    for entry in truth.get("hidden", [truth]):
        if "where" in entry or "where" in entry.get("truth", {}):
            return set(entry.get("where") or entry["truth"]["where"])
    return set()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["clean", "catalogue", "outside", "outliers"])
    parser.add_argument("count", type=int)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    template, count, took = load(args.data), Counter(), []
    names = {"clean": ["none"], "catalogue": hidden.CATALOGUED, "outliers": hidden.CATALOGUED, "outside": hidden.OUTSIDE}[args.what]
    for name in [n for n in names if args.only in n]:
        tally = Counter()
        for m in range(args.count):
            rng = np.random.default_rng(args.seed + m)
            strength = float(np.exp(rng.uniform(np.log(0.4), np.log(2.0))))
            effects = [] if name == "none" else [{"name": name, "strength": strength}]
            obs, truth = measured(template, effects, args.seed + m, 0.01 if args.what == "outliers" else 0.0)
            begun = time.perf_counter()
            verdict, named, found = examine(obs)
            took.append(time.perf_counter() - begun)
            right = verdict == "none" if name == "none" else bool(named) and all(n == name for n, _ in named) and verdict == "explained"
            if args.what == "outside":
                right = verdict != "explained"
            tally["right" if right else "silent" if verdict == "none" else "wrong"] += 1
            if not right or args.what == "outside":
                spot = found.leftover.judged.best()
                print(
                    f"  {name} seed {args.seed + m} strength {strength:.2f}: {verdict} {named} left {spot.at}({spot.depends_on}) "
                    f"log evidence {spot.log_ratio:.1f} "
                    f"truth {truth_line(truth)}",
                    flush=True,
                )
        print(f"{name}: {dict(tally)}", flush=True)
        count += tally
    print(f"all: {dict(count)}, {np.mean(took):.2f} s each")


def truth_line(truth: dict) -> str:
    return str(truth.get("hidden", truth))[:160]


if __name__ == "__main__":
    main()
