"""Scans of a part as a recording: before and after the calibration, the steps between them, the deviations from the CAD model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mbcacq.files.atomic_write import replacing
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.blueprint import collapsed
from mbcacq.recording.rrd.drawable import drawn_text
from mbcacq.recording.rrd.new_stream import filed
from mbcacq.recording.rrd.scan_colouring import GREY, diverging

AS_EXPECTED, WORST = 1.0, 3.0  # step over what is expected of it: ends of the colours
GOLDEN = 0.61803398875  # of the circle of hues between neighbouring scans


@dataclass(frozen=True)
class PartDrawn:
    """What is drawn of a part.

    Attributes
    ----------
    text : str
        Markdown.
    scans : mapping
        Name of a placement -> (g, 4): places in mm, base frame, with the number of their scan.
    times : float
        By which factor these places are off.
    centres, steps, share : ndarray
        (k, 3) mm, (k, 3) mm and (k,): of each overlap its place, how its scans are apart, and that over what is expected.
    deviations : ndarray or None
        (d, 4) mm: points of the part in the CAD frame with their deviation; or None.
    U_mm : float
        Expanded uncertainty at which the colours of the deviations end, twice.
    """

    text: str
    scans: Mapping[str, np.ndarray]
    times: float
    centres: np.ndarray
    steps: np.ndarray
    share: np.ndarray
    deviations: np.ndarray | None = None
    U_mm: float = 0.0


def write_part(path: Path | str, drawn: PartDrawn) -> Path:
    """Write a .rrd of a part alone. Raises RecordingError if it cannot be written."""
    off = f"errors {drawn.times:g} times as large"
    views: list[rrb.View] = [rrb.Spatial3DView(name=f"scans, {name}, {off}", origin=f"part/{name}") for name in drawn.scans]
    views.append(rrb.Spatial3DView(name="steps between scans, 300 times", origin="part/steps"))
    if drawn.deviations is not None:
        views.append(rrb.Spatial3DView(name="deviations from CAD", origin="part/cad"))
    shown = rrb.Horizontal(rrb.Grid(*views), rrb.TextDocumentView(name="agreement", origin="part/text"), column_shares=[4, 1])
    with replacing(path) as partial, filed(partial, rrb.Blueprint(shown, *collapsed(layout.TIME))) as stream:
        _log(stream, drawn)
    return Path(path)


def _log(stream: rr.RecordingStream, drawn: PartDrawn) -> None:
    stream.set_time(layout.TIME, duration=0.0)  # a viewer needs a time, even of what does not change
    stream.log("part/text", drawn_text(drawn.text))
    for name, points in drawn.scans.items():
        around = 6 * ((points[:, 3:] * GOLDEN) % 1.0) + np.array([0.0, 4.0, 2.0])  # red, green and blue along the circle of colours
        colours = np.rint(255 * (np.clip(np.abs(around % 6 - 3) - 1, 0, 1) * 0.75 + 0.2)).astype(np.uint8)
        stream.log(f"part/{name}", rr.Points3D(points[:, :3].astype(np.float32), colors=colours, radii=rr.Radius.ui_points(1.5)))
    whole = list(drawn.scans.values())[-1][::5, :3].astype(np.float32)
    stream.log("part/steps/surface", rr.Points3D(whole, colors=[GREY], radii=rr.Radius.ui_points(0.8)))
    colours = diverging((drawn.share - AS_EXPECTED) / (WORST - AS_EXPECTED))
    arrows = rr.Arrows3D(origins=drawn.centres, vectors=300 * drawn.steps, colors=colours, radii=rr.Radius.ui_points(1.5))
    stream.log("part/steps/arrows", arrows)
    if drawn.deviations is not None:
        points, along = drawn.deviations[:, :3].astype(np.float32), drawn.deviations[:, 3]
        cloud = rr.Points3D(points, colors=diverging(along / (2 * drawn.U_mm)), radii=rr.Radius.ui_points(1.5))
        stream.log("part/cad", cloud)
