"""How strong an effect must be to be found, against the likelihood-ratio test that knows which effect it is, and where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import factorial
from typing import Any

import numpy as np
from likelihood_gain import best_hyper, independent_values
from scipy.optimize import brentq
from scipy.special import chdtri, chndtr, ndtr, ndtri

from mbcacq.challenge import simulated_cells
from mbcacq.challenge.oracle import true_members
from mbcacq.challenge.run import Challenger
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.score import at_location
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.hypothesis import SetPrior
from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects, noise_with
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare
from mbcacq.diagnosis.search.bayes_factor import prior_weight
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet, Member
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior
from mbcacq.model.json_text import plain
from mbcacq.model.observations import Observations

INFORMED_LEVEL = 0.01  # false-alarm rate of the informed test, which is that of the diagnosis as a whole
WANTED_POWER = 0.9  # share of the cells in which an effect has to be found


def least_gain(k: int, level: float = INFORMED_LEVEL) -> float:
    """Non-centrality at which a test of this level finds an effect of k coefficients nine times in ten."""
    limit = chdtri(k, level)
    root = brentq(lambda gain: 1.0 - chndtr(limit, k, gain) - WANTED_POWER, 1e-3, 1e4)
    return float(root)  # pyright: ignore[reportArgumentType]  # the stubs do not know that the full output was not asked for


def search_multiple(k: int, share: float, level: float) -> float:
    """Multiple of the strength for the informed test that a search over the catalogue needs, of this false-alarm rate.

    share: of that rate, given to one effect of k coefficients at one location and value of its hyper-parameter.
    """
    return float(np.sqrt(least_gain(k, level * share) / least_gain(k)))


@dataclass(frozen=True, kw_only=True)
class PowerCell:
    """One cell with one drawn effect, at several strengths.

    found: whether the diagnosis reports it. informed: whether a likelihood-ratio test finds it that knows everything but its size and
    the noise. estimating: the same for a test that knows name and location, and estimates order or moment too. log_e_values: of all
    effects, where the diagnosis reports it or would with a lower least e-value, else -inf. coefficients, share: of the true model, for
    ``search_multiple``.
    """

    found: list[bool]
    informed: list[bool]
    estimating: list[bool]
    log_e_values: list[float]
    coefficients: int
    share: float


def try_cell(challenger: Challenger, name: str, seed: int, multiples: Sequence[float]) -> PowerCell:
    """The whole diagnosis, cross-validation included, and the two tests on the same recordings, at these multiples of the strength that
    the informed test would need if it knew the noise too.

    There is one cell, with one drawn location and shape of the effect, and noise as in any challenge.
    """
    scenario = Scenario(0, name, seed, (name,), seed + 1, 1.0)
    gauge, one = challenger.gauge, {"name": name, "strength": 1.0, "seed": seed + 1}
    gain = gauge.gain(scenario, [one])
    k, share = search_space(challenger, scenario, one)
    found, informed, estimating, log_e_values = [], [], [], []
    for multiple in multiples:
        drawn = replace(scenario, seed=seed + int(1000 * multiple))
        strength = multiple * float(np.sqrt(least_gain(k) / gain))
        observations, stated = simulated_cells.observe(challenger.loaded, challenger.poses, drawn, [{**one, "strength": strength}])
        truth = plain(stated["effects"][0])
        found.append(bool(reports(diagnose(observations).to_json(), truth)))
        fit = evidence_of(observations)
        log_e_values.append(fit.log_e_value if found[-1] or not fit.significant and most_probable(fit, truth) else -np.inf)
        setup = prepare(observations)
        model = EffectSet(tuple(true_members(setup, truth)))
        informed.append(bool(likelihood_ratio(setup, model) > chdtri(k, INFORMED_LEVEL)))
        best, values = with_estimated_hypers(setup, model)
        estimating.append(bool(likelihood_ratio(setup, best) > chdtri(k, INFORMED_LEVEL / values)))
    return PowerCell(found=found, informed=informed, estimating=estimating, log_e_values=log_e_values, coefficients=k, share=share)


def evidence_of(observations: Observations) -> EvidenceFit:
    """The hypotheses that the diagnosis of a recording compares."""
    return fit_model(prepare(observations)).evidence


def most_probable(fit: EvidenceFit, truth: dict[str, Any]) -> bool:
    """Whether the most probable set of effects has the true one at its location."""
    best = next(h for h in fit.hypotheses if h.members)
    effects = ({"name": m.candidate.name, "where": list(m.candidate.where)} for m in best.members)
    return any(e["name"] == truth["name"] and at_location(e, truth) for e in effects)


def with_estimated_hypers(setup: DiagnosisProblem, model: EffectSet) -> tuple[EffectSet, float]:
    """The model with orders and moments as these data would have them, and the number of independent choices of all of them."""
    screen, members, choices = CandidateScoring.of(setup.linear, geometry_noise(setup)), list(model.members), 1.0
    for j, candidate in enumerate(m.candidate for m in model.members):
        if candidate.hyper is not None:
            others = screen.conditioned_on(
                [(screen.block(m.candidate, m.hyper), prior_weight(m.candidate)) for m in members[:j] + members[j + 1 :]]
            )
            best = best_hyper(others, candidate)
            members[j] = Member(candidate, best.hyper)
            same = sum(m.candidate.key == candidate.key for m in members[: j + 1])
            choices *= max(independent_values(candidate.hyper, best.hyper in candidate.hyper.preferred) / same, 1.0)
    return EffectSet(tuple(members)), choices


def geometry_noise(setup: DiagnosisProblem) -> Noise:
    """The noise of a model of the geometry alone."""
    return noise_with(setup.linear, NO_EFFECTS, setup.noise, setup.prior_noise)


def likelihood_ratio(setup: DiagnosisProblem, model: EffectSet) -> float:
    """Twice the log of the likelihood with the true effects over that without, each under the noise that it leaves: chi2 of k where there
    is no such effect.
    """
    linear = setup.linear
    geometry_only = CandidateScoring.of(linear, geometry_noise(setup))
    there = CandidateScoring.of(linear, noise_with(linear, model, geometry_only.noise, setup.prior_noise))
    return log_restricted_likelihood(there, conditioned_on_effects(there, model), setup.prior_noise) - log_restricted_likelihood(
        geometry_only, geometry_only, setup.prior_noise
    )


def log_restricted_likelihood(projected: CandidateScoring, conditioned: CandidateScoring, prior_noise: NoisePrior) -> float:
    """Twice the log of the restricted likelihood of a noise with its prior, up to a constant.

    conditioned: the problem conditioned on the effects of the model, of whose coefficients no determinant is counted.
    """
    return -projected.whiten.log_det - projected.log_det - conditioned.chi2 + 2 * prior_noise.log_density(projected.noise)


def reports(diagnosis: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Whether the effect is reported at its location, or as one of two that these data cannot tell apart."""
    if any(e["name"] == truth["name"] and at_location(e, truth) for e in diagnosis["effects"]):
        return True
    apart = [label.split(":") for pair in diagnosis["not_separable"] for label in pair["effects"]]
    return any(name == truth["name"] and set(where.split("+")) <= set(truth["where"]) for name, where in apart)


