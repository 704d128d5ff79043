"""The figures of the report. Each takes plain values of ``content`` and returns a plotly figure; one look for all."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from mbcacq.report.content import Coverage, Residuals, Spacing

# Okabe and Ito's colours, which all eyes tell apart; markers differ as well.
BEFORE, AFTER, LINE, LIMIT = "#E69F00", "#0072B2", "#444444", "#8A2B0B"
AXES = {"x": "#0072B2", "y": "#E69F00", "z": "#009E73"}
PHASES = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#777777"]
SYMBOLS = ["circle", "diamond", "square", "cross", "triangle-up", "x"]
MOST = 2500  # points drawn of a cloud of points; the largest all, the rest evenly
# axis titles are drawn as HTML by plotly; names from files are plain text
ESCAPES = str.maketrans({"<": "&lt;", ">": "&gt;", "&": "&amp;"})


def spacing(data: Spacing) -> go.Figure:
    """Signed spacing error at each place, before and after, with the limit and the standard uncertainty."""
    place = [p.translate(ESCAPES) for p in data.place]
    error = None if data.sigma is None else {"type": "data", "array": 2 * data.sigma, "color": LINE, "thickness": 1.2, "width": 3}
    figure = go.Figure(
        [
            go.Bar(x=place, y=data.before, name="before", marker_color=BEFORE),
            go.Bar(x=place, y=data.after, name="after", marker_color=AFTER, error_y=error),
        ]
    )
    if data.limit is not None:
        for sign in (-1, 1):
            figure.add_hline(sign * data.limit, line={"color": LIMIT, "width": 1.2, "dash": "dash"})
    figure.update_xaxes(title="place", type="category")
    figure.update_yaxes(title="sphere spacing error / mm")
    return styled(figure, 330)


def residual_per_pose(data: Residuals) -> go.Figure:
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
    figure = go.Figure()
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


def thinned(size: np.ndarray) -> np.ndarray:
    """Indices of what is drawn of many points: those of the largest size (k,) all, the rest evenly, in their order."""
    if len(size) <= MOST:
        return np.arange(len(size))
    largest = np.argsort(-np.nan_to_num(size))[: MOST // 5]
    return np.union1d(largest, np.arange(0, len(size), len(size) // (MOST - MOST // 5) + 1))


def residual_per_ball(data: Residuals) -> go.Figure:
    """Root mean square residual along each scanner axis, for each ball and for all."""
    ball = np.unique(data.ball)
    labels = [str(b) for b in ball] + ["all"]
    groups = [data.ball == b for b in ball] + [np.ones(len(data.ball), dtype=bool)]
    figure = go.Figure()
    for axis, (name, colour) in enumerate(AXES.items()):
        rms = [1e3 * np.sqrt(np.mean(data.xyz[g, axis] ** 2)) for g in groups]
        figure.add_bar(x=labels, y=rms, name=name, marker_color=colour)
    figure.update_xaxes(title="ball", type="category")
    figure.update_yaxes(title="residual rms / µm")
    return styled(figure, 290)


def residual_mean_per_ball(data: Residuals) -> go.Figure:
    """Mean residual along each scanner axis for each ball, with twice its standard error: a ball off its certificate shows here."""
    ball = np.unique(data.ball)
    figure = go.Figure()
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


def histogram(data: Residuals) -> go.Figure:
    """Residuals over their expected standard deviation against the normal distribution."""
    values = data.weighted[np.isfinite(data.weighted)]
    edges = np.linspace(-5, 5, 51)
    density, _ = np.histogram(np.clip(values, -4.999, 4.999), edges, density=True)
    middle = (edges[1:] + edges[:-1]) / 2
    t = np.linspace(-5, 5, 201)
    figure = go.Figure(
        [
            go.Bar(x=middle, y=density, width=0.2, name="observed", marker_color=AFTER, marker_line_width=0),
            go.Scatter(x=t, y=np.exp(-t * t / 2) / np.sqrt(2 * np.pi), mode="lines", name="expected", line={"color": LIMIT, "width": 2}),
        ]
    )
    figure.update_xaxes(title="residual / expected σ", range=[-5, 5])
    figure.update_yaxes(title="density")
    return styled(figure, 290)


def correlation(names: list[str], matrix: np.ndarray) -> go.Figure:
    labels = [n.translate(ESCAPES) for n in names]
    figure = go.Figure(
        go.Heatmap(
            z=matrix,
            x=labels,
            y=labels,
            zmin=-1,
            zmax=1,
            colorscale="RdBu",
            reversescale=True,
            colorbar={"title": "", "thickness": 12, "outlinewidth": 0},
            xgap=0.5,
            ygap=0.5,
            hovertemplate="%{y} · %{x}: %{z:.3f}<extra></extra>",
        )
    )
    figure.update_xaxes(tickangle=-60, tickfont={"size": 9}, showgrid=False, dtick=1, title="parameter")
    figure.update_yaxes(
        autorange="reversed", title="parameter", tickfont={"size": 9}, showgrid=False, scaleanchor="x", constrain="domain", dtick=1
    )
    figure.update_xaxes(constrain="domain")
    figure = styled(figure, 640)
    figure.update_layout(meta={"narrow": {"height": 420, "tick": 6}})
    return figure


def joint_coverage(data: Coverage) -> go.Figure:
    """Every pose on the range of each axis."""
    n = data.q_deg.shape[1]
    figure = go.Figure()
    for i in range(n) if data.limits_deg is not None else ():
        figure.add_scatter(
            x=data.limits_deg[i], y=[i + 1, i + 1], mode="lines", line={"color": "#e2e2e2", "width": 14}, showlegend=False, hoverinfo="skip"
        )
    for k, name in enumerate(dict.fromkeys(data.phase)):
        mine = np.flatnonzero(data.phase == name)
        lift, colour = (k - 1) * 0.09, PHASES[k % len(PHASES)]
        figure.add_scatter(
            x=data.q_deg[mine].ravel(),
            y=np.tile(np.arange(1, n + 1), len(mine)) + lift,
            mode="markers",
            name=str(name).translate(ESCAPES) or "all poses",
            marker={"color": colour, "size": 8, "symbol": "line-ns", "line": {"width": 1.2, "color": colour}},
            hovertemplate="%{x:.1f}°<extra></extra>",
        )
    figure.update_xaxes(title="joint angle / deg")
    figure.update_yaxes(
        tickvals=list(range(1, n + 1)), ticktext=[f"A{i}" for i in range(1, n + 1)], autorange="reversed", showgrid=False, title="axis"
    )
    return styled(figure, 70 + 44 * n)


def place_coverage(data: Coverage, axis: int) -> go.Figure:
    """Where the flange stood, from above (axis 1) or from the side (axis 2), with the robot's foot."""
    return places({str(name): data.flange[data.phase == name] for name in dict.fromkeys(data.phase)}, axis)


