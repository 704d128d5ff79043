"""Figures of a fleet: how far each arm is out, its drift over time with control limits, the arms of one type beside each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts.style import AFTER, ESCAPES, LIMIT, LINE, Plot
from mbcacq.report.several import ArmTypeContent, ControlChart

MOST_ARMS = 60  # rows of the overview; of more arms those that are farthest out
MOST_NAMES, NAME_APART = 12, 0.05  # of arms at their lines; their distance as a share of the axis
GREY = "#9aa3a8"


def overview(kind: ArmTypeContent) -> Figure:
    """Largest distance of each arm's recordings from its centre line, in control limits, for every figure."""
    ratio = np.array([[_farthest(chart, a) for chart in kind.charts] for a in range(len(kind.arms))])
    shown = np.arange(len(kind.arms))
    if len(shown) > MOST_ARMS:
        shown = np.sort(np.argsort(-np.nanmax(np.nan_to_num(ratio), axis=1))[:MOST_ARMS])
    chart = Plot().heatmap(
        [chart.title.translate(ESCAPES) for chart in kind.charts],
        [kind.arms[a].translate(ESCAPES) for a in shown],
        ratio[shown],
        ends=(0, 2),
        colours=[(0.0, "#f3f5f6"), (0.499, "#a9c8dd"), (0.5, "#f2b26b"), (1.0, LIMIT)],
        key={
            "title": {"text": "limits"},
            "tickvals": [0, 1, 2],
            "ticktext": ["0", "1", "2 and more"],
            "lenmode": "pixels",
            "len": 110,
            "y": 1,
            "yanchor": "top",
        },
        hover="%{y}, %{x}: %{z:.2f} of the limit",
    )
    shared = {"tickfont": {"size": 10}, "showgrid": False, "dtick": 1}
    height = int(240 + 16 * len(shown))
    chart.update_layout(meta={"narrow": {"height": height, "tick": 7, "angle": -90}})
    return chart.finished(height, {"tickangle": -60, **shared}, {"autorange": "reversed", "title": "arm", "type": "category", **shared})


def drift(kind: ArmTypeContent) -> Figure:
    """Distance of each recording from the centre line of its arm over time; the figure is chosen from a list. Arms that are far out are
    named at their last recording."""
    times, title = _times(kind)
    drawn = Plot()
    for k, chart in enumerate(kind.charts):
        order, gaps = _by_arm(chart.arm)
        y, x, shown = chart.deviation[order], [times[i] for i in order], k == 0
        text = [f"{kind.arms[chart.arm[i]]}, {kind.recordings[i]}".translate(ESCAPES) for i in order]
        hover = "%{customdata}<br>%{x}: %{y:.4f}"
        drawn.points(
            _broken(x, gaps),
            _broken(y.tolist(), gaps),
            customdata=_broken(text, gaps),
            mode="lines+markers",
            line={"color": GREY, "width": 0.7},
            colour=AFTER,
            size=5,
            name="recording",
            visible=shown,
            hover=hover,
        )
        out = [j for j, i in enumerate(order) if chart.outside[i]]
        drawn.points(
            [x[j] for j in out],
            [float(y[j]) for j in out],
            customdata=[text[j] for j in out],
            colour=LIMIT,
            size=9,
            symbol="diamond",
            name="outside the limits",
            visible=shown,
            hover=hover,
        )
        limit = float(np.nanmedian(chart.limit)) if np.isfinite(chart.limit).any() else np.nan
        ends = [min(times), max(times)] if times else []
        across = {"colour": LIMIT, "dash": "dash", "width": 1.4, "name": "control limits"}
        drawn.line([*ends, None, *ends], [limit, limit, None, -limit, -limit], **across, visible=shown, hover=None)
        named = _named_at_the_end(kind, chart, order)
        drawn.add_scatter(
            x=[times[i] for i in named],
            y=[float(chart.deviation[i]) for i in named],
            text=[kind.arms[chart.arm[i]].translate(ESCAPES) for i in named],
            mode="text",
            textposition="top left",  # ends at the last recording, within the frame
            textfont={"size": 10, "color": LINE},
            showlegend=False,
            visible=shown,
            hoverinfo="skip",
        )
    return _chosen(drawn, kind, 4, {"title": title, **_axis(times)}, "difference from the arm's centre line")


