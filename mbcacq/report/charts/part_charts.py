"""Figures of a merged part: each pair of scans before and after the calibration, and the map of deviations from the design."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, BEFORE, LIMIT, Plot
from mbcacq.report.content import PartContent

INWARDS_TO_OUTWARDS = [(0.0, AFTER), (0.5, "#f0f0eb"), (1.0, LIMIT)]


def overlaps(part: PartContent) -> Figure:
    """How far the scans of each pair are apart, on a logarithmic axis, over what is expected of them."""
    chart, expected = Plot(), 1e3 * part.expected_mm
    for name, values, colour in (("before", part.before_mm, BEFORE), ("after", part.after_mm, AFTER)):
        chart.points(expected, 1e3 * values, name=name, colour=colour, size=6, text=part.poses, hover="poses %{text}: %{y:.1f} µm")
    line = np.linspace(expected.min(), expected.max(), 20)
    chart.line(line, line, colour=LIMIT, width=1.5, name="as expected", hover=None)
    return chart.finished(360, {"title": "expected / µm"}, {"title": "3D rms / µm", "type": "log"})


def deviation_map(part: PartContent) -> Figure:
    """Mean deviation from the design, seen along z of its frame."""
    assert part.deviation_mm is not None, "a part that was compared with its design"
    end = 1e3 * float(np.nanquantile(np.abs(part.deviation_mm), 0.98))
    chart = Plot().heatmap(
        part.x_mm,
        part.y_mm,
        1e3 * part.deviation_mm,
        ends=(-end, end),
        colours=INWARDS_TO_OUTWARDS,
        key={"title": {"text": "µm"}},
        hover="%{x:.0f}, %{y:.0f} mm: %{z:.1f} µm",
        gap=0,
    )
    within = {"constrain": "domain", "showgrid": False}
    return chart.finished(360, {"title": "x / mm, CAD frame", **within}, {"title": "y / mm", "scaleanchor": "x", **within})
