"""Picture of the first screen: the error of the bar before and after, as SVG, which needs no script, scales, and prints."""

from __future__ import annotations

from html import escape

import numpy as np

from mbcacq.report.charts.style import AFTER, BEFORE, LIMIT
from mbcacq.report.content import Spacing

WIDTH, LEFT, RIGHT = 460.0, 64.0, 14.0
MOST_ROWS = 14


def spacing_picture(data: Spacing) -> str:
    """SVG of the magnitudes of the errors, two bars for each place; of many places those with the largest errors after."""
    before, after = np.abs(data.before), np.abs(data.after)
    rows = np.arange(len(after))
    if len(rows) > MOST_ROWS:
        rows = np.sort(np.argsort(-after)[:MOST_ROWS])
    sigma = np.zeros(len(after)) if data.sigma is None else data.sigma
    top = 1.06 * max(float(before.max()), float((after + 2 * sigma).max()), data.limit or 0.0, 1e-9)
    unit = (WIDTH - LEFT - RIGHT) / top
    pitch = 26.0 if len(rows) <= 10 else 21.0
    head, foot = 30.0, 44.0
    bottom = head + pitch * len(rows)
    out = [
        f'<svg class="picture" viewBox="0 0 {WIDTH:g} {bottom + foot:g}" role="img" '
        f'aria-label="Sphere spacing error before and after calibration at {len(rows)} places" font-size="13">'
    ]
    out += error_axis(top, LEFT, WIDTH - RIGHT, head, bottom)
    for k, row in enumerate(rows):
        y = head + pitch * k + 3
        thick = (pitch - 6) / 2
        name = escape(_short(data.place[row]))
        out.append(f'<text x="{LEFT - 7:g}" y="{y + thick + 4.5:.1f}" text-anchor="end" fill="#222">{name}</text>')
        out.append(f'<rect x="{LEFT:g}" y="{y:.1f}" width="{max(before[row] * unit, 1):.1f}" height="{thick:.1f}" fill="{BEFORE}"/>')
        out.append(f'<rect x="{LEFT:g}" y="{y + thick:.1f}" width="{max(after[row] * unit, 1):.1f}" height="{thick:.1f}" fill="{AFTER}"/>')
        if sigma[row] > 0:
            low, high = (LEFT + max(v, 0.0) * unit for v in (after[row] - 2 * sigma[row], after[row] + 2 * sigma[row]))
            middle = y + 1.5 * thick
            out.append(f'<path d="M{low:.1f} {middle:.1f}H{high:.1f}M{high:.1f} {middle - 3:.1f}v6" stroke="#222" fill="none"/>')
    if data.limit is not None:
        x = LEFT + data.limit * unit
        out.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{head - 8:g}" y2="{bottom:g}" stroke="{LIMIT}" stroke-width="1.6" '
            'stroke-dasharray="5 3"/>'
        )
    out.append(f'<line x1="{LEFT:g}" x2="{LEFT:g}" y1="{head:g}" y2="{bottom:g}" stroke="#222"/>')
    out.append(_legend(data.limit))
    return "".join([*out, "</svg>"])


def _legend(limit: float | None) -> str:
    out = (
        f'<rect x="{LEFT:g}" y="5" width="12" height="9" fill="{BEFORE}"/><text x="{LEFT + 17:g}" y="14">before</text>'
        f'<rect x="{LEFT + 78:g}" y="5" width="12" height="9" fill="{AFTER}"/><text x="{LEFT + 95:g}" y="14">after, ± k = 2</text>'
    )
    if limit is None:
        return out
    return out + (
        f'<path d="M{LEFT + 200:g} 10h22" stroke="{LIMIT}" stroke-width="1.6" stroke-dasharray="5 3"/>'
        f'<text x="{LEFT + 228:g}" y="14">limit {limit:g} mm</text>'
    )


def error_axis(top: float, left: float, right: float, head: float, bottom: float) -> list[str]:
    """SVG of the horizontal axis of a picture of errors: a line at each round value from zero to ``top`` mm, its number, and the title."""
    out = []
    for value in _ticks(top):
        x = left + value * (right - left) / top
        out.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{head:g}" y2="{bottom:g}" stroke="#e4e4e4"/>')
        out.append(f'<text x="{x:.1f}" y="{bottom + 16:g}" text-anchor="middle" fill="#555">{value:g}</text>')
    middle, title = (left + right) / 2, "size of the sphere spacing error / mm"
    return [*out, f'<text x="{middle:.1f}" y="{bottom + 35:g}" text-anchor="middle" fill="#333">{title}</text>']


def _ticks(top: float) -> list[float]:
    """Round values from zero to ``top``, four to seven of them."""
    power = 10.0 ** np.floor(np.log10(top))
    step = next(s * power for s in (0.1, 0.2, 0.25, 0.5, 1.0, 2.0) if top / (s * power) <= 6)
    return [float(f"{k * step:.6g}") for k in range(int(top / step) + 1)]


def _short(place: str) -> str:
    return place if len(place) <= 9 else place[:8] + "…"
