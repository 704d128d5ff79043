"""Figures of a diagnosis of motion: a channel of one joint over time with both models, and below it what each leaves."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from mbcacq.model.channel_series import ChannelSeries
from mbcacq.report.charts.diagnosis_charts import axis
from mbcacq.report.charts.style import AFTER, BEFORE, styled

MEASURED = "#777777"


def channel_over_time(series: ChannelSeries, quantity: str, unit: str) -> go.Figure:
    """Measured, model alone and with effects over time; below them the residuals, which have gaps where nothing is compared."""
    time = np.round(series.time_s, 4)
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06, row_heights=[0.55, 0.45])
    lines = (
        ("measured", series.measured, MEASURED, 3.2, "solid", 1),
        ("model alone", series.before, BEFORE, 1.4, "dash", 1),
        ("with effects", series.after, AFTER, 1.4, "solid", 1),
        ("model alone", series.residual("before"), BEFORE, 1.2, "dash", 2),
        ("with effects", series.residual("after"), AFTER, 1.2, "solid", 2),
    )
    for name, values, colour, width, dash, row in lines:
        figure.add_scatter(
            x=time,
            y=_short(values),
            mode="lines",
            name=name,
            legendgroup=name,
            showlegend=row == 1,
            line={"color": colour, "width": width, "dash": dash},
            connectgaps=False,
            hovertemplate=f"{name}: %{{y:.4g}} {unit} at %{{x:.3f}} s<extra></extra>",
            row=row,
            col=1,
        )
    figure = styled(figure, 380)
    figure.update_yaxes(zeroline=True, zerolinecolor="#bbbbbb")
    figure.update_yaxes(title=axis(quantity, unit), row=1, col=1)
    figure.update_yaxes(title=axis("residual", unit), row=2, col=1)
    figure.update_xaxes(title="time / s", row=2, col=1)
    figure.update_xaxes(showticklabels=False, row=1, col=1)
    return figure


def _short(values: np.ndarray) -> list[float | None]:
    """Five significant digits, which a line shows at most; None where there is no value."""
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in values]
