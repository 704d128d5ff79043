"""The one form of every effect at standstill: locations of the cell that move, functions that say by how much, and a report.

A candidate displaces one or several locations of the cell. Its columns are the products (component of a location) x (function of
the pose or of the centre), each with a coefficient to be estimated; the functions may depend on one hyper-parameter (an order, a
time constant, the moment of a step), for which the values to try are given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mbcacq.effects.functions import DescribedPart
from mbcacq.estimation.terms import Part
from mbcacq.quantities import K, measured, split_unit

__all__ = [
    "Candidate",
    "DescribedPart",
    "Hyperparameter",
    "Missing",
    "ParameterEstimate",
    "Parameters",
    "Part",
    "number",
    "parameter_in_words",
    "scalar_report",
    "vector",
]


class Missing(Exception):
    """The recording lacks what an effect needs; the message says what."""


@dataclass(frozen=True)
class Hyperparameter:
    """A bounded parameter in which an effect is not linear.

    values: to try first, (H,). independent: the number of statistically independent choices among all values. refine: whether the best
    of the values is a start for a continuous search. preferred: values that are more probable beforehand than all others.
    """

    name: str
    values: np.ndarray
    independent: float
    refine: bool = True
    preferred: tuple[float, ...] = ()


@dataclass(frozen=True)
class ParameterEstimate:
    """A reported parameter and its standard deviation, in the unit that its name ends with; tuples where it has several components."""

    value: float | tuple[float, ...]
    std: float | tuple[float, ...]

    def __str__(self) -> str:
        return self.shown("")

    def shown(self, unit: str, factor: float = 1.0) -> str:
        """Value and expanded uncertainty (k = 2) in a unit of which ``factor`` make one of the stored; each component by itself."""
        values, stds = (x if isinstance(x, tuple) else (x,) for x in (self.value, self.std))
        return ", ".join(measured(factor * v, factor * K * s, unit) for v, s in zip(values, stds, strict=True))


def parameter_in_words(name: str, estimate: ParameterEstimate) -> str:
    """'A2 compliance (2.09 ± 0.18) µrad/(N·m)': name, value and expanded uncertainty (k = 2) with the unit that the name ends with."""
    words, unit, factor = split_unit(name)
    return f"{words} {estimate.shown(unit, factor)}"


Parameters = Mapping[str, ParameterEstimate]
Report = Callable[[np.ndarray, np.ndarray, float | None], Parameters]


@dataclass(frozen=True)
class Candidate:
    """One effect at one location, ready to be tested.

    build(value of the hyper-parameter or None) -> parts. report(coefficients (k,), covariance (k, k), value of the hyper-parameter) ->
    parameters by name.
    typical: (k,) size of each coefficient in a real cell. From it follow whether these poses can observe the effect, and how probable
    each size of it is.
    separable: the (place, index, component) of its components, where every component is multiplied by the same
    functions(values (H,)) -> (H, P, f); coefficients are then ordered component by component.
    positive: the first coefficient can only be positive.
    several: one location may have the effect several times, each with its own value of the hyper-parameter (several orders).
    variant: tells candidates of one effect at one location apart, of which at most one is selected.
    described: the same parts as ``build`` gives, written down as functions of covariates, so that the effect can be kept and evaluated at
    any other pose; None for an effect that cannot be kept.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    build: Callable[[float | None], list[Part]]
    report: Report
    typical: np.ndarray
    hyper: Hyperparameter | None = None
    separable: tuple[tuple[str, int, int], ...] = ()
    functions: Callable[[np.ndarray], np.ndarray] | None = None
    positive: bool = False
    several: bool = False
    variant: str = ""
    described: Callable[[float | None], list[DescribedPart]] | None = None

    @property
    def k(self) -> int:
        """The number of coefficients."""
        return len(self.typical)

    @property
    def key(self) -> str:
        """Identifies the candidate among all of a recording."""
        return f"{self.name}:{'+'.join(self.where)}:{self.depends_on}:{self.variant}"


def number(value: float, std: float) -> ParameterEstimate:
    """A parameter of one component."""
    return ParameterEstimate(float(value), float(std))


def vector(values: np.ndarray, covariance: np.ndarray) -> ParameterEstimate:
    """A parameter of several components, from its values (k,) and their covariance (k, k)."""
    return ParameterEstimate(tuple(float(v) for v in values), tuple(float(s) for s in np.sqrt(np.diag(covariance))))


def scalar_report(name: str, scale: float = 1.0) -> Report:
    """The report of an effect with a single coefficient, which ``scale`` converts to the unit that the name ends with."""
    return lambda c, v, _: {name: number(scale * c[0], abs(scale) * np.sqrt(v[0, 0]))}
