"""Figures of the residuals: by pose, ball, station and joint angle, and against the expected noise."""

from __future__ import annotations

import numpy as np

from mbcacq.calibration.place_errors import ArmImprovement
from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, AXES, BEFORE, ESCAPES, LIMIT, LINE, PHASES, SYMBOLS, Plot, by_phase, thinned
from mbcacq.report.content import Residuals

HEIGHT, MOST_STATIONS = 290, 60


def residual_per_pose(data: Residuals) -> Figure:
    """Root mean square 3D residual of the balls of each pose, by phase."""
    pose, first, index = np.unique(data.pose, return_index=True, return_inverse=True)
    count = np.bincount(index)
    rms = np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / count)
    out = np.zeros(len(pose), bool)
    if data.outlier is not None:
        np.logical_or.at(out, index, data.outlier)
    keep = thinned(rms)
    pose, rms, count, out = pose[keep], rms[keep], count[keep], out[keep]
    chart = Plot()
    for k, name, mine in by_phase(data.phase):
        mine = mine[first][keep]
        mark = {"colour": PHASES[k % len(PHASES)], "symbol": SYMBOLS[k % len(SYMBOLS)], "size": 6}
        chart.points(
            pose[mine], 1e3 * rms[mine], name=name, **mark, customdata=count[mine], hover="pose %{x}: %{y:.1f} µm, %{customdata} balls"
        )
    if out.any():
        mark = {"colour": LIMIT, "symbol": "circle-open", "size": 13, "edge": (1.8,)}
        chart.points(pose[out], 1e3 * rms[out], name="with centres left out of the fit", **mark, hover=None)
    return chart.finished(HEIGHT, "pose", {"title": "3D residual rms / µm", "rangemode": "tozero"})


def places_missed(data: ArmImprovement) -> Figure:
    """By how much the arm misses each place, before and after its targets were corrected, and what noise alone would show."""
    chart, keep = Plot(), thinned(np.array(data.before_mm))
    pose = np.array(data.pose)[keep]
    for name, mm, colour in (("before", data.before_mm, BEFORE), ("after", data.after_mm, AFTER)):
        chart.points(pose, np.array(mm)[keep], name=name, colour=colour, size=6)
    chart.add_line_across(y=data.noise_mm, color=LINE, dash="dot")
    return chart.finished(HEIGHT, "pose", {"title": "place missed by / mm", "type": "log"})


def residual_per_ball(data: Residuals) -> Figure:
    """Root mean square residual along each scanner axis, for each ball and for all."""
    ball = np.unique(data.ball)
    labels = [str(b) for b in ball] + ["all"]
    groups = [data.ball == b for b in ball] + [np.ones(len(data.ball), dtype=bool)]
    chart = Plot()
    for axis, (name, colour) in enumerate(AXES.items()):
        chart.bars(labels, [1e3 * np.sqrt(np.mean(data.xyz[g, axis] ** 2)) for g in groups], name=name, colour=colour)
    return chart.finished(HEIGHT, {"title": "ball", "type": "category"}, "residual rms / µm")


def residual_mean_per_ball(data: Residuals) -> Figure:
    """Mean residual along each scanner axis for each ball, with twice its standard error: a ball off its certificate stands out."""
    ball = np.unique(data.ball)
    chart = Plot()
    for axis, (name, colour) in enumerate(AXES.items()):
        values = [1e3 * data.xyz[data.ball == b, axis] for b in ball]
        error = {"array": [2 * np.std(v) / np.sqrt(len(v)) for v in values], "color": colour, "thickness": 1.2, "width": 3}
        chart.points([str(b) for b in ball], [np.mean(v) for v in values], name=name, colour=colour, size=8, error_y=error)
    chart.update_layout(scattermode="group")
    y = {"title": "mean residual / µm", "zeroline": True, "zerolinecolor": LINE}
    return chart.finished(HEIGHT, {"title": "ball", "type": "category"}, y)


def residual_per_station(data: Residuals, stations: np.ndarray) -> Figure:
    """Root mean square 3D residual of each station; of many, the largest. stations: (M,) str, of each centre."""
    station, index = np.unique(stations, return_inverse=True)
    count = np.bincount(index)
    rms = 1e3 * np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / count)
    order = np.argsort(-rms)[:MOST_STATIONS]
    order = np.array(sorted(order, key=lambda k: np.min(np.flatnonzero(index == k))))
    names, hover = [str(s).translate(ESCAPES) for s in station[order]], "station %{x}: %{y:.1f} µm, %{customdata} centres"
    chart = Plot().bars(names, rms[order], colour=AFTER, customdata=count[order], hover=hover)
    return chart.finished(HEIGHT, {"title": "station", "type": "category"}, "3D residual rms / µm")


def residual_over_axis(data: Residuals, q_deg: np.ndarray, axis: int) -> Figure:
    """3D residual of each pose over the angle of one axis, and its running rms, which shows errors of that joint.

    q_deg: (M, n) joint angles at each centre.
    """
    _, first, index = np.unique(data.pose, return_index=True, return_inverse=True)
    rms = 1e3 * np.sqrt(np.bincount(index, np.sum(data.xyz**2, axis=1)) / np.bincount(index))
    q = q_deg[first, axis]
    keep = thinned(rms)
    top = float(np.percentile(rms, 99)) * 1.25
    chart = Plot().points(q[keep], np.minimum(rms[keep], top), name="pose", colour="#8fb3cc", size=4, hover="%{x:.1f}: %{y:.1f} µm")
    chart.line(*_running(q, rms), name="running rms", colour="#0B3C5D", width=2.5)
    return chart.finished(240, data.axes[axis], {"title": "3D residual / µm", "rangemode": "tozero"})


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
    chart = Plot().bars(middle, density, width=0.2, name="observed", colour=AFTER, edge=0)
    chart.line(t, np.exp(-t * t / 2) / np.sqrt(2 * np.pi), name="expected", colour=LIMIT, width=2)
    return chart.finished(HEIGHT, {"title": "residual / expected σ", "range": [-5, 5]}, "density")
