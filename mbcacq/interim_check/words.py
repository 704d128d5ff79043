"""The verdict of a check in words."""

from __future__ import annotations

import numpy as np

from mbcacq.interim_check.history import CheckHistory
from mbcacq.interim_check.possible_changes import UNNAMED
from mbcacq.interim_check.verdict import CheckVerdict, Suspect
from mbcacq.quantities import K, in_degrees, measured

MOST = 4  # suspects in a sentence
LARGEST = 1e6  # an e-value beyond it is "more than a million"


def odds(log_e: float) -> str:
    """An e-value as a number that people read."""
    return "more than a million" if log_e > np.log(LARGEST) else f"{np.exp(log_e):.3g}"


def size_in_words(value: float, std: float, unit: str) -> str:
    """A size with its expanded uncertainty (k = 2), or two digits of one without: angles in degrees."""
    factor, shown = (in_degrees(1.0), "°") if unit == "rad" else (1.0, f" {unit}" if unit else "")
    if not std:
        return f"{float(f'{factor * value:.2g}'):g}{shown}"
    return measured(factor * value, factor * K * std, shown.strip())


def size_of(suspect: Suspect) -> str:
    """The coefficients of a suspect beyond their uncertainty, or '' if no unit is known."""
    known = [
        f"{name} {size_in_words(value, std, unit)}"
        for name, value, std, unit in zip(suspect.parameters, suspect.size, suspect.std, suspect.units, strict=True)
        if unit and abs(value) > K * std
    ]
    return ", ".join(known)


def sentence_of(verdict: CheckVerdict, history: CheckHistory) -> str:
    """One sentence: as before, or what changed, where, since when, by how much."""
    n, undone = len(history.days) - sum(one.end - one.first for one in verdict.put_right), _undone_in_words(verdict, history)
    if not verdict.changed:
        near = f", but the evidence is close to the alarm at {odds(verdict.log_threshold)}: repeat the check now" if verdict.near else ""
        return f"as before: nothing changed in {n} check{'s' if n > 1 else ''} of {len(history.poses)} poses{near}{undone}"
    first, names = verdict.suspects[0], [s.label for s in verdict.suspects if s.name != UNNAMED]
    shown = " or ".join(names[:MOST]) + (f" or {len(names) - MOST} others like them" if len(names) > MOST else "")
    if first.name == UNNAMED:
        near = next(s for s in verdict.suspects if s.name != UNNAMED)
        what = f"the cell changed in a way that no name on the list describes (nearest: {near.label}, which explains {near.explains:.0%})"
    else:
        what = f"the cell changed: {shown}"
    if verdict.since == 0:
        when = "between its calibration and the first check"
    else:
        low, high = verdict.between or (0, 0)
        when = f"before the check of {history.days[verdict.since or 0].time}"
        if low != high:
            when += f" (with 90 % before one of those from {history.days[low].time} to {history.days[high].time})"
    size = size_of(first)
    return f"{what}, {when}" + (f"; if it is the first: {size}" if size and len(names) > 1 else f"; {size}" if size else "") + undone


def _undone_in_words(verdict: CheckVerdict, history: CheckHistory) -> str:
    said = ""
    for one in verdict.put_right:
        first, last, end = (history.days[k].time for k in (one.first, one.end - 1, one.end))
        days = f"at the check of {first}" if first == last else f"from the check of {first} to that of {last}"
        size = f", {size}" if (size := size_of(one.suspect)) else ""
        said += f"; the cell was off {days} ({one.suspect.label}{size}); that was put right before the check of {end}"
    return said
