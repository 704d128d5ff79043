"""What has no name, found: groups of the map adopted one after the other, each weighed anew once the noise is known without it.

A mismatch makes noise look larger than it is, and large noise hides it; so groups, their sizes and the noise are found in turns. Whole
hypotheses (names, groups and noise together) are compared by their restricted likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.linearized import variance_components
from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.nonparametric import random_effects
from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.nonparametric.evidence_atlas import EvidenceMap, MapCell
from mbcacq.diagnosis.nonparametric.joint_model import adopted, columns_of, with_members
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.nonparametric.residual_tests import STRUCTURE
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NOTHING, EffectSet

MOST_GROUPS = 5
BENT = 0.7  # share of a group's gain that a name at its place has alone, if the group may be that name
PLAINLY, AHEAD = 5.0, 1.1  # log of a ratio of probabilities, and share of it, by which a single group must be ahead of many names
NAMELESS = float(np.log(100.0))  # what has no name is a hundred times less likely beforehand than what has one


@dataclass(frozen=True)
class Hypothesis:
    """Named members, groups with their fitted sizes (None: no groups), noise. score: twice the log of the restricted likelihood, less what
    members and groups cost for having been picked. last: evidence of the best further group (log ratio of the whole map).
    """

    model: EffectSet
    cells: tuple[MapCell, ...]
    smooth: RandomEffectsModel | None
    noise: NoiseEstimate
    score: float


@dataclass(frozen=True)
class ComparisonProblem:
    """What hypotheses are built on. first: prior of the noise. least: evidence of the map from which a further group is adopted."""

    linear: LinearProblem
    chart: DesignBlocks
    first: NoiseEstimate
    search: BeamSearch
    least: float = STRUCTURE

    def build(self, names: EffectSet, start: NoiseEstimate, cells: tuple[MapCell, ...] = (), rounds: int = 4) -> Hypothesis:
        """Groups beyond the names, until nothing is left that the map sees. cells: groups to begin with."""
        sigma, rest = start, None
        for turn in range(rounds):
            screen = CandidateScoring(self.linear, sigma)
            atlas, named = EvidenceMap(screen, self.chart), with_members(screen, names)
            before = cells
            if turn > 0 or cells:
                cells = self._chosen_anew(atlas, named, cells)
            cells, rest = self._grown(atlas, named, cells)
            new = self.noise_of(names, rest, sigma)
            same = [(c.at, c.rows, c.depends_on) for c in cells] == [(c.at, c.rows, c.depends_on) for c in before]
            steady = near(new, sigma)
            sigma = new
            if not cells or same or (steady and turn > 0):
                break
        names = self.search.solve(CandidateScoring(self.linear, sigma), names.members, permit=True)
        return Hypothesis(names, cells, rest, sigma, self.score(names, cells, rest, sigma))

    def _chosen_anew(self, atlas: EvidenceMap, named: CandidateScoring, cells: tuple[MapCell, ...]) -> tuple[MapCell, ...]:
        """Each group in turn put to the choice again, beside the others."""
        for j in range(len(cells)):
            others = cells[:j] + cells[j + 1 :]
            judged = atlas.judge(adopted(named, fitted(atlas, named, others)))
            cells = (*cells[:j], judged.best(), *cells[j + 1 :])
        return cells

    def _grown(
        self, atlas: EvidenceMap, named: CandidateScoring, cells: tuple[MapCell, ...]
    ) -> tuple[tuple[MapCell, ...], RandomEffectsModel | None]:
        rest = fitted(atlas, named, cells)
        while len(cells) < MOST_GROUPS:
            judged = atlas.judge(adopted(named, rest))
            if judged.total < self.least:
                break
            cells = (*cells, judged.best())
            rest = fitted(atlas, named, cells)
        return cells, rest

    def noise_of(self, names: EffectSet, rest: RandomEffectsModel | None, start: NoiseEstimate) -> NoiseEstimate:
        return variance_components.estimate(self.linear, *columns_of(self.linear, names, rest), start, self.first)

    def score(self, names: EffectSet, cells: tuple[MapCell, ...], rest: RandomEffectsModel | None, sigma: NoiseEstimate) -> float:
        screen = CandidateScoring(self.linear, sigma)
        named = with_members(screen, names)
        value = likelihood(screen, adopted(named, rest), self.first)
        if rest is not None:
            X = screen.whiten(rest.columns) * rest.sigma
            taken = named.all_projected.T @ X
            value -= float(np.linalg.slogdet(X.T @ X - taken.T @ taken + np.eye(X.shape[1]))[1])
        return value - (names.gain - names.worth) - 2 * sum(c.log_ratio - c.weighed + NAMELESS for c in cells)


def likelihood(screen: CandidateScoring, adopted: CandidateScoring, first: NoiseEstimate) -> float:
    """Twice the log of the restricted likelihood of a noise, less what the coefficients of whatever is adopted cost. first: its prior."""
    return -screen.whiten.log_det - screen.log_det - adopted.chi2 + 2 * variance_components.log_prior(screen.noise, first, screen.linear)


def overshadowed(screen: CandidateScoring, chart: DesignBlocks, names: EffectSet) -> bool:
    """Whether a single group of the map is plainly more probable than a set of names: they are strung together in place of one thing
    without a name, and it is better to look for names beyond that.

    A group at the place of one of them that follows the same variable, and gains little more, may be that very effect, bent because it
    is large.
    """
    best = EvidenceMap(screen, chart).judge(screen).best()
    same = [m for m in names.members if best.at in m[0].where and best.depends_on == m[0].depends_on]
    if any(screen.test(*m).gain > BENT * best.gain for m in same):
        return False
    return best.weighed - NAMELESS - PLAINLY > 0.5 * AHEAD * names.worth


def near(a: NoiseEstimate, b: NoiseEstimate) -> bool:
    return bool(np.all(np.abs(np.log(variance_components.pack(a, False) / variance_components.pack(b, False))) < 0.05))


def fitted(atlas: EvidenceMap, named: CandidateScoring, cells: tuple[MapCell, ...]) -> RandomEffectsModel | None:
    return random_effects.fit(named, [atlas.group(c) for c in cells]) if cells else None


def contest(ground: ComparisonProblem, names: EffectSet, start: NoiseEstimate, plain: NoiseEstimate) -> Hypothesis:
    """Names with groups beyond them, groups without names, names found beyond groups: what is most probable.

    start: noise with the names in place; plain: with geometry alone.
    """
    best = ground.build(names, start)
    if names.members:
        best = better(best, ground.build(NOTHING, plain))
        for name in names.names if len(names.names) > 1 and not best.model.members else ():  # one of them may be true
            only = EffectSet(tuple(m for m in names.members if m[0].name == name))
            best = better(best, ground.build(only, plain))
    if best.smooth is not None:
        beside = best.smooth.columns, best.smooth.sigma
        found = ground.search.run(CandidateScoring(ground.linear, best.noise, beside))
        if {c.key for c, _ in found.members} != {c.key for c, _ in best.model.members}:
            best = better(best, ground.build(EffectSet(found.members), best.noise, best.cells, 2))
        for name in best.model.names if len(best.model.names) > 1 else ():
            best = better(best, ground.build(best.model.without((name,)), best.noise, best.cells, 2))
    return best


def better(a: Hypothesis, b: Hypothesis) -> Hypothesis:
    return b if b.score > a.score else a
