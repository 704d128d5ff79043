"""The one shape of every physical effect: places that move, functions of the situation that say how much, and a report.

A candidate displaces one or several places of the cell. Its columns are the products (component of a place) x (function of
the pose or of the centre), each with a coefficient to be estimated; functions may depend on one hyper-parameter (an order, a
time constant, the moment of a step), whose values to try are given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.terms import Part

__all__ = ["Candidate", "Hyperparameter", "Missing", "Parameters", "Part", "number", "scalar_report", "vector"]


class Missing(Exception):
    """The recording lacks what an effect needs; the message says what."""


@dataclass(frozen=True)
class Hyperparameter:
    """A bounded non-linear parameter: values to try first, their scale for refinement, effective number of independent values."""

    name: str
    values: np.ndarray
    independent: float
    refine: bool = True
    preferred: tuple[float, ...] = ()


Parameters = dict[str, dict[str, float | list[float]]]


@dataclass(frozen=True)
class Candidate:
    """One effect at one place, ready to be tested.

    build(hyper value or None) -> parts. report(coefficients (k,), covariance (k, k), hyper value) -> parameters in contract units.
    separable: (place, index, component) of its components where every component is multiplied by the same functions(values (H,)) ->
    (H, P, f); coefficients are ordered component-major. positive: physics demands a positive first coefficient.
    typical: size of the coefficients in a real cell (k,): whether the poses could see it, and how probable one size of them is beside the
    others. variant: tells candidates of one effect at one place apart; only one of them is ever chosen. several: the same place may have it
    several times (several orders). detectability: how well these poses show a typical size of it, relative to the same effect at other
    locations; 1: fully.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    build: Callable[[float | None], list[Part]]
    report: Callable[[np.ndarray, np.ndarray, float | None], Parameters]
    typical: np.ndarray
    hyper: Hyperparameter | None = None
    separable: tuple[tuple[str, int, int], ...] = ()
    functions: Callable[[np.ndarray], np.ndarray] | None = None
    positive: bool = False
    several: bool = False
    variant: str = ""
    detectability: float = 1.0

    @property
    def k(self) -> int:
        return len(self.typical)

    @property
    def key(self) -> str:
        return f"{self.name}:{'+'.join(self.where)}:{self.depends_on}:{self.variant}"


def number(value: float, std: float) -> dict[str, float]:
    return {"value": float(value), "std": float(std)}


def vector(values: np.ndarray, covariance: np.ndarray) -> dict[str, list[float]]:
    return {"value": [float(v) for v in values], "std": [float(s) for s in np.sqrt(np.diag(covariance))]}


def scalar_report(name: str, scale: float = 1.0) -> Callable[[np.ndarray, np.ndarray, float | None], Parameters]:
    """Report of a single coefficient, converted by ``scale`` to the unit in the name."""
    return lambda c, v, _: {name: number(scale * c[0], abs(scale) * np.sqrt(v[0, 0]))}
