"""Joint diagnosis of one arm on two days against that of each day alone.

    python benchmarks/joint_diagnosis.py [--pairs 30] [--write]

A fake cell conceals one effect of the arm, or none. It is recorded on two days (by arrays): another tool mount and other placements, other
temperatures, other noise, the same arm and the same effect. Each day is diagnosed alone, and both together. Printed are how often the
effect is named at its location, how often something is named that is not there, and how many of the parameters lie within three stated
standard deviations.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

import mbcacq
from mbcacq.challenge.run import with_observable_locations
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.score import Score, score
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import Gauge
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, expand

KINDS = ("joint_compliance", "none", "gear_transmission_error", "joint_scale", "none", "wrist_coupling")
CLIMATES = ({"air_C": 19.0, "warmup_K": 6.0}, {"air_C": 26.0, "warmup_K": 11.0})
WEAKEST, STRONGEST = 0.03, 0.5  # excess of chi2 per degree of freedom on one day: about where power rises from none to all
WAYS = ("first day", "second day", "both")


def day(loaded: LoadedPlan, poses: list[PlannedPose], injected: list, seed: int, climate: dict) -> tuple[Observations, list]:
    """One day's recording, and the true effects."""
    observations, truth = observe(loaded, poses, Scenario(0, "day", seed, (), 0, 0.0), injected, climate)
    return observations, [with_observable_locations(dict(effect)) for effect in truth["effects"]]


def pair(loaded: LoadedPlan, poses: list[PlannedPose], gauge: Gauge, number: int) -> tuple[str, list[Score]]:
    """The kind of effect, and the scores of the first day, the second and both."""
    rng = np.random.default_rng([41, number])
    kind = KINDS[number % len(KINDS)]
    seeds = [int(s) for s in rng.integers(1, 2**31 - 1, 3)]
    excess = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    names = () if kind == "none" else (kind,)
    injected = gauge.inject(Scenario(number, kind, seeds[0], names, seeds[2], excess))
    days = [day(loaded, poses, injected, seed, climate) for seed, climate in zip(seeds[:2], CLIMATES, strict=True)]
    truth = days[0][1]
    recordings = [observations for observations, _ in days]
    found = [mbcacq.diagnose(data, workers=1) for data in (*recordings, recordings)]
    return kind, [score(kind, truth, one.main.to_json(), 1.0) for one in found]


def table(results: list[tuple[str, list[Score]]]) -> list[str]:
    """The figures of all pairs as a table."""
    present = sum(kind != "none" for kind, _ in results)
    out = [
        f"{present} pairs with an effect, {len(results) - present} without.",
        "",
        "| diagnosed | named at its location | false names, with an effect | anything named without one | parameters within 3 sigma |",
        "|---|---|---|---|---|",
    ]
    for way, label in enumerate(WAYS):
        with_effect = [scores[way] for kind, scores in results if kind != "none"]
        without = [scores[way] for kind, scores in results if kind == "none"]
        sigmas = np.array([abs(v) for s in with_effect for v in s.sigmas.values()])
        right = f"{int((sigmas < 3).sum())} of {len(sigmas)}" if len(sigmas) else "none reported"
        named = sum(s.placed for s in with_effect)
        false = sum(bool(s.extra) for s in with_effect)
        alarms = sum(bool(s.reported) for s in without)
        out.append(f"| {label} | {named} of {len(with_effect)} | {false} | {alarms} of {len(without)} | {right} |")
    lost = Counter(kind for kind, s in results if kind != "none" and (s[0].placed or s[1].placed) and not s[2].placed)
    gained = Counter(kind for kind, s in results if kind != "none" and not (s[0].placed or s[1].placed) and s[2].placed)
    return [*out, "", f"Found by both together and by neither alone: {_words(gained)}. Found by one alone and not by both: {_words(lost)}."]


def _words(counted: Counter) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in sorted(counted.items())) or "none"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plan", type=Path, default=Path("plans/kuka-effects.yaml"))
    parser.add_argument("--poses", type=int, default=70)
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--write", action="store_true", help="put the table into benchmarks/joint_diagnosis.md")
    given = parser.parse_args()
    loaded = mbcacq.load_plan(given.plan)
    every = [p for p in expand(loaded) if p.phase != "verification"]
    keep = set(np.linspace(0, len(every) - 1, given.poses).astype(int).tolist())
    poses = [p for i, p in enumerate(every) if i in keep]
    gauge = Gauge(loaded, poses)
    results = []
    for number in range(given.pairs):
        results.append(pair(loaded, poses, gauge, number))
        kind, scores = results[-1]
        print(number, kind, *("; ".join(s.reported) or "-" for s in scores), sep=" | ", flush=True)
        if given.write:
            page = Path(__file__).with_suffix(".md")
            before, _, after = page.read_text(encoding="utf-8").partition("<!-- table -->\n")
            after = after.partition("<!-- end -->\n")[2]
            page.write_text(before + "<!-- table -->\n" + "\n".join(table(results)) + "\n<!-- end -->\n" + after, encoding="utf-8")
    print(*table(results), sep="\n")


if __name__ == "__main__":
    main()
