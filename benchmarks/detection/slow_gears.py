"""Slow errors of gears: named, an alternative, below their limit, not tested, or a false statement."""

from __future__ import annotations

import argparse
import json
from time import perf_counter
from typing import Any

import numpy as np
from bench import HERE, PLANS, Kept

from detection.exclusion import NAMES
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import Gauge
from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.validation.cross_validation import CrossValidation, geometry_scores
from mbcacq.diagnosis.validation.folds import split
from mbcacq.diagnosis.verdict import conclude
from mbcacq.model.observations import Observations
from mbcacq.plan import expand, load

NAME = "gear_transmission_error"
BARELY = 30.0  # chi2 that an effect of unknown place adds where it is barely found
LARGEST_DEG = 0.05  # of an error; a larger one is no gear's
SAID = ("named", "alternative", "limit holds", "not tested", "false limit", "other name")


def diagnosed(observations: Observations) -> Diagnosis:
    """The diagnosis without its cross-validation."""
    problem = prepare(observations)
    full = fit_model(problem)
    fold, how = split(full.geometry_only.linear, 4)
    plain = geometry_scores(full, [fold == k for k in range(int(fold.max()) + 1)])
    return conclude(problem, full, CrossValidation(plain, plain, how, {}))


def said_of(found: Diagnosis, joint: str, order: float, amplitude_deg: float) -> str:
    """What a diagnosis says of the concealed error: one of SAID."""
    for effect in found.effects:
        if effect.name == NAME and joint in effect.where and near(effect.parameters, joint, order):
            return "named"
        if effect.name == "unknown" and joint in (*effect.where, *effect.equivalent):
            return "named"  # at its location, in a more general form
    labels = {label for pair in found.not_separable for both in pair.effects for label in both.split(" and ")}
    labels |= {f"{a.name}:{where}" for e in found.effects for a in e.alternatives if (a.odds or 0.0) > 0.05 for where in a.where}
    if f"{NAME}:{joint}" in labels or f"unknown:{joint}" in labels:
        return "alternative"
    if any(e.name != NAME and joint in e.where for e in found.effects):
        return "other name"
    stated = [e for e in found.exclusion_limits if e.name == NAME and e.where == (joint,) and holds(e, order)]
    tested = [e.value for e in stated if e.value is not None and getattr(e, "tested", True)]
    if not tested:
        return "not tested"
    return "limit holds" if amplitude_deg <= max(tested) else "false limit"


def near(parameters: Any, joint: str, order: float) -> bool:
    """Whether one of the reported orders is the true one, within three of its standard deviations or a tenth."""
    reported = parameters[f"{joint}.order"]
    pairs = zip(np.atleast_1d(reported.value), np.atleast_1d(reported.std), strict=True)
    return any(abs(value - order) < max(3 * std, 0.1) for value, std in pairs)


def holds(limit: Any, order: float) -> bool:
    """Whether a limit is stated for this order; a version without bands states it for all."""
    band = getattr(limit, "holds_for", None)
    return band is None or band.low - 0.01 <= order <= band.high + 0.01


def concealed_cell(plan: str, number: int, gauge: Gauge) -> dict[str, Any]:
    """A concealed error, and what the diagnosis says."""
    rng = np.random.default_rng([number, 141])
    joint, order = f"A{rng.integers(2, 4)}", float(rng.integers(1, 3))
    scenario = Scenario(number, NAME, int(rng.integers(1, 2**31)), (NAME,), number, 0.0)
    one = {"name": NAME, "seed": number, "where": joint, "order": order, "phase_deg": float(rng.uniform(-180, 180)), "amplitude_deg": 0.01}
    times = float(np.exp(rng.uniform(np.log(0.5), np.log(5.0))))
    gain = gain_of(gauge, scenario, one)
    one["amplitude_deg"] = min(0.01 * times * np.sqrt(BARELY / gain), LARGEST_DEG)
    observations, _ = observe(gauge.loaded, gauge.poses, scenario, [one])
    start = perf_counter()
    found = diagnosed(observations)
    return {
        "plan": plan,
        "cell": number,
        "joint": joint,
        "order": order,
        "amplitude_deg": one["amplitude_deg"],
        "times_detectable": times,
        "verdict": found.verdict,
        "effects": [f"{e.name}:{'+'.join(e.where)}" for e in found.effects],
        "said": said_of(found, joint, order, one["amplitude_deg"]),
        "seconds": perf_counter() - start,
    }


