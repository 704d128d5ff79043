"""What a diagnosis says of effects that it did not find, against the truth: coverage of its exclusion limits, slow errors of gears.

    OMP_NUM_THREADS=1 python benchmarks/limits.py exclusion --write
    OMP_NUM_THREADS=1 python benchmarks/limits.py exclusion --plans seeing --draws 10
    OMP_NUM_THREADS=1 python benchmarks/limits.py slow-gears --write
    OMP_NUM_THREADS=1 python benchmarks/limits.py slow-gears --plans seeing --cells 4

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import bench
import numpy as np
from bench import HERE, PLANS, Kept, keeps, option, table, wilson, writes

from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import Gauge
from mbcacq.design.simulated_observations import planned_noise, planned_state
from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.nonparametric.joint_model import noise_with
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.exclusion_limits import BandLimit, limits_of_band, parameters_of, with_confounders
from mbcacq.diagnosis.output.limit_bands import ORDERS, LimitBand, bands
from mbcacq.diagnosis.output.sufficient_poses import of_fewest_coefficients
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring, ProductStore
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.search.projected_solve import prior_weight
from mbcacq.diagnosis.validation.cross_validation import CrossValidation, geometry_scores
from mbcacq.diagnosis.validation.folds import split
from mbcacq.diagnosis.verdict import conclude, judge
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior, first_noise, noise_prior
from mbcacq.model.observations import Observations
from mbcacq.plan import expand, load

NAMES = ("seeing", "kuka", "paper")
LARGEST_NUISANCE = 0.1  # mm, rad: of what a draw's geometry is off by; stations are free, so any size would do


@dataclass(frozen=True)
class PlannedRecording:
    """A plan linearised at its nominal cell, its candidates, and its noise."""

    linear: LinearProblem
    candidates: list[Candidate]
    noise: Noise
    prior: NoisePrior

    @classmethod
    def of(cls, name: str) -> PlannedRecording:
        loaded = load(PLANS / f"{name}.yaml")
        poses = expand(loaded)
        observations, _ = observe(loaded, poses, Scenario(0, "none", 1, (), 1, 0.0), [])
        linear = LinearProblem.of(observations, planned_state(loaded))
        context = Context(observations, linear.state, linear.prediction)
        candidates = of_fewest_coefficients(catalogue.candidates(context)[0])
        return cls(linear, candidates, planned_noise(loaded, poses), noise_prior(observations.cell))

    def drawn(self, seed: int) -> CandidateScoring:
        """A recording without any effect, under the noise that is estimated from it."""
        rng, linear = np.random.default_rng([seed, 71]), self.linear
        columns, sigma = linear.nuisance()
        residual = columns @ (np.minimum(sigma, LARGEST_NUISANCE) * rng.standard_normal(len(sigma)))
        joints = rng.standard_normal((linear.obs.n_poses, linear.obs.cell.robot.n)) * self.noise.joint
        residual = residual + np.einsum("mrn,mn->mr", linear.joint_columns, joints[linear.obs.pose])
        residual[:, :3] += self.noise.point * rng.standard_normal((len(residual), 3))
        here = linear.with_residual(residual)
        return CandidateScoring.of(here, noise_with(here, NO_EFFECTS, first_noise(linear.obs.cell), self.prior))


def with_effect(drawn: CandidateScoring, candidate: Candidate, hyper: float | None, coefficients: np.ndarray) -> CandidateScoring:
    """The recording had it that effect."""
    r0 = drawn.r0 + drawn.block(candidate, hyper) @ coefficients
    store = ProductStore(noise=drawn.store.noise, independent=drawn.store.independent)  # what no residual changes
    return replace(drawn, r0=r0, r=r0 - drawn.Q @ (drawn.Q.T @ r0), store=store)


@dataclass(frozen=True)
class Family:
    """What a limit is of: an effect, a band of its hyper-parameter, one of its parameters."""

    candidate: Candidate
    band: LimitBand
    parameter: str

    @property
    def key(self) -> str:
        """Effect, location, band and parameter."""
        return f"{self.candidate.name}:{'+'.join(self.candidate.where)}:{band_name(self.candidate, self.band)}:{self.parameter}"

    def limit(self, drawn: CandidateScoring, beside: list[Candidate]) -> BandLimit | None:
        """As a diagnosis would state it, with these effects free; None where it is not tested."""
        stated = limits_of_band(with_confounders(drawn, self.candidate, beside), self.candidate, self.band)
        one = next(limit for limit in stated if limit.parameter == self.parameter)
        return one if one.in_usual_sizes <= OPTIONS.largest_usual else None


def band_name(candidate: Candidate, band: LimitBand) -> str:
    if not candidate.periodic:
        return ""
    low = float(band.values[0] or 0.0)
    if len(band.values) == 1:
        return f"order {low:g}"
    j = int(np.searchsorted(ORDERS, low, side="right")) - 1
    return f"orders {ORDERS[j]:g} to {ORDERS[j + 1]:g}"


def families(planned: PlannedRecording) -> dict[tuple[str, str], list[Family]]:
    """(effect, band) -> at every location."""
    out: dict[tuple[str, str], list[Family]] = defaultdict(list)
    for candidate in planned.candidates:
        for band in bands(candidate):
            for parameter in parameters_of(candidate, band.values[0]):
                out[candidate.name, band_name(candidate, band)].append(Family(candidate, band, parameter))
    return out


def drawn_from(family: Family, limit: BandLimit, rng: np.random.Generator) -> tuple[float | None, np.ndarray]:
    """An effect exactly as large as a limit, anywhere in the family for which that is stated: any value of the hyper-parameter (of orders,
    between those of the grid too), any direction of the coefficients.
    """
    candidate = family.candidate
    which, unit = parameters_of(candidate, limit.hyper)[family.parameter]
    values = limit.band.values
    value = values[int(rng.integers(len(values)))]
    if candidate.periodic and value is not None:
        following = [v for v in values if v is not None and v > value]
        value = float(rng.uniform(value, following[0])) if following else value
    direction = rng.standard_normal(len(which))
    direction = np.abs(direction) if candidate.positive and candidate.k == 1 else direction
    coefficients = np.zeros(candidate.k)
    coefficients[which] = limit.value * direction / np.linalg.norm(direction) / unit * candidate.typical[which]
    return value, coefficients


def measured_draw(planned: PlannedRecording, seed: int, among: dict[tuple[str, str], list[Family]]) -> dict[str, Any]:
    """Two recordings of a plan: limits are stated from the first, and effects as large are put into the second. One location of each effect
    and band. Every other seed has a further effect, three times as large as usual, that was found and is reported.
    """
    rng = np.random.default_rng([seed, 72])
    first, second = planned.drawn(2 * seed), planned.drawn(2 * seed + 1)
    plain = [c for c in planned.candidates if c.hyper is None]
    found = plain[int(rng.integers(len(plain)))] if seed % 2 else None

    def beside_found(one: CandidateScoring) -> CandidateScoring:
        return one if found is None else one.conditioned_on([(one.block(found, None), prior_weight(found))])

    if found is not None:
        first, second = (with_effect(one, found, None, 3 * found.typical) for one in (first, second))
    others = {c.key: c for c in planned.candidates if found is None or (c.name, c.where) != (found.name, found.where)}
    covered = {}
    for each in among.values():
        family = each[int(rng.integers(len(each)))]
        stated = family.limit(beside_found(first), list(others.values())) if family.candidate.key in others else None
        if stated is None:
            continue
        there = with_effect(second, family.candidate, *drawn_from(family, stated, rng))
        again = family.limit(beside_found(there), list(others.values()))
        covered[family.key] = bool(again is None or again.value >= stated.value)
    return {"verdict": "none" if found is None else "explained", "covered": covered}


def coverage_page(kept: list[dict]) -> str:
    """Every row with its rate and Wilson's interval."""
    cases = defaultdict[tuple[str, str, str], list[bool]](list)
    for row in kept:
        for key, yes in row["covered"].items():
            name, _, band, _ = key.split(":")
            for plan in (row["plan"], "all plans"):
                cases[plan, name, band].append(yes)
                cases[plan, "all", row["verdict"]].append(yes)

    def rate(yes: list[bool]) -> list[str]:
        low, high = wilson(sum(yes), len(yes))
        return [str(len(yes)), f"{100 * np.mean(yes):.1f}", f"{low:.1f} to {high:.1f}"]

    heads = ["cases", "covered, %", "95 % interval"]
    said = [[plan, verdict, *rate(yes)] for (plan, name, verdict), yes in cases.items() if name == "all"]
    seeds = sorted(row["seed"] for row in kept)
    drawn = f"{len(kept)} pairs of recordings, seeds {seeds[0]} to {seeds[-1]}."
    lines = [COVERAGE, "", drawn, "", *table(["plan", "verdict", *heads], sorted(said))]
    for plan in ("all plans", *NAMES):
        each = [[name, band, *rate(yes)] for (one, name, band), yes in sorted(cases.items()) if one == plan and name != "all"]
        if each:
            lines += ["", f"## {plan}", "", *table(["effect", "band", *heads], each)]
    return "\n".join([*lines, ""])


