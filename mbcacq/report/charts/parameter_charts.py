"""Figure of the identified parameters: their correlation."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import ESCAPES, styled

# RdBu of ColorBrewer; plotly.js calls another scale so
RED_TO_BLUE = [
    (k / 10, colour)
    for k, colour in enumerate(
        ["#67001f", "#b2182b", "#d6604d", "#f4a582", "#fddbc7", "#f7f7f7", "#d1e5f0", "#92c5de", "#4393c3", "#2166ac", "#053061"]
    )
]


def correlation(names: list[str], matrix: np.ndarray) -> Figure:
    labels = [n.translate(ESCAPES) for n in names]
    figure = Figure().add(
        "heatmap",
        z=matrix,
        x=labels,
        y=labels,
        zmin=-1,
        zmax=1,
        colorscale=RED_TO_BLUE,
        reversescale=True,
        colorbar={"thickness": 12, "outlinewidth": 0},
        xgap=0.5,
        ygap=0.5,
        hovertemplate="%{y} · %{x}: %{z:.3f}<extra></extra>",
    )
    figure.update_xaxes(tickangle=-60, tickfont={"size": 9}, showgrid=False, dtick=1, title="parameter")
    figure.update_yaxes(
        autorange="reversed", title="parameter", tickfont={"size": 9}, showgrid=False, scaleanchor="x", constrain="domain", dtick=1
    )
    figure.update_xaxes(constrain="domain")
    figure = styled(figure, 640)
    figure.update_layout(meta={"narrow": {"height": 420, "tick": 6}})
    return figure
