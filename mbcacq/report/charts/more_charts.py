"""Figures by station and axis of the arm, of the spheres, of the workspace, and of the devices."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from mbcacq.report.charts.calibration_charts import AFTER, ESCAPES, LIMIT, LINE, PHASES, add_base, styled, thinned
from mbcacq.report.content import AccuracyGrid, Devices, Residuals, Spheres

MOST_STATIONS = 60
STATES = {
    "moving": PHASES[0],
    "settling": "#F0E442",
    "scanning": PHASES[2],
    "waiting": PHASES[3],
    "connecting": "#999999",
    "paused": PHASES[1],
    "stopped": "#555555",
}


def residual_per_station(data: Residuals) -> go.Figure:
    """Root mean square 3D residual of each station; of many, the largest."""
    station, index = np.unique(data.station, return_inverse=True)
    count = np.bincount(index)
    rms = 1e3 * np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / count)
    order = np.argsort(-rms)[:MOST_STATIONS]
    order = np.array(sorted(order, key=lambda k: np.min(np.flatnonzero(index == k))))
    figure = go.Figure(
        go.Bar(
            x=[str(s).translate(ESCAPES) for s in station[order]],
            y=rms[order],
            marker_color=AFTER,
            customdata=count[order],
            hovertemplate="station %{x}: %{y:.1f} µm, %{customdata} centres<extra></extra>",
        )
    )
    figure.update_xaxes(title="station", type="category")
    figure.update_yaxes(title="3D residual rms / µm")
    return styled(figure, 290)


def residual_over_axis(data: Residuals, axis: int) -> go.Figure:
    """3D residual of each pose over the angle of one axis, and its running rms: what belongs to a joint shows here."""
    _, first, index = np.unique(data.pose, return_index=True, return_inverse=True)
    rms = 1e3 * np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / np.bincount(index))
    q = data.q_deg[first, axis]
    keep = thinned(rms)
    top = float(np.percentile(rms, 99)) * 1.25
    figure = go.Figure()
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
    figure.update_xaxes(title=f"A{axis + 1} / deg")
    figure.update_yaxes(title="3D residual / µm", rangemode="tozero")
    return styled(figure, 240)


def _running(x: np.ndarray, y: np.ndarray, parts: int = 12) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(x)
    groups = [g for g in np.array_split(order, min(parts, max(len(x) // 5, 1))) if len(g)]
    return np.array([x[g].mean() for g in groups]), np.array([np.sqrt(np.mean(y[g] ** 2)) for g in groups])


def sphere_quality(data: Spheres) -> go.Figure:
    """Residual of the sphere fits of each ball: half of them in the box, whiskers at 1.5 times its height, what lies beyond as dots."""
    figure = go.Figure()
    for b in np.unique(data.ball):
        values = data.rms_um[data.ball == b]
        values = values[np.isfinite(values)]
        figure.add_box(y=values[thinned(values)], name=str(b), marker={"color": AFTER, "size": 4}, line={"width": 1.4}, showlegend=False)
    figure.update_xaxes(title="ball", type="category")
    figure.update_yaxes(title="rms of the sphere fit / µm")
    return styled(figure, 290)


def sphere_points(data: Spheres) -> go.Figure:
    """Residual of a fit over the number of its points: poor views stand out."""
    figure = go.Figure()
    keep = thinned(data.rms_um)
    figure.add_scatter(
        x=data.n_points[keep],
        y=data.rms_um[keep],
        mode="markers",
        marker={"color": AFTER, "size": 4, "opacity": 0.55},
        text=[f"pose {p}, ball {b}" for p, b in zip(data.pose[keep], data.ball[keep], strict=True)],
        hovertemplate="%{text}: %{x:.0f} points, %{y:.1f} µm<extra></extra>",
        showlegend=False,
    )
    figure.update_xaxes(title="points on the ball", rangemode="tozero")
    figure.update_yaxes(title="rms of the sphere fit / µm")
    return styled(figure, 290)


def accuracy(data: AccuracyGrid, axis: int) -> go.Figure:
    """Expected accuracy, from above (axis 1) or from the side (axis 2): each field shows the rms of the cells behind one another."""
    x, y, z = _projected(data, axis)
    top = 1e3 * max(float(np.nanpercentile(_projected(data, a)[2], 97)) for a in (1, 2))
    figure = go.Figure(
        go.Heatmap(
            x=x,
            y=y,
            z=1e3 * z,
            zmin=0,
            zmax=top,
            colorscale="Cividis",
            reversescale=True,
            xgap=1,
            ygap=1,
            colorbar={"title": {"text": "µm"}, "thickness": 11, "outlinewidth": 0},
            hovertemplate="%{x:.0f}, %{y:.0f} mm: %{z:.1f} µm<extra></extra>",
        )
    )
    add_base(figure)
    figure.update_xaxes(title="X / mm")
    figure.update_yaxes(title=("Y / mm, from above", "Z / mm, from the side")[axis - 1], scaleanchor="x")
    figure = styled(figure, 400)
    figure.update_layout(showlegend=False)
    figure.update_xaxes(constrain="domain", showgrid=False)
    figure.update_yaxes(constrain="domain", showgrid=False)
    return figure


def _projected(data: AccuracyGrid, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, i = np.unique(data.centres[:, 0], return_inverse=True)
    y, j = np.unique(data.centres[:, axis], return_inverse=True)
    square, count = np.zeros((len(y), len(x))), np.zeros((len(y), len(x)))
    np.add.at(square, (j, i), data.sigma_mm**2)
    np.add.at(count, (j, i), 1)
    return x, y, np.where(count > 0, np.sqrt(square / np.maximum(count, 1)), np.nan)


def late_answers(data: Devices) -> go.Figure:
    """How many cycles found how many late answers counted by the controller."""
    value, count = np.unique(np.rint(data.late).astype(int), return_counts=True)
    figure = go.Figure(
        go.Bar(x=[str(v) for v in value], y=count, marker_color=AFTER, hovertemplate="%{x} late: %{y} cycles<extra></extra>")
    )
    figure.update_xaxes(title="late answers, as the controller counts", type="category")
    figure.update_yaxes(title="cycles (log)", type="log", dtick=1)
    return styled(figure, 270)


def periods(data: Devices) -> go.Figure:
    """Time from cycle to cycle on this computer, against the controller's period."""
    values = data.period_ms[np.isfinite(data.period_ms)]
    high = max(float(np.percentile(values, 99.95)), 2.0 * (data.nominal_ms or 0.0))
    count, edges = np.histogram(np.clip(values, 0, high), bins=60, range=(0, high))
    figure = go.Figure(
        go.Bar(
            x=(edges[1:] + edges[:-1]) / 2,
            y=count,
            width=np.diff(edges),
            marker_color=AFTER,
            marker_line_width=0,
            hovertemplate="%{x:.2f} ms: %{y} cycles<extra></extra>",
        )
    )
    if data.nominal_ms:
        figure.add_vline(
            data.nominal_ms,
            line={"color": LIMIT, "width": 1.5, "dash": "dash"},
            annotation={"text": f"controller {data.nominal_ms:.3g} ms", "font": {"size": 11}},
        )
    figure.update_xaxes(title="period on this computer / ms")
    figure.update_yaxes(title="cycles (log)", type="log", dtick=1)
    return styled(figure, 270)


def exposure_times(data: Devices) -> go.Figure:
    figure = go.Figure(go.Histogram(x=data.exposure_s, nbinsx=40, marker_color=AFTER, hovertemplate="%{x} s: %{y}<extra></extra>"))
    figure.update_xaxes(title="from one exposure to the next / s", rangemode="tozero")
    figure.update_yaxes(title="exposures")
    return styled(figure, 270)


def time_spent(data: Devices) -> go.Figure:
    """Where the time of the run went."""
    figure = go.Figure()
    for name, seconds in data.state_s:
        figure.add_bar(
            x=[seconds / 60],
            y=["run"],
            orientation="h",
            name=f"{name} {seconds / 60:.1f} min".translate(ESCAPES),
            marker_color=STATES.get(name, LINE),
            hovertemplate=f"{name.translate(ESCAPES)}: %{{x:.1f}} min<extra></extra>",
        )
    figure.update_xaxes(title="time / min")
    figure.update_yaxes(visible=False)
    figure = styled(figure, 170)
    figure.update_layout(barmode="stack")
    return figure
