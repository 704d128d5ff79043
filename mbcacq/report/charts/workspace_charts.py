"""Figures of the workspace: joint angles used, where balls and flange were, expected accuracy."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import PHASES, SYMBOLS, Plot, by_phase, thinned
from mbcacq.report.content import AccuracyGrid, Coverage

SIDES = {1: "Y / mm, from above", 2: "Z / mm, from the side"}  # title of the vertical axis, by the axis of the base that it is


def joint_coverage(data: Coverage) -> Figure:
    """Every pose on the range of each axis, of an arm that has joints."""
    assert data.q_deg is not None
    n = data.q_deg.shape[1]
    chart = Plot()
    for i, limits in enumerate(() if data.limits_deg is None else data.limits_deg):
        chart.line(limits, [i + 1, i + 1], colour="#e2e2e2", width=14, showlegend=False, hover=None)
    for k, name, mine in by_phase(data.phase):
        lift, colour = (k - 1) * 0.09, PHASES[k % len(PHASES)]
        y = np.tile(np.arange(1, n + 1), np.count_nonzero(mine)) + lift
        mark = {"colour": colour, "size": 8, "symbol": "line-ns", "edge": (1.2, colour)}
        chart.points(data.q_deg[mine].ravel(), y, name=name, **mark, hover="%{x:.1f}")
    angles_alone = all(name.endswith("°") for name in data.axes)
    axes = {"tickvals": list(range(1, n + 1)), "ticktext": [name.split()[0] if angles_alone else name for name in data.axes]}
    return chart.finished(
        70 + 44 * n,
        "joint angle / °" if angles_alone else "position",
        {**axes, "autorange": "reversed", "showgrid": False, "title": "axis"},
    )


def position_coverage(xyz: np.ndarray, phase: np.ndarray, axis: int) -> Figure:
    """Where flange or balls were, xyz (k, 3) mm in the base with phase (k,) str, from above (axis 1) or from the side (axis 2)."""
    chart = Plot()
    for k, name, mine in sorted(by_phase(phase), key=lambda one: -np.count_nonzero(one[2])):  # few points stand on many
        of_phase = xyz[mine]
        of_phase = of_phase[thinned(np.zeros(len(of_phase)))]
        mark = {"colour": PHASES[k % len(PHASES)], "symbol": SYMBOLS[k % len(SYMBOLS)], "size": 6, "edge": (0.6, "#ffffff")}
        chart.points(of_phase[:, 0], of_phase[:, axis], name=name, legendrank=k, **mark, hover="%{x:.0f}, %{y:.0f} mm")
    add_base(chart)
    return chart.finished(400, "X / mm", {"title": SIDES[axis], "scaleanchor": "x"})


def accuracy(data: AccuracyGrid, axis: int) -> Figure:
    """Expected accuracy, from above (axis 1) or from the side (axis 2): each field shows the rms of the cells behind each other."""
    x, y, z = _projected(data, axis)
    low, top = (1e3 * float(np.nanpercentile(z, share)) for share in (1, 97))  # a scale of its own: where it is better, and where worse
    chart = Plot().heatmap(
        x,
        y,
        1e3 * z,
        ends=(low, max(top, low + 1e-9)),
        colours="Cividis",
        reversescale=True,
        key={"title": {"text": "µm"}, "thickness": 11},
        hover="%{x:.0f}, %{y:.0f} mm: %{z:.1f} µm",
    )
    add_base(chart)
    within = {"constrain": "domain", "showgrid": False}
    chart.finished(400, {"title": "X / mm", **within}, {"title": SIDES[axis], "scaleanchor": "x", **within})
    chart.update_layout(showlegend=False)
    return chart


def _projected(data: AccuracyGrid, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, i = np.unique(data.centres[:, 0], return_inverse=True)
    y, j = np.unique(data.centres[:, axis], return_inverse=True)
    square, count = np.zeros((len(y), len(x))), np.zeros((len(y), len(x)))
    np.add.at(square, (j, i), data.uncertainty_mm**2)
    np.add.at(count, (j, i), 1)
    return x, y, np.where(count > 0, np.sqrt(square / np.maximum(count, 1)), np.nan)


def add_base(chart: Plot) -> None:
    """The foot of the robot."""
    chart.points([0], [0], name="robot base", colour="#222222", symbol="circle-x-open", size=13, edge=(2,), hover=None)
