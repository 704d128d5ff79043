"""Functions of covariates by which an effect is written down, so that it can be kept in a file and evaluated at any other pose.

A column of an effect's basis is a sum of products: each product is a factor times functions of one covariate each. Names and numbers
stand in JSON as they stand here; ``docs/reference/effect-model.md`` evaluates them in plain numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, FiniteFloat, WithJsonSchema

from mbcacq.model.json_text import EveryKey, InJson

Values = Callable[[str], np.ndarray]  # name of a covariate -> its values, one a row
Known = dict[int, tuple["tuple[Function, ...]", np.ndarray]]  # by identity, with the functions: what is held here keeps its identity
INCIDENCE = ("incidence_x", "incidence_y", "incidence_z")
SIGHT = ("sight_x", "sight_y", "sight_z")
EQUAL = 1e-11  # difference of two orders below which they are the same
OF_CENTRES = ("x", "y", "z", "ball", *INCIDENCE, *SIGHT)  # covariates with a value for each centre; all others have one for each pose


def turned(x: np.ndarray, orders: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine (H, P) of orders (H, 1), in ascending order, times an angle x (P,).

    A scan has hundreds of orders in equal steps, with a few that are preferred in between. The second half of a run of equal steps is the
    first, turned by a fixed angle. Sums of products take a quarter of the time that a sine for each would take, and are as exact.
    """
    order = orders[:, 0]
    sine, cosine = np.empty((len(order), len(x))), np.empty((len(order), len(x)))
    for first, end in _equal_steps(order):
        s, c = sine[first:end], cosine[first:end]
        s[0], c[0] = np.sin(order[first] * x), np.cos(order[first] * x)
        known = 1
        while known < end - first:
            turn = (order[first + known] - order[first]) * x
            across, along = np.sin(turn), np.cos(turn)
            more = min(known, end - first - known)
            s[known : known + more] = s[:more] * along + c[:more] * across
            c[known : known + more] = c[:more] * along - s[:more] * across
            known += more
    return sine, cosine


def _equal_steps(order: np.ndarray) -> list[tuple[int, int]]:
    """First and end of runs of orders (H,) whose steps are equal, to rounding."""
    runs, first = [], 0
    while first < len(order):
        along = order[first] + (order[min(first + 1, len(order) - 1)] - order[first]) * np.arange(len(order) - first)
        off = np.abs(order[first:] - along) > EQUAL
        end = first + int(off.argmax()) if off.any() else len(order)
        runs.append((first, end))
        first = end
    return runs


def _sine(x: np.ndarray, order: Any) -> np.ndarray:
    return np.sin(order * x) if np.ndim(order) == 0 else turned(x, order)[0]


def _cosine(x: np.ndarray, order: Any) -> np.ndarray:
    return np.cos(order * x) if np.ndim(order) == 0 else turned(x, order)[1]


# Name of a function -> its value for a covariate x and its numbers.
FUNCTIONS: Mapping[str, Callable[..., np.ndarray]] = {
    "power": lambda x, p: x**p,
    "signed_power": lambda x, p: np.sign(x) * np.abs(x) ** p,
    "sin": _sine,
    "cos": _cosine,
    "sign": lambda x: np.sign(x),
    "tanh": lambda x, width: np.tanh(x / width),
    "sigmoid": lambda x, at, width: np.tanh((x - at) / width),
    "distance": lambda x, at: np.abs(x - at),
    "clip": lambda x, at: np.clip(x, -at, at),
    "lever": lambda x, at, ratio: np.sin(x - at) / np.sqrt(1 + ratio**2 - 2 * ratio * np.cos(x - at)),
    "stretch": lambda x, at, ratio: (np.sqrt(1 + ratio**2 - 2 * ratio * np.cos(x - at)) - (1 - ratio)) / (2 * ratio),
    "step": lambda x, at: (x >= at).astype(float),
    "decay": lambda x, constant: np.exp(-x / constant),
    "cosine": lambda x, low, high, k: np.cos(np.pi * k * (x - low) / (high - low)),
    "is": lambda x, value: (x == value).astype(float),
}
OF_MECHANISMS = ("lever", "stretch")  # functions of an angle by the geometry of a mechanism, which is what it is at every angle
REPEATING = ("sin", "cos", *OF_MECHANISMS)  # functions of an angle to which a full turn is the same place


def _written(value: Any) -> Any:
    return value


_Factor = Annotated[Any, InJson(FiniteFloat, float, _written)]  # in a file a number


