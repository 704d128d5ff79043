"""Figures of the workspace: joint angles used, where balls and flange were, expected accuracy."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import ESCAPES, PHASES, SYMBOLS, styled, thinned
from mbcacq.report.content import AccuracyGrid, Coverage


def joint_coverage(data: Coverage) -> Figure:
    """Every pose on the range of each axis, of an arm that has joints."""
    assert data.q_deg is not None
    n = data.q_deg.shape[1]
    figure = Figure()
    for i, limits in enumerate(() if data.limits_deg is None else data.limits_deg):
        figure.add_scatter(
            x=limits, y=[i + 1, i + 1], mode="lines", line={"color": "#e2e2e2", "width": 14}, showlegend=False, hoverinfo="skip"
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
    figure.update_xaxes(title="joint angle / °")
    figure.update_yaxes(
        tickvals=list(range(1, n + 1)), ticktext=[f"A{i}" for i in range(1, n + 1)], autorange="reversed", showgrid=False, title="axis"
    )
    return styled(figure, 70 + 44 * n)


def position_coverage(xyz: np.ndarray, phase: np.ndarray, axis: int) -> Figure:
    """Where flange or balls were, xyz (k, 3) mm in the base with phase (k,) str, from above (axis 1) or from the side (axis 2)."""
    figure = Figure()
    names = list(dict.fromkeys(phase))
    for name in sorted(names, key=lambda name: -np.count_nonzero(phase == name)):  # few points stand on many
        k = names.index(name)
        of_phase = xyz[phase == name]
        of_phase = of_phase[thinned(np.zeros(len(of_phase)))]
        figure.add_scatter(
            x=of_phase[:, 0],
            y=of_phase[:, axis],
            mode="markers",
            name=str(name).translate(ESCAPES) or "all poses",
            legendrank=k,
            marker={
                "color": PHASES[k % len(PHASES)],
                "symbol": SYMBOLS[k % len(SYMBOLS)],
                "size": 6,
                "line": {"color": "#ffffff", "width": 0.6},
            },
            hovertemplate="%{x:.0f}, %{y:.0f} mm<extra></extra>",
        )
    add_base(figure)
    figure.update_xaxes(title="X / mm")
    figure.update_yaxes(title=("Y / mm, from above", "Z / mm, from the side")[axis - 1], scaleanchor="x")
    return styled(figure, 400)


def accuracy(data: AccuracyGrid, axis: int) -> Figure:
    """Expected accuracy, from above (axis 1) or from the side (axis 2): each field shows the rms of the cells behind each other."""
    x, y, z = _projected(data, axis)
    low, top = (1e3 * float(np.nanpercentile(z, share)) for share in (1, 97))  # a scale of its own: where it is better, and where worse
    figure = Figure().add(
        "heatmap",
        x=x,
        y=y,
        z=1e3 * z,
        zmin=low,
        zmax=max(top, low + 1e-9),
        colorscale="Cividis",
        reversescale=True,
        xgap=1,
        ygap=1,
        colorbar={"title": {"text": "µm"}, "thickness": 11, "outlinewidth": 0},
        hovertemplate="%{x:.0f}, %{y:.0f} mm: %{z:.1f} µm<extra></extra>",
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
    np.add.at(square, (j, i), data.uncertainty_mm**2)
    np.add.at(count, (j, i), 1)
    return x, y, np.where(count > 0, np.sqrt(square / np.maximum(count, 1)), np.nan)


def add_base(figure: Figure) -> None:
    """The foot of the robot."""
    figure.add_scatter(
        x=[0],
        y=[0],
        mode="markers",
        name="robot base",
        hoverinfo="skip",
        marker={"color": "#222222", "symbol": "circle-x-open", "size": 13, "line": {"width": 2}},
    )
