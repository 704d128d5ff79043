"""The diagnosis of a motion to the content of a report: words and units, and the stretch of its channels that is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.motion.result import ChannelFit, CheckedChannel, ErrorBeforeAfter, MotionDiagnosis
from mbcacq.diagnosis.output.text import VERDICTS
from mbcacq.effects.in_words import CHANNELS
from mbcacq.model.channel_series import ChannelSeries, MotionSeries
from mbcacq.model.json_text import plain
from mbcacq.quantities import capitalised, significant, symbol
from mbcacq.report.content import DiagnosisContent, MotionChannel, MotionKind, TrialContent
from mbcacq.report.sources.from_diagnosis import mismatch_rows, open_remarks, what_every_diagnosis_says

STRETCH_S = 20.0  # of a recording that is drawn: longer, and a reversal of an axis is narrower than a line
MOST = 1250  # samples a line: two for each point of the widest screen that a figure has half of
AXES = {"tau": "torque", "q_joint": "joint side − motor side", "q_set": "actual − set point"}
LEAST_SHARE = 0.005  # of the excess over noise; the dependences below it are counted, not listed
TRIED = ["joint", "channel", "rms before", "after", "unit"]
REFUSED = "no model is kept: on held-out data it leaves {}"
OTHER_SET = (
    "the fit leaves more than held-out data do, for these are two sets of effects. Each held-out part is predicted by what is selected on "
    "the others, which there has an effect more; selected on all data are the effects below, and what is unmodelled or not separable from "
    "another stays in the fit"
)
MORE = 1.25  # of the held-out rms, from which that of the fit is another set's: with one set it is the smaller of both


def motion_content(found: MotionDiagnosis | PosesAndMotion) -> DiagnosisContent:
    """Content of a diagnosis of motion, alone or with the poses of the same run. Raises ConfigError if the motion was read from JSON,
    and has no channels to draw."""
    motion, both = (found.motion, found) if isinstance(found, PosesAndMotion) else (found, None)
    return _content(motion, motion.series, both)


def kept_motion_content(diagnosis: Mapping[str, Any], pictures: Mapping[str, Any] | None) -> DiagnosisContent | None:
    """Content of the motion in a kept diagnosis of a run, None if it has none; with the channels of ``motion_pictures``, where they are
    there and undamaged. Raises ConfigError if the diagnosis is damaged."""
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
    """What ``motion_pictures`` wrote. Raises KeyError, TypeError, ValueError, AttributeError if it is damaged."""
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


def _content(found: MotionDiagnosis, series: MotionSeries, both: PosesAndMotion | None) -> DiagnosisContent:
    channels, listed = found.fit.channels, mismatch_rows(found, LEAST_SHARE)
    kinds = [
        MotionKind(
            title=capitalised(CHANNELS[kind]),
            quantity=AXES[kind],
            unit=symbol(next(c.unit for c in channels if c.channel == kind)),
            rows=[_channel(c) for c in channels if c.channel == kind],
            series=_stretch(series, kind),
        )
        for kind in dict.fromkeys(c.channel for c in channels)
    ]
    return DiagnosisContent(
        **what_every_diagnosis_says(found),
        split=found.fit.held_out.split,
        recordings=[name or "the recording" for name in series.recordings],
        mismatch=listed,
        small=len(found.mismatch) - len(listed),
        kinds=kinds,
        trials=[
            TrialContent(recording=one.recording or "another recording", heads=TRIED, rows=[_checked(c) for c in one.channels], words=2)
            for one in found.checks
        ],
        remarks=[*(f"{remark}." for remark in found.remarks), *open_remarks(found)],
        contradictions=[] if both is None else both.contradictions,
        both=[] if both is None else _as_one_problem(both),
    )


def _as_one_problem(both: PosesAndMotion) -> list[tuple[str, list[str]]]:
    """The verdict on the run, and what poses and motion say together."""
    headline, _, _ = VERDICTS[both.verdict].partition(":")
    return [("Verdict on poses and motion as one problem", [f"{headline}."]), *both.in_both]


def _channel(channel: ChannelFit) -> MotionChannel:
    refused = channel.refused_rms
    (held_out, held_out_chi2), (fitted, _) = (_before_after(error) for error in (channel.held_out, channel.train))
    of_another_set = channel.train.after_rms > MORE * channel.held_out.after_rms  # then the held-out data were predicted by other effects
    return MotionChannel(
        at=channel.at,
        noise=significant(channel.noise_floor),
        held_out=held_out,
        chi2=held_out_chi2,
        fitted=fitted,
        remark=REFUSED.format(f"{significant(refused)} {symbol(channel.unit)}") if refused is not None else OTHER_SET * of_another_set,
    )


def _before_after(error: ErrorBeforeAfter) -> tuple[tuple[str, str], tuple[str, str]]:
    """Root mean square before and after, and chi2 per degree of freedom."""
    rms, chi2 = (error.before_rms, error.after_rms), (error.before_chi2_dof, error.after_chi2_dof)
    return (significant(rms[0]), significant(rms[1])), (significant(chi2[0]), significant(chi2[1]))


def _checked(channel: CheckedChannel) -> tuple[str, str, str, str, str]:
    before, after = (significant(rms) for rms in (channel.error.before_rms, channel.error.after_rms))
    return channel.at, CHANNELS[channel.channel], before, after, symbol(channel.unit)


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
