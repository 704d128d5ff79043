"""The opened envelope of a moving arm against the diagnosis."""

from __future__ import annotations

from typing import Any

import numpy as np

TURN = {"phase_deg": 360.0}
NEAR_ORDER = 0.5


def judge(
    truth: list[dict[str, Any]], matters: list[bool], diagnosis: dict[str, Any]
) -> tuple[bool, list[str], list[str], dict[str, float]]:
    """(every fault that matters is told, name and place, before anything that is not concealed; names told that were not concealed;
    all names told; errors of parameters in stated sigmas)."""
    effects = [e for e in diagnosis["effects"] if e["name"] != "unknown"]
    concealed = {_place(t) for t in truth}
    wanted = {_place(t) for t, m in zip(truth, matters, strict=True) if m}
    told = [_place(e) for e in effects]
    first = []
    for place in told:
        if place not in concealed:
            break
        first.append(place)
    sigmas: dict[str, float] = {}
    for t in truth:
        mine = next((e for e in effects if _place(e) == _place(t)), None)
        if mine is not None:
            sigmas |= {f"{t['name']}:{k}": v for k, v in _errors(t["parameters"], mine["parameters"]).items()}
    return wanted <= set(first), [_words(p) for p in told if p not in concealed], [_words(p) for p in told], sigmas


def _place(effect: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    return effect["name"], tuple(effect["where"])


def _words(place: tuple[str, tuple[str, ...]]) -> str:
    return f"{place[0]}:{'+'.join(place[1])}"


def _errors(truth: dict[str, Any], told: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Worst component of each parameter; of several waves the one of the nearest order."""
    out = {}
    order = next((k for k in truth if k.endswith(".order")), None)
    pick = None
    if order is not None and order in told:
        orders = np.atleast_1d(told[order]["value"])
        pick = int(np.argmin(np.abs(orders - truth[order])))
        if abs(orders[pick] - truth[order]) > NEAR_ORDER:
            return {}
    for key, true in truth.items():
        if key not in told:
            continue
        value, std = np.atleast_1d(told[key]["value"]).astype(float), np.atleast_1d(told[key]["std"]).astype(float)
        if pick is not None:
            value, std = value[[pick]], std[[pick]]
        away = value - np.atleast_1d(true)
        turn = TURN.get(key.rpartition(".")[2])
        away = (away + turn / 2) % turn - turn / 2 if turn else away
        if (std > 0).all():
            out[key] = float(np.max(np.abs(away) / std))
    return out
