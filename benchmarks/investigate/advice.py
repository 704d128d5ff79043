"""The advice of diagnoses that cannot tell, followed."""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import mbcacq
from investigate.cells import Table, mixed, names_found, outcome
from mbcacq.challenge.scenarios import NONE, Scenario, draw
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import LARGEST_STRENGTH, Gauge
from mbcacq.design.adaptive.next_plan import advised, next_plan_text
from mbcacq.diagnosis.interim import InterimEvidence, weigh
from mbcacq.errors import MbcacqError
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, expand, load, refuse_errors
from mbcacq.plan.growth import grown
from mbcacq.workflow.acquire import plan_acquisition

FEWEST, MOST = 24, 64  # poses after which a run was stopped
SHOWN = (8.0, 40.0)  # information of each effect in these poses
ROUNDS = 2


def followed_by(loaded: LoadedPlan, look: InterimEvidence, folder: Path) -> tuple[LoadedPlan | None, dict]:
    """The plan that has grown by the advice, if that runs; and what was advised."""
    chosen = advised(look, loaded)
    said = {"advised": len(chosen.poses), "visits": len(chosen.visits), "reasons": chosen.reasons[:3]}
    if not chosen.visits:
        return None, said | {"runs": None}
    file = folder / "next.yaml"
    file.write_text(next_plan_text(loaded, chosen.visits, folder, chosen.reasons), encoding="utf-8")
    try:
        before = len(expand(loaded))
        longer = grown(loaded, load(file), before)
        poses = expand(longer)
        refuse_errors(longer, poses)
        plan_acquisition(longer, poses, frozenset(range(before)), 1, "the fake cell")
    except MbcacqError as error:
        return None, said | {"runs": False, "refused": str(error)}
    return longer, said | {"runs": True}


def measured(loaded: LoadedPlan, scenario: Scenario, injected: list, first: int, planned: int) -> Observations:
    """The first poses of the plan as it was, and all by which it has grown."""
    poses = expand(loaded)
    obs, _ = observe(loaded, poses, scenario, injected, planned=poses[:planned])
    number = np.arange(obs.n_poses)
    return obs.select((number < first) | (number >= planned))


def injected_in(loaded: LoadedPlan, scenario: Scenario, first: int, information: float) -> list | None:
    """The effects of a scenario, each as strong as the first poses show by this information; None where they show one not at all."""
    gauge, out = Gauge(loaded, expand(loaded)[:first]), []
    for number, name in enumerate(scenario.names):
        one = {"name": name, "strength": 1.0, "seed": scenario.effect_seed + number}
        gain = gauge.gain(scenario, [one])
        strength = float(np.sqrt(information / max(gain, 1e-9)))
        if strength > LARGEST_STRENGTH:
            return None
        out.append({**one, "strength": strength})
    return out


def followed(loaded: LoadedPlan, scenario: Scenario, folder: Path) -> dict:
    """Row of one cell: what was said at first, what was advised, and what came out of it."""
    true, planned, rng = set(scenario.names), len(expand(loaded)), np.random.default_rng(scenario.seed)
    first, information = int(rng.integers(FEWEST, MOST + 1)), float(np.exp(rng.uniform(*np.log(SHOWN))))
    injected = injected_in(loaded, scenario, first, information)
    if injected is None:
        return {"kind": scenario.kind, "verdict": "unseen", "rounds": []}
    look = weigh(measured(loaded, scenario, injected, first, planned))
    row = {"kind": scenario.kind, "information": information, "first": first, "verdict": look.verdict, "rounds": []}
    for _ in range(ROUNDS):
        if look.verdict != "cannot_tell":
            break
        longer, said = followed_by(loaded, look, folder)
        row["rounds"].append(said)
        if longer is None:
            break
        loaded = longer
        look = weigh(measured(loaded, scenario, injected, first, planned))
        said |= {"verdict": look.verdict, "found": sorted(look.reported.labels), "outcome": outcome(look.verdict, names_found(look), true)}
    return row


def advice(given: argparse.Namespace) -> None:
    """The advice of diagnoses that cannot tell: does it run as written, and does it decide?

    Cells are recorded by the array path at the first 24 to 64 poses of a plan, as a run that was stopped early. They have effects that
    these poses show by an information of 8 to 40, about as much as a decision needs. If a look says ``cannot_tell``, the next poses are
    chosen as by ``mbcacq diagnose RUN --next next.yaml``. The plan is written, read, grown onto that of the recording and checked as
    ``mbcacq run next.yaml --extend RUN`` does, every motion of it too. Its poses are measured in the same cell and all is weighed again.
    Cells that are still open get one more piece of advice. Rows go to runs/investigate-benchmark, so that a call goes on where another
    ended; the last lines count them.
    """
    loaded = mbcacq.load_plan(given.plan)
    table = Table(f"advice-{given.plan.stem}-{given.seed}")
    with threadpool_limits(1), tempfile.TemporaryDirectory() as made:
        for scenario in draw(given.seed, 20 * given.count, [kind for kind in mixed(30 * given.count) if kind != NONE]):
            if sum(bool(row["rounds"]) for row in table.rows) >= given.count:
                break
            if scenario.number not in table.done:
                table.add_numbered(scenario.number, followed(loaded, scenario, Path(made)))
    count(table.rows)


def count(rows: list[dict]) -> None:
    """How many there were, ran as written, and were decided."""
    open_ones = [row["rounds"] for row in rows if row["rounds"]]
    runs = [r[0] for r in open_ones]
    print(f"{len(rows)} recordings, of {len(open_ones)} the diagnosis cannot tell")
    print(f"advice: {sum(r['runs'] is True for r in runs)} run as written, {sum(r['runs'] is None for r in runs)} none within reach")
    for k in range(ROUNDS):
        last = [r[: k + 1][-1] for r in open_ones]
        decided = [r for r in last if r.get("verdict", "cannot_tell") != "cannot_tell"]
        print(f"after {k + 1}: {len(decided)} decided, {dict(Counter(r['outcome'] for r in decided))}")
