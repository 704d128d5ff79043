"""The diagnosis of motion in plain words."""

from __future__ import annotations

from collections.abc import Iterable

from mbcacq.diagnosis.motion.result import ChannelFit, MotionDiagnosis
from mbcacq.diagnosis.output.brief import MOST_NOTES, WHOLE, effects_in_brief, mismatch_in_brief
from mbcacq.diagnosis.output.evidence_summary import e_value_in_words
from mbcacq.diagnosis.output.text import effect_lines, first_sentence, mismatch_lines, open_lines
from mbcacq.effects.in_words import CHANNELS
from mbcacq.quantities import significant, symbol, with_unit

MOST_ROWS = 12  # of the mismatch


def motion_text(diagnosis: MotionDiagnosis) -> str:
    """Verdict, mismatch, effects with their parameters, and residuals on held-out data, in lines."""
    return "\n".join([first_sentence(diagnosis), "", motion_details(diagnosis)])


def motion_details(diagnosis: MotionDiagnosis) -> str:
    """What the verdict rests on: mismatch, effects with their parameters, and residuals on held-out data, in lines."""
    lines = [*diagnosis.remarks, ""] if diagnosis.suspicions else []
    lines += mismatch_lines(diagnosis.mismatch[:MOST_ROWS])
    lines += effect_lines(diagnosis.effects)
    lines += open_lines(diagnosis.not_separable, diagnosis.advice)
    lines += [*evidence_lines(diagnosis), "", f"On held-out data (by {diagnosis.fit.held_out.split}):"]
    for c in diagnosis.fit.channels:
        lines.append(f"  {c.at} {CHANNELS[c.channel]}: {_held_out(c)}")
    for check in diagnosis.checks:
        lines += ["", f"Tried on {check.recording or 'the other recording'}, from which nothing was learnt:"]
        for one in check.channels:
            rms = f"{with_unit(significant(one.error.before_rms), symbol(one.unit))} before, {significant(one.error.after_rms)} after"
            lines.append(f"  {one.at} {CHANNELS[one.channel]}: {rms}")
    return "\n".join(lines)


def motion_in_brief(diagnosis: MotionDiagnosis) -> str:
    """Verdict, effects a line each, and residuals a line for each channel."""
    lines = [first_sentence(diagnosis), "", *brief_details(diagnosis)]
    return "\n".join(lines)


def brief_details(diagnosis: MotionDiagnosis) -> list[str]:
    """``motion_details`` on one screen."""
    lines = [*diagnosis.remarks, ""] if diagnosis.suspicions else []
    lines += effects_in_brief(diagnosis.effects)
    lines += mismatch_in_brief(diagnosis.mismatch)
    lines += open_lines(diagnosis.not_separable, diagnosis.advice)[:MOST_NOTES]
    lines += [*evidence_lines(diagnosis), f"On held-out data (by {diagnosis.fit.held_out.split}), before and after:"]
    lines += by_channel((c.channel, c.unit, f"{c.at} {_short(c)}") for c in diagnosis.fit.channels)
    for check in diagnosis.checks:
        lines.append(f"Tried on {check.recording or 'the other recording'}, from which nothing was learnt, before and after:")
        each = ((c.channel, c.unit, f"{c.at} {significant(c.error.before_rms)}, {significant(c.error.after_rms)}") for c in check.channels)
        lines += by_channel(each)
    return [*lines, WHOLE]


def by_channel(figures: Iterable[tuple[str, str, str]]) -> list[str]:
    """What is said of each joint, a line for each channel and unit."""
    said: dict[tuple[str, str], list[str]] = {}
    for channel, unit, words in figures:
        said.setdefault((channel, unit), []).append(words)
    return [f"  {CHANNELS[channel]} in {symbol(unit)}: {'; '.join(each)}" for (channel, unit), each in said.items()]


def evidence_lines(diagnosis: MotionDiagnosis) -> list[str]:
    """Whether there is an effect, a line for each channel."""
    said = ((CHANNELS[e.channel], *e_value_in_words(e.evidence)) for e in diagnosis.evidence)
    return [f"{channel}: effects against none {odds}, {found}." for channel, odds, found in said]


def _short(c: ChannelFit) -> str:
    after = "refused" if c.refused_rms is not None else significant(c.held_out.after_rms)
    return f"{significant(c.held_out.before_rms)}, {after}"


def _held_out(c: ChannelFit) -> str:
    before = f"{with_unit(significant(c.held_out.before_rms), symbol(c.unit))} before"
    if c.refused_rms is not None:
        return f"{before}; {significant(c.refused_rms)} with the model of the other parts, which is refused"
    return f"{before}, {significant(c.held_out.after_rms)} after"
