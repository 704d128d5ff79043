"""Scores of many challenges as one table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbcacq.challenge.scenarios import NONE, OUTSIDE
from mbcacq.challenge.score import WITHIN, Score

COLUMNS = (
    "kind",
    "challenges",
    "that count",
    "named",
    "and placed",
    "located",
    "share of achievable",
    "parameters within 3 sigma",
    "confidently wrong",
    "false alarms",
)


def summary(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """One row a kind, then one for the whole catalogue, one for what lies outside it, one for clean cells, as far as there are any."""
    rows = [row(kind, [s for s in scores if s.kind == kind]) for kind in dict.fromkeys(s.kind for s in scores)]
    inside = [s for s in scores if s.kind != NONE and s.kind not in OUTSIDE]
    outside = [s for s in scores if s.kind in OUTSIDE]
    return rows + [row(name, some) for name, some in (("all catalogued", inside), ("all outside", outside)) if some]


def row(kind: str, scores: Sequence[Score]) -> dict[str, Any]:
    """Rates are over the challenges that count; None if there are none."""
    count = [s for s in scores if s.counts]
    clean = [s for s in scores if not s.truth]
    shares = [s.share for s in count if s.share is not None]
    sigmas = [v for s in count for v in s.sigmas.values()]
    return {
        "kind": kind,
        "challenges": len(scores),
        "that count": len(count),
        "named": rate([s.named for s in count]),
        "and placed": rate([s.placed for s in count]),
        "located": rate([s.located for s in count]),
        "share of achievable": float(np.median(shares)) if shares else None,
        "parameters": len(sigmas),
        "parameters within 3 sigma": rate([v <= WITHIN for v in sigmas]),
        "confidently wrong": rate([s.confident for s in count]),
        "false alarms": rate([s.detected for s in clean]),
    }


def rate(yes: Sequence[bool]) -> float | None:
    return float(np.mean(yes)) if len(yes) else None


def cells(entry: dict[str, Any]) -> list[str]:
    return [text(entry[c]) for c in COLUMNS]


def text(value: Any) -> str:
    if value is None:
        return ""
    return f"{100 * value:.0f} %" if isinstance(value, float) else str(value)


def line(s: Score) -> str:
    """One challenge in words."""
    if not s.truth:
        judged = "FALSE ALARM" if s.detected else "no false alarm"
    else:
        judged = "right" if s.placed else "located" if s.located else "missed" if not s.detected else "WRONG"
        judged += "" if s.counts else ", too weak to count"
    injected, reported = ", ".join(s.truth) or "nothing", ", ".join(s.reported) or "nothing reported"
    return f"{injected} ({s.achievable:.0%} to gain): {s.verdict}, {reported}; {judged}"
