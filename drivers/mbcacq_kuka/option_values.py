"""Options that both drivers have, and the values that they check alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from mbcacq.devices import ConfigError, DriverOptions

MOST_OUTPUTS = 8  # that may be switched from here: the EKI program has room for so many
LAST_OUTPUT = 4096  # $OUT of every KSS


def _rising(limits: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    if any(low >= high for low, high in limits):
        raise ValueError("every lower limit must be below the upper one")
    return limits


def _positive(values: tuple[float, ...]) -> tuple[float, ...]:
    if min(values) <= 0:
        raise ValueError("every value must be positive")
    return values


def _outputs(numbers: Any) -> Any:
    if not isinstance(numbers, list | tuple) or not all(type(n) is int and 1 <= n <= LAST_OUTPUT for n in numbers):
        raise ValueError(f"it must be a list of whole numbers from 1 to {LAST_OUTPUT}, not {numbers!r}")
    if len(set(numbers)) != len(numbers) or len(numbers) > MOST_OUTPUTS:
        raise ValueError(f"it must name up to {MOST_OUTPUTS} outputs, each once, not {list(numbers)}")
    return tuple(numbers)


Six = Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]
PositiveSix = Annotated[Six, AfterValidator(_positive)]
OneOrSix = Annotated[PositiveSix, BeforeValidator(lambda value: [value] * 6 if isinstance(value, int | float) else value)]


class KukaOptions(DriverOptions):
    """limits_deg: (6, 2) joint limits. connect_timeout_s: how long to wait for the controller. silence_s: without a telegram or state that
    long is a fault. follow: of the plan's robot section: a person, or another program, moves the arm. digital_outputs: numbers n of the
    outputs $OUT[n] that may be switched from here, as to trigger a scanner.
    """

    limits_deg: Annotated[tuple[tuple[float, float], ...], AfterValidator(_rising)] = Field(
        description="the joint limits, six pairs in °", min_length=6, max_length=6
    )
    connect_timeout_s: float = Field(default=30.0, ge=1e-3, le=1e6, strict=True)
    silence_s: float = Field(default=1.0, ge=1e-2, le=1e3, strict=True)
    follow: bool = Field(default=False, strict=True)
    digital_outputs: Annotated[tuple[int, ...], BeforeValidator(_outputs)] = ()

    @model_validator(mode="after")
    def _sends_nothing(self) -> KukaOptions:
        if self.digital_outputs and self.follow:
            raise ValueError("an arm that is only followed is sent nothing, digital_outputs neither; leave them out, or remove follow")
        return self


def check_output(name: str, number: int, allowed: Sequence[int]) -> None:
    """Raises ConfigError for an output that the plan does not name."""
    if number not in allowed:
        raise ConfigError(f"robot '{name}': output {number} may not be switched from here; add it to the option digital_outputs")
