"""A run has both: poses at standstill and the motion between them. A parameter found in both must agree."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.options import DEFAULTS
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.diagnosis.motion.text import motion_text
from mbcacq.quantities import K, measured, split_unit


@dataclass(frozen=True)
class SingleEstimate:
    """A value with its standard deviation."""

    value: float
    std: float

    def shown(self, parameter: str) -> str:
        """With its expanded uncertainty (k = 2) in the unit of the parameter's name."""
        _, unit, factor = split_unit(parameter)
        return measured(factor * self.value, K * factor * self.std, unit)


@dataclass(frozen=True)
class ParameterAgreement:
    """A parameter of an effect that was found in the poses and in the motion. sigmas: their distance in combined standard deviations."""

    name: str
    parameter: str
    poses: SingleEstimate
    motion: SingleEstimate
    sigmas: float
    agrees: bool


def combined(poses: dict[str, Any], motion: MotionDiagnosis) -> dict[str, Any]:
    """The JSON of the pose diagnosis with that of the motion (``motion``), and what both found (``agreement``)."""
    return poses | {"motion": motion.to_json(), "agreement": [asdict(a) for a in agreement(poses, motion)]}


def agreement(poses: dict[str, Any], motion: MotionDiagnosis, sigmas: float = DEFAULTS.agreement_sigmas) -> list[ParameterAgreement]:
    """Every parameter that both found, as single numbers. poses: JSON of the pose diagnosis; sigmas: within which two values agree."""
    found = {(e.name, key): p for e in motion.effects for key, p in e.parameters.items()}
    out = []
    for effect in poses["effects"]:
        for key, entry in effect["parameters"].items():
            mine, other = _estimate(entry), _estimate(found.get((effect["name"], key), {}))
            if mine is None or other is None:
                continue
            distance = float(abs(mine.value - other.value) / max(float(np.hypot(mine.std, other.std)), 1e-300))
            out.append(ParameterAgreement(effect["name"], key, mine, other, distance, distance <= sigmas))
    return out


def _estimate(entry: Any) -> SingleEstimate | None:
    """None for a parameter that is missing, not finite or a list."""
    value, std = entry.get("value"), entry.get("std")
    return None if value is None or std is None or np.ndim(value) or np.ndim(std) else SingleEstimate(value, std)


def combined_text(poses: dict[str, Any], text: str, motion: MotionDiagnosis) -> str:
    """poses, text: the pose diagnosis as JSON and in words."""
    lines = ["Poses, at standstill", "====================", text, ""]
    lines += ["Motion, between the poses", "=========================", motion_text(motion)]
    found = agreement(poses, motion)
    if found:
        lines += ["", "Found in both:"]
        lines += [
            f"  {split_unit(a.parameter)[0]}: {a.poses.shown(a.parameter)} from the poses, {a.motion.shown(a.parameter)} from the motion: "
            f"{'they agree' if a.agrees else 'they do not agree'} ({a.sigmas:.1f} sigma)"
            for a in found
        ]
    return "\n".join(lines)
