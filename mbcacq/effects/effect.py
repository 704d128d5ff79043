"""The one form of every effect at standstill: locations of the cell that move, by functions of covariates, and a report.

A candidate displaces one or several locations of the cell. Its columns are the products (component of a location) x (function of
the pose or of the centre), each with a coefficient to be estimated. The functions are written down by name
(``mbcacq.effects.functions``), so that the same description is searched, kept in a file, and evaluated at any other pose. They may depend
on one hyper-parameter (an order, a time constant, the moment of a step), for which the values to try are given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from mbcacq.effects.functions import OF_CENTRES, ZERO, Column, DescribedPart
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import Number
from mbcacq.quantities import K, in_degrees, measured, split_unit

# What a hyper-parameter is; the search knows how each of these is refined, how uncertain it is and what it is confused with.
MOMENT = "moment"  # rank in time of the first pose after a change
ORDER = "order"  # periods a turn of the angle that the effect depends on
BREAKPOINT = "breakpoint"  # value of a covariate at which something changes
FADING = "fading"  # time constant of something that fades

JOINTS = ("A", "E")  # how the names of joints begin
ON_THE_ARM = (*JOINTS, "link", "base")  # how the locations begin that several recordings of one arm share


class Missing(Exception):
    """The recording lacks what an effect needs; the message says what."""


@dataclass(frozen=True)
class Hyperparameter:
    """A bounded parameter in which an effect is not linear.

    Attributes
    ----------
    name : str
        Under which it is reported, empty if it is not.
    values : ndarray
        (H,) values to try first.
    independent : float
        The number of statistically independent choices among all values.
    refine : bool
        Whether the best of the values is a start for a continuous search.
    preferred : tuple[float, ...]
        Values that are more probable beforehand than all others.
    kind : str
        MOMENT, ORDER, BREAKPOINT or FADING, empty for any other.
    from_none : bool
        The first value stands for no such effect at all, and is no bound of what was tried.
    """

    name: str
    values: np.ndarray
    independent: float
    refine: bool = True
    preferred: tuple[float, ...] = ()
    kind: str = ""
    from_none: bool = False


@dataclass(frozen=True)
class HyperEstimate:
    """The value of a hyper-parameter and its standard deviation: 0 where that is not estimated. Not a number for an effect without one."""

    value: float
    std: float = 0.0


@dataclass(frozen=True)
class ParameterEstimate:
    """A reported parameter and its standard deviation, in the unit that its name ends with; tuples where it has several components."""

    value: Number | tuple[Number, ...]
    std: Number | tuple[Number, ...]

    def __str__(self) -> str:
        return self.shown("")

    @property
    def components(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Values and standard deviations, of one component as well."""
        values, stds = (x if isinstance(x, tuple) else (x,) for x in (self.value, self.std))
        return values, stds

    def only(self, numbers: Sequence[int]) -> ParameterEstimate:
        """The components of these numbers, counted from 0."""
        values, stds = self.components
        return ParameterEstimate(tuple(values[k] for k in numbers), tuple(stds[k] for k in numbers))

    def shown(self, unit: str, factor: float = 1.0) -> str:
        """Value and expanded uncertainty (k = 2) in a unit of which ``factor`` make one of the stored; each component by itself."""
        return ", ".join(measured(factor * v, factor * K * s, unit) for v, s in zip(*self.components, strict=True))


def parameter_in_words(name: str, estimate: ParameterEstimate) -> str:
    """'A2 compliance (2.09 ± 0.18) µrad/(N·m)': name, value and expanded uncertainty (k = 2) with the unit that the name ends with."""
    words, unit, factor = split_unit(name)
    return f"{words} {estimate.shown(unit, factor)}"


Parameters = Mapping[str, ParameterEstimate]
Report = Callable[[np.ndarray, np.ndarray, HyperEstimate], Parameters]
Described = Sequence[DescribedPart] | Callable[[Any], Sequence[DescribedPart]]


class EffectRows(Protocol):
    """What an effect adds to the rows of a kind of recording, linear in its coefficients: ``StandstillRows``, or ``MotionRows`` in time."""

    hyper_digits: ClassVar[int | None]

    @property
    def typical(self) -> np.ndarray: ...


R = TypeVar("R", bound=EffectRows)


