"""HTML tables for notebooks: what ``_repr_html_`` of the results is made of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """An HTML table; the first column is text, the others are aligned right. Everything is escaped."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join("<tr>" + "".join(_cell(k, value) for k, value in enumerate(row)) + "</tr>" for row in rows)
    return f"<table><caption>{escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def paragraph(text: str) -> str:
    """A sentence below a table."""
    return f"<p>{escape(text)}</p>"


def _cell(column: int, value: object) -> str:
    side = "left" if column == 0 else "right"
    return f'<td style="text-align:{side}">{escape(str(value))}</td>'
