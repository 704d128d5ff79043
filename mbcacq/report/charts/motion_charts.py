"""Figures of a diagnosis of motion: a channel of one joint over time with both models, and below it what each leaves."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.model.channel_series import ChannelSeries
from mbcacq.report.charts.diagnosis_charts import axis
from mbcacq.report.charts.style import AFTER, BEFORE, Plot

MEASURED = "#777777"
UPPER, LOWER = [0.483, 1.0], [0.0, 0.423]  # shares of the height


def channel_over_time(series: ChannelSeries, quantity: str, unit: str) -> Figure:
    """Measured, model alone and with effects over time; below them the residuals, which have gaps where nothing is compared."""
    time = np.round(series.time_s, 4)
    chart = Plot(layout={"xaxis2": {"anchor": "y2", "matches": "x"}, "yaxis2": {"anchor": "x2"}})
    lines = (
        ("measured", series.measured, MEASURED, 3.2, "solid", 1),
        ("model alone", series.before, BEFORE, 1.4, "dash", 1),
        ("with effects", series.after, AFTER, 1.4, "solid", 1),
        ("model alone", series.residual("before"), BEFORE, 1.2, "dash", 2),
        ("with effects", series.residual("after"), AFTER, 1.2, "solid", 2),
    )
    for name, values, colour, width, dash, row in lines:
        chart.line(
            time,
            _short(values),
            colour=colour,
            width=width,
            dash=dash,
            name=name,
            legendgroup=name,
            showlegend=row == 1,
            connectgaps=False,
            hover=f"{name}: %{{y:.4g}} {unit} at %{{x:.3f}} s",
            xaxis="x" if row == 1 else "x2",
            yaxis="y" if row == 1 else "y2",
        )
    chart.finished(380, {}, {"zeroline": True, "zerolinecolor": "#bbbbbb"})
    layout = chart.layout
    layout["xaxis"] |= {"showticklabels": False}
    layout["xaxis2"] |= {"title": {"text": "time / s"}}
    layout["yaxis"] |= {"title": {"text": axis(quantity, unit)}, "domain": UPPER}
    layout["yaxis2"] |= {"title": {"text": axis("residual", unit)}, "domain": LOWER}
    return chart


def _short(values: np.ndarray) -> list[float | None]:
    """Five significant digits, which a line shows at most; None if there is no value."""
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in values]
