"""Figures of the residuals: by pose, ball, station and joint angle, and against the expected noise."""

from __future__ import annotations

import numpy as np

from mbcacq.calibration.place_errors import ArmImprovement
from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, AXES, BEFORE, ESCAPES, LIMIT, LINE, PHASES, SYMBOLS, styled, thinned
from mbcacq.report.content import Residuals

MOST_STATIONS = 60


def residual_per_pose(data: Residuals) -> Figure:
    """Root mean square 3D residual of the balls of each pose, by phase."""
    pose, index = np.unique(data.pose, return_inverse=True)
    count = np.bincount(index)
    rms = np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / count)
    phase = np.empty(len(pose), dtype=object)
    phase[index] = data.phase
    out = np.zeros(len(pose), bool)
    if data.outlier is not None:
        np.logical_or.at(out, index, data.outlier)
    keep = thinned(rms)
    pose, rms, count, phase, out = pose[keep], rms[keep], count[keep], phase[keep], out[keep]
    figure = Figure()
    for k, name in enumerate(dict.fromkeys(data.phase)):
        mine = phase == name
        figure.add_scatter(
            x=pose[mine],
            y=1e3 * rms[mine],
            mode="markers",
            name=str(name).translate(ESCAPES) or "all poses",
            marker={"color": PHASES[k % len(PHASES)], "symbol": SYMBOLS[k % len(SYMBOLS)], "size": 6},
            customdata=count[mine],
            hovertemplate="pose %{x}: %{y:.1f} µm, %{customdata} balls<extra></extra>",
        )
    if out.any():
        figure.add_scatter(
            x=pose[out],
            y=1e3 * rms[out],
            mode="markers",
            name="with centres left out of the fit",
            hoverinfo="skip",
            marker={"color": LIMIT, "symbol": "circle-open", "size": 13, "line": {"width": 1.8}},
        )
    figure.update_xaxes(title="pose")
    figure.update_yaxes(title="3D residual rms / µm", rangemode="tozero")
    return styled(figure, 290)


def places_missed(data: ArmImprovement) -> Figure:
    """By how much the arm misses each place, before and after its targets were corrected, and what noise alone leaves."""
    figure = Figure()
    keep = thinned(np.array(data.before_mm))
    pose = np.array(data.pose)[keep]
    for name, mm, colour in (("before", data.before_mm, BEFORE), ("after", data.after_mm, AFTER)):
        figure.add_scatter(x=pose, y=np.array(mm)[keep], mode="markers", name=name, marker={"color": colour, "size": 6})
    figure.add_line_across(y=data.noise_mm, color=LINE, dash="dot")
    figure.update_xaxes(title="pose")
    figure.update_yaxes(title="place missed by / mm", type="log")
    return styled(figure, 290)


def residual_per_ball(data: Residuals) -> Figure:
    """Root mean square residual along each scanner axis, for each ball and for all."""
    ball = np.unique(data.ball)
    labels = [str(b) for b in ball] + ["all"]
    groups = [data.ball == b for b in ball] + [np.ones(len(data.ball), dtype=bool)]
    figure = Figure()
    for axis, (name, colour) in enumerate(AXES.items()):
        rms = [1e3 * np.sqrt(np.mean(data.xyz[g, axis] ** 2)) for g in groups]
        figure.add_bar(x=labels, y=rms, name=name, marker={"color": colour})
    figure.update_xaxes(title="ball", type="category")
    figure.update_yaxes(title="residual rms / µm")
    return styled(figure, 290)


