"""Figures of the devices: late answers, periods, times of exposures and states."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, ESCAPES, LIMIT, LINE, PHASES, styled

SHORT_S = 300.0  # the times of a shorter run are shown in seconds
STATES = {
    "moving": PHASES[0],
    "settling": "#F0E442",
    "scanning": PHASES[2],
    "waiting": PHASES[3],
    "connecting": "#999999",
    "paused": PHASES[1],
    "stopped": "#555555",
}


def late_answers(late: np.ndarray) -> Figure:
    """Number of cycles over the number of late answers that the controller counted, late (k,)."""
    value, count = np.unique(np.rint(late).astype(int), return_counts=True)
    figure = Figure().add_bar(
        x=[str(v) for v in value], y=count, marker={"color": AFTER}, hovertemplate="%{x} late: %{y} cycles<extra></extra>"
    )
    figure.update_xaxes(title="late answers, as the controller counts", type="category")
    figure.update_yaxes(title="cycles (log)", type="log", dtick=1)
    return styled(figure, 270)


def periods(period_ms: np.ndarray, nominal_ms: float | None) -> Figure:
    """Time from cycle to cycle on this computer, (k,) ms, against the controller's period."""
    values = period_ms[np.isfinite(period_ms)]
    high = max(float(np.percentile(values, 99.95)), 2.0 * (nominal_ms or 0.0))
    count, edges = np.histogram(np.clip(values, 0, high), bins=60, range=(0, high))
    figure = Figure().add_bar(
        x=(edges[1:] + edges[:-1]) / 2,
        y=count,
        width=np.diff(edges),
        marker={"color": AFTER, "line": {"width": 0}},
        hovertemplate="%{x:.2f} ms: %{y} cycles<extra></extra>",
    )
    if nominal_ms:
        figure.add_line_across(x=nominal_ms, text=f"controller {nominal_ms:.3g} ms", color=LIMIT, width=1.5, dash="dash")
    figure.update_xaxes(title="period on this computer / ms")
    figure.update_yaxes(title={"text": "cycles (log)", "standoff": 14}, type="log", dtick=1)
    return styled(figure, 270)


def exposure_times(exposure_s: np.ndarray) -> Figure:
    """Histogram of the times (e,) s from one exposure to the next at a pose."""
    figure = Figure().add("histogram", x=exposure_s, nbinsx=40, marker={"color": AFTER}, hovertemplate="%{x} s: %{y}<extra></extra>")
    figure.update_xaxes(title="from one exposure to the next / s", rangemode="tozero")
    figure.update_yaxes(title="exposures")
    return styled(figure, 270)


def time_spent(state_s: list[tuple[str, float]]) -> Figure:
    """Time of the run by state, (state, s)."""
    unit, per_unit = ("min", 60.0) if sum(seconds for _, seconds in state_s) > SHORT_S else ("s", 1.0)
    figure = Figure()
    for name, seconds in state_s:
        figure.add_bar(
            x=[seconds / per_unit],
            y=["run"],
            orientation="h",
            name=f"{name} {seconds / per_unit:.1f} {unit}".translate(ESCAPES),
            marker={"color": STATES.get(name, LINE)},
            hovertemplate=f"{name.translate(ESCAPES)}: %{{x:.1f}} {unit}<extra></extra>",
        )
    figure.update_xaxes(title=f"time / {unit}")
    figure.update_yaxes(visible=False)
    figure = styled(figure, 170)
    figure.update_layout(barmode="stack")
    return figure
