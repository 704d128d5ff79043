"""The verdict and the diagnosis in Markdown, as the viewer shows them beside its pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbcacq.files.template import filled
from mbcacq.report.content import Content, DiagnosisContent, EffectContent
from mbcacq.report.verdict import largest_error

HERE = Path(__file__).parent
SIGNS = {"pass": "✓", "fail": "✗", "undecided": "?", "found": "→", "none": "–"}
MOST_VALUES = 6  # of an effect on its card


def verdict_card(content: Content) -> str:
    """The verdict, and the one number against its limit."""
    verdict, spacing = content.verdict, content.spacing
    errors = {} if spacing is None else {"largest": largest_error(spacing), "before": spacing.mm(np.abs(spacing.before).max())}
    known = {"sign": SIGNS[verdict.level], "verdict": verdict, "spacing": spacing, "caveats": content.caveats}
    return filled(HERE / "verdict.md.j2", **known, **errors).removesuffix("\n")


def diagnosis_cards(diagnosis: DiagnosisContent) -> str:
    """The verdict, what it leaves of the misfit, then a card for each effect: what, where, how much, how sure, what else it could be."""
    return filled(HERE / "diagnosis.md.j2", d=diagnosis, sign=SIGNS[diagnosis.level], how_much=_how_much).removesuffix("\n")


def _how_much(effect: EffectContent) -> str:
    if effect.trend:
        return f"a trend: {effect.trend}"
    values = [f"{name} {value} ± {uncertainty} {unit}".rstrip() for name, value, uncertainty, unit in effect.parameters]
    if effect.harmonics is not None:
        values.append(f"{len(effect.harmonics[1])} harmonics, a row each in the report")
    more = f"; {len(values) - MOST_VALUES} more in the report" if len(values) > MOST_VALUES else ""
    return "; ".join(values[:MOST_VALUES]) + more or "see its response curve"
