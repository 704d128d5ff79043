"""The diagnosis of a motion to the content of a report: its JSON in words and units, and the stretch of its channels that is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.result import CheckedChannel, MotionDiagnosis, MotionEffect, MotionMismatch, UnmodelledMotionEffect
from mbcacq.diagnosis.motion.text import CHANNELS, size_of_shape, verdict_sentence
from mbcacq.diagnosis.output.pictures import axis_of
from mbcacq.effects.in_words import effect_in_words, odds_in_words
from mbcacq.model.channel_series import ChannelSeries, MotionSeries
from mbcacq.quantities import significant, split_unit, symbol
from mbcacq.report.content import EffectContent, MotionChannel, MotionContent, MotionKind
from mbcacq.report.sources.from_diagnosis import VERDICTS, effect_content, share
from mbcacq.report.verdict import readable

STRETCH_S = 20.0  # of a recording that is drawn: longer, and a reversal of an axis is narrower than a line
AXES = {"tau": "torque", "q_joint": "joint side − motor side", "q_set": "actual − set point"}
NAMES = {"tau": "the torque", "q_joint": "the joint-side angle", "q_set": "the set point"}
LEAST_SHARE = 0.005  # of the excess over noise; the dependences below it are counted, not listed
REFUSED = "no model is kept: on held-out data it leaves {}"


def motion_content(found: MotionDiagnosis) -> MotionContent:
    """Content of a diagnosis of motion. Raises ConfigError where it was read from JSON, and has no channels to draw."""
    diagnosis, series = found.to_json(), found.series
    level, headline, _ = VERDICTS.get(diagnosis["verdict"], ("none", readable(diagnosis["verdict"]), ""))
    channels = diagnosis["fit"]["channels"]
    kinds = [
        MotionKind(
            title=_sentence(CHANNELS[kind]),
            quantity=AXES[kind],
            unit=symbol(next(c["unit"] for c in channels if c["channel"] == kind)),
            rows=[_channel(c) for c in channels if c["channel"] == kind],
            series=_stretch(series, kind),
        )
        for kind in dict.fromkeys(c["channel"] for c in channels)
    ]
    return MotionContent(
        level=level,
        headline=headline,
        reason=_sentence(verdict_sentence(diagnosis["verdict"]).removeprefix(f"{headline}: ")),
        split=diagnosis["fit"]["held_out"]["split"],
        recordings=[name or "the recording" for name in series.recordings],
        effects=[_effect(e, content) for e, content in zip(found.effects, diagnosis["effects"], strict=True)],
        mismatch=[
            (NAMES.get(m.at, m.at), CHANNELS[m.channel], _covariate(m.depends_on), share(m.share)) for m in found.mismatch if _listed(m)
        ],
        small=sum(not _listed(m) for m in found.mismatch),
        kinds=kinds,
        checks=[(one.recording or "the other recording", [_checked(c) for c in one.channels]) for one in found.checks],
        remarks=_remarks(diagnosis),
    )


def _effect(effect: MotionEffect | UnmodelledMotionEffect, content: Mapping[str, Any]) -> EffectContent:
    """Its gain is that at its own joints; an unmodelled one has a size in place of parameters."""
    if isinstance(effect, UnmodelledMotionEffect):
        return replace(effect_content(content), depends_on=_covariate(effect.depends_on), notes=[f"{_sentence(size_of_shape(effect))}."])
    notes = [f"{split_unit(first)[0]} {rest}." for first, _, rest in (note.partition(" ") for note in effect.notes)]
    shown = effect_content({**content, "where": [NAMES.get(at, at) for at in effect.where], "held_out_gain": effect.held_out_gain_here})
    return replace(shown, depends_on=_covariate(effect.depends_on), notes=notes)


def _listed(mismatch: MotionMismatch) -> bool:
    """Whether a dependence has a line of its own."""
    return mismatch.share >= LEAST_SHARE


def _covariate(name: str) -> str:
    return "speed" if name == "qd" else axis_of(name)[0]


def _channel(channel: Mapping[str, Any]) -> MotionChannel:
    unit, refused = symbol(channel["unit"]), channel.get("refused_rms")
    (held_out, held_out_chi2), (fitted, _) = (_before_after(channel[key]) for key in ("held_out", "train"))
    return MotionChannel(
        at=channel["at"],
        noise=significant(channel["noise_floor"]),
        held_out=held_out,
        chi2=held_out_chi2,
        fitted=fitted,
        remark="" if refused is None else REFUSED.format(f"{significant(refused)} {unit}"),
    )


def _before_after(error: Mapping[str, Any]) -> tuple[tuple[str, str], tuple[str, str]]:
    """Root mean square before and after, and chi2 per degree of freedom."""
    rms, chi2 = ((significant(error[f"before_{what}"]), significant(error[f"after_{what}"])) for what in ("rms", "chi2_dof"))
    return rms, chi2


def _checked(channel: CheckedChannel) -> tuple[str, str, str, str, str]:
    before, after = (significant(rms) for rms in (channel.error.before_rms, channel.error.after_rms))
    return channel.at, CHANNELS[channel.channel], before, after, symbol(channel.unit)


def _remarks(diagnosis: Mapping[str, Any]) -> list[str]:
    remarks = [f"The description of the data looks wrong: {text}." for text in diagnosis.get("suspicions", ())]
    for pair in diagnosis.get("not_separable", ()):
        odds = "" if pair.get("odds") is None else f"; {odds_in_words(pair['odds'])} for the second"
        both = " and ".join(map(effect_in_words, pair["effects"]))
        remarks.append(f"Not separable: {both} (correlation {pair['correlation']:.2f}{odds}).")
    return remarks + [f"Measure next: {advice['reason']}." for advice in diagnosis.get("advice", ())]


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _stretch(series: MotionSeries, kind: str) -> list[ChannelSeries]:
    """The same stretch of each joint: of all, that with the largest difference between model and data before the effects."""
    by_joint: dict[str, list[ChannelSeries]] = {}
    for one in series.of(kind):
        by_joint.setdefault(one.at, []).append(one)
    joints = list(by_joint.values())
    best, largest = (0, slice(0, 0)), -1.0
    for number in range(len(joints[0])):
        time = joints[0][number].time_s
        step = float(time[1] - time[0])
        length = min(len(time), max(int(STRETCH_S / step), 2))
        size = np.zeros(len(time))
        for of_joint in joints:
            squares = np.nan_to_num(of_joint[number].residual("before")) ** 2
            size += squares / max(float(squares.mean()), 1e-300)
        running = np.concatenate([[0.0], np.cumsum(size)])
        sums = running[length:] - running[:-length]
        start = int(np.argmax(sums))
        if sums[start] > largest:
            best, largest = (number, slice(start, start + length)), float(sums[start])
    number, part = best
    return [of_joint[number].part(part) for of_joint in joints]
