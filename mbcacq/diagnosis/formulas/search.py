"""Search for formulas by evidence: terms added one by one, each paying for its coefficients and for the size of the dictionary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, Member, estimated, first_order
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.unmodelled import relative_to_best_determined
from mbcacq.diagnosis.formulas import dictionary
from mbcacq.diagnosis.formulas.dictionary import DictionaryEntry
from mbcacq.diagnosis.formulas.formula import PlacedTerm, candidate
from mbcacq.diagnosis.formulas.options import OPTIONS
from mbcacq.diagnosis.nonparametric.basis_functions import Shape
from mbcacq.diagnosis.nonparametric.bayes_factor import log_bayes_factors
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.nonparametric.locations import Location
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.context import Context
from mbcacq.effects.functions import Column, evaluate

FINE, ROUNDS = 9, 3  # values of a finer grid for the order of a wave, and how often it is made finer
WORTH_A_LOOK = 6  # entries for each extension: many of the best are neighbouring orders of one wave


@dataclass(frozen=True)
class FormulaSpace:
    """The terms of one location, laid out as design blocks, which stand in the order of ``placed``."""

    context: Context
    location: Location
    per_pose: bool
    terms: list[DictionaryEntry]
    placed: list[PlacedTerm]
    log_priors: np.ndarray
    blocks: BlockGroup

    @classmethod
    def of(cls, context: Context, location: Location, located: str) -> FormulaSpace:
        """located: the covariate that the diagnosis found."""
        per_pose = location.keys[0][0] != "point"
        if per_pose:
            terms = dictionary.of_pose(context, location.joint, location.frame, located)
        else:
            terms = dictionary.of_centre(context, located)
        values, index, kept = table(context, terms, per_pose)
        shapes = [Shape(term.shape, values[:, own], np.ones(len(own))) for term, own in zip(kept, index, strict=True)]
        group = BlockGroup(location, shapes, OPTIONS.most_coefficients)
        by_shape = dict(zip(map(id, shapes), kept, strict=True))
        placed = [PlacedTerm(location, block.rows, by_shape[id(block.shape)]) for block in group.blocks]
        logs = [one.term.log_prior - np.log(len(location.variants)) for one in placed]
        return cls(context, location, per_pose, kept, placed, np.array(logs), group)


def table(context: Context, terms: Sequence[DictionaryEntry], per_pose: bool) -> tuple[np.ndarray, list[np.ndarray], list[DictionaryEntry]]:
    """(rows, f) all columns, each of unit size; which of them are each term's; the terms of which none is constant."""
    rows = context.obs.n_poses if per_pose else context.obs.n_centres
    known: dict[str, np.ndarray] = {}

    def value(name: str) -> np.ndarray:
        if name not in known:
            values = np.asarray(context.value(name), dtype=float)
            known[name] = values if per_pose or len(values) == rows and name in ("x", "y", "z") else values[context.obs.pose]
        return known[name]

    number: dict[Column, int] = {}
    columns, index, kept, seen = [], [], [], dict[bytes, Column]()
    for term in terms:
        new = [c for c in term.columns if c not in number]
        for column, values in zip(new, evaluate(tuple(new), value, rows).T, strict=True):
            size, spread = float(np.sqrt(np.mean(values**2))), float(values.std())
            if not (np.isfinite(size) and spread > 1e-9 * size > 0):
                continue
            # What varies as another column does is the same function: constants are the geometry's.
            varying = np.round((values - values.mean()) / spread, 6)
            alike = (varying * np.sign(varying[np.argmax(np.abs(varying))]) + 0.0).tobytes()
            if seen.setdefault(alike, column) == column:
                number[column] = len(columns)
                columns.append(values / size)
        if all(c in number for c in term.columns):
            index.append(np.array([number[c] for c in term.columns]))
            kept.append(term)
    return np.stack(columns, axis=1), index, kept


@dataclass(frozen=True)
class Formula:
    """Terms, and the hypothesis with them in place. log_bayes_factor: against the same hypothesis without them, prior left out."""

    placed: tuple[PlacedTerm, ...]
    hypothesis: Hypothesis
    log_prior: float
    log_bayes_factor: float

    @property
    def log_posterior(self) -> float:
        """Log posterior odds against no formula."""
        return self.log_bayes_factor + self.log_prior

    @property
    def key(self) -> frozenset[str]:
        return frozenset(p.label for p in self.placed)