COVERAGE = """# Coverage of the exclusion limits

Made by `python benchmarks/limits.py exclusion --write`. A diagnosis states, of every effect that it did not find, the size of which 95 %
would have shown more than the recording does: for an order, a band of orders, the moments or the breakpoints that it names, any of them,
and any direction of the coefficients (a phase, a direction of a shift). Here an effect is put into a recording exactly as large as another
recording of the same plan states its limit, at a value and with a direction drawn from those for which the limit is stated. The limit that
comes out should be at least as large in 95 % of the cases (asked: 93 to 97 %). In linear theory: geometry errors, noise of instrument and
joints are drawn anew for every recording, and the noise is estimated from each; under `explained` a further effect was found and is in the
model. Limits are never below what one recording in six without any effect would state, so of the cases at that least limit, 16 %, all
are covered, and 95.8 % are expected over all of them."""


def exclusion(given: argparse.Namespace) -> None:
    """Coverage of the exclusion limits: recordings with an effect exactly at its stated limit.

    A draw is two recordings of the plan in linear theory: geometry errors, noise of instrument and joints. The limits of one location of
    each effect and band are computed from the first as the diagnosis does it, under noise estimated from it. Then an effect is put,
    exactly as large as that limit and anywhere in the family for which it was stated, into the second, and its limit is computed again:
    it should be at least as large in 95 % of the cases. Three plans, 400 draws each take some twelve minutes of a processor.
    """
    kept = Kept(given.kept)
    planned = {name: PlannedRecording.of(name) for name in given.plans}
    among = {name: families(one) for name, one in planned.items()}
    done = {(r["plan"], r["seed"]) for r in kept.rows}
    for seed in range(given.first, given.first + given.draws):
        for name in given.plans:
            if (name, seed) not in done:
                kept.add({"plan": name, "seed": seed, **measured_draw(planned[name], seed, among[name])})
    if given.write:
        (HERE / "exclusion_limits.md").write_text(coverage_page(kept.rows), encoding="utf-8")


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
    return conclude(problem, judge(problem, full, CrossValidation(plain, plain, how, {})))


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
    """Whether a limit is stated for this order; of a version without bands it is stated for all."""
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

