"""The diagnosis of motion in plain words."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.result import ChannelFit, MotionDiagnosis, MotionEffect, UnmodelledMotionEffect
from mbcacq.diagnosis.output.evidence_summary import e_value_in_words
from mbcacq.diagnosis.output.text import FINDINGS, TRENDS, reported, verdict_in_words
from mbcacq.effects.in_words import effect_in_words, odds_in_words
from mbcacq.quantities import percent, significant, symbol

CHANNELS = {
    "q_joint": "joint-side against motor-side angle",
    "q_set": "actual angle against set point",
    "tau": "torque against the rigid arm",
}
CANNOT_TELL = "Cannot tell: these motions do not let some of the candidates be separated, or show an effect too weakly."
MOST_ROWS = 12  # of the mismatch


def motion_text(diagnosis: MotionDiagnosis) -> str:
    """Verdict, mismatch, effects with their parameters, and residuals on held-out data, in lines."""
    return "\n".join([headline(diagnosis), "", motion_details(diagnosis)])


def headline(diagnosis: MotionDiagnosis) -> str:
    """The verdict as a sentence."""
    return verdict_sentence(diagnosis.verdict)


def verdict_sentence(verdict: str) -> str:
    """What a verdict says of a motion."""
    return CANNOT_TELL if verdict == "cannot_tell" else verdict_in_words(verdict)


def motion_details(diagnosis: MotionDiagnosis) -> str:
    """What the verdict rests on: mismatch, effects with their parameters, and residuals on held-out data, in lines."""
    lines = [f"The description of the data looks wrong: {s}" for s in diagnosis.suspicions]
    lines += [""] if diagnosis.suspicions else []
    if diagnosis.mismatch:
        lines.append("Where model and data disagree:")
        for m in diagnosis.mismatch[:MOST_ROWS]:
            lines.append(f"  {m.at:<8} depends on {m.depends_on:<14} share {percent(m.share)} ({CHANNELS[m.channel]})")
        lines.append("")
    for heading, trend in ((FINDINGS, False), (TRENDS, True)):
        effects = [e for e in diagnosis.effects if bool(e.trend) is trend]
        lines += [heading] if effects else []
        for effect in effects:
            lines += _describe(effect)
    for pair in diagnosis.not_separable:
        both = " and ".join(map(effect_in_words, pair.effects))
        odds = "" if pair.odds is None else f"; {odds_in_words(pair.odds)} for the second"
        lines.append(f"Not separated: {both} (correlation of the estimates {pair.correlation:.3f}{odds})")
    lines += [f"To tell them apart: {a.reason}." for a in diagnosis.advice]
    for e in diagnosis.evidence:
        odds, found = e_value_in_words(e.evidence)
        lines.append(f"{CHANNELS[e.channel]}: effects against none {odds}, {found}.")
    lines += ["", f"On held-out data (by {diagnosis.fit.held_out.split}):"]
    for c in diagnosis.fit.channels:
        lines.append(f"  {c.at} {CHANNELS[c.channel]}: {_held_out(c)}")
    for check in diagnosis.checks:
        lines += ["", f"Tried on {check.recording or 'the other recording'}, of which nothing was learnt:"]
        for one in check.channels:
            rms = f"{significant(one.error.before_rms)} {symbol(one.unit)} before, {significant(one.error.after_rms)} after"
            lines.append(f"  {one.at} {CHANNELS[one.channel]}: {rms}")
    return "\n".join(lines)


def _describe(effect: MotionEffect | UnmodelledMotionEffect) -> list[str]:
    """The lines of one effect; of a trend no figure."""
    where = ", ".join(effect.where)
    if isinstance(effect, UnmodelledMotionEffect):
        gain, rest = effect.held_out_gain, [size_of_shape(effect)]
    else:
        values = [effect.trend] if effect.trend else [reported(name, p) for name, p in effect.parameters.items()]
        gain, rest = effect.held_out_gain_here, [*values, *effect.notes]
    head = f"{effect_in_words(effect.name)} at {where} (removes {percent(gain)} of the excess there, on held-out data)"
    return [head, *(f"  {line}" for line in rest)]


def size_of_shape(effect: UnmodelledMotionEffect) -> str:
    """Its size. The bins hold equally many samples, so that the mean square over them is that over the recording."""
    torque = effect.channel == "tau"
    rms = float(np.sqrt(np.mean(np.square(effect.shape.y))))
    size = f"{significant(rms)} N·m" if torque else f"{significant(float(np.degrees(rms)))}°"
    return f"rms {size}, as a function of {effect.depends_on} ({CHANNELS[effect.channel]})"


def _held_out(c: ChannelFit) -> str:
    before = f"{significant(c.held_out.before_rms)} {symbol(c.unit)} before"
    if c.refused_rms is not None:
        return f"{before}; the model found elsewhere makes it {significant(c.refused_rms)} and is refused here"
    return f"{before}, {significant(c.held_out.after_rms)} after"
