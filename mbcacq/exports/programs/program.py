"""A program as its text and the joint targets in it; what is written anew are their numbers alone, every other byte stays."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import numpy as np
from lark import Lark
from lark.exceptions import LarkError

from mbcacq.quantities import DEGREE

LINE_END = re.compile(r"\r\n|\r|\n")  # and no other: to Python's splitlines byte 0x85 ends a line too
# What names say of coordinates that are no place: tolerances, steps, offsets, limits, speeds.
NO_PLACE = re.compile(
    r"tol|offs|delta|step|incr|rel(?![a-z])|diff|limit|^max|^min|max$|min$|(?<!le)vel|acc(?!ess)|speed|dist|range|window", re.IGNORECASE
)


@cache
def parser_of(grammar: str) -> Any:
    """The parser of one statement of a robot's language; grammar: the file beside this one that describes it."""
    return Lark.open(grammar, rel_to=__file__, parser="lalr", maybe_placeholders=False)


LeftAlone = tuple[str, int, str]  # name, line and reason


@dataclass(frozen=True)
class ProgrammedPoint:
    """angles: (n,) rad as the program counts them; spans: where each number stands in the text; unit: rad of one of each."""

    name: str
    line: int
    angles: np.ndarray
    spans: tuple[tuple[int, int], ...]
    unit: tuple[float, ...]


@dataclass(frozen=True)
class RobotProgram:
    """The joint targets of a controller's program.

    Attributes
    ----------
    points : tuple[ProgrammedPoint, ...]
        The absolute joint targets.
    left_alone : tuple[LeftAlone, ...]
        Name, line and reason of each that looks like one and stays as it is.
    coupling : ndarray or None
        (n, n), the joint angles of the arm's description from those of the program, where a controller counts them otherwise.
    """

    text: str
    points: tuple[ProgrammedPoint, ...]
    left_alone: tuple[LeftAlone, ...] = ()
    coupling: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def q(self) -> np.ndarray:
        """(P, n) rad."""
        angles = np.array([point.angles for point in self.points])
        return angles if self.coupling is None else angles @ self.coupling.T

    def written(self, q: np.ndarray, reached: Sequence[bool]) -> str:
        """The text with joint angles q (P, n) rad; a point that is not ``reached`` keeps the programmed ones."""
        angles = q if self.coupling is None else q @ np.linalg.inv(self.coupling).T
        edits: list[tuple[int, int, str]] = []
        for point, row, ok in zip(self.points, angles, reached, strict=True):
            if ok:
                for (begin, end), value, unit in zip(point.spans, row, point.unit, strict=True):
                    edits.append((begin, end, number(value / unit, 9 if unit == 1.0 else 6)))
        parts, at = [], 0
        for begin, end, new in sorted(edits):
            parts += [self.text[at:begin], new]
            at = end
        return "".join([*parts, self.text[at:]])


def number(value: float, decimals: int) -> str:
    """The number with so many decimals; 1e-6 of a degree is 0.02 um at a metre."""
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text


@dataclass
class Uses:
    """Where a program uses a variable: as the target of an absolute motion, as an increment, as a mere hint, or otherwise."""

    absolute: list[int] = field(default_factory=list)
    relative: list[int] = field(default_factory=list)
    otherwise: list[int] = field(default_factory=list)

    def add(self, other: Uses) -> None:
        """Take in further places."""
        self.absolute += other.absolute
        self.relative += other.relative
        self.otherwise += other.otherwise

    def reason(self, name: str) -> str:
        """Why the coordinates of a variable are not to be touched, '' where they are a target."""
        if self.relative:
            return f"is the increment of a relative motion (line {self.relative[0]})"
        if 0 in self.absolute and NO_PLACE.search(name):  # used by no program that is known: the name alone says what it is
            return "is by its name no place, but a tolerance, a step or a limit"
        if self.absolute and self.otherwise:
            return f"is a target, and is used otherwise too (line {self.otherwise[0]})"
        if self.otherwise:
            return f"is not the target of a motion, but used otherwise (line {self.otherwise[0]})"
        return "" if self.absolute else "is the target of no motion in this program"


