"""The verdict and the diagnosis in Markdown, as the viewer shows them beside its pictures."""

from __future__ import annotations

import numpy as np

from mbcacq.report.content import Content, DiagnosisContent, EffectContent
from mbcacq.report.verdict import largest_error

SIGNS = {"pass": "✓", "fail": "✗", "undecided": "?", "found": "→", "none": "–"}


def verdict_card(content: Content) -> str:
    """The verdict, and the one number against its limit."""
    lines = [f"# {SIGNS[content.verdict.level]} {content.verdict.headline}", ""]
    spacing = content.spacing
    if spacing is not None:
        limit = "no limit in the plan" if spacing.limit is None else f"limit {spacing.limit:g} mm"
        lines += [f"## {largest_error(spacing)}, {limit}", f"before calibration {spacing.mm(np.abs(spacing.before).max())} mm", ""]
    return "\n".join([*lines, content.verdict.reason, "", *(f"*{caveat}*" for caveat in content.caveats)])


def diagnosis_cards(diagnosis: DiagnosisContent) -> str:
    """The verdict, what it leaves of the misfit, then a card for each effect: what, where, how much, how sure, what else it could be."""
    lines = [f"# {SIGNS[diagnosis.level]} {diagnosis.headline}", "", diagnosis.reason, ""]
    if diagnosis.validation:
        lines += ["| difference between model and data (3D rms) | before | after |", "|---|---|---|"]
        lines += [f"| {label} | {before} | {after} |" for label, before, after in diagnosis.validation]
        lines += [f"| expected from noise alone | | {diagnosis.noise_floor} |", ""]
    for kind in diagnosis.kinds:
        lines += [f"| {kind.title} | held-out rms before, {kind.unit} | after, {kind.unit} |", "|---|---|---|"]
        lines += [f"| {c.at} | {c.held_out[0]} | {c.held_out[1]}{f' ({c.remark})' if c.remark else ''} |" for c in kind.rows]
        lines.append("")
    for number, effect in enumerate(diagnosis.effects, 1):
        lines += _card(number, effect)
    return "\n".join([*lines, *(f"- {remark}" for remark in diagnosis.remarks)])


def _card(number: int, effect: EffectContent) -> list[str]:
    notes = [f"- {note}" for note in effect.notes]
    what, _, where = effect.title.rpartition(" at ")
    values = [f"{name} {value} ± {uncertainty} {unit}".rstrip() for name, value, uncertainty, unit in effect.parameters]
    if effect.harmonics is not None:
        values.append(f"{len(effect.harmonics[1])} harmonics, a row each in the report")
    much = "; ".join(values[:6]) + (f"; {len(values) - 6} more in the report" if len(values) > 6 else "")
    rows = [
        ("what", f"{what}" + (f", depends on {effect.depends_on}" if effect.depends_on else "")),
        ("where", where),
        ("how much (± is k = 2)", f"a trend: {effect.trend}" if effect.trend else much or "see its response curve"),
        ("how sure", effect.p_value + (f"; removes {effect.gain} of the excess over noise in held-out data" if effect.gain else "")),
    ]
    table = [f"| {label} | {text} |" for label, text in rows]
    others = [f"- {text}" for text in effect.alternatives] or ["- no other candidate comes near"]
    return [
        f"## {'' if effect.trend else f'{number}. '}{effect.title}",
        "",
        "| | |",
        "|---|---|",
        *table,
        "",
        *notes,
        *([""] if notes else []),
        "What else it could be:",
        "",
        *others,
        "",
    ]
