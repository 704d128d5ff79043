"""Tables and figures for notebooks: what ``_repr_html_`` and ``plot`` of the results are made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from mbcacq.figure import Figure
from mbcacq.quantities import K

KINDS = {"mm": ("lengths / mm", 1.0, "#0072B2"), "rad": ("angles / mrad", 1e3, "#E69F00")}  # unit -> legend, factor, colour


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """An HTML table; the first column is text, the others are aligned right. Everything is escaped."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join("<tr>" + "".join(_cell(k, value) for k, value in enumerate(row)) + "</tr>" for row in rows)
    return f"<table><caption>{escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def paragraph(text: str) -> str:
    """A sentence below a table."""
    return f"<p>{escape(text)}</p>"


def parameter_figure(title: str, parameters: Sequence[Mapping[str, Any]]) -> Figure:
    """What a calibration changed: the error of each parameter against the data sheet, with its U (k = 2).

    parameters: as result.json lists them; those of the arm are drawn, or of the hand-eye transform where the arm has none. Lengths are in
    mm, angles in mrad: over an arm's length of a metre both displace by about as much.
    """
    known = [p for p in parameters if p["std"] is not None and p["unit"] in KINDS and not p["name"].startswith("ball_")]
    arm = [p for p in known if "." not in p["name"]]
    figure = Figure()
    for unit, (legend, factor, colour) in KINDS.items():
        drawn = [p for p in arm or known if p["unit"] == unit]
        figure.add_scatter(
            x=[p["name"] for p in drawn],
            y=[factor * p["error"] for p in drawn],
            mode="markers",
            name=legend,
            marker={"color": colour, "size": 8},
            error_y={"array": [factor * K * p["std"] for p in drawn], "color": colour, "thickness": 1.2, "width": 3},
        )
    figure.update_xaxes(
        title="parameter", tickangle=-60, type="category", categoryorder="array", categoryarray=[p["name"] for p in arm or known]
    )
    figure.update_yaxes(title="error with U (k = 2) / mm, mrad", zeroline=True)
    figure.update_layout(title=title, height=420)
    return figure


def before_and_after(title: str, labels: Sequence[str], before: Sequence[float], after: Sequence[float], U: Sequence[float]) -> Figure:
    """Bars of signed errors in mm before and after, those after with their U (k = 2)."""
    figure = Figure()
    figure.add_bar(name="before", x=labels, y=before, marker={"color": "#E69F00"})
    figure.add_bar(
        name="after, with U (k = 2)", x=labels, y=after, marker={"color": "#0072B2"}, error_y={"array": U, "thickness": 1.2, "width": 3}
    )
    figure.update_xaxes(title="station: balls", type="category")
    figure.update_yaxes(title="error / mm", zeroline=True)
    figure.update_layout(title=title, height=420)
    return figure


def _cell(column: int, value: object) -> str:
    side = "left" if column == 0 else "right"
    return f'<td style="text-align:{side}">{escape(str(value))}</td>'