@dataclass(frozen=True)
class StandstillRows:
    """What an effect displaces in poses at standstill.

    Attributes
    ----------
    described
        The parts that move, as functions of covariates; with a hyper-parameter, a function of its value that returns them. It is also
        called with an array (H, 1) of values, and then passes these on to its functions as they are.
    typical
        (k,) size of each coefficient in a real cell. From it follow whether these poses can observe the effect, and how probable each size
        of it is.
    """

    hyper_digits: ClassVar[int | None] = 1  # by which values of a hyper-parameter are told apart

    described: Described
    typical: np.ndarray


@dataclass(frozen=True)
class PriorOdds:
    """What the class of the arm says of an effect beforehand.

    Attributes
    ----------
    odds
        Prior odds of the effect beside another one.
    beside
        The other one (``name:where``), through which it shows; without that one it is as rare as any other.
    """

    odds: float
    beside: str


@dataclass(frozen=True)
class Support:
    """What physics allows of an effect at a location, beside the sign: the support of the prior of its size.

    Attributes
    ----------
    largest
        Size of a coefficient, in its own unit, that no such effect exceeds; one number, or one for each coefficient.
    limit
        What makes that impossible, as the end of a sentence.
    refused
        The sentence on the name that an unmodelled effect cannot have; empty for others.
    """

    largest: float | np.ndarray = np.inf
    limit: str = ""
    refused: str = ""


ANY_SIZE = Support()


