"""Figures of the checks of a cell, one after the other, each with its limit."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, LIMIT, LINE, styled

HEIGHT = 260


def check_figures(kept: dict[str, Any]) -> dict[str, Figure]:
    """Difference from the first check, and evidence for a change, over the number of the check (from 1)."""
    difference = _over_checks(kept, "difference", kept["difference_mm"], kept["difference_limit_mm"], "difference / mm")
    since, before = ([value / np.log(10) for value in kept[name]] for name in ("log_e_by_check", "log_e_since_calibration_by_check"))
    evidence = _over_checks(kept, "since the first check", since, kept["log_threshold"] / np.log(10), "evidence, power of ten")
    evidence.add_scatter(
        x=list(range(1, len(before) + 1)),
        y=before,
        mode="markers",
        marker={"color": LINE, "symbol": "x", "size": 7},
        name="since the calibration",
        hovertemplate="check %{x}: 10^%{y:.2f}<extra></extra>",
    )
    return {"difference": difference, "evidence": evidence}


def _over_checks(kept: dict[str, Any], name: str, values: list[float], limit: float, title: str) -> Figure:
    figure = Figure()
    colours = [LIMIT if value > limit else AFTER for value in values]
    figure.add_scatter(
        x=list(range(1, len(values) + 1)),
        y=values,
        text=[time[:16].replace("T", " ") for time in kept["times"]],
        mode="lines+markers",
        line={"color": AFTER, "width": 1},
        marker={"color": colours, "size": 7},
        name=name,
        hovertemplate="check %{x}, %{text}: %{y:.4f}<extra></extra>",
    )
    ends = [1, max(len(values), 2)]
    figure.add_scatter(x=ends, y=[limit, limit], mode="lines", line={"color": LIMIT, "dash": "dash", "width": 1.5}, name="limit")
    figure.update_xaxes(title="check", tickformat="d", **({"dtick": 1} if len(values) < 12 else {}))
    figure.update_yaxes(title=title, rangemode="tozero")
    return styled(figure, HEIGHT)
