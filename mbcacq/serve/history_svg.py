"""The history of a cell as a picture: the largest verified error of each run over time, and what the checks between them said."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbcacq.files.template import filled
from mbcacq.report.charts.style import AFTER, LIMIT
from mbcacq.serve.run_choice import time_of
from mbcacq.serve.run_row import RunRow


def history_picture(rows: Sequence[RunRow]) -> str:
    """SVG of the recordings, the oldest first; '' if less than two have a figure. Bars are U (k = 2) of judging."""
    figures = [(k, *found, time_of(row.found)[:10]) for k, row in enumerate(rows) if (found := _largest(row)) is not None]
    checks = [(k, row.overview.check["verdict"] == "changed") for k, row in enumerate(rows) if row.overview.check is not None]
    if len(figures) + len(checks) < 2:
        return ""
    first, last = (time_of(row.found)[:10] for row in (rows[0], rows[-1]))
    return filled(
        Path(__file__).parent / "templates" / "history.svg.j2",
        figures=figures,
        checks=checks,
        count=len(rows),
        largest=max([1e-3, *(error + U for _, error, U, _ in figures)]),
        first=first,
        last=last,
        colour=AFTER,
        changed_colour=LIMIT,
    )


def _largest(row: RunRow) -> tuple[float, float] | None:
    """The largest error of a verified run, and its U."""
    spacing = None if row.overview.content is None else row.overview.content.spacing
    if spacing is None:
        return None
    worst = int(np.abs(spacing.after).argmax())
    return float(abs(spacing.after[worst])), 0.0 if spacing.judging is None else 2.0 * float(spacing.judging[worst])
