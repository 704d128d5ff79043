"""A figure of the page as SVG, for paper: drawn by Matplotlib from the same traces, without a browser."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

PX_PER_INCH = 96.0  # of CSS
LEGEND_PX = 105.0  # of a name in the legend
TICK_PX = 55.0  # of a number on the horizontal axis
MARKERS = {"circle": "o", "diamond": "D", "square": "s", "cross": "P", "triangle-up": "^", "x": "X", "circle-x-open": "o"}
DEFAULT = "#0072B2"  # of a trace that names no colour
DASHES = {"dash": "--", "dot": ":", "dashdot": "-."}


def static_svg(figure: Any, width_px: float, scale: float = 1.0) -> str:
    """An SVG drawing of a figure.

    Parameters
    ----------
    figure
        With traces of the kinds scatter, bar, heatmap, histogram and box on one pair of axes.
    width_px
        Width of the drawing.
    scale
        Its height over that of the figure's layout.

    Returns
    -------
    Text of an SVG document; its characters are outlines, so it needs no font.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.ticker import AutoLocator

    height = scale * float(figure.layout.get("height") or 300)
    drawing = Figure(figsize=(width_px / PX_PER_INCH, height / PX_PER_INCH), layout="constrained")
    axes = drawing.add_subplot()
    for trace in figure.data:
        DRAW[trace["type"]](axes, trace, figure)
    _finish(axes, figure.layout, max(int(width_px / LEGEND_PX), 1))
    if isinstance(axes.xaxis.get_major_locator(), AutoLocator):
        axes.locator_params(axis="x", nbins=max(int(width_px / TICK_PX), 3))
    out = io.StringIO()
    FigureCanvasSVG(drawing).print_svg(out, metadata={"Date": None})
    return out.getvalue()


def _numbers(axis: Any, values: Any) -> np.ndarray:
    """Numbers as they are, names as the axis numbers them."""
    values = np.atleast_1d(np.asarray(values))
    if values.dtype.kind in "biuf" or (values.dtype.kind == "O" and all(isinstance(v, int | float | None) for v in values)):
        return values.astype(float)
    names = list(map(str, values))
    axis.update_units(names)
    return np.asarray(axis.convert_units(names), dtype=float)


def _scatter(axes: Any, trace: Any, figure: Any) -> None:
    if trace.get("x") is None or trace.get("y") is None:
        return
    x, y = _numbers(axes.xaxis, trace.get("x")), _numbers(axes.yaxis, trace.get("y"))
    if trace.get("fill") == "toself":
        axes.fill(x, y, color=_rgba(trace["fillcolor"]), linewidth=0, label=_label(trace))
        return
    mode = trace.get("mode") or "lines"
    line, marker = trace.get("line", {}), trace.get("marker", {})
    colours = [line.get("color"), _one(marker.get("color"))]
    colour = next((c for c in (colours if "lines" in mode else colours[::-1]) if c), DEFAULT)
    style: dict[str, Any] = {"color": colour, "linestyle": "none", "alpha": marker.get("opacity") or trace.get("opacity") or 1.0}
    if "lines" in mode:
        dash = DASHES.get(line.get("dash"), "-")
        style |= {"linestyle": dash, "linewidth": 0.75 * line.get("width", 2), "solid_capstyle": "butt"}
    if "markers" in mode:
        symbol = _one(marker.get("symbol")) or "circle"
        style |= {"marker": MARKERS.get(symbol, "o"), "markersize": 0.75 * float(_one(marker.get("size")) or 6), "markeredgewidth": 0}
        if symbol.endswith("-open"):
            style |= {"markerfacecolor": "none", "markeredgewidth": 1.2}
    axes.plot(x, y, label=_label(trace), **style)
    if _of(trace, "error_y.array") is not None:
        axes.errorbar(x, y, yerr=np.asarray(_of(trace, "error_y.array"), dtype=float), fmt="none", ecolor=colour, elinewidth=0.8, capsize=2)


def _bar(axes: Any, trace: Any, figure: Any) -> None:
    flat = trace.get("orientation") == "h"
    across, along = ("y", "x") if flat else ("x", "y")
    at, size = _numbers(getattr(axes, f"{across}axis"), trace.get(across)), np.asarray(trace.get(along), dtype=float)
    width = np.asarray(trace.get("width") if trace.get("width") is not None else 0.72, dtype=float)
    bars, base = [one for one in figure.data if one.get("type") == "bar"], np.zeros(len(size))
    own = [one is trace for one in bars].index(True)
    if figure.layout.get("barmode") == "stack":
        base = sum((np.asarray(one.get(along), dtype=float) for one in bars[:own]), base)
    elif len(bars) > 1 and trace.get("width") is None:
        width = width / len(bars)
        at = at + (own - (len(bars) - 1) / 2) * width
    draw: Callable = axes.barh if flat else axes.bar
    draw(at, size, width, base, color=_one(_of(trace, "marker.color")) or DEFAULT, label=_label(trace))