def gain_of(gauge: Gauge, scenario: Scenario, one: dict[str, Any]) -> float:
    """chi2 that the error adds beyond what geometry absorbs."""
    with_it, _ = observe(gauge.loaded, gauge.poses, scenario, [one])
    without, _ = observe(gauge.loaded, gauge.poses, scenario, [{**one, "amplitude_deg": 0.0}])
    moved = gauge.screen.whiten(with_it.xyz - without.xyz)
    taken = gauge.screen.Q.T @ moved
    return max(float(moved @ moved - taken @ taken), 1e-9)


def slow_gears_page(kept: list[dict[str, Any]]) -> str:
    lines = [SLOW_GEARS, "", f"| plan | cells | {' | '.join(SAID)} | false, % |", "|---" * (len(SAID) + 3) + "|"]
    for plan in (*(p for p in NAMES if any(r["plan"] == p for r in kept)), "all"):
        mine = [r for r in kept if plan in (r["plan"], "all")]
        counts = [sum(r["said"] == one for r in mine) for one in SAID]
        lines.append(f"| {plan} | {len(mine)} | {' | '.join(map(str, counts))} | {100 * (counts[-1] + counts[-2]) / len(mine):.1f} |")
    wrong = [r for r in kept if r["said"] in SAID[-2:]]
    if wrong:
        lines += ["", "The false ones:", "", "| plan | cell | truth | times detectable | verdict | reported |", "|---|---|---|---|---|---|"]
        for r in wrong:
            truth = f"{r['joint']}, order {r['order']:.0f}, {r['amplitude_deg']:.4f} deg"
            reported = ", ".join(r["effects"])
            lines.append(f"| {r['plan']} | {r['cell']} | {truth} | {r['times_detectable']:.1f} | {r['verdict']} | {reported} |")
    return "\n".join([*lines, ""])


SLOW_GEARS = """# Slow gear errors

**Question.** What does a diagnosis say of slow gear errors, and how often is it false?

`python benchmarks/detection.py slow-gears --write`. One error of a gear of order 1 or 2 at A2 or A3 is concealed in each cell. It
is 0.5 to 5 times as large as a barely detectable one (chi2 rises by 30), and at most 0.05 deg. Such an error trades with geometry and
gravity. The diagnosis may say four things. The effect is *named* (or an unmodelled effect is, at the same joint). It is an *alternative*
that is not excluded. The *limit* stated for its order *holds*. Its order was *not tested* by these poses. False are a *limit* below the
truth and *another name* at the same joint with the truth excluded; asked: not more than 5 %."""


def slow_gears(given: argparse.Namespace) -> None:
    """Slow gear errors concealed at A2 and A3: what the diagnosis says of them, and whether it is true.

    Each cell has one error of order 1 or 2, 0.5 to 5 times as large as what is barely detectable there. The search is the diagnosis'
    own; the cross-validation, on which no verdict depends, is left out. Three plans, 24 cells each take some twenty minutes.
    """
    kept = Kept(given.kept)
    for plan in given.plans:
        done = {r["cell"] for r in kept.rows if r["plan"] == plan}
        todo = [n for n in range(given.first, given.first + given.cells) if n not in done]
        if not todo:
            continue
        loaded = load(PLANS / f"{plan}.yaml")
        gauge = Gauge(loaded, expand(loaded))
        for number in todo:
            kept.add(concealed_cell(plan, number, gauge))
            print(json.dumps(kept.rows[-1]), flush=True)
    if given.write:
        (HERE / "slow_gear_errors.md").write_text(slow_gears_page(kept.rows), encoding="utf-8")
