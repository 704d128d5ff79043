"""A diagnosis of motion as a recording: its verdict as text, and each channel over time, measured and as the model has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mbcacq.files.atomic_write import replacing
from mbcacq.model.channel_series import ChannelSeries, MotionSeries
from mbcacq.quantities import symbol
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.blueprint import collapsed, curves_over_time
from mbcacq.recording.rrd.drawable import drawable, drawn_text
from mbcacq.recording.rrd.new_stream import filed
from mbcacq.recording.rrd.result_recording import AFTER, BEFORE

MEASURED = (190, 198, 210)
LINES = {  # entity below that of a joint: name, colour, width
    "measured": ("measured", MEASURED, 2.5),
    "model/before": ("model alone", BEFORE, 1.3),
    "model/after": ("with effects", AFTER, 1.3),
    "residual/before": ("before", BEFORE, 1.3),
    "residual/after": ("after", AFTER, 1.3),
}


@dataclass(frozen=True)
class MotionDrawn:
    """A diagnosis of motion as it is drawn. cards: the diagnosis as Markdown; titles: of the kinds of channel, in words."""

    series: MotionSeries
    cards: str
    titles: Mapping[str, str]


def write_motion(path: Path | str, motion: MotionDrawn) -> Path:
    """Write a .rrd of a diagnosis of motion alone. Raises RecordingError if it cannot be written."""
    blueprint = rrb.Blueprint(rrb.Tabs(*motion_tabs(motion), active_tab=0), *collapsed(layout.ROBOT_TIME))
    with replacing(path) as partial, filed(partial, blueprint) as stream:
        log_motion(stream, motion)
    return Path(path)


def log_motion(stream: rr.RecordingStream, motion: MotionDrawn) -> None:
    """The verdict, and every channel and joint of each recording."""
    stream.log(layout.MOTION_TEXT, drawn_text(motion.cards), static=True)
    for (number, channel, at), stretches in _by_entity(motion.series).items():
        entity = f"{layout.MOTION_CHANNELS}/{number}/{channel}/{at}"
        for name, (label, colour, width) in LINES.items():
            full = drawable(f"{at} {label}")
            stream.log(f"{entity}/{name}", rr.SeriesLines(names=[full], colors=[colour], widths=[width]), static=True)
            time, values = _joined(stretches, name)
            index = rr.TimeColumn(layout.ROBOT_TIME, duration=time)
            stream.send_columns(f"{entity}/{name}", [index], rr.Scalars.columns(scalars=values))


def motion_tabs(motion: MotionDrawn, name: str = "Diagnosis") -> list[rrb.Container]:
    """A tab of that name has the verdict and all residuals of each kind of channel. Then one tab for each kind of channel of each recording
    has the measurements of each joint, both models, and their residuals."""
    series, titles = motion.series, motion.titles
    entities = _by_entity(series)
    text = rrb.TextDocumentView(name="Verdict", origin=layout.MOTION_TEXT)
    left = [
        curves_over_time(
            f"{titles[kind]}, {symbol(series.of(kind)[0].unit)}: residuals before (orange), after (blue)",
            [f"{layout.MOTION_CHANNELS}/{n}/{c}/{at}/residual/**" for n, c, at in entities if c == kind],
        )
        for kind in series.kinds()
    ]
    out: list[rrb.Container] = [rrb.Horizontal(text, rrb.Vertical(*left), column_shares=[2, 3], name=name)]
    for number in range(len(series.recordings)):
        for kind in series.kinds():
            which = f", recording {number + 1}" if len(series.recordings) > 1 else ""
            joints = [at for n, c, at in entities if (n, c) == (number, kind)]
            views = [_joint(f"{layout.MOTION_CHANNELS}/{number}/{kind}/{at}", at, symbol(series.of(kind)[0].unit)) for at in joints]
            out.append(rrb.Grid(*views, grid_columns=min(len(views), 3), name=drawable(f"{titles[kind]}{which}")))
    return out


def _joint(entity: str, at: str, unit: str) -> rrb.Container:
    return rrb.Vertical(
        curves_over_time(
            f"{at}: measured (grey), model alone (orange), with effects (blue), {unit}", [f"{entity}/measured", f"{entity}/model/**"]
        ),
        curves_over_time(f"{at}: measured minus model, {unit}", [f"{entity}/residual/**"]),
        row_shares=[3, 2],
        name=at,
    )


def _by_entity(series: MotionSeries) -> dict[tuple[int, str, str], list[ChannelSeries]]:
    """The stretches of each recording, kind of channel and joint, in the order of time."""
    out: dict[tuple[int, str, str], list[ChannelSeries]] = {}
    for one in series.channels:
        out.setdefault((one.recording, one.channel, one.at), []).append(one)
    return {key: sorted(stretches, key=lambda s: float(s.time_s[0])) for key, stretches in out.items()}


def _joined(stretches: list[ChannelSeries], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and values of stretches one after the other, with a gap between them."""
    what, _, when = name.partition("/")
    each = [s.measured if what == "measured" else s.residual(when) if what == "residual" else getattr(s, when) for s in stretches]
    if len(each) > 1:
        each = [np.concatenate([values, [np.nan]]) for values in each]
    times = [np.concatenate([s.time_s, s.time_s[-1:] + 1e-6]) if len(stretches) > 1 else s.time_s for s in stretches]
    return np.concatenate(times), np.concatenate(each)
