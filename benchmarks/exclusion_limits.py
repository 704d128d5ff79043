"""Coverage of the exclusion limits: recordings with an effect exactly at its stated limit. Writes benchmarks/exclusion_limits.md.

    OMP_NUM_THREADS=1 python benchmarks/exclusion_limits.py --write               three plans, 100 draws each (some eight minutes)
    OMP_NUM_THREADS=1 python benchmarks/exclusion_limits.py --plans seeing --draws 10

A draw is a recording of the plan in linear theory: geometry errors, noise of instrument and joints. Every candidate's limit is computed as
the diagnosis does it, under noise estimated from that draw. Then the effect is put, exactly as large as that limit, into the next draw, and
its limit is computed again: it should be at least as large in 95 % of the cases. Every draw is added to exclusion_limits.jsonl at once.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.design.simulated_observations import planned_noise, planned_state
from mbcacq.diagnosis.nonparametric.joint_model import noise_with
from mbcacq.diagnosis.output.exclusion_limits import coefficient_limit, of_fewest_coefficients
from mbcacq.diagnosis.output.next_measurements import SizedEffect
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring, ProductStore
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior, first_noise, noise_prior
from mbcacq.plan import expand, load

HERE = Path(__file__).resolve().parent
PLANS = ("seeing", "kuka", "concealed")
LARGEST_NUISANCE = 0.1  # mm, rad: of what a draw's geometry is off by; stations are free, so any size would do


@dataclass(frozen=True)
class PlannedRecording:
    """A plan linearised at its nominal cell, its candidates, and its noise."""

    linear: LinearProblem
    candidates: list[Candidate]
    noise: Noise
    prior: NoisePrior
    stated: CandidateScoring

    @classmethod
    def of(cls, name: str) -> PlannedRecording:
        loaded = load(HERE.parent / "plans" / f"{name}.yaml")
        poses = expand(loaded)
        observations, _ = observe(loaded, poses, Scenario(0, "none", 1, (), 1, 0.0), [])
        linear = LinearProblem.of(observations, planned_state(loaded))
        context = Context(observations, linear.state, linear.prediction)
        candidates = of_fewest_coefficients(catalogue.candidates(context)[0])
        stated = CandidateScoring.of(linear, first_noise(observations.cell))
        return cls(linear, candidates, planned_noise(loaded, poses), noise_prior(observations.cell), stated)

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


def with_effect(drawn: CandidateScoring, candidate: Candidate, limit: SizedEffect) -> CandidateScoring:
    """The recording had it that effect, as large as a limit."""
    r0 = drawn.r0 + drawn.block(candidate, limit.hyper) @ limit.coefficients
    beyond, products = r0 - drawn.Q @ (drawn.Q.T @ r0), {}
    X, S, _ = drawn.candidate_products(candidate, limit.hyper)
    products[candidate.key, limit.hyper] = X, S, X.T @ beyond
    return replace(drawn, r0=r0, r=beyond, store=ProductStore(candidates=products))


def measured(planned: PlannedRecording, seed: int, stated: dict[str, SizedEffect]) -> tuple[dict[str, SizedEffect], dict[str, bool]]:
    """The limits of a draw, and whether those of the draw before cover effects as large as they are."""
    drawn, limits, covered = planned.drawn(seed), {}, {}
    for candidate in planned.candidates:
        limits[candidate.key] = coefficient_limit(drawn, candidate, planned.stated)
        before = stated.get(candidate.key)
        if before is not None and np.all(np.isfinite(before.coefficients)):
            again = coefficient_limit(with_effect(drawn, candidate, before), candidate, planned.stated)
            covered[candidate.key] = again.in_typical_sizes >= before.in_typical_sizes
    return limits, covered


def report(kept: list[dict]) -> str:
    lines = [INTRODUCTION, ""]
    for plan in PLANS:
        mine = [r for r in kept if r["plan"] == plan]
        if not mine:
            continue
        each: dict[str, list[bool]] = defaultdict(list)
        for row in mine:
            for key, yes in row["covered"].items():
                each[key].append(yes)
        total = [yes for values in each.values() for yes in values]
        kinds: dict[str, list[bool]] = defaultdict(list)
        for key, values in each.items():
            kinds[key.split(":")[0]] += values
        by_location = np.array([np.mean(v) for v in each.values()])
        # Limits of one draw are not independent; the draws are.
        by_draw = [np.mean(list(row["covered"].values())) for row in mine]
        error = float(np.std(by_draw, ddof=1) / np.sqrt(len(by_draw)))
        lines += [
            f"## {plan}",
            "",
            f"{len(mine)} draws, {len(each)} effects at their locations: **{100 * np.mean(total):.1f} %** +- {100 * error:.1f} "
            f"({len(total)} cases); by effect and location {100 * by_location.min():.0f} to {100 * by_location.max():.0f} %.",
            "",
            "| effect | locations | covered, % |",
            "|---|---|---|",
        ]
        count = {kind: sum(key.split(":")[0] == kind for key in each) for kind in kinds}
        lines += [f"| {kind} | {count[kind]} | {100 * np.mean(values):.1f} |" for kind, values in sorted(kinds.items())]
        lines.append("")
    return "\n".join(lines)


INTRODUCTION = """# Coverage of the exclusion limits

Made by `python benchmarks/exclusion_limits.py --write`. A diagnosis states, of every effect that it did not find, the largest size that the
recording does not exclude with 95 % confidence. Here an effect is put into a recording exactly as large as another recording of the same
plan states its limit, and the limit that comes out should be at least as large in 95 % of the cases (asked: 93 to 97 %). In linear theory,
with geometry errors, noise of instrument and joints drawn anew, and the noise estimated from each draw; every case that a search would have
found and reported with its size would count as covered too, and is computed here as if it had not been found."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", nargs="*", default=PLANS, choices=PLANS)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--write", action="store_true", help="write exclusion_limits.md")
    parser.add_argument("--kept", type=Path, default=HERE / "exclusion_limits.jsonl")
    asked = parser.parse_args()
    kept = [json.loads(line) for line in asked.kept.read_text(encoding="utf-8").splitlines()] if asked.kept.exists() else []
    for name in asked.plans:
        done = {r["seed"] for r in kept if r["plan"] == name}
        todo = [seed for seed in range(1, asked.draws + 1) if seed not in done]
        if not todo:
            continue
        planned = PlannedRecording.of(name)
        stated, _ = measured(planned, todo[0] - 1, {})
        for seed in todo:
            stated, covered = measured(planned, seed, stated)
            kept.append({"plan": name, "seed": seed, "covered": covered})
            with asked.kept.open("a", encoding="utf-8") as out:
                out.write(json.dumps(kept[-1]) + "\n")
        mine = [yes for r in kept if r["plan"] == name for yes in r["covered"].values()]
        print(f"{name}: {100 * np.mean(mine):.2f} % of {len(mine)}", flush=True)
    if asked.write:
        (HERE / "exclusion_limits.md").write_text(report(kept), encoding="utf-8")


if __name__ == "__main__":
    main()
