"""Picture of the bar's error at every place before calibration, after geometry and after effects, as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from mbcacq.report.charts.spacing_svg import error_axis
from mbcacq.report.charts.style import AFTER, BEFORE

WIDTH, LEFT, RIGHT, HEAD, FOOT, THICK = 620.0, 64.0, 62.0, 62.0, 44.0, 11.0
COLOURS = (BEFORE, AFTER, "#009E73")  # Okabe and Ito's


def stages_picture(places: Sequence[str], stages: Mapping[str, np.ndarray], expected_mm: float | None = None) -> str:
    """SVG with a bar for each place and stage. stages: at most three, name -> (places,) signed errors in mm; drawn are their magnitudes.
    expected_mm: mean magnitude that the last stage would have by noise alone.
    """
    size = {name: np.abs(errors) for name, errors in stages.items()}
    top = 1.06 * max(max(float(e.max()) for e in size.values()), 1e-9)
    unit, pitch = (WIDTH - LEFT - RIGHT) / top, THICK * len(size) + 8.0
    bottom = HEAD + pitch * len(places)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {bottom + FOOT:g}" role="img" '
        f'font-family="Helvetica, Arial, sans-serif" font-size="13" aria-label="Sphere spacing error at {len(places)} places by stage">',
        f'<rect width="{WIDTH:g}" height="{bottom + FOOT:g}" fill="white"/>',
    ]
    out += error_axis(top, LEFT, WIDTH - RIGHT, HEAD, bottom)
    for row, place in enumerate(places):
        y = HEAD + pitch * row + 4
        out.append(f'<text x="{LEFT - 7:g}" y="{y + pitch / 2:.1f}" text-anchor="end" fill="#222">{escape(place[:9])}</text>')
        for k, errors in enumerate(size.values()):
            at, wide = y + THICK * k, max(errors[row] * unit, 1)
            out.append(f'<rect x="{LEFT:g}" y="{at:.1f}" width="{wide:.1f}" height="{THICK:g}" fill="{COLOURS[k]}"/>')
            out.append(f'<text x="{LEFT + wide + 4:.1f}" y="{at + THICK - 2:.1f}" font-size="9.5" fill="#444">{errors[row]:.3f}</text>')
    for k, (name, errors) in enumerate(size.items()):
        x = LEFT + k * (WIDTH - LEFT) / 3
        out.append(
            f'<rect x="{x:.1f}" y="8" width="12" height="10" fill="{COLOURS[k]}"/><text x="{x + 17:.1f}" y="18">{escape(name)}</text>'
        )
        out.append(f'<text x="{x + 17:.1f}" y="36" fill="#444">mean {errors.mean():.4f} mm</text>')
    if expected_mm is not None:
        x = LEFT + (len(size) - 1) * (WIDTH - LEFT) / 3
        out.append(f'<text x="{x + 17:.1f}" y="50" font-size="11" fill="#444">noise alone: {expected_mm:.4f} mm</text>')
    out.append(f'<line x1="{LEFT:g}" x2="{LEFT:g}" y1="{HEAD:g}" y2="{bottom:g}" stroke="#222"/></svg>')
    return "".join(out)
