"""Functions of covariates by which an effect is written down, so that it can be kept in a file and evaluated at any other pose.

A column of an effect's basis is a sum of products: each product is a factor times functions of one covariate each. Names and numbers
stand in JSON as they stand here; ``docs/reference/effect-model.md`` evaluates them in plain numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Values = Callable[[str], np.ndarray]  # name of a covariate -> its values, one a row

# Name of a function -> its value for a covariate x and its numbers.
FUNCTIONS: Mapping[str, Callable[..., np.ndarray]] = {
    "power": lambda x, p: x**p,
    "sin": lambda x, order: np.sin(order * x),
    "cos": lambda x, order: np.cos(order * x),
    "sign": lambda x: np.sign(x),
    "tanh": lambda x, width: np.tanh(x / width),
    "clip": lambda x, at: np.clip(x, -at, at),
    "lever": lambda x, at, ratio: np.sin(x - at) / np.sqrt(1 + ratio**2 - 2 * ratio * np.cos(x - at)),
    "stretch": lambda x, at, ratio: (np.sqrt(1 + ratio**2 - 2 * ratio * np.cos(x - at)) - (1 - ratio)) / (2 * ratio),
    "step": lambda x, at: (x >= at).astype(float),
    "decay": lambda x, constant: np.exp(-x / constant),
    "cosine": lambda x, low, high, k: np.cos(np.pi * k * (x - low) / (high - low)),
    "is": lambda x, value: (x == value).astype(float),
}


@dataclass(frozen=True)
class Function:
    """One function of one covariate. kind: a name of FUNCTIONS; numbers: its parameters, in their order."""

    covariate: str
    kind: str = "power"
    numbers: tuple[float, ...] = (1.0,)

    def __call__(self, values: Values) -> np.ndarray:
        return FUNCTIONS[self.kind](values(self.covariate), *self.numbers)


@dataclass(frozen=True)
class Product:
    """factor times the functions; a constant where there is none."""

    factor: float
    functions: tuple[Function, ...] = ()


Column = tuple[Product, ...]  # a sum of products; an empty one is zero
ZERO: Column = ()


@dataclass(frozen=True)
class DescribedPart:
    """A ``mbcacq.estimation.terms.Part`` whose basis is written down: one column for each coefficient of the effect."""

    place: str
    index: int
    component: int
    columns: tuple[Column, ...]

    @property
    def covariates(self) -> frozenset[str]:
        """Names of the covariates that its columns are functions of."""
        return frozenset(f.covariate for column in self.columns for product in column for f in product.functions)


def linear(covariate: str, factor: float = 1.0) -> Column:
    """factor * covariate."""
    return (Product(factor, (Function(covariate),)),)


def sine(covariate: str, order: float) -> Column:
    """sin(order * covariate)."""
    return (Product(1.0, (Function(covariate, "sin", (float(order),)),)),)


def cosine(covariate: str, order: float) -> Column:
    """cos(order * covariate)."""
    return (Product(1.0, (Function(covariate, "cos", (float(order),)),)),)


def of(covariate: str, kind: str, *numbers: float, factor: float = 1.0) -> Column:
    """factor * kind(covariate; numbers)."""
    return (Product(factor, (Function(covariate, kind, tuple(float(v) for v in numbers)),)),)


def monomial(factor: float = 1.0, **powers: int) -> Product:
    """factor * product of covariates to the given powers; ``monomial(x=1, z=2)`` is x z^2."""
    return Product(factor, tuple(Function(name, "power", (float(p),)) for name, p in powers.items() if p))


def of_second_degree(names: tuple[str, str, str]) -> tuple[Column, ...]:
    """The polynomials of first and second degree of a unit vector with these components: three linear ones, five of second degree. The
    square of the third component follows from the others'.
    """
    x, y, z = names
    linear_ones = tuple((monomial(**{one: 1}),) for one in names)
    squares = tuple((monomial(**{one: 2}),) for one in (x, y))
    return linear_ones + squares + tuple((monomial(**{one: 1, other: 1}),) for one, other in ((x, y), (x, z), (y, z)))


def scaled(column: Column, factor: float) -> Column:
    """The column times a factor."""
    return tuple(Product(factor * product.factor, product.functions) for product in column)


def evaluate(columns: tuple[Column, ...], values: Values, rows: int) -> np.ndarray:
    """(rows, k) values of the columns."""
    out = np.zeros((rows, len(columns)))
    for j, column in enumerate(columns):
        for product in column:
            value = np.full(rows, product.factor)
            for function in product.functions:
                value = value * function(values)
            out[:, j] += value
    return out


def column_to_json(column: Column) -> list[dict[str, Any]]:
    """The column as JSON content."""
    return [
        {
            "factor": product.factor,
            "functions": [{"of": f.covariate, "kind": f.kind, "numbers": list(f.numbers)} for f in product.functions],
        }
        for product in column
    ]


def column_from_json(content: list[Mapping[str, Any]]) -> Column:
    """The column that ``column_to_json`` wrote. Raises KeyError, TypeError or ValueError where it is damaged."""
    return tuple(Product(float(product["factor"]), tuple(_function(f) for f in product["functions"])) for product in content)


def _function(content: Mapping[str, Any]) -> Function:
    kind, numbers = content["kind"], tuple(float(v) for v in content["numbers"])
    if kind not in FUNCTIONS:
        raise ValueError(f"there is no function '{kind}'; this result was written by a newer version")
    if len(numbers) != FUNCTIONS[kind].__code__.co_argcount - 1:
        raise ValueError(f"the function '{kind}' has {len(numbers)} numbers")
    return Function(str(content["of"]), kind, numbers)
