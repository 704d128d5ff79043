"""Model comparison: parametric effects, random effects and noise together are one hypothesis, compared by restricted likelihood.

A mismatch makes noise look larger than it is, and large noise hides it; so random effects, their sizes and the noise are found in turns:
the best block of the evidence map is added, and each is chosen anew once the noise is known without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap, MapCell
from mbcacq.diagnosis.nonparametric.joint_model import conditioned_on_effects, conditioned_on_random_effects, noise_with
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel, fit_random_effects
from mbcacq.diagnosis.nonparametric.residual_tests import STRUCTURE
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import NoisePrior, pack

MOST_GROUPS = 5
DISTORTED = 0.7  # share of a block's gain that an effect at its location has alone, if the block may be that effect
DECISIVE, RELATIVE_LEAD = 5.0, 1.1  # log posterior odds, and their ratio, by which a single block must lead over several effects
UNMODELLED = float(np.log(100.0))  # an unmodelled effect is a hundred times less likely beforehand than a parametric one


@dataclass(frozen=True)
class Hypothesis:
    """Parametric effects, cells of the map with the random effects fitted to them (None: no cells), noise. log_posterior: twice the log of
    the restricted likelihood less the Occam penalties of effects and cells.
    """

    model: EffectSet
    cells: tuple[MapCell, ...]
    smooth: RandomEffectsModel | None
    noise: Noise
    log_posterior: float


@dataclass(frozen=True)
class ComparisonProblem:
    """What hypotheses are built on. least: evidence of the map from which a further cell is added."""

    linear: LinearProblem
    design_blocks: DesignBlocks
    prior_noise: NoisePrior
    search: BeamSearch
    least: float = STRUCTURE

    def build(self, model: EffectSet, start: Noise, cells: tuple[MapCell, ...] = (), rounds: int = 4) -> Hypothesis:
        """Random effects beyond the parametric ones, until the map has no further evidence. cells: to begin with."""
        noise, smooth = start, None
        for number in range(rounds):
            projected = CandidateScoring.of(self.linear, noise)
            evidence_map, conditioned = EvidenceMap(projected, self.design_blocks), conditioned_on_effects(projected, model)
            before = cells
            if number > 0 or cells:
                cells = self._chosen_anew(evidence_map, conditioned, cells)
            cells, smooth = self._grown(evidence_map, conditioned, cells)
            new = noise_with(self.linear, model, smooth, noise, self.prior_noise)
            same = [(c.location, c.rows, c.depends_on) for c in cells] == [(c.location, c.rows, c.depends_on) for c in before]
            steady = nearly_equal(new, noise)
            noise = new
            if not cells or same or (steady and number > 0):
                break
        model = self.search.solved(CandidateScoring.of(self.linear, noise), model.effects)
        return Hypothesis(model, cells, smooth, noise, self.log_posterior(model, cells, smooth, noise))

    def _chosen_anew(self, evidence_map: EvidenceMap, conditioned: CandidateScoring, cells: tuple[MapCell, ...]) -> tuple[MapCell, ...]:
        """Each cell in turn replaced by the best one beyond the others."""
        for j in range(len(cells)):
            others = fitted(evidence_map, conditioned, cells[:j] + cells[j + 1 :])
            evidence = evidence_map.evaluate(conditioned_on_random_effects(conditioned, others))
            cells = (*cells[:j], evidence.best(), *cells[j + 1 :])
        return cells

    def _grown(
        self, evidence_map: EvidenceMap, conditioned: CandidateScoring, cells: tuple[MapCell, ...]
    ) -> tuple[tuple[MapCell, ...], RandomEffectsModel | None]:
        smooth = fitted(evidence_map, conditioned, cells)
        while len(cells) < MOST_GROUPS:
            evidence = evidence_map.evaluate(conditioned_on_random_effects(conditioned, smooth))
            if evidence.total < self.least:
                break
            cells = (*cells, evidence.best())
            smooth = fitted(evidence_map, conditioned, cells)
        return cells, smooth

    def log_posterior(self, model: EffectSet, cells: tuple[MapCell, ...], smooth: RandomEffectsModel | None, noise: Noise) -> float:
        """Twice the log of the posterior probability of a hypothesis, up to a constant."""
        projected = CandidateScoring.of(self.linear, noise)
        conditioned = conditioned_on_effects(projected, model)
        value = log_restricted_likelihood(projected, conditioned_on_random_effects(conditioned, smooth), self.prior_noise)
        if smooth is not None:
            X = projected.whiten(smooth.columns) * smooth.sigma
            absorbed = conditioned.all_projected.T @ X
            value -= float(np.linalg.slogdet(X.T @ X - absorbed.T @ absorbed + np.eye(X.shape[1]))[1])
        penalty = model.gain - model.log_posterior_odds
        return value - penalty - 2 * sum(c.log_bayes_factor - c.log_posterior + UNMODELLED for c in cells)


def log_restricted_likelihood(projected: CandidateScoring, conditioned: CandidateScoring, prior_noise: NoisePrior) -> float:
    """Twice the log of the restricted likelihood of a noise with its prior, up to a constant.

    conditioned: the problem conditioned on the effects of the model, of whose coefficients no determinant is counted.
    """
    return -projected.whiten.log_det - projected.log_det - conditioned.chi2 + 2 * prior_noise.log_density(projected.noise)


def single_block_more_probable(projected: CandidateScoring, design_blocks: DesignBlocks, model: EffectSet) -> bool:
    """Whether a single block of the map is plainly more probable than a set of effects: they describe one unmodelled effect together, and
    it is better to look for parametric effects beyond that.

    A block at the location of one of them that follows the same covariate, and gains little more, may be that very effect, distorted
    because it is large.
    """
    best = EvidenceMap(projected, design_blocks).evaluate(projected).best()
    same = [e for e in model.effects if best.location in e[0].where and best.depends_on == e[0].depends_on]
    return leads_plainly(best, model, max((projected.test(*e).gain for e in same), default=-np.inf))


def leads_plainly(block: MapCell, model: EffectSet, gain_there: float) -> bool:
    """gain_there: of the effect at the block's location that follows the same covariate, fitted alone."""
    if gain_there > DISTORTED * block.gain:
        return False
    return block.log_posterior - UNMODELLED - DECISIVE > 0.5 * RELATIVE_LEAD * model.log_posterior_odds


