"""Score of a diagnosis of motion against the injected effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.result import MotionDiagnosis

Truth = Mapping[str, Any]
Location = tuple[str, tuple[str, ...]]

PERIOD = {"phase_deg": 360.0}  # of a parameter that is an angle of a periodic component
SAME_ORDER = 0.5  # periods per turn within which two periodic components are the same


@dataclass(frozen=True)
class MotionScore:
    """identified: every effect that is detectable is reported, with name and location, before any that was not injected. false_names:
    effects reported that were not injected; reported: all. sigmas: errors of parameters in stated standard deviations."""

    identified: bool
    false_names: list[str]
    reported: list[str]
    sigmas: dict[str, float]


def score_motion(truth: Sequence[Truth], detectable: Sequence[bool], diagnosis: MotionDiagnosis) -> MotionScore:
    """truth: the injected effects, each with name, where and parameters; detectable: which of them must be found."""
    injected = {_location(t) for t in truth}
    required = {_location(t) for t, needed in zip(truth, detectable, strict=True) if needed}
    reported = {(e.name, e.where): e.parameters for e in diagnosis.named_effects}
    first: list[Location] = []
    for location in reported:
        if location not in injected:
            break
        first.append(location)
    sigmas: dict[str, float] = {}
    for t in truth:
        if _location(t) in reported:
            errors = _errors(t["parameters"], reported[_location(t)])
            sigmas |= {f"{t['name']}:{key}": value for key, value in errors.items()}
    false_names = [_text(location) for location in reported if location not in injected]
    return MotionScore(required <= set(first), false_names, [_text(location) for location in reported], sigmas)


def _location(truth: Truth) -> Location:
    return truth["name"], tuple(truth["where"])


def _text(location: Location) -> str:
    return f"{location[0]}:{'+'.join(location[1])}"


def _errors(truth: Mapping[str, Any], found: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Largest error among the components of each parameter; of several periodic components that of the nearest order counts."""
    component = _nearest_order(truth, found)
    if component is not None and component < 0:
        return {}
    out = {}
    for key in [k for k in truth if k in found]:
        value, std = (np.atleast_1d(found[key][part]).astype(float) for part in ("value", "std"))
        if component is not None:
            value, std = value[[component]], std[[component]]
        error = value - np.atleast_1d(truth[key])
        period = PERIOD.get(key.rpartition(".")[2])
        if period is not None:
            error = (error + period / 2) % period - period / 2
        if (std > 0).all():
            out[key] = float(np.max(np.abs(error) / std))
    return out


def _nearest_order(truth: Mapping[str, Any], found: Mapping[str, Mapping[str, Any]]) -> int | None:
    """Which of several periodic components is meant, -1 if none is near; None for an effect without an order."""
    key = next((k for k in truth if k.endswith(".order")), None)
    if key is None or key not in found:
        return None
    distances = np.abs(np.atleast_1d(found[key]["value"]) - truth[key])
    nearest = int(np.argmin(distances))
    return nearest if distances[nearest] <= SAME_ORDER else -1
