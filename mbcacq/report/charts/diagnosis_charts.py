"""Figures of a diagnosis: the evidence map, the response curve of each effect with its band, the misfit along its covariate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, BEFORE, ESCAPES, Plot, thinned

ROUGH = 0.12  # mean step from point to point, as a share of the range, above which a response is not drawn as a line


def evidence_map(locations: list[str], covariates: list[str], strength: np.ndarray) -> Figure:
    """Location by covariate: -log10 of the p-value of a motion of the location with the covariate, beyond what the model explains. Colours
    are logarithmic, so that weak and strong evidence are both seen."""
    top = max(float(np.nanmax(strength)), 3.0)
    ticks = [v for v in (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000) if v <= top]
    chart = Plot().heatmap(
        [name.translate(ESCAPES) for name in covariates],
        [spaced(name).translate(ESCAPES) for name in locations],
        np.log10(1 + strength),
        ends=(0, float(np.log10(1 + top))),
        colours="Viridis",
        key={"title": {"text": "−log₁₀ p"}, "tickvals": [float(np.log10(1 + v)) for v in ticks], "ticktext": [str(v) for v in ticks]},
        customdata=strength,
        hover="%{y} depends on %{x}: −log₁₀ p = %{customdata:.1f}",
    )
    x = {"tickangle": -55, "dtick": 1, "showgrid": False, "title": "depends on"}
    chart.finished(190 + 19 * len(locations), x, {"dtick": 1, "autorange": "reversed", "showgrid": False, "title": "location"})
    chart.update_layout(meta={"narrow": {"height": 230 + 13 * len(locations), "tick": 7, "angle": -90}})
    return chart


def response_curve(curve: Mapping[str, Any]) -> Figure:
    """Motion of an effect over its covariate: the model with its band (k = 2), and the estimate from each pose."""
    x, y, std, of_pose = (np.array(curve[name], dtype=float) for name in ("x", "y", "std", "seen"))
    keep = thinned(np.abs(of_pose))
    chart = Plot().points(x[keep], of_pose[keep], name="poses", colour="#9aa0a6", size=4, opacity=0.7, hover="%{x:.4g}: %{y:.4g}")
    span = max(float(np.ptp(y)), 1e-12)
    if len(y) > 8 and np.mean(np.abs(np.diff(y))) < ROUGH * span:
        there_and_back = np.concatenate([x, x[::-1]]), np.concatenate([y + 2 * std, (y - 2 * std)[::-1]])
        band = {"fill": "toself", "line": {"width": 0}, "fillcolor": "rgba(0,114,178,0.22)"}
        chart.add_scatter(x=there_and_back[0], y=there_and_back[1], mode="lines", **band, name="k = 2", hoverinfo="skip")
        chart.line(x, y, name="model", colour=AFTER, width=2.5)
    else:
        error = {"array": 2 * std, "color": "rgba(0,114,178,0.45)", "thickness": 1, "width": 0}
        chart.points(x, y, name="model, k = 2", colour=AFTER, size=4.5, symbol="diamond", error_y=error)
    low, high = np.percentile(np.concatenate([y - 2 * std, y + 2 * std, np.percentile(of_pose, [2, 98])]), [0, 100])
    pad = 0.12 * max(high - low, 1e-9)
    zero = {"range": [low - pad, high + pad], "zeroline": True, "zerolinecolor": "#bbbbbb"}
    return chart.finished(300, axis(curve["x_label"], curve["x_unit"]), {"title": axis(curve["what"], curve["unit"]), **zero})


def difference_along(centres: Mapping[str, Any], cause: Mapping[str, Any]) -> Figure:
    """Size of the difference between model and data along a variable that an effect depends on, before and after it was taken into the
    model."""
    x = np.array(cause["values"], dtype=float)
    before, after = (1e3 * np.linalg.norm(np.array(centres[f"{w}_mm"], dtype=float).reshape(-1, 3), axis=1) for w in ("before", "after"))
    chart, keep = Plot(), thinned(before)
    for name, values, colour, symbol in (("before", before, BEFORE, "circle"), ("after", after, AFTER, "diamond")):
        mark = {"colour": colour, "size": 4, "symbol": symbol, "opacity": 0.7}
        chart.points(x[keep], values[keep], name=name, **mark, hover="%{x:.4g}: %{y:.1f} µm")
    return chart.finished(290, axis(cause["label"], cause["unit"]), {"title": "3D difference / µm", "rangemode": "tozero"})


def spaced(location: str) -> str:
    """'station12' -> 'station 12'; the names of joints and links stay."""
    for stem in ("station", "ball"):
        if location.startswith(stem) and len(location) > len(stem):
            return f"{stem} {location.removeprefix(stem)}"
    return location


def axis(label: str, unit: str) -> str:
    return f"{label} / {unit}".translate(ESCAPES) if unit else label.translate(ESCAPES)
