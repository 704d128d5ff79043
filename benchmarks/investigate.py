"""Concealed cells investigated blind through the array path: poses and moves to the verdict, against the fixed plan; false alarms of looks.

    python benchmarks/investigate.py cells --count 20        # cells with an effect of the catalogue, and one of four with nothing
    python benchmarks/investigate.py looks --count 20        # clean cells, a look after every eight poses: largest e-value of each
    python benchmarks/investigate.py kills --count 20        # kill -9 after a random pose, then resumed: is all as undisturbed?

Nothing that is measured once is measured anew: a block adds its poses to those of the blocks before.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "adaptive"))
import simulated_cell

import mbcacq
from mbcacq.challenge.run import with_observable_locations
from mbcacq.challenge.scenarios import NONE, Scenario, catalogued, draw
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import Gauge
from mbcacq.design.adaptive.investigation import Budget, Decision, decisions
from mbcacq.diagnosis.interim import weigh
from mbcacq.diagnosis.result import plain
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, expand, load

PLAN = Path(__file__).parents[1] / "plans" / "seeing.yaml"
BLOCK = 8


class RecordedCell:
    """A concealed cell that remembers what was measured of it."""

    def __init__(self, scenario: Scenario, injected: list):
        self.scenario, self.injected, self.measured = scenario, injected, None

    def measure(self, grown: LoadedPlan) -> Observations:
        new, truth = observe(grown, expand(grown), self.scenario, self.injected)
        self.truth, old = truth, self.measured
        if old is not None:
            P, M = old.n_poses, old.n_centres
            later = old.time_s[-1] - new.time_s[P - 1] if old.time_s is not None and new.time_s is not None else 0.0
            new = replace(
                new,
                q=np.concatenate([old.q, new.q[P:]]),
                xyz=np.concatenate([old.xyz, new.xyz[M:]]),
                time_s=np.concatenate([old.time_s, new.time_s[P:] + later]),
                temperatures={name: np.concatenate([old.temperatures[name], T[P:]]) for name, T in new.temperatures.items()},
            )
        self.measured = new
        return new


def named(decision: Decision) -> set[str]:
    """Names of the most probable set."""
    return {label.split(" at ")[0] for label in decision.sets[0][0].split(" and ")} if decision.sets else set()


def investigated(loaded: LoadedPlan, gauge: Gauge, scenario: Scenario) -> dict:
    cell = RecordedCell(scenario, gauge.inject(scenario))
    made = list(decisions(loaded, cell.measure, Budget(poses=96)))
    last, true = made[-1], [with_observable_locations(plain(e)) for e in cell.truth["effects"]]
    names = {e["name"] for e in true}
    decided = last.verdict in ("none", "explained") and not last.end.startswith("the budget")
    right = decided and (named(last) == names if names else last.verdict == "none")
    out = {
        "kind": scenario.kind,
        "poses": last.poses,
        "moves": last.moves,
        "verdict": last.verdict,
        "found": last.sets[0][0],
        "end": last.end,
    }
    return out | {
        "right": right,
        "wrong": last.verdict == "explained" and not named(last) & names,
        "alarm": any(d.log_e_value > np.log(100) for d in made),
    }


def looks(loaded: LoadedPlan, scenario: Scenario) -> float:
    """Largest log e-value of a clean recording that grows."""
    obs, _ = observe(loaded, expand(loaded), scenario, [])
    rng = np.random.default_rng(scenario.seed)
    order = rng.permutation(obs.n_poses)
    largest = -np.inf
    for n in range(24, min(obs.n_poses, 24 + 10 * BLOCK), BLOCK):
        keep = np.zeros(obs.n_poses, dtype=bool)
        keep[order[:n]] = True
        largest = max(largest, weigh(obs.select(keep)).summary.log_e_value)
    return float(largest)


def resumed_after_kill(plan: Path, folder: Path, poses: int, whole: tuple[list[Decision], Observations]) -> dict:
    """Whether an investigation that was killed after so many poses, and resumed, decided and measured what the undisturbed one did."""
    killed = subprocess.run([sys.executable, simulated_cell.__file__, str(plan), str(folder), str(poses)], capture_output=True, check=False)
    resumed = list(mbcacq.investigate(None, resume=folder, dry_run=True))
    again, (decided, obs) = mbcacq.load_observations(folder), whole
    same = [np.array_equal(getattr(again, name), getattr(obs, name)) for name in ("pose_id", "ball", "xyz", "time_s", "direction")]
    return {
        "killed_after": poses,
        "killed": killed.returncode == -signal.SIGKILL,
        "decisions": [(d.verdict, d.sets, d.steps, d.end) for d in resumed] == [(d.verdict, d.sets, d.steps, d.end) for d in decided],
        "observations": all(same),
    }


def kills(count: int, seed: int) -> None:
    """Random moments, at the poses of the first block and of the visit."""
    with tempfile.TemporaryDirectory() as made:
        plan = simulated_cell.simulated_plan(Path(made), "concealed.yaml")
        decided = list(mbcacq.investigate(plan, simulated_cell.BUDGET, out=Path(made) / "whole", dry_run=True))
        whole = decided, mbcacq.load_observations(Path(made) / "whole")
        for k, poses in enumerate(np.random.default_rng(seed).integers(1, whole[1].n_poses + 1, count).tolist()):
            print(json.dumps(resumed_after_kill(plan, Path(made) / f"killed{k}", poses, whole)), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["cells", "looks", "kills"])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=42)
    given = parser.parse_args()
    loaded = load(PLAN)
    if given.what == "kills":
        kills(given.count, given.seed)
        return
    if given.what == "looks":
        for scenario in draw(given.seed, given.count, [NONE]):
            print(json.dumps({"seed": scenario.seed, "largest_log_e_value": looks(loaded, scenario)}), flush=True)
        return
    gauge = Gauge(loaded, expand(loaded))
    kinds = list(catalogued())
    mixed = [kind for k, name in enumerate(kinds) for kind in ([name, NONE] if k % 3 == 2 else [name])]
    for scenario in draw(given.seed, given.count, mixed):
        print(json.dumps(investigated(loaded, gauge, scenario)), flush=True)


if __name__ == "__main__":
    main()
