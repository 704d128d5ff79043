"""Which effects are a trend, and no finding with a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from mbcacq.quantities import K

NOT_SIZES = ("order", "phase_deg", "at_pose", "time_constant_s", "transition_Nm", "breakpoint_Nm", "zero_deg")
TREND = "a trend: no figure is beyond its expanded uncertainty (k = 2)"


def is_trend(parameters: Mapping[str, tuple[Iterable[float | None], Iterable[float | None]]]) -> bool:
    """Whether no parameter that is a size reaches its expanded uncertainty: the effect helps, but no figure of it may be relied on.

    parameters: by name, the values of its components and their standard deviations.
    """
    sizes = [pairs for name, pairs in parameters.items() if name.rpartition(".")[2] not in NOT_SIZES]
    known = [(v, s) for values, stds in sizes for v, s in zip(values, stds, strict=False) if v is not None and s]
    return bool(known) and all(abs(v) < K * s for v, s in known)


def is_trend_in_json(effect: Mapping[str, Any]) -> bool:
    """``is_trend`` of an effect as a diagnosis is written: 'parameters' with 'value' and 'std', numbers or lists of them."""
    return is_trend({name: components(entry) for name, entry in effect["parameters"].items()})


def components(entry: Mapping[str, Any]) -> tuple[list[float | None], list[float | None]]:
    """Values and standard deviations of the components of a parameter as a diagnosis is written."""
    values, stds = (v if isinstance(v, list) else [v] for v in (entry["value"], entry["std"]))
    return values, stds