def nearly_equal(a: Noise, b: Noise) -> bool:
    return bool(np.all(np.abs(pack(a) - pack(b)) < 0.05))


def fitted(evidence_map: EvidenceMap, conditioned: CandidateScoring, cells: tuple[MapCell, ...]) -> RandomEffectsModel | None:
    return fit_random_effects(conditioned, [evidence_map.random_effect(c) for c in cells]) if cells else None


def most_probable_hypothesis(problem: ComparisonProblem, model: EffectSet, start: Noise, plain: Noise) -> Hypothesis:
    """The most probable of parametric effects with random effects beyond them, random effects alone, and effects found beyond those.

    start: noise with the parametric effects in place; plain: with geometry alone.
    """
    best = problem.build(model, start)
    if model.effects:
        best = more_probable(best, problem.build(NO_EFFECTS, plain))
        for name in model.names if len(model.names) > 1 and not best.model.effects else ():  # one of them may be true
            only = EffectSet(tuple(e for e in model.effects if e[0].name == name))
            best = more_probable(best, problem.build(only, plain))
    if best.smooth is not None:
        nuisance = best.smooth.columns, best.smooth.sigma
        found = problem.search.run(CandidateScoring.of(problem.linear, best.noise, nuisance))
        if {c.key for c, _ in found.effects} != {c.key for c, _ in best.model.effects}:
            best = more_probable(best, problem.build(EffectSet(found.effects), best.noise, best.cells, 2))
        for name in best.model.names if len(best.model.names) > 1 else ():
            best = more_probable(best, problem.build(best.model.without((name,)), best.noise, best.cells, 2))
    return best


def more_probable(a: Hypothesis, b: Hypothesis) -> Hypothesis:
    return b if b.log_posterior > a.log_posterior else a
