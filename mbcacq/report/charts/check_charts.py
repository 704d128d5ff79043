"""Figures of the checks of a cell, one after the other, each with its limit."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, LIMIT, LINE, Plot

HEIGHT = 260


def check_figures(kept: dict[str, Any]) -> dict[str, Figure]:
    """Difference from the first check, and evidence for a change, over the number of the check (from 1)."""
    difference = _over_checks(kept, "difference", kept["difference_mm"], kept["difference_limit_mm"], "difference / mm")
    since, before = ([value / np.log(10) for value in kept[name]] for name in ("log_e_by_check", "log_e_since_calibration_by_check"))
    evidence = _over_checks(kept, "since the first check", since, kept["log_threshold"] / np.log(10), "evidence, power of ten")
    evidence.points(
        list(range(1, len(before) + 1)),
        before,
        colour=LINE,
        symbol="x",
        size=7,
        name="since the calibration",
        hover="check %{x}: 10^%{y:.2f}",
    )
    return {"difference": difference, "evidence": evidence}


def _over_checks(kept: dict[str, Any], name: str, values: list[float], limit: float, title: str) -> Plot:
    chart = Plot().points(
        list(range(1, len(values) + 1)),
        values,
        colour=[LIMIT if value > limit else AFTER for value in values],
        size=7,
        text=[time[:16].replace("T", " ") for time in kept["times"]],
        mode="lines+markers",
        line={"color": AFTER, "width": 1},
        name=name,
        hover="check %{x}, %{text}: %{y:.4f}",
    )
    chart.line([1, max(len(values), 2)], [limit, limit], colour=LIMIT, dash="dash", width=1.5, name="limit")
    x = {"title": "check", "tickformat": "d"} | ({"dtick": 1} if len(values) < 12 else {})
    return chart.finished(HEIGHT, x, {"title": title, "rangemode": "tozero"})
