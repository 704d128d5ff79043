"""Formulas, and the search for them by evidence: terms added one by one, each paying for its coefficients and for the size of the
dictionary.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, estimated, first_order
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.unmodelled import relative_to_best_determined
from mbcacq.diagnosis.formulas import dictionary
from mbcacq.diagnosis.formulas.dictionary import MOST_TERMS, DictionaryEntry
from mbcacq.diagnosis.nonparametric.basis_functions import Location, Shape
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS
from mbcacq.diagnosis.search.effect_set import Member, prior_sigma
from mbcacq.effects.context import Context
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect import Candidate, StandstillRows
from mbcacq.effects.functions import ZERO, Column, DescribedPart, scaled

NAME = "formula"
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class PlacedTerm:
    """A term that moves some components of a location: rows of its ``mix``."""

    location: Location
    rows: tuple[int, ...]
    term: DictionaryEntry

    @cached_property
    def label(self) -> str:
        """Tells it apart from all others but waves of another order."""
        columns = [] if self.term.is_wave else list(self.term.columns)
        return f"{self.location.name}{self.rows}:{self.term.shape}{columns}"

    @property
    def coefficients(self) -> list[tuple[str, str, str]]:
        """(what moves, e.g. 'A2' or 'link3 rx'; text of the column; unit of the displacement) of each coefficient."""
        name = self.location.name
        if self.location.keys[0][0] == "joint":
            return [(name, text, "rad") for text in self.term.columns]
        return [(f"{name} {COMPONENTS[row]}", text, "mm" if row < 3 else "rad") for row in self.rows for text in self.term.columns]


def described(placed: Sequence[PlacedTerm]) -> list[DescribedPart]:
    """The parts that all terms displace together; coefficients are ordered term by term, and in each component by component."""
    count, start = sum(len(p.coefficients) for p in placed), 0
    columns: dict[tuple[str, int, int], list[Column]] = {}
    for one in placed:
        for row in one.rows:
            for key, share in zip(one.location.keys, one.location.mix[row], strict=True):
                if abs(share) > 1e-12:
                    own = columns.setdefault(key, [ZERO] * count)
                    own[start : start + len(one.term.columns)] = [scaled(column, float(share)) for column in one.term.columns.values()]
            start += len(one.term.columns)
    return [DescribedPart(*key, tuple(own)) for key, own in columns.items()]


def candidate(context: Context, placed: Sequence[PlacedTerm], typical: np.ndarray) -> Candidate:
    """The terms as one effect, whose coefficients have these typical sizes (k,)."""
    parts, first = described(placed), placed[0]
    variant, rows = " + ".join(f"{p.label}{list(p.term.columns)}" for p in placed), StandstillRows(parts, typical)
    return Candidate(NAME, (first.location.name,), first.term.covariates[0], rows, lambda c, v, h: {}, several=True, variant=variant)


@dataclass(frozen=True)
class FormulaSpace:
    """The terms of some locations, each at every choice of components, laid out as design blocks in the order of ``placed``."""

    context: Context
    placed: list[PlacedTerm]
    groups: list[BlockGroup]

    @classmethod
    def of(cls, context: Context, locations: Sequence[Location]) -> FormulaSpace:
        placed, groups = list[PlacedTerm](), list[BlockGroup]()
        for location in locations:
            terms = dictionary.entries(context, location)
            columns = tuple(dict.fromkeys(column for term in terms for column in term.columns.values()))
            (part,) = evaluated(context, [DescribedPart(*location.keys[0], columns)], cache(context.value))
            kept = distinct(part.basis)
            values, number = part.basis[:, kept], {columns[j]: i for i, j in enumerate(kept)}
            unit = values / np.sqrt(np.mean(values**2, axis=0))
            chosen = [term for term in terms if all(column in number for column in term.columns.values())]
            each = [unit[:, [number[column] for column in term.columns.values()]] for term in chosen]
            shapes = [Shape(t.shape, tuple(t.columns.values()), own, np.ones(own.shape[1])) for t, own in zip(chosen, each, strict=True)]
            groups.append(BlockGroup(location, shapes))
            term_of = dict(zip(map(id, shapes), chosen, strict=True))
            placed += [PlacedTerm(location, block.rows, term_of[id(block.shape)]) for block in groups[-1].blocks]
        return cls(context, placed, groups)


def distinct(columns: np.ndarray) -> np.ndarray:
    """Indices of the columns (rows, f) that vary otherwise than any before them. Means belong to the geometry and do not count, nor do
    scales."""
    varies = np.flatnonzero(columns.std(axis=0) > 1e-9 * np.sqrt(np.mean(columns**2, axis=0)))
    shape = columns[:, varies] - columns[:, varies].mean(axis=0)
    shape = shape / shape[np.abs(shape).argmax(axis=0), np.arange(len(varies))]
    return varies[np.sort(np.unique(np.round(shape, 6) + 0.0, axis=1, return_index=True)[1])]


@dataclass(frozen=True)
class Formula:
    """Terms, and the hypothesis with them in place. log_bayes_factor: against the same hypothesis without them, prior left out."""

    placed: tuple[PlacedTerm, ...]
    hypothesis: Hypothesis
    log_bayes_factor: float

    @property
    def log_posterior(self) -> float:
        """Log posterior odds against no formula."""
        return self.log_bayes_factor + self.hypothesis.log_prior

    @cached_property
    def labels(self) -> frozenset[str]:
        """Labels of its terms."""
        return frozenset(p.label for p in self.placed)

    @property
    def functions(self) -> frozenset[tuple[str, str]]:
        """What it is a function of and where, whatever the phase, the order of a wave and the components that move."""
        return frozenset((p.location.name, p.term.shape) for p in self.placed)

    @property
    def shapes(self) -> tuple[str, ...]:
        """What it is a function of, wherever."""
        return tuple(sorted({p.term.shape for p in self.placed}))

    @property
    def sigma(self) -> np.ndarray:
        """(k,) prior standard deviation of the coefficients, at the most probable size of each term."""
        return prior_sigma(self.hypothesis.members[-len(self.placed) :])


def ranked(formulas: Iterable[Formula]) -> list[Formula]:
    """The most probable first."""
    return sorted(formulas, key=lambda f: -f.log_posterior)


def different(formulas: Iterable[Formula]) -> list[Formula]:
    """The most probable first, without those that only add terms to a more probable one, or details."""
    out: list[Formula] = []
    for formula in ranked(formulas):
        if not any(other.functions <= formula.functions for other in out):
            out.append(formula)
    return out


class FormulaSearch:
    """The search in one recording, or a part of it, under the noise of ``point``, with the other effects in place."""

    def __init__(self, point: NoisePoint, others: Sequence[Member], space: FormulaSpace):
        self.point, self.others, self.space = point, tuple(others), space
        self.map = EvidenceMap(point.projected, space.groups)
        self.none = first_order(self.others, point, 0.0)

    def run(self, most_terms: int = MOST_TERMS) -> list[Formula]:
        """The most probable formulas, best first, each with the noise that is most probable with it, against none with its own.

        Every further term seems to gain under a noise that still contains the effect, so formulas of every length are compared.
        """
        plain = estimated(self.others, self.point, 0.0)
        each = [(f, estimated(f.hypothesis.members, self.point, f.hypothesis.log_prior)) for f in self.to_first_order(most_terms)]
        return ranked(Formula(f.placed, there, there.log_evidence - plain.log_evidence) for f, there in each)

    def to_first_order(self, most_terms: int = MOST_TERMS) -> list[Formula]:
        """The most probable formulas of one term, of two and so on, as long as a further one gains."""
        out, beam = [], [Formula((), self.none, 0.0)]
        for _ in range(most_terms):
            extended = {new.labels: new for formula in beam for new in self.extensions(formula)}
            longer = ranked(extended.values())[: DIAGNOSIS.beam]
            out += longer
            if not longer or longer[0].log_posterior <= beam[0].log_posterior:
                break
            beam = longer
        return out

    def extensions(self, formula: Formula) -> list[Formula]:
        """A formula with one term more: those that are most probable to first order."""
        logs = self.map.evaluate(formula.hypothesis.conditioned).log_bayes_factor
        best: dict[str, PlacedTerm] = {}
        for e in np.argsort(-logs):
            best.setdefault(self.space.placed[e].label, self.space.placed[e])
        chosen = [placed for label, placed in best.items() if label not in formula.labels][: DIAGNOSIS.beam]
        return [self.refined(formula, placed) if placed.term.is_wave else self.extended(formula, placed) for placed in chosen]

    def extended(self, formula: Formula, placed: PlacedTerm) -> Formula:
        """With this term as well, to first order."""
        further = DIAGNOSIS.further if formula.placed else 1.0
        log_prior = formula.hypothesis.log_prior + float(np.log(further / len(self.space.placed)))
        hypothesis = first_order((*formula.hypothesis.members, self.member(placed)), self.point, log_prior)
        return Formula((*formula.placed, placed), hypothesis, hypothesis.log_evidence - self.none.log_evidence)

    def refined(self, formula: Formula, placed: PlacedTerm) -> Formula:
        """With a wave as well, at its most probable order between the neighbours of one of the grid."""
        name, step = placed.term.covariates[0], dictionary.wave_step(self.space.context, placed.term.covariates[0])

        @cache
        def at(order: float) -> Formula:
            return self.extended(formula, replace(placed, term=dictionary.wave(name, float(f"{order:.4g}"))))

        middle = next(iter(placed.term.columns.values()))[0].functions[0].numbers[0]
        best: Any = minimize_scalar(lambda order: -at(order).log_posterior, bounds=(middle - step, middle + step), method="bounded")
        return at(best.x)

    def member(self, placed: PlacedTerm) -> Member:
        """A term as an effect; its sizes are relative to the best determined direction, as those of the evidence map."""
        unit = candidate(self.space.context, (placed,), np.ones(len(placed.coefficients)))
        return relative_to_best_determined(self.point.projected, unit)
