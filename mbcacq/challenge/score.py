"""Scores of a diagnosis against the effects that were injected; both are JSON objects."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any

import numpy as np

from mbcacq.effects.catalogue import declaration
from mbcacq.model.json_text import AsJson

WITHIN = 3.0  # stated standard deviations within which a parameter counts as right
ORDER_TOLERANCE = 0.1  # periods a turn within which a reported order is the injected one


@dataclass(frozen=True, kw_only=True)
class Score(AsJson):
    """The score of one challenge.

    Attributes
    ----------
    truth, reported : list[str]
        Effects as ``name:where``.
    achievable : float
        Share of the held-out chi2 that the true model removes.
    counts : bool
        Whether that is enough for the challenge to count.
    detected : bool
        Whether an effect, or a verdict other than ``none`` and ``cannot_tell``, is reported.
    named, placed : bool
        Every injected effect (of several: each that adds something) is reported, before any other, by its name, and at its location.
    located : bool
        The first entry of ``mismatch`` is at the location of an injected effect.
    confident : bool
        A wrong name with the verdict ``explained``.
    extra : list[str]
        Reported names that were not injected.
    share : float or None
        Share of the achievable improvement; None for an effect of one station, of which others know nothing, and where another effect goes
        with it.
    sigmas : dict[str, float]
        Errors of the parameters in units of their stated standard deviation.
    """

    kind: str
    truth: list[str]
    reported: list[str]
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


def score(
    kind: str, truth: list[dict[str, Any]], diagnosis: dict[str, Any], achievable: float, least: float = 0.1, catalogued: bool = True
) -> Score:
    """The score of a diagnosis, as its JSON object, against the injected effects.

    truth: with name, where and parameters; each of several effects also states what it ``adds`` to the others. achievable, least, adds:
    shares of the held-out chi2; what removes less than ``least`` need not be reported. catalogued: whether the catalogue has the effect.
    """
    effects, verdict = diagnosis["effects"], diagnosis["verdict"]
    names = {t["name"] for t in truth}
    companions = {c for name in names for c in companions_of(name)} - names
    claimed = [e for e in effects if e["name"] not in ("unknown", *companions)]
    extra = [e["name"] for e in claimed if e["name"] not in names]
    first = list(takewhile(lambda e: e["name"] in names, (e for e in effects if e["name"] not in companions)))
    named = bool(first) and {t["name"] for t in truth if t.get("adds", least) >= least} <= {e["name"] for e in first}
    placed = named and all(at_location(e, next(t for t in truth if t["name"] == e["name"])) for e in first)
    improvement = held_out_improvement(diagnosis)
    comparable = bool(truth) and achievable > 0 and not at_one_station(truth) and not companions
    return Score(
        kind=kind,
        truth=[label(t) for t in truth],
        reported=[label(e) for e in effects],
        verdict=verdict,
        achievable=achievable,
        counts=bool(truth) and achievable >= least,
        detected=bool(effects) or verdict not in ("none", "cannot_tell"),
        named=named and catalogued,
        placed=placed and catalogued,
        located=located(diagnosis["mismatch"], truth),
        confident=verdict == "explained" and bool(extra),
        extra=extra,
        share=improvement / achievable if comparable else None,
        sigmas=errors_in_sigmas(truth, claimed),
        improvement=improvement,
    )


def locations(truth: list[dict[str, Any]]) -> set[str]:
    """Where the injected effects act, and where they are first observable if that is elsewhere."""
    return {w for t in truth for w in (*t["where"], *t.get("observable_at", ()))}


def located(mismatch: list[dict[str, Any]], truth: list[dict[str, Any]]) -> bool:
    """Whether the largest mismatch is at the location of an injected effect."""
    return bool(mismatch) and mismatch[0]["at"] in locations(truth)


def at_one_station(truth: list[dict[str, Any]]) -> bool:
    """Whether an effect happens at single stations: at others than these its model improves nothing."""
    return any(w.startswith("station") for w in locations(truth))


def held_out_improvement(diagnosis: dict[str, Any]) -> float:
    """Share of the held-out chi2 per degree of freedom that the diagnosis removes."""
    fit = diagnosis["fit"]["held_out"]
    return 1.0 - fit["after_chi2_dof"] / fit["before_chi2_dof"] if fit["before_chi2_dof"] else 0.0


def companions_of(name: str) -> tuple[str, ...]:
    """Effects that are no false names next to this one."""
    challenge = declaration(name).challenge
    return () if challenge is None else challenge.companions


def errors_in_sigmas(truth: list[dict[str, Any]], claimed: list[dict[str, Any]]) -> dict[str, float]:
    """``name.parameter`` -> error of each parameter of the injected effects that are reported at their location."""
    sigmas: dict[str, float] = {}
    for t in truth:
        mine = next((e for e in claimed if e["name"] == t["name"] and at_location(e, t)), None)
        if mine is not None:
            sigmas |= {f"{t['name']}.{k}": v for k, v in parameter_errors(t, mine["parameters"]).items()}
    return sigmas


def label(effect: dict[str, Any]) -> str:
    """``name:where``."""
    return f"{effect['name']}:{'+'.join(effect['where'])}"


def at_location(reported: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Whether an effect is reported at no location but those injected; a coupling needs both of its joints."""
    there, true = set(reported["where"]), set(truth["where"])
    return there == true if declaration(truth["name"]).between_locations else bool(there) and there <= true


def parameter_errors(truth: dict[str, Any], reported: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Largest error of each parameter in units of its stated standard deviation; those reported without one are left out."""
    if "order" in truth:
        return _orders(truth, reported)
    out = {}
    for key, entry in reported.items():
        location, _, name = key.rpartition(".")
        true = truth.get(name)
        if isinstance(true, dict):
            true = true.get(location)
        if true is None:
            continue
        value, std = np.atleast_1d(entry["value"]).astype(float), np.atleast_1d(entry["std"]).astype(float)
        true = np.broadcast_to(np.asarray(true, dtype=float), value.shape) if np.size(true) in (1, value.size) else None
        if true is None or not np.any(std > 0):
            continue
        use = std > 0
        out[key] = float(np.max(np.abs(value - true)[use] / std[use]))
    return out


def _orders(truth: dict[str, Any], reported: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Amplitude and phase of the reported order that is nearest to each injected one."""
    out = {}
    joint = truth["where"][0]
    if f"{joint}.order" not in reported:
        return {}  # stated as not determined
    columns = {name: np.atleast_1d(reported[f"{joint}.{name}"]["value"]).astype(float) for name in ("order", "amplitude_deg", "phase_deg")}
    std = {name: np.atleast_1d(reported[f"{joint}.{name}"]["std"]).astype(float) for name in ("amplitude_deg", "phase_deg")}
    for order, amplitude, phase in zip(truth["order"], truth["amplitude_deg"], truth["phase_deg"], strict=True):
        j = int(np.argmin(np.abs(columns["order"] - order)))
        if abs(columns["order"][j] - order) > ORDER_TOLERANCE:
            continue
        phase_error = (columns["phase_deg"][j] - phase + 180) % 360 - 180
        for name, error in (("amplitude_deg", columns["amplitude_deg"][j] - amplitude), ("phase_deg", phase_error)):
            if std[name][j] > 0:
                out[f"{joint}.{name}[{order:g}]"] = float(abs(error) / std[name][j])
    return out
