"""Figures as plotly.js draws them: traces and a layout as data, without Plotly for Python, whose classes take ten times the room."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError

LIBRARY = Path(__file__).with_name("plotly.min.js")  # put here when the package is built, out of Plotly's wheel
MIME = "application/vnd.plotly.v1+json"  # what notebooks with Plotly's extension draw themselves
PACKED = {"f": "f8", "b": "u1"}  # kind of an array -> type that plotly.js unpacks
LARGEST_I4 = 2**31 - 1


def drawing_library() -> str:
    """The text of plotly.js. Raises ConfigError if the package was not built."""
    try:
        return LIBRARY.read_text(encoding="utf-8")
    except OSError:
        raise ConfigError(f"{LIBRARY} is missing, which draws the figures; install mbcacq with pip, which puts it there") from None


class Figure:
    """A figure: ``data``, its traces, and ``layout``, both as plotly.js takes them.

    It shows itself in a notebook. With Plotly for Python, ``plotly.graph_objects.Figure(figure.to_dict())`` is the same figure.

    Parameters
    ----------
    data
        Traces, each with its ``type``.
    layout
        Axes, shapes, legend, size.
    """

    def __init__(self, data: Iterable[Mapping[str, Any]] = (), layout: Mapping[str, Any] | None = None) -> None:
        self.data: list[dict[str, Any]] = [dict(trace) for trace in data]
        self.layout: dict[str, Any] = {"xaxis": {}, "yaxis": {}, "shapes": [], "annotations": []} | dict(layout or {})

    def add(self, kind: str, **trace: Any) -> Figure:
        """Add a trace of a kind of plotly.js: scatter, bar, heatmap, histogram, box. Returns this figure."""
        self.data.append({"type": kind} | trace)
        return self

    def add_scatter(self, **trace: Any) -> Figure:
        """Add points or lines. Returns this figure."""
        return self.add("scatter", **trace)

    def add_bar(self, **trace: Any) -> Figure:
        """Add bars. Returns this figure."""
        return self.add("bar", **trace)

    def add_line_across(self, *, x: float | None = None, y: float | None = None, text: str = "", **line: Any) -> Figure:
        """Add a line across the frame at x or at y, with a text at its upper end. line: color, width, dash. Returns this figure."""
        if x is not None:
            self.layout["shapes"].append({"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "yref": "y domain", "line": line})
        else:
            self.layout["shapes"].append({"type": "line", "y0": y, "y1": y, "x0": 0, "x1": 1, "xref": "x domain", "line": line})
        if text:
            at = {"x": x, "xanchor": "left", "y": 1, "yref": "y domain", "yanchor": "top"}
            self.layout["annotations"].append(at | {"text": text, "showarrow": False, "font": {"size": 11}})
        return self

    def update_xaxes(self, **axis: Any) -> Figure:
        """Set properties of every horizontal axis. A title may be a plain text. Returns this figure."""
        return self._axes("x", axis)

    def update_yaxes(self, **axis: Any) -> Figure:
        """Set properties of every vertical axis; as ``update_xaxes``."""
        return self._axes("y", axis)

    def update_layout(self, **layout: Any) -> Figure:
        """Set properties of the layout; a title may be a plain text. Returns this figure."""
        self.layout |= _titled(layout)
        return self

    def to_dict(self) -> dict[str, Any]:
        """Data and layout, as plotly.js and ``plotly.graph_objects.Figure`` take them."""
        return {"data": self.data, "layout": self.layout}

    def to_json(self) -> str:
        """The same as JSON; arrays of numbers are packed, NaN elsewhere is null."""
        return json.dumps(_plain(self.to_dict()), allow_nan=False)

    def to_html(self) -> str:
        """A page that draws the figure by itself, offline."""
        return f'<!DOCTYPE html><html><head><meta charset="utf-8"></head><body>{self._repr_html_()}</body></html>'

    def _repr_html_(self) -> str:
        height = f"{self.layout.get('height', 420):g}px"
        figure = self.to_json().replace("<", "\\u003c")
        return (
            f'<div style="height:{height}"></div><script>(() => {{ const place = document.currentScript.previousElementSibling;\n'
            f"if (!window.Plotly) {{ {drawing_library()} }}\nconst figure = {figure};\n"
            "window.Plotly.newPlot(place, figure.data, figure.layout, {responsive: true}); })();</script>"
        )

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        return {MIME: json.loads(self.to_json()), "text/html": self._repr_html_(), "text/plain": f"Figure of {len(self.data)} traces"}

    def _axes(self, letter: str, values: dict[str, Any]) -> Figure:
        for name in [key for key in self.layout if key.startswith(f"{letter}axis")]:
            self.layout[name] = {**self.layout[name], **_titled(values)}
        return self


def _titled(values: dict[str, Any]) -> dict[str, Any]:
    title = values.get("title")
    return values | {"title": {"text": title}} if isinstance(title, str) else values


def _plain(value: Any) -> Any:
    """What JSON can say: arrays of numbers packed as plotly.js unpacks them, other arrays and numbers of numpy as Python's."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray):
        return _packed(value)
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _packed(array: np.ndarray) -> Any:
    kind = PACKED.get(array.dtype.kind)
    if array.dtype.kind in "iu" and (array.size == 0 or np.abs(array).max() <= LARGEST_I4):
        kind = "i4"
    if kind is None or array.size == 0:
        return _plain(array.tolist())
    out: dict[str, Any] = {"dtype": kind, "bdata": b64encode(np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()).decode()}
    return out if array.ndim == 1 else out | {"shape": ", ".join(map(str, array.shape))}
