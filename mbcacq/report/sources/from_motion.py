"""The diagnosis of a motion to the content of a report: its JSON in words and units, and the stretch of its channels that is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.motion.result import CheckedChannel, MotionDiagnosis, MotionEffect, MotionMismatch, UnmodelledMotionEffect
from mbcacq.diagnosis.motion.text import CHANNELS, size_of_shape, verdict_sentence
from mbcacq.diagnosis.output.pictures import axis_of
from mbcacq.model.channel_series import ChannelSeries, MotionSeries
from mbcacq.model.json_text import plain
from mbcacq.quantities import percent, significant, split_unit, symbol
from mbcacq.report.content import EffectContent, MotionChannel, MotionContent, MotionKind, TrialContent
from mbcacq.report.sources.from_diagnosis import VERDICTS, effect_content, open_remarks
from mbcacq.report.verdict import readable

STRETCH_S = 20.0  # of a recording that is drawn: longer, and a reversal of an axis is narrower than a line
MOST = 1250  # samples a line: two for each point of the widest screen that a figure has half of
AXES = {"tau": "torque", "q_joint": "joint side − motor side", "q_set": "actual − set point"}
NAMES = {"tau": "the torque", "q_joint": "the joint-side angle", "q_set": "the set point"}
LEAST_SHARE = 0.005  # of the excess over noise; the dependences below it are counted, not listed
TRIED = ["joint", "channel", "rms before", "after", "unit"]
REFUSED = "no model is kept: on held-out data it leaves {}"
OTHER_SET = (
    "the fit leaves more than held-out data do, for these are two sets of effects. Each held-out part is predicted by what is selected on "
    "the others, which there has an effect more; selected on all data are the effects below, and what is unmodelled or not separable from "
    "another stays in the fit"
)
MORE = 1.25  # of the held-out rms, from which that of the fit is another set's: with one set it is the smaller of both


def motion_content(found: MotionDiagnosis | PosesAndMotion) -> MotionContent:
    """Content of a diagnosis of motion, alone or with the poses of the same run. Raises ConfigError where the motion was read from JSON,
    and has no channels to draw."""
    motion, both = (found.motion, found) if isinstance(found, PosesAndMotion) else (found, None)
    return _content(motion, motion.series, both)


def kept_motion_content(diagnosis: Mapping[str, Any], pictures: Mapping[str, Any] | None) -> MotionContent | None:
    """Content of the motion in a kept diagnosis of a run, None where it has none; with the channels of ``motion_pictures``, where they are
    there and undamaged. Raises ConfigError where the diagnosis is damaged."""
    if not diagnosis.get("motion"):
        return None
    try:
        series = _read_series((pictures or {})["motion"])
    except (KeyError, TypeError, ValueError, AttributeError):
        series = MotionSeries("", (), ())
    both = PosesAndMotion.of_json(diagnosis)
    return _content(both.motion, series, both)


def motion_pictures(found: MotionDiagnosis) -> dict[str, Any]:
    """The stretch of each channel that is drawn, as JSON."""
    drawn = (one for kind in found.series.kinds() for one in _stretch(found.series, kind))
    return plain(replace(found.series, channels=tuple(drawn)))


def _read_series(content: Mapping[str, Any]) -> MotionSeries:
    """What ``motion_pictures`` wrote. Raises KeyError, TypeError, ValueError, AttributeError where it is damaged."""
    channels = []
    for one in content["channels"]:
        arrays = {name: np.array(one[name], dtype=float) for name in ("time_s", "measured", "before", "after")}
        if len(arrays["time_s"]) < 2 or any(a.shape != arrays["time_s"].shape for a in arrays.values()):
            raise ValueError("the arrays of a channel differ in length")
        channels.append(ChannelSeries(**{**one, **arrays}))
    recordings = tuple(map(str, content["recordings"]))
    if not all(0 <= one.recording < len(recordings) for one in channels):
        raise ValueError("a channel is of no recording")
    return MotionSeries(str(content["robot"]), recordings, tuple(channels))


def _content(found: MotionDiagnosis, series: MotionSeries, both: PosesAndMotion | None) -> MotionContent:
    diagnosis = found.to_json()
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
        effects=sorted(
            (_effect(e, content) for e, content in zip(found.effects, diagnosis["effects"], strict=True)), key=lambda e: bool(e.trend)
        ),
        mismatch=[
            (NAMES.get(m.at, m.at), CHANNELS[m.channel], _covariate(m.depends_on), percent(m.share)) for m in found.mismatch if _listed(m)
        ],
        small=sum(not _listed(m) for m in found.mismatch),
        kinds=kinds,
        trials=[
            TrialContent(recording=one.recording or "another recording", heads=TRIED, rows=[_checked(c) for c in one.channels], words=2)
            for one in found.checks
        ],
        remarks=[
            *(f"The description of the data looks wrong: {text}." for text in diagnosis.get("suspicions", ())),
            *open_remarks(diagnosis),
        ],
        contradictions=[] if both is None else both.contradictions,
        both=[] if both is None else _as_one_problem(both),
    )


def _as_one_problem(both: PosesAndMotion) -> list[tuple[str, list[str]]]:
    """The verdict on the run, and what poses and motion say together."""
    _, headline, _ = VERDICTS.get(both.verdict, ("none", readable(both.verdict), ""))
    return [("Verdict on poses and motion as one problem", [f"{headline}."]), *both.in_both]


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
        remark=REFUSED.format(f"{significant(refused)} {unit}") if refused is not None else OTHER_SET if _of_another_set(channel) else "",
    )


def _of_another_set(channel: Mapping[str, Any]) -> bool:
    """Whether the fit to all data leaves so much more than the held-out data that these were predicted by other effects."""
    fitted, held_out = channel["train"]["after_rms"], channel["held_out"]["after_rms"]
    return fitted is not None and held_out is not None and fitted > MORE * held_out


def _before_after(error: Mapping[str, Any]) -> tuple[tuple[str, str], tuple[str, str]]:
    """Root mean square before and after, and chi2 per degree of freedom."""
    rms, chi2 = ((significant(error[f"before_{what}"]), significant(error[f"after_{what}"])) for what in ("rms", "chi2_dof"))
    return rms, chi2


def _checked(channel: CheckedChannel) -> tuple[str, str, str, str, str]:
    before, after = (significant(rms) for rms in (channel.error.before_rms, channel.error.after_rms))
    return channel.at, CHANNELS[channel.channel], before, after, symbol(channel.unit)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _stretch(series: MotionSeries, kind: str) -> list[ChannelSeries]:
    """The same stretch of each joint: of all, that with the largest difference between model and data before the effects; in as many
    samples as a line shows. Nothing where the series has no such channel."""
    by_joint: dict[str, list[ChannelSeries]] = {}
    for one in series.of(kind):
        by_joint.setdefault(one.at, []).append(one)
    joints = list(by_joint.values())
    if not joints:
        return []
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
            best, largest = (number, slice(start, start + length, -(-length // MOST))), float(sums[start])
    number, part = best
    return [of_joint[number].part(part) for of_joint in joints]
