"""Figures of two recordings compared: each change with its expanded uncertainty."""

from __future__ import annotations

import plotly.graph_objects as go

from mbcacq.quantities import measured, symbol
from mbcacq.report.charts.style import AFTER, ESCAPES, LIMIT, LINE, styled
from mbcacq.report.content import ChangeRow

ROW_PX, FRAME_PX = 22, 90  # of one quantity, and of axis and margins


def changes(rows: list[ChangeRow]) -> go.Figure:
    """Changes of quantities of one unit, each with its expanded uncertainty; those beyond chance in the colour of a limit."""
    figure = go.Figure()
    for marked, name, colour, shape in ((False, "within chance", AFTER, "circle"), (True, "beyond chance", LIMIT, "diamond")):
        shown = [row for row in rows if row.marked == marked]
        figure.add_scatter(
            x=[row.change for row in shown],
            y=[row.name.translate(ESCAPES) for row in shown],
            error_x={"type": "data", "array": [row.expanded for row in shown], "color": colour, "thickness": 1.2, "width": 4},
            mode="markers",
            marker={"color": colour, "size": 8, "symbol": shape},
            name=name,
            text=[measured(row.change, row.expanded, symbol(row.unit)) for row in shown],
            hovertemplate="%{y}: %{text} (k = 2)<extra></extra>",
        )
    figure.add_vline(x=0.0, line={"color": LINE, "width": 1})
    figure.update_yaxes(
        categoryorder="array", categoryarray=[row.name.translate(ESCAPES) for row in rows], autorange="reversed", dtick=1, showgrid=False
    )
    figure.update_xaxes(title=f"change / {symbol(rows[0].unit)}, with U (k = 2)", gridcolor="#e6e6e6")
    return styled(figure, FRAME_PX + ROW_PX * len(rows))
