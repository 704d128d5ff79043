"""The one shape of every physical effect: places that move, functions of the situation that say how much, and a report.

A candidate displaces one or several places of the cell. Its columns are the products (component of a place) x (function of
the pose or of the centre), each with a coefficient to be estimated; functions may depend on one hyper-parameter (an order, a
time constant, the moment of a step), whose values to try are given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np


class Missing(Exception):
    """The recording lacks what an effect needs; the message says what."""


@dataclass(frozen=True)
class Part:
    """Movement of one component of one place, shared coefficients with the other parts of its candidate.

    place: 'joint' (index 0..n-1; rad), 'frame' (index 0 base .. n mount; component 0..5 of the local twist behind it),
    'point' (component 0..2, added to the measured point), 'ball' (component 0..2, added in the artefact frame),
    'station' (component 0..2, translation of the artefact along the base axes). basis: (P, k) or, for point and ball, (P, k) or (M, k).
    """

    place: str
    index: int
    component: int
    basis: np.ndarray


@dataclass(frozen=True)
class Hyper:
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
    typical: size of the coefficients in a real cell (k,), used to say whether the poses could see it.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    build: Callable[[float | None], list[Part]]
    report: Callable[[np.ndarray, np.ndarray, float | None], Parameters]
    typical: np.ndarray
    hyper: Hyper | None = None
    separable: tuple[tuple[str, int, int], ...] = ()
    functions: Callable[[np.ndarray], np.ndarray] | None = None
    positive: bool = False
    several: bool = False
    extra: Mapping[str, object] = field(default_factory=dict)

    @property
    def key(self) -> str:
        return f"{self.name}:{'+'.join(self.where)}:{self.depends_on}"


def number(value: float, std: float) -> dict[str, float]:
    return {"value": float(value), "std": float(std)}


def vector(values: np.ndarray, covariance: np.ndarray) -> dict[str, list[float]]:
    return {"value": [float(v) for v in values], "std": [float(s) for s in np.sqrt(np.diag(covariance))]}


def scalar_report(name: str, scale: float = 1.0) -> Callable[[np.ndarray, np.ndarray, float | None], Parameters]:
    """Report of a single coefficient, converted by ``scale`` to the unit in the name."""
    return lambda c, v, _: {name: number(scale * c[0], abs(scale) * np.sqrt(v[0, 0]))}
