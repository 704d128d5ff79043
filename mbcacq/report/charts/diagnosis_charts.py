"""Figures of a diagnosis: the evidence map, the response curve of each effect with its band, the misfit along its covariate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, BEFORE, ESCAPES, styled, thinned

ROUGH = 0.12  # mean step from point to point, as a share of the range, above which a response is not drawn as a line


def evidence_map(locations: list[str], covariates: list[str], strength: np.ndarray) -> Figure:
    """Location by covariate: -log10 of the p-value of a motion of the location with the covariate, beyond what free geometry absorbs.

    strength: (locations, covariates), NaN where nothing was tested.
    """
    z = strength
    top = max(float(np.nanmax(z)), 3.0)
    ticks = [v for v in (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000) if v <= top]
    labels = [o.translate(ESCAPES) for o in covariates]
    figure = Figure().add(
        "heatmap",
        z=np.log10(1 + z),
        customdata=z,
        x=labels,
        y=[spaced(a).translate(ESCAPES) for a in locations],
        colorscale="Viridis",
        zmin=0,
        zmax=float(np.log10(1 + top)),
        xgap=1,
        ygap=1,
        colorbar={
            "title": {"text": "−log₁₀ p"},
            "thickness": 12,
            "outlinewidth": 0,
            "tickvals": [float(np.log10(1 + v)) for v in ticks],
            "ticktext": [str(v) for v in ticks],
        },
        hovertemplate="%{y} depends on %{x}: −log₁₀ p = %{customdata:.1f}<extra></extra>",
    )
    figure.update_xaxes(tickangle=-55, dtick=1, showgrid=False, title="depends on")
    figure.update_yaxes(dtick=1, autorange="reversed", showgrid=False, title="location")
    figure = styled(figure, 190 + 19 * len(locations))
    figure.update_layout(meta={"narrow": {"height": 230 + 13 * len(locations), "tick": 7, "angle": -90}})
    return figure


def response_curve(curve: Mapping[str, Any]) -> Figure:
    """Motion of an effect over its covariate: the model with its band (k = 2), and the estimate from each pose alone."""
    x, y, std, of_pose = (np.array(curve[name], dtype=float) for name in ("x", "y", "std", "seen"))
    figure = Figure()
    keep = thinned(np.abs(of_pose))
    figure.add_scatter(
        x=x[keep],
        y=of_pose[keep],
        mode="markers",
        name="poses",
        marker={"color": "#9aa0a6", "size": 4, "opacity": 0.7},
        hovertemplate="%{x:.4g}: %{y:.4g}<extra></extra>",
    )
    span = max(float(np.ptp(y)), 1e-12)
    if len(y) > 8 and np.mean(np.abs(np.diff(y))) < ROUGH * span:
        figure.add_scatter(
            x=np.concatenate([x, x[::-1]]),
            y=np.concatenate([y + 2 * std, (y - 2 * std)[::-1]]),
            fill="toself",
            mode="lines",
            line={"width": 0},
            fillcolor="rgba(0,114,178,0.22)",
            name="k = 2",
            hoverinfo="skip",
        )
        figure.add_scatter(x=x, y=y, mode="lines", name="model", line={"color": AFTER, "width": 2.5})
    else:
        figure.add_scatter(
            x=x,
            y=y,
            mode="markers",
            name="model, k = 2",
            marker={"color": AFTER, "size": 4.5, "symbol": "diamond"},
            error_y={"array": 2 * std, "color": "rgba(0,114,178,0.45)", "thickness": 1, "width": 0},
        )
    low, high = np.percentile(np.concatenate([y - 2 * std, y + 2 * std, np.percentile(of_pose, [2, 98])]), [0, 100])
    pad = 0.12 * max(high - low, 1e-9)
    figure.update_xaxes(title=axis(curve["x_label"], curve["x_unit"]))
    figure.update_yaxes(title=axis(curve["what"], curve["unit"]), range=[low - pad, high + pad], zeroline=True, zerolinecolor="#bbbbbb")
    return styled(figure, 300)


def difference_along(centres: Mapping[str, Any], cause: Mapping[str, Any]) -> Figure:
    """Size of the difference between model and data along a variable that an effect depends on, before and after."""
    x = np.array(cause["values"], dtype=float)
    before, after = (1e3 * np.linalg.norm(np.array(centres[f"{w}_mm"], dtype=float).reshape(-1, 3), axis=1) for w in ("before", "after"))
    figure = Figure()
    for name, values, colour, symbol in (("before", before, BEFORE, "circle"), ("after", after, AFTER, "diamond")):
        keep = thinned(before)
        figure.add_scatter(
            x=x[keep],
            y=values[keep],
            mode="markers",
            name=name,
            marker={"color": colour, "size": 4, "symbol": symbol, "opacity": 0.7},
            hovertemplate="%{x:.4g}: %{y:.1f} µm<extra></extra>",
        )
    figure.update_xaxes(title=axis(cause["label"], cause["unit"]))
    figure.update_yaxes(title="3D difference / µm", rangemode="tozero")
    return styled(figure, 290)


def spaced(location: str) -> str:
    """'station12' -> 'station 12'; the names of joints and links stay."""
    for stem in ("station", "ball"):
        if location.startswith(stem) and len(location) > len(stem):
            return f"{stem} {location.removeprefix(stem)}"
    return location


def axis(label: str, unit: str) -> str:
    return f"{label} / {unit}".translate(ESCAPES) if unit else label.translate(ESCAPES)
