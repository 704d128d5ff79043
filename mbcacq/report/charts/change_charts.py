"""Figures of two recordings compared: each change with its expanded uncertainty."""

from __future__ import annotations

import textwrap

from mbcacq.figure import Figure
from mbcacq.quantities import measured, symbol
from mbcacq.report.charts.style import AFTER, ESCAPES, LIMIT, LINE, Plot
from mbcacq.report.several import Change

LABEL = 18  # characters of a line of a name, so that there is room for the figure on a phone
ROW_PX, LINE_PX, FRAME_PX = 26, 15, 90  # of one quantity, of a further line of its name, and of axis and margins


def changes(rows: list[Change]) -> Figure:
    """Changes of quantities of one unit, each with its expanded uncertainty; those beyond chance in the colour of limits."""
    chart = Plot()
    for marked, name, colour, shape in ((False, "within chance", AFTER, "circle"), (True, "beyond chance", LIMIT, "diamond")):
        shown = [(row, *row.change) for row in rows if row.significant == marked and row.change is not None]
        chart.points(
            [value for _, value, _ in shown],
            [_label(row.title) for row, _, _ in shown],
            colour=colour,
            size=8,
            symbol=shape,
            error_x={"type": "data", "array": [U for _, _, U in shown], "color": colour, "thickness": 1.2, "width": 4},
            name=name,
            text=[measured(value, U, symbol(row.unit)) for row, value, U in shown],
            hover="%{y}: %{text} (k = 2)",
        )
    chart.add_line_across(x=0.0, color=LINE, width=1)
    names = [_label(row.title) for row in rows]
    x = {"title": f"change / {symbol(rows[0].unit)}, with U (k = 2)", "gridcolor": "#e6e6e6"}
    y = {"categoryorder": "array", "categoryarray": names, "autorange": "reversed", "dtick": 1, "showgrid": False}
    return chart.finished(FRAME_PX + sum(ROW_PX + LINE_PX * name.count("<br>") for name in names), x, y)


def _label(name: str) -> str:
    """A name in lines that are short."""
    return "<br>".join(line.translate(ESCAPES) for line in textwrap.wrap(name, LABEL))