Made by `python benchmarks/limits.py slow-gears --write`. One error of a gear of order 1 or 2 at A2 or A3 is concealed in each cell, 0.5 to
5 times as large as what is barely detectable (chi2 rises by 30), at most 0.05 deg. Such an error trades with geometry and gravity.
What the diagnosis says of it: it is *named* (or an unmodelled effect is, at the same joint); it is an *alternative* that is not excluded;
the *limit* stated for its order *holds*; its order was *not tested* by these poses. False are a *limit* below the truth and *another name*
at the same joint with the truth excluded; asked: not more than 5 %.

Eight of the 24 cells 1 to 8 of each plan were false while a limit was that of a median order and a balancer as probable on a light arm as
on a heavy one: two limits below the truth, and six times a balancer in the place of the gear."""


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


if __name__ == "__main__":
    ASKED = option("--plans", nargs="*", default=NAMES, choices=NAMES)
    DRAWS = [option("--draws", type=int, default=400), option("--first", type=int, default=1, help="seed of the first draw")]
    CELLS = [option("--cells", type=int, default=24), option("--first", type=int, default=1)]
    bench.main(
        __doc__,
        {
            "exclusion": (exclusion, [ASKED, *DRAWS, keeps("exclusion_limits.jsonl"), writes("benchmarks/exclusion_limits.md")]),
            "slow-gears": (slow_gears, [ASKED, *CELLS, keeps("slow_gear_errors.jsonl"), writes("benchmarks/slow_gear_errors.md")]),
        },
    )