def side_by_side(kind: ArmTypeContent) -> Figure:
    """Every recording of each arm, arms beside each other, with the range that is usual among them."""
    drawn = Plot()
    names = [arm.translate(ESCAPES) for arm in kind.arms]
    for k, chart in enumerate(kind.charts):
        for unusual in (False, True):
            here, mark = chart.unusual[chart.arm] == unusual, {"colour": AFTER, "size": 5}
            drawn.points(
                [names[a] for a in chart.arm[here]],
                chart.value[here],
                error_y={"type": "data", "array": 2 * chart.std[here], "thickness": 0.8, "width": 0},
                text=[name.translate(ESCAPES) for name, mine in zip(kind.recordings, here, strict=True) if mine],
                **({"colour": LIMIT, "size": 8, "symbol": "diamond"} if unusual else mark),
                name="arm outside of them" if unusual else "recording, ± k = 2",
                visible=k == 0,
                hover="%{x}, %{text}: %{y:.4f}",
            )
        low, high = chart.usual - chart.permitted, chart.usual + chart.permitted
        ends = [names[0], names[-1]]
        levels = [chart.usual, chart.usual, None, low, low, None, high, high]
        across = {"colour": LINE, "dash": "dash", "width": 1.2, "name": "median of the arms and limits"}
        drawn.line([*ends, None, *ends, None, *ends], levels, **across, visible=k == 0, hover=None)
    x = {"title": "arm", "type": "category", "categoryorder": "array", "categoryarray": names, "tickangle": -60 if len(names) > 12 else 0}
    return _chosen(drawn, kind, 3, x, "value")


def _chosen(drawn: Plot, kind: ArmTypeContent, traces: int, x: dict[str, Any], what: str) -> Plot:
    """The chart with a list of the figures, of which one is shown at a time."""
    total, titles = traces * len(kind.charts), [f"{what} / {chart.unit}" for chart in kind.charts]
    buttons = [
        {
            "label": chart.title.translate(ESCAPES),
            "method": "update",
            "args": [{"visible": [j // traces == k for j in range(total)]}, {"yaxis.title.text": title}],
        }
        for k, (chart, title) in enumerate(zip(kind.charts, titles, strict=True))
    ]
    drawn.finished(420, x, titles[0])
    drawn.update_layout(
        updatemenus=[{"buttons": buttons, "x": 0, "xanchor": "left", "y": 1.02, "yanchor": "bottom", "bgcolor": "#ffffff"}],
        margin={"l": 62, "r": 16, "t": 56, "b": 48},
    )
    return drawn


def _farthest(chart: ControlChart, arm: int) -> float:
    """Largest distance of an arm's recordings from its centre line, in limits; NaN where there is none."""
    here = (chart.arm == arm) & np.isfinite(chart.deviation) & (chart.limit > 0)
    return float(np.max(np.abs(chart.deviation[here]) / chart.limit[here])) if here.any() else np.nan


def _named_at_the_end(kind: ArmTypeContent, chart: ControlChart, order: list[int]) -> list[int]:
    """The last recording of each arm that is named there; those that are farthest out first, and none over another."""
    last = {int(chart.arm[i]): i for i in order}
    apart = NAME_APART * float(np.nanmax(chart.deviation) - np.nanmin(chart.deviation)) if np.isfinite(chart.deviation).any() else 0.0
    named: list[int] = []
    for arm in sorted(last, key=lambda a: -np.nan_to_num(_farthest(chart, a))):
        away = [abs(chart.deviation[last[arm]] - chart.deviation[other]) for other in named]
        if len(named) < MOST_NAMES and all(distance > apart for distance in away):
            named.append(last[arm])
    return named


def _axis(times: list) -> dict[str, Any]:
    """The axis of dates, with the time of day where there are few days, or of numbers."""
    if not times or not isinstance(times[0], str):
        return {"rangemode": "tozero"}
    few = len({time[:10] for time in times}) < 3
    return {"type": "date", "tickformat": "%H:%M<br>%Y-%m-%d" if few else "%Y-%m-%d", "nticks": 6}


def _times(kind: ArmTypeContent) -> tuple[list, str]:
    """Abscissa of the recordings: their time, or their number within the arm where one has none."""
    if all(kind.times):
        return list(kind.times), "date"
    arm = kind.charts[0].arm
    return [int(np.sum(arm[:i] == arm[i])) + 1 for i in range(len(arm))], "recording of the arm"


def _by_arm(arm: np.ndarray) -> tuple[list[int], list[int]]:
    """Recordings arm by arm, and after which of them the line is broken."""
    order = np.argsort(arm, kind="stable")
    return order.tolist(), np.flatnonzero(np.diff(arm[order])).tolist()


def _broken(values: list, gaps: list[int]) -> list:
    """The values with None after each gap, so that a line ends there."""
    after = set(gaps)
    return [v for i, value in enumerate(values) for v in ((value, None) if i in after else (value,))]
