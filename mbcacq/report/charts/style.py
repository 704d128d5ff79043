"""What all charts of a report share: colours, markers, layout, and the marks that they are drawn with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mbcacq.figure import Figure

# Okabe and Ito's colours, which the colour-blind can distinguish; markers differ as well.
BEFORE, AFTER, LINE, LIMIT = "#E69F00", "#0072B2", "#444444", "#8A2B0B"
AXES = {"x": "#0072B2", "y": "#E69F00", "z": "#009E73"}
PHASES = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#777777"]
SYMBOLS = ["circle", "diamond", "square", "cross", "triangle-up", "x"]
MOST = 2500  # points drawn of a cloud of points; the largest all, the rest evenly
# Plotly draws axis titles as HTML; names from files are plain text.
ESCAPES = str.maketrans({"<": "&lt;", ">": "&gt;", "&": "&amp;"})
Axis = str | Mapping[str, Any]  # the title of an axis, or its properties as plotly.js names them


class Plot(Figure):
    """A figure that is drawn by marks. hover: what is shown at a mark, in the words of plotly.js; None shows nothing, '' the values."""

    def points(self, x: Any, y: Any, *, colour: Any, size: float, hover: str | None = "", **trace: Any) -> Plot:
        """Add points. trace: also symbol and opacity of them, and edge (width, colour) of each."""
        marker = {"color": colour, "size": size}
        marker |= {key: trace.pop(key) for key in ("symbol", "opacity") if key in trace}
        if edge := trace.pop("edge", None):
            marker["line"] = dict(zip(("width", "color"), edge, strict=False))
        self.add_scatter(x=x, y=y, mode=trace.pop("mode", "markers"), marker=marker, **_hovered(hover), **trace)
        return self

    def line(self, x: Any, y: Any, *, colour: str, width: float, dash: str = "", hover: str | None = "", **trace: Any) -> Plot:
        """Add a line through points."""
        line = {"color": colour, "width": width} | ({"dash": dash} if dash else {})
        self.add_scatter(x=x, y=y, mode="lines", line=line, **_hovered(hover), **trace)
        return self

    def bars(self, x: Any, y: Any, *, colour: str, hover: str | None = "", **trace: Any) -> Plot:
        """Add bars from zero. trace: also edge, the width of their outline."""
        edge = {"line": {"width": trace.pop("edge")}} if "edge" in trace else {}
        self.add_bar(x=x, y=y, marker={"color": colour} | edge, **_hovered(hover), **trace)
        return self

    def heatmap(
        self,
        x: Any,
        y: Any,
        z: Any,
        *,
        ends: tuple[float, float],
        colours: Any,
        key: Mapping[str, Any],
        hover: str,
        gap: float = 1,
        **trace: Any,
    ) -> Plot:
        """Add fields whose colour says z, from the first to the last of ``colours`` between the ends. key: of the scale beside them."""
        scale = {"zmin": ends[0], "zmax": ends[1], "colorscale": colours, "colorbar": {"thickness": 12, "outlinewidth": 0, **key}}
        self.add("heatmap", x=x, y=y, z=z, xgap=gap, ygap=gap, **scale, **_hovered(hover), **trace)
        return self

    def finished(self, height: int, x: Axis, y: Axis) -> Plot:
        """The chart with its axes and the common layout, ``height`` px high."""
        self.update_xaxes(**_properties(x))
        self.update_yaxes(**_properties(y))
        self.update_layout(
            height=height,
            margin={"l": 62, "r": 16, "t": 26, "b": 48},
            barmode="group",
            bargap=0.28,
            font={"family": "Helvetica, Arial, sans-serif", "size": 12, "color": "#222222"},
            legend={"orientation": "h", "x": 1, "xanchor": "right", "y": 1.02, "yanchor": "bottom"},
            paper_bgcolor="rgba(0,0,0,0)",
            plot_bgcolor="rgba(0,0,0,0)",
        )
        self.update_xaxes(automargin=True, showline=True, linecolor=LINE, ticks="outside", ticklen=4, zeroline=False)
        self.update_yaxes(automargin=True, gridcolor="#e6e6e6", showline=True, linecolor=LINE, ticks="outside", ticklen=4)
        return self


def by_phase(phase: np.ndarray) -> Iterator[tuple[int, str, np.ndarray]]:
    """Number, name as it is shown, and mask of each phase, in the order in which they come."""
    for k, name in enumerate(dict.fromkeys(phase)):
        yield k, str(name).translate(ESCAPES) or "all poses", phase == name


def thinned(size: np.ndarray) -> np.ndarray:
    """Indices of what is drawn of many points: those of the largest size (k,) all, the rest evenly, in their order."""
    if len(size) <= MOST:
        return np.arange(len(size))
    largest = np.argsort(-np.nan_to_num(size))[: MOST // 5]
    return np.union1d(largest, np.arange(0, len(size), len(size) // (MOST - MOST // 5) + 1))


def _properties(axis: Axis) -> Mapping[str, Any]:
    return {"title": axis} if isinstance(axis, str) else axis


def _hovered(text: str | None) -> dict[str, str]:
    if text is None:
        return {"hoverinfo": "skip"}
    return {"hovertemplate": f"{text}<extra></extra>"} if text else {}