def search_space(challenger: Challenger, scenario: Scenario, one: dict) -> tuple[int, float]:
    """Coefficients of the true model, and its share of all that may be: all places of all effects alike, of several joints or orders their
    choices.
    """
    observations, stated = simulated_cells.observe(challenger.loaded, challenger.poses, scenario, [one])
    setup = prepare(observations)
    members = true_members(setup, plain(stated["effects"][0]))
    prior = SetPrior.of(setup.candidates, len(setup.design_blocks.locations))
    share = np.exp(prior.log_probability_of_set([m.candidate for m in members]))
    for m in members:
        if m.candidate.hyper is not None:
            share /= independent_values(m.candidate.hyper, m.hyper in m.candidate.hyper.preferred)
    return max(sum(m.candidate.k for m in members), 1), min(float(share) * factorial(len(members)), 1.0)


def ninety_percent_point(multiples: Sequence[float], found: np.ndarray) -> float:
    """The multiple at which nine in ten are found: the most likely cumulative normal through found (cells, multiples), bool."""
    rate, count = np.mean(found, axis=0, dtype=float), len(found)
    middle, width = np.meshgrid(np.linspace(0.3, 2.5, 221), np.geomspace(0.05, 0.6, 40), indexing="ij")
    p = np.clip(ndtr((np.asarray(multiples) - middle[..., None]) / width[..., None]), 1e-6, 1 - 1e-6)
    score = np.sum(count * (rate * np.log(p) + (1 - rate) * np.log(1 - p)), axis=-1)
    best = np.unravel_index(np.argmax(score), score.shape)
    return float(middle[best] + ndtri(WANTED_POWER) * width[best])


def with_interval(figure: Callable[[np.ndarray], float], cells: int, draws: int = 200) -> tuple[float, float, float]:
    """A figure of cells, given by their numbers, and its 95 % interval, from cells drawn again and again."""
    rng = np.random.default_rng(0)
    drawn = [figure(rng.integers(0, cells, cells)) for _ in range(draws)]
    return figure(np.arange(cells)), float(np.quantile(drawn, 0.025)), float(np.quantile(drawn, 0.975))
