"""Concealed cells investigated blind through the array path: poses and moves to the verdict, against the fixed plan; false alarms of looks.

    python benchmarks/investigate.py cells --count 20        # cells with an effect of the catalogue, and one of four with nothing
    python benchmarks/investigate.py looks --count 20        # clean cells, a look after every eight poses: largest e-value of each

Nothing that is measured once is measured anew: a block adds its poses to those of the blocks before.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["cells", "looks"])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=42)
    given = parser.parse_args()
    loaded = load(PLAN)
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