def _heatmap(axes: Any, trace: Any, figure: Any) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    z = np.asarray(trace.get("z"), dtype=float)
    scale = trace.get("colorscale", "Viridis")
    colours = colormaps[scale.lower()] if isinstance(scale, str) else LinearSegmentedColormap.from_list("page", list(map(tuple, scale)))
    colours = colours.reversed() if trace.get("reversescale") else colours
    x, y = (
        np.arange(n, dtype=float) if values is None or not _numeric(values) else np.asarray(values, dtype=float)
        for values, n in ((trace.get("x"), z.shape[1]), (trace.get("y"), z.shape[0]))
    )
    shown = axes.pcolormesh(x, y, np.ma.masked_invalid(z), cmap=colours, vmin=trace.get("zmin"), vmax=trace.get("zmax"), shading="nearest")
    for axis, values in ((axes.xaxis, trace.get("x")), (axes.yaxis, trace.get("y"))):
        if values is not None and not _numeric(values):
            axis.set_ticks(range(len(values)), [str(v) for v in values], fontsize=6, rotation=90 if axis is axes.xaxis else 0)
    bar = axes.figure.colorbar(shown, ax=axes, aspect=30)
    bar.outline.set_visible(False)
    bar.ax.set_title(_of(trace, "colorbar.title.text") or "", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    if _of(trace, "colorbar.tickvals") is not None:
        bar.set_ticks(list(_of(trace, "colorbar.tickvals")), labels=[_plain(str(t)) for t in _of(trace, "colorbar.ticktext")])


def _histogram(axes: Any, trace: Any, figure: Any) -> None:
    values, colour = np.asarray(trace["x"], dtype=float), _one(_of(trace, "marker.color")) or DEFAULT
    axes.hist(values, bins=trace.get("nbinsx") or 30, color=colour, label=_label(trace))


def _box(axes: Any, trace: Any, figure: Any) -> None:
    colour = _one(_of(trace, "marker.color")) or DEFAULT
    thin = {"color": colour, "linewidth": 0.9}
    axes.boxplot(
        [np.asarray(trace.get("y"), dtype=float)],
        positions=_numbers(axes.xaxis, [str(trace.get("name"))]),
        widths=0.6,
        manage_ticks=False,
        boxprops=thin,
        whiskerprops=thin,
        capprops=thin,
        medianprops=thin,
        flierprops={"marker": "o", "markersize": 2, "markerfacecolor": colour, "markeredgewidth": 0},
    )


DRAW: dict[str, Callable[[Any, Any, Any], None]] = {
    "scatter": _scatter,
    "bar": _bar,
    "heatmap": _heatmap,
    "histogram": _histogram,
    "box": _box,
}


def _finish(axes: Any, layout: Any, most: int) -> None:
    """most: names in a row of the legend."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    axes.set_axisbelow(True)
    if _of(layout, "yaxis.showgrid") is not False:
        axes.grid(axis="y", color="#e6e6e6", linewidth=0.6)
    for name, axis in (("x", layout.get("xaxis")), ("y", layout.get("yaxis"))):
        _axis(axes, name, axis)
    if _of(layout, "yaxis.scaleanchor"):
        axes.set_aspect("equal", adjustable="datalim")
    for shape in layout.get("shapes", ()):
        if shape.get("type") == "line":
            _line(axes, shape)
    handles, labels = axes.get_legend_handles_labels()
    if labels and layout.get("showlegend") is not False:
        above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": min(len(labels), most)}
        axes.legend(handles, labels, fontsize=7, frameon=False, borderaxespad=0.2, handletextpad=0.4, columnspacing=1.0, **above)


def _axis(axes: Any, name: str, axis: Any) -> None:
    if axis.get("visible") is False:
        (axes.xaxis if name == "x" else axes.yaxis).set_visible(False)
        return
    getattr(axes, f"set_{name}label")(_plain(_of(axis, "title.text")), fontsize=8)
    if axis.get("type") == "log":
        getattr(axes, f"set_{name}scale")("log")
    if axis.get("tickvals") is not None and axis.get("ticktext") is not None:
        getattr(axes, f"set_{name}ticks")(list(axis.get("tickvals")), [_plain(t) for t in axis.get("ticktext")])
    if axis.get("range") is not None:
        ends = [10.0**end for end in axis.get("range")] if axis.get("type") == "log" else list(axis.get("range"))
        getattr(axes, f"set_{name}lim")(*ends)
    elif axis.get("rangemode") == "tozero":
        getattr(axes, f"set_{name}lim")(**{"bottom" if name == "y" else "left": 0.0})
    if axis.get("autorange") == "reversed":
        (axes.invert_xaxis if name == "x" else axes.invert_yaxis)()


def _line(axes: Any, shape: Any) -> None:
    style = {"color": _of(shape, "line.color") or "#444444", "linewidth": 1.0, "linestyle": DASHES.get(_of(shape, "line.dash"), "-")}
    if shape.get("x0") == shape.get("x1"):
        axes.axvline(shape.get("x0"), **style)
    elif shape.get("y0") == shape.get("y1"):
        axes.axhline(shape.get("y0"), **style)


def _of(values: Mapping[str, Any], path: str) -> Any:
    """``values["a"]["b"]`` of the path "a.b"; None if it is not given."""
    found: Any = values
    for name in path.split("."):
        found = None if found is None else found.get(name)
    return found


def _one(value: Any) -> Any:
    """A style that holds for the whole trace; the first of one for each point."""
    if isinstance(value, str) or value is None or np.isscalar(value):
        return value
    return value[0] if len(value) else None


def _rgba(colour: str) -> tuple[float, ...]:
    """'rgba(r, g, b, a)' of plotly.js, r to b up to 255, as Matplotlib takes it."""
    *shades, opacity = (float(part) for part in colour[colour.index("(") + 1 : -1].split(","))
    return (*(shade / 255 for shade in shades), opacity)


def _numeric(values: Any) -> bool:
    return np.asarray(values).dtype.kind in "biuf"


def _label(trace: Any) -> str:
    """'_' hides a trace from the legend."""
    return "_" if trace.get("showlegend") is False or not trace.get("name") else _plain(trace.get("name"))


def _plain(text: str | None) -> str:
    """Plotly's names are HTML of which the page uses escapes and line breaks."""
    for code, character in (("<br>", "\n"), ("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")):
        text = (text or "").replace(code, character)
    return (text or "").replace("$", r"\$")
