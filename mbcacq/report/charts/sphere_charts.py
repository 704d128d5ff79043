"""Figures of the sphere fits: residual by ball and by number of points."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, Plot, thinned
from mbcacq.report.content import Spheres


def sphere_quality(data: Spheres) -> Figure:
    """Residual of the sphere fits of each ball: half of them in the box, whiskers at 1.5 times its height, what lies beyond as dots."""
    chart = Plot()
    for b in np.unique(data.ball):
        values = data.rms_um[data.ball == b]
        values = values[np.isfinite(values)]
        box = {"y": values[thinned(values)], "name": str(b), "marker": {"color": AFTER, "size": 4}, "line": {"width": 1.4}}
        chart.add("box", showlegend=False, **box)
    return chart.finished(290, {"title": "ball", "type": "category"}, "rms of the sphere fit / µm")


def sphere_points(data: Spheres) -> Figure:
    """Residual of a fit over the number of its points: poor views stand out."""
    keep = thinned(data.rms_um)
    chart = Plot().points(
        data.n_points[keep],
        data.rms_um[keep],
        colour=AFTER,
        size=4,
        opacity=0.55,
        text=[f"pose {p}, ball {b}" for p, b in zip(data.pose[keep], data.ball[keep], strict=True)],
        hover="%{text}: %{x:.0f} points, %{y:.1f} µm",
        showlegend=False,
    )
    return chart.finished(290, {"title": "points on the ball", "rangemode": "tozero"}, "rms of the sphere fit / µm")
