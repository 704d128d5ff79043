"""Figure of the identified parameters: their correlation."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from mbcacq.report.charts.style import ESCAPES, styled


def correlation(names: list[str], matrix: np.ndarray) -> go.Figure:
    labels = [n.translate(ESCAPES) for n in names]
    figure = go.Figure(
        go.Heatmap(
            z=matrix,
            x=labels,
            y=labels,
            zmin=-1,
            zmax=1,
            colorscale="RdBu",
            reversescale=True,
            colorbar={"title": "", "thickness": 12, "outlinewidth": 0},
            xgap=0.5,
            ygap=0.5,
            hovertemplate="%{y} · %{x}: %{z:.3f}<extra></extra>",
        )
    )
    figure.update_xaxes(tickangle=-60, tickfont={"size": 9}, showgrid=False, dtick=1, title="parameter")
    figure.update_yaxes(
        autorange="reversed", title="parameter", tickfont={"size": 9}, showgrid=False, scaleanchor="x", constrain="domain", dtick=1
    )
    figure.update_xaxes(constrain="domain")
    figure = styled(figure, 640)
    figure.update_layout(meta={"narrow": {"height": 420, "tick": 6}})
    return figure
