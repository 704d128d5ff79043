"""Figure of the identified parameters: their correlation."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import ESCAPES, Plot

# RdBu of ColorBrewer; plotly.js calls another scale so
RED_TO_BLUE = [
    (k / 10, colour)
    for k, colour in enumerate(
        ["#67001f", "#b2182b", "#d6604d", "#f4a582", "#fddbc7", "#f7f7f7", "#d1e5f0", "#92c5de", "#4393c3", "#2166ac", "#053061"]
    )
]


def correlation(names: list[str], matrix: np.ndarray) -> Figure:
    labels = [n.translate(ESCAPES) for n in names]
    chart = Plot().heatmap(
        labels, labels, matrix, ends=(-1, 1), colours=RED_TO_BLUE, reversescale=True, key={}, gap=0.5, hover="%{y} · %{x}: %{z:.3f}"
    )
    shared = {"tickfont": {"size": 9}, "showgrid": False, "dtick": 1, "title": "parameter", "constrain": "domain"}
    chart.finished(640, {"tickangle": -60, **shared}, {"autorange": "reversed", "scaleanchor": "x", **shared})
    chart.update_layout(meta={"narrow": {"height": 420, "tick": 6}})
    return chart
