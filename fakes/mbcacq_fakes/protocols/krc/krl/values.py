"""Values of KRL, with its strictness: a BOOL is no number, an INT is rounded, a structure is copied."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

INT, REAL, BOOL = "INT", "REAL", "BOOL"


class KrlError(Exception):
    """A program that a controller would refuse, or stop."""


class Struct:
    """FRAME, AXIS, EKI_STATUS...: members by lower-case name."""

    if TYPE_CHECKING:  # members are named by the programs

        def __getattr__(self, name: str) -> Any: ...

        def __setattr__(self, name: str, value: Any) -> None: ...

    def __init__(self, **members: Any) -> None:
        self.__dict__.update(members)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Struct) and self.__dict__ == other.__dict__

    def __repr__(self) -> str:
        return "{" + ",".join(f"{k.upper()} {v}" for k, v in self.__dict__.items()) + "}"


class Cells(list):
    """A KRL array: indices count from 1."""

    def __init__(self, size: int, value: Any = None) -> None:
        super().__init__([None] + [value] * size)

    def _check(self, index: Any) -> int:
        if not isinstance(index, int) or not 1 <= index < len(self):
            raise KrlError(f"array index {index!r} is not between 1 and {len(self) - 1}")
        return index

    def __getitem__(self, index: Any) -> Any:
        return super().__getitem__(self._check(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(self._check(index), value)


def fit(kind: str, value: Any) -> Any:
    """``value`` as a variable of type ``kind`` takes it. Raises KrlError."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind == INT and number:
        return value if isinstance(value, int) else round(value)
    if kind == REAL and number:
        return float(value)
    if kind in (INT, REAL) or (kind == BOOL and not isinstance(value, bool)):
        raise KrlError(f"{value!r} is no {kind}")
    if isinstance(value, Struct):
        return Struct(**value.__dict__)
    return value


def divide(a: Any, b: Any) -> Any:
    """INT by INT cuts off, as KRL does."""
    if isinstance(a, int) and isinstance(b, int):
        return int(a / b)
    return a / b


def logical(*values: Any) -> tuple[bool, ...]:
    for value in values:
        if not isinstance(value, bool):
            raise KrlError(f"{value!r} is no BOOL")
    return values


def both(a: Any, b: Any) -> bool:
    return all(logical(a, b))


def either(a: Any, b: Any) -> bool:
    return any(logical(a, b))


def differ(a: Any, b: Any) -> bool:
    return a is not b if logical(a, b) else False


def negate(a: Any) -> bool:
    return not logical(a)[0]


def equal(a: Any, b: Any) -> bool:
    """Comparing a BOOL with a number, or with what was never set, is an error of the program."""
    if a is None or b is None or isinstance(a, bool) != isinstance(b, bool):
        raise KrlError(f"{a!r} and {b!r} cannot be compared")
    return a == b