@dataclass(frozen=True)
class Function(EveryKey):
    """One function of one covariate. kind: a name of FUNCTIONS; numbers: its parameters, in their order. A number may be an array (H, 1):
    the function then stands for H functions at once.
    """

    covariate: Annotated[str, Field(alias="of", description="name of a covariate")]
    kind: Annotated[str, WithJsonSchema({"enum": list(FUNCTIONS)})] = "power"
    numbers: tuple[_Factor, ...] = (1.0,)

    def __call__(self, values: Values) -> np.ndarray:
        return FUNCTIONS[self.kind](values(self.covariate), *self.numbers)


@dataclass(frozen=True)
class Product(EveryKey):
    """factor times the functions; a constant where there is none. The factor may be an array (H, 1), as the numbers of a function may."""

    factor: _Factor
    functions: tuple[Function, ...] = ()


Column = tuple[Product, ...]  # a sum of products; an empty one is zero
ZERO: Column = ()


COMPONENTS = {"joint": 1, "frame": 6, "station": 6, "point": 3, "orientation": 3, "ball": 3}  # of each place
PLACE = (
    "what is displaced: joint (rad), frame (local twist mm, rad; 0 behind the base, i behind link i), point (mm in the scanner frame), "
    "ball (mm in the artefact frame), station (local twist), orientation (rad about the target's own axes)"
)


@dataclass(frozen=True)
class DescribedPart:
    """A ``mbcacq.estimation.terms.Part`` whose basis is written down: one column for each coefficient of the effect."""

    place: Annotated[str, Field(description=PLACE), WithJsonSchema({"enum": list(COMPONENTS), "description": PLACE})]
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


def sine(covariate: str, order: Any) -> Column:
    """sin(order * covariate)."""
    return (Product(1.0, (Function(covariate, "sin", (_number(order),)),)),)


def cosine(covariate: str, order: Any) -> Column:
    """cos(order * covariate)."""
    return (Product(1.0, (Function(covariate, "cos", (_number(order),)),)),)


def of(covariate: str, kind: str, *numbers: Any, factor: float = 1.0) -> Column:
    """factor * kind(covariate; numbers)."""
    return (Product(factor, (Function(covariate, kind, tuple(_number(v) for v in numbers)),)),)


def _number(value: Any) -> Any:
    return float(value) if np.ndim(value) == 0 else value


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


def times(*columns: Column) -> Column:
    """The product of columns."""
    first, *others = columns
    for other in others:
        first = tuple(Product(p.factor * q.factor, (*p.functions, *q.functions)) for p in first for q in other)
    return first


def standardized(column: Column, mean: float, spread: float) -> Column:
    """(column - mean) / spread."""
    return (*scaled(column, 1 / spread), Product(-mean / spread))


def evaluate(columns: Sequence[Column], values: Values, rows: int, known: Known | None = None) -> np.ndarray:
    """(rows, k) values of the columns; (H, rows, k) of columns whose numbers or factors are arrays (H, 1).

    known: values of the functions of products that stand in several columns, by identity; those of another call for the same values.
    """
    known = {} if known is None else known
    out: list[Any] = [np.zeros(rows)]
    for column in columns:
        products = [_value(product, values, known) for product in column]
        out.append(sum(products[1:], products[0]) if products else 0.0)
    if not columns:
        return np.zeros((rows, 0))
    each = np.broadcast_arrays(*out)[1:]
    # The rows of a column stay together in memory in a scan: they are summed over.
    return np.stack(each, axis=-1) if each[0].ndim == 1 else np.swapaxes(np.stack(each, axis=1), 1, 2)


def _value(product: Product, values: Values, known: Known) -> np.ndarray | float:
    value = _of_functions(product.functions, values, known)
    return value if np.ndim(product.factor) == 0 and product.factor == 1.0 else product.factor * value


def _of_functions(functions: tuple[Function, ...], values: Values, known: Known) -> np.ndarray | float:
    """The product of functions, computed once for all columns that have the same tuple of them."""
    if not functions:
        return 1.0
    if id(functions) not in known:
        first, *others = functions
        value = first(values)
        for function in others:
            value = value * function(values)
        known[id(functions)] = functions, value
    return known[id(functions)][1]


LEAST_PERIODS = 1.0  # of an order that is only found, which the travel must cover for the claim that the error is periodic


def periods_covered(q: np.ndarray, order: float) -> float:
    """Periods of an order that the travel of a joint q (P,) rad covers."""
    return float(order * np.ptp(q) / (2 * np.pi))
