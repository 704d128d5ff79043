"""Pictures of the sphere spacing errors as SVG: before and after calibration, and stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mbcacq.files.template import filled
from mbcacq.report.charts.style import AFTER, AXES, BEFORE, LIMIT
from mbcacq.report.content import Spacing

HERE = Path(__file__).parent
MOST_ROWS = 14


def spacing_picture(data: Spacing) -> str:
    """SVG of the magnitudes of the errors, two bars for each place; of many places those with the largest errors after. Whiskers are twice
    the expected standard deviation, and the limit is a line."""
    before, after = np.abs(data.before), np.abs(data.after)
    U = np.zeros(len(after)) if data.sigma is None else 2 * data.sigma
    top = 1.06 * max(float(before.max()), float((after + U).max()), data.limit or 0.0, 1e-9)
    shown = np.sort(np.argsort(-after)[:MOST_ROWS])
    rows = [{"place": data.place[k], "before": before[k], "after": after[k], "U": U[k]} for k in shown]
    colours = {"before": BEFORE, "after": AFTER, "limit_colour": LIMIT}
    return filled(HERE / "spacing.svg.j2", rows=rows, top=top, ticks=_ticks(top), limit=data.limit, **colours)


def slider_pictures(data: Spacing) -> list[str]:
    """SVG of the signed errors at each place before and after calibration, on one scale; of many places those with the largest after."""
    shown = np.sort(np.argsort(-np.abs(data.after))[:MOST_ROWS])
    after_U = 0 * data.after if data.sigma is None else 2 * data.sigma
    ends = np.concatenate([data.before, data.after - after_U, data.after + after_U, [0.0, 1e-9]])
    low, high = 1.06 * ends.min(), 1.06 * ends.max()
    step = _ticks(high - low)[1]
    ticks = [k * step for k in range(int(np.ceil(low / step)), int(high / step) + 1)]
    out = []
    for title, errors, U, colour in (("before", data.before, 0 * after_U, BEFORE), ("after", data.after, after_U, AFTER)):
        rows = [{"place": data.place[k], "error": errors[k], "U": U[k]} for k in shown]
        largest = np.abs(errors).max()
        out.append(filled(HERE / "columns.svg.j2", title=title, rows=rows, low=low, high=high, ticks=ticks, colour=colour, largest=largest))
    return out


def stages_picture(places: Sequence[str], stages: Mapping[str, np.ndarray], expected_mm: float | None = None) -> str:
    """SVG with a bar for each place and stage.

    Parameters
    ----------
    places
        Names.
    stages
        At most three, name -> (places,) signed errors in mm; magnitudes are drawn.
    expected_mm
        Mean magnitude that noise alone would show after the last of them.
    """
    size = {name: np.abs(errors) for name, errors in stages.items()}
    top = 1.06 * max(max(float(e.max()) for e in size.values()), 1e-9)
    drawn = [{"name": n, "errors": e, "colour": c} for (n, e), c in zip(size.items(), (BEFORE, AFTER, AXES["z"]), strict=False)]
    return filled(HERE / "stages.svg.j2", places=places, stages=drawn, expected_mm=expected_mm, top=top, ticks=_ticks(top))


def _ticks(top: float) -> list[float]:
    """Round values from zero to ``top``, four to seven of them."""
    power = 10.0 ** np.floor(np.log10(top))
    step = next(s * power for s in (0.1, 0.2, 0.25, 0.5, 1.0, 2.0) if top / (s * power) <= 6)
    return [float(f"{k * step:.6g}") for k in range(int(top / step) + 1)]