class FormulaSearch:
    """Of one recording, or a part of it, under the noise of ``point``, with the other effects in place."""

    def __init__(self, point: NoisePoint, others: Sequence[Member], spaces: Sequence[FormulaSpace]):
        self.point, self.others, self.spaces = point, tuple(others), spaces
        self.maps = [EvidenceMap(point.projected, [space.blocks]) for space in spaces]

    def run(self, most_terms: int = OPTIONS.most_terms, final: bool = True) -> list[Formula]:
        """The most probable formulas, best first; final: with the noise of each estimated anew."""
        none = Formula((), first_order(self.others, self.point, 0.0), 0.0, 0.0)
        known: dict[frozenset[str], Formula] = {}
        beam = [none]
        for _ in range(most_terms):
            new: dict[frozenset[str], Formula] = {}
            for node in beam:
                for child in self.extensions(node, none):
                    new.setdefault(child.key, child)
            ranked = sorted(new.values(), key=lambda f: -f.log_posterior)[: OPTIONS.beam]
            best = max((f.log_posterior for f in known.values()), default=0.0)
            known |= {f.key: f for f in new.values()}
            beam = ranked
            if not beam or beam[0].log_posterior <= best:
                break
        ranked = sorted(known.values(), key=lambda f: -f.log_posterior)
        if not final:
            return ranked[: OPTIONS.estimated]
        # Under a noise that still contains the effect every further term seems to gain: short ones are compared under their own as well.
        plain, terms = estimated(self.others, self.point, 0.0), range(1, most_terms + 1)
        best = {f.key: f for n in terms for f in [f for f in ranked if len(f.placed) == n][: OPTIONS.estimated_of_each]}
        best |= {f.key: f for f in ranked[: OPTIONS.estimated]}
        return sorted((self.estimated(f, plain) for f in best.values()), key=lambda f: -f.log_posterior)

    def estimated(self, formula: Formula, plain: Hypothesis) -> Formula:
        """The formula with the noise that is most probable with it, against the hypothesis without formula with its own."""
        there = estimated(formula.hypothesis.members, self.point, 0.0)
        return Formula(formula.placed, there, formula.log_prior, there.log_evidence - plain.log_evidence)

    def extensions(self, node: Formula, none: Formula) -> list[Formula]:
        """A formula with one term more: those that are most probable to first order."""
        conditioned = node.hypothesis.conditioned
        found: list[tuple[float, PlacedTerm, float]] = []
        for space, evidence_map in zip(self.spaces, self.maps, strict=True):
            logs = evidence_map.evaluate(conditioned).log_bayes_factor + space.log_priors
            present = {distinct(p)[0] for p in node.placed if p.location.name == space.location.name}
            chosen: dict[tuple[str, tuple[int, ...]], int] = {}
            for e in np.argsort(-logs)[: WORTH_A_LOOK * OPTIONS.compared]:
                if distinct(space.placed[e])[0] not in present:
                    chosen.setdefault(distinct(space.placed[e]), int(e))
            found += [(float(logs[e]), space.placed[e], float(space.log_priors[e])) for e in chosen.values()]
        out = []
        for _, placed, log_prior in sorted(found, key=lambda one: -one[0])[: OPTIONS.compared]:
            here = self.refined(conditioned, placed) if placed.term.wave else placed
            members = (*node.hypothesis.members, self.member(here))
            hypothesis = first_order(members, self.point, 0.0)
            further = float(np.log(OPTIONS.further)) if node.placed else -float(np.log(len(self.spaces)))
            log_factor = hypothesis.log_evidence - none.hypothesis.log_evidence
            out.append(Formula((*node.placed, here), hypothesis, node.log_prior + log_prior + further, log_factor))
        return out

    def member(self, placed: PlacedTerm) -> Member:
        """A term as an effect; its sizes are relative to the best determined direction, as those of the evidence map."""
        unit = candidate(self.context(placed), (placed,), np.ones(len(placed.coefficients)))
        return relative_to_best_determined(self.point.projected, unit)

    def context(self, placed: PlacedTerm) -> Context:
        return next(s.context for s in self.spaces if s.location.name == placed.location.name)

    def refined(self, conditioned: CandidateScoring, placed: PlacedTerm) -> PlacedTerm:
        """A wave at its most probable order between the neighbours of one of the grid."""
        orders = sorted({dictionary.order_of(s.term) for space in self.spaces for s in space.placed if s.term.wave})
        middle, step = dictionary.order_of(placed.term), orders[1] - orders[0]
        best = placed
        for _ in range(ROUNDS):
            values = [float(f"{v:.4g}") for v in np.linspace(middle - step, middle + step, FINE) if v > 0]
            tried = [PlacedTerm(placed.location, placed.rows, dictionary.with_order(placed.term, v)) for v in values]
            best = tried[int(np.argmax([self.evidence(conditioned, one) for one in tried]))]
            middle, step = dictionary.order_of(best.term), 2 * step / (FINE - 1)
        return best

    def evidence(self, conditioned: CandidateScoring, placed: PlacedTerm) -> float:
        """Log Bayes factor of one term beyond what a problem is conditioned on."""
        unit = candidate(self.context(placed), (placed,), np.ones(len(placed.coefficients)))
        X, S, b = conditioned.candidate_products(unit, None)
        absorbed = conditioned.conditioned.T @ X
        S, b, typical = S - absorbed.T @ absorbed, b - absorbed.T @ conditioned.along, np.sum(X * X, axis=0) ** -0.5
        return float(log_bayes_factors((S * np.outer(typical, typical))[None], (b * typical)[None])[0])


def distinct(placed: PlacedTerm) -> tuple[str, tuple[int, ...]]:
    """What tells terms of one location apart: waves of one covariate are one, whatever their order."""
    return placed.term.shape if placed.term.wave else placed.term.label, placed.rows
