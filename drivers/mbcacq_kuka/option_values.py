"""Checks of option values that both drivers make. Each raises ConfigError with the robot's name and the option's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from mbcacq.devices import ConfigError

MOST_OUTPUTS = 8  # that may be switched from here: the EKI program has room for so many
LAST_OUTPUT = 4096  # $OUT of every KSS


def refuse_unknown(name: str, given: Iterable[str], known: list[str]) -> None:
    if unknown := sorted(set(given) - set(known)):
        raise ConfigError(f"robot '{name}': unknown option {', '.join(unknown)}; known are {', '.join(known)}")


def array(name: str, key: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """value as finite numbers of this shape."""
    try:
        numbers = np.asarray(value, dtype=float).reshape(shape)
        if not np.isfinite(numbers).all():
            raise ValueError("a value is not finite")
        return numbers
    except (TypeError, ValueError) as error:
        raise ConfigError(f"robot '{name}': option {key} is wrong: {error}") from error


def check_numbers(name: str, options: Any, ranges: Mapping[str, tuple[float, float, bool]]) -> None:
    """ranges: option -> lowest, highest, whether it must be whole. None is let through where the option's type has it."""
    optional = {field.name for field in fields(options) if "None" in str(field.type)}
    for key, (low, high, whole) in ranges.items():
        value = getattr(options, key)
        if value is None and key in optional:
            continue
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)) or not low <= value <= high:
            raise ConfigError(
                f"robot '{name}': option {key} must be a {'whole ' if whole else ''}number from {low:g} to {high:g}, it is {value!r}"
            )


def check_limits(name: str, limits_deg: tuple[tuple[float, float], ...]) -> None:
    if any(low >= high for low, high in limits_deg):
        raise ConfigError(f"robot '{name}': in limits_deg every lower limit must be below the upper one")


def check_positive(name: str, key: str, values: tuple[float, ...] | None) -> None:
    if values is not None and min(values) <= 0:
        raise ConfigError(f"robot '{name}': option {key} must be positive")


def output_numbers(name: str, given: Mapping[str, Any]) -> tuple[int, ...]:
    """The option digital_outputs: numbers of $OUT, each once."""
    numbers = given.get("digital_outputs", ())
    if not isinstance(numbers, list | tuple) or not all(type(n) is int and 1 <= n <= LAST_OUTPUT for n in numbers):
        raise ConfigError(
            f"robot '{name}': option digital_outputs must be a list of whole numbers from 1 to {LAST_OUTPUT}, it is {numbers!r}"
        )
    if len(set(numbers)) != len(numbers) or len(numbers) > MOST_OUTPUTS:
        raise ConfigError(
            f"robot '{name}': option digital_outputs must name up to {MOST_OUTPUTS} outputs, each once, it is {list(numbers)}"
        )
    if numbers and given.get("follow"):
        raise ConfigError(
            f"robot '{name}': an arm that is only followed is sent nothing, digital_outputs neither; leave them out, or remove follow"
        )
    return tuple(numbers)


def check_output(name: str, number: int, allowed: tuple[int, ...]) -> None:
    """Raises ConfigError for an output that the plan does not name."""
    if number not in allowed:
        raise ConfigError(f"robot '{name}': output {number} may not be switched from here; add it to the option digital_outputs")
