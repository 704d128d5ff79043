"""Pictures of the sphere spacing errors as SVG: before and after calibration, and stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.files.template import filled
from mbcacq.report.charts.style import AFTER, AXES, BEFORE, LIMIT
from mbcacq.report.content import Spacing

HERE = Path(__file__).parent
MOST_ROWS = 14


def spacing_picture(data: Spacing) -> str:
    """SVG of the magnitudes of the errors, two bars for each place; of many places those with the largest errors after. Whiskers are twice
    the expected standard deviation, and the limit is a line."""
    rows = [row | {"before": abs(row["before"]), "after": abs(row["after"])} for row in _rows(data)]
    top = 1.06 * max(*(max(row["before"], row["after"] + row["U"]) for row in rows), data.limit or 0.0, 1e-9)
    colours = {"before": BEFORE, "after": AFTER, "limit_colour": LIMIT}
    return filled(HERE / "spacing.svg.j2", rows=rows, places=len(data.place), top=top, ticks=_ticks(top), limit=data.limit, **colours)


def slider_pictures(data: Spacing) -> list[str]:
    """SVG of the signed errors before and after calibration, on one scale, at the places of ``spacing_picture``."""
    rows = _rows(data)
    ends = [0.0, 1e-9, *(end for row in rows for end in (row["before"], row["after"] - row["U"], row["after"] + row["U"]))]
    low, high = 1.06 * min(ends), 1.06 * max(ends)
    step = _ticks(high - low)[1]
    axis = {"low": low, "high": high, "ticks": [k * step for k in range(int(np.ceil(low / step)), int(high / step) + 1)]}
    return [filled(HERE / "columns.svg.j2", rows=rows, when=when, colour=c, **axis) for when, c in (("before", BEFORE), ("after", AFTER))]


def _rows(data: Spacing) -> list[dict[str, Any]]:
    """Place, errors before and after, and U expected (0: none) of the places that are drawn, in their order."""
    U = np.zeros(len(data.after)) if data.sigma is None else 2 * data.sigma
    shown = np.sort(np.argsort(-np.abs(data.after))[:MOST_ROWS])
    return [{"place": data.place[k], "before": data.before[k], "after": data.after[k], "U": U[k]} for k in shown]


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
