"""The diagnosis of motion in plain words."""

from __future__ import annotations

from mbcacq.diagnosis.motion.result import ChannelFit, MotionDiagnosis
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
    for e in diagnosis.evidence:
        odds, found = e_value_in_words(e.evidence)
        lines.append(f"{CHANNELS[e.channel]}: effects against none {odds}, {found}.")
    lines += ["", f"On held-out data (by {diagnosis.fit.held_out.split}):"]
    for c in diagnosis.fit.channels:
        lines.append(f"  {c.at} {CHANNELS[c.channel]}: {_held_out(c)}")
    for check in diagnosis.checks:
        lines += ["", f"Tried on {check.recording or 'the other recording'}, from which nothing was learnt:"]
        for one in check.channels:
            rms = f"{with_unit(significant(one.error.before_rms), symbol(one.unit))} before, {significant(one.error.after_rms)} after"
            lines.append(f"  {one.at} {CHANNELS[one.channel]}: {rms}")
    return "\n".join(lines)


def _held_out(c: ChannelFit) -> str:
    before = f"{with_unit(significant(c.held_out.before_rms), symbol(c.unit))} before"
    if c.refused_rms is not None:
        return f"{before}; {significant(c.refused_rms)} with the model of the other parts, which is refused"
    return f"{before}, {significant(c.held_out.after_rms)} after"
