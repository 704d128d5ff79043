"""A chart in a 2D view of the viewer, for what is no curve over time: bars with whiskers, points over a variable, limit lines.

Drawn in points of a sheet of SHEET_WIDTH, x to the right and y downwards, as the viewer's 2D views count them. The name of the view says
what the axes are: text in a picture is of one size however small the view is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from rerun import escape_entity_path_part as in_path

from mbcacq.recording.rrd.drawable import drawable

SHEET_WIDTH, SHEET_HEIGHT = 900.0, 420.0  # of a chart with its labels
ROOM, FLATTEST = 860.0, 200.0  # height for charts one below the other in half of a usual window; least height of one of them
LEFT, RIGHT, TOP, BOTTOM = 70.0, 20.0, 42.0, 34.0
LETTER = 11.0  # width of a letter of a label, about
INK, GRID, LIMIT = (190, 198, 210), (58, 64, 76), (235, 96, 60)
Colour = tuple[int, ...]


def round_step(span: float, most: int) -> float:
    """The smallest of 1, 2, 5 times a power of ten that divides ``span`` (above zero) into at most ``most`` parts."""
    power = 10.0 ** np.floor(np.log10(span / most))
    return float(next(f * power for f in (1.0, 2.0, 5.0, 10.0) if span / (f * power) <= most + 1e-9))


def ticks(ends: tuple[float, float], most: int) -> np.ndarray:
    """Round values between the ends of an axis, about ``most`` of them and at least two: one alone says nothing of the scale."""
    while True:
        step = round_step(ends[1] - ends[0], most)
        values = np.arange(np.ceil(ends[0] / step), np.floor(ends[1] / step + 1e-9) + 1) * step
        if len(values) > 1:
            return values
        most += 1


def written(value: float) -> str:
    """A value at a tick; zero has no sign."""
    return f"{value + 0.0:.6g}"


def sheet_height(charts: int) -> float:
    """Height of the sheet of each of several charts that stand one below the other."""
    return float(np.clip(ROOM / max(charts, 1), FLATTEST, SHEET_HEIGHT))


class Chart:
    """Axes with ticks and labels on ``entity``; what is drawn into them stands below it, static."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        entity: str,
        x: tuple[float, float],
        y: tuple[float, float],
        names: Sequence[str] | None = None,
        height: float = SHEET_HEIGHT,
    ) -> None:
        """x, y: ranges of the axes; names: of the places 0, 1, .. on the x axis instead of numbers; height: of the sheet."""
        self._rec, self._entity, self._x, self._y, self._height, self._key_end = stream, entity, x, y, height, LEFT
        self._axes(names)

    def at(self, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        """(k, 2) points of the sheet of values in the axes; what lies outside stands at the edge."""
        (x0, x1), (y0, y1) = self._x, self._y
        column = LEFT + (np.clip(np.asarray(x, float), x0, x1) - x0) / (x1 - x0) * (SHEET_WIDTH - LEFT - RIGHT)
        row = self._height - BOTTOM - (np.clip(np.asarray(y, float), y0, y1) - y0) / (y1 - y0) * (self._height - TOP - BOTTOM)
        return np.stack(np.broadcast_arrays(column, row), axis=-1).reshape(-1, 2)

    def bars(self, name: str, x: np.ndarray, y: np.ndarray, width: float, colour: Colour) -> None:
        """Bars from zero, ``width`` in units of x, centred on x (k,) with height y (k,)."""
        corner, opposite = self.at(x - width / 2, 0.0), self.at(x + width / 2, y)
        low, high = np.minimum(corner, opposite), np.maximum(corner, opposite)
        lines = [np.array([[c, a], [c, b]]) for (left, a), (right, b) in zip(low, high, strict=True) for c in np.arange(left, right, 0.8)]
        self._strips(name, lines, colour, 0.9)
        self._key(name, colour)

    def whiskers(self, name: str, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: Colour = INK) -> None:
        """Vertical lines from low (k,) to high (k,) with a foot and a head."""
        ends = zip(self.at(x, low), self.at(x, high), strict=True)
        foot = np.array([5.0, 0.0])
        self._strips(name, [line for a, b in ends for line in ([a, b], [a - foot, a + foot], [b - foot, b + foot])], colour, 0.8)
        self._key(name, colour)

    def level(self, name: str, y: Sequence[float], colour: Colour = LIMIT) -> None:
        """Horizontal lines over the whole width, e.g. a limit; without a name they are not in the legend."""
        self._strips(name or "zero", [self.at(np.array(self._x), v) for v in y], colour, 1.0)
        if name:
            self._key(name, colour)

    def points(self, name: str, x: np.ndarray, y: np.ndarray, colour: Colour, radius: float = 2.2) -> None:
        self._log(in_path(name), rr.Points2D(self.at(x, y), colors=[colour], radii=radius))
        self._key(name, colour)

    def line(self, name: str, x: np.ndarray, y: np.ndarray, colour: Colour) -> None:
        self._strips(name, [self.at(x, y)], colour, 1.2)
        self._key(name, colour)

    def _axes(self, names: Sequence[str] | None) -> None:
        left, right, top, bottom = LEFT, SHEET_WIDTH - RIGHT, TOP, self._height - BOTTOM
        frame = np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
        self._log("frame", rr.LineStrips2D([frame], colors=[GRID], radii=0.6))
        rows = ticks(self._y, 6 if self._height > 1.5 * FLATTEST else 3)
        at = self.at(self._x[0], rows)
        if names is None:
            marks = [(v, written(v)) for v in ticks(self._x, 8)]
        else:
            every = len(names) // 16 + 1
            marks = [(float(k), name) for k, name in enumerate(names) if k % every == 0]
        self._log("grid", rr.LineStrips2D([np.array([a, [right, a[1]]]) for a in at], colors=[GRID], radii=0.4))
        places = [*(at - [34.0, 9.0]), *(self.at(v, self._y[0])[0] + [0.0, 4.0] for v, _ in marks)]
        self._labels("ticks", places, [*map(written, rows), *(text for _, text in marks)])

    def _key(self, name: str, colour: Colour) -> None:
        """The entry of the legend, above the chart."""
        half = LETTER * len(name) / 2 + 12.0
        at = np.array([self._key_end + 22.0 + half, TOP / 2])
        self._key_end = at[0] + half + 14.0
        self._log(f"key/{in_path(name)}", rr.Points2D([at - [half + 8.0, 0.0]], colors=[colour], radii=5.0))
        self._labels(f"key/{in_path(name)}/text", [at - [0.0, 12.0]], [name])

    def _labels(self, part: str, places: Sequence[np.ndarray], texts: Sequence[str]) -> None:
        labels = [drawable(text) for text in texts]
        self._log(part, rr.Points2D(np.array(places), labels=labels, show_labels=True, radii=0.01, colors=[INK]))

    def _strips(self, name: str, strips: Sequence[Sequence[np.ndarray] | np.ndarray], colour: Colour, radius: float) -> None:
        self._log(in_path(name), rr.LineStrips2D([np.array(s) for s in strips], colors=[colour], radii=radius))

    def _log(self, part: str, shape: rr.AsComponents) -> None:
        self._rec.log(f"{self._entity}/{part}", shape, static=True)
