"""What is open after a look at the evidence: sets of effects that are not told apart, effects that could still hide, accuracy asked for.

The log odds of a true set of effects against another one are expected to grow by half of D. D is the squared length of the difference of
their predictions for poses to come, beyond everything that geometry and the other set can still do about it. Without any effect this is
what a set owes to chance: it does not come again. An effect of usual size shows by the information I, the squared length of its
displacement beyond the geometry: a decision takes 20 to 30 of either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.design.adaptive.options import OPTIONS, AdaptiveOptions
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import nested
from mbcacq.diagnosis.interim import InterimEvidence
from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.diagnosis.search.effect_set import prior_sigma
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem


@dataclass(frozen=True, kw_only=True)
class SetComparison:
    """Two sets, one of which is true. differs: column by which their displacements differ; model: columns of the other set, in prior
    sigmas; weight: how probable the first is to be true; known: log odds in its favour as they stand.
    """

    differs: int
    model: tuple[int, ...]
    weight: float
    known: float
    a: int
    b: int

    def information(self, products: np.ndarray) -> np.ndarray:
        """D (...,) of products (..., K, K) of all columns beyond the geometry."""
        own, across = products[..., self.differs, self.differs], products[..., self.differs, list(self.model)]
        if not self.model:
            return own
        inner = products[..., list(self.model), :][..., list(self.model)] + np.eye(len(self.model))
        taken = np.linalg.solve(inner, across[..., None])[..., 0]
        return own - np.sum(across * taken, axis=-1)


@dataclass(frozen=True, eq=False)
class Questions:
    """sets: sets of effects that are not excluded. columns (M, R, K): first the ``pairs`` of the sets, then, in usual sizes, of the effects
    that could hide, by weights and names (K - pairs,). aim: log odds between sets to be expected after the measurement.
    """

    sets: tuple[Hypothesis, ...]
    comparisons: tuple[SetComparison, ...]
    columns: np.ndarray
    pairs: int
    weights: np.ndarray
    names: tuple[str, ...]
    aim: float

    def value(self, products: np.ndarray, squares: np.ndarray, before: np.ndarray) -> np.ndarray:
        """(...,): expected log odds gained over what is known ``before`` (one D for each comparison), as far as they are needed, and what
        else shows. products (..., pairs, pairs), squares (..., K).
        """
        return self.log_odds_gained(products, before) + OPTIONS.hidden * self.shown(squares)

    def shown(self, squares: np.ndarray) -> np.ndarray:
        """(...,) share of the effects that could hide, each kind alike, that show at their usual size. The information that shows an effect
        counts as half of one; much more information counts hardly more, so that others get their turn.
        """
        information = np.maximum(squares[..., self.pairs :], 0.0)
        return information / (information + OPTIONS.shows) @ self.weights / max(float(self.weights.sum()), 1e-12)

    def hidden(self, squares: np.ndarray) -> np.ndarray:
        """(...,) sum of log(1 + information) over the effects that could hide, at their usual size; each kind has the same weight."""
        return np.log1p(np.maximum(squares[..., self.pairs :], 0.0)) @ self.weights

    def log_odds_gained(self, products: np.ndarray, before: np.ndarray) -> np.ndarray:
        """(...,) expected log odds gained between the sets."""
        total = np.zeros(products.shape[:-2])
        for comparison, known in zip(self.comparisons, before, strict=True):
            gained = 0.5 * np.maximum(comparison.information(products) - known, 0.0)
            total = total + comparison.weight * np.minimum(gained, max(self.aim - comparison.known, 0.0))
        return total

    @property
    def differences(self) -> np.ndarray:
        """Indices of the columns by which displacements of two sets differ."""
        return np.unique([c.differs for c in self.comparisons]).astype(int)

    def information(self, products: np.ndarray) -> np.ndarray:
        """(comparisons,) D of each."""
        return np.array([c.information(products) for c in self.comparisons])


def questions(look: InterimEvidence | None, linear: LinearProblem, timeless: bool = False, options: AdaptiveOptions = OPTIONS) -> Questions:
    """What is open after a look, or before the first one, as columns of a problem that is linearised at measured and planned poses.

    timeless: leave out what acts in time, where nobody knows yet when a pose will be measured.
    """
    sets, comparisons, columns = ((), (), []) if look is None else _sets(look, linear)
    pairs = sum(c.shape[2] for c in columns)
    names, weights, hidden = _hidden(look, linear, timeless)
    every, aim = np.concatenate([np.zeros((*linear.residual.shape, 0)), *columns, *hidden], axis=2), options.enough + options.spare
    return Questions(tuple(sets), tuple(comparisons), every, pairs, np.array(weights), tuple(names), aim)


def surviving(look: InterimEvidence) -> list[Hypothesis]:
    """The sets that the evidence leaves, the reported one first; without any other those that are neither part nor extension of it and
    against which a decision has little to spare. The empty set and the most probable ones, most probable first, if an effect is shown
    neither to be there nor to be absent. The identity of the effect, if it is there, is asked at once.
    """
    fit = look.full.evidence
    if fit.significant:
        least = look.reported.log_posterior - OPTIONS.enough - OPTIONS.spare
        near = [h for h in fit.hypotheses if h.members and h.log_posterior > least and not nested(h, look.reported)]
        return [look.reported, *(look.alternatives or near)[: OPTIONS.rivals]]
    if not doubtful(look):
        return []
    most_probable: dict[frozenset[str], Hypothesis] = {}  # of each set, at one value of its hyper-parameters
    for h in fit.hypotheses:
        most_probable.setdefault(h.labels, h)
    effects = [h for h in most_probable.values() if h.members]
    return sorted([fit.none, *effects[: OPTIONS.rivals]], key=lambda h: -h.log_posterior)


def doubtful(look: InterimEvidence) -> bool:
    """Whether no effect is shown, and yet one is too probable for the answer that there is none."""
    fit = look.full.evidence
    return not fit.significant and fit.log_e_value > float(np.log(OPTIONS.doubtful))


def differ_in_time(look: InterimEvidence) -> bool:
    """Whether something that acts in time is among what is to be told apart: then postures that were measured are measured again."""
    return any(catalogue.declaration(m.candidate.name).acts_in_time for h in surviving(look) for m in h.members)


def differ_by_direction(look: InterimEvidence) -> bool:
    """Whether something that depends on the direction of approach is among what is to be told apart: then poses are approached from both
    sides.
    """
    return any("direction" in catalogue.declaration(m.candidate.name).needs for h in surviving(look) for m in h.members)


def _sets(look: InterimEvidence, linear: LinearProblem) -> tuple[list[Hypothesis], list[SetComparison], list[np.ndarray]]:
    found = surviving(look)
    if len(found) < 2:
        return [], [], []
    logs = np.array([h.log_posterior for h in found])
    probability = np.exp(logs - np.logaddexp.reduce(logs))
    columns, model, moved, start = [], [], [], 0
    noise_mm = float(np.mean(look.full.noise.point))
    for h in found:
        displaced, own = _of_set(h, linear)
        own = _largest_combinations(own / noise_mm) * noise_mm
        moved.append(displaced)
        columns.append(own)
        model.append(tuple(range(start, start + own.shape[2])))
        start += own.shape[2]
    comparisons = []
    for b in range(1, len(found)):  # each against the most probable one
        columns.append((moved[0] - moved[b])[:, :, None])
        for one, other in ((0, b), (b, 0)):
            known = float(logs[one] - logs[other])
            comparisons.append(
                SetComparison(differs=start, model=model[other], weight=float(probability[one]), known=known, a=one, b=other)
            )
        start += 1
    return found, comparisons, columns


def _of_set(h: Hypothesis, linear: LinearProblem) -> tuple[np.ndarray, np.ndarray]:
    """(M, R) displaced by a set with its coefficients, and (M, R, k) its columns in prior sigmas."""
    nothing = np.zeros((*linear.residual.shape, 0))
    columns = np.concatenate([nothing, *(candidate_columns(linear, m.candidate, m.hyper) for m in h.members)], axis=2)
    return columns @ h.solved.coefficients, columns * prior_sigma(h.members)


def _largest_combinations(X: np.ndarray) -> np.ndarray:
    """(M, R, at most OPTIONS.columns) of columns (M, R, k) for coefficients with priors of one: the orthogonal combinations, with the same
    prior, that displace most.
    """
    if X.shape[2] <= OPTIONS.columns:
        return X
    rows = X.reshape(-1, X.shape[2])
    _, vectors = np.linalg.eigh(rows.T @ rows)
    return X @ vectors[:, -OPTIONS.columns :]


def _hidden(look: InterimEvidence | None, linear: LinearProblem, timeless: bool) -> tuple[list[str], list[float], list[np.ndarray]]:
    """Name, weight and columns of every effect that is not excluded at its usual size."""
    open_ones = None if look is None else {(e.candidate.name, e.candidate.where) for e in look.limited if e.in_typical_sizes > 1.0}
    found, _ = catalogue.candidates(Context(linear.obs, linear.state, linear.prediction))
    chosen = [c for c in found if open_ones is None or (c.name, c.where) in open_ones]
    chosen = [c for c in chosen if not (timeless and catalogue.declaration(c.name).acts_in_time)]
    kinds: dict[str, set[tuple[str, ...]]] = {}
    for c in chosen:
        kinds.setdefault(c.name, set()).add(c.where)
    names, weights, columns = [], list[float](), []
    for c in chosen:
        variants = sum(o.name == c.name and o.where == c.where for o in chosen)
        values = _values(c)
        for hyper in values:
            X = candidate_columns(linear, c, hyper) * c.typical
            columns.append(X)
            names += [c.label] * X.shape[2]
            weights += [1.0 / (len(kinds) * len(kinds[c.name]) * variants * len(values) * X.shape[2])] * X.shape[2]
    return names, [w * len(kinds) for w in weights], columns


def _values(candidate: Candidate) -> Sequence[float | None]:
    """A few values of the hyper-parameter: those that are most probable, or evenly over its range."""
    if candidate.hyper is None:
        return [None]
    values = np.array(candidate.hyper.preferred) if len(candidate.hyper.preferred) else np.sort(candidate.hyper.values)
    return [float(v) for v in values[np.unique(np.linspace(0, len(values) - 1, OPTIONS.values).astype(int))]]
