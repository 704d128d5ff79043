"""The diagnosis of motion in plain words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.motion.result import ChannelFit, MotionDiagnosis, MotionEffect, UnmodelledMotionEffect
from mbcacq.diagnosis.output.evidence_summary import e_value_in_words
from mbcacq.diagnosis.output.text import effect_lines, mismatch_lines, open_lines, verdict_in_words
from mbcacq.quantities import significant, symbol

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
    lines += mismatch_lines(diagnosis.mismatch[:MOST_ROWS], lambda m: f" ({CHANNELS[m.channel]})")
    lines += effect_lines(diagnosis.effects, further)
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
            rms = f"{significant(one.error.before_rms)} {symbol(one.unit)} before, {significant(one.error.after_rms)} after"
            lines.append(f"  {one.at} {CHANNELS[one.channel]}: {rms}")
    return "\n".join(lines)


def further(effect: MotionEffect | UnmodelledMotionEffect) -> Sequence[str]:
    """What is said of an effect beside its parameters."""
    return [size_of_shape(effect)] if isinstance(effect, UnmodelledMotionEffect) else effect.notes


def size_of_shape(effect: UnmodelledMotionEffect) -> str:
    """Its size. The bins hold equally many samples, so that the mean square over them is that over the recording."""
    torque = effect.channel == "tau"
    rms = float(np.sqrt(np.mean(np.square(effect.shape.y))))
    size = f"{significant(rms)} N·m" if torque else f"{significant(float(np.degrees(rms)))}°"
    return f"rms {size}, as a function of {effect.depends_on} ({CHANNELS[effect.channel]})"


def _held_out(c: ChannelFit) -> str:
    before = f"{significant(c.held_out.before_rms)} {symbol(c.unit)} before"
    if c.refused_rms is not None:
        return f"{before}; {significant(c.refused_rms)} with the model of the other parts, which is refused"
    return f"{before}, {significant(c.held_out.after_rms)} after"
