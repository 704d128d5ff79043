"""The search over sets of effects on a small problem that is known whole: a line of regression with noise of one."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mbcacq.diagnosis.evidence.beam_search import EvidenceSearch
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import StandstillRows

ROWS = 12
SHOWN, UNDONE, LEFT = 12.0, 6.0, 20.0


@dataclass(frozen=True)
class Column:
    """An effect with one coefficient of typical size one."""

    name: str
    x: np.ndarray
    where: tuple[str, ...] = ("A1",)
    k: int = 1
    positive: bool = False
    rarity: float = 1.0
    usual: None = None
    least_size: float = 0.0
    rows: StandstillRows = field(default_factory=lambda: StandstillRows([], np.ones(1)))

    @property
    def key(self) -> str:
        return self.name

    @property
    def label(self) -> str:
        return f"{self.name}:{'+'.join(self.where)}"

    @property
    def typical(self) -> np.ndarray:
        return np.ones(1)


@dataclass(frozen=True)
class Equations:
    A: np.ndarray
    a: np.ndarray
    log_likelihood: float = 0.0

    def score(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(0), np.zeros((0, 0))


@dataclass(frozen=True)
class KnownNoise:
    """Rows r (R,) of variance one."""

    r: np.ndarray

    def extended(self, members) -> np.ndarray:
        return np.stack([m.candidate.x for m in members], axis=1) if members else np.zeros((len(self.r), 0))

    def with_effects(self, extended: np.ndarray) -> Equations:
        return Equations(extended.T @ extended, extended.T @ self.r)

    def conditioned(self, members) -> Any:
        return self

    def moved(self, gradient: np.ndarray, information: np.ndarray) -> tuple[KnownNoise, np.ndarray]:
        return self, np.zeros(1)

    def forget(self) -> None: ...


@dataclass(kw_only=True)
class Search(EvidenceSearch):
    """Every further effect at the odds that it has beside the set."""

    ahead: bool = True

    @property
    def looks_ahead(self) -> bool:
        return self.ahead

    def further(self, node: Hypothesis, candidates: list[Any], least: float) -> list[tuple[float, Member]]:
        new = [c for c in candidates if c not in [m.candidate for m in node.members]]
        sets = [(*node.members, Member(c, None)) for c in new]
        return [(exact(s, node.point.r) + self.log_prior(s) - node.log_posterior, s[-1]) for s in sets]


def exact(members, r: np.ndarray) -> float:
    """Log density of r against no effect, coefficients integrated out and averaged over the sizes of each effect."""
    none, logs = multivariate_normal(cov=np.eye(len(r))).logpdf(r), [0.0]
    grids = np.array(np.meshgrid(*[m.sizes for m in members])).reshape(len(members), -1).T if members else np.zeros((0, 0))
    X = np.stack([m.candidate.x for m in members], axis=1) if members else np.zeros((len(r), 0))
    if len(grids):
        logs = [multivariate_normal(cov=np.eye(len(r)) + (X * s**2) @ X.T).logpdf(r) - none for s in grids]
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


@pytest.fixture(scope="module")
def made() -> tuple[list[Column], np.ndarray]:
    """One effect that shows by itself, and two that undo most of each other: together they leave one row, which each alone could have
    only with far more along another row, where nothing is."""
    e = np.eye(ROWS)
    plain = Column("plain", e[0])
    one, other = Column("one", UNDONE * e[1] + e[2]), Column("other", -UNDONE * e[1] + e[2])
    elsewhere = [Column(f"nothing {k}", e[k]) for k in (4, 5)]
    return [plain, one, other, *elsewhere], SHOWN * e[0] + LEFT * e[2]


def searched(made: tuple[list[Column], np.ndarray], ahead: bool) -> list[Hypothesis]:
    columns, r = made
    return Search(candidates=columns, prior=SetPrior.of(columns, 1), ahead=ahead).run(KnownNoise(r))


def names(h: Hypothesis) -> set[str]:
    return {m.candidate.name for m in h.members}


def test_two_effects_that_show_only_together_are_found_together(made):
    columns, r = made
    found = searched(made, ahead=True)
    assert names(found[0]) == {"plain", "one", "other"}
    # No other set is more probable.
    prior = SetPrior.of(columns, 1)
    every = [s for n in range(4) for s in combinations(columns, n)]
    posterior = {frozenset(c.name for c in s): exact([Member(c, None) for c in s], r) + prior.log_probability_of_set(s) for s in every}
    assert max(posterior, key=lambda s: posterior[s]) == names(found[0])
    # Each of the two alone, beside the one that shows, makes the set less probable, though it is not excluded.
    alone = posterior[frozenset({"plain"})]
    each = [posterior[frozenset({"plain", one})] - alone for one in ("one", "other")]
    assert np.log(OPTIONS.undecided) < min(each) <= max(each) < 0


def test_without_looking_ahead_the_search_ends_before_them(made):
    assert names(searched(made, ahead=False)[0]) == {"plain"}


def test_looking_ahead_finds_no_more_where_there_is_no_more(made):
    columns, _ = made
    r = SHOWN * columns[0].x + 0.5 * columns[3].x
    found = searched((columns, r), ahead=True)
    assert names(found[0]) == {"plain"}
