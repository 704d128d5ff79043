"""Figures of the sphere fits: residual by ball and by number of points."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, styled, thinned
from mbcacq.report.content import Spheres


def sphere_quality(data: Spheres) -> Figure:
    """Residual of the sphere fits of each ball: half of them in the box, whiskers at 1.5 times its height, what lies beyond as dots."""
    figure = Figure()
    for b in np.unique(data.ball):
        values = data.rms_um[data.ball == b]
        values = values[np.isfinite(values)]
        box = {"y": values[thinned(values)], "name": str(b), "marker": {"color": AFTER, "size": 4}, "line": {"width": 1.4}}
        figure.add("box", showlegend=False, **box)
    figure.update_xaxes(title="ball", type="category")
    figure.update_yaxes(title="rms of the sphere fit / µm")
    return styled(figure, 290)


def sphere_points(data: Spheres) -> Figure:
    """Residual of a fit over the number of its points: poor views stand out."""
    figure = Figure()
    keep = thinned(data.rms_um)
    figure.add_scatter(
        x=data.n_points[keep],
        y=data.rms_um[keep],
        mode="markers",
        marker={"color": AFTER, "size": 4, "opacity": 0.55},
        text=[f"pose {p}, ball {b}" for p, b in zip(data.pose[keep], data.ball[keep], strict=True)],
        hovertemplate="%{text}: %{x:.0f} points, %{y:.1f} µm<extra></extra>",
        showlegend=False,
    )
    figure.update_xaxes(title="points on the ball", rangemode="tozero")
    figure.update_yaxes(title="rms of the sphere fit / µm")
    return styled(figure, 290)