@dataclass(frozen=True)
class Candidate(Generic[R]):
    """One effect at one location, ready to be tested in recordings of one kind: of poses, or of motion.

    Attributes
    ----------
    name, where, depends_on
        Name of the effect, its locations, and the covariate that it is reported to depend on.
    rows
        What it adds to a recording: ``StandstillRows`` or ``MotionRows``.
    report
        (coefficients (k,), covariance (k, k), hyper-parameter with its standard deviation) -> parameters by name.
    hyper
        The hyper-parameter, if there is one.
    positive
        The first coefficient can only be positive.
    several
        One location may have the effect several times, each with its own value of the hyper-parameter (several orders), or as each of its
        variants.
    variant
        Tells candidates of one effect at one location apart, of which at most one is selected unless there may be several.
    rarity
        Share of the arms like this one that can have the effect at all, by which it is less probable beforehand.
    usual
        Its prior odds beside the effect through which it shows, if most arms like this one have it.
    least_size
        Size of its coefficients, in typical ones, below which an arm like this one does not have it.
    support
        What physics allows of its size.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    rows: R = field(compare=False)
    report: Report
    hyper: Hyperparameter | None = None
    positive: bool = False
    several: bool = False
    variant: str = ""
    rarity: float = 1.0
    usual: PriorOdds | None = None
    least_size: float = 0.0
    support: Support = field(default=ANY_SIZE, compare=False)

    def __post_init__(self) -> None:
        if not hasattr(self.rows, "typical"):
            raise ConfigError(
                f"the effect {self.name} has a {type(self.rows).__name__} for its rows; give StandstillRows(parts, typical) for poses, or "
                "MotionRows(joints, columns) for motion"
            )

    @property
    def typical(self) -> np.ndarray:
        """(k,) sizes of the coefficients."""
        return self.rows.typical

    @property
    def k(self) -> int:
        """The number of coefficients."""
        return len(self.typical)

    @property
    def location(self) -> tuple[str, tuple[str, ...]]:
        """Name and location: what identifies an effect whatever its form."""
        return self.name, self.where

    @property
    def label(self) -> str:
        """``name:where``."""
        return label_of(self.name, self.where)

    @property
    def form(self) -> tuple[tuple[str, tuple[str, ...]], str]:
        """Location and variant."""
        return self.location, self.variant

    @property
    def key(self) -> str:
        """Identifies the candidate among all of a recording."""
        return f"{self.label}:{self.depends_on}:{self.variant}"

    def parameters(self, c: np.ndarray, v: np.ndarray, hyper: float | None = None, std: float = 0.0) -> Parameters:
        """What coefficients (k,) with covariance (k, k) are reported as. hyper, std: value of the hyper-parameter and its uncertainty."""
        return self.report(c, v, HyperEstimate(np.nan if hyper is None else hyper, std))

    def parts(self: Candidate[StandstillRows], hyper: Any = None) -> tuple[DescribedPart, ...]:
        """The parts at a value of the hyper-parameter, or at an array (H, 1) of values."""
        described = self.rows.described
        return tuple(described(hyper) if callable(described) else described)

    @cached_property
    def components(self: Candidate[StandstillRows]) -> tuple[tuple[str, int, int], ...]:
        """The (place, index, component) of its parts if all are multiplied by the same functions of the pose, so that all values of the
        hyper-parameter can be scanned at once. Coefficients are then ordered component by component. Empty for other effects.
        """
        if self.hyper is None:
            return ()
        parts = self.parts(float(self.hyper.values[0]))
        f = self.k // max(len(parts), 1)
        if not parts or f * len(parts) != self.k or any(p.covariates & set(OF_CENTRES) for p in parts):
            return ()
        own = parts[0].columns[:f]
        alike = all(p.columns == _placed(own, j, len(parts)) for j, p in enumerate(parts))
        return tuple((p.place, p.index, p.component) for p in parts) if alike else ()

    def functions(self: Candidate[StandstillRows], values: np.ndarray) -> tuple[Column, ...]:
        """The functions by which each component of an effect with ``components`` is multiplied, at values (H,) of the hyper-parameter."""
        (first, *_) = self.parts(values[:, None])
        return first.columns[: self.k // len(self.components)]

    @property
    def periodic(self) -> bool:
        """Whether the hyper-parameter is the order of a periodic function."""
        return self.hyper is not None and self.hyper.kind == ORDER


def _placed(own: tuple[Column, ...], j: int, count: int) -> tuple[Column, ...]:
    """The columns of component j of ``count``, which are zero for the coefficients of all others."""
    return (ZERO,) * (j * len(own)) + own + (ZERO,) * ((count - 1 - j) * len(own))


def label_of(name: str, where: Iterable[str]) -> str:
    """``name:where`` of an effect; several harmonics of a joint are one."""
    return f"{name}:{'+'.join(where)}"


def number(value: float, std: float) -> ParameterEstimate:
    """A parameter of one component."""
    return ParameterEstimate(float(value), float(std))


def vector(values: np.ndarray, covariance: np.ndarray) -> ParameterEstimate:
    """A parameter of several components, from its values (k,) and their covariance (k, k)."""
    return ParameterEstimate(tuple(float(v) for v in values), tuple(float(s) for s in np.sqrt(np.diag(covariance))))


def angle(value: float, std: float) -> ParameterEstimate:
    """``number`` of an angle in rad, stated in deg."""
    return number(in_degrees(value), in_degrees(std))


def angles(values: np.ndarray, covariance: np.ndarray) -> ParameterEstimate:
    """``vector`` of angles in rad, stated in deg."""
    return vector(in_degrees(values), in_degrees(in_degrees(covariance)))


def standard_deviations(covariance: np.ndarray) -> np.ndarray:
    """(k,) from a covariance (k, k); rounding may leave a variance slightly below zero."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def plain_report(*names: str, scale: float = 1.0, hyper_name: str | None = None) -> Report:
    """The report of coefficients as they are, by name, converted by ``scale`` to the unit that the names end with, and of the
    hyper-parameter by its name.
    """

    def report(c: np.ndarray, v: np.ndarray, hyper: HyperEstimate) -> Parameters:
        std = abs(scale) * standard_deviations(v)
        out = {name: number(scale * c[k], std[k]) for k, name in enumerate(names)}
        return out if hyper_name is None else out | {hyper_name: number(hyper.value, hyper.std)}

    return report


def joined_parameters(each: Iterable[Parameters]) -> dict[str, ParameterEstimate]:
    """The parameters of several effects; a name that occurs several times (several orders at one joint) gets a tuple of values."""
    out: dict[str, ParameterEstimate] = {}
    for parameters in each:
        for name, new in parameters.items():
            if name in out:
                (values, stds), (more, spread) = out[name].components, new.components
                new = ParameterEstimate((*values, *more), (*stds, *spread))
            out[name] = new
    return out


def plain_effect(
    name: str, where: Sequence[str], depends_on: str, described: Described, parameters: Mapping[str, float], **fields: Any
) -> Candidate:
    """An effect whose coefficients are its parameters.

    Parameters
    ----------
    name, where, depends_on, described
        As of ``Candidate``.
    parameters
        The name under which each coefficient is reported, which ends with its unit, and its typical size in a real cell.
    fields
        Further fields of ``Candidate`` (``hyper``, ``positive``, ``several``, ``variant``).
    """
    typical = np.array(list(parameters.values()), dtype=float)
    return Candidate(name, tuple(where), depends_on, StandstillRows(described, typical), plain_report(*parameters), **fields)