class Variables(dict[str, Uses]):
    """Uses by the name in lower case."""

    def __missing__(self, name: str) -> Uses:
        self[name] = Uses()
        return self[name]

    def add(self, others: Variables) -> None:
        """Take in what another program does with the same variables."""
        for name, uses in others.items():
            self[name].add(uses)


DEGREES = DEGREE  # rad of one


class Statements:
    """What the statements of a program hold.

    A language derives its own, with the file of the ``grammar`` of a statement, the mark of a ``comment`` to the end of a line, the names
    that ``word`` finds, and what is ``doubtful``: what may be a point in a statement that is not understood.
    """

    grammar: ClassVar[str]
    comment: ClassVar[str] = ""
    word: ClassVar[re.Pattern[str]] = re.compile(r"[A-Za-z_]\w*")
    doubtful: ClassVar[re.Pattern[str]]

    def __init__(self, n: int) -> None:
        self.n = n
        self.uses = Variables()
        self.points: list[tuple[str, str, ProgrammedPoint]] = []  # variable or '', reason that is known already, point
        self.left: list[LeftAlone] = []

    def parsed(self, code: str, number: int, what: str = "line") -> list[Any]:
        """The pieces of a statement in a line; none where it is not understood: what it names is then no target."""
        try:
            return parser_of(self.grammar).parse(code).children
        except LarkError:
            plain = code.split(self.comment, 1)[0] if self.comment else code
            for word in self.word.findall(plain):
                self.uses[word.lower()].otherwise.append(number)
            if self.doubtful.search(plain):
                self.left.append((f"line {number}", number, f"is a {what} that is not understood"))
            return []

    def point(self, variable: str, name: str, number: int, at: int, numbers: Sequence[tuple[Any, float]], reason: str = "") -> None:
        """Coordinates of all axes. at: place of the statement; numbers: the token of each and its unit in rad."""
        spans = tuple((at + token.start_pos, at + token.end_pos) for token, _ in numbers)
        angles = np.array([float(token) * unit for token, unit in numbers])
        self.points.append((variable, reason, ProgrammedPoint(name, number, angles, spans, tuple(unit for _, unit in numbers))))

    def reason(self, variable: str) -> str:
        """Why the coordinates of a variable are not to be touched, '' where they are a target."""
        return self.uses[variable].reason(variable)

    def program(self, text: str, notes: tuple[str, ...] = ()) -> RobotProgram:
        """The points that are targets, and the others with the reason of each. notes: where there are points."""
        points, left = [], list(self.left)
        for variable, known, point in self.points:
            if reason := known or (self.reason(variable) if variable else ""):
                left.append((point.name, point.line, reason))
            else:
                points.append(point)
        return RobotProgram(text, tuple(points), tuple(sorted(left, key=lambda one: one[1])), notes=notes if points else ())


def kind(piece: Any) -> str:
    """The rule or the terminal of the grammar that a piece of a statement is of."""
    return getattr(piece, "data", "") or getattr(piece, "type", "")


def lines(text: str) -> Iterable[tuple[int, int, str]]:
    """Number from 1, place in the text, and content of each line."""
    at, count = 0, 1
    for match in LINE_END.finditer(text):
        yield count, at, text[at : match.start()]
        at, count = match.end(), count + 1
    yield count, at, text[at:]


class LineNumbers:
    """The line of each place in a text, from 1."""

    def __init__(self, text: str) -> None:
        self._ends = [match.end() for match in LINE_END.finditer(text)]

    def __call__(self, place: int) -> int:
        return bisect_right(self._ends, place) + 1


def names_in(tree: Any) -> Iterable[str]:
    """All names that stand anywhere in a piece of a statement, in lower case."""
    stack = [tree]
    while stack:
        here = stack.pop()
        if hasattr(here, "children"):
            stack += here.children
        elif kind(here) == "NAME":
            yield str(here).lower()
