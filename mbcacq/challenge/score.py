"""The opened envelope against the diagnosis: both are plain data, the diagnosis as its JSON says it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import takewhile
from typing import Any

import numpy as np

from mbcacq.challenge.scenarios import COMPANIONS

WITHIN = 3.0
ORDER_TOLERANCE = 0.1


@dataclass(frozen=True)
class Score:
    """One challenge. achievable: share of the held-out chi2 that the true model takes away; counts: whether that is worth naming.

    named, placed: every concealed effect (of several: each that adds something) is told, before any other, by its name and at its place.
    located: the first entry of ``mismatch`` is a place of a concealed effect. extra: named effects that were not concealed. share: of the
    achievable improvement (None for an effect of one station, of which others know nothing, and where another effect goes with it).
    sigmas: errors of the parameters in units of their stated sigma. confident: a wrong name with the verdict 'explained'.
    """

    kind: str
    truth: list[str]
    told: list[str]
    verdict: str
    achievable: float
    counts: bool
    detected: bool
    named: bool
    placed: bool
    located: bool
    confident: bool
    extra: list[str]
    share: float | None
    sigmas: dict[str, float] = field(default_factory=dict)
    improvement: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def score(
    kind: str, truth: list[dict[str, Any]], diagnosis: dict[str, Any], achievable: float, worth: float = 0.1, catalogued: bool = True
) -> Score:
    """truth: the concealed effects with name, where and parameters; of several each with what it ``adds`` to the others. achievable, worth,
    adds: shares of the held-out chi2.
    """
    effects, mismatch = diagnosis["effects"], diagnosis["mismatch"]
    names = {t["name"] for t in truth}
    beside = {c for name in names for c in COMPANIONS.get(name, ())} - names
    claimed = [e for e in effects if e["name"] not in ("unknown", *beside)]
    must = {t["name"] for t in truth if t.get("adds", worth) >= worth}
    first = list(takewhile(lambda e: e["name"] in names, (e for e in effects if e["name"] not in beside)))
    named = bool(first) and must <= {e["name"] for e in first}
    placed = named and all(at_place(e, next(t for t in truth if t["name"] == e["name"])) for e in first)
    where = {w for t in truth for w in (*t["where"], *t.get("seen_at", ()))}
    located = bool(mismatch) and mismatch[0]["at"] in where
    wrong = [e["name"] for e in claimed if e["name"] not in names]
    fit = diagnosis["fit"]["held_out"]
    improvement = 1.0 - fit["after_chi2_dof"] / fit["before_chi2_dof"] if fit["before_chi2_dof"] else 0.0
    alone = any(w.startswith("station") for w in where)  # on other stations than its own such an effect improves nothing
    sigmas = {}
    for t in truth:
        mine = next((e for e in claimed if e["name"] == t["name"] and at_place(e, t)), None)
        if mine is not None:
            sigmas |= {f"{t['name']}.{k}": v for k, v in parameter_errors(t, mine["parameters"]).items()}
    return Score(
        kind=kind,
        truth=[label(t) for t in truth],
        told=[label(e) for e in effects],
        verdict=diagnosis["verdict"],
        achievable=achievable,
        counts=bool(truth) and achievable >= worth,
        detected=diagnosis["verdict"] != "none",
        named=named and catalogued,
        placed=placed and catalogued,
        located=located,
        confident=diagnosis["verdict"] == "explained" and bool(wrong),
        extra=wrong,
        share=None if not truth or achievable <= 0 or alone or beside else improvement / achievable,
        sigmas=sigmas,
        improvement=improvement,
    )


def label(effect: dict[str, Any]) -> str:
    return f"{effect['name']}:{'+'.join(effect['where'])}"


def at_place(told: dict[str, Any], truth: dict[str, Any]) -> bool:
    """No place but those concealed; a coupling needs both of its joints."""
    there, true = set(told["where"]), set(truth["where"])
    return there == true if truth["name"] == "wrist_coupling" else bool(there) and there <= true


def parameter_errors(truth: dict[str, Any], told: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Largest error of each parameter in units of its stated sigma. Parameters told without a sigma (an order from a grid) are left out."""
    if truth["name"] == "gear_transmission_error":
        return _orders(truth, told)
    out = {}
    for key, entry in told.items():
        place, _, name = key.rpartition(".")
        true = truth.get(name)
        if isinstance(true, dict):
            true = true.get(place)
        if true is None:
            continue
        value, std = np.atleast_1d(entry["value"]).astype(float), np.atleast_1d(entry["std"]).astype(float)
        true = np.broadcast_to(np.asarray(true, dtype=float), value.shape) if np.size(true) in (1, value.size) else None
        if true is None or not np.any(std > 0):
            continue
        use = std > 0
        out[key] = float(np.max(np.abs(value - true)[use] / std[use]))
    return out


def _orders(truth: dict[str, Any], told: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Amplitude and phase of the told order that is nearest to each concealed one."""
    out = {}
    place = truth["where"][0]
    columns = {name: np.atleast_1d(told[f"{place}.{name}"]["value"]).astype(float) for name in ("order", "amplitude_deg", "phase_deg")}
    std = {name: np.atleast_1d(told[f"{place}.{name}"]["std"]).astype(float) for name in ("amplitude_deg", "phase_deg")}
    for order, amplitude, phase in zip(truth["order"], truth["amplitude_deg"], truth["phase_deg"], strict=True):
        j = int(np.argmin(np.abs(columns["order"] - order)))
        if abs(columns["order"][j] - order) > ORDER_TOLERANCE:
            continue
        turn = (columns["phase_deg"][j] - phase + 180) % 360 - 180
        for name, error in (("amplitude_deg", columns["amplitude_deg"][j] - amplitude), ("phase_deg", turn)):
            if std[name][j] > 0:
                out[f"{place}.{name}[{order:g}]"] = float(abs(error) / std[name][j])
    return out
