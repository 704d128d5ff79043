"""Colours, markers and layout that all figures of a report share."""

from __future__ import annotations

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


def styled(figure: Figure, height: int) -> Figure:
    """The figure with the common layout, ``height`` px high."""
    figure.update_layout(
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


def thinned(size: np.ndarray) -> np.ndarray:
    """Indices of what is drawn of many points: those of the largest size (k,) all, the rest evenly, in their order."""
    if len(size) <= MOST:
        return np.arange(len(size))
    largest = np.argsort(-np.nan_to_num(size))[: MOST // 5]
    return np.union1d(largest, np.arange(0, len(size), len(size) // (MOST - MOST // 5) + 1))
