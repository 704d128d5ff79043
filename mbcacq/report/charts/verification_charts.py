"""Figure of the verification: sphere spacing error at each place."""

from __future__ import annotations

import plotly.graph_objects as go

from mbcacq.report.charts.style import AFTER, BEFORE, ESCAPES, LIMIT, LINE, styled
from mbcacq.report.content import Spacing


def spacing(data: Spacing) -> go.Figure:
    """Signed spacing error at each place, before and after, with the limit and the standard uncertainty."""
    place = [p.translate(ESCAPES) for p in data.place]
    error = None if data.sigma is None else {"type": "data", "array": 2 * data.sigma, "color": LINE, "thickness": 1.2, "width": 3}
    figure = go.Figure(
        [
            go.Bar(x=place, y=data.before, name="before", marker_color=BEFORE),
            go.Bar(x=place, y=data.after, name="after", marker_color=AFTER, error_y=error),
        ]
    )
    if data.limit is not None:
        for sign in (-1, 1):
            figure.add_hline(sign * data.limit, line={"color": LIMIT, "width": 1.2, "dash": "dash"})
    figure.update_xaxes(title="place", type="category")
    figure.update_yaxes(title="sphere spacing error / mm")
    return styled(figure, 330)
