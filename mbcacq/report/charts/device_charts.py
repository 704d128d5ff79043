"""Figures of the devices: late answers, periods, times of exposures and states."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, ESCAPES, LIMIT, LINE, PHASES, Plot

HEIGHT = 270
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
    chart = Plot().bars([str(v) for v in value], count, colour=AFTER, hover="%{x} late: %{y} cycles")
    x = {"title": "late answers, as the controller counts", "type": "category"}
    return chart.finished(HEIGHT, x, {"title": "cycles (log)", "type": "log", "dtick": 1})


def periods(period_ms: np.ndarray, nominal_ms: float | None) -> Figure:
    """Time from cycle to cycle on this computer, (k,) ms, against the controller's period."""
    values = period_ms[np.isfinite(period_ms)]
    high = max(float(np.percentile(values, 99.95)), 2.0 * (nominal_ms or 0.0))
    count, edges = np.histogram(np.clip(values, 0, high), bins=60, range=(0, high))
    middle, hover = (edges[1:] + edges[:-1]) / 2, "%{x:.2f} ms: %{y} cycles"
    chart = Plot().bars(middle, count, width=np.diff(edges), colour=AFTER, edge=0, hover=hover)
    if nominal_ms:
        chart.add_line_across(x=nominal_ms, text=f"controller {nominal_ms:.3g} ms", color=LIMIT, width=1.5, dash="dash")
    y = {"title": {"text": "cycles (log)", "standoff": 14}, "type": "log", "dtick": 1}
    return chart.finished(HEIGHT, "period on this computer / ms", y)


def exposure_times(exposure_s: np.ndarray) -> Figure:
    """Histogram of the times (e,) s from one exposure to the next at a pose."""
    chart = Plot()
    chart.add("histogram", x=exposure_s, nbinsx=40, marker={"color": AFTER}, hovertemplate="%{x} s: %{y}<extra></extra>")
    return chart.finished(HEIGHT, {"title": "from one exposure to the next / s", "rangemode": "tozero"}, "exposures")


def time_spent(state_s: list[tuple[str, float]]) -> Figure:
    """Time of the run by state, (state, s)."""
    unit, per_unit = ("min", 60.0) if sum(seconds for _, seconds in state_s) > SHORT_S else ("s", 1.0)
    chart = Plot()
    for state, seconds in state_s:
        time, name = seconds / per_unit, state.translate(ESCAPES)
        chart.bars(
            [time],
            ["run"],
            orientation="h",
            name=f"{name} {time:.1f} {unit}",
            colour=STATES.get(state, LINE),
            hover=f"{name}: %{{x:.1f}} {unit}",
        )
    chart.finished(170, f"time / {unit}", {"visible": False})
    chart.update_layout(barmode="stack")
    return chart
