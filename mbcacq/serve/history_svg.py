"""The history of a cell as a picture: the largest verified error of each run over time, and what the checks between them said."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from mbcacq.report.charts.style import AFTER, LIMIT
from mbcacq.serve.run_choice import time_of
from mbcacq.serve.run_row import RunRow

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BELOW = 900.0, 240.0, 70.0, 20.0, 30.0, 56.0


def history_picture(rows: Sequence[RunRow]) -> str:
    """SVG of the recordings, the oldest first; '' where less than two have a figure. Bars are U (k = 2) of judging."""
    figures = [(k, *found, time_of(row.found)[:10]) for k, row in enumerate(rows) if (found := _largest(row)) is not None]
    checks = [(k, row.overview.check["verdict"] == "changed") for k, row in enumerate(rows) if row.overview.check is not None]
    if len(figures) + len(checks) < 2:
        return ""
    top = 1.1 * max([1e-3, *(error + U for _, error, U, _ in figures)])
    across = LEFT + 12 + (WIDTH - LEFT - RIGHT - 24) * np.arange(len(rows)) / max(len(rows) - 1, 1)
    foot = HEIGHT - BELOW

    def up(value: float) -> float:
        return foot - (foot - TOP) * value / top

    out = [f'<svg class="picture" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="History of the cell" font-size="13">']
    for value in np.linspace(0, top / 1.1, 3):
        out.append(f'<line x1="{LEFT:g}" x2="{WIDTH - RIGHT:g}" y1="{up(value):.1f}" y2="{up(value):.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{LEFT - 7:g}" y="{up(value) + 4:.1f}" text-anchor="end" fill="#555">{value:.3f}</text>')
    for k, error, U, day in figures:
        x, low, high = across[k], up(max(error - U, 0.0)), up(error + U)
        out.append(f'<path d="M{x:.1f} {low:.1f}V{high:.1f}" stroke="{AFTER}" stroke-width="2"/>')
        out.append(f'<circle cx="{x:.1f}" cy="{up(error):.1f}" r="5" fill="{AFTER}"><title>{escape(day)}: {error:.3f} mm</title></circle>')
    for k, changed in checks:
        x, y = across[k], foot + 14
        mark = f"M{x - 5:.1f} {y - 5:g}l10 10m0 -10l-10 10" if changed else f"M{x - 5:.1f} {y:g}l4 4l6 -8"
        out.append(f'<path d="{mark}" stroke="{LIMIT if changed else "#00694B"}" stroke-width="2.5" fill="none"/>')
    days = [time_of(row.found)[:10] for row in (rows[0], rows[-1])]
    out.append(f'<text x="{LEFT:g}" y="{HEIGHT - 8:g}" fill="#333">{escape(days[0])}</text>')
    out.append(f'<text x="{WIDTH - RIGHT:g}" y="{HEIGHT - 8:g}" text-anchor="end" fill="#333">{escape(days[1])}</text>')
    said = "largest sphere spacing error of each run / mm, ± U (k = 2); below: checks, ✓ as before, × changed"
    return "".join([*out, f'<text x="{LEFT:g}" y="16" fill="#333">{said}</text></svg>'])


def _largest(row: RunRow) -> tuple[float, float] | None:
    """The largest error of a verified run, and its U."""
    spacing = None if row.overview.content is None else row.overview.content.spacing
    if spacing is None:
        return None
    worst = int(np.abs(spacing.after).argmax())
    return float(abs(spacing.after[worst])), 0.0 if spacing.judging is None else 2.0 * float(spacing.judging[worst])
