"""Coverage of the limits that a diagnosis states for effects which it did not find."""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from bench import HERE, PLANS, Kept, table, wilson

from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.design.simulated_observations import planned_noise, planned_state
from mbcacq.diagnosis.nonparametric.joint_model import noise_with
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.exclusion_limits import BandLimit, limits_of_bands, parameters_of, with_confounders
from mbcacq.diagnosis.output.sufficient_poses import of_fewest_coefficients
from mbcacq.diagnosis.output.upper_limit import ORDERS, LimitBand, bands
from mbcacq.diagnosis.search.bayes_factor import prior_weight
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior, first_noise, noise_prior
from mbcacq.model.computed_once import ComputedOnce
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
    unchanged = {key: value for key, value in drawn.known.items() if key == "noise" or key[0] == "independent"}  # what no residual changes
    return replace(drawn, r0=r0, r=r0 - drawn.Q @ (drawn.Q.T @ r0), known=ComputedOnce(unchanged), known_beside=ComputedOnce())


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
        stated = limits_of_bands(with_confounders(drawn, self.candidate, beside), self.candidate, [self.band])
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
    which, unit = parameters_of(candidate, limit.effect.hyper)[family.parameter]
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
    each = {(name, band): yes for (plan, name, band), yes in cases.items() if plan == "all plans" and name != "all"}
    ends = sorted(each.items(), key=lambda one: np.mean(one[1]))
    lines += ["", "Effects and bands with the least and the largest coverage:", ""]
    lines += table(["effect, all plans", *heads], [[f"{name} {band}".strip(), *rate(yes)] for (name, band), yes in (*ends[:4], *ends[-4:])])
    return "\n".join([*lines, ""])


COVERAGE = """# Coverage of the exclusion limits

**Question.** Does a recording with an effect exactly at its stated limit state a limit at least as large in 95 % of cases (93 to 97 asked)?

`python benchmarks/detection.py exclusion --write`. For every effect that it did not find, a diagnosis states a limit: 95 % of effects of
that size would have shown more. The limit holds for the order, band, moments or breakpoints that it names, and for any direction of the
coefficients. An effect as large as the limit of one recording is put into another of the same plan, in linear theory: geometry errors and
noise are drawn anew for every recording, and the noise is estimated from each. Under `explained` a further effect is in the model. Limits
are never below what one recording in six without any effect would state; these 16 % are covered, so that 95.8 % are expected."""


def exclusion(given: argparse.Namespace) -> None:
    """Coverage of the exclusion limits: recordings with an effect exactly at its stated limit.

    A draw is two recordings of the plan in linear theory: geometry errors, noise of instrument and joints. The limits of one location of
    each effect and band are computed from the first as the diagnosis does it, under noise estimated from it. Then an effect is put, exactly
    as large as that limit and anywhere in the family for which it was stated, into the second, and its limit is computed again. The limit
    should be at least as large in 95 % of the cases. Three plans, 400 draws each take some twelve minutes of a processor.
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