def ball_coverage(data: Coverage, axis: int) -> go.Figure:
    """Where balls were measured, likewise."""
    return places({str(name): data.balls[data.ball_phase == name] for name in dict.fromkeys(data.ball_phase)}, axis)


def places(of_phase: dict[str, np.ndarray], axis: int) -> go.Figure:
    figure = go.Figure()
    for k, (name, place) in enumerate(of_phase.items()):
        place = place[thinned(np.zeros(len(place)))]
        figure.add_scatter(
            x=place[:, 0],
            y=place[:, axis],
            mode="markers",
            name=name.translate(ESCAPES) or "all poses",
            marker={"color": PHASES[k % len(PHASES)], "symbol": SYMBOLS[k % len(SYMBOLS)], "size": 5, "opacity": 0.75},
            hovertemplate="%{x:.0f}, %{y:.0f} mm<extra></extra>",
        )
    add_base(figure)
    figure.update_xaxes(title="X / mm")
    figure.update_yaxes(title=("Y / mm, from above", "Z / mm, from the side")[axis - 1], scaleanchor="x")
    return styled(figure, 400)


def add_base(figure: go.Figure) -> None:
    """The foot of the robot."""
    figure.add_scatter(
        x=[0],
        y=[0],
        mode="markers",
        name="robot base",
        hoverinfo="skip",
        marker={"color": "#222222", "symbol": "circle-x-open", "size": 13, "line": {"width": 2}},
    )


def styled(figure: go.Figure, height: int) -> go.Figure:
    figure.update_layout(
        template="none",
        height=height,
        margin={"l": 62, "r": 16, "t": 26, "b": 48},
        barmode="group",
        bargap=0.28,
        font={"family": "Helvetica, Arial, sans-serif", "size": 12, "color": "#222222"},
        legend={"orientation": "h", "x": 1, "xanchor": "right", "y": 1.02, "yanchor": "bottom"},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
    )
    figure.update_xaxes(automargin=True, showline=True, linecolor=LINE, ticks="outside", ticklen=4, zeroline=False)
    figure.update_yaxes(automargin=True, gridcolor="#e6e6e6", showline=True, linecolor=LINE, ticks="outside", ticklen=4)
    return figure
