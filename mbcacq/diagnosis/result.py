"""The diagnosis as one object, and as the JSON that other programs read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

FORMAT = "mbcacq-diagnosis/1"


@dataclass
class EffectFound:
    name: str
    where: list[str]
    depends_on: str
    parameters: dict[str, dict[str, Any]]
    p_value: float
    held_out_gain: float
    alternatives: list[dict[str, Any]] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        out = {
            "name": self.name,
            "where": self.where,
            "parameters": self.parameters,
            "p_value": self.p_value,
            "held_out_gain": self.held_out_gain,
            "alternatives": self.alternatives,
            "depends_on": self.depends_on,
        }
        return out


@dataclass
class Diagnosis:
    """verdict as in the contract; dropped: effect -> what the recording lacks; notes: further sentences for people.

    evidence: what pictures are drawn from (``figures.Evidence``); not part of the JSON.
    """

    verdict: str
    mismatch: list[dict[str, Any]]
    effects: list[EffectFound]
    fit: dict[str, Any]
    not_separable: list[dict[str, Any]]
    advice: list[dict[str, Any]]
    dropped: dict[str, str]
    notes: list[str]
    evidence: Any = None

    def as_json(self) -> dict[str, Any]:
        return plain(
            {
                "format": FORMAT,
                "verdict": self.verdict,
                "mismatch": self.mismatch,
                "effects": [e.as_json() for e in self.effects],
                "fit": self.fit,
                "not_separable": self.not_separable,
                "advice": self.advice,
                "dropped": self.dropped,
                "notes": self.notes,
            }
        )


def plain(value: Any) -> Any:
    """Only what JSON has: numpy numbers become numbers, what is not finite becomes null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