def residual_mean_per_ball(data: Residuals) -> Figure:
    """Mean residual along each scanner axis for each ball, with twice its standard error: a ball off its certificate shows here."""
    ball = np.unique(data.ball)
    figure = Figure()
    for axis, (name, colour) in enumerate(AXES.items()):
        values = [1e3 * data.xyz[data.ball == b, axis] for b in ball]
        error = [2 * np.std(v) / np.sqrt(len(v)) for v in values]
        figure.add_scatter(
            x=[str(b) for b in ball],
            y=[np.mean(v) for v in values],
            mode="markers",
            name=name,
            marker={"color": colour, "size": 8},
            error_y={"array": error, "color": colour, "thickness": 1.2, "width": 3},
        )
    figure.update_xaxes(title="ball", type="category")
    figure.update_yaxes(title="mean residual / µm", zeroline=True, zerolinecolor=LINE)
    figure.update_layout(scattermode="group")
    return styled(figure, 290)


def residual_per_station(data: Residuals, stations: np.ndarray) -> Figure:
    """Root mean square 3D residual of each station; of many, the largest. stations: (M,) str, of each centre."""
    station, index = np.unique(stations, return_inverse=True)
    count = np.bincount(index)
    rms = 1e3 * np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / count)
    order = np.argsort(-rms)[:MOST_STATIONS]
    order = np.array(sorted(order, key=lambda k: np.min(np.flatnonzero(index == k))))
    figure = Figure().add_bar(
        x=[str(s).translate(ESCAPES) for s in station[order]],
        y=rms[order],
        marker={"color": AFTER},
        customdata=count[order],
        hovertemplate="station %{x}: %{y:.1f} µm, %{customdata} centres<extra></extra>",
    )
    figure.update_xaxes(title="station", type="category")
    figure.update_yaxes(title="3D residual rms / µm")
    return styled(figure, 290)


def residual_over_axis(data: Residuals, q_deg: np.ndarray, axis: int) -> Figure:
    """3D residual of each pose over the angle of one axis, and its running rms, which shows errors of that joint.

    q_deg: (M, n) joint angles at each centre.
    """
    _, first, index = np.unique(data.pose, return_index=True, return_inverse=True)
    rms = 1e3 * np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / np.bincount(index))
    q = q_deg[first, axis]
    keep = thinned(rms)
    top = float(np.percentile(rms, 99)) * 1.25
    figure = Figure()
    figure.add_scatter(
        x=q[keep],
        y=np.minimum(rms[keep], top),
        mode="markers",
        name="pose",
        marker={"color": "#8fb3cc", "size": 4},
        hovertemplate="%{x:.1f}°: %{y:.1f} µm<extra></extra>",
    )
    x, y = _running(q, rms)
    figure.add_scatter(x=x, y=y, mode="lines", name="running rms", line={"color": "#0B3C5D", "width": 2.5})
    figure.update_xaxes(title=f"A{axis + 1} / °")
    figure.update_yaxes(title="3D residual / µm", rangemode="tozero")
    return styled(figure, 240)


def _running(x: np.ndarray, y: np.ndarray, parts: int = 12) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(x)
    groups = [g for g in np.array_split(order, min(parts, max(len(x) // 5, 1))) if len(g)]
    return np.array([x[g].mean() for g in groups]), np.array([np.sqrt(np.mean(y[g] ** 2)) for g in groups])


def histogram(weighted: np.ndarray) -> Figure:
    """Residuals over their expected standard deviation, (M, r), against the normal distribution."""
    values = weighted[np.isfinite(weighted)]
    edges = np.linspace(-5, 5, 51)
    density, _ = np.histogram(np.clip(values, -4.999, 4.999), edges, density=True)
    middle = (edges[1:] + edges[:-1]) / 2
    t = np.linspace(-5, 5, 201)
    figure = Figure()
    figure.add_bar(x=middle, y=density, width=0.2, name="observed", marker={"color": AFTER, "line": {"width": 0}})
    figure.add_scatter(x=t, y=np.exp(-t * t / 2) / np.sqrt(2 * np.pi), mode="lines", name="expected", line={"color": LIMIT, "width": 2})
    figure.update_xaxes(title="residual / expected σ", range=[-5, 5])
    figure.update_yaxes(title="density")
    return styled(figure, 290)
